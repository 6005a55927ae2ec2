"""One corruption of one recording: what is reported, and whether it matters."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.implausible.corruptions import CORRUPTIONS, Corruption
from benchmarks.implausible.files import FORMATS, Source
from benchmarks.implausible.harm import compare_ground, compare_paths, follow_foot, follow_head, map_ground
from benchmarks.implausible.walks import FEET, HEADS, Walk, load_walk
from stridetwin.outputs.terrain.grid import GroundGrid
from stridetwin.scenarios.check import Finding, check_recording
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory

LEAST_CHANGE = 0.05
"""Change of an estimate from which a corruption matters: 5 % of the way, or of the height of the eyes."""
_UNKNOWN = re.compile(r"could not be checked|were not checked")
"""Of reports that something could not be judged, which name no cause."""
RIGHT, OTHER, SILENT = "right", "other", "silent"
"""Outcomes: reported with its cause; something else was reported; nothing new was."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A corrupted recording.

    Attributes:
        corruption: Its name in `CORRUPTIONS`.
        form: Name of the format in `FORMATS`.
        number: Number of the case, which with the seed determines what the corruption draws.
        seed: Of the benchmark.
        walk: File of the good walk.
    """

    corruption: str
    form: str
    number: int
    seed: int
    walk: Path


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What came of a case.

    Attributes:
        corruption: Its name.
        form: Name of the format.
        number: Number of the case.
        what: What was done to the walk.
        outcome: `RIGHT`, `OTHER` or `SILENT`.
        change: Largest change of an estimate (see `harm`); None where it was not estimated, or could not be.
        reports: New reports, those that the good recording does not have.
    """

    corruption: str
    form: str
    number: int
    what: str
    outcome: str
    change: float | None
    reports: tuple[str, ...]

    @property
    def is_harmful(self) -> bool:
        """Whether an estimate is known to change by more than `LEAST_CHANGE`."""
        return self.change is not None and self.change > LEAST_CHANGE


def draw_cases(count: int, seed: int, folder: Path, only: Sequence[str] = ()) -> Iterator[Case]:
    """Corruptions in turn, each in a format and a walk that are drawn.

    Args:
        count: Number of cases.
        seed: Determines them, with their numbers.
        folder: Of the good walks.
        only: Names of corruptions, formats and families of formats, one of which must fit; all without any.
    """
    names = [(name, form) for name, c in CORRUPTIONS.items() for form in c.formats() if _is_selected(name, form, only)]
    corruptions = list(dict.fromkeys(name for name, _ in names))
    for number in range(count if names else 0):
        rng = np.random.default_rng([seed, number])
        corruption = corruptions[number % len(corruptions)]
        forms = [form for name, form in names if name == corruption]
        # families in turn by chance, so that formats that exist in many variants are not more frequent
        family = str(rng.choice(sorted({FORMATS[form].family for form in forms})))
        form = str(rng.choice([form for form in forms if FORMATS[form].family == family]))
        body = FORMATS[form].body
        walk = int(rng.integers(FEET if body == "foot" else HEADS))
        yield Case(corruption=corruption, form=form, number=number, seed=seed, walk=folder / f"{body}_{walk}.pickle")


def _is_selected(corruption: str, form: str, only: Sequence[str]) -> bool:
    """Whether a corruption, a format or its family is one of some names; true without names."""
    return not only or any(text in (corruption, form, FORMATS[form].family) for text in only)


def try_case(case: Case, clean_reports: Collection[Finding], always_estimate: bool = False) -> Trial:
    """Corrupts, writes and checks a recording; estimates from it where nothing right was reported.

    Args:
        case: The case.
        clean_reports: Those on the good recording, of `list_clean_reports`.
        always_estimate: Estimates in every case, which takes longer.
    """
    corruption = CORRUPTIONS[case.corruption]
    rng = np.random.default_rng([case.seed, case.number, 1])
    walk, what = corruption.edit(load_walk(case.walk), rng)
    usual = {_without_numbers(finding.text) for finding in clean_reports}
    change: float | None = None
    with tempfile.TemporaryDirectory() as folder:
        source = FORMATS[case.form].write(Path(folder), walk)
        texts = [finding.text for finding in list_reports(source)]
        reports = [text for text in texts if _without_numbers(text) not in usual]
        if always_estimate or not _is_right(corruption, reports):
            change, refusals = _estimate_change(case, source, walk)
            reports += refusals
    outcome = RIGHT if _is_right(corruption, reports) else OTHER if reports else SILENT
    return Trial(
        corruption=case.corruption,
        form=case.form,
        number=case.number,
        what=what,
        outcome=outcome,
        change=change,
        reports=tuple(reports),
    )


def list_reports(source: Source) -> list[Finding]:
    """What opening and checking a recording reports: errors and warnings, without the path of its folder."""
    try:
        recording = open_any(source.path, lenient=True, options=source.options)
        findings = list(check_recording(recording).findings)
    except StrideTwinError as error:
        findings = [Finding(topic="", what=line) for line in str(error).split("\n")]
    folder = str(source.path.parent)
    return [replace(finding, what=finding.what.replace(folder, "")) for finding in findings]


def list_clean_reports(form: str, walk: Path) -> list[Finding]:
    """Reports on a good walk in a format, such as assumptions."""
    with tempfile.TemporaryDirectory() as folder:
        return list_reports(FORMATS[form].write(Path(folder), load_walk(walk)))


def _without_numbers(text: str) -> str:
    """A report with its numbers left out, by which it is recognised."""
    return re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", text)


def _is_right(corruption: Corruption, reports: Sequence[str]) -> bool:
    """Whether one of some reports names the cause, and not only what could not be judged."""
    return any(corruption.is_named_by(text) for text in reports if not _UNKNOWN.search(text))


# --- estimates ---


@dataclass(frozen=True, kw_only=True, eq=False)
class _Estimates:
    """What is estimated from a recording; None where the format does not allow it, or the estimator refuses.

    Attributes:
        path: Of the foot or the head.
        ground: Around the head.
        refusals: Errors of the estimators.
    """

    path: Trajectory | None
    ground: GroundGrid | None
    refusals: tuple[str, ...]


def _estimate(form: str, source: Source) -> _Estimates:
    """All estimates that a format allows."""
    has = FORMATS[form].has
    refusals: list[str] = []
    try:
        recording = open_any(source.path, lenient=True, options=source.options)
    except StrideTwinError as error:
        return _Estimates(path=None, ground=None, refusals=(str(error),))
    path: Trajectory | None = None
    ground: GroundGrid | None = None
    if FORMATS[form].body == "foot":
        path = _try(follow_foot, recording, refusals)
    elif "imu" in has:
        path = _try(follow_head, recording, refusals)
    if "depth" in has:
        has_truth = FORMATS[form].family in ("tum", "7scenes")
        ground = _try(lambda r: map_ground(r, has_truth=has_truth), recording, refusals)
    return _Estimates(path=path, ground=ground, refusals=tuple(refusals))


EstimateT = TypeVar("EstimateT")


def _try(estimate: Callable[[Recording], EstimateT], recording: Recording, refusals: list[str]) -> EstimateT | None:
    """An estimate; None if it is refused, which is added to the refusals."""
    try:
        return estimate(recording)
    except StrideTwinError as error:
        refusals.append(str(error).replace(str(recording.path.parent), ""))
        return None


@lru_cache(maxsize=8)
def _estimate_clean(form: str, walk: Path) -> _Estimates:
    """Estimates from a good walk in a format."""
    with tempfile.TemporaryDirectory() as folder:
        return _estimate(form, FORMATS[form].write(Path(folder), load_walk(walk)))


def _estimate_change(case: Case, source: Source, walk: Walk) -> tuple[float | None, list[str]]:
    """Largest change of an estimate against the good recording, and new errors of estimators."""
    clean, corrupted = _estimate_clean(case.form, case.walk), _estimate(case.form, source)
    changes: list[float] = []
    if clean.path is not None and corrupted.path is not None:
        changes.append(compare_paths(corrupted.path, clean.path, walk.length_m))
    if clean.ground is not None and corrupted.ground is not None:
        changes.append(compare_ground(corrupted.ground, clean.ground))
    refusals = [text for text in corrupted.refusals if text not in clean.refusals]
    return max(changes, default=None), refusals
