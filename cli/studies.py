"""`experiment` reproduces the table of a paper or runs a study; `place` finds where sensors are most useful."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from stridetwin.cli.console import table
from stridetwin.cli.options import (
    Options,
    Outcome,
    ParametersOption,
    Progress,
    SchedulerOption,
    check_executor,
    count,
    option,
    output_option,
    switch,
    whole,
)
from stridetwin.scenarios.built_in import experiments
from stridetwin.streams.errors import FieldLocation, explain_import_error, missing_library_error
from stridetwin.streams.notices import note

if TYPE_CHECKING:
    from rich.table import Table

    from stridetwin.studies.placement.problem_file import PlacementProblem
    from stridetwin.studies.placement.result import PlacementResult

_SUFFIXES = (".yaml", ".yml")
"""Endings of a study file's name."""


def _experiment(text: str) -> str:
    """Parses the argument of `experiment`: the name of an experiment, or the path of a study file.

    Raises:
        typer.BadParameter: It is neither.
    """
    if text not in experiments() and not text.lower().endswith(_SUFFIXES):
        raise typer.BadParameter(f"{text!r}: expected one of {', '.join(experiments())}, or a .yaml file")
    return text


@dataclass(frozen=True, kw_only=True)
class ExperimentOptions(Options):
    """Run a paper's experiment and print its results beside ours, or run a study of your own."""

    experiment: Annotated[
        str,
        typer.Argument(
            metavar="NAME|STUDY",
            help=f"{', '.join(experiments())}, or a .yaml file of a study.",
            parser=_experiment,
            autocompletion=lambda: list(experiments()),
        ),
    ]
    workers: Annotated[int | None, option("Cases at a time (default 1).", "N", count)] = None
    scheduler: SchedulerOption = None
    seed: Annotated[int | None, option("Seed of the first case (default 1000).", "FIRST", whole)] = None
    subset: Annotated[int | None, option("Number of cases (default all).", "K", count)] = None
    physics: Annotated[
        Literal["kinematic", "dynamic"] | None,
        option("How the body moves, in experiments with walks (default dynamic; in a study as its scenarios say)."),
    ] = None
    resume: Annotated[bool, switch("--resume", "Continue an earlier run that stopped.")] = False
    estimators: Annotated[
        list[str] | None,
        typer.Option(
            "--estimators", metavar="NAME", help="Also run an installed estimator of the same kind; may be repeated."
        ),
    ] = None
    parameters: ParametersOption = field(default_factory=list)
    keep: Annotated[bool, switch("--keep", "Keep the recordings of the walks in the folder.")] = False
    output: Annotated[Path | None, output_option("Folder for the cases (default runs/NAME).", "DIR")] = None


def experiment_command(arguments: ExperimentOptions, progress: Progress) -> Outcome:
    """Runs `experiment`: an experiment of a paper with its published table, or a study file.

    Returns:
        The results, and our table beside the published one.

    Raises:
        StrideTwinError: An option is invalid, or the simulator is not installed.
    """
    check_executor(arguments.workers, arguments.scheduler)
    if arguments.experiment not in experiments():
        return _study_command(arguments, progress)
    try:
        from stridetwin.outputs.parameters import parse_parameters
        from stridetwin.studies.experiment import experiment
        from stridetwin.studies.registry import ExperimentBatchOptions, run_experiment

        study = experiment(arguments.experiment)
    except ModuleNotFoundError as error:
        if (missing := missing_library_error(error, "experiments need the simulator")) is None:
            raise  # a library that no extra of ours brings
        raise missing from error
    options = ExperimentBatchOptions(
        folder=arguments.output or Path("runs") / arguments.experiment,
        workers=arguments.workers or 1,
        scheduler=arguments.scheduler,
        estimators=tuple(arguments.estimators or ()),
        first=arguments.seed,
        subset=arguments.subset,
        physics=arguments.physics or "dynamic",
        resume=arguments.resume,
        keep=arguments.keep,
        parameters=parse_parameters(arguments.parameters),
    )
    result = run_experiment(arguments.experiment, options, progress, note)
    return Outcome(data=result, lines=study.table(result))


def _study_command(arguments: ExperimentOptions, progress: Progress) -> Outcome:
    """Runs `experiment` with a study file.

    Returns:
        The results, and a table with the means of every combination of factors.

    Raises:
        StrideTwinError: The file or an option is invalid, or the simulator is not installed.
    """
    here = FieldLocation(source="command line")
    for name, value in (("--estimators", arguments.estimators), ("--keep", arguments.keep)):
        if value:
            raise here.key(name).error(value, "none, as a study file lists its methods and keeps no walks")
    with explain_import_error("studies need the simulator", "twin"):
        from stridetwin.studies.study_file.results import table_head, table_rows
        from stridetwin.studies.study_file.run import REPORT, StudyOptions, run_study
        from stridetwin.studies.study_file.study import read_study
    from stridetwin.outputs.parameters import parse_parameters

    path, parameters = Path(arguments.experiment), parse_parameters(arguments.parameters)
    options = StudyOptions(
        folder=arguments.output or Path("runs") / path.stem,
        workers=arguments.workers or 1,
        scheduler=arguments.scheduler,
        first=arguments.seed,
        subset=arguments.subset,
        physics=arguments.physics,
        resume=arguments.resume,
        parameters=parameters,
    )
    result = run_study(read_study(path, parameters), options, progress, note)
    means = table(table_rows(result), table_head(result), text_columns=len(result["factors"]) + 1)
    page = (options.folder / REPORT).absolute().as_uri()
    # `words` are sentences on what the study shows; a blank line separates them from the page's address
    sentences = [*result["words"], ""] if result["words"] else []
    return Outcome(data=result, lines=[means, "", *sentences, f"page  {page}"])


@dataclass(frozen=True, kw_only=True)
class PlaceOptions(Options):
    """Sweep or optimise the mounts or the parts of sensors."""

    problem: Annotated[
        str,
        typer.Argument(
            metavar="SENSOR|PROBLEM",
            help="Placement of the catalogue (see `list`), such as foot_camera, or a .yaml file.",
        ),
    ]
    scenario: Annotated[str | None, option("Walk this scenario instead of the file's.", "SCENARIO")] = None
    walks: Annotated[int | None, option("Walks of each scenario (default: as in the file).", "K", count)] = None
    seed: Annotated[int | None, option("Seed of the first walk (default: as in the file).", "FIRST", whole)] = None
    budget: Annotated[int | None, option("Optimise: places to try (default: as in the file).", "N", count)] = None
    workers: Annotated[int | None, option("Walks at a time (default 1).", "N", count)] = None
    scheduler: SchedulerOption = None
    resume: Annotated[bool, switch("--resume", "Continue an earlier run that stopped.")] = False
    output: Annotated[Path | None, output_option("Folder for the files (default runs/NAME).", "DIR")] = None


def place_command(arguments: PlaceOptions, progress: Progress) -> Outcome:
    """Runs `place`: sweeps or optimises the mounts or parts of sensors, and ranks the places."""
    check_executor(arguments.workers, arguments.scheduler)
    from stridetwin.studies.placement.problem_file import find_problem, read_problem

    with explain_import_error("placements need the simulator", "twin"):
        from stridetwin.studies.placement.run import PlacementOptions, run_placement
    path = find_problem(arguments.problem)
    problem = _apply_options(read_problem(path), arguments)
    options = PlacementOptions(
        folder=arguments.output or Path("runs") / path.stem,
        workers=arguments.workers or 1,
        scheduler=arguments.scheduler,
        seed=arguments.seed,
        walks=arguments.walks,
        resume=arguments.resume,
    )
    result = run_placement(problem, options, progress)
    page = (options.folder / "placement.html").absolute().as_uri()
    return Outcome(data=result, lines=[*placement_lines(result), f"page  {page}"])


def _apply_options(problem: PlacementProblem, arguments: PlaceOptions) -> PlacementProblem:
    """The placement problem with the settings of the command line in place of the file's.

    Raises:
        StrideTwinError: `--scenario` or `--budget` does not fit the problem.
    """
    from stridetwin.scenarios.campaign.named_files import NamedBase, NamedFiles
    from stridetwin.studies.placement.problem_file import check_budget

    here = FieldLocation(source="command line")
    if arguments.scenario is not None:
        at = here.key("--scenario")
        # as if a file in the working folder named the scenario: its own files must be there, too
        files = NamedFiles(Path.cwd() / "command line", "the working folder")
        base = files.base(NamedBase(scenario=arguments.scenario), at, short=True)
        for name, file in files.user_files.items():
            if problem.user_files.get(name, file) != file:  # both would be copied to one place in the output
                raise at.error(arguments.scenario, f"a scenario without another file {name} than the placement's")
        problem = replace(problem, bases=(base,), user_files=problem.user_files | files.user_files)
    if arguments.budget is not None:
        if problem.search is None:
            raise here.key("--budget").error(arguments.budget, f"no --budget, as {problem.path.stem} only sweeps")
        problem = replace(problem, search=replace(problem.search, budget=arguments.budget))
        check_budget(problem, here.key("--budget"))
    return problem


def _describe_size(result: PlacementResult) -> str:
    """How many places were tried on how many walks, as text below the table."""
    walks, shown = len(result["walks"]), len(result["table"])  # the table has the unchanged place, too
    places = f"{result['tried']} places and the unchanged one on {walks} walk{'s' * (walks != 1)}"
    if shown > result["tried"]:  # all of them
        return places
    return f"{places}; {shown} of them in the table, all in places.csv"


def placement_lines(result: PlacementResult) -> list[str | Table]:
    """What `place` prints: the table of places, failures, and which differences are significant."""
    from stridetwin.studies.placement.page import value_text
    from stridetwin.studies.significance import interval_text

    scores = [score["name"] for score in result["scores"]]
    rows = [  # rank, values of the free parameters, and each score with its interval
        [
            str(row["rank"]),
            *(value_text(row["values"], name) for name in result["free"]),
            *(interval_text(row["scores"].get(name)) for name in scores),
        ]
        for row in result["table"]
    ]
    lines: list[str | Table] = [table(rows, ["place", *result["free"], *scores], text_columns=0)]
    lines += [f"{row['rank']} failed: {row['failed']}" for row in result["table"] if "failed" in row]
    # `words` are sentences on which differences are significant
    lines += ["", *result["words"], "", _describe_size(result)]
    if result["failed"]:
        lines.append(f"{result['failed']} of them failed somewhere")
    return lines
