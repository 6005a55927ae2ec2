"""The vertical from level ground: floors, treads and landings are level as built, ramps clearly are not.

At rest and on a straight walk an accelerometer bias looks like a tilt: 10 mg are 10 mrad, and a height error of 1 % of
the distance. Vision finds the path relative to the camera, so a path is as level as the camera's vertical. The depth
image shows the ground's normal in the camera to about a milliradian. Ground that is level within the present
uncertainty is therefore a measurement of the camera's tilt; anything steeper is not used, but at the start, where it
shows a mount that is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from stridetwin.estimators.dvio.mount_prior import MountPrior
from stridetwin.estimators.dvio.optimiser import fix_first_estimate
from stridetwin.estimators.dvio.state import CALIBRATION, D_ATTITUDE, D_ATTITUDE_IC, FRAME, WindowState
from stridetwin.streams.algebra.arrays import hat
from stridetwin.streams.samples import Array

# Hand-chosen on tuning seeds unless an origin is given.
SPACING_M = 1.0
"""Between two observations: those of the same ground are not independent."""
_HUBER_SD = 1.5  # a slope beyond this many standard deviations is down-weighted
# Largest squared Mahalanobis distance of a slope from level: 1 % of level ground exceeds it; and for the ground of the
# start, before any other, as people rarely start on a ramp.
_MAX_MISFIT, _MAX_START_MISFIT = 9.2, 13.8
# Anything steeper is a ramp (wheelchair ramps begin at 1:20, 50 mrad); and the same for the ground of the start.
_MAX_SLOPE_RAD, _MAX_START_SLOPE_RAD = 0.035, 0.042
_MAX_MOUNT_SLOPE_RAD = 0.12  # gentler ground at the start that is no error of the tilt shows a mount that is off
START_MOUNT_SD_RAD = 0.016
"""How well it is known that way, the tilt included: walking measures it better within a metre."""
_MAX_START_SCATTER_RAD = 0.008  # planes of the start that agree less well may include a ramp
_MAX_TILT_SD_RAD = 0.02  # while the camera's tilt is less certain, a ramp could be mistaken for level ground


class LevelGround:
    """Uses level ground as a measurement of the camera's tilt, once per stretch of the path.

    Args:
        ground_sd_rad: How level ground is as built: standard deviation, rad.
        used: Whether it is used at all.
    """

    def __init__(self, ground_sd_rad: float, *, used: bool) -> None:
        """`ground_sd_rad` is how level ground is as built, rad; `used` is whether it is used at all."""
        self._ground_sd_rad, self._used = ground_sd_rad, used
        # (3,) m, where level ground was used last; None: not yet in this window
        self._p_last: Array | None = None

    def restart(self) -> None:
        """Begins a new window: the next level ground is used wherever it is."""
        self._p_last = None

    def is_due(self, p_imu_in_world: Array) -> bool:
        """Whether level ground seen from a position (3,), m, is independent of the last one used.

        True once per `SPACING_M` of path, and never if level ground is not used.
        """
        last = self._p_last
        return self._used and (last is None or float(np.linalg.norm(p_imu_in_world - last)) >= SPACING_M)

    def observe(
        self, window: WindowState, L: Array, slot: int, measured: Array, weights: Array, mount: MountPrior
    ) -> None:
        """Adds one measurement of the tilt from the level planes that the frame in a slot sees.

        Planes that may be ramps are left out. At the start, planes that are too steep for an error of the tilt measure
        the mount instead, and the prior of the mount widens.

        Args:
            window: The sliding window, whose prior receives the measurement.
            L: Cholesky factor of the window's normal equations.
            slot: Slot of the frame.
            measured: (P, 3) planes in 1/m of `read_planes`.
            weights: (P, 3, 3) inverses of their covariances.
            mount: Prior of the mount.
        """
        if not len(measured):
            return
        sd_rad = self._ground_sd_rad  # how level ground is as built
        # of the errors that a slope depends on; the frame in the slot is the newest, so all states are in the equations
        covariance = covariance_of(slope_columns(slot), L, CALIBRATION + FRAME * (slot + 1))
        # none was used yet in this window, and the IMU is still near the world's origin, where the odometry began
        at_start = self._p_last is None and float(np.linalg.norm(window.frames.p[slot])) < SPACING_M
        slopes = [slope_of(window, slot, *plane) for plane in zip(measured, weights)]
        level = [slope for slope in slopes if level_weight(slope, covariance, sd_rad, at_start=at_start)]
        if not level:  # ramps, or a mount that is off, which only the ground of the start may show
            mount_slope = start_slope(slopes, covariance) if at_start else None
            if mount_slope and mount.widen(window):
                self._add_slope(window, slot, mount_slope, START_MOUNT_SD_RAD**-2)
            return
        # one measurement: the mean of all planes that may be level, if it may be level itself
        common = mean_slope(level, [misfit(slope, covariance, sd_rad) for slope in level])
        if weight := level_weight(common, covariance, sd_rad, at_start=at_start):
            self._add_slope(window, slot, common, weight)

    def _add_slope(self, window: WindowState, slot: int, slope: Slope, weight: float) -> None:
        """Adds a slope of a weight, 1/rad², to the window's prior, and notes where the frame saw it."""
        add_level(window, slot, slope, weight)
        self._p_last = window.frames.p[slot].copy()


class Slope(NamedTuple):
    """The ground's slope in the world of the odometry, which is 0 for level ground and a true vertical.

    Attributes:
        r: (2,) horizontal part of its unit normal, rad.
        J: (2, 6) derivative by the errors of the camera's attitude on the IMU and of the frame's attitude.
        variance: Variance of the components of `r` as measured, rad².
    """

    r: Array
    J: Array
    variance: float = 0.0


def slope_of(window: WindowState, slot: int, measured: Array, weight: Array | None = None) -> Slope:
    """Slope of a plane seen by the frame in a slot, with derivative and variance: docs/dvio.md (12).

    Args:
        window: Frames and calibration.
        slot: Slot of the frame.
        measured: (3,) plane in 1/m, as `read_planes` returns it.
        weight: (3, 3) inverse of its covariance; None means exact.
    """
    c, R = window.calibration, window.frames.R[slot]
    # The plane was read with the nominal focal lengths; `m` is its unit normal in the camera by the estimated ones.
    scale = np.array([1.0 / (1.0 + c.focal[0]), 1.0 / (1.0 + c.focal[1]), 1.0])
    m = measured * scale
    size = float(np.linalg.norm(m))
    m = m / size
    in_imu = c.R @ m  # the normal in the IMU's axes
    variance = 0.0
    if weight is not None:
        # (2, 3) derivative of the slope by the measured plane; the variance is the mean of both components
        by_plane = (R @ c.R)[:2] @ (np.eye(3) - np.outer(m, m)) * scale / size
        variance = 0.5 * float(np.trace(by_plane @ np.linalg.solve(weight, by_plane.T)))
    by_mount, by_attitude = -(R @ c.R @ hat(m))[:2], -(R @ hat(in_imu))[:2]
    return Slope(r=(R @ in_imu)[:2], J=np.hstack([by_mount, by_attitude]), variance=variance)


def misfit(slope: Slope, covariance: Array, ground_sd_rad: float) -> float:
    """Squared Mahalanobis distance rᵀ (J P Jᵀ + σ² I)⁻¹ r of a slope r from level.

    σ² is the variance of the measured slope and of level ground as built.

    Args:
        slope: Slope of the ground.
        covariance: (6, 6) P of the errors that the slope depends on, rad².
        ground_sd_rad: How level ground is as built.
    """
    spread = slope.J @ covariance @ slope.J.T + (ground_sd_rad**2 + slope.variance) * np.eye(2)
    return float(slope.r @ np.linalg.solve(spread, slope.r))


def is_tilt_known(slope: Slope, covariance: Array) -> bool:
    """Whether the camera's tilt is certain enough to tell level ground from a ramp.

    Args:
        slope: Slope of the ground, whose derivative projects the covariance.
        covariance: (6, 6) of the errors that the slope depends on, rad².
    """
    tilt_covariance = slope.J @ covariance @ slope.J.T  # (2, 2) rad², of the slope's two components
    return bool(np.trace(tilt_covariance) <= 2.0 * _MAX_TILT_SD_RAD**2)


def mean_slope(slopes: Sequence[Slope], misfits: Sequence[float]) -> Slope:
    """Weighted mean of the slopes of level planes in one image, as uncertain as they scatter.

    A depth image often shows one floor as several planes, of which a single one may be a degree off or a gentle ramp.
    So each counts by its likelihood as level ground, too.

    Args:
        slopes: Slopes of N planes, N ≥ 1.
        misfits: (N,) squared Mahalanobis distances of the slopes from level, see `misfit`; 0 for equal likelihood.

    Returns:
        The mean of slopes and derivatives; its variance is that of the slopes, plus their scatter.
    """
    # the likelihood as level ground, over the variance
    weight = np.exp(-0.5 * np.array(misfits)) / np.array([slope.variance for slope in slopes])
    weight /= weight.sum()
    r = weight @ np.array([slope.r for slope in slopes])
    scatter = 0.5 * float(sum(w * np.sum((slope.r - r) ** 2) for w, slope in zip(weight, slopes)))
    J = np.tensordot(weight, np.array([slope.J for slope in slopes]), 1)
    return Slope(r=r, J=J, variance=scatter + float(weight @ [slope.variance for slope in slopes]))


def level_weight(slope: Slope, covariance: Array, ground_sd_rad: float, *, at_start: bool = False) -> float:
    """Weight of a slope as level ground, 1/rad²; 0 where it may be a ramp.

    The weight is 1/σ² of the slope and of level ground as built together, less by Huber's rule for slopes beyond
    `_HUBER_SD`.

    Args:
        slope: Slope of the ground.
        covariance: (6, 6) of the errors that the slope depends on, rad².
        ground_sd_rad: How level ground is as built.
        at_start: Whether the ground is that of the start, where the limits are wider.
    """
    steepest = _MAX_START_SLOPE_RAD if at_start else _MAX_SLOPE_RAD
    if not is_tilt_known(slope, covariance) or slope.r @ slope.r > steepest**2:
        return 0.0
    square = misfit(slope, covariance, ground_sd_rad)  # in variances
    if square > (_MAX_START_MISFIT if at_start else _MAX_MISFIT):
        return 0.0
    return min(1.0, _HUBER_SD / max(square**0.5, 1e-9)) / (ground_sd_rad**2 + slope.variance)


def start_slope(slopes: Sequence[Slope], covariance: Array) -> Slope | None:
    """Slope of the ground of the start where it is too steep for an error of the tilt: the mount is off.

    People rarely start on a ramp. If they do, walking measures the mount anew within a metre, and no tilt is wrong: so
    the slope depends on the mount alone here. None if there is no such ground, or its planes differ.

    Args:
        slopes: Slopes of all planes.
        covariance: (6, 6) of the errors that they depend on, rad².
    """
    gentle = [slope for slope in slopes if slope.r @ slope.r < _MAX_MOUNT_SLOPE_RAD**2]  # others are too steep
    if not gentle or not is_tilt_known(gentle[0], covariance):
        return None
    common = mean_slope(gentle, [0.0] * len(gentle))  # equal likelihoods: none of them looks level
    common.J[:, 3:] = 0.0  # no dependence on the frame's attitude
    return common if common.variance < _MAX_START_SCATTER_RAD**2 else None


def slope_columns(slot: int) -> NDArray[np.int64]:
    """(6,) indices, among all states, of the errors that a slope depends on: mount rotation and frame attitude."""
    attitude = CALIBRATION + FRAME * slot + D_ATTITUDE
    return np.r_[D_ATTITUDE_IC : D_ATTITUDE_IC + 3, attitude : attitude + 3]


def covariance_of(indices: NDArray[np.int64], L: Array, size: int) -> Array:
    """(K, K) covariance of selected states, by a triangular solve with the Cholesky factor.

    Args:
        indices: (K,) indices of the states.
        L: Lower Cholesky factor of the normal equations.
        size: Number of states in the equations.
    """
    # selected columns of the identity E: the covariance is Eᵀ (L Lᵀ)⁻¹ E = (L⁻¹ E)ᵀ (L⁻¹ E)
    unit = np.zeros((size, len(indices)))
    unit[indices, range(len(indices))] = 1.0
    Y: Array = solve_triangular(L[:size, :size], unit, lower=True, check_finite=False)
    return np.asarray(Y.T @ Y)


def add_level(window: WindowState, slot: int, slope: Slope, weight: float) -> None:
    """Adds level ground, of a weight in 1/rad², to the prior of a frame and of the calibration: docs/dvio.md (12).

    H += w JᵀJ and b += w Jᵀ(J x − r), where x is the deviation of the states from the prior's linearisation point. If
    the prior does not contain the frame yet, it does afterwards, with the present state as its first estimate.

    Args:
        window: The sliding window, whose prior changes.
        slot: Slot of the frame that saw the ground.
        slope: Slope of the ground, which should be 0.
        weight: Weight w, 1/rad².
    """
    f, prior, at = window.frames, window.prior, slope_columns(slot)  # at: (6,) rows of the prior
    if not f.in_prior[slot]:
        fix_first_estimate(window, slot)
    # x: deviation of mount rotation and attitude from the prior's linearisation point
    moved = np.concatenate(
        [window.calibration.moved[D_ATTITUDE_IC : D_ATTITUDE_IC + 3], f.moved[slot, D_ATTITUDE : D_ATTITUDE + 3]]
    )
    JtW = weight * slope.J.T
    prior.H[np.ix_(at, at)] += JtW @ slope.J
    prior.b[at] += JtW @ (slope.J @ moved - slope.r)
