"""Focal length of a camera by its rotation: images whose focal length is wrong turn by more or less than the gyro.

A feature moves by about the focal length times the angle when the camera turns about an axis across its line of sight.
With a focal length that is too large by a factor, the angle from the images is too small by it; a rotation about the
line of sight does not depend on it. With depth the translation of the camera, which moves features as well, is part of
the fit (`camera_lever`). Without, the rotation is estimated by the images alone, and repeated with the corrected focal
length until the angles agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.camera_clock import CameraClock, GyroRates, split_blocks, student_quantile
from stridetwin.scenarios.camera_lever import estimate_factor
from stridetwin.scenarios.camera_motion import MotionPart, build_parts, prepare_parts
from stridetwin.scenarios.image_rotation import Rates, Tracks, estimate_rates
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Imu

FOCAL_OFF = 0.05
"""Relative error of the focal length that a calibration may have: zoom by the housing, temperature and focus change it
by 1 to 2 %, another resolution or camera by more than 10 %."""
_MODEL_SD = 0.01  # of the ratio: scale error of consumer gyros by their data sheets
_MOST_HALF_WIDTH = 0.15  # half width up to which a ratio counts
_ROUNDS, _CLOSE = 6, 0.01  # most repetitions, and change of the ratio at which they end
_LARGEST_STEP = 1.6  # factor by which one repetition changes the focal length at most
_OUTLIER = 9.0  # times the mean of the squared differences
_TRIMMED_ROUNDS = 4  # of the fit without outliers
_MIN_BLOCKS = 6


@dataclass(frozen=True, kw_only=True)
class FocalRatio:
    """What the focal lengths are by the rotation of the images, in multiples of the calibrated ones.

    Attributes:
        ratio: Of both focal lengths.
        half: Half width of its 95 % interval.
        roll: Ratio of the rotation about the line of sight to the gyro's, which should be 1 for any focal length; NaN
            where there is none.
        roll_half: Half width of its 95 % interval.
    """

    ratio: float
    half: float
    roll: float
    roll_half: float

    @property
    def is_off(self) -> bool:
        """Whether the interval lies entirely beyond `FOCAL_OFF`."""
        return abs(self.ratio - 1) - self.half > FOCAL_OFF

    @property
    def is_certain(self) -> bool:
        """Whether the interval lies entirely on one side of `FOCAL_OFF`."""
        return abs(abs(self.ratio - 1) - FOCAL_OFF) > self.half

    @property
    def is_gyro_off(self) -> bool:
        """Whether the rotation about the line of sight, which needs no focal length, is off by the same factor."""
        return abs(self.roll - 1) - self.roll_half > FOCAL_OFF and abs(self.roll / self.ratio - 1) < FOCAL_OFF


@dataclass(frozen=True, kw_only=True)
class _Slope:
    """Ratio of rates from the images to those of the gyro, with the half width of its 95 % interval."""

    value: float
    half: float


def estimate_focal_by_depth(
    camera: CameraCalibration,
    T_imu_cam: Array,
    imu: Block[Imu],
    gyro: GyroRates,
    segments: Sequence[Sequence[Tracks]],
    clock: CameraClock,
) -> FocalRatio | None:
    """The focal length of a camera with depth with which the IMU explains the motion of its features.

    Args:
        camera: Its calibration.
        T_imu_cam: (4, 4) its calibrated pose on the IMU.
        imu: All samples of the IMU.
        gyro: Rates of the gyro in the camera's nominal axes.
        segments: Tracks of each segment.
        clock: Its clock and mount.

    Returns:
        None if the motion shows too little of it.
    """
    R_imu_cam = T_imu_cam[:3, :3] @ clock.turn.T
    parts = list(prepare_parts(R_imu_cam, imu, segments, clock.shift_s))

    def build(factor: float) -> list[MotionPart]:
        """Equations of the parts with a multiple of the focal length."""
        return build_parts(scale_focal(camera, factor), parts)

    estimate = estimate_factor(build, T_imu_cam[:3, 3], camera.readout_s)
    if estimate is None:
        return None
    ratio, sd, count = estimate
    half = student_quantile(count - 1) * math.hypot(sd, _MODEL_SD)
    rates = [r for r in (estimate_rates(camera, segment) for segment in segments) if r is not None]
    slopes = _fit_slopes(gyro, rates, clock)
    if half > _MOST_HALF_WIDTH * ratio or slopes is None:
        return None
    return _to_ratio(ratio, half, slopes[1])


def estimate_focal(
    camera: CameraCalibration, gyro: GyroRates, segments: Sequence[Sequence[Tracks]], clock: CameraClock
) -> FocalRatio | None:
    """The focal length by which the images of some segments turn as the gyro says.

    Args:
        camera: Its calibration.
        gyro: Rates of the gyro in its nominal axes.
        segments: Tracks of each segment.
        clock: Its clock and mount.

    Returns:
        None if the rotation shows too little of it.
    """
    factor = 1.0
    for _ in range(_ROUNDS):
        scaled = scale_focal(camera, factor)
        rates = [r for r in (estimate_rates(scaled, segment) for segment in segments) if r is not None]
        slopes = _fit_slopes(gyro, rates, clock) if rates else None
        if slopes is None:
            return None
        across, roll = slopes
        if abs(across.value - 1) < _CLOSE:
            break
        factor *= min(max(across.value, 1 / _LARGEST_STEP), _LARGEST_STEP)
    ratio, half = factor * across.value, factor * across.half
    return None if half > _MOST_HALF_WIDTH * ratio else _to_ratio(ratio, half, roll)


def _to_ratio(ratio: float, half: float, roll: _Slope) -> FocalRatio:
    """The ratio with the one of the rotation about the line of sight, if that is known."""
    is_known = roll.half < _MOST_HALF_WIDTH
    return FocalRatio(
        ratio=ratio, half=half, roll=roll.value if is_known else math.nan, roll_half=roll.half if is_known else math.nan
    )


def scale_focal(camera: CameraCalibration, factor: float) -> CameraCalibration:
    """The camera with both focal lengths multiplied."""
    fu, fv, pu, pv = camera.intrinsics
    return replace(camera, intrinsics=(factor * fu, factor * fv, pu, pv))


def _fit_slopes(gyro: GyroRates, rates: Sequence[Rates], clock: CameraClock) -> tuple[_Slope, _Slope] | None:
    """Ratios of the images' rates to the gyro's, across the line of sight and about it; None with too few blocks.

    Args:
        gyro: Rates of the gyro in the camera's nominal axes.
        rates: Rates from the images of each segment.
        clock: Clock and mount of the camera.
    """
    block = split_blocks(rates)
    spans, visual = np.concatenate([r.t_ns for r in rates]), np.concatenate([r.rate for r in rates])
    is_covered = gyro.covers(spans, clock.shift_s)
    _, block = np.unique(block[is_covered], return_inverse=True)
    if not len(block) or block[-1] + 1 < _MIN_BLOCKS:
        return None
    measured = gyro.mean_between(spans[is_covered], np.array([clock.shift_s]))[0] @ clock.turn.T
    across, about = (_fit_slope(measured[:, axes], visual[is_covered][:, axes], block) for axes in ([0, 1], [2]))
    return across, about


def _fit_slope(measured: Array, visual: Array, block: NDArray[np.intp]) -> _Slope:
    """Slope of D axes of the images' rates over the gyro's, by least squares without outliers.

    The interval is Student's, from a jackknife over the blocks, with the error of the model.

    Args:
        measured: (N, D) rates of the gyro, rad/s.
        visual: (N, D) rates of the images, rad/s.
        block: (N,) number of the block of each pair of images.
    """
    x, y = measured - np.median(measured, axis=0), visual - np.median(visual, axis=0)
    weight, slope = np.ones(len(x)), 1.0
    for _ in range(_TRIMMED_ROUNDS):
        slope = float(np.sum(weight * np.sum(x * y, axis=1)) / (np.sum(weight * np.sum(x * x, axis=1)) + 1e-30))
        squared = np.sum((y - slope * x) ** 2, axis=1)
        weight = (squared <= _OUTLIER * np.median(squared) + 1e-30).astype(float)
    products = np.bincount(block, weight * np.sum(x * y, axis=1))
    squares = np.bincount(block, weight * np.sum(x * x, axis=1))
    without = (products.sum() - products) / (squares.sum() - squares + 1e-30)
    count = len(products)
    sd = math.hypot(math.sqrt((count - 1) * float(np.var(without))), _MODEL_SD)
    return _Slope(value=slope, half=student_quantile(count - 1) * sd)
