"""Lever arm of a camera on its IMU, and its focal length: with which of them does the IMU explain the motion?

The equations are those of `camera_motion`; intervals come from a jackknife over the parts (Efron and Tibshirani 1993,
An Introduction to the Bootstrap, 11.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.scenarios.camera_clock import student_quantile
from stridetwin.scenarios.camera_motion import MotionPart, Quadratic
from stridetwin.streams.samples import Array

LEVER_OFF_M = 0.1
"""Error of the lever arm that a calibration may have, m: what the housing of one device spans."""
FACTORS = np.geomspace(0.6, 1.7, 15)
"""Multiples of the calibrated focal length that are compared."""
_MIN_PARTS = 6
_MODEL_SD_M = 0.02  # of an axis: depth noise that depends on the motion
_DEPTH_SHARE = 0.02  # of the depth: along the line of sight, an error of the focal length looks like a lever arm
_MOST_HALF_WIDTH_M = 0.25  # half width up to which a direction counts
_ROUNDS, _OUTLIER = 3, 9.0  # of the fit without outliers, and the limit in multiples of the median cost


@dataclass(frozen=True, kw_only=True, eq=False)
class LeverArm:
    """Where a camera is on its IMU by their motion.

    Attributes:
        calibrated: (3,) m, position of the camera in the IMU's axes by the calibration.
        measured: (3,) m, by the motion.
        covariance: (3, 3) m², of the latter.
        freedom: Degrees of freedom of its interval.
        depth_scale: Common factor of the depths, by the motion.
    """

    calibrated: Array
    measured: Array
    covariance: Array
    freedom: int
    depth_scale: float

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
        """Whether they certainly differ by more than `LEVER_OFF_M`."""
        return self.off_m > LEVER_OFF_M

    @property
    def text(self) -> str:
        """Measured position with the half widths of its axes, as text: `(0.02 ± 0.03, ...) m`."""
        cells = [f"{value:.2f} ± {half:.2f}" for value, half in zip(self.measured, self.half)]
        return f"({', '.join(cells)}) m"


def estimate_lever(parts: Sequence[MotionPart], T_imu_cam: Array, depth_m: float) -> LeverArm | None:
    """The lever arm of a camera with depth on its IMU.

    Args:
        parts: Equations with its calibrated lens.
        T_imu_cam: (4, 4) calibrated pose on the IMU, whose rotation has to be right.
        depth_m: Median depth of the features.

    Returns:
        None with too few parts, or where the forces do not agree with the motion at all.
    """
    if len(parts) < _MIN_PARTS:
        return None
    sums = _sum_without_outliers(parts)
    total = _add_up(sums)
    solutions = np.array([total.solve(), *((total - one).solve() for one in sums)])
    if not (solutions[:, 0] > 0).all():
        return None
    arms = solutions[:, 1:] / solutions[:, :1]
    axis = T_imu_cam[:3, 2]  # the line of sight
    spread = (len(sums) - 1) * np.cov(arms[1:].T, ddof=0)
    covariance = spread + _MODEL_SD_M**2 * np.eye(3) + (_DEPTH_SHARE * depth_m) ** 2 * np.outer(axis, axis)
    return LeverArm(
        calibrated=T_imu_cam[:3, 3].copy(),
        measured=arms[0],
        covariance=covariance,
        freedom=len(sums) - 1,
        depth_scale=float(solutions[0, 0]),
    )


def estimate_factor(
    build: Callable[[float], Sequence[MotionPart]], calibrated: Array
) -> tuple[float, float, int] | None:
    """The multiple of the focal length with which the IMU explains the motion best.

    The lever arm is free, but `LEVER_OFF_M` from the calibrated one is unlikely.

    Args:
        build: Gives the equations of the parts for a multiple of the calibrated focal length.
        calibrated: (3,) m, calibrated position of the camera in the IMU's axes.

    Returns:
        The multiple, its standard deviation, and the number of parts; None with too few parts, or without a minimum.
    """
    by_factor = [build(factor) for factor in FACTORS]
    count = min(len(parts) for parts in by_factor)
    if count < _MIN_PARTS or any(len(parts) != count for parts in by_factor):
        return None
    terms = np.column_stack((-calibrated, np.eye(3))) / LEVER_OFF_M  # the lever arm's own equations
    likely = Quadratic(normal=terms.T @ terms, right=np.zeros(4), constant=0.0)
    weights = [np.ones(len(part.misfit)) for part in by_factor[0]]
    best = len(FACTORS) // 2
    for _ in range(_ROUNDS):
        sums = [[part.sum_up(weight) for part, weight in zip(parts, weights)] for parts in by_factor]
        totals = [_add_up(of_factor) + likely for of_factor in sums]
        costs = np.array([total.find_cost(total.solve()) for total in totals])
        best = int(np.argmin(costs))
        solution = totals[best].solve()
        weights = _weigh(by_factor[best], weights, solution)
    minimum = _find_minimum(costs)
    without = []
    for part in range(count):
        rest = [total - of_factor[part] for total, of_factor in zip(totals, sums)]
        without.append(_find_minimum(np.array([total.find_cost(total.solve()) for total in rest])))
    if minimum is None or any(value is None for value in without):
        return None
    logs = np.log(np.array(without, float))
    return minimum, minimum * math.sqrt((count - 1) * float(np.var(logs))), count


def _find_minimum(costs: Array) -> float | None:
    """Multiple of the focal length at the least of the costs (F,), by a parabola through it and its neighbours."""
    best = int(np.argmin(costs))
    if best in (0, len(costs) - 1):
        return None
    before, here, after = costs[best - 1 : best + 2]
    step = math.log(FACTORS[1] / FACTORS[0])
    return float(FACTORS[best] * math.exp(0.5 * step * (before - after) / (before - 2 * here + after + 1e-30)))


def _sum_without_outliers(parts: Sequence[MotionPart]) -> list[Quadratic]:
    """The cost of each part as a function of scale and lever arm, without pairs that fit much worse than others."""
    weights = [np.ones(len(part.misfit)) for part in parts]
    for _ in range(_ROUNDS):
        sums = [part.sum_up(weight) for part, weight in zip(parts, weights)]
        weights = _weigh(parts, weights, _add_up(sums).solve())
    return sums


def _weigh(parts: Sequence[MotionPart], weights: Sequence[Array], solution: Array) -> list[Array]:
    """Weights (K,) of the pairs of each part: next to nothing where they fit much worse than the median."""
    costs = [part.find_costs(solution, weight) - part.misfit for part, weight in zip(parts, weights)]
    most = _OUTLIER * float(np.median(np.concatenate(costs))) + 1e-12
    return [np.where(of_pairs <= most, 1.0, 1e-6) for of_pairs in costs]


def _add_up(sums: Sequence[Quadratic]) -> Quadratic:
    """The sum of some costs."""
    total = sums[0]
    for other in sums[1:]:
        total = total + other
    return total
