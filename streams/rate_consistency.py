"""Whether the angular rates of an IMU turn gravity as its forces say: unit, sign, order and clock of the rates.

A foot rests in each stance. From one rest to the next, rates and forces together must lead from speed 0 to speed 0.
Rates of another unit, or with swapped or mirrored axes, do not: they leave gravity along wrong axes, which sums up to a
speed. The rates are then corrected for each usual mistake in turn, and the mistake whose correction leaves the least is
the likely cause.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Stamps

_REST_S = 0.15
"""Length of the shortest rest, s."""
_REST_FORCE_SD_MPS2, _REST_RATE_SHARE = 0.5, 0.06
"""A rest varies by less than this: forces in m/s², rates as a share of their variation over the whole recording, so
that their unit does not matter."""
_MOVEMENT_S = (0.15, 3.0)
"""Shortest movement between two rests, and longest time from one rest to the next, s."""
_FEWEST, _MOST = 3, 12
"""Movements that are needed for a judgement, and that are looked at, spread over the recording."""
_MISFIT_MPS2, _BETTER = 0.3, 0.5
"""Rates are inconsistent if they leave over more than this, and if a correction leaves less than this share of it."""
_DOUBTFUL_MPS2 = 1.2
"""Misfit from which on rates are doubtful even if no usual mistake explains it, m/s²; 19 recordings of real feet are
within 0.85."""
_DEGREE = math.pi / 180
_CLOCK_S = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)
"""Shifts of the rates against the forces that are tried, s."""
_SCALES = np.geomspace(1 / 40, 40, 81)
"""Factors of the rates that are tried, in steps of 9 %."""
_LEAST_SCALE, _CLEARLY = 1.15, 0.6
"""Least factor that counts as a fault (parts without calibration are within 1.05), and by which share it must be better
than another cause to be named."""


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
        rates: (L, S, 3) without bias, in the middle of each step.
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
    is_at_rest, unrest = _find_rests(t, specific_force, angular_rate)
    spans = _find_movements(t, is_at_rest, unrest)
    if len(spans) < _FEWEST:
        return None
    spans = [spans[k] for k in np.unique(np.linspace(0, len(spans) - 1, _MOST).round().astype(int))]
    rates = angular_rate - np.median(angular_rate[is_at_rest], axis=0)
    movements = _cut_movements(t, specific_force, rates, spans)
    as_recorded = float(compute_misfits(movements, np.eye(3)[None])[0])
    if as_recorded <= _MISFIT_MPS2:
        return None
    causes = _list_causes()
    misfits = compute_misfits(movements, np.stack([correction for _, correction in causes]))
    best = int(np.argmin(misfits))
    cause, corrected = causes[best][0], float(misfits[best])
    scales = compute_misfits(movements, _SCALES[:, None, None] * np.eye(3))
    scale, of_scale = float(_SCALES[np.argmin(scales)]), float(scales.min())
    if of_scale < _CLEARLY * corrected and max(scale, 1 / scale) > _LEAST_SCALE:
        cause, corrected = _name_scale(scale), of_scale
    for shift in _CLOCK_S:
        shifted = np.column_stack([np.interp(t - shift, t, rates[:, k]) for k in range(3)])
        misfit = float(compute_misfits(_cut_movements(t, specific_force, shifted, spans), np.eye(3)[None])[0])
        if misfit < corrected:
            when = "later" if shift > 0 else "earlier"
            cause, corrected = f"the rates belong {1000 * abs(shift):.0f} ms {when} than they are stamped", misfit
    if corrected >= _BETTER * as_recorded:
        axes = [axis for axis, extent in zip("xyz", np.ptp(angular_rate, axis=0)) if extent == 0.0]
        if len(axes) == len("xyz") or (not axes and as_recorded < _DOUBTFUL_MPS2):
            return None
        if not axes:
            return RateFault(misfit_mps2=as_recorded, corrected_mps2=corrected, cause="")
        cause, corrected = f"the rates about {' and '.join(axes)} never change, as those of an empty column", 0.0
    return RateFault(misfit_mps2=as_recorded, corrected_mps2=corrected, cause=cause)


def _name_scale(scale: float) -> str:
    """What is likely wrong with rates that fit the forces once they are multiplied by a factor."""
    size, span = ("large", "long") if scale < 1 else ("small", "short")
    factor = f"{max(scale, 1 / scale):.2g}"
    return f"the rates are {factor} times too {size}, or the time between samples is {factor} times too {span}"


def _list_causes() -> list[tuple[str, Array]]:
    """Usual mistakes, and the matrix (3, 3) by which rates are multiplied to correct each."""
    causes = [
        ("the rates are in °/s", _DEGREE * np.eye(3)),
        ("the rates are in rad/s, and were taken for °/s", np.eye(3) / _DEGREE),
        ("the rates are 1000 times too large", 1e-3 * np.eye(3)),
        ("the rates are 1000 times too small", 1e3 * np.eye(3)),
        ("the rates are twice too large", 0.5 * np.eye(3)),
        ("the rates are twice too small", 2.0 * np.eye(3)),
    ]
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs))
            if axes != "x, y, z":
                cause = f"the axes x, y, z of the forces are {axes} of the rates"
                # rows: axes of the forces; each entry picks an axis of the rates
                causes.append((cause, np.diag(signs) @ np.eye(3)[list(order)]))
    return causes


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


def _find_movements(t: Array, is_at_rest: NDArray[np.bool_], unrest: Array) -> list[tuple[int, int]]:
    """First and last row of each movement: from the stillest sample of a rest to that of the next one."""
    changes = np.diff(np.pad(is_at_rest.astype(np.int8), 1))
    starts, ends = np.flatnonzero(changes == 1), np.flatnonzero(changes == -1)
    stillest = [int(start) + int(np.argmin(unrest[start:end])) for start, end in zip(starts, ends)]
    shortest, longest = _MOVEMENT_S
    return [
        (stillest[k], stillest[k + 1])
        for k in range(len(stillest) - 1)
        if t[starts[k + 1]] - t[ends[k] - 1] >= shortest and t[stillest[k + 1]] - t[stillest[k]] <= longest
    ]


def _cut_movements(t: Array, force: Array, rate: Array, spans: list[tuple[int, int]]) -> _Movements:
    """Cuts the movements out of forces and rates (N, 3) at times (N,), by their first and last rows."""
    length = max(last - first for first, last in spans)
    rates, forces = np.zeros((length, len(spans), 3)), np.zeros((length, len(spans), 3))
    steps, up = np.zeros((length, len(spans))), np.zeros((len(spans), 3))
    for k, (first, last) in enumerate(spans):
        n = last - first
        rates[:n, k] = 0.5 * (rate[first:last] + rate[first + 1 : last + 1])
        forces[:n, k] = 0.5 * (force[first:last] + force[first + 1 : last + 1])
        steps[:n, k] = np.diff(t[first : last + 1])
        gravity = force[max(first - 2, 0) : first + 3].mean(axis=0)
        up[k] = gravity / np.linalg.norm(gravity)
    return _Movements(rates=rates, forces=forces, steps=steps, up=up)


def compute_misfits(movements: _Movements, corrections: Array) -> Array:
    """Acceleration that rates and forces leave over, the median over the movements: (H,) m/s².

    The rates are integrated to rotations, the forces turned by them and summed up to a speed. What differs from the
    speed of a free fall against gravity, divided by the duration, is left over.

    Args:
        movements: S movements.
        corrections: (H, 3, 3), each multiplies the rates.
    """
    rotation = np.broadcast_to(
        np.eye(3), (len(corrections), len(movements.up), 3, 3)
    )  # sensor to its axes at the start
    speed = np.zeros((len(corrections), len(movements.up), 3))
    for rate, force, step in zip(movements.rates, movements.forces, movements.steps):
        half_turn = np.einsum("hij,sj->hsi", corrections, rate) * (0.5 * step)[:, None]
        half = exp(half_turn)
        middle = rotation @ half
        speed += np.einsum("hsij,sj->hsi", middle, force * step[:, None])
        rotation = middle @ half
    duration = movements.steps.sum(axis=0)[:, None]
    left_over = speed / duration - NOMINAL_GRAVITY_MPS2 * movements.up
    return np.asarray(np.median(np.linalg.norm(left_over, axis=2), axis=1))
