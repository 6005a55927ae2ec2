"""The list of checks, as cases for pytest and as verdicts for the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import SkipTest

from stridetwin.estimators.base import Options
from stridetwin.streams.errors import ConfigError
from stridetwin.testing.checks.faulty_samples import check_fault
from stridetwin.testing.checks.interface import check_declaration, check_estimates, check_missing_sensors, check_stamps
from stridetwin.testing.checks.memory import check_bounded_memory, check_keeps_no_reference, check_leaves_sample
from stridetwin.testing.checks.numbers import check_covariance, check_finite
from stridetwin.testing.checks.plausible import check_plausible
from stridetwin.testing.checks.repeatability import check_causal, check_deterministic, check_follow, check_independent
from stridetwin.testing.faults import FAULT_CASES
from stridetwin.testing.subject import ConformanceError, Subject, skip

if TYPE_CHECKING:
    import pytest

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
_DECLARATION, _ESTIMATES, _DETERMINISTIC = "declaration", "estimates", "deterministic"


@dataclass(frozen=True, kw_only=True)
class Check:
    """A check of the conformance suite, which runs on one estimator at a time.

    Attributes:
        run: Raises `ConformanceError` if an estimator fails it.
        requires: Name of the check without which this one says nothing; "" for none.
        summary: What it checks, in one line.
    """

    run: Callable[[Subject], None]
    requires: str
    summary: str


def _check(run: Callable[[Subject], None], requires: str) -> Check:
    """A check whose summary is the first line of its function's docstring."""
    return Check(run=run, requires=requires, summary=(run.__doc__ or "").splitlines()[0])


CHECKS: dict[str, Check] = {
    _DECLARATION: _check(check_declaration, ""),
    "missing_sensors": _check(check_missing_sensors, _DECLARATION),
    _ESTIMATES: _check(check_estimates, _DECLARATION),
    "stamps": _check(check_stamps, _ESTIMATES),
    "finite": _check(check_finite, _ESTIMATES),
    "covariance": _check(check_covariance, _ESTIMATES),
    "plausible": _check(check_plausible, _ESTIMATES),
    "leaves_sample": _check(check_leaves_sample, _ESTIMATES),
    _DETERMINISTIC: _check(check_deterministic, _ESTIMATES),
    "independent": _check(check_independent, _DETERMINISTIC),
    "causal": _check(check_causal, _DETERMINISTIC),
    "keeps_no_reference": _check(check_keeps_no_reference, _DETERMINISTIC),
    "follow": _check(check_follow, _DETERMINISTIC),
    **{
        case.name: Check(
            run=partial(check_fault, case=case),
            requires=_ESTIMATES,
            summary=f"Finite estimates and no exception where {case.summary}.",
        )
        for case in FAULT_CASES
    },
    "bounded_memory": _check(check_bounded_memory, _ESTIMATES),
}
"""All checks by name, each after the one that it requires."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Outcome of one check.

    Attributes:
        check: Its name.
        outcome: `passed`, `failed` or `skipped`.
        message: What is wrong and what to change, or why the check was skipped; "" if it passed.
    """

    check: str
    outcome: str
    message: str = ""


class Case:
    """One check of one estimator, for a test.

    Args:
        name: Name of the check.
        suite: The verdicts on this estimator, which all of its cases share.

    Attributes:
        name: Name of the check.
    """

    def __init__(self, name: str, suite: _Suite) -> None:
        self.name, self._suite = name, suite

    def run(self) -> None:
        """Runs the check.

        Raises:
            ConformanceError: The estimator fails it.
            SkipTest: It does not apply, or the check that it requires has failed; pytest reports a skipped test.
        """
        verdict = self._suite.verdict(self.name)
        if verdict.outcome == FAILED:
            raise ConformanceError(f"{self._suite.subject.name}: {verdict.message}")
        if verdict.outcome == SKIPPED:
            raise skip(verdict.message)

    def __repr__(self) -> str:
        return f"<Case {self.name} of {self._suite.subject.name}>"


class _Suite:
    """The verdicts on one estimator; each check runs once, when it is first needed.

    Attributes:
        subject: The estimator under test.
    """

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self._verdicts: dict[str, Verdict] = {}  # of the checks that have run, by name

    def verdict(self, name: str) -> Verdict:
        """The verdict of a check."""
        if name not in self._verdicts:
            self._verdicts[name] = self._run(name)
        return self._verdicts[name]

    def _run(self, name: str) -> Verdict:
        """Runs a check after the one that it requires; it is skipped if that one has not passed."""
        check = CHECKS[name]
        if check.requires and self.verdict(check.requires).outcome != PASSED:
            return Verdict(check=name, outcome=SKIPPED, message=f"needs the check {check.requires}, which did not pass")
        try:
            check.run(self.subject)
        except ConformanceError as error:
            return Verdict(check=name, outcome=FAILED, message=str(error))
        except SkipTest as error:
            return Verdict(check=name, outcome=SKIPPED, message=str(error))
        return Verdict(check=name, outcome=PASSED)


def conformance_cases(
    estimator_class: type, *, options: Options | None = None, recording: Path | None = None
) -> list[pytest.ParameterSet]:
    """The checks of an estimator as parameters of a test, each with its name as id.

    Use it as `@pytest.mark.parametrize("case", conformance_cases(MyEstimator))` on a test that calls `case.run()`.
    Nothing runs before the tests do.

    Args:
        estimator_class: An `Estimator`, or a class with the constructor `Class(rig)` and `update` alone.
        options: Options such as method or foot; None for the defaults.
        recording: Recording to use in place of the twin's walk, for sensors that the twin does not have.
    """
    import pytest

    suite = _Suite(Subject(estimator_class, options, recording))
    return [pytest.param(Case(name, suite), id=name) for name in CHECKS]


def check_conformance(
    estimator_class: type,
    *,
    options: Options | None = None,
    recording: Path | None = None,
    only: Iterable[str] = (),
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> list[Verdict]:
    """Runs the checks of an estimator, all of them unless `only` names some.

    Args:
        estimator_class: An `Estimator`, or a class with the constructor `Class(rig)` and `update` alone.
        options: Options such as method or foot; None for the defaults.
        recording: Recording to use in place of the twin's walk, for sensors that the twin does not have.
        only: Names of checks.
        progress: Called with a stage and the share of it that is done.

    Returns:
        A verdict per check, in the order of `CHECKS`, or of `only`.

    Raises:
        ConfigError: A name in `only` is that of no check.
    """
    names = list(only) or list(CHECKS)
    for name in names:
        if name not in CHECKS:
            raise ConfigError("only", "check", name, ", ".join(CHECKS))
    suite = _Suite(Subject(estimator_class, options, recording))
    verdicts = []
    for i, name in enumerate(names):
        verdicts.append(suite.verdict(name))
        progress("conform", (i + 1) / len(names))
    return verdicts
