"""`conform`: checks that an estimator keeps the rules of the interface."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from dataclasses import asdict

from stridetwin.cli.commands import ConformOptions
from stridetwin.cli.console import table
from stridetwin.cli.options import Outcome, Progress
from stridetwin.estimators import registry
from stridetwin.estimators.base import Declaration
from stridetwin.estimators.base import Options as EstimatorOptions
from stridetwin.gate.own_estimators import load_class
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.reader import Recording
from stridetwin.testing.cases import FAILED, PASSED, check_conformance


def conform_command(arguments: ConformOptions, progress: Progress) -> Outcome:
    """Runs `conform`: checks an estimator, and gives the outcome of each check; the exit code is 1 if one failed."""
    if arguments.recording is not None:
        Recording(arguments.recording)  # an error in it is the user's, not the estimator's
    with redirect_stdout(sys.stderr):  # of the estimator's own prints: stdout is for the verdicts
        estimator_class = _load_estimator(arguments.estimator)
        verdicts = check_conformance(
            estimator_class,
            options=_estimator_options(arguments, estimator_class),
            recording=arguments.recording,
            only=arguments.only,
            progress=progress,
        )
    failed = sum(verdict.outcome == FAILED for verdict in verdicts)
    passed = sum(verdict.outcome == PASSED for verdict in verdicts)
    data = {
        "estimator": arguments.estimator,
        "failed": failed,
        "passed": passed,
        "checks": [asdict(verdict) for verdict in verdicts],
    }
    rows = [(verdict.check, verdict.outcome, verdict.message) for verdict in verdicts]
    summary = f"{arguments.estimator}: {passed} passed, {failed} failed, {len(verdicts) - passed - failed} skipped"
    return Outcome(data=data, lines=[table(rows, text_columns=3), summary], code=int(failed > 0))


def _load_estimator(text: str) -> type:
    """The class of an installed estimator, or that of `MODULE:CLASS`, installed or in the working folder.

    Raises:
        StrideTwinError: There is no such estimator, module or class, or the import raised an exception.
    """
    return load_class(text, "conform") if ":" in text else registry.estimator(text)


def _estimator_options(arguments: ConformOptions, estimator_class: type) -> EstimatorOptions:
    """Options of the estimator to be checked, with its first method by default.

    Raises:
        ConfigError: The estimator has no such method or mount.
    """
    declaration = getattr(estimator_class, "declaration", None)
    if not isinstance(declaration, Declaration):  # a class with `update` alone has none; a check reports a wrong one
        declaration = Declaration(name=estimator_class.__name__, kind="")
    default_method = declaration.methods[0] if declaration.methods else ""
    method = default_method if arguments.method is None else arguments.method
    if declaration.methods and method not in declaration.methods:
        raise ConfigError("conform", "--method", method, ", ".join(declaration.methods))
    if arguments.mount and arguments.mount not in declaration.mounts:
        raise ConfigError("conform", "--mount", arguments.mount, ", ".join(declaration.mounts) or "none")
    return EstimatorOptions(method=method, foot=arguments.foot, mount=arguments.mount)
