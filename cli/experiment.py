"""`experiment`: reproduces the table of a paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from stridetwin.cli.options import Options, count, one_of, whole
from stridetwin.cli.outcome import Outcome, Progress
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies.catalogue import STUDIES


@dataclass(frozen=True, kw_only=True)
class ExperimentOptions(Options):
    """Run a paper's experiment and print its table beside ours."""

    experiment: Annotated[str, typer.Argument(metavar="NAME", help=", ".join(STUDIES), **one_of(tuple(STUDIES)))]
    workers: Annotated[int, typer.Option(parser=count, metavar="N", help="Cases at a time.")] = 1
    seed: Annotated[
        int | None, typer.Option(parser=whole, metavar="FIRST", help="Seed of the first case (default 1000).")
    ] = None
    subset: Annotated[int | None, typer.Option(parser=count, metavar="K", help="Number of cases (default all).")] = None
    physics: Annotated[
        Literal["kinematic", "dynamic"], typer.Option(help="How the body moves, in experiments with walks.")
    ] = "dynamic"
    resume: Annotated[bool, typer.Option("--resume", help="Continue an earlier run that stopped.")] = False
    keep: Annotated[bool, typer.Option("--keep", help="Keep the recordings of the walks in the folder.")] = False
    estimators: Annotated[
        list[str] | None,
        typer.Option(
            "--estimators", metavar="NAME", help="Also run an installed estimator of the same kind; may be repeated."
        ),
    ] = None
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for the cases (default runs/NAME).")
    ] = None


def experiment_command(arguments: ExperimentOptions, progress: Progress) -> Outcome:
    """`experiment`."""
    try:
        from stridetwin.studies.catalogue import experiment
        from stridetwin.studies.registry import Options, run_experiment

        study = experiment(arguments.experiment)
    except ModuleNotFoundError as error:
        extra = "closed-loop" if str(error.name).startswith("dm_") else "twin"
        raise StrideTwinError(
            f"{error.name} is not installed; experiments need the simulator: pip install 'stridetwin[{extra}]'"
        ) from error
    options = Options(
        folder=arguments.output or Path("runs") / arguments.experiment,
        workers=arguments.workers,
        first=arguments.seed,
        subset=arguments.subset,
        physics=arguments.physics,
        resume=arguments.resume,
        keep=arguments.keep,
        estimators=tuple(arguments.estimators or ()),
    )
    result = run_experiment(arguments.experiment, options, progress)
    return Outcome(data=result, lines=study.table(result))
