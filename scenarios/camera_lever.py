"""Lever arm of a camera on its IMU, and its focal length: with which of them does the IMU explain the motion?

The equations are those of `camera_motion`; intervals come from a jackknife over the parts (Efron and Tibshirani 1993,
An Introduction to the Bootstrap, 11.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.scenarios.camera_motion import ARM, READOUT, READOUT_UNIT_S, SCALE, UNKNOWNS, MotionPart, Quadratic
from stridetwin.scenarios.intervals import student_quantile
from stridetwin.streams.samples import Array

LEVER_OFF_M = 0.1
"""Error of the lever arm that a calibration may have, m: what the housing of one device spans."""
COARSE_FACTORS = np.geomspace(0.55, 1.82, 9)
"""Multiples of the calibrated focal length that are compared first."""
_FINE_FACTORS = np.array([0.95, 1.0, 1.05])
"""Multiples of the best of these that are compared then."""
_READOUT_SD_S, _CALIBRATED_READOUT_SD_S = 0.015, 0.002
"""Readout of a camera of which none is calibrated: 0 to 30 ms; and error of a calibrated one."""
_MIN_PARTS = 4
"""Fewest parts from which a lever arm or a focal length is estimated."""
_MODEL_SD_M = 0.02  # of an axis: depth noise that depends on the motion
_DEPTH_SHARE = 0.02  # of the depth: along the line of sight, an error of the focal length looks like a lever arm
_MOST_HALF_WIDTH_M = 0.25  # half width up to which a direction counts
_LEAST_GAIN = 30.0
"""Least squared residuals, in units of their noise, by which a wrong calibration must fit worse than the motion. Lever
arms that are 0.3 m off have over 100 in a dozen seconds; among people who walk about, a wrong one fits better by 2."""
_ROUNDS, _OUTLIER = 3, 9.0  # of the fit without outliers, and the limit in multiples of the median cost


@dataclass(frozen=True, kw_only=True, eq=False)
class LeverArm:
    """Where a camera is on its IMU by their motion.

    Attributes:
        calibrated: (3,) m, position of the camera in the IMU's axes by the calibration.
        measured: (3,) m, by the motion.
        covariance: (3, 3) m², of the latter.
        freedom: Degrees of freedom of its intervals.
        gain: Squared residuals, in units of their noise, that the calibrated position leaves beyond the measured one.
        depth_scale: Factor by which the measured depths are too large, by the motion.
        readout_s: Readout of the shutter, s, by the motion.
    """

    calibrated: Array
    measured: Array
    covariance: Array
    freedom: int
    gain: float
    depth_scale: float
    readout_s: float

    @property
    def half(self) -> Array:
        """(3,) half widths of the 95 % intervals of the axes, m."""
        return np.asarray(student_quantile(self.freedom) * np.sqrt(np.diag(self.covariance)))

    @property
    def off_m(self) -> float:
        """Largest distance that calibration and motion certainly differ by in a direction that the motion shows, m."""
        variances, directions = np.linalg.eigh(self.covariance)
        half = student_quantile(self.freedom) * np.sqrt(np.maximum(variances, 0.0))
        difference = np.abs(directions.T @ (self.measured - self.calibrated))
        return float(np.max(np.where(half < _MOST_HALF_WIDTH_M, difference - half, 0.0), initial=0.0))

    @property
    def is_off(self) -> bool:
        """Whether they certainly differ by more than `LEVER_OFF_M`, and the calibrated one fits clearly worse."""
        return self.off_m > LEVER_OFF_M and self.gain > _LEAST_GAIN

    @property
    def text(self) -> str:
        """Measured position with the half widths of its axes, as text: `(0.02 ± 0.03, ...) m`."""
        cells = [f"{value:.2f} ± {half:.2f}" for value, half in zip(self.measured, self.half)]
        return f"({', '.join(cells)}) m"


def estimate_lever(parts: Sequence[MotionPart], T_imu_cam: Array, depth_m: float, readout_s: float) -> LeverArm | None:
    """The lever arm of a camera with depth on its IMU.

    Args:
        parts: Equations with its calibrated lens.
        T_imu_cam: (4, 4) calibrated pose on the IMU, whose rotation has to be right.
        depth_m: Median depth of the features, m.
        readout_s: Calibrated readout of the shutter, s; 0 if it is unknown.

    Returns:
        The lever arm; None with too few parts, or where the forces do not agree with the motion at all.
    """
    if len(parts) < _MIN_PARTS:
        return None
    sums = _sum_without_outliers(parts)
    total = _add_up(sums) + _expect_readout(readout_s)
    solutions = np.array([total.solve(), *((total - one).solve() for one in sums)])
    if not (solutions[:, SCALE] > 0).all():
        return None
    arms = solutions[:, ARM] / solutions[:, [SCALE]]
    axis = T_imu_cam[:3, 2]  # the line of sight
    spread = (len(sums) - 1) * np.cov(arms[1:].T, ddof=0)
    covariance = spread + _MODEL_SD_M**2 * np.eye(3) + (_DEPTH_SHARE * depth_m) ** 2 * np.outer(axis, axis)
    return LeverArm(
        calibrated=T_imu_cam[:3, 3].copy(),
        measured=arms[0],
        covariance=covariance,
        freedom=len(sums) - 1,
        gain=_find_least_cost_of_arm(total, T_imu_cam[:3, 3]) - total.find_cost(solutions[0]),
        depth_scale=float(solutions[0, SCALE]),
        readout_s=float(solutions[0, READOUT]) * READOUT_UNIT_S,
    )


def estimate_focal_factor(
    build: Callable[[float], Sequence[MotionPart]], calibrated: Array, readout_s: float
) -> tuple[float, float, int] | None:
    """The multiple of the focal length with which the IMU explains the motion best.

    The lever arm is free, but `LEVER_OFF_M` from the calibrated one is unlikely.

    Args:
        build: Gives the equations of the parts for a multiple of the calibrated focal length.
        calibrated: (3,) m, calibrated position of the camera in the IMU's axes.
        readout_s: Calibrated readout of the shutter, s; 0 if it is unknown.

    Returns:
        The multiple, its standard deviation, and the number of parts; None with too few parts, or without a minimum.
    """
    likely = _expect_arm(calibrated) + _expect_readout(readout_s)
    coarse = _compare_factors(build, COARSE_FACTORS, likely)
    start = None if coarse is None else find_minimum(COARSE_FACTORS, coarse.costs)
    if start is None:
        return None
    factors = start * _FINE_FACTORS
    fine = _compare_factors(build, factors, likely)
    if fine is None:
        return None
    count = len(fine.sums[0])
    # the least cost without each of the parts
    without = [
        find_minimum(factors, np.array([_find_least_cost(total - sums[part]) for total, sums in fine.pairs]))
        for part in range(count)
    ]
    minimum = find_minimum(factors, fine.costs)
    known = [value for value in (minimum, *without) if value is not None]
    if minimum is None or len(known) <= count:
        return None
    return minimum, minimum * math.sqrt((count - 1) * float(np.var(np.log(known[1:])))), count


@dataclass(frozen=True, kw_only=True, eq=False)
class _FactorCosts:
    """Costs with F multiples of the focal length.

    Attributes:
        costs: (F,) least cost with each, over all unknowns.
        sums: F lists of the cost of each part as a function of the unknowns.
        totals: F sums of the costs of all parts and of what is known of the unknowns beforehand.
    """

    costs: Array
    sums: list[list[Quadratic]]
    totals: list[Quadratic]

    @property
    def pairs(self) -> Iterable[tuple[Quadratic, list[Quadratic]]]:
        """F pairs of the total and of the costs of the parts."""
        return zip(self.totals, self.sums)


def _compare_factors(
    build: Callable[[float], Sequence[MotionPart]], factors: Array, likely: Quadratic
) -> _FactorCosts | None:
    """Compares multiples (F,) of the focal length; pairs of images that do not fit even with the best one count little.

    Args:
        build: Gives the equations of the parts for a multiple.
        factors: The multiples.
        likely: Cost of values of the unknowns that are unlikely beforehand.

    Returns:
        The costs; None with too few parts, or where the features allow different pairs of images.
    """
    by_factor = [build(float(factor)) for factor in factors]
    sizes = {tuple(len(part.misfit) for part in parts) for parts in by_factor}
    if len(sizes) > 1 or len(by_factor[0]) < _MIN_PARTS:
        return None
    weights = [np.ones(len(part.misfit)) for part in by_factor[0]]
    for _ in range(_ROUNDS):
        sums = [[part.sum_up(weight) for part, weight in zip(parts, weights)] for parts in by_factor]
        totals = [_add_up(of_factor) + likely for of_factor in sums]
        costs = np.array([_find_least_cost(total) for total in totals])
        best = int(np.argmin(costs))
        weights = _weigh(by_factor[best], weights, totals[best].solve())
    return _FactorCosts(costs=costs, sums=sums, totals=totals)


def _find_least_cost(total: Quadratic) -> float:
    """The least cost over all unknowns."""
    return total.find_cost(total.solve())


def _find_least_cost_of_arm(total: Quadratic, arm: Array) -> float:
    """The least cost with a given lever arm (3,), m, over scale and readout."""
    # the unknowns by scale and readout: the second unknown is the arm times the scale
    mixing = np.zeros((UNKNOWNS, 2))
    mixing[SCALE, 0], mixing[ARM, 0], mixing[READOUT, 1] = 1.0, arm, 1.0
    values = np.linalg.lstsq(mixing.T @ total.normal @ mixing, mixing.T @ total.right, rcond=None)[0]
    return total.find_cost(mixing @ values)


def _expect_arm(calibrated: Array) -> Quadratic:
    """The cost of a lever arm that differs from the calibrated one (3,), m, by more than a device spans."""
    terms = np.zeros((3, UNKNOWNS))
    terms[:, SCALE], terms[:, ARM] = -calibrated / LEVER_OFF_M, np.eye(3) / LEVER_OFF_M
    return Quadratic(normal=terms.T @ terms, right=np.zeros(UNKNOWNS), constant=0.0)


def _expect_readout(readout_s: float) -> Quadratic:
    """The cost of a readout that differs from the calibrated one, s; 0 if that is unknown."""
    sd = (_CALIBRATED_READOUT_SD_S if readout_s else _READOUT_SD_S) / READOUT_UNIT_S
    normal, right = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    normal[READOUT, READOUT], right[READOUT] = sd**-2, readout_s / READOUT_UNIT_S * sd**-2
    return Quadratic(normal=normal, right=right, constant=(readout_s / READOUT_UNIT_S / sd) ** 2)


def find_minimum(factors: Array, costs: Array) -> float | None:
    """Multiple of the focal length at the least of the costs (F,), by a parabola in its logarithm.

    Args:
        factors: (F,) multiples, a geometric sequence.
        costs: (F,) their costs.

    Returns:
        The multiple; None if the least cost is at the end of more than three multiples, or the three costs around it do
        not curve upwards.
    """
    best = int(np.argmin(costs))
    if best in (0, len(costs) - 1) and len(costs) > 3:
        return None
    best = min(max(best, 1), len(costs) - 2)
    before, here, after = costs[best - 1 : best + 2]
    if not before - 2 * here + after > 0:
        return None
    step = 0.5 * math.log(factors[best + 1] / factors[best - 1])
    return float(factors[best] * math.exp(0.5 * step * (before - after) / (before - 2 * here + after)))


def _sum_without_outliers(parts: Sequence[MotionPart]) -> list[Quadratic]:
    """The cost of each part as a function of the unknowns, without pairs that fit much worse than others."""
    weights = [np.ones(len(part.misfit)) for part in parts]
    for _ in range(_ROUNDS):
        sums = [part.sum_up(weight) for part, weight in zip(parts, weights)]
        weights = _weigh(parts, weights, _add_up(sums).solve())
    return sums


def _weigh(parts: Sequence[MotionPart], weights: Sequence[Array], solution: Array) -> list[Array]:
    """New weights (K,) of the pairs of each part: next to nothing where they fit much worse than the median.

    Args:
        parts: The parts.
        weights: (K,) of each part, the weights that the solution was found with.
        solution: (5,) the unknowns.
    """
    costs = [part.find_costs(solution, weight) - part.misfit for part, weight in zip(parts, weights)]
    most = _OUTLIER * float(np.median(np.concatenate(costs))) + 1e-12
    return [np.where(of_pairs <= most, 1.0, 1e-6) for of_pairs in costs]


def _add_up(sums: Sequence[Quadratic]) -> Quadratic:
    """The sum of some costs."""
    total = sums[0]
    for other in sums[1:]:
        total = total + other
    return total
