"""`place`: finds where sensors are most useful."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stridetwin.cli.options import Options, count, whole
from stridetwin.cli.outcome import Outcome, Progress
from stridetwin.streams.errors import StrideTwinError, Where

if TYPE_CHECKING:
    from stridetwin.studies.placement.problem_file import Problem


@dataclass(frozen=True, kw_only=True)
class PlaceOptions(Options):
    """Sweep or optimise where sensors sit, or which parts they are."""

    problem: Annotated[
        str,
        typer.Argument(
            metavar="SENSOR|PROBLEM",
            help="Placement of the catalogue (see `list`), such as foot_camera, or a .yaml file.",
        ),
    ]
    scenario: Annotated[
        str | None, typer.Option(metavar="SCENARIO", help="Walk this scenario instead of the file's.")
    ] = None
    walks: Annotated[
        int | None, typer.Option(parser=count, metavar="K", help="Walks of each scenario (default: as the file says).")
    ] = None
    seed: Annotated[
        int | None,
        typer.Option(parser=whole, metavar="FIRST", help="Seed of the first walk (default: as the file says)."),
    ] = None
    budget: Annotated[
        int | None, typer.Option(parser=count, metavar="N", help="Optimise: places to try (default: as the file says).")
    ] = None
    workers: Annotated[int, typer.Option(parser=count, metavar="N", help="Walks at a time.")] = 1
    resume: Annotated[bool, typer.Option("--resume", help="Continue an earlier run that stopped.")] = False
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for the files (default runs/NAME).")
    ] = None


def place_command(arguments: PlaceOptions, progress: Progress) -> Outcome:
    """`place`."""
    from stridetwin.studies.placement.problem_file import find_problem, read_problem

    try:
        from stridetwin.studies.placement.run import Options, run_placement
    except ModuleNotFoundError as error:
        raise StrideTwinError(
            f"{error.name} is not installed; placements need the simulator: pip install 'stridetwin[twin]'"
        ) from error
    path = find_problem(arguments.problem)
    problem = _asked(read_problem(path), arguments)
    options = Options(
        folder=arguments.output or Path("runs") / path.stem,
        workers=arguments.workers,
        seed=arguments.seed,
        walks=arguments.walks,
        resume=arguments.resume,
    )
    result = run_placement(problem, options, progress)
    return Outcome(
        data=result, lines=[*_lines(result), f"page  {(options.folder / 'placement.html').absolute().as_uri()}"]
    )


def _asked(problem: Problem, arguments: PlaceOptions) -> Problem:
    """The problem, with the settings of the command line in place of the file's."""
    from stridetwin.scenarios.campaign.named_files import NamedBase, NamedFiles
    from stridetwin.studies.placement.problem_file import check_budget

    here = Where(source="command line")
    if arguments.scenario is not None:
        at = here.key("--scenario")
        files = NamedFiles(Path.cwd() / "command line", "the working folder")
        base = files.base(NamedBase(scenario=arguments.scenario), at, short=True)
        for name, file in files.own.items():
            if problem.own.get(name, file) != file:
                raise at.error(arguments.scenario, f"a scenario whose {name} is the placement's, or has another name")
        problem = replace(problem, bases=(base,), own=problem.own | files.own)
    if arguments.budget is not None:
        if problem.search is None:
            raise here.key("--budget").error(arguments.budget, f"optimise to go with it; {problem.path.stem} sweeps")
        problem = replace(problem, search=replace(problem.search, budget=arguments.budget))
        check_budget(problem, here.key("--budget"))
    return problem


def _lines(result: dict[str, Any]) -> list[str]:
    """The table, and which differences in it are significant."""
    from stridetwin.studies.placement.page import said, said_value

    scores = [score["name"] for score in result["scores"]]
    rows = [["place", *result["free"], *scores]]
    rows += [[str(row["rank"]), *(said_value(row["values"], name) for name in result["free"]),
              *(said(row["scores"].get(name)) for name in scores)] for row in result["table"]]  # fmt: skip
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths)) for row in rows]
    lines += [f"{row['rank']} failed: {row['failed']}" for row in result["table"] if "failed" in row]
    lines += ["", *result["words"], "", f"{result['tried']} places on {len(result['walks'])} walks"]
    return [*lines, *([f"{result['failed']} of them failed somewhere"] if result["failed"] else [])]
