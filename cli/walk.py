"""`run`, and `generate` of a scenario: walks of the twin."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stridetwin.cli.options import BackendOption, WalkOptions, count, whole
from stridetwin.cli.outcome import Outcome, Progress
from stridetwin.cli.score import score_table

if TYPE_CHECKING:
    from stridetwin.scenarios.scenario_file import Scenario


@dataclass(frozen=True, kw_only=True)
class RunOptions(WalkOptions):
    """Walk, estimate and score in one go."""

    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name in the catalogue (see `list`), or a .yaml file.")
    ]
    seed: Annotated[int, typer.Option(parser=whole, metavar="N", help="Determines every byte.")] = 0
    backend: BackendOption = None
    no_film: Annotated[bool, typer.Option("--no-film", help="Leave the film out of the report.")] = False
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for the files (default runs/SCENARIO).")
    ] = None


@dataclass(frozen=True, kw_only=True)
class GenerateOptions(WalkOptions):
    """Record a walk, or the data set of a campaign, without estimates."""

    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO|CAMPAIGN", help="Name in the catalogue (see `list`), or a .yaml file.")
    ]
    seed: Annotated[
        int | None,
        typer.Option(parser=whole, metavar="N", help="Determines every byte (default 0, or the campaign's)."),
    ] = None
    workers: Annotated[
        int | None, typer.Option(parser=count, metavar="N", help="Campaign: walks at a time (default 1).")
    ] = None
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Campaign: walk on the workers of this Dask scheduler.")
    ] = None
    subset: Annotated[int | None, typer.Option(parser=count, metavar="K", help="Campaign: only the first K walks.")] = (
        None
    )
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="PATH",
            help="Recording to write (.mcap); for a campaign: output folder, existing walks are kept.",
        ),
    ]


def run_command(arguments: RunOptions, progress: Progress) -> Outcome:
    """`run`."""
    from stridetwin.report.runner import run_scenario

    scenario = _scenario(arguments)
    folder = arguments.output or Path("runs") / scenario.config.name
    run = run_scenario(
        scenario,
        arguments.seed,
        folder,
        _how_to_repeat(arguments),
        progress,
        film=not arguments.no_film,
        backend=arguments.backend or "",
    )
    data = {"folder": str(run.folder), "files": list(run.files), "estimators": run.scores}
    report = (run.folder / "report.html").absolute().as_uri()
    return Outcome(data=data, lines=[*score_table(run.scores), "", f"report  {report}", f"files   {folder}/"])


def record_command(arguments: GenerateOptions, progress: Progress) -> Outcome:
    """`generate` of a scenario."""
    from stridetwin.scenarios.record import make_twin, record

    scenario = _scenario(arguments)
    seed = arguments.seed or 0
    twin = make_twin(scenario, seed)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    record(twin, arguments.output, progress)
    data = {"recording": str(arguments.output), "duration_s": twin.duration_s, "seed": seed}
    return Outcome(data=data, lines=[f"{arguments.output}: {twin.duration_s:.1f} s of {scenario.config.name}"])


def _scenario(arguments: RunOptions | GenerateOptions) -> Scenario:
    from stridetwin.scenarios.record import without_cameras
    from stridetwin.scenarios.scenario_file import PHYSICS, load_scenario
    from stridetwin.streams.errors import ConfigError

    scenario = load_scenario(arguments.scenario)
    for note in scenario.notes:
        print(f"stridetwin: note: {note}", file=sys.stderr)
    if arguments.physics is not None:
        if arguments.physics not in PHYSICS:
            raise ConfigError("command line", "--physics", arguments.physics, ", ".join(PHYSICS))
        scenario = replace(scenario, config=replace(scenario.config, physics=arguments.physics))
    return without_cameras(scenario) if arguments.no_cameras else scenario


def _how_to_repeat(arguments: RunOptions) -> str:
    words = ["stridetwin", "run", arguments.scenario, "--seed", str(arguments.seed)]
    words += ["--physics", arguments.physics] if arguments.physics else []
    words += ["--no-cameras"] if arguments.no_cameras else []
    words += ["--no-film"] if arguments.no_film else []
    words += ["--backend", arguments.backend] if arguments.backend else []
    return shlex.join(words)
