"""Scores of estimated gait phases against the true touch-downs: circular errors, events, consistency.

The true phase of a leg grows linearly in time from 0 at a touch-down of its foot to 1 at the next one. The initial
footprint of a standing foot is no touch-down. Samples before the first touch-down, after the last one and within a
pause (`Stride.is_pause`) are not counted; all others are, those of the first and last strides and of strides between
level ground, stairs and ramps included.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.estimators.gait_phase import PhaseEstimate
from stridetwin.outputs.base import BAD_SHARE, DESCRIPTIVE, SHARE, Evaluated, Score
from stridetwin.outputs.coverage import COVERAGE, compute_covered_share
from stridetwin.streams.samples import Array, Footprint

TERRAINS = LEVEL, STAIRS, RAMP = ("level", "stairs", "ramp")
LONGEST_STRIDE_S = 2.5
"""In a longer stride the person stands still or stops."""
LONGEST_STRIDE_SHARE = 1.6
"""So they do in one that is longer than the median stride of the foot times this factor."""
STEADY_CHANGE = 0.1
"""A level stride is steady if its time differs from the previous one by less than this share, and it is neither one of
the foot's first two nor its last."""
_TERRAIN_OF_MODE = {"LG": LEVEL, "SA": STAIRS, "SD": STAIRS, "RA": RAMP, "RD": RAMP}
_INTERVAL_95 = 1.96  # standard deviations on each side of the mean that contain 95 % of a normal density

SCORES = (
    Score(name="rmse_pct", heading="phase %", label="Phase, RMS error", unit="% of the cycle"),
    Score(name="rmse_steady_pct", heading="steady %", label="the same in steady walking on the level", unit="%"),
    Score(name="rmse_level_pct", heading="level %", label="the same on the level", unit="%"),
    Score(name="rmse_stairs_pct", heading="stairs %", label="the same onto, on and off stairs", unit="%"),
    Score(name="rmse_ramp_pct", heading="ramps %", label="the same onto, on and off ramps", unit="%"),
    Score(name="p95_pct", label="Phase, 95th percentile of the error", unit="%"),
    Score(name="bias_pct", signed=True, label="Phase, mean error", unit="%"),
    Score(
        name="within_95_pct", scale=SHARE, heading="in 95 %", label="Time within its own 95 % bound", unit="%", digits=1
    ),
    Score(name="not_walking_pct", scale=BAD_SHARE, label="Time without a phase", unit="%", digits=1),
    Score(name="touch_down_error_ms", heading="touch-down ms", label="Touch-downs, mean error", unit="ms", digits=1),
    Score(name="touch_down_bias_ms", signed=True, label="Touch-downs, mean delay", unit="ms", digits=1),
    Score(name="missed", label="Touch-downs that were not detected", digits=0),
    Score(name="extra", label="Detected touch-downs that are none", digits=0),
    Score(name="strides", scale=DESCRIPTIVE, label="Strides", digits=0),
    COVERAGE,
)
"""The scores of one leg's phase; see `phase_scores`."""


@dataclass(frozen=True, kw_only=True)
class Stride:
    """One true stride of a foot, from one touch-down to the next.

    Attributes:
        begin_ns: Touch-down that begins it, ns.
        end_ns: Touch-down that ends it, ns.
        begin_mode: Mode of the step that ended with that touch-down: LG, SA, SD, RA or RD.
        end_mode: Mode of the one that ends with this stride.
        is_pause: The person stands still in it, so that it has no phase.
        is_steady: A level stride of a steady walk, see `STEADY_CHANGE`.
    """

    begin_ns: int
    end_ns: int
    begin_mode: str = "LG"
    end_mode: str = "LG"
    is_pause: bool = False
    is_steady: bool = False

    @property
    def terrain(self) -> str:
        """One of `TERRAINS`: stairs if it begins or ends on a stair, else ramp if it does on a ramp, else level."""
        terrains = {_TERRAIN_OF_MODE[self.begin_mode], _TERRAIN_OF_MODE[self.end_mode]}
        return next(name for name in (STAIRS, RAMP, LEVEL) if name in terrains)


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseSeries:
    """Estimates of one leg as columns.

    Attributes:
        foot: `l` or `r`.
        t_ns: (N,) times, ns, increasing.
        phase: (N,) in [0, 1).
        phase_sd: (N,) standard deviations, shares of the cycle.
        rate: (N,) expected cycles per second.
        walking: (N,) whether the estimator claims a phase.
        swing: (N,) whether the foot is in the air.
        touch_down_ns: (N,) time of the last detected touch-down, ns; -1 before the first.
    """

    foot: str
    t_ns: NDArray[np.int64]
    phase: Array
    phase_sd: Array
    rate: Array
    walking: NDArray[np.bool_]
    swing: NDArray[np.bool_]
    touch_down_ns: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluatedPhases(Evaluated[PhaseSeries]):
    """Phases of one leg beside the truth.

    Attributes:
        strides: The true strides of the foot.
    """

    strides: Sequence[Stride]


def to_phase_series(estimates: Sequence[PhaseEstimate], foot: str) -> PhaseSeries:
    """Estimates of one foot, `l` or `r`, as columns."""
    return PhaseSeries(
        foot=foot,
        t_ns=np.array([e.t_ns for e in estimates], np.int64),
        phase=np.array([e.phase for e in estimates], float),
        phase_sd=np.array([e.phase_sd for e in estimates], float),
        rate=np.array([e.rate for e in estimates], float),
        walking=np.array([e.walking for e in estimates], bool),
        swing=np.array([e.swing for e in estimates], bool),
        touch_down_ns=np.array([e.touch_down_ns for e in estimates], np.int64),
    )


def true_strides(footprints: Iterable[Footprint], foot: str) -> list[Stride]:
    """The strides of one foot, `l` or `r`, in order; its first footprint is where it stood at the beginning."""
    landed = [p for p in footprints if p.foot == foot][1:]
    durations = np.diff([p.t_ns for p in landed])  # (strides,) ns
    if not len(durations):
        return []
    # a longer stride is a pause
    longest_ns = min(1e9 * LONGEST_STRIDE_S, LONGEST_STRIDE_SHARE * float(np.median(durations)))
    strides = []
    for i, (before, after) in enumerate(pairwise(landed)):
        stride = Stride(
            begin_ns=before.t_ns,
            end_ns=after.t_ns,
            begin_mode=before.mode,
            end_mode=after.mode,
            is_pause=bool(durations[i] > longest_ns),
        )
        # neither one of the first two strides nor the last one, and about as long as the previous one
        is_even = 1 < i < len(durations) - 1 and abs(durations[i] / durations[i - 1] - 1.0) < STEADY_CHANGE
        strides.append(replace(stride, is_steady=bool(stride.terrain == LEVEL and is_even)))
    return strides


def true_phase(t_ns: ArrayLike, stride: Stride) -> Array:
    """(N,) true phase at times (N,) ns within a stride, 0 to 1: (t - begin) / (end - begin)."""
    return (np.asarray(t_ns, dtype=np.int64) - stride.begin_ns) / (stride.end_ns - stride.begin_ns)


def circular_difference(phase: ArrayLike, reference: ArrayLike) -> Array:
    """(N,) phase minus reference as shares of the cycle, in [-0.5, 0.5): 0.99 against 0.01 is -0.02."""
    return (np.subtract(phase, reference) + 0.5) % 1.0 - 0.5


def find_touch_downs(series: PhaseSeries) -> NDArray[np.int64]:
    """(M,) times of the touch-downs that an estimator detected, ns, in order and without repetition."""
    return np.unique(series.touch_down_ns[series.touch_down_ns >= 0])


def match_touch_downs(detected_ns: ArrayLike, true_ns: ArrayLike, tolerance_s: float = 0.25) -> list[tuple[int, int]]:
    """Matches detected with true touch-downs, nearest pairs first, each used once.

    Args:
        detected_ns: (M,) detected times, ns.
        true_ns: (N,) true times, ns.
        tolerance_s: Largest difference of a pair, s.

    Returns:
        Pairs of indices of detected and true touch-downs, sorted.
    """
    detected, true = np.asarray(detected_ns, dtype=float), np.asarray(true_ns, dtype=float)
    distance_ns = np.abs(detected[:, None] - true[None, :])  # (M, N)
    nearest_first = np.argsort(distance_ns, axis=None, kind="stable")
    rows, columns = np.unravel_index(nearest_first, distance_ns.shape)  # detected and true touch-down of each pair
    used_detected, used_true, pairs = set[int](), set[int](), []
    for i, j in zip(rows.tolist(), columns.tolist()):
        if distance_ns[i, j] > tolerance_s * 1e9:  # all further pairs are farther apart
            break
        if i not in used_detected and j not in used_true:
            used_detected.add(i)
            used_true.add(j)
            pairs.append((i, j))
    return sorted(pairs)


def phase_errors(series: PhaseSeries, stride: Stride) -> tuple[Array, Array]:
    """Circular errors of a stride's samples and their reported standard deviations, both as shares of the cycle.

    A sample without a claimed phase counts as estimated at 0, with the deviation that it reports.

    Args:
        series: Estimates of the foot.
        stride: One of its true strides; the samples from its begin until before its end count.

    Returns:
        (N,) estimated minus true phase, positive if the estimate is ahead, and (N,) standard deviations.
    """
    begin, end = np.searchsorted(series.t_ns, (stride.begin_ns, stride.end_ns))
    errors = circular_difference(series.phase[begin:end], true_phase(series.t_ns[begin:end], stride))
    return errors, series.phase_sd[begin:end]


def phase_scores(series: PhaseSeries, strides: Sequence[Stride]) -> dict[str, float]:
    """Every score of one leg in one walk.

    Returns:
        `rmse_pct`, circular RMS error over all counted samples, % of the cycle; by the terrain of the stride
        `rmse_level_pct`, `rmse_stairs_pct`, `rmse_ramp_pct`, and `rmse_steady_pct` of steady level strides, each where
        there is one; `p95_pct` of the errors' sizes; `bias_pct`; `within_95_pct`, share of errors inside the reported
        95 % interval; `not_walking_pct`, share of counted samples without a claimed phase; `touch_down_error_ms`, mean
        size of the time error of matched touch-downs, and `touch_down_bias_ms`, positive if late; `missed` true
        touch-downs without a detected one within 0.25 s, and `extra` detected ones beyond the true ones between the
        first and the last; `strides` counted; `coverage_pct` of the time from the first to the last
        stride. Empty without a counted stride.
    """
    counted = [s for s in strides if not s.is_pause]
    # each stride with samples, the (N,) errors of these samples and their (N,) standard deviations
    strides_with_errors = [(stride, *phase_errors(series, stride)) for stride in counted]
    rows = [(stride, errors, sds) for stride, errors, sds in strides_with_errors if len(errors)]
    if not rows:
        return {}
    # the samples of all these strides together
    errors = np.concatenate([stride_errors for _, stride_errors, _ in rows])
    sds = np.concatenate([stride_sds for _, _, stride_sds in rows])
    # which samples of the series lie in each of these strides
    ranges = [slice(*np.searchsorted(series.t_ns, (stride.begin_ns, stride.end_ns))) for stride, _, _ in rows]
    walking = np.concatenate([series.walking[samples] for samples in ranges])
    groups: Mapping[str, list[Array]] = {
        **{terrain: [e for stride, e, _ in rows if stride.terrain == terrain] for terrain in TERRAINS},
        "steady": [e for stride, e, _ in rows if stride.is_steady],
    }
    return {
        "rmse_pct": _rms_pct(errors),
        **{f"rmse_{name}_pct": _rms_pct(np.concatenate(group)) for name, group in groups.items() if group},
        "p95_pct": 100.0 * float(np.percentile(np.abs(errors), 95)),
        "bias_pct": 100.0 * float(errors.mean()),
        "within_95_pct": 100.0 * float((np.abs(errors) <= _INTERVAL_95 * sds).mean()),
        "not_walking_pct": 100.0 * float((~walking).mean()),
        **_touch_down_scores(find_touch_downs(series), strides),
        "strides": float(len(rows)),
        COVERAGE.name: 100.0 * compute_covered_share(series.t_ns, strides[0].begin_ns, strides[-1].end_ns),
    }


def _touch_down_scores(detected_ns: NDArray[np.int64], strides: Sequence[Stride]) -> dict[str, float]:
    """Errors of the matched touch-downs, ms, and the numbers of missed and extra ones.

    Args:
        detected_ns: (M,) times of the detected touch-downs, ns.
        strides: True strides of the foot, one or more, in order.

    Returns:
        `missed`: true touch-downs without a detected one; `extra`: detected ones without a true one, from 0.25 s before
        the first true one to 0.25 s after the last; and, with a matched pair, `touch_down_error_ms`, mean size of the
        time errors, and `touch_down_bias_ms`, their mean, positive if the detections are late.
    """
    true_ns = np.array([strides[0].begin_ns, *(s.end_ns for s in strides)])
    pairs = match_touch_downs(detected_ns, true_ns)
    errors_ms = np.array([(detected_ns[i] - true_ns[j]) * 1e-6 for i, j in pairs])
    margin_ns = 250_000_000  # the tolerance of `match_touch_downs`
    # detections that a true touch-down could match
    between = (detected_ns > true_ns[0] - margin_ns) & (detected_ns < true_ns[-1] + margin_ns)
    scores = {"missed": float(len(true_ns) - len(pairs)), "extra": float(between.sum() - len(pairs))}
    if not pairs:
        return scores
    return {
        "touch_down_error_ms": float(np.abs(errors_ms).mean()),
        "touch_down_bias_ms": float(errors_ms.mean()),
        **scores,
    }


def _rms_pct(errors: Array) -> float:
    """Root mean square of errors (N,) of the phase, in % of a cycle."""
    return 100.0 * math.sqrt(float(np.mean(np.square(errors))))
