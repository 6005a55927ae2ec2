"""`score`: compares estimators with the truth and with a baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table

from stridetwin.batch.executors import BatchOptions
from stridetwin.cli.commands import SCORED_FRAME, ScoreOptions
from stridetwin.cli.console import table
from stridetwin.cli.options import NO_FILE, Outcome, Progress, check_executor
from stridetwin.estimators import registry
from stridetwin.gate.compare import Comparison, Rules, check_level, compare_scores
from stridetwin.gate.formatting import (
    HEAD,
    ScoringFailure,
    collect_failures,
    find_changes,
    format_failures,
    format_limits,
    to_cells,
    to_junit,
    to_markdown,
    verdict_line,
)
from stridetwin.gate.history_file import append_history, history_line
from stridetwin.gate.own_estimators import OwnEstimator, Program, PythonClass, TumFile
from stridetwin.gate.score_table import document_of, is_text, mean_scores, read_table, table_of
from stridetwin.gate.walk_scores import OnEvaluated, jobs_of, score_walks
from stridetwin.outputs.base import AnyKind, KindEvaluations, Scores
from stridetwin.outputs.coverage import describe_partial
from stridetwin.outputs.parameters import check_used, parse_parameters
from stridetwin.outputs.registry import kind_with_scores, kinds
from stridetwin.scenarios.score_needs import estimators_of
from stridetwin.streams.errors import ConfigError, StrideTwinError, explain_import_error
from stridetwin.streams.files import atomic_file
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS
from stridetwin.streams.notices import warn
from stridetwin.streams.recording.reader import Recording


def score_command(arguments: ScoreOptions, progress: Progress) -> Outcome:
    """Runs `score`: scores of all recordings, their means, and the comparison with a baseline.

    Returns:
        Scores by recording and means; the exit code is 1 if a score is worse than the baseline or a walk has failed.
    """
    check_executor(arguments.workers, arguments.scheduler)
    _check_options(arguments)
    baseline = read_table(arguments.baseline) if arguments.baseline else None
    rules = _comparison_rules(arguments)
    if baseline is not None:
        check_level(baseline, rules)
    own_estimators = _load_own_estimators(arguments)
    only = estimators_of(arguments.only, "--only") if arguments.only else None
    parameters = parse_parameters(arguments.parameters)
    check_used(parameters, registry.names() if only is None else only)
    settings = {
        "lenient": arguments.lenient,
        "alignment": arguments.align,
        "user_estimators": own_estimators,
        "only": only,
        "parameters": parameters,
    }
    jobs = jobs_of(arguments.recordings, **settings)
    if arguments.estimate and len(jobs) > 1:
        raise StrideTwinError("invalid --estimate: expected one RECORDING, or --program for many")
    options = BatchOptions(
        folder=arguments.resume or Path(), workers=arguments.workers or 1, scheduler=arguments.scheduler
    )
    if arguments.report and (len(jobs) > 1 or arguments.resume or arguments.scheduler):
        raise ConfigError(
            "command line", "--report", str(arguments.report), "one RECORDING, and no --resume or --scheduler"
        )
    # one row per recording, with the scores by estimator and what has failed
    rows = score_walks(
        jobs, options, progress, is_kept=arguments.resume is not None, on_evaluated=_page_writer(arguments.report)
    )
    warn_of_partial([(row["name"], row["estimators"]) for row in rows])
    means = mean_scores(row["estimators"] for row in rows)
    data = document_of(rows, means) | ({"parameters": parameters} if parameters else {})
    failed = collect_failures(rows)
    code, comparison = int(bool(failed)), None  # exit code: 1 after a failure
    if baseline is not None:
        comparison = compare_scores(table_of(data, "scores"), baseline, rules)
        data["comparison"] = {"how": comparison.description, "scores": [vars(line) for line in comparison.lines]}
        data["regressions"] = [vars(line) for line in comparison.regressions]
        code = 1 if comparison.regressions else code
        for path, form in ((arguments.junit, to_junit), (arguments.markdown, to_markdown)):
            if path is not None:
                with atomic_file(path) as file:
                    file.write_text(form(comparison, failed), encoding="utf-8")
    if arguments.history and arguments.label:
        append_history(arguments.history, history_line(arguments.label, rows, means, comparison))
    lines = format_scores(means, len(rows), comparison, failed)
    if arguments.report:
        lines += ["", f"page  {arguments.report.absolute().as_uri()}"]
    return Outcome(data=data, lines=lines, code=code)


def format_scores(
    means: dict[str, Scores], walks: int, comparison: Comparison | None, failed: Sequence[ScoringFailure]
) -> list[str | Table]:
    """What `score` prints: means over some walks, failures, and the changes from the baseline."""
    lines = score_tables(means)
    if walks > 1:
        lines.insert(0, f"arithmetic means of {walks} walks; heights are signed")
    lines += format_failures(failed)
    return lines if comparison is None else [*lines, *_format_comparison(comparison, failed)]


def _page_writer(file: Path | None) -> OnEvaluated | None:
    """Makes the function that writes the page of `--report` as soon as a recording has been evaluated.

    Args:
        file: The page to write; None makes no function.

    Raises:
        StrideTwinError: The libraries of the extra `report` are not installed.
    """
    if file is None:
        return None
    with explain_import_error("pages with figures need it", "report"):
        from stridetwin.report.score_page import score_page

    def write(recording: Recording, of_kinds: Sequence[KindEvaluations]) -> None:
        """Writes the page of one recording, unless nothing was evaluated."""
        if of_kinds:
            with atomic_file(file) as part:
                part.write_text(score_page(recording, of_kinds), encoding="utf-8")

    return write


def _check_options(arguments: ScoreOptions) -> None:
    """Refuses options that would have no effect, and a label that no file can hold.

    Raises:
        StrideTwinError: An option needs another one, or excludes it; the message says which.
    """
    for name in ("least", "false_alarms", "tolerance", "junit", "markdown"):
        if getattr(arguments, name) is not None and arguments.baseline is None:
            raise StrideTwinError(f"--{name.replace('_', '-')} is about changes: expected --baseline as well")
    has_own = arguments.estimate or arguments.estimator or arguments.program
    none_of_own = "expected no --estimate, --estimator, --program"
    for is_wrong, message in (
        (arguments.history and not arguments.label, "--history needs the --label of this version, such as a commit"),
        (
            arguments.label is not None and not arguments.history,
            "--label names a version in a history: expected --history as well",
        ),
        (
            arguments.trajectory != NO_OPTIONS and not (arguments.estimate or arguments.program),
            f"{NO_FILE} --estimate or --program",
        ),
        (arguments.resume and has_own, f"--resume is only valid for built-in estimators: {none_of_own}"),
        (arguments.only and has_own, f"--only selects built-in estimators: {none_of_own}"),
        (arguments.parameters and has_own, f"--set is only valid for built-in estimators: {none_of_own}"),
    ):
        if is_wrong:
            raise StrideTwinError(message)
    if arguments.label is not None and not is_text(arguments.label):
        raise ConfigError("command line", "--label", arguments.label, "text in UTF-8")


def _comparison_rules(arguments: ScoreOptions) -> Rules:
    """The rules of the comparison: shares in place of the options' percentages, and defaults where none is given."""
    shares_pct = {"level": arguments.false_alarms, "tolerance": arguments.tolerance}
    shares = {name: value / 100.0 for name, value in shares_pct.items() if value is not None}
    return Rules(**shares) if arguments.least is None else Rules(**shares, least=arguments.least)


def _load_own_estimators(arguments: ScoreOptions) -> tuple[OwnEstimator, ...]:
    """Loads the estimators of `--estimate`, `--estimator` and `--program`, which replace the built-in ones.

    Raises:
        StrideTwinError: One of them is invalid, or two have one name; reported before anything is scored.
    """
    frame = (arguments.frame or SCORED_FRAME).lstrip("/")
    own_estimators: list[OwnEstimator] = []
    for text in arguments.estimate:
        name, file = _split_assignment(text, "--estimate", "FILE")
        own_estimators.append(
            TumFile(name=name, file=Path(file), frame=frame, options=arguments.trajectory, alignment=arguments.align)
        )
    for text in arguments.estimator:
        name, place = _split_assignment(text, "--estimator", "module:Class")
        estimator = PythonClass(name=name, place=place, frame=frame)
        estimator.load()
        own_estimators.append(estimator)
    for text in arguments.program:
        name, command_line = _split_assignment(text, "--program", '"COMMAND {recording} {output}"')
        program = Program(
            name=name,
            command=command_line,
            frame=frame,
            timeout_s=arguments.timeout,
            options=arguments.trajectory,
            alignment=arguments.align,
        )
        program.arguments()
        own_estimators.append(program)
    # a class may declare its frame itself; `--frame` must then not name another one
    frames = {estimator.own_frame if isinstance(estimator, PythonClass) else frame for estimator in own_estimators}
    if own_estimators and arguments.frame is not None and frame not in frames:
        declared = f"{', '.join(sorted(frames))}, as the classes declare"
        raise ConfigError("command line", "--frame", arguments.frame, declared)
    names = [estimator.name for estimator in own_estimators]
    if twice := [name for name in names if names.count(name) > 1]:
        raise StrideTwinError(f"invalid name {twice[0]!r} of two estimators: expected a name for each")
    return tuple(own_estimators)


def score_tables(scores: dict[str, Scores]) -> list[str | Table]:
    """The main scores, one row per output, one table per kind of output."""
    of_kinds: dict[AnyKind, dict[str, Scores]] = {kind: {} for kind in kinds().values()}
    for name, values in scores.items():
        of_kinds[kind_with_scores(values)][name] = values
    tables = [_score_table(of_kind, kind) for kind, of_kind in of_kinds.items() if of_kind]
    lines = [line for of_kind in tables for line in ("", of_kind)]  # a blank line before each table
    return lines[1:]


def _score_table(scores: dict[str, Scores], kind: AnyKind) -> Table:
    """A table of one kind of output: a row per output, a column per score that has a heading."""
    columns = {score.name: score.heading for score in kind.scores if score.heading}
    rows = [[name, *(f"{values[c]:.3f}" if c in values else "-" for c in columns)] for name, values in scores.items()]
    return table(rows, ["estimator", *columns.values()])


def _format_comparison(comparison: Comparison, failed: Sequence[ScoringFailure]) -> list[str | Table]:
    """How the comparison was made, the scores that differ (regressions first), what it does not prove, the verdict."""
    rows = [to_cells(line) for line in find_changes(comparison)]
    head = f"against the baseline: {comparison.description}"
    return [
        "",
        head,
        *([table(rows, HEAD, text_columns=3)] if rows else []),
        *format_limits(comparison),
        verdict_line(comparison, failed),
    ]


def warn_of_partial(walks: Sequence[tuple[str, Mapping[str, Scores]]]) -> None:
    """Prints a warning on stderr for each output that covers less than 95 % of its walk.

    Args:
        walks: Name of each walk, and its scores by output.
    """
    for warning in describe_partial(walks):
        warn(warning)


def _split_assignment(text: str, option: str, what: str) -> tuple[str, str]:
    """The two parts of an option `NAME=...`.

    Raises:
        StrideTwinError: The text has another form; the message says what follows the name.
    """
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise StrideTwinError(f"{option}: invalid {text!r}: expected NAME={what}")
    return name, value
