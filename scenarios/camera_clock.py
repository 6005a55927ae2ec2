"""Offset between a camera's clock and its IMU's: the rotation rate seen in the images is aligned with the gyro's.

The offset minimises the squared difference between the two rates, as Kelly and Sukhatme (IJRR 33(2), 2014) align
sensors by their rotations alone. Its interval comes from a jackknife over short blocks of images (Efron and
Tibshirani 1993, An Introduction to the Bootstrap, 11.5), because neighbouring rates share their errors. An offset
counts only where the difference has one clear minimum: every offset farther away is significantly worse over the
same blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.image_rotation import Rates, rotation_rates
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Board, CameraCalibration, Rig
from stridetwin.streams.samples import Array, Block, Imu

IMAGES, BATCH, MOST_SEGMENTS = 45, 3, 12
"""Images of a segment, segments that are read at a time, and most segments of one recording."""
LARGEST_SHIFT_S = 0.15
MOUNT_OFF_DEG = 5.0
CLOCK_OFFSET_S = 0.005
"""Offset that the calibration may leave unexplained: a third of a frame at 60 Hz, and the standard deviation that the
shoes' estimator assumes of it."""
_STEP_S = 0.0025  # between the shifts that are compared
_PEAK_S = 0.02  # shifts farther from the best one have to be significantly worse
_MIN_CORRELATION = 0.7  # correlation from which a result counts
_MAX_HALF_WIDTH_S = 0.01  # half width up to which a result counts
_MODEL_SD_S = 0.0008  # of exposure, low-pass and features: offsets of twelve catalogue walks (seeds below 1000)
_BLOCK = 11  # pairs of images of a block
_MIN_BLOCKS = 6
_OUTLIER = 5.0  # times the median of the squared differences
_MEDIAN_OF_SQUARED_NORMAL = 0.455  # of a standard normal variable
_BETTER = 1.5  # ratio of costs from which another mount counts
_ROUNDS, _PRIOR_SHARE = 3, 0.001  # of the mount's alignment, and weight of the nominal mount in it
_NORMAL_975 = 1.959964  # quantile of the standard normal distribution
_SHOES = ("foot_l", "foot_r")


class ClockRow(TypedDict):
    """A `CameraClock` as plain values, with the shift that the calibration does not explain."""

    imu: str
    shift_s: float
    half_s: float
    calibrated_s: float
    correlation: float
    mount_off_deg: float
    pairs: int
    unexplained_s: float


@dataclass(frozen=True, kw_only=True)
class CameraClock:
    """Clock and mount of a camera relative to those of its IMU.

    Attributes:
        imu: Topic of the IMU.
        shift_s: t_imu = t_cam + shift.
        half_s: Half width of its 95 % interval.
        calibrated_s: The shift in the calibration.
        correlation: Of the two rates at the shift.
        mount_off_deg: Rotation of the mount that gives this correlation, 0 for the nominal mount.
        pairs: Pairs of images.
    """

    imu: str
    shift_s: float
    half_s: float
    calibrated_s: float
    correlation: float
    mount_off_deg: float
    pairs: int

    @property
    def unexplained_s(self) -> float:
        """The shift that the calibration does not explain."""
        return self.shift_s - self.calibrated_s

    @property
    def is_off(self) -> bool:
        """Whether its interval lies entirely beyond `CLOCK_OFFSET_S`."""
        return abs(self.unexplained_s) - self.half_s > CLOCK_OFFSET_S

    def row(self) -> ClockRow:
        """The clock as a mapping of plain values, for JSON."""
        return {
            "imu": self.imu,
            "shift_s": self.shift_s,
            "half_s": self.half_s,
            "calibrated_s": self.calibrated_s,
            "correlation": self.correlation,
            "mount_off_deg": self.mount_off_deg,
            "pairs": self.pairs,
            "unexplained_s": self.unexplained_s,
        }


def moving_board(rig: Rig, camera: CameraCalibration) -> Board | None:
    """The board on the other shoe that fills the images of a shoe's camera.

    Such images show the motion of both shoes, so that the gyro of one does not explain them.

    Returns:
        The board; None for a camera that is on no shoe or measures depth, and without a board on the other shoe.
    """
    if camera.mount.body not in _SHOES or camera.depth_topic:
        return None
    return next((b for b in rig.boards.values() if b.mount.body in _SHOES and b.mount.body != camera.mount.body), None)


def camera_clock(recording: Recording, camera: CameraCalibration, gyro: Block[Imu]) -> CameraClock | None:
    """Clock and mount of one camera relative to the IMU on its body.

    Segments of images are read in batches, those with the most varied rotation first, until the offset is certainly
    above or below `CLOCK_OFFSET_S`.

    Args:
        recording: Recording with the images.
        camera: Calibration of the camera.
        gyro: All samples of the IMU.

    Returns:
        None where the two rates have no clear common peak (little rotation or texture, or a scene that moves along).
    """
    # rates of the gyro in the axes of the camera as it is nominally mounted, (M, 3) rad/s
    T_body_imu = recording.rig.imu(camera.imu_topic).mount.T_body_sensor
    R_cam_imu = camera.mount.T_body_sensor[:3, :3].T @ T_body_imu[:3, :3]
    rate = gyro.columns["angular_rate"] @ R_cam_imu.T
    segments = _most_varied_segments(recording.image_times(camera.topic), gyro.t_ns, rate)[:MOST_SEGMENTS]
    clock, visual_rates = None, list[Rates]()
    for start in range(0, len(segments), BATCH):
        batch = segments[start : start + BATCH]
        visual_rates += [r for first in batch if (r := rotation_rates(recording, camera, first, IMAGES)) is not None]
        clock = _estimate_clock(camera, gyro.t_ns, rate, visual_rates)
        if clock is not None and abs(abs(clock.unexplained_s) - CLOCK_OFFSET_S) > clock.half_s:
            break  # certainly above or below
    return clock


def _most_varied_segments(images: NDArray[np.int64], t: NDArray[np.int64], rate: Array) -> list[int]:
    """Numbers of the first images of all segments, by how much the camera's rotation rate varies in them, most first.

    Args:
        images: (N,) stamps of the images, ns.
        t: (M,) stamps of the gyro, ns.
        rate: (M, 3) rates of the gyro in the camera's axes, rad/s.
    """
    starts = range(0, max(1, len(images) - IMAGES), IMAGES)
    spread: list[float] = []
    for start in starts:
        first, last = images[start], images[min(start + IMAGES, len(images) - 1)]
        segment_rate = rate[(t >= first) & (t <= last)]
        spread.append(float(segment_rate.std(axis=0).sum()) if len(segment_rate) > 1 else 0.0)
    return [starts[int(i)] for i in np.argsort(spread, kind="stable")[::-1]]


def _estimate_clock(
    camera: CameraCalibration, t_ns: NDArray[np.int64], rate: Array, rates: Sequence[Rates]
) -> CameraClock | None:
    """The clock by the rates of some segments; None without a clear peak, or with too few blocks of images.

    Gyro and images are compared at every shift, first with the nominal mount. A rotated mount (`_align_mounts`) is
    taken instead if it is more than `MOUNT_OFF_DEG` off and the nominal one fits worse by the factor `_BETTER`, or not
    at all.

    Args:
        camera: Calibration of the camera.
        t_ns: (M,) stamps of the gyro, ns.
        rate: (M, 3) rates of the gyro in the camera's nominal axes, rad/s.
        rates: Rates from the images, by segment.
    """
    # each segment is split into blocks of about `_BLOCK` pairs of images; `block_sizes` is the number of pairs of each
    block_sizes: list[int] = []
    for segment in rates:
        pairs = np.arange(len(segment.rate))
        block_sizes += [len(part) for part in np.array_split(pairs, max(1, round(len(pairs) / _BLOCK)))]
    if len(block_sizes) < _MIN_BLOCKS:
        return None
    block = np.repeat(np.arange(len(block_sizes)), block_sizes)  # (N,) number of the block of each pair
    visual = np.concatenate([r.rate for r in rates])
    shifts = camera.timeshift_cam_imu_s + np.arange(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + _STEP_S / 2, _STEP_S)
    # (S, N, 3) at S shifts
    measured = _gyro_rates(np.concatenate([r.t_ns for r in rates]), shifts, t_ns, rate)
    fit, off_deg = _fit_shift(shifts, measured, visual, block), 0.0
    # with wrong nominal mounts the two rates may correlate only after a rotation of one of them
    # (S, 3, 3) best rotation at each shift, and its cost
    rotations, costs = _align_mounts(measured, visual)
    likely_shift = int(np.argmin(costs)) if fit is None else fit.at  # number of the most likely shift
    if _angle_deg(rotations[likely_shift]) > MOUNT_OFF_DEG:
        rotated = _fit_shift(shifts, measured @ rotations.transpose(0, 2, 1), visual, block)
        off = 0.0 if rotated is None else _angle_deg(rotations[rotated.at])
        if rotated is not None and off > MOUNT_OFF_DEG and (fit is None or rotated.cost * _BETTER < fit.cost):
            fit, off_deg = rotated, off
    if fit is None:
        return None
    return CameraClock(
        imu=camera.imu_topic,
        shift_s=fit.shift_s,
        half_s=fit.half_s,
        calibrated_s=camera.timeshift_cam_imu_s,
        correlation=fit.correlation,
        mount_off_deg=off_deg,
        pairs=len(visual),
    )


def _gyro_rates(spans: NDArray[np.int64], shifts: Array, t_ns: NDArray[np.int64], rate: Array) -> Array:
    """(S, N, 3) mean rate of the gyro over N intervals between images, shifted by each of S shifts, rad/s.

    Args:
        spans: (N, 2) start and end of each interval by the camera's clock, ns.
        shifts: (S,) s, added to them.
        t_ns: (M,) stamps of the gyro, ns.
        rate: (M, 3) rates of the gyro, rad/s.
    """
    t = (t_ns - t_ns[0]) * 1e-9  # (M,) s
    # (M, 3) integral of the rates: a mean rate is its difference over an interval
    angle = np.vstack((np.zeros(3), np.cumsum(rate[1:] * np.diff(t)[:, None], axis=0)))
    at = (spans - t_ns[0]) * 1e-9 + shifts[:, None, None]  # (S, N, 2)
    # (S, N, 2, 3) integral at the start and the end of each interval
    ends = np.stack([np.interp(at, t, angle[:, k]) for k in range(3)], axis=-1)
    return np.asarray((ends[:, :, 1] - ends[:, :, 0]) / (at[:, :, 1] - at[:, :, 0])[..., None])


@dataclass(frozen=True, kw_only=True)
class _ShiftFit:
    """The shift that best aligns the rates.

    Attributes:
        shift_s: The shift, between the compared ones.
        half_s: Half width of its 95 % interval.
        at: Number of the nearest compared shift.
        cost: Mean squared difference of the rates at the best shift, before the axes are weighted, (rad/s)².
        correlation: Of the two rates.
    """

    shift_s: float
    half_s: float
    at: int
    cost: float
    correlation: float


def _fit_shift(shifts: Array, measured: Array, visual: Array, block: NDArray[np.intp]) -> _ShiftFit | None:
    """The best of S shifts; None if it is at the end of the range, not unique, or too uncertain.

    The interval is Student's, from a jackknife over B blocks of images: var = (B - 1) var(minima without one block),
    plus the error of the model.

    Args:
        shifts: (S,) s.
        measured: (S, N, 3) rates of the gyro over N pairs of images at each shift, rad/s.
        visual: (N, 3) rates from the images, rad/s.
        block: (N,) number of the block of each pair.
    """
    # (S, N) squared differences, the number of the best shift, and its mean difference
    squared, at, cost = _robust_residuals(measured, visual)
    if at in (0, len(shifts) - 1):
        return None  # the minimum may lie beyond the range
    count = int(block[-1]) + 1  # of the blocks
    # (B, S) cost of each block at each shift
    by_block = np.zeros((count, len(shifts)))
    np.add.at(by_block, block, squared.T)
    total = by_block.sum(axis=0)
    at = int(np.argmin(total))
    correlation = _correlation(measured[at], visual)
    # unique means that every shift far from the best one costs significantly more than that
    is_far = np.abs(shifts - shifts[at]) > _PEAK_S
    if correlation < _MIN_CORRELATION or not _are_significantly_worse(by_block - by_block[:, [at]])[is_far].all():
        return None
    # jackknife: the minimum without each of the blocks
    left_out = np.array([_parabola_minimum(shifts, total - block_cost) for block_cost in by_block])
    sd = math.hypot(math.sqrt((count - 1) * float(np.var(left_out))), _MODEL_SD_S)
    half = _student_quantile(count - 1) * sd
    if half > _MAX_HALF_WIDTH_S:
        return None
    return _ShiftFit(shift_s=_parabola_minimum(shifts, total), half_s=half, at=at, cost=cost, correlation=correlation)


def _robust_residuals(measured: Array, visual: Array) -> tuple[Array, int, float]:
    """Squared differences between gyro and images at S shifts, without the gyro's bias and limited for outliers.

    Args:
        measured: (S, N, 3) rates of the gyro over N pairs of images at each shift, rad/s.
        visual: (N, 3) rates from the images, rad/s.

    Returns:
        (S, N) squared differences, each axis divided by its variance at the best shift, and limited to `_OUTLIER` times
        the median there; the number of the shift with the least mean difference; and this mean, (rad/s)², whose axes
        are not divided by a variance.
    """
    residual = measured - visual
    # the median is the gyro's bias, as seen at each shift
    residual = residual - np.median(residual, axis=1, keepdims=True)
    squared = np.sum(residual**2, axis=2)
    most = _OUTLIER * np.median(squared, axis=1, keepdims=True)  # that one difference counts, at each shift
    means = np.mean(np.minimum(squared, most), axis=1)
    at = int(np.argmin(means))
    # (3,) variance of each axis, from the median of its squares, which outliers hardly change
    variance = np.median(residual[at] ** 2, axis=0) / _MEDIAN_OF_SQUARED_NORMAL + 1e-12
    squared = np.sum(residual**2 / variance, axis=2)
    return np.minimum(squared, _OUTLIER * np.median(squared[at])), at, float(means[at])


def _are_significantly_worse(additional: Array) -> NDArray[np.bool_]:
    """Whether each shift costs significantly more than the best one, by Student's test of the mean over the blocks.

    Args:
        additional: (B, S) cost of each of B blocks at each of S shifts, minus that at the best shift.

    Returns:
        (S,) booleans.
    """
    # (S,) standard error of the mean
    error = additional.std(axis=0, ddof=1) / math.sqrt(len(additional))
    return np.asarray(additional.mean(axis=0) > _student_quantile(len(additional) - 1) * error)


def _student_quantile(freedom: int) -> float:
    """The 97.5 % quantile of Student's distribution (Abramowitz and Stegun 1972, 26.7.5), to 0.1 % from 5 on."""
    z, n = _NORMAL_975, float(freedom)
    return (
        z
        + (z**3 + z) / (4 * n)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3)
    )


def _parabola_minimum(shifts: Array, cost: Array) -> float:
    """Position of the minimum of the parabola through the least of (S,) costs and its two neighbours, s.

    If the three costs do not curve upwards, it is the middle one.
    """
    best = int(np.clip(np.argmin(cost), 1, len(shifts) - 2))
    before, here, after = cost[best - 1 : best + 2]
    curvature = before - 2 * here + after
    offset = 0.5 * _STEP_S * (before - after) / curvature if curvature > 0 else 0.0
    return float(shifts[best] + offset)


def _align_mounts(measured: Array, visual: Array) -> tuple[Array, Array]:
    """The rotation that best maps the gyro's rates to the visual ones (Kabsch), at each of S shifts.

    A few rounds leave out pairs with large differences. A small weight keeps a rotation at the nominal mount about axes
    that the rates do not observe.

    Args:
        measured: (S, N, 3) rates of the gyro in the camera's nominal axes, rad/s.
        visual: (N, 3) rates from the images, rad/s.

    Returns:
        (S, 3, 3) rotations, and (S,) costs: mean squared differences, each limited, (rad/s)².
    """
    a, b = measured - np.median(measured, axis=1, keepdims=True), visual - np.median(visual, axis=0)
    weight = np.ones(a.shape[:2])  # (S, N) 0 for a pair that is left out
    for _ in range(_ROUNDS):
        size = np.sum(weight * np.linalg.norm(a, axis=2) * np.linalg.norm(b, axis=1), axis=1)
        # (S, 3, 3) sum of the products, with the small weight of the nominal mount on the diagonal
        H = np.einsum("sn,ni,snj->sij", weight, b, a) + (_PRIOR_SHARE * size + 1e-12)[:, None, None] * np.eye(3)
        U, _, Vt = np.linalg.svd(H)
        # a rotation, not a reflection
        U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
        R = U @ Vt
        squared = np.sum((a @ R.transpose(0, 2, 1) - b) ** 2, axis=2)
        most = _OUTLIER * np.median(squared, axis=1, keepdims=True)
        weight = (squared <= most).astype(float)
    return R, np.mean(np.minimum(squared, most), axis=1)


def _angle_deg(R: Array) -> float:
    """Angle of a rotation matrix (3, 3), deg: arccos((tr R - 1) / 2)."""
    return math.degrees(math.acos(float(np.clip((np.trace(R) - 1) / 2, -1, 1))))


def _correlation(measured: Array, visual: Array) -> float:
    """Correlation of the rates of gyro and images without their medians; pairs with a large difference are left out.

    Args:
        measured: (N, 3) rates of the gyro, rad/s.
        visual: (N, 3) rates from the images, rad/s.
    """
    a, b = measured - np.median(measured, axis=0), visual - np.median(visual, axis=0)
    squared = np.sum((a - b) ** 2, axis=1)
    is_inlier = squared <= _OUTLIER * np.median(squared)
    a, b = a[is_inlier], b[is_inlier]
    return float(np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2) + 1e-30))  # 0 / 0 without motion becomes 0
