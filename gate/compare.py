"""Compares scores with a baseline: which estimator has become significantly worse?"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.gate.bootstrap import BootstrapResult, compare_groups, compare_pairs, holm_correct
from stridetwin.gate.metric_policy import ARITHMETIC, OVERALL, Scale, scale_of
from stridetwin.gate.score_table import EVERY_ESTIMATOR, ScoreTable
from stridetwin.outputs.base import CLAIM, ERROR, Scores
from stridetwin.outputs.coverage import COVERAGE, ENOUGH_PCT
from stridetwin.streams.errors import ConfigError, check_type
from stridetwin.streams.samples import Array

MIN_WALKS = 8
"""Fewer walks have too few distinct resamples for a significance level of 1 % over sixty scores."""
ENOUGH_WALKS = 30
"""Fewer walks reveal only large changes: thirty find most of 5 to 20 % (docs/gate.md, "Measured")."""
PAIRED, UNPAIRED, TOLERANCE = "paired", "unpaired", "tolerance"
"""How a score is compared: walk by walk, as two groups of walks, or by its mean and a tolerance, without a test."""
SAME, WORSE, BETTER, MISSING, NEW = "same", "worse", "better", "missing", "new"
"""Verdicts on a score: MISSING is only in the baseline, NEW only in the current scores."""
_MAX_DRAWS = 2_000_000  # largest number of resamples; a level that needs more is refused
_NO_SPREAD = 1e-9  # a standard deviation of losses up to this is none
WALKS = "walks"
"""Metric name of the line with the number of walks on which an estimator could be scored."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What counts as a regression: how sure, how large, and what holds with too few walks.

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
    """One score against its baseline: values, change, test and verdict.

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
        near_miss: The verdict is SAME, but the whole 95 % interval is worse than the baseline: further walks decide.
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
    near_miss: bool = False

    @property
    def regressed(self) -> bool:
        """Whether the gate fails because of this line: the score has become worse, or is missing."""
        return self.verdict in (WORSE, MISSING)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All scores against their baselines, sorted by estimator and score.

    Attributes:
        description: How the scores were compared, as text: in pairs, as groups or by tolerance, over how many walks.
        lines: One line per estimator and score.
    """

    description: str
    lines: Sequence[Line]

    @property
    def regressions(self) -> list[Line]:
        """The lines for which the gate fails."""
        return [line for line in self.lines if line.regressed]

    @property
    def near_misses(self) -> list[Line]:
        """The lines that seem worse, without proof (`Line.near_miss`)."""
        return [line for line in self.lines if line.near_miss]

    @property
    def tested_walks(self) -> int:
        """Largest number of walks of a statistical test; 0 if means alone were compared."""
        return max((line.walks for line in self.lines if line.p is not None), default=0)


def check_level(baseline: ScoreTable, rules: Rules) -> None:
    """Checks, before anything is scored, that a regression from this baseline is detectable at this level.

    Raises:
        ConfigError: Too many scores for the level; the message gives the smallest valid level.
    """
    # the number of scores that are tested follows from the baseline alone, so no current walks are given
    score_count = len(_score_columns(list(baseline.walks.values()), [], ()))
    # with fewer than MIN_WALKS there is no test, and hence no limit
    if len(baseline.walks) >= MIN_WALKS and _draw_count(score_count, rules.level) > _MAX_DRAWS:
        # smallest level whose number of resamples is allowed, in %, rounded up to four decimals: 1e6 = 100 % · 1e4
        min_level = math.ceil(1e6 * _draw_count(score_count, 1.0) / _MAX_DRAWS) / 1e4
        valid = f"{min_level:g} or more, with the {score_count} scores of this baseline"
        raise ConfigError("command line", "--false-alarms", float(f"{100.0 * rules.level:g}"), valid)


def _draw_count(score_count: int, level: float) -> int:
    """Number of resamples with which a test can reach half of the level after correction: 4 × scores / level.

    The smallest p-value of a test is 1 / (resamples + 1). The correction multiplies it by up to the number of scores
    (Holm), and by 2, because composites and scores share the level (`_correct_p_values`).
    """
    return math.ceil(4.0 * score_count / level)


def compare_scores(now: ScoreTable, baseline: ScoreTable, rules: Rules) -> Comparison:
    """Compares every gated score of the baseline, and the composite of each estimator's errors, with the current ones.

    Walks in both tables are compared in pairs. With fewer than `MIN_WALKS` of these, the two groups of walks are
    compared; with too few of them, the means are compared by the tolerance.

    Scores that fewer than `MIN_WALKS` walks have are compared by their means and the tolerance, too. What is covered of
    the same walks is compared without a test, as it does not vary by chance. An estimator
    that the baseline lacks gets a line with the verdict NEW.

    Raises:
        ConfigError: The baseline has too many scores for the level, see `check_level`.
    """
    for name, scores in (("now", now), ("baseline", baseline)):
        check_type("compare_scores", name, scores, ScoreTable, "a ScoreTable, such as read_table(FILE)")
    check_level(baseline, rules)
    shared = [key for key in baseline.walks if key in now.walks]  # keys of the walks in both tables
    smaller_count = min(len(baseline.walks), len(now.walks))
    # `before` and `after`: for each compared walk, its scores by estimator; in the same order if compared in pairs
    if len(shared) >= MIN_WALKS:
        method, how = PAIRED, f"{len(shared)} walks in both tables, compared in pairs"
        unpaired_count = len(baseline.walks) + len(now.walks) - 2 * len(shared)
        how += f"; {unpaired_count} walks in only one table are left out" if unpaired_count else ""
        before, after = ([side.walks[key] for key in shared] for side in (baseline, now))
    else:
        before, after = list(baseline.walks.values()), list(now.walks.values())
        method = UNPAIRED if smaller_count >= MIN_WALKS else TOLERANCE
        counts = f"{_walk_count(baseline)} of the baseline, {len(now.walks)} now"
        how = f"{counts}, {len(shared)} of them equal: compared as groups"
        if method == TOLERANCE:
            how = (
                f"{counts}: fewer than {MIN_WALKS}, too few for statistics; "
                f"means may be worse by {100 * rules.tolerance:g} %"
            )
    lines = _find_missing(now, baseline, shared, method)
    # estimators that now give no score on any walk: their single line says so, and their scores are not compared
    gone = {line.estimator for line in lines if line.now == 0}
    columns = _score_columns(before, after, gone)
    # what was covered of the same walks is compared without a test, as it does not vary by chance
    paired_coverage = [c for c in columns if method == PAIRED and c.metric == COVERAGE.name and c.count(method)]
    lines += [_compare_coverage(column, rules) for column in paired_coverage]
    testable = [
        column
        for column in columns
        if method != TOLERANCE and column not in paired_coverage and column.count(method) >= MIN_WALKS
    ]
    if method != TOLERANCE:
        lines += _compare_over_walks([*testable, *_composite_columns(columns)], method, rules)
    tested = {(name, column.metric) for column in [*testable, *paired_coverage] for name in column.members}
    # the baseline's means of all scores that are not compared yet
    means = {
        name: {metric: mean for metric, mean in scores.items() if (name, metric) not in tested}
        for name, scores in baseline.means.items()
        if name not in gone
    }
    lines += _compare_means(now.means, means, rules)
    lines += [
        Line(estimator=name, metric=WALKS, method=method, walks=len(now.walks), verdict=NEW)
        for name in now.means
        if name not in baseline.means
    ]
    return Comparison(description=how, lines=sorted(lines, key=_sort_key))


def _walk_count(table: ScoreTable) -> str:
    """Number of walks of a table with its unit, such as `12 walks`."""
    return f"{len(table.walks)} walk{'s' if len(table.walks) != 1 else ''}"


def _sort_key(line: Line) -> tuple[str, bool, bool, str]:
    """Order of the lines: by estimator; its number of walks first, then the composite, then scores by name.

    False sorts before True, so a line for which `!=` is False comes first.
    """
    return line.estimator, line.metric != WALKS, line.metric != OVERALL, line.metric


@dataclass(frozen=True, kw_only=True, eq=False)
class _ScoreColumn:
    """The losses of one score on every walk, means over the feet of one estimator.

    Attributes:
        estimator: Its name without the foot.
        members: Names of the estimator in the scores: one, or those of both feet.
        metric: Name of the score.
        scale: Scale of its losses.
        before: (walks,) losses of the baseline, NaN where the score is missing.
        now: (walks,) current losses.
    """

    estimator: str
    members: Sequence[str]
    metric: str
    scale: Scale
    before: Array
    now: Array

    def finite_losses(self, method: str) -> tuple[Array, Array]:
        """The losses before and now without the missing ones.

        For PAIRED only walks that have both are kept, so that both arrays have the same walks. Otherwise each side
        loses only its own missing values.
        """
        had, has = np.isfinite(self.before), np.isfinite(self.now)
        if method == PAIRED:
            had = has = had & has
        return self.before[had], self.now[has]

    def count(self, method: str) -> int:
        """Number of walks with a loss: of both sides for PAIRED, else on the side with fewer."""
        return min(map(len, self.finite_losses(method)))


ScoresPerWalk = Sequence[Mapping[str, Scores]]


def _score_columns(before: ScoresPerWalk, now: ScoresPerWalk, gone: Iterable[str]) -> list[_ScoreColumn]:
    """A column for each gated score of the baseline; scores that only describe a walk have no scale, and no column.

    Args:
        before: Scores of each walk of the baseline, by estimator.
        now: Current scores of each walk.
        gone: Estimators without any current score, which get no column.
    """
    names = sorted({name for walk in before for name in walk} - set(gone))
    columns = []
    for estimator, members in _group_feet(names).items():
        metrics = {metric for walk in before for name in members for metric in walk.get(name, {})}
        for metric in sorted(metrics):
            if (scale := scale_of(metric)) is not None:
                # (walks,) losses before and now, means over the feet, NaN where the score is missing
                losses_before, losses_now = (
                    np.mean([_losses(walks, name, metric, scale) for name in members], axis=0)
                    for walks in (before, now)
                )
                columns.append(
                    _ScoreColumn(
                        estimator=estimator,
                        members=members,
                        metric=metric,
                        scale=scale,
                        before=losses_before,
                        now=losses_now,
                    )
                )
    return columns


def _losses(walks: ScoresPerWalk, name: str, metric: str, scale: Scale) -> Array:
    """(walks,) losses of one score of one estimator, NaN where a walk lacks it."""
    values = (walk.get(name, {}).get(metric) for walk in walks)
    return np.array([np.nan if value is None else scale.loss(value) for value in values])


def _group_feet(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Estimators with their names in the scores.

    `NAME_l` and `NAME_r` together become the estimator NAME with both of these names, unless another estimator is
    called NAME. Every other name is an estimator with this one name.
    """
    groups: dict[str, tuple[str, ...]] = {}
    for name in names:
        stem = name.removesuffix("_l").removesuffix("_r")
        feet = (f"{stem}_l", f"{stem}_r")
        if name in feet and set(feet) <= set(names) and stem not in names:
            groups[stem] = feet
        else:
            groups[name] = (name,)
    return groups


def _composite_columns(columns: Sequence[_ScoreColumn]) -> list[_ScoreColumn]:
    """A composite column `OVERALL` for each estimator: the mean loss of its errors, with weights 1 / spread over walks.

    Only walks and errors without a missing value count; the spread is the standard deviation over the baseline's walks.
    An estimator with fewer than two such errors, or with fewer than `MIN_WALKS` walks, gets no composite.

    As a loss is a logarithm, this is a weighted geometric mean of errors, in which errors of low spread count more.
    Weights come from the baseline alone, so that a change does not affect its own weight.
    """
    composites = []
    for name in dict.fromkeys(c.estimator for c in columns):
        errors = [c for c in columns if c.estimator == name and c.scale.kind == ERROR]
        if not errors:
            continue
        before, now = np.array([c.before for c in errors]), np.array([c.now for c in errors])  # (errors, walks)
        # (errors, walks) without the walks on which the estimator has no error at all
        had, has = (side[:, np.isfinite(side).any(axis=0)] for side in (before, now))
        if min(had.shape[1], has.shape[1]) < MIN_WALKS:
            continue
        spread = np.std(had, axis=1)  # (errors,) over the baseline's walks
        # errors with a value on every walk and different values: only these enter the composite
        is_complete = np.isfinite(had).all(axis=1) & np.isfinite(has).all(axis=1) & (spread > _NO_SPREAD)
        if is_complete.sum() >= 2:
            weights = 1.0 / spread[is_complete]
            # (walks,) weighted mean losses before and now
            mean_before, mean_now = (weights @ side[is_complete] / weights.sum() for side in (before, now))
            # estimator and names are those of any of its errors
            composites.append(
                replace(errors[0], metric=OVERALL, scale=Scale(kind=ERROR), before=mean_before, now=mean_now)
            )
    return composites


def _compare_over_walks(columns: Sequence[_ScoreColumn], method: str, rules: Rules) -> list[Line]:
    """Tests each column over the walks and gives one line per column.

    p-values are corrected by Holm's method, separately for composites and scores (`_correct_p_values`). A paired score
    that is equal on every walk is not tested and keeps the verdict SAME.

    Args:
        columns: Scores and composites with enough walks.
        method: PAIRED or UNPAIRED.
        rules: Level and least change.
    """
    lines = []
    # lines as of scores that are equal before and now; those of tested scores are replaced below
    for column in columns:
        # mean losses as values of the score, before and now
        baseline, current = (column.scale.value(float(side.mean())) for side in column.finite_losses(method))
        if column.metric == OVERALL:  # its errors have several units: only the ratio has a meaning
            baseline, current = 1.0, current / baseline
        lines.append(
            Line(
                estimator=column.estimator,
                metric=column.metric,
                method=method,
                walks=column.count(method),
                baseline=baseline,
                now=current,
                change=0.0,
                low=0.0,
                high=0.0,
                p=1.0,
                in_points=column.scale.in_points,
                mean=column.scale.mean,
                absolute=column.scale.signed,
            )
        )
    # numbers of the columns to test: a paired score that is equal on every walk cannot have become worse and does not
    # count as a comparison
    changed = [i for i, c in enumerate(columns) if method == UNPAIRED or np.nanmax(np.abs(c.now - c.before)) > 0.0]
    if not changed:
        return lines
    # (walks, tested scores) losses on both sides
    before = np.column_stack([columns[i].before for i in changed])
    now = np.column_stack([columns[i].now for i in changed])
    is_composite = np.array([columns[i].metric == OVERALL for i in changed])
    # composites and scores are corrected apart: the larger of the two families needs the most resamples
    draws = _draw_count(int(max(is_composite.sum(), (~is_composite).sum())), rules.level)
    result = compare_pairs(now - before, draws) if method == PAIRED else compare_groups(before, now, draws)
    # a larger loss is worse
    p_worse, p_better = (_correct_p_values(p, is_composite) for p in (result.p_above, result.p_below))
    for k, i in enumerate(changed):  # k: number among the tested columns, i: among all
        p_of_line = float(p_worse[k]), float(p_better[k])
        lines[i] = _with_verdict(lines[i], columns[i].scale, result, k, p_of_line, rules)
    return lines


def _compare_coverage(column: _ScoreColumn, rules: Rules) -> Line:
    """The line of what was covered of the same walks: worse if the mean, or a walk that was covered, has lost.

    Args:
        column: Shares of walks, of which at least one is on both sides.
        rules: The least change, in percentage points.
    """
    before, now = (-losses for losses in column.finite_losses(PAIRED))  # losses of shares are negative
    baseline, current = float(before.mean()), float(now.mean())
    has_lost_walk = bool(np.any((before >= ENOUGH_PCT) & (now < ENOUGH_PCT) & (before - now > rules.least)))
    is_worse = baseline - current > rules.least or has_lost_walk
    is_better = current - baseline > rules.least and not is_worse
    return Line(
        estimator=column.estimator,
        metric=column.metric,
        method=PAIRED,
        walks=len(before),
        verdict=WORSE if is_worse else BETTER if is_better else SAME,
        baseline=baseline,
        now=current,
        change=current - baseline,
        limit=baseline - rules.least,
        in_points=True,
        mean=ARITHMETIC,
    )


def _correct_p_values(p: Array, is_composite: NDArray[np.bool_]) -> Array:
    """(N,) p-values corrected by Holm's method: half of the level goes to the few composites, half to the scores.

    Args:
        p: (N,) p-values of composites and scores.
        is_composite: (N,) which of them are of composites.
    """
    corrected = np.empty(len(p))
    for part in (is_composite, ~is_composite):
        # times 2: each of the two families has half of the level
        corrected[part] = np.minimum(2.0 * holm_correct(p[part]), 1.0)
    return corrected


def _with_verdict(
    line: Line, scale: Scale, result: BootstrapResult, k: int, p: tuple[float, float], rules: Rules
) -> Line:
    """The line of a score with its change, interval, p-value and verdict.

    A significant change (p up to the level) of more than `Rules.least` is WORSE or BETTER; a claim is never BETTER.
    Another change of more than `Rules.least` for the worse whose 95 % interval excludes 0 is a near miss.

    Args:
        line: The line without verdict.
        scale: Scale of the score.
        result: Test of all columns.
        k: Number of the score's column in the result.
        p: Corrected p-values of a change for the worse and for the better.
        rules: Level and least change.
    """
    p_worse, p_better = p
    mean = float(result.mean[k])  # mean loss now minus before: above 0 is worse
    # where more is better, the change has the other sign than the loss, and the ends change places
    low, high = sorted(scale.change(float(end)) for end in (result.low[k], result.high[k]))
    verdict = SAME
    if p_worse <= rules.level and scale.worse_by(mean) > rules.least:
        verdict = WORSE
    elif p_better <= rules.level and -scale.worse_by(mean) > rules.least and scale.kind != CLAIM:
        verdict = BETTER
    near_miss = verdict == SAME and result.low[k] > 0.0 and scale.worse_by(mean) > rules.least
    return replace(
        line, verdict=verdict, change=scale.change(mean), low=low, high=high, p=p_worse, near_miss=bool(near_miss)
    )


def _find_missing(now: ScoreTable, baseline: ScoreTable, shared: Sequence[str], method: str) -> list[Line]:
    """A line for each estimator that no longer gives scores on walks on which it did.

    PAIRED compares the walks in both tables. Otherwise an estimator without failures in the baseline must not fail on
    any current walk, and every estimator of the baseline must have a mean. A line has both numbers of walks: on which
    the estimator should give scores, and on which it does.

    Args:
        now: Current scores.
        baseline: Scores of the baseline.
        shared: Keys of the walks in both tables.
        method: PAIRED, UNPAIRED or TOLERANCE.
    """
    lines = []
    # `had`: walks on which the estimator should give scores; `has`: those on which it does
    for name in sorted(baseline.means):
        if method == PAIRED:
            had = [key for key in shared if name in baseline.walks[key]]
            has = [key for key in had if name in now.walks[key]]
        else:
            # a failure of the estimator is listed under its own name or that of all
            names = {name, EVERY_ESTIMATOR}
            failed_walks = {key for key, failed in now.failed.items() if failed.keys() & names}
            had_no_failure = not any(failed.keys() & names for failed in baseline.failed.values())
            has = [key for key, walk in now.walks.items() if name in walk]
            had = [*has, *failed_walks] if had_no_failure else has
            if name not in now.means:  # it gives nothing now: its line counts at least one walk, if only the mean
                had, has = had or list(baseline.walks) or ["the mean"], []
        if len(has) < len(had):
            lines.append(
                Line(
                    estimator=name,
                    metric=WALKS,
                    method=method,
                    walks=len(had),
                    verdict=MISSING,
                    baseline=float(len(had)),
                    now=float(len(has)),
                )
            )
    return lines


def _compare_means(now: Mapping[str, Scores], baseline: Mapping[str, Scores], rules: Rules) -> list[Line]:
    """Lines of means over walks, for scores that too few walks have.

    A mean is WORSE if it exceeds the baseline's by the tolerance (of what is covered, by `Rules.least`) and by rounding
    differences between machines (`Scale.slack`); a score that is gone is MISSING.

    Args:
        now: Current means by estimator.
        baseline: Means of the baseline that are compared, by estimator.
        rules: The tolerance.
    """
    lines = []
    for name, scores in baseline.items():
        for metric, value in scores.items():
            scale, current = scale_of(metric), now.get(name, {}).get(metric)
            # descriptive scores are not gated; signed scores and claims must only exist, as their means say nothing
            if scale is None or (scale.by_walks_only and current is not None):
                continue
            line = Line(
                estimator=name,
                metric=metric,
                method=TOLERANCE,
                walks=0,
                baseline=value,
                verdict=MISSING,
                in_points=scale.in_points,
                mean=ARITHMETIC,
            )
            if current is not None:  # otherwise the line stays MISSING
                # what is covered varies little between walks: the least change counts
                tolerance = rules.least if metric == COVERAGE.name else abs(value) * rules.tolerance
                allowance = tolerance + scale.slack
                limit = value - allowance if scale.higher_is_better else value + allowance
                worse = current < limit if scale.higher_is_better else current > limit
                if scale.in_points:
                    change: float | None = current - value
                else:  # in %, which a baseline of 0 does not allow
                    change = 100.0 * (current / value - 1.0) if value else None
                line = replace(line, limit=limit, now=current, change=change, verdict=WORSE if worse else SAME)
            lines.append(line)
    return lines
