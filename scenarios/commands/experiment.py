"""`experiment`: the table of a paper."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from stridetwin.scenarios.commands.outcome import Outcome, Progress
from stridetwin.streams.errors import StrideTwinError


def experiment_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`experiment`."""
    try:
        from stridetwin.scenarios.experiments.registry import Options, run_experiment
        from stridetwin.scenarios.experiments.studies import experiment

        study = experiment(arguments.experiment)
    except ModuleNotFoundError as error:
        raise StrideTwinError(
            f"{error.name} is not installed; experiments need the simulator: pip install 'stridetwin[twin]'"
        ) from error
    options = Options(
        folder=arguments.output or Path("runs") / arguments.experiment,
        workers=arguments.workers,
        first=arguments.seed,
        subset=arguments.subset,
        physics=arguments.physics,
        resume=arguments.resume,
        keep=arguments.keep,
    )
    result = run_experiment(arguments.experiment, options, progress)
    return Outcome(data=result, lines=study.table(result))
