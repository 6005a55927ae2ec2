"""Focal length of a camera by its rotation: images whose focal length is wrong turn by more or less than the gyro.

A feature moves by about the focal length times the angle when the camera turns about an axis across its line of sight.
With a focal length that is too large by a factor, the angle from the images is too small by it; a rotation about the
line of sight does not depend on it. With depth the translation of the camera, which moves features as well, is part of
the fit (`camera_lever`); without, its direction is (`camera_epipolar`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.camera_clock import CameraClock, GyroRates, split_blocks
from stridetwin.scenarios.camera_epipolar import find_epipolar_cost
from stridetwin.scenarios.camera_lever import COARSE_FACTORS, estimate_focal_factor, find_minimum
from stridetwin.scenarios.camera_motion import InertialPart, MotionPart, build_parts, prepare_parts
from stridetwin.scenarios.image_rotation import PairTracks, Rates, list_rates
from stridetwin.scenarios.intervals import student_quantile
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Imu

FOCAL_OFF = 0.05
"""Relative error of the focal length that a calibration may have: zoom by the housing, temperature and focus change it
by 1 to 2 %, another resolution or camera by more than 10 %."""
_MODEL_SD = 0.01  # of the ratio: scale error of consumer gyros by their data sheets
_MOST_HALF_WIDTH = 0.15  # half width up to which a ratio counts
_LARGEST_RATIO = 1.6  # of the images' rates to the gyro's that a bias is estimated with
_COARSE_PAIRS = 3
"""Of so many pairs of images, one is compared first."""
_AROUND = np.array([0.92, 1.0, 1.08])
"""Multiples of the best focal length that are compared last, without depth."""
_MIN_PARTS = 4  # fewest parts from which a focal length is estimated
_OUTLIER = 9.0  # times the median of the squared differences
_TRIMMED_ROUNDS = 4  # of the fit without outliers
_MIN_BLOCKS = 6  # fewest blocks of images from which slopes are fitted


@dataclass(frozen=True, kw_only=True)
class FocalMultiple:
    """What the focal lengths are by the rotation of the images, in multiples of the calibrated ones.

    The ratios of `streams.depth_planes` and `depth_scale` are the inverse: calibrated over fitting focal lengths.

    Attributes:
        ratio: Focal lengths that fit over the calibrated ones.
        half: Half width of its 95 % interval.
        roll: Ratio of the rotation about the line of sight to the gyro's, which should be 1 for any focal length; NaN
            where there is none.
        roll_half: Half width of its 95 % interval.
    """

    ratio: float
    half: float
    roll: float
    roll_half: float

    def multiply(self, factor: float) -> FocalMultiple:
        """The ratio to a calibration whose focal lengths are `1 / factor` of those that it refers to."""
        return replace(self, ratio=factor * self.ratio, half=factor * self.half)

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


def estimate_focal(
    camera: CameraCalibration,
    T_imu_cam: Array,
    imu: Block[Imu],
    gyro: GyroRates,
    segments: Sequence[Sequence[PairTracks]],
    rates: Sequence[Rates],
    clock: CameraClock,
) -> FocalMultiple | None:
    """The focal length with which the IMU explains the motion of a camera's features.

    Args:
        camera: Its calibration.
        T_imu_cam: (4, 4) its calibrated pose on the IMU.
        imu: All samples of the IMU.
        gyro: Rates of the gyro in the camera's nominal axes.
        segments: Tracks of each segment.
        rates: Rates from the images of each segment with this calibration.
        clock: Its clock and mount.

    Returns:
        The focal length; None if the motion shows too little of it.
    """
    slopes = _fit_slopes(gyro, rates, clock) if rates else None
    if slopes is None:
        return None
    R_imu_cam = T_imu_cam[:3, :3] @ clock.turn.T
    unbiased = _remove_bias(imu, R_imu_cam @ slopes.bias)
    has_depth = any(tracks.depth is not None for segment in segments for tracks in segment)
    parts = list(prepare_parts(R_imu_cam, unbiased, segments, clock.shift_s, needs_depth=has_depth))

    def build(factor: float) -> list[MotionPart]:
        """Equations of the parts with a multiple of the focal length."""
        return build_parts(scale_focal(camera, factor), parts)

    if has_depth:
        estimate = estimate_focal_factor(build, T_imu_cam[:3, 3], camera.readout_s)
    else:
        estimate = _estimate_without_depth(camera, parts)
    if estimate is None:
        return None
    ratio, sd, count = estimate
    half = student_quantile(count - 1) * math.hypot(sd, _MODEL_SD * ratio)
    if half > _MOST_HALF_WIDTH * ratio:
        return None
    if abs(ratio - 1) > FOCAL_OFF:  # the rotation about the line of sight, with the lens that fits
        scaled = scale_focal(camera, ratio)
        rates = list_rates(scaled, segments)
        slopes = _fit_slopes(gyro, rates, clock) if rates else None
    roll = None if slopes is None or slopes.about.half > _MOST_HALF_WIDTH else slopes.about
    return FocalMultiple(
        ratio=ratio,
        half=half,
        roll=math.nan if roll is None else roll.value,
        roll_half=math.nan if roll is None else roll.half,
    )


def _estimate_without_depth(
    camera: CameraCalibration, parts: Sequence[InertialPart]
) -> tuple[float, float, int] | None:
    """The multiple of the focal length with which features without depth agree best with the gyro.

    Args:
        camera: Calibration of the camera.
        parts: Pairs of images with the rotations by the gyro.

    Returns:
        The multiple, its standard deviation, and the number of parts; None with too few, or without a minimum.
    """
    if len(parts) < _MIN_PARTS:
        return None
    coarse = _compare_epipolar(camera, parts, COARSE_FACTORS, every=_COARSE_PAIRS).sum(axis=0)
    start = find_minimum(COARSE_FACTORS, coarse)
    if start is None:
        return None
    factors = start * _AROUND
    fine = _compare_epipolar(camera, parts, factors)
    total = fine.sum(axis=0)
    minima = [find_minimum(factors, total), *(find_minimum(factors, total - of_part) for of_part in fine)]
    known = [value for value in minima if value is not None]
    if len(known) < len(minima):
        return None
    return known[0], known[0] * math.sqrt((len(parts) - 1) * float(np.var(np.log(known[1:])))), len(parts)


def _compare_epipolar(
    camera: CameraCalibration, parts: Sequence[InertialPart], factors: Array, *, every: int = 1
) -> Array:
    """(P, F) costs (`find_epipolar_cost`) of the features of P parts with F multiples of the focal length.

    Args:
        camera: Calibration of the camera.
        parts: The parts, with the rotations by the gyro.
        factors: (F,) the multiples.
        every: Of so many pairs of images of a part, one is used.
    """
    costs = np.zeros((len(parts), len(factors)))
    for column, factor in enumerate(factors):
        scaled, direction = scale_focal(camera, float(factor)), np.array([0.0, 0.0, 1.0])
        for row, part in enumerate(parts):
            for tracks, (before, after) in zip(part.pairs[::every], part.R_start_cam[::every]):
                cost, direction = find_epipolar_cost(scaled, tracks, after.T @ before, direction)
                costs[row, column] += cost
    return costs


def _remove_bias(imu: Block[Imu], bias: Array) -> Block[Imu]:
    """The samples of an IMU without a bias (3,) of its rates, rad/s."""
    return replace(imu, columns={**imu.columns, "angular_rate": imu.columns["angular_rate"] - bias})


def scale_focal(camera: CameraCalibration, factor: float) -> CameraCalibration:
    """The camera with both focal lengths multiplied by a factor; the centre of the lens stays."""
    fu, fv, pu, pv = camera.intrinsics
    return replace(camera, intrinsics=(factor * fu, factor * fv, pu, pv))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Slopes:
    """Ratios of the images' rates to the gyro's.

    Attributes:
        across: Of the rotation about axes across the line of sight.
        about: Of the rotation about the line of sight.
        bias: (3,) of the gyro in the camera's true axes, rad/s: its rates where the images do not turn.
    """

    across: _Slope
    about: _Slope
    bias: Array


def _fit_slopes(gyro: GyroRates, rates: Sequence[Rates], clock: CameraClock) -> _Slopes | None:
    """Ratios of the images' rates to the gyro's; None with too few blocks of images.

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
    measured, visual = gyro.mean_between(spans[is_covered], np.array([clock.shift_s]))[0], visual[is_covered]
    measured = measured @ clock.turn.T
    across, about = (_fit_slope(measured[:, axes], visual[:, axes], block) for axes in ([0, 1], [2]))
    # a wrong focal length changes rates across the line of sight alone
    ratio = min(max(across.value, 1 / _LARGEST_RATIO), _LARGEST_RATIO)
    bias = np.median(measured - visual / np.array([ratio, ratio, 1.0]), axis=0)
    return _Slopes(across=across, about=about, bias=bias)


def _fit_slope(measured: Array, visual: Array, block: NDArray[np.intp]) -> _Slope:
    """Slope of D axes of the images' rates over the gyro's, by least squares without outliers.

    The interval is Student's, from a jackknife over the blocks, with the error of the model.

    Args:
        measured: (N, D) rates of the gyro in the camera's true axes, rad/s.
        visual: (N, D) rates of the images in the same axes, rad/s.
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
