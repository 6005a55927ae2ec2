"""Whether the rates and forces of an IMU have the unit and the axes that the images of a camera on its body show.

The images know how fast the body turns, about which axes, and to which side; and who wears a camera holds it upright.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stridetwin.scenarios.camera_clock import CameraClock, GyroRates, estimate_clock, split_blocks
from stridetwin.scenarios.image_rotation import Rates
from stridetwin.scenarios.intervals import exceeds_zero
from stridetwin.streams.rate_corrections import list_units
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Imu

_LOOKS_DOWN, _ASIDE = math.cos(math.radians(70.0)), math.sin(math.radians(20.0))
"""Cosine of the largest angle by which a worn camera looks down on average (one on the chest by up to 45°), and sine of
that by which it looks up or lies on its side."""
_LEAST_GRAVITY_MPS2 = 5.0
"""Mean force from which on its direction is up, m/s²."""
_LEAST_GAIN = 0.2
"""Mean gain of the log-likelihood of a pair of images from which a reflection counts. Rates of six cameras have at
most 0.005 as they are, and 0.44 or more once they are mirrored (walks of seeds 500 and 600)."""
_ALIGN_ROUNDS = 15
"""Rounds of weighing pairs of images by what the alignment of their rates leaves over."""
_WORN_UPRIGHT = ("head", "chest")
"""Bodies whose cameras are upright; a shoe's may look anywhere."""


def find_rate_fault(
    camera: CameraCalibration, gyro: GyroRates, rates: Sequence[Rates], clock: CameraClock | None
) -> str:
    """What is wrong with the rates of the gyro if the images turn by another unit or to the other side.

    Args:
        camera: Calibration of the camera.
        gyro: Rates of the gyro in the camera's nominal axes.
        rates: Rates from the images, one item for each segment.
        clock: Clock and mount of the camera with the rates as they are; None if the two do not agree.

    Returns:
        What was seen, what is expected and the likely cause; "" if nothing is wrong, or nothing known.
    """
    if clock is not None:
        is_mirrored = _fits_mirrored(gyro, rates, clock)
    else:
        for unit in list_units():
            scaled = replace(gyro, rate=float(unit.matrix[0, 0]) * gyro.rate)
            if estimate_clock(camera, scaled, rates) is not None:
                return (
                    f"its images turn as {camera.imu_topic} measures only with {unit.matrix[0, 0]:.4g} times the rates "
                    f"of that: expected the same; probably {unit.cause}"
                )
        is_mirrored = estimate_clock(camera, replace(gyro, rate=-gyro.rate), rates) is not None
    if not is_mirrored:
        return ""
    return (
        f"its images turn as {camera.imu_topic} measures only if the rates of that are mirrored: expected right-handed "
        "axes; probably one axis has the wrong sign, all three have, or two are exchanged"
    )


def _fits_mirrored(gyro: GyroRates, rates: Sequence[Rates], clock: CameraClock) -> bool:
    """Whether the best reflection of the rates is significantly likelier than the best rotation.

    Images of walls without depth give some rates that are far off, so that errors count by their logarithm (those of a
    Cauchy distribution). Where a head turns about one axis alone, or two, both fit alike.
    """
    block = split_blocks(rates)
    spans, visual = np.concatenate([r.t_ns for r in rates]), np.concatenate([r.rate for r in rates])
    is_covered = gyro.covers(spans, clock.shift_s)
    measured = gyro.mean_between(spans[is_covered], np.array([clock.shift_s]))[0]
    rotated, reflected = (_align_robustly(measured, visual[is_covered], handedness=sign) for sign in (1.0, -1.0))
    noise = min(float(np.median(rotated)), float(np.median(reflected)))
    gain = np.log1p(rotated / noise) - np.log1p(reflected / noise)
    _, number = np.unique(block[is_covered], return_inverse=True)
    by_block = np.asarray(np.bincount(number, gain), float)
    return bool(gain.mean() > _LEAST_GAIN and exceeds_zero(by_block))


def _align_robustly(measured: Array, visual: Array, *, handedness: float) -> Array:
    """Squared differences (N,) that the best rotation and offset of rates leave, (rad/s)².

    Args:
        measured: (N, 3) rates of the gyro, rad/s.
        visual: (N, 3) rates from the images, rad/s.
        handedness: 1 for a rotation, -1 for a reflection.
    """
    weight = np.ones(len(measured))
    squared = weight
    for _ in range(_ALIGN_ROUNDS):
        a, b = (rate - np.average(rate, axis=0, weights=weight) for rate in (measured, visual))
        U, _, Vt = np.linalg.svd((b * weight[:, None]).T @ a)
        turn = U @ np.diag([1.0, 1.0, handedness * float(np.sign(np.linalg.det(U @ Vt)))]) @ Vt
        squared = np.sum((a @ turn.T - b) ** 2, axis=1)
        weight = 1 / (1 + squared / float(np.median(squared)))
    return np.asarray(squared)


def find_up(imu: Block[Imu], R_cam_imu: Array) -> Array | None:
    """(3,) direction of up in the axes of a camera, by the mean force; None without gravity.

    Args:
        imu: All samples of the IMU.
        R_cam_imu: (3, 3) its rotation into the camera's axes.
    """
    mean = imu.columns["specific_force"].mean(axis=0)
    size = float(np.linalg.norm(mean))
    return R_cam_imu @ mean / size if size > _LEAST_GRAVITY_MPS2 else None


def is_upright(camera: CameraCalibration, up: Array) -> bool:
    """Whether a direction (3,) of up in a camera's axes is one of a worn camera: y of an image points down."""
    x, y, z = up
    return camera.mount.body not in _WORN_UPRIGHT or bool(-y > _LOOKS_DOWN and abs(x) < _ASIDE and z < _ASIDE)
