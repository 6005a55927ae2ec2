"""Whether the angular rates of an IMU turn gravity as its forces say: unit, sign, order and clock of the rates.

A foot rests in each stance. From one rest to the next, rates and forces together must lead from speed 0 to speed 0, and
the rates must turn gravity from where the forces point in the first rest to where they point in the second. Rates of
another unit, or with swapped or mirrored axes, do neither. They are then corrected for each usual mistake in turn, and
the mistake whose correction leaves the least is the likely cause.

A foot that walks straight ahead turns about one axis only. A mistake of the other two shows in the few movements of a
turn, so that every movement counts by the logarithm of what it leaves over: few impossible ones outweigh many that say
nothing, and a single one proves nothing. Sensors that do not rest, and mistakes that show from stride to stride alone,
are left to `motion_consistency`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.even_steps import integrate
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rate_corrections import Correction, correct_scale, correct_shift, list_products, shift_rates
from stridetwin.streams.samples import Array, Stamps
from stridetwin.streams.time_series import interpolate

_REST_S = 0.15
"""Length of the shortest rest, s."""
_REST_FORCE_SD_MPS2, _REST_RATE_SHARE = 1.0, 0.06
"""A rest varies by less than this: forces in m/s², rates as a share of their variation over the whole recording, so
that their unit does not matter. The foot of a fast walker varies by 0.6 m/s² in its stillest 0.15 s."""
_MOST_UNREST = 1.5
"""Sum of the squares of both shares that half of the stillest samples of rests stay below: of feet up to 1.4."""
_MOVEMENT_S = (0.15, 3.0)
"""Shortest movement between two rests, and longest time from one rest to the next, s."""
_FEWEST, _MOST = 3, 30
"""Movements that are needed for a judgement, and that are looked at, spread over the recording."""
_GRAVITY_S = 0.08
"""Time over which the forces of a rest are averaged to gravity, and the rates to their bias, s."""
_USUAL_MPS2 = (0.3, 0.6)
"""What a movement of a foot usually leaves over, m/s²: of the speed by its duration, and of gravity's direction."""
_CLIPPED = 5.0
"""Multiple of it that a movement leaves whose forces or rates exceed the sensor's range."""
_CERTAIN, _MOST_OF_ONE = 4.5, 4.0
"""Gain from which on a correction is certain, and most that one movement adds to it, so that one alone is no proof; see
`_Misfits.score`. Of 200 sound simulated feet, no correction gains more than 3."""
_AGREES, _MANY = (1.5, 2.2), 10
"""Most that a right correction leaves over in the mean of few movements and of many, as a score, for some correction
fits few movements by chance; and how many are many. Simulated feet leave up to 1.0, 13 of 14 real ones up to 2.1, and
one that runs 4.3."""
_MISFIT_MPS2 = 0.3
"""Rates with an axis that never changes are inconsistent if they leave over more than this."""
_SHIFT_MISFIT_MPS2 = 0.3
"""Rates are late or early if they leave more than this over in the median, as filters of parts delay by some ms."""
_SHIFT_LEAVES = 0.55
"""A right shift leaves at most this share of the median: some shift of 75 to 100 ms fits slow walkers by chance, whose
shoes roll over in stance, and leaves 0.58 or more; rates that are 100 ms late leave 0.30 to 0.52 on most feet."""
_GRAVITY_SCALE = (0.85, 1.15)
"""Least and largest scale of the forces, by which gravity at rest differs from the nominal one."""
_GRAVITY_SPREAD = 0.015
"""Deviation of gravity from rest to rest, as a share, that most rests of a sensor that surely rests stay below: that of
half of the feet is up to 1.1 %, of 20 of 22 heads, chests and thighs 1.6 to 20 %."""
_FEWEST_CLIPPED = 3
"""Samples at the end of an axis's range from which on it is its end."""
_REST_BIAS_SHARE = 0.1
"""Rates at rest, and their deviation from rest to rest, are less than this share of the rates' variation over the whole
recording. Those of real feet are 1 to 9 %; a thigh or a trunk that turns evenly for a moment has 10 % and more."""
_STEP_S = 0.01
"""Step over which rates and forces are averaged, s: a foot turns by up to 0.2 rad in it."""
_SCALES = np.concatenate([np.geomspace(1 / 40, 1 / 1.2, 40), np.geomspace(1.2, 40, 40)])
"""Factors of the rates that are tried, in steps of 9 %; parts without calibration are within 1.05."""
_CLEARLY = 3.0
"""Score by which a factor must leave less than a usual mistake to be named in its place."""
_DOUBTFUL_MPS2 = 1.2
"""Misfit from which on rates are doubtful even if no usual mistake explains it, m/s²; 19 recordings of real feet are
within 0.85."""
_NEAR_SHIFT_S, _SHIFT_STEP_S = 0.35, 0.025
"""Shifts of the rates that are tried on both sides of none, and of the one with which rates and forces rest together;
and their steps, s."""
_LEAST_SHIFT_S, _FARTHEST_SHIFT_S = 0.05, 10.0
"""Least and farthest shift that is told, s."""
_FIRST_LOOK, _REFINED = 8, 8
"""Movements by which the best corrections are chosen, and how many of these are judged by all movements."""
_NONE = Correction(cause="", matrix=np.eye(3))
"""The rates as recorded."""


@dataclass(frozen=True, kw_only=True)
class RateFault:
    """Rates that contradict the forces.

    Attributes:
        misfit_mps2: Acceleration that rates and forces leave over between two rests, m/s²: the median of all
            movements, or where most say nothing of the mistake, of those that show it.
        corrected_mps2: The same after the correction.
        cause: What is likely wrong with the rates; "" if no usual mistake explains the misfit, which is then a doubt.
    """

    misfit_mps2: float
    corrected_mps2: float
    cause: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _Movements:
    """S movements between two rests, with L steps of time each; shorter ones end with steps of no duration.

    Attributes:
        edges: (L + 1, S) times between the steps, s.
        forces: (L, S, 3) m/s², mean of each step.
        gravity: (2, S, 3) m/s², mean forces at rest at the start and at the end, in the sensor's axes there.
        is_clipped: (S,) whether forces or rates reach the end of the sensor's range.
    """

    edges: Array
    forces: Array
    gravity: Array
    is_clipped: NDArray[np.bool_]

    def __getitem__(self, which: NDArray[np.int64]) -> _Movements:
        """Some movements: (K,) their numbers."""
        return _Movements(
            edges=self.edges[:, which],
            forces=self.forces[:, which],
            gravity=self.gravity[:, which],
            is_clipped=self.is_clipped[which],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Misfits:
    """What S movements leave over with each of H corrections.

    Attributes:
        speed: (H, S) difference of the speed at the end from 0, divided by the duration, m/s².
        gravity: (H, S) difference of gravity at the end from where the rates have turned it, m/s².
        is_clipped: (S,) as in `_Movements`.
    """

    speed: Array
    gravity: Array
    is_clipped: NDArray[np.bool_]

    def __getitem__(self, which: int) -> _Misfits:
        """Those of one correction."""
        return _Misfits(speed=self.speed[[which]], gravity=self.gravity[[which]], is_clipped=self.is_clipped)

    @property
    def score(self) -> Array:
        """(H, S), 0 where nothing is left over; grows by the logarithm, so that a strike or a slip counts little."""
        speed, gravity = (usual * np.where(self.is_clipped, _CLIPPED, 1.0) for usual in _USUAL_MPS2)  # (S,) each
        return np.asarray(np.log1p((self.speed / speed) ** 2) + np.log1p((self.gravity / gravity) ** 2))


def find_rate_fault(t_ns: Stamps, specific_force: Array, angular_rate: Array) -> RateFault | None:
    """Compares rates and forces over the movements between the rests of a foot.

    Args:
        t_ns: (N,) increasing stamps.
        specific_force: (N, 3) m/s².
        angular_rate: (N, 3) rad/s.

    Returns:
        The fault; None if rates and forces agree, if they differ by little and no usual mistake explains it, or if the
        sensor does not rest often enough to judge.
    """
    t = (t_ns - t_ns[0]) * 1e-9
    spans, bias, common_shift_s = _find_common_movements(t, specific_force, angular_rate)
    if len(spans) < _FEWEST:
        return None
    spans = [spans[k] for k in np.unique(np.linspace(0, len(spans) - 1, _MOST).round().astype(int))]
    integrals = integrate(t, angular_rate - bias)
    is_clipped = np.any(_find_clipped(specific_force) | _find_clipped(angular_rate), axis=1)  # (N,)
    movements = _cut_movements(t, specific_force, spans, is_clipped)
    recorded = _measure(movements, _correct(t, integrals, movements, [_NONE]))
    as_recorded = float(np.median(recorded.speed))
    correction, corrected = _find_correction(t, integrals, movements, recorded.score[0], common_shift_s)
    is_late = correction.shift_s != 0.0
    explains = not is_late or (
        as_recorded > _SHIFT_MISFIT_MPS2 and float(np.median(corrected.speed)) <= _SHIFT_LEAVES * as_recorded
    )
    if _is_certain(recorded, corrected) and explains:
        shows = recorded.score[0] - corrected.score[0] > 0.0  # (S,)
        shows = shows & (recorded.speed[0] > min(as_recorded, _DOUBTFUL_MPS2))
        return RateFault(
            misfit_mps2=float(np.median(recorded.speed[0][shows])) if shows.any() else as_recorded,
            corrected_mps2=float(np.median(corrected.speed[0][shows])) if shows.any() else as_recorded,
            cause=correction.cause,
        )
    is_constant = np.ptp(angular_rate, axis=0) == 0.0  # (3,)
    if as_recorded > _MISFIT_MPS2 and is_constant.any() and not is_constant.all():
        axes = " and ".join(axis for axis, constant in zip("xyz", is_constant) if constant)
        cause = f"the rates about {axes} never change, as those of an empty column"
        return RateFault(misfit_mps2=as_recorded, corrected_mps2=0.0, cause=cause)
    if common_shift_s or not _is_doubtful(movements, recorded.speed[0]):
        return None
    return RateFault(misfit_mps2=as_recorded, corrected_mps2=float(np.median(corrected.speed)), cause="")


def _find_common_movements(t: Array, force: Array, rate: Array) -> tuple[list[tuple[int, int]], Array, float]:
    """First and last row of each movement between rests of both rates and forces, the rates' bias, and their shift.

    The rests of rates with a clock of their own are elsewhere than those of the forces, and few are common to both.
    Then the rates are moved so that they rest with the forces for the longest time.

    Args:
        t: (N,) s.
        force: (N, 3) m/s².
        rate: (N, 3) rad/s.

    Returns:
        S spans, the bias (3,) rad/s, and the shift with which rates and forces rest together, s.
    """
    spans, bias = _find_movements(t, force, rate)
    shift_s = _find_common_shift(t, force, rate)
    if abs(shift_s) < _LEAST_SHIFT_S:
        return spans, bias, 0.0
    shifted, shifted_bias = _find_movements(t, force, shift_rates(t, rate, shift_s))
    return (shifted, shifted_bias, shift_s) if len(shifted) > len(spans) else (spans, bias, shift_s)


def _find_common_shift(t: Array, force: Array, rate: Array) -> float:
    """Time by which rates (N, 3) are moved to later so that they rest when the forces (N, 3) do, s; 0 without rests."""
    n = max(5, round(_REST_S / float(np.median(np.diff(t)))))  # samples of a window
    count = int((t[-1] - t[0]) / _SHIFT_STEP_S)
    if len(t) <= 2 * n or not 2 <= count <= len(t):  # more steps than samples: a recording of long gaps
        return 0.0
    grid = t[0] + _SHIFT_STEP_S * np.arange(count)
    rows = np.clip(np.searchsorted(t, grid) - n // 2, 0, len(t) - n)
    is_still = [unrest[rows] < 1.0 for unrest in _measure_unrest(force, rate, n)]
    if not all(still.any() and not still.all() for still in is_still):
        return 0.0
    forces, rates = (np.fft.rfft(still - still.mean(), 2 * count) for still in is_still)
    common = np.fft.irfft(forces * rates.conj(), 2 * count)
    most = min(round(_FARTHEST_SHIFT_S / _SHIFT_STEP_S), count // 2)
    shifts = np.arange(-most, most + 1)
    return float(shifts[np.argmax(common[shifts])]) * _SHIFT_STEP_S


def _is_certain(recorded: _Misfits, corrected: _Misfits) -> bool:
    """Whether a correction leaves so much less in several of S movements, and so little in all, that it is right."""
    gains = np.minimum(recorded.score[0] - corrected.score[0], _MOST_OF_ONE)  # (S,)
    return float(gains.sum()) >= _CERTAIN and float(corrected.score.mean()) <= _AGREES[len(gains) >= _MANY]


def _is_doubtful(movements: _Movements, speed: Array) -> bool:
    """Whether the movements that can be judged leave too much over, of a sensor that surely rests between them.

    At rest, the forces are gravity alone; those of a head or a thigh that seems to rest are not. Movements whose
    forces or rates exceed the range of the sensor leave much over, which `check` reports as such.

    Args:
        movements: S movements.
        speed: (S,) m/s² that they leave over.
    """
    magnitudes = np.linalg.norm(movements.gravity[0], axis=1)  # (S,)
    if float(np.percentile(np.abs(magnitudes / np.median(magnitudes) - 1.0), 75)) > _GRAVITY_SPREAD:
        return False
    is_whole = ~movements.is_clipped
    return int(is_whole.sum()) >= _FEWEST and float(np.median(speed[is_whole])) >= _DOUBTFUL_MPS2


def _find_clipped(values: Array) -> NDArray[np.bool_]:
    """Which values (N, 3) are at the end of the sensor's range, where several are equal and none is larger."""
    sizes = np.abs(values)
    is_at_end = sizes >= sizes.max(axis=0) * (1.0 - 1e-6)
    is_end = (is_at_end.sum(axis=0) >= _FEWEST_CLIPPED) & (np.ptp(values, axis=0) > 0.0)  # (3,)
    return np.asarray(is_at_end & is_end)


def _find_correction(
    t: Array, integrals: Array, movements: _Movements, recorded: Array, common_shift_s: float
) -> tuple[Correction, _Misfits]:
    """The mistake whose correction leaves the least, and what it leaves over.

    Args:
        t: (N,) s.
        integrals: (N, 3) of the rates without bias, rad.
        movements: S movements.
        recorded: (S,) score of what is left over as recorded.
        common_shift_s: With which rates and forces rest together.
    """
    # mistakes that show in some movements alone are chosen by these, and judged by all
    some = movements[np.argsort(recorded)[::-1][:_FIRST_LOOK].astype(np.int64)]
    usual = [*list_products(), *(correct_shift(shift) for shift in _list_shifts(common_shift_s))]
    first_look = _measure(some, _correct(t, integrals, some, usual)).score.mean(axis=1)
    best = [usual[k] for k in np.argsort(first_look)[:_REFINED]]
    misfits = _measure(movements, _correct(t, integrals, movements, best))
    least = int(np.argmin(misfits.score.sum(axis=1)))
    # any other factor must leave clearly less, for it fits by chance more often than a usual mistake
    scales = [correct_scale(float(factor)) for factor in _SCALES]
    first_look = _measure(some, _correct(t, integrals, some, scales)).score.mean(axis=1)
    scaled = scales[int(np.argmin(first_look))]
    of_scale = _measure(movements, _correct(t, integrals, movements, [scaled]))
    if float(of_scale.score.sum()) < float(misfits.score[least].sum()) - _CLEARLY:
        return scaled, of_scale
    return best[least], misfits[least]


def _list_shifts(common_shift_s: float) -> list[float]:
    """Shifts of the rates that are tried, s: those around none, and around one with which rates and forces rest."""
    steps = round(_NEAR_SHIFT_S / _SHIFT_STEP_S)
    common = round(common_shift_s / _SHIFT_STEP_S)
    tried = {k + near for k in (0, common) for near in range(-steps, steps + 1)}
    return [k * _SHIFT_STEP_S for k in sorted(tried) if abs(k) * _SHIFT_STEP_S >= _LEAST_SHIFT_S - 1e-9]


def _find_rests(t: Array, force: Array, rate: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which samples lie in a rest, (N,), and how restless each is, (N,): 0 is still, infinite where no rest is near."""
    n = max(5, round(_REST_S / float(np.median(np.diff(t)))))  # samples of a window
    if len(t) <= 2 * n:
        return np.zeros(len(t), bool), np.full(len(t), np.inf)
    force_unrest, rate_unrest = _measure_unrest(force, rate, n)
    still = (force_unrest < 1.0) & (rate_unrest < 1.0)
    # a sample rests if any of the n windows that hold it is still
    at_rest = np.convolve(still, np.ones(n)) > 0.5
    unrest = np.full(len(t), np.inf)
    unrest[n // 2 : n // 2 + len(still)] = force_unrest**2 + rate_unrest**2
    return at_rest, unrest


def _measure_unrest(force: Array, rate: Array, n: int) -> tuple[Array, Array]:
    """Variation of forces and rates (N, 3) in each window of n rows, as shares of a rest's: (N - n + 1,) each."""
    rate_limit = _REST_RATE_SHARE * math.sqrt(float(rate.var(axis=0).sum())) + 1e-12
    return _window_sd(force, n) / _REST_FORCE_SD_MPS2, _window_sd(rate, n) / rate_limit


def _window_sd(values: Array, n: int) -> Array:
    """Standard deviation over each window of n rows, the three columns (N, 3) together: (N - n + 1,)."""
    values = values - values.mean(axis=0)
    sums = np.cumsum(np.pad(values, ((1, 0), (0, 0))), axis=0)
    squares = np.cumsum(np.pad(values**2, ((1, 0), (0, 0))), axis=0)
    mean = (sums[n:] - sums[:-n]) / n
    variance = ((squares[n:] - squares[:-n]) / n - mean**2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _find_movements(t: Array, force: Array, rate: Array) -> tuple[list[tuple[int, int]], Array]:
    """First and last row of each movement, and the median of the rates at rest (3,) rad/s.

    A movement goes from the stillest sample of a rest to that of the next one. A sensor that turns in what looks like
    its rests has none.
    """
    is_at_rest, unrest = _find_rests(t, force, rate)
    changes = np.diff(np.pad(is_at_rest.astype(np.int8), 1))
    starts, ends = np.flatnonzero(changes == 1), np.flatnonzero(changes == -1)
    stillest = [int(start) + int(np.argmin(unrest[start:end])) for start, end in zip(starts, ends)]
    shortest, longest = _MOVEMENT_S
    spans = [
        (stillest[k], stillest[k + 1])
        for k in range(len(stillest) - 1)
        if t[starts[k + 1]] - t[ends[k] - 1] >= shortest and t[stillest[k + 1]] - t[stillest[k]] <= longest
    ]
    if not spans or _turns_at_rest(t, rate, spans):
        return [], np.zeros(3)
    if float(np.median(unrest[[first for first, _ in spans]])) > _MOST_UNREST:
        return [], np.zeros(3)
    return spans, np.median(rate[is_at_rest], axis=0)


def _turns_at_rest(t: Array, rate: Array, spans: list[tuple[int, int]]) -> bool:
    """Whether a sensor turns evenly in what looks like its rests.

    Args:
        t: (N,) s.
        rate: (N, 3) rad/s.
        spans: First and last rows of the movements between rests.
    """
    half = max(2, round(_GRAVITY_S / float(np.median(np.diff(t)))) // 2)  # samples
    at = [first for first, _ in spans] + [spans[-1][1]]
    means = np.stack([rate[max(row - half, 0) : row + half + 1].mean(axis=0) for row in at])
    bias = np.median(means, axis=0)
    most = _REST_BIAS_SHARE * math.sqrt(float(rate.var(axis=0).sum()))
    deviation = float(np.median(np.linalg.norm(means - bias, axis=1)))
    return deviation >= most or float(np.linalg.norm(bias)) >= most


def _cut_movements(t: Array, force: Array, spans: list[tuple[int, int]], is_clipped: NDArray[np.bool_]) -> _Movements:
    """Cuts the movements out of a recording, in even steps of about 10 ms.

    Args:
        t: (N,) s.
        force: (N, 3) m/s².
        spans: First and last rows of S movements.
        is_clipped: (N,) whether forces or rates are at the end of the sensor's range.
    """
    counts = [max(1, round((t[last] - t[first]) / _STEP_S)) for first, last in spans]
    ends = t[np.array(spans)].T  # (2, S)
    shares = np.minimum(np.arange(max(counts) + 1)[:, None] / np.array(counts), 1.0)
    edges = ends[0] + shares * (ends[1] - ends[0])
    integrals = integrate(t, force)
    around = np.stack([np.maximum(ends - _GRAVITY_S / 2, t[0]), np.minimum(ends + _GRAVITY_S / 2, t[-1])])
    gravity = np.diff(interpolate(around, t, integrals), axis=0)[0] / np.diff(around, axis=0)[0, ..., None]
    return _Movements(
        edges=edges,
        forces=_average(t, integrals, edges),
        gravity=gravity,
        is_clipped=np.array([is_clipped[first : last + 1].any() for first, last in spans]),
    )


def _average(t: Array, integrals: Array, edges: Array) -> Array:
    """Means (L, S, 3) between edges (L + 1, S) s, from integrals (N, 3) at times (N,) s; 0 in steps of no duration."""
    durations = np.diff(edges, axis=0)[..., None]
    return np.asarray(np.diff(interpolate(edges, t, integrals), axis=0) / np.where(durations > 0, durations, np.inf))


def _correct(t: Array, integrals: Array, movements: _Movements, corrections: list[Correction]) -> Array:
    """Corrected rates of S movements: (L, H, S, 3) rad/s, the mean of each step.

    Args:
        t: (N,) s.
        integrals: (N, 3) of the rates without bias, rad.
        movements: S movements.
        corrections: H corrections.
    """
    recorded = _average(t, integrals, movements.edges)
    rates = [
        (_average(t, integrals, movements.edges - c.shift_s) if c.shift_s else recorded) @ c.matrix.T
        for c in corrections
    ]
    return np.stack(rates, axis=1)


def _measure(movements: _Movements, rates: Array) -> _Misfits:
    """What rates and forces leave over in each movement.

    The rates are integrated to rotations, the forces turned by them and summed up to a speed. What differs from the
    speed of a free fall against gravity is left over, and what differs between gravity at the start and at the end.

    Args:
        movements: S movements.
        rates: (L, H, S, 3) rad/s with each of H corrections.
    """
    rotation = np.broadcast_to(np.eye(3), (*rates.shape[1:], 3))  # sensor to its axes at the start
    speed = np.zeros(rates.shape[1:])
    steps = np.diff(movements.edges, axis=0)
    for rate, force, step in zip(rates, movements.forces, steps):
        half = exp(rate * (0.5 * step)[:, None])
        middle = rotation @ half
        speed += np.einsum("hsij,sj->hsi", middle, force * step[:, None])
        rotation = middle @ half
    magnitude = np.linalg.norm(movements.gravity, axis=2, keepdims=True)
    first, last = movements.gravity / np.maximum(magnitude, 1e-9)  # unit vectors; rows of zeros have none
    # gravity as the sensor measures it, so that the scale of its forces is none of the rates' mistakes
    gravity = float(np.clip(np.median(magnitude) / NOMINAL_GRAVITY_MPS2, *_GRAVITY_SCALE)) * NOMINAL_GRAVITY_MPS2
    left_over = speed / steps.sum(axis=0)[:, None] - gravity * first
    turned = gravity * (np.einsum("hsij,sj->hsi", rotation, last) - first)
    return _Misfits(
        speed=np.linalg.norm(left_over, axis=2),
        gravity=np.linalg.norm(turned, axis=2),
        is_clipped=movements.is_clipped,
    )
