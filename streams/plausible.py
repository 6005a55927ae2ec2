"""Plausibility checks: units, rates and gravity reveal an invalid file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2, STANDARD_GRAVITY_MPS2
from stridetwin.streams.rate_consistency import find_rate_fault
from stridetwin.streams.samples import Array, Block, Sample, Stamps

IMU_RATES_HZ = (20.0, 5000.0)
"""Least and largest plausible rate of an IMU."""
IMAGE_RATES_HZ = (0.2, 1000.0)
"""Least and largest plausible rate of a camera."""
_REST_SPREAD = 0.15
"""Share by which the force at rest may differ from gravity."""
_REST_S, _REST_SD, _FEWEST_AT_REST = 0.25, 0.3, 5
"""A rest: length of a window in s, most standard deviation of the force's magnitude in m/s², fewest samples."""
_MOVING_SPREAD = (0.5, 2.0)
"""Least and largest median force in motion, in multiples of gravity."""
_MOVING_SD = 1.0
"""Standard deviation of the force from which on a sensor moves, m/s²."""
_FASTEST = 60.0  # rad/s: 3400 °/s, beyond what foot-worn gyros measure
_LEAST_FAR_M, _MOST_FAR_M, _USUAL_FAR_M = 0.6, 15.0, 3.0
_DEPTH_FACTORS = (5.0, 0.2, 10.0, 0.1, 2.0, 0.5, 1000.0, 0.001)
"""Factors between usual units of depth: 1/5000, 1/1000, 1/10000 and 1/2000 m, mm and m."""
_HINTS = (
    ((0.8, 1.2), f"; is it in g? Multiply by {STANDARD_GRAVITY_MPS2}"),
    ((800.0, 1200.0), f"; is it in milli-g? Multiply by {STANDARD_GRAVITY_MPS2 / 1000}"),
    ((0.0, 3.0), "; has gravity been taken out? It must be the raw specific force"),
    ((85.0, 110.0), "; is it in m/s², and was taken for g?"),
    ((8_500.0, 11_000.0), "; is it in mg or mm/s², and was taken for g or m/s²?"),
    ((200.0, math.inf), "; are they raw counts? Divide them by those of 1 g in the data sheet"),
)
"""What may be wrong with a median force, by the range of its number; the first range that fits counts."""


@dataclass(frozen=True)
class Implausible:
    """An implausible quantity.

    Attributes:
        field: The quantity.
        value: Its value.
        valid: Plausible values.
    """

    field: str
    value: str
    valid: str

    def __str__(self) -> str:
        return f"{self.field}: invalid {self.value}: expected {self.valid}"


def median_rate(t_ns: Stamps) -> float:
    """Rate in Hz from the median step of (N,) increasing stamps; 0 for fewer than two."""
    return 1e9 / float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0


def mean_rate(t_ns: Stamps) -> float:
    """Rate in Hz from the first to the last of (N,) increasing stamps; 0 for fewer than two."""
    span = int(t_ns[-1] - t_ns[0]) if len(t_ns) > 1 else 0
    return (len(t_ns) - 1) * 1e9 / span if span > 0 else 0.0


def find_implausible_rates(t_ns: Stamps, valid_hz: tuple[float, float]) -> Iterator[Implausible]:
    """Yields an `Implausible` if the median rate of (N,) stamps is outside `valid_hz`, as with a wrong unit of time."""
    rate, (low, high) = median_rate(t_ns), valid_hz
    if len(t_ns) > 1 and not low <= rate <= high:
        hint = _guess_time_unit(rate, valid_hz)
        yield Implausible("t", f"{rate:.4g} Hz", f"a rate of {low:g} to {high:g} Hz, t in s{hint}")


def _guess_time_unit(rate_hz: float, valid_hz: tuple[float, float]) -> str:
    """What may be wrong with the unit of stamps that give an impossible rate, for a message; "" if none is likely."""
    low, high = valid_hz
    if rate_hz > high:
        factors = [factor for factor in (1e3, 1e6, 1e9) if low <= rate_hz / factor <= high]
        return f"; are the stamps in a unit that is {factors[0]:g} times larger, as s and ms?" if factors else ""
    for name, factor in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
        if low <= rate_hz * factor <= high:
            return f"; is t in {name}, or in a unit that is {factor:g} times smaller than the given one?"
    return "; is t in milliseconds or nanoseconds?" if rate_hz < low else ""


def force_at_rest(t_ns: Stamps, specific_force: Array) -> tuple[float, bool]:
    """Median magnitude, m/s², of specific force at rest, and whether the sensor is ever at rest.

    It is at rest in windows of 0.25 s in which the magnitude hardly changes: a foot is in every stance, a walking head
    never. Without rest the median is that of all samples.

    Args:
        t_ns: (N,) increasing stamps, N ≥ 2.
        specific_force: (N, 3) m/s².
    """
    with np.errstate(over="ignore", invalid="ignore"):  # damaged numbers may have any size
        force = np.linalg.norm(specific_force, axis=1)
        size = min(len(force), max(_FEWEST_AT_REST, round(_REST_S * median_rate(t_ns))))  # samples of a window
        windows = force[: len(force) // size * size].reshape(-1, size)  # the samples left over at the end are dropped
        resting = windows[windows.std(axis=1) < _REST_SD]
    return (float(np.median(resting)), True) if len(resting) else (float(np.median(force)), False)


def find_implausible_values(block: Block[Sample]) -> Iterator[Implausible]:
    """Yields what is implausible in the samples of an IMU or an accelerometer, as wrong units cause.

    Checked are the sample rate, the magnitude of the specific force (gravity ± 15 % at rest, 0.5 to 2 times gravity in
    motion), the angular rate (up to 60 rad/s in 99.9 % of the values), and whether rates and forces of a sensor that
    rests now and then agree, which shows a wrong unit, order, sign or clock of the rates.
    """
    yield from find_implausible_rates(block.t_ns, IMU_RATES_HZ)
    force, rests = force_at_rest(block.t_ns, block.columns["specific_force"])
    low, high = (1 - _REST_SPREAD, 1 + _REST_SPREAD) if rests else _MOVING_SPREAD
    if not low * NOMINAL_GRAVITY_MPS2 < force < high * NOMINAL_GRAVITY_MPS2:
        hint = next((text for (least, most), text in _HINTS if least <= force < most), "")
        where = " at rest" if rests else ""
        yield Implausible("accel", f"median magnitude {force:.3g}{where}", f"about 9.8 m/s²{hint}")
    if "angular_rate" in block.columns:
        fastest = float(np.percentile(np.abs(block.columns["angular_rate"]), 99.9))
        fault = find_rate_fault(block.t_ns, block.columns["specific_force"], block.columns["angular_rate"])
        if fastest > _FASTEST:
            is_known = fault is not None and fault.cause
            hint = f"probably {fault.cause}" if is_known and fault else "is it in °/s? Multiply by 0.0174533"
            yield Implausible("gyro", f"up to {fastest:.0f}", f"rad/s; {hint}")
        elif not np.ptp(block.columns["angular_rate"], axis=0).any() and force_sd(block) > _MOVING_SD:
            yield Implausible("gyro", "the same rates in all rows", "measured rates, as the forces change; is it on?")
        elif fault is not None and fault.cause:
            yield Implausible(
                "gyro",
                f"rates that leave {fault.misfit_mps2:.2g} m/s² of the forces over from one rest to the next",
                f"rates that agree with the forces, with {fault.corrected_mps2:.2g} m/s²; probably {fault.cause}",
            )


def force_sd(block: Block[Sample]) -> float:
    """Standard deviation of the magnitude of the specific force of an IMU, m/s²."""
    return float(np.linalg.norm(block.columns["specific_force"], axis=1).std())


def find_doubt(block: Block[Sample]) -> str:
    """What makes the samples of an IMU doubtful though no usual mistake explains it, for a warning; "" for nothing."""
    if "angular_rate" not in block.columns:
        return ""
    fault = find_rate_fault(block.t_ns, block.columns["specific_force"], block.columns["angular_rate"])
    if fault is None or fault.cause:
        return ""
    return (
        f"rates leave {fault.misfit_mps2:.2g} m/s² of the forces over from one rest to the next, much more than usual: "
        "the path may be wrong; were they filtered, turned to other axes, or recorded by another clock?"
    )


def find_implausible_depth(depths: Sequence[Array]) -> Iterator[Implausible]:
    """Yields an `Implausible` if depth images have another unit than metres, by the distances that a person sees.

    A worn or carried camera sees something beyond 0.6 m in most images, and most of it within 15 m. The advice is by
    how much the depth would have to be multiplied, of the factors by which usual units differ.

    Args:
        depths: Some images (H, W) of one camera, m; 0 where there is none.
    """
    valid = [depth[depth > 0.0] for depth in depths]
    far = [float(np.percentile(values, 95)) for values in valid if len(values)]
    if not far:
        return
    seen_m = float(np.median(far))  # that 95 % of an image's pixels are within
    if _LEAST_FAR_M <= seen_m <= _MOST_FAR_M:
        return
    factors = [f for f in _DEPTH_FACTORS if _LEAST_FAR_M <= f * seen_m <= _MOST_FAR_M]
    # of several the one that puts the far end nearest to 3 m
    factor = min(factors, key=lambda f: abs(math.log(f * seen_m / _USUAL_FAR_M)), default=None)
    advice = "" if factor is None else f"; with {factor:g} times the depth it would be {factor * seen_m:.2g} m"
    valid_range = f"{_LEAST_FAR_M:g} to {_MOST_FAR_M:g} m, as a person's camera sees"
    yield Implausible("depth", f"{seen_m:.2g} m within which 95 % of the pixels lie", f"{valid_range}{advice}")
