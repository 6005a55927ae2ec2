"""Scale of a depth camera's motion against a motion that is measured otherwise.

The path of a camera that its depth images give is wrong by the factor of their unit, and a wrong focal length shortens
its sideways parts. It shows against a reference: given poses, or an IMU on the camera's body. An accelerometer knows no
start speed and no direction of gravity. Over a short run both are polynomials of the time, which are taken out of the
two paths, as are the biases (Martinelli, IEEE T-RO 28(1), 2012, and Qin et al., IEEE T-RO 34(4), 2018, V-B, solve for
them): what is left of a walk are the centimetres by which each step moves the head.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.scenarios.depth_tracks import CameraPath
from stridetwin.scenarios.inertial_path import DEGREE, InertialPath, build_polynomial_remover
from stridetwin.scenarios.intervals import student_quantile
from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.samples import Array
from stridetwin.streams.time_series import interpolate

SHIFTS_S = np.arange(-0.15, 0.1501, 0.01)
"""Shifts of the camera's clock against the IMU's that are tried, in addition to the calibrated one."""
_FEWEST_RUNS = 4
"""Runs from which a scale counts."""
_LEAST_CORRELATION = 0.75
"""Least correlation of both paths from which a scale counts."""
_LEAST_MOTION_M = 0.002
"""Least standard deviation of a run's path that counts as motion."""
_PATH_SD_M, _LEVER_SD_M = 0.005, 0.1
"""Standard deviations of a position by the images, and of the calibrated distance of camera and IMU: what an offset of
the camera could explain is no scale."""
_WEIGHT_ROUNDS = 3
"""Rounds of weighing the runs by what the scale leaves over."""
_LEAST_SD_M = 0.0005
"""Least standard deviation of a position by the images."""
_MODEL_SD_LOG = 0.015
"""Error that the runs share: scale of an uncalibrated accelerometer, and of depth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A run's path by the camera and by the reference, without what the reference does not know.

    Attributes:
        seen_m: (K, 3) camera's path by its images, in the camera's axes at the run's first image.
        reference_m: (K, 3) the same by the reference, in the same axes.
        lever: (K, 3, 3) change of `reference_m` per metre by which the camera is displaced along each of its own axes;
            0 for given poses.
    """

    seen_m: Array
    reference_m: Array
    lever: Array


@dataclass(frozen=True, kw_only=True)
class LogRatio:
    """Natural logarithm of a ratio, with an interval.

    Attributes:
        value: The logarithm.
        half: Half width of its 95 % interval; infinite where nothing is known.
    """

    value: float
    half: float

    @property
    def ratio(self) -> float:
        """The ratio."""
        return math.exp(self.value)

    def is_beyond(self, margin: float) -> bool:
        """Whether the interval lies entirely beyond a margin (a logarithm) on either side."""
        return abs(self.value) - self.half > margin

    def is_within(self, margin: float) -> bool:
        """Whether the interval lies entirely within a margin (a logarithm) on both sides."""
        return abs(self.value) + self.half < margin

    def combine(self, other: LogRatio) -> LogRatio:
        """The mean of two estimates by their weights; the more certain one if they contradict each other."""
        if math.isinf(self.half) or math.isinf(other.half) or not self.agrees(other, 1.5):
            return min(self, other, key=lambda ratio: ratio.half)
        weights = 1.0 / self.half**2, 1.0 / other.half**2
        value = (weights[0] * self.value + weights[1] * other.value) / sum(weights)
        return LogRatio(value=value, half=1.0 / math.sqrt(sum(weights)))

    def agrees(self, other: LogRatio, margin: float = 1.0) -> bool:
        """Whether both allow the same value, in multiples of the half width of their difference's interval."""
        return abs(self.value - other.value) <= margin * math.hypot(self.half, other.half)

    def contains(self, value: float) -> bool:
        """Whether a logarithm is in the interval."""
        return abs(self.value - value) <= self.half


@dataclass(frozen=True, kw_only=True)
class MotionScale:
    """Scale of a camera's motion against a reference.

    Attributes:
        path: Length of the camera's path over that of the reference: the factor by which its depths are too large.
        sideways: The same across the optical axis of the run's first image.
        focal: Calibrated focal length over the one with which both parts of the path have one scale.
        correlation: Of both paths, 1 where they agree but for the scale.
        runs: Number of runs.
    """

    path: LogRatio
    sideways: LogRatio
    focal: LogRatio
    correlation: float
    runs: int

    def is_beyond(self, margin: float) -> bool:
        """Whether the path or its sideways part is certainly wrong by more than a margin (a logarithm)."""
        return self.path.is_beyond(margin) or self.sideways.is_beyond(margin)

    @property
    def is_usable(self) -> bool:
        """Whether the paths agree well enough for a scale."""
        return self.correlation > _LEAST_CORRELATION


def compare_with_imu(path: CameraPath, inertial: InertialPath, T_imu_camera: Array, shift_s: float) -> Run:
    """The camera's path by its images and by an IMU on its body, both without a polynomial of time (`DEGREE`).

    Args:
        path: By the images.
        inertial: By the IMU; it covers the images' times.
        T_imu_camera: (4, 4) m, pose of the camera in the IMU's frame.
        shift_s: t_imu = t_camera + shift, s.
    """
    t = (inertial.t_ns - inertial.t_ns[0]) * 1e-9
    at = (path.t_ns - inertial.t_ns[0]) * 1e-9 + shift_s
    R = exp(interpolate(at, t, inertial.rotation_rad))
    p = interpolate(at, t, inertial.p_imu_in_start) + R @ T_imu_camera[:3, 3]
    R_start_camera = R @ T_imu_camera[:3, :3]
    reference = p @ R_start_camera[0]  # in the axes of the first image
    R_first_camera = R_start_camera[0].T @ R_start_camera
    without_polynomial = build_polynomial_remover(at, DEGREE)
    return Run(
        seen_m=without_polynomial(path.p_camera_in_first),
        reference_m=without_polynomial(reference),
        lever=without_polynomial(R_first_camera.reshape(-1, 9)).reshape(-1, 3, 3),
    )


def compare_with_poses(path: CameraPath, T_world_camera: Array) -> Run:
    """The camera's path by its images and by given poses, both in the camera's axes at the first image.

    Args:
        path: By the images.
        T_world_camera: (K, 4, 4) m, given poses of the camera at the images' times.
    """
    T = np.linalg.inv(T_world_camera[0]) @ T_world_camera
    return Run(seen_m=path.p_camera_in_first, reference_m=T[:, :3, 3], lever=np.zeros((len(T), 3, 3)))


def correlate(runs: Sequence[Run]) -> float:
    """Correlation (-1 to 1) of the paths by camera and reference over some runs; 0 without any motion."""
    across = sum(float(np.sum(run.seen_m * run.reference_m)) for run in runs)
    seen = sum(float(np.sum(run.seen_m**2)) for run in runs)
    reference = sum(float(np.sum(run.reference_m**2)) for run in runs)
    return across / math.sqrt(seen * reference + 1e-30)


def fit_motion_scale(runs: Sequence[Run]) -> MotionScale | None:
    """Scale of the motion by some runs, with intervals from a jackknife over them.

    The camera's path is compared with the reference by least squares of the former on the latter, because only the
    former is noisy.

    Returns:
        The scale; None with too few runs in which the reference moves.
    """
    moving = [run for run in runs if np.sqrt(np.mean(np.sum(run.reference_m**2, axis=1))) > _LEAST_MOTION_M]
    if len(moving) < _FEWEST_RUNS:
        return None
    # (R, 5, 5) sums of products over each run: of all axes, and of those across the optical axis
    all_axes = np.array([_multiply_columns(run.seen_m, run.reference_m, run.lever) for run in moving])
    across = np.array([_multiply_columns(r.seen_m[:, :2], r.reference_m[:, :2], r.lever[:, :2]) for r in moving])
    weights = _weigh(moving, all_axes)[:, None, None]
    products = np.sum(weights * all_axes, axis=0)
    # (R, 2, 5, 5) those along the optical axis, and those across it
    parts = np.stack((weights * (all_axes - across), weights * across), axis=1)
    return MotionScale(
        path=jackknife(weights * all_axes, _solve_scale_log),
        sideways=jackknife(weights * across, _solve_scale_log),
        focal=jackknife(parts, lambda sums: _solve_scale_log(sums[0]) - _solve_scale_log(sums[1])),
        correlation=float(products[0, 4] / math.sqrt(products[0, 0] * products[4, 4] + 1e-30)),
        runs=len(moving),
    )


def _weigh(runs: Sequence[Run], equations: Array) -> Array:
    """(R,) weights of R runs, of mean 1: inverse variances of the camera's positions by what the scale leaves over.

    Args:
        runs: The runs.
        equations: (R, 5, 5) of their paths, see `_solve_scale_log`.
    """
    weights = np.ones(len(runs))
    for _ in range(_WEIGHT_ROUNDS):
        scale_log = _solve_scale_log(np.tensordot(weights, equations, axes=1))
        if math.isnan(scale_log):
            return np.ones(len(runs))
        scale = math.exp(scale_log)
        least = (scale * _LEAST_SD_M) ** 2
        variances = np.array([np.mean((run.seen_m - scale * run.reference_m) ** 2) + least for run in runs])
        weights = 1.0 / variances
        weights /= weights.mean()
    return weights


def _solve_scale_log(equations: Array) -> float:
    """Logarithm of the length of the camera's path over that of the reference; NaN if the camera does not follow it.

    Args:
        equations: (5, 5) sum of the products of the columns reference, offsets of the camera, and camera.
    """
    regularised = equations[:4, :4] + np.diag([1e-12, *3 * [_PATH_SD_M**2 / _LEVER_SD_M**2]])
    scale = float(np.linalg.solve(regularised, equations[:4, 4])[0])
    return math.log(scale) if scale > 0.0 else math.nan


def _multiply_columns(seen: Array, reference: Array, lever: Array) -> Array:
    """(5, 5) products of the columns reference, offsets of the camera along three axes, and camera, m², over a run.

    Args:
        seen: (K, A) A axes of the camera's path.
        reference: (K, A) the same by the reference.
        lever: (K, A, 3) change of the reference by an offset of the camera.
    """
    columns = np.column_stack((reference.ravel(), lever.reshape(-1, 3), seen.ravel()))
    return columns.T @ columns


def jackknife(sums: Array, logarithm: Callable[[Array], float], freedom: float = math.inf) -> LogRatio:
    """A logarithm of a ratio over R runs, with an interval from a jackknife.

    Args:
        sums: (R, ...) what each run adds to the sums that determine the ratio.
        logarithm: Gives the logarithm for the sum (...) over all runs, or over all but one; NaN where it has none.
        freedom: Degrees of freedom of the interval, where some runs count for little; at most R - 1 are used.

    Returns:
        The logarithm; 0 with an infinite interval if it is undefined for all runs or without one of them.
    """
    total = sums.sum(axis=0)
    value = logarithm(total)
    without_one = np.array([logarithm(total - of_run) for of_run in sums])
    if not (math.isfinite(value) and np.isfinite(without_one).all()):
        return LogRatio(value=0.0, half=math.inf)
    variance = (len(sums) - 1) * float(np.var(without_one)) + _MODEL_SD_LOG**2
    freedom = max(1.0, min(freedom, len(sums) - 1.0))
    return LogRatio(value=value, half=student_quantile(freedom) * math.sqrt(variance))
