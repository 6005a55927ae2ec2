"""Whether the angular rates of an IMU turn gravity as its forces say: unit, sign, order and clock of the rates.

A foot rests in each stance. From one rest to the next, rates and forces together must lead from speed 0 to speed 0.
Rates of another unit, or with swapped or mirrored axes, do not: they leave gravity along wrong axes, which sums up to a
speed. The rates are then corrected for each usual mistake in turn, and the mistake whose correction leaves the least is
the likely cause. Sensors that do not rest, and mistakes that show from stride to stride alone, are left to
`motion_consistency`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.even_steps import average_between, integrate
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rate_corrections import Correction, correct_scale, list_corrections, shift_rates
from stridetwin.streams.samples import Array, Stamps

_REST_S = 0.15
"""Length of the shortest rest, s."""
_REST_FORCE_SD_MPS2, _REST_RATE_SHARE = 0.5, 0.06
"""A rest varies by less than this: forces in m/s², rates as a share of their variation over the whole recording, so
that their unit does not matter."""
_MOVEMENT_S = (0.15, 3.0)
"""Shortest movement between two rests, and longest time from one rest to the next, s."""
_FEWEST, _MOST = 3, 30
"""Movements that are needed for a judgement, and that are looked at, spread over the recording."""
_MISFIT_MPS2, _SHIFT_MISFIT_MPS2 = 0.3, 0.5
"""Rates are inconsistent if they leave over more than this; and where a shift explains it, more than that, as filters
of parts delay by some ms."""
_BETTER, _CERTAIN = 0.5, 3.0
"""A correction explains it if it leaves less than this share in the mean of all movements (of their logarithms), by
this many standard errors. Of 260 simulated and real feet and links of an exoskeleton beside them, none fulfils that."""
_MEDIAN_BETTER, _MANY = (0.5, 0.7), 8
"""Share that it leaves in the median movement at most, of few movements and of many; how many are many."""
_AGREES_MPS2 = 0.7
"""Most that a right correction leaves over, m/s²: 18 of 19 real feet leave up to 0.55, one with clipped rates 0.85."""
_REST_BIAS_SHARE = 0.1
"""Rates at rest, and their deviation from rest to rest, are less than this share of the rates' variation over the whole
recording. Those of real feet are 1 to 9 %; a thigh or a trunk that turns evenly for a moment has 10 % and more."""
_STEP_S = 0.01
"""Step over which rates and forces are averaged, s: a foot turns by up to 0.2 rad in it."""
_FIRST_LOOK, _REFINED = 8, 6
"""Movements by which the best corrections are chosen, and how many of these are judged by all movements."""
_SCALES = np.concatenate([np.geomspace(1 / 40, 1 / 1.2, 40), np.geomspace(1.2, 40, 40)])
"""Factors of the rates that are tried, in steps of 9 %; parts without calibration are within 1.05."""
_CLEARLY = 0.6
"""Share of what a usual mistake leaves over that a factor must stay below to be named in its place."""
_DOUBTFUL_MPS2 = 1.2
"""Misfit from which on rates are doubtful even if no usual mistake explains it, m/s²; 19 recordings of real feet are
within 0.85."""
_STEPS_AT_ONCE = 16
"""Steps of time whose rotations are computed together; more would take memory, fewer would take calls."""
_LONGEST_SHIFT_S = 0.25
"""Longest shift of the rates that is told within a movement, s."""


@dataclass(frozen=True, kw_only=True)
class RateFault:
    """Rates that contradict the forces.

    Attributes:
        misfit_mps2: Acceleration that rates and forces leave over between two rests, m/s².
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
        rates: (L, S, 3) without bias, mean of each step.
        forces: (L, S, 3) m/s², likewise.
        steps: (L, S) s.
        up: (S, 3) unit vectors against gravity at the start, in the sensor's axes there.
    """

    rates: Array
    forces: Array
    steps: Array
    up: Array


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
    spans, bias = _find_movements(t, specific_force, angular_rate)
    if len(spans) < _FEWEST:  # a clock of its own may move the rests of the rates away from those of the forces
        shifts = [c.shift_s for c in list_corrections() if 0 < abs(c.shift_s) < _LONGEST_SHIFT_S]
        shifted = [_find_movements(t, specific_force, shift_rates(t, angular_rate, shift)) for shift in shifts]
        spans, bias = max(shifted, key=lambda movements: len(movements[0]))
    if len(spans) < _FEWEST:
        return None
    spans = [spans[k] for k in np.unique(np.linspace(0, len(spans) - 1, _MOST).round().astype(int))]
    rates = angular_rate - bias
    movements = _cut_movements(t, specific_force, rates, spans)
    recorded = compute_misfits(movements, np.eye(3)[None])[0]
    as_recorded = float(np.median(recorded))
    if as_recorded <= _MISFIT_MPS2:
        return None
    correction, misfits = _correct(t, specific_force, rates, spans, movements)
    if correction.shift_s and as_recorded <= _SHIFT_MISFIT_MPS2:
        return None
    corrected = float(np.median(misfits))
    most = _MEDIAN_BETTER[len(spans) >= _MANY] * as_recorded
    if corrected <= min(_AGREES_MPS2, most) and _is_certainly_less(misfits, recorded):
        return RateFault(misfit_mps2=as_recorded, corrected_mps2=corrected, cause=correction.cause)
    is_constant = np.ptp(angular_rate, axis=0) == 0.0  # (3,)
    if is_constant.any() and not is_constant.all():
        axes = " and ".join(axis for axis, constant in zip("xyz", is_constant) if constant)
        cause = f"the rates about {axes} never change, as those of an empty column"
        return RateFault(misfit_mps2=as_recorded, corrected_mps2=0.0, cause=cause)
    if as_recorded < _DOUBTFUL_MPS2:
        return None
    return RateFault(misfit_mps2=as_recorded, corrected_mps2=corrected, cause="")


def _correct(
    t: Array, force: Array, rates: Array, spans: list[tuple[int, int]], movements: _Movements
) -> tuple[Correction, Array]:
    """The usual mistake whose correction leaves the least, and what it leaves over in each movement: (S,) m/s².

    Args:
        t: (N,) s.
        force: (N, 3) m/s².
        rates: (N, 3) rad/s without bias.
        spans: First and last rows of S movements.
        movements: The movements themselves.
    """
    corrections = list_corrections()
    turned = [c for c in corrections if not c.shift_s]
    shifted = [c for c in corrections if 0 < abs(c.shift_s) < _LONGEST_SHIFT_S]
    some = _cut_movements(t, force, rates, spans[:: max(1, len(spans) // _FIRST_LOOK)])
    first_look = np.median(compute_misfits(some, np.stack([c.matrix for c in turned])), axis=1)
    best = [turned[k] for k in np.argsort(first_look)[:_REFINED]]
    misfits = [compute_misfits(movements, np.stack([c.matrix for c in best]))]
    for correction in shifted:
        moved = _cut_movements(t, force, shift_rates(t, rates, correction.shift_s), spans)
        misfits.append(compute_misfits(moved, correction.matrix[None]))
    every = np.concatenate(misfits)  # (H, S)
    medians = np.median(every, axis=1)
    least = int(np.argmin(medians))
    correction, of_correction = [*best, *shifted][least], every[least]
    # any other factor must leave clearly less, for it fits by chance more often than a usual mistake
    scales = np.median(compute_misfits(some, _SCALES[:, None, None] * np.eye(3)), axis=1)
    scaled = correct_scale(float(_SCALES[np.argmin(scales)]))
    (of_scale,) = compute_misfits(movements, scaled.matrix[None])
    if float(np.median(of_scale)) < _CLEARLY * medians[least]:
        return scaled, of_scale
    return correction, of_correction


def _is_certainly_less(corrected: Array, recorded: Array) -> bool:
    """Whether a correction leaves less in most of S movements (S,), by far more than chance."""
    gains = np.log(recorded / corrected)  # (S,)
    mean, error = float(gains.mean()), float(gains.std(ddof=1)) / math.sqrt(len(gains))
    return mean > -math.log(_BETTER) and mean > _CERTAIN * error


def _find_rests(t: Array, force: Array, rate: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which samples lie in a rest, (N,), and how restless each is, (N,): 0 is still, infinite where no rest is near."""
    n = max(5, round(_REST_S / float(np.median(np.diff(t)))))  # samples of a window
    if len(t) <= 2 * n:
        return np.zeros(len(t), bool), np.full(len(t), np.inf)
    force_sd, rate_sd = _window_sd(force, n), _window_sd(rate, n)  # (N - n + 1,) of each window
    rate_limit = _REST_RATE_SHARE * math.sqrt(float(rate.var(axis=0).sum())) + 1e-12
    still = (force_sd < _REST_FORCE_SD_MPS2) & (rate_sd < rate_limit)
    # a sample rests if any of the n windows that hold it is still
    at_rest = np.convolve(still, np.ones(n)) > 0.5
    unrest = np.full(len(t), np.inf)
    unrest[n // 2 : n // 2 + len(still)] = (force_sd / _REST_FORCE_SD_MPS2) ** 2 + (rate_sd / rate_limit) ** 2
    return at_rest, unrest


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
    return spans, np.median(rate[is_at_rest], axis=0)


def _turns_at_rest(t: Array, rate: Array, spans: list[tuple[int, int]]) -> bool:
    """Whether a sensor turns evenly in what looks like its rests.

    Args:
        t: (N,) s.
        rate: (N, 3) rad/s.
        spans: First and last rows of the movements between rests.
    """
    half = max(5, round(_REST_S / float(np.median(np.diff(t))))) // 2  # samples of half a rest
    at = [first for first, _ in spans] + [spans[-1][1]]
    means = np.stack([rate[max(row - half, 0) : row + half + 1].mean(axis=0) for row in at])
    bias = np.median(means, axis=0)
    most = _REST_BIAS_SHARE * math.sqrt(float(rate.var(axis=0).sum()))
    deviation = float(np.median(np.linalg.norm(means - bias, axis=1)))
    return deviation >= most or float(np.linalg.norm(bias)) >= most


def _cut_movements(t: Array, force: Array, rate: Array, spans: list[tuple[int, int]]) -> _Movements:
    """Cuts the movements out of a recording, in even steps of about 10 ms.

    Args:
        t: (N,) s.
        force: (N, 3) m/s².
        rate: (N, 3) rad/s.
        spans: First and last rows of S movements.
    """
    counts = [max(1, round((t[last] - t[first]) / _STEP_S)) for first, last in spans]
    shape = (max(counts), len(spans))
    rates, forces, steps, up = np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape), np.zeros((len(spans), 3))
    rate_integrals, force_integrals = integrate(t, rate), integrate(t, force)
    for k, ((first, last), n) in enumerate(zip(spans, counts)):
        edges = np.linspace(t[first], t[last], n + 1)
        rates[:n, k] = average_between(t, rate_integrals, edges)
        forces[:n, k] = average_between(t, force_integrals, edges)
        steps[:n, k] = np.diff(edges)
        gravity = force[max(first - 2, 0) : first + 3].mean(axis=0)
        up[k] = gravity / max(float(np.linalg.norm(gravity)), 1e-9)  # rows of zeros have none
    return _Movements(rates=rates, forces=forces, steps=steps, up=up)


def compute_misfits(movements: _Movements, corrections: Array) -> Array:
    """Acceleration that rates and forces leave over in each movement: (H, S) m/s².

    The rates are integrated to rotations, the forces turned by them and summed up to a speed. What differs from the
    speed of a free fall against gravity, divided by the duration, is left over.

    Args:
        movements: S movements.
        corrections: (H, 3, 3), each multiplies the rates.
    """
    shape = len(corrections), len(movements.up)
    rotation = np.broadcast_to(np.eye(3), (*shape, 3, 3))  # sensor to its axes at the start
    speed = np.zeros((*shape, 3))
    for first in range(0, len(movements.steps), _STEPS_AT_ONCE):
        some = slice(first, first + _STEPS_AT_ONCE)
        half_turns = np.einsum("hij,lsj->lhsi", corrections, movements.rates[some])
        halves = exp(half_turns * (0.5 * movements.steps[some])[:, None, :, None])
        for half, force, step in zip(halves, movements.forces[some], movements.steps[some]):
            middle = rotation @ half
            speed += np.einsum("hsij,sj->hsi", middle, force * step[:, None])
            rotation = middle @ half
    duration = movements.steps.sum(axis=0)[:, None]
    left_over = speed / duration - NOMINAL_GRAVITY_MPS2 * movements.up
    return np.asarray(np.linalg.norm(left_over, axis=2))
