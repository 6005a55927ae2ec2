"""Whether the rates and forces of an IMU have the unit and the axes that the images of a camera on its body show.

The images know how fast the body turns, about which axes, and to which side; and who wears a camera holds it upright.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stridetwin.scenarios.camera_clock import CameraClock, GyroRates, estimate_clock, fits_better, split_blocks
from stridetwin.scenarios.image_rotation import Rates
from stridetwin.streams.rate_corrections import list_units
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Imu

_LOOKS_DOWN, _ASIDE = math.cos(math.radians(70.0)), math.sin(math.radians(20.0))
"""Cosine of the largest angle by which a worn camera looks down on average (one on the chest by up to 45°), and sine of
that by which it looks up or lies on its side."""
_LEAST_GRAVITY_MPS2 = 5.0
"""Mean force from which on its direction is up, m/s²."""
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
    """Whether the best reflection of the rates fits the images significantly better than the best rotation."""
    block = split_blocks(rates)
    spans, visual = np.concatenate([r.t_ns for r in rates]), np.concatenate([r.rate for r in rates])
    is_covered = gyro.covers(spans, clock.shift_s)
    measured = gyro.mean_between(spans[is_covered], np.array([clock.shift_s]))[0]
    # without the bias of the gyro
    a, b = measured - np.median(measured, axis=0), visual[is_covered] - np.median(visual[is_covered], axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    handedness = float(np.sign(np.linalg.det(U @ Vt)))
    rotation, reflection = (U @ np.diag([1.0, 1.0, sign * handedness]) @ Vt for sign in (1.0, -1.0))
    rotated, reflected, recorded = (np.sum((a @ M.T - b) ** 2, axis=1) for M in (rotation, reflection, clock.turn))
    best = rotated if rotated.sum() < recorded.sum() else recorded
    return fits_better(reflected, best, block[is_covered])


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
