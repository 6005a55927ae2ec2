"""Plausibility checks: units, rates and gravity reveal an invalid file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2, STANDARD_GRAVITY_MPS2
from stridetwin.streams.motion_consistency import find_motion_fault, mean_force, measure_gravity
from stridetwin.streams.rate_consistency import find_rate_fault
from stridetwin.streams.rate_corrections import IN_DEGREES
from stridetwin.streams.row_patterns import QUANTITIES, count_jumps, find_frozen, find_held, find_lacking
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
_MOVING_SD_MPS2 = 1.0
"""Standard deviation of the force's magnitude from which on a sensor moves."""
_HELD_TOGETHER, _WITHOUT_GRAVITY = 0.7, 0.65
"""Least share of the median force that its turned mean has, unless the rates are wrong; and share of gravity that the
mean over 1 s does not reach where gravity was taken out."""
_FEW_ROWS = 0.01
"""Share of rows that are no measurements from which on an estimate suffers."""
_FASTEST = 60.0
"""Largest plausible rate, rad/s: 3400 °/s, beyond what foot-worn gyros measure."""
_LEAST_FAR_M, _MOST_FAR_M, _USUAL_FAR_M = 0.6, 15.0, 3.0
"""Least, largest and most likely distance within which 95 % of an image's pixels lie, m."""
DEPTH_SCALE = "--depth-scale"
"""Option that gives the units of a folder's depth images per metre."""
DEPTH_UNITS = "depth_units_per_metre"
"""Key of these units, as they were read, in the metadata of a recording."""
_DEPTH_FACTORS = (5.0, 0.2, 10.0, 0.1, 2.0, 0.5, 1000.0, 0.001)
"""Factors between usual units of depth: 1/5000, 1/1000, 1/10000 and 1/2000 m, mm and m."""
_NO_GRAVITY = "; has gravity been taken out? It must be the raw specific force"
"""End of a message about forces that are too small, or have no direction that stays."""
_HINTS = (
    ((0.8, 1.2), f"; is it in g? Multiply by {STANDARD_GRAVITY_MPS2}"),
    ((800.0, 1200.0), f"; is it in milli-g? Multiply by {STANDARD_GRAVITY_MPS2 / 1000}"),
    ((85.0, 110.0), "; is it in m/s², and was taken for g?"),
    ((8_000.0, 12_000.0), "; is it in mg or mm/s², and was taken for g or m/s²? Multiply mm/s² by 0.001"),
    ((28.0, 36.0), "; is it in ft/s²? Multiply by 0.3048"),
    ((0.0, 5.0), _NO_GRAVITY),
    ((200.0, math.inf), "; are they raw counts? Divide them by those of 1 g in the data sheet"),
    ((5.0, math.inf), "; were the forces multiplied by the factor of another range, or are they raw counts?"),
)
"""What may be wrong with a median force, by the range of its number; the first range that fits counts."""


@dataclass(frozen=True)
class Implausible:
    """An implausible quantity.

    Attributes:
        field: The quantity.
        value: Its value.
        valid: Plausible values.
        is_error: Whether it would spoil an estimate; otherwise it is worth a warning.
    """

    field: str
    value: str
    valid: str
    is_error: bool = True

    def __str__(self) -> str:
        """What is wrong as one line: quantity, value and plausible values."""
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
    """Yields what is implausible in the samples of an IMU or an accelerometer, as wrong units and lost rows cause.

    Checked are the sample rate, the magnitude of the specific force (gravity ± 15 % at rest, 0.5 to 2 times gravity in
    motion, and gravity ± 15 % after the rates have turned it to fixed axes), the angular rate (up to 60 rad/s in
    99.9 % of the values), and whether rates and forces agree, from one rest to the next or by the speed that they leave
    over, which shows a wrong unit, order, sign or clock of the rates; and rows that are not measured, repeated or lost.
    """
    yield from find_implausible_rates(block.t_ns, IMU_RATES_HZ)
    faults = [*_find_implausible_forces(block)]
    yield from faults
    if not faults and "angular_rate" in block.columns:  # wrong forces tell nothing of the rates
        yield from _find_implausible_turning(block)
    yield from _find_implausible_rows(block)


def _find_implausible_forces(block: Block[Sample]) -> Iterator[Implausible]:
    """Yields an `Implausible` if the forces are not about gravity at rest, in motion, or turned to fixed axes."""
    force, rests = force_at_rest(block.t_ns, block.columns["specific_force"])
    low, high = (1 - _REST_SPREAD, 1 + _REST_SPREAD) if rests else _MOVING_SPREAD
    if not low * NOMINAL_GRAVITY_MPS2 < force < high * NOMINAL_GRAVITY_MPS2:
        hint = next((text for (least, most), text in _HINTS if least <= force < most), "")
        where = " at rest" if rests else ""
        yield Implausible("accel", f"median magnitude {force:.3g}{where}", f"about 9.8 m/s²{hint}")
    elif "angular_rate" in block.columns and not rests:
        yield from _find_implausible_gravity(block)


def _find_implausible_gravity(block: Block[Sample]) -> Iterator[Implausible]:
    """Yields an `Implausible` if the mean force of an IMU without rests, turned by the rates, is not gravity."""
    t_ns, force, rate = block.t_ns, block.columns["specific_force"], block.columns["angular_rate"]
    gravity = measure_gravity(t_ns, force, rate)
    if gravity is None or abs(gravity / NOMINAL_GRAVITY_MPS2 - 1) <= _REST_SPREAD:
        return
    magnitude = float(np.median(np.linalg.norm(force, axis=1)))
    if gravity > _HELD_TOGETHER * magnitude:
        ratio = gravity / NOMINAL_GRAVITY_MPS2
        hint = f"; were the forces multiplied by {ratio:.2g}, as with the factor of another range?"
    elif mean_force(t_ns, force) < _WITHOUT_GRAVITY * NOMINAL_GRAVITY_MPS2:
        hint = _NO_GRAVITY
    else:  # rates that turn the forces in all directions, which are judged elsewhere
        return
    yield Implausible("accel", f"mean of {gravity:.3g} once the rates have turned it", f"about 9.8 m/s²{hint}")


def _find_implausible_turning(block: Block[Sample]) -> Iterator[Implausible]:
    """Yields an `Implausible` if the rates of an IMU are too fast for a person, or contradict its forces."""
    t_ns, force, rate = block.t_ns, block.columns["specific_force"], block.columns["angular_rate"]
    if not np.ptp(rate, axis=0).any() and float(np.linalg.norm(force, axis=1).std()) > _MOVING_SD_MPS2:
        yield Implausible("gyro", "the same rates in all rows", "measured rates, as the forces change; is it on?")
        return
    fastest = float(np.percentile(np.abs(rate), 99.9))
    fault = find_rate_fault(t_ns, force, rate)
    motion = find_motion_fault(t_ns, force, rate) if fault is None else None
    cause = fault.cause if fault is not None else motion.cause if motion is not None else ""
    if fastest > _FASTEST:
        hint = f"probably {cause}" if cause and cause != IN_DEGREES else "is it in °/s? Multiply by 0.0174533"
        yield Implausible("gyro", f"up to {fastest:.0f}", f"rad/s; {hint}")
    elif fault is not None and not fault.cause:
        yield Implausible(
            "gyro",
            f"rates that leave {fault.misfit_mps2:.2g} m/s² of the forces over from one rest to the next, much more "
            "than usual, so that the path may be wrong",
            "rates that agree with the forces; were they filtered, turned to other axes, or recorded by another clock?",
            is_error=False,
        )
    elif fault is not None:
        yield Implausible(
            "gyro",
            f"rates that leave {fault.misfit_mps2:.2g} m/s² of the forces over from one rest to the next",
            f"rates that agree with the forces, with {fault.corrected_mps2:.2g} m/s²; probably {cause}",
        )
    elif motion is not None:
        yield Implausible(
            "gyro",
            f"rates that turn the forces so that a speed of {motion.speed_mps:.2g} m/s is left over",
            f"rates that agree with the forces, with {motion.corrected_mps:.2g} m/s; probably {cause}",
        )


def _find_implausible_rows(block: Block[Sample]) -> Iterator[Implausible]:
    """Yields an `Implausible` for rows that are not measured, that repeat the row before, or that are missing."""
    if not all(np.isfinite(values).all() for values in block.columns.values()):
        return  # is reported elsewhere
    for column, lacking in find_lacking(block.columns).items():
        yield Implausible(
            f"rows of {QUANTITIES[column]}",
            f"zeros or a fill value in {int(lacking.sum())} of {len(lacking)} rows, unlike the rows around",
            "a measurement in each row; does the driver write rows without one?",
            is_error=float(lacking.mean()) > _FEW_ROWS,
        )
    frozen = find_frozen(block.columns)
    for column in ("specific_force", "angular_rate"):
        if column in block.columns and not frozen.any():
            frozen = find_held(block.columns[column])
    if frozen.any():
        yield Implausible(
            "rows",
            f"the numbers of the row before in {int(frozen.sum())} of {len(frozen)} rows in motion",
            "a measurement in each row; does the driver repeat the last one where it has none?",
            is_error=float(frozen.mean()) > _FEW_ROWS,
        )
    if "angular_rate" in block.columns:
        jumps = count_jumps(block.t_ns, block.columns["specific_force"], block.columns["angular_rate"])
        if jumps:
            yield Implausible(
                "rows",
                f"{jumps} steps in which rates and forces both go on as if rows were missing, which no stamp shows",
                "a stamp of its own for each row; were packets lost, and the stamps counted or made even?",
                is_error=False,
            )


def find_implausible_depth(depths: Sequence[Array], per_metre: float | None = None) -> Iterator[Implausible]:
    """Yields an `Implausible` if depth images have another unit than metres, by the distances that a person sees.

    A worn or carried camera sees something beyond 0.6 m in most images, and most of it within 15 m. The advice is by
    how much the depth would have to be multiplied, of the factors by which usual units differ.

    Args:
        depths: Some images (H, W) of one camera, m; 0 where there is none.
        per_metre: Units per metre with which they were read; None if no option gives them.
    """
    valid = [depth[depth > 0.0] for depth in depths]
    far = [float(np.percentile(values, 95)) for values in valid if len(values)]
    if not far:
        return
    distance_m = float(np.median(far))  # that 95 % of an image's pixels are within
    if _LEAST_FAR_M <= distance_m <= _MOST_FAR_M:
        return
    advice = advise_depth_unit(distance_m, (_LEAST_FAR_M, _MOST_FAR_M), _USUAL_FAR_M, per_metre)
    valid_range = f"{_LEAST_FAR_M:g} to {_MOST_FAR_M:g} m, as a person's camera sees"
    yield Implausible("depth", f"{distance_m:.2g} m within which 95 % of the pixels lie", f"{valid_range}{advice}")


def advise_depth_unit(distance_m: float, valid_m: tuple[float, float], usual_m: float, per_metre: float | None) -> str:
    """What to do about depth that makes a distance implausible, as the end of a message; "" without any advice.

    Args:
        distance_m: The distance.
        valid_m: Least and largest plausible one.
        usual_m: The most likely one, to which the advice leads as nearly as a usual unit allows.
        per_metre: Units per metre with which the depth was read; None if no option gives them.
    """
    factors = [f for f in _DEPTH_FACTORS if valid_m[0] <= f * distance_m <= valid_m[1]]
    if not factors:
        return ""
    factor = min(factors, key=lambda f: abs(math.log(f * distance_m / usual_m)))
    advice = f"; with {factor:g} times the depth it would be {factor * distance_m:.2g} m"
    return f"{advice}, {name_depth_option(factor, per_metre)}"


def name_depth_option(factor: float, per_metre: float | None) -> str:
    """The option with which the depth is multiplied by a factor, as text.

    Args:
        factor: By which the depth is to be multiplied.
        per_metre: Units per metre with which it was read; None if the messages of a bag have a unit of their own.
    """
    if per_metre is None:
        return f"by {DEPTH_SCALE} in units per metre (messages in 16UC1 should be in mm, in 32FC1 in m)"
    return f"{DEPTH_SCALE} {per_metre / factor:.4g} in place of {per_metre:g}"
