"""`conform`: checks that an estimator keeps the rules of the interface."""

from __future__ import annotations

import importlib
import sys
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stridetwin.cli.console import table
from stridetwin.cli.options import Options, Outcome, Progress, one_of, option
from stridetwin.streams.errors import ConfigError, StrideTwinError

if TYPE_CHECKING:
    from stridetwin.estimators.base import Options as EstimatorOptions


@dataclass(frozen=True, kw_only=True)
class ConformOptions(Options):
    """Check that an estimator is causal, deterministic, bounded in memory, and robust to faulty samples."""

    estimator: Annotated[
        str,
        typer.Argument(
            metavar="ESTIMATOR", help="Name of an installed estimator, or MODULE:CLASS.", show_default=False
        ),
    ]
    method: Annotated[str | None, option("Method in place of the first.", "NAME")] = None
    foot: Annotated[
        str, typer.Option(metavar="l|r", help="Foot, for an estimator of one foot.", **one_of(("l", "r")))
    ] = "l"
    mount: Annotated[str, option("Mount of the camera in place of the first.", "NAME")] = ""
    recording: Annotated[
        Path | None, option("Check on this recording instead of a simulated walk, for sensors of your own.", "FILE")
    ] = None
    only: Annotated[list[str], option("Run only this check; may be repeated.", "CHECK")] = field(default_factory=list)


def conform_command(arguments: ConformOptions, progress: Progress) -> Outcome:
    """`conform`."""
    from stridetwin.streams.recording.reader import Recording
    from stridetwin.testing.cases import FAILED, PASSED, check_conformance

    if arguments.recording is not None:
        Recording(arguments.recording)  # an error in it is the user's, not the estimator's
    with redirect_stdout(sys.stderr):  # of the estimator's own prints: stdout is for the verdicts
        estimator_class = _load_estimator(arguments.estimator)
        verdicts = check_conformance(
            estimator_class, options=_estimator_options(arguments, estimator_class), recording=arguments.recording,
            only=arguments.only, progress=progress,
        )  # fmt: skip
    failed = sum(verdict.outcome == FAILED for verdict in verdicts)
    passed = sum(verdict.outcome == PASSED for verdict in verdicts)
    data = {
        "estimator": arguments.estimator, "failed": failed, "passed": passed,
        "checks": [asdict(verdict) for verdict in verdicts],
    }  # fmt: skip
    rows = [(verdict.check, verdict.outcome, verdict.message) for verdict in verdicts]
    summary = f"{arguments.estimator}: {passed} passed, {failed} failed, {len(verdicts) - passed - failed} skipped"
    return Outcome(data=data, lines=[table(rows, text_columns=3), summary], code=int(failed > 0))


def _load_estimator(text: str) -> type:
    """The class of an installed estimator, or that of `MODULE:CLASS`, installed or in the working folder.

    Raises:
        StrideTwinError: There is no such estimator, module or class, or the import raised an exception.
    """
    from stridetwin.estimators import registry

    module, colon, attribute = text.partition(":")
    if not colon:
        return registry.estimator(text)
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.append(folder)  # installed modules take precedence over the working folder
    try:
        loaded: Any = importlib.import_module(module)
        for name in attribute.split("."):
            loaded = getattr(loaded, name)
    except (Exception, SystemExit) as error:
        words = " ".join(str(error).split())
        raise StrideTwinError(f"conform: {text}: cannot be imported: {type(error).__name__}: {words}") from error
    if not isinstance(loaded, type) or not callable(getattr(loaded, "update", None)):
        raise StrideTwinError(f"conform: {text} is not a class with an update(sample) method")
    return loaded


def _estimator_options(arguments: ConformOptions, estimator_class: type) -> EstimatorOptions:
    """Options of the estimator; an unknown method or mount is refused."""
    from stridetwin.estimators.base import Declaration
    from stridetwin.estimators.base import Options as EstimatorOptions

    declaration = getattr(estimator_class, "declaration", None)
    if not isinstance(declaration, Declaration):
        declaration = Declaration(name=estimator_class.__name__, kind="")
    method = declaration.methods[0] if arguments.method is None and declaration.methods else arguments.method or ""
    if declaration.methods and method not in declaration.methods:
        raise ConfigError("conform", "--method", method, ", ".join(declaration.methods))
    if arguments.mount and arguments.mount not in declaration.mounts:
        raise ConfigError("conform", "--mount", arguments.mount, ", ".join(declaration.mounts) or "none")
    return EstimatorOptions(method=method, foot=arguments.foot, mount=arguments.mount)
