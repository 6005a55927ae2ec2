"""Compares scores with a baseline: which estimator has become significantly worse?"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.gate.bootstrap import Tested, holm, paired, unpaired
from stridetwin.gate.metric_policy import ARITHMETIC, OVERALL, Scale, scale_of
from stridetwin.gate.score_table import EVERY, ScoreTable
from stridetwin.outputs.base import CLAIM, ERROR, Scores
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

LEAST_WALKS = 8
"""Fewer walks have too few distinct resamples for a significance level of 1 % over sixty scores."""
PAIRED, UNPAIRED, TOLERANCE = "paired", "unpaired", "tolerance"
SAME, WORSE, BETTER, MISSING, NEW = "same", "worse", "better", "missing", "new"
_MOST_DRAWS = 2_000_000
_NO_SPREAD = 1e-9
WALKS = "walks"
"""Metric name of the line with the number of walks on which an estimator could be scored."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """When a change is a regression.

    Attributes:
        level: Probability of any false alarm, 0-1.
        least: Smaller changes are ignored; in % of an error, or percentage points of a share.
        tolerance: Share by which a mean may be worse if there are too few walks, 0.1 = 10 %.
    """

    level: float = 0.01
    least: float = 1.0
    tolerance: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Line:
    """One score against its baseline.

    Attributes:
        estimator: Its name; `NAME_l` and `NAME_r` of the two feet become NAME, with means over both.
        metric: Name of the score, `OVERALL` or `WALKS`.
        method: PAIRED, UNPAIRED or TOLERANCE.
        walks: Number of walks with this score; of two groups the smaller one.
        verdict: SAME, WORSE, BETTER, MISSING or NEW.
        baseline: Baseline value, over the walks that have it.
        now: Current value.
        change: From baseline to now, in % or percentage points.
        low: Lower end of the change's 95 % interval.
        high: Upper end.
        p: p-value of a change for the worse, corrected for the number of scores.
        limit: Worst mean that passes, where the tolerance decides.
        in_points: The change is in percentage points.
        mean: ARITHMETIC or GEOMETRIC mean over walks; None for a number of walks.
        absolute: Values are means of absolute values of a signed score.
    """

    estimator: str
    metric: str
    method: str
    walks: int
    verdict: str = SAME
    baseline: float | None = None
    now: float | None = None
    change: float | None = None
    low: float | None = None
    high: float | None = None
    p: float | None = None
    limit: float | None = None
    in_points: bool = False
    mean: str | None = None
    absolute: bool = False

    @property
    def regressed(self) -> bool:
        """Whether the gate fails because of it."""
        return self.verdict in (WORSE, MISSING)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All scores against their baselines, by estimator and score; `words` give the method of comparison."""

    words: str
    lines: Sequence[Line]

    @property
    def regressions(self) -> list[Line]:
        """The lines for which the gate fails."""
        return [line for line in self.lines if line.regressed]


def check_level(baseline: ScoreTable, rules: Rules) -> None:
    """Checks, before anything is scored, that a regression from this baseline is detectable at this level.

    Raises:
        ConfigError: Too many scores for the level; the message gives the smallest valid level.
    """
    scores = len(_columns(list(baseline.walks.values()), [], ()))
    if len(baseline.walks) >= LEAST_WALKS and _draws(scores, rules.level) > _MOST_DRAWS:
        least = math.ceil(1e6 * _draws(scores, 1.0) / _MOST_DRAWS) / 1e4
        valid = f"{least:g} or more, with the {scores} scores of this baseline"
        raise ConfigError("command line", "--false-alarms", float(f"{100.0 * rules.level:g}"), valid)


def _draws(scores: int, level: float) -> int:
    """Number of resamples that resolves half of the level after `_corrected`, for this number of scores."""
    return math.ceil(4.0 * scores / level)


def compare_scores(now: ScoreTable, baseline: ScoreTable, rules: Rules) -> Comparison:
    """Compares every gated score of the baseline, and the composite of each estimator's errors, with the current ones.

    Walks in both tables are compared in pairs. With fewer than `LEAST_WALKS` of these, the two groups of walks are
    compared; with too few of them, the means are compared by the tolerance.

    Raises:
        ConfigError: As `check_level`.
    """
    check_level(baseline, rules)
    shared = [key for key in baseline.walks if key in now.walks]
    few = min(len(baseline.walks), len(now.walks))
    if len(shared) >= LEAST_WALKS:
        method, words = PAIRED, f"{len(shared)} walks in both tables, compared in pairs"
        others = len(baseline.walks) + len(now.walks) - 2 * len(shared)
        words += f"; {others} walks in only one table are left out" if others else ""
        before, after = ([side.walks[key] for key in shared] for side in (baseline, now))
    else:
        before, after = list(baseline.walks.values()), list(now.walks.values())
        method = UNPAIRED if few >= LEAST_WALKS else TOLERANCE
        counts = f"{_counted(baseline)} of the baseline, {len(now.walks)} now"
        words = f"{counts}, {len(shared)} of them equal: compared as groups"
        if method == TOLERANCE:
            words = (
                f"{counts}: fewer than {LEAST_WALKS}, too few for statistics; "
                f"means may be worse by {100 * rules.tolerance:g} %"
            )
    lines = _lost(now, baseline, shared, method)
    gone = {line.estimator for line in lines if line.now == 0}
    columns = _columns(before, after, gone)
    enough = [c for c in columns if method != TOLERANCE and c.count(method) >= LEAST_WALKS]
    if method != TOLERANCE:
        lines += _tested_by_walks([*enough, *_composites(columns)], method, rules)
    tested = {(name, c.metric) for c in enough for name in c.members}
    means = {
        name: {m: v for m, v in scores.items() if (name, m) not in tested}
        for name, scores in baseline.means.items()
        if name not in gone
    }
    lines += _tolerated(now.means, means, rules)
    lines += [
        Line(estimator=name, metric=WALKS, method=method, walks=len(now.walks), verdict=NEW)
        for name in now.means
        if name not in baseline.means
    ]
    return Comparison(words=words, lines=sorted(lines, key=_order))


def _counted(table: ScoreTable) -> str:
    return f"{len(table.walks)} walk{'s' if len(table.walks) != 1 else ''}"


def _order(line: Line) -> tuple[str, bool, bool, str]:
    return line.estimator, line.metric != WALKS, line.metric != OVERALL, line.metric


@dataclass(frozen=True, kw_only=True, eq=False)
class _Column:
    """The losses of one score, (walks,) each, NaN where it is missing; means over the feet of one estimator."""

    estimator: str
    members: Sequence[str]
    metric: str
    scale: Scale
    before: Array
    now: Array

    def known(self, method: str) -> tuple[Array, Array]:
        """The losses before and now, of the walks that have them; PAIRED: of those that have both."""
        had, has = np.isfinite(self.before), np.isfinite(self.now)
        if method == PAIRED:
            had = has = had & has
        return self.before[had], self.now[has]

    def count(self, method: str) -> int:
        """Number of walks that have it; of two groups the smaller one."""
        return min(map(len, self.known(method)))


Walks = Sequence[Mapping[str, Scores]]


def _columns(before: Walks, now: Walks, gone: Iterable[str]) -> list[_Column]:
    names = sorted({name for walk in before for name in walk} - set(gone))
    found = []
    for estimator, members in _estimators(names).items():
        for metric in sorted({m for walk in before for name in members for m in walk.get(name, {})}):
            if (scale := scale_of(metric)) is not None:
                b, n = (
                    np.mean([_losses(walks, name, metric, scale) for name in members], axis=0)
                    for walks in (before, now)
                )
                found.append(_Column(estimator=estimator, members=members, metric=metric, scale=scale, before=b, now=n))
    return found


def _losses(walks: Walks, name: str, metric: str, scale: Scale) -> Array:
    values = (walk.get(name, {}).get(metric) for walk in walks)
    return np.array([np.nan if value is None else scale.loss(value) for value in values])


def _estimators(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Estimators and the names under which they are scored; two names if one estimates both feet."""
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        stem = name.removesuffix("_l").removesuffix("_r")
        feet = (f"{stem}_l", f"{stem}_r")
        if name in feet and set(feet) <= set(names) and stem not in names:
            found[stem] = feet
        else:
            found[name] = (name,)
    return found


def _composites(columns: Sequence[_Column]) -> list[_Column]:
    """For each estimator with several errors, their mean, each weighted by its spread over walks.

    A weighted mean of logarithms, that is a weighted geometric mean of errors in which errors of low spread count
    more. Weights come from the baseline alone, so that a change does not affect its own weight.
    """
    found = []
    for name in dict.fromkeys(c.estimator for c in columns):
        errors = [c for c in columns if c.estimator == name and c.scale.kind == ERROR]
        if not errors:
            continue
        before, now = np.array([c.before for c in errors]), np.array([c.now for c in errors])
        had, has = (side[:, np.isfinite(side).any(axis=0)] for side in (before, now))
        if min(had.shape[1], has.shape[1]) < LEAST_WALKS:
            continue
        spread = np.std(had, axis=1)
        whole = np.isfinite(had).all(axis=1) & np.isfinite(has).all(axis=1) & (spread > _NO_SPREAD)
        if whole.sum() >= 2:
            weights = 1.0 / spread[whole]
            b, n = (weights @ side[whole] / weights.sum() for side in (before, now))
            found.append(replace(errors[0], metric=OVERALL, scale=Scale(kind=ERROR), before=b, now=n))
    return found


def _tested_by_walks(columns: Sequence[_Column], method: str, rules: Rules) -> list[Line]:
    """Lines of the scores that enough walks have."""
    lines = []
    for c in columns:
        b, n = (c.scale.value(float(side.mean())) for side in c.known(method))
        if c.metric == OVERALL:  # of several units
            b, n = 1.0, n / b
        lines.append(
            Line(
                estimator=c.estimator, metric=c.metric, method=method, walks=c.count(method), baseline=b, now=n,
                change=0.0, low=0.0, high=0.0, p=1.0, in_points=c.scale.in_points, mean=c.scale.mean,
                absolute=c.scale.signed,
            )
        )  # fmt: skip
    # a score that is equal on every walk cannot have become worse and does not count as a comparison
    moved = [i for i, c in enumerate(columns) if method == UNPAIRED or np.nanmax(np.abs(c.now - c.before)) > 0.0]
    if not moved:
        return lines
    before, now = (np.column_stack(side) for side in zip(*((columns[i].before, columns[i].now) for i in moved)))
    composite = np.array([columns[i].metric == OVERALL for i in moved])
    draws = _draws(int(max(composite.sum(), (~composite).sum())), rules.level)
    tested = paired(now - before, draws) if method == PAIRED else unpaired(before, now, draws)
    worse, better = (_corrected(p, composite) for p in (tested.p_above, tested.p_below))
    for k, i in enumerate(moved):
        lines[i] = _verdict(lines[i], columns[i].scale, tested, k, (float(worse[k]), float(better[k])), rules)
    return lines


def _corrected(p: Array, composite: NDArray[np.bool_]) -> Array:
    """Corrected p-values: half of the level goes to the few composites, half to the scores."""
    corrected = np.empty(len(p))
    for part in (composite, ~composite):
        corrected[part] = np.minimum(2.0 * holm(p[part]), 1.0)
    return corrected


def _verdict(line: Line, scale: Scale, tested: Tested, k: int, p: tuple[float, float], rules: Rules) -> Line:
    mean = float(tested.mean[k])
    ends = sorted(scale.change(float(end)) for end in (tested.low[k], tested.high[k]))
    verdict = SAME
    if p[0] <= rules.level and scale.worse_by(mean) > rules.least:
        verdict = WORSE
    elif p[1] <= rules.level and -scale.worse_by(mean) > rules.least and scale.kind != CLAIM:
        verdict = BETTER
    return replace(line, verdict=verdict, change=scale.change(mean), low=ends[0], high=ends[1], p=p[0])


def _lost(now: ScoreTable, baseline: ScoreTable, shared: Sequence[str], method: str) -> list[Line]:
    """Estimators that no longer give scores on walks on which they did."""
    lines = []
    for name in sorted(baseline.means):
        if method == PAIRED:
            had = [key for key in shared if name in baseline.walks[key]]
            has = [key for key in had if name in now.walks[key]]
        else:
            broke = {key for key, failed in now.failed.items() if failed.keys() & {name, EVERY}}
            expected = not any(failed.keys() & {name, EVERY} for failed in baseline.failed.values())
            has = [key for key, walk in now.walks.items() if name in walk]
            had = [*has, *broke] if expected else has
            if name not in now.means:
                had, has = had or list(baseline.walks) or ["the mean"], []
        if len(has) < len(had):
            lines.append(
                Line(
                    estimator=name, metric=WALKS, method=method, walks=len(had), verdict=MISSING,
                    baseline=float(len(had)), now=float(len(has)),
                )
            )  # fmt: skip
    return lines


def _tolerated(now: Mapping[str, Scores], baseline: Mapping[str, Scores], rules: Rules) -> list[Line]:
    """Lines of means, which may be worse by the tolerance and by rounding differences between machines."""
    lines = []
    for name, scores in baseline.items():
        for metric, value in scores.items():
            scale, current = scale_of(metric), now.get(name, {}).get(metric)
            if scale is None or (scale.by_walks_only and current is not None):
                continue
            line = Line(
                estimator=name, metric=metric, method=TOLERANCE, walks=0, baseline=value, verdict=MISSING,
                in_points=scale.in_points, mean=ARITHMETIC,
            )  # fmt: skip
            if current is not None:
                allowance = abs(value) * rules.tolerance + scale.slack
                limit = value - allowance if scale.higher_is_better else value + allowance
                worse = current < limit if scale.higher_is_better else current > limit
                change = current - value if scale.in_points else 100.0 * (current / value - 1.0) if value else None
                line = replace(line, limit=limit, now=current, change=change, verdict=WORSE if worse else SAME)
            lines.append(line)
    return lines
