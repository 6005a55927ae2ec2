"""Offset between a camera's clock and its IMU's: the rotation rate seen in the images is aligned with the gyro's.

The offset minimises the squared difference between the two rates, as Kelly and Sukhatme (IJRR 33(2), 2014) align
sensors by their rotations alone. Its interval comes from a jackknife over short blocks of images (Efron and
Tibshirani 1993, An Introduction to the Bootstrap, 11.5), because neighbouring rates share their errors. An offset
counts only where the difference has one clear minimum: every offset farther away is significantly worse over the
same blocks. Offsets beyond `LARGEST_SHIFT_S` come from a search over the whole overlap (`clock_search`), and count only
where they fit significantly better than the calibrated clock and every other candidate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.clock_search import find_shifts
from stridetwin.scenarios.image_rotation import Rates
from stridetwin.scenarios.intervals import exceeds_zero, student_quantile
from stridetwin.streams.rig import Board, CameraCalibration, Rig
from stridetwin.streams.samples import Array, Block, Imu
from stridetwin.streams.time_series import accumulate, interpolate

LARGEST_SHIFT_S = 0.15
"""Shifts are tried up to this far on both sides of the calibrated one."""
MOUNT_OFF_DEG = 5.0
"""Smallest rotation of the mount that counts as an error of the calibration."""
CLOCK_OFFSET_S = 0.005
"""Offset that the calibration may leave unexplained: a third of a frame at 60 Hz, and the standard deviation that the
shoes' estimator assumes of it."""
_STEP_S = 0.0025  # between the shifts that are compared
_PEAK_S = 0.02  # shifts farther from the best one have to be significantly worse
_MIN_CORRELATION = 0.7  # correlation from which a result counts
_MIN_FAR_CORRELATION = 0.8  # the same for an offset beyond `LARGEST_SHIFT_S`, which is one of very many
_MIN_COVERED = 0.5  # share of the pairs of images during which the gyro has to run
_MAX_HALF_WIDTH_S = 0.01  # half width up to which a result counts
_MODEL_SD_S = 0.0008  # of exposure, low-pass and features: offsets of twelve catalogue walks (seeds below 1000)
_BLOCK = 11  # pairs of images of a block
_MIN_BLOCKS = 6  # fewest blocks from which a clock is estimated
_OUTLIER = 5.0  # times the median of the squared differences
_MEDIAN_OF_SQUARED_NORMAL = 0.455  # of a standard normal variable
_BETTER = 1.5  # ratio of costs from which another mount counts
_AS_GOOD = 1.3  # ratio of costs up to which a usual mistake of the mount is as good as the best rotation
_ROUNDS, _PRIOR_SHARE = 3, 0.001  # of the mount's alignment, and weight of the nominal mount in it
_SHOES = ("foot_l", "foot_r")  # bodies


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


@dataclass(frozen=True, kw_only=True, eq=False)
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
        turn: (3, 3) that rotation: it maps the camera's nominal axes to its true ones.
    """

    imu: str
    shift_s: float
    half_s: float
    calibrated_s: float
    correlation: float
    mount_off_deg: float
    pairs: int
    turn: Array

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

    Args:
        rig: Calibration with the boards.
        camera: The camera.

    Returns:
        The board; None for a camera that is on no shoe or measures depth, and without a board on the other shoe.
    """
    if camera.mount.body not in _SHOES or camera.depth_topic:
        return None
    return next((b for b in rig.boards.values() if b.mount.body in _SHOES and b.mount.body != camera.mount.body), None)


@dataclass(frozen=True, kw_only=True, eq=False)
class GyroRates:
    """Rates of a gyro in the axes of a camera as it is nominally mounted.

    Attributes:
        t_ns: (M,) stamps of the gyro, ns.
        rate: (M, 3) rad/s.
        R_cam_imu: (3, 3) the nominal mount.
    """

    t_ns: NDArray[np.int64]
    rate: Array
    R_cam_imu: Array

    @classmethod
    def of(cls, imu: Block[Imu], R_cam_imu: Array) -> GyroRates:
        """The rates of an IMU on which a camera has the nominal rotation (3, 3)."""
        return cls(t_ns=imu.t_ns, rate=imu.columns["angular_rate"] @ R_cam_imu.T, R_cam_imu=R_cam_imu)

    def mean_between(self, spans: NDArray[np.int64], shifts: Array) -> Array:
        """(S, N, 3) mean rates over N intervals between images, shifted by each of S shifts, rad/s.

        Args:
            spans: (N, 2) start and end of each interval by the camera's clock, ns.
            shifts: (S,) s, added to them.
        """
        return _gyro_rates(spans, shifts, self.t_ns, self.rate)

    def covers(self, spans: NDArray[np.int64], shift_s: float) -> NDArray[np.bool_]:
        """(N,) whether the gyro runs during each of the intervals (N, 2), ns, that are shifted by `shift_s`."""
        at = (spans - self.t_ns[0]) * 1e-9 + shift_s
        return np.asarray((at[:, 0] >= 0) & (at[:, 1] <= (self.t_ns[-1] - self.t_ns[0]) * 1e-9))


def split_blocks(rates: Sequence[Rates], pairs_of_block: int = _BLOCK) -> NDArray[np.intp]:
    """(N,) number of the block of each pair of images: each segment is split into parts of about `pairs_of_block`."""
    sizes: list[int] = []
    for segment in rates:
        pairs = np.arange(len(segment.rate))
        sizes += [len(part) for part in np.array_split(pairs, max(1, round(len(pairs) / pairs_of_block)))]
    return np.repeat(np.arange(len(sizes)), sizes)


def estimate_clock(camera: CameraCalibration, gyro: GyroRates, rates: Sequence[Rates]) -> CameraClock | None:
    """Clock and mount of a camera by the rates of some segments of its images.

    Shifts around the calibrated one are compared first. A shift from the search over the whole overlap replaces the
    best of them if it fits significantly better than that and than every other candidate.

    Args:
        camera: Its calibration.
        gyro: Rates of the gyro.
        rates: Rates from the images, one item for each segment.

    Returns:
        None where the two rates have no clear common peak (little rotation or texture, or a scene that moves along), or
        with too few blocks of images.
    """
    if not rates:
        return None
    block = split_blocks(rates)  # (N,)
    spans, visual = np.concatenate([r.t_ns for r in rates]), np.concatenate([r.rate for r in rates])
    if block[-1] + 1 < _MIN_BLOCKS:
        return None
    near = _fit_window(gyro, spans, visual, block, camera.timeshift_cam_imu_s)
    windows = [near] if near is not None else []
    for shift in find_shifts(spans, visual, gyro.t_ns, gyro.rate):
        if abs(shift - camera.timeshift_cam_imu_s) > LARGEST_SHIFT_S:
            window = _fit_window(gyro, spans, visual, block, float(shift))
            windows += [window] if window is not None else []
    window = _choose_window(near, windows, block)
    if window is None or window.fit is None:
        return None
    turn = window.turn
    if window.is_turned:
        is_covered = gyro.covers(spans, window.fit.shift_s)
        measured = gyro.mean_between(spans[is_covered], np.array([window.fit.shift_s]))[0]
        turn = _find_usual_turn(turn, measured, visual[is_covered], gyro.R_cam_imu)
    return CameraClock(
        imu=camera.imu_topic,
        shift_s=window.fit.shift_s,
        half_s=window.fit.half_s,
        calibrated_s=camera.timeshift_cam_imu_s,
        correlation=window.fit.correlation,
        mount_off_deg=angle_deg(turn),
        pairs=len(visual),
        turn=turn,
    )


def exchange_axes() -> list[Array]:
    """The 24 rotations (3, 3) that exchange or reverse axes, the identity first."""
    orders, signs = itertools.permutations(range(3)), list(itertools.product((1.0, -1.0), repeat=3))
    axes = [np.diag(sign) @ np.eye(3)[list(order)] for order in orders for sign in signs]
    return [R for R in axes if np.linalg.det(R) > 0]


def _find_usual_turn(turn: Array, measured: Array, visual: Array, R_cam_imu: Array) -> Array:
    """The usual mistake of a mount that fits about as well as the best rotation, else that rotation.

    A walk may turn a head about one axis alone, so that a rotation about that axis is anyone's guess; then a usual
    mistake is likelier.

    Args:
        turn: (3, 3) rotation of the nominal mount that fits best.
        measured: (N, 3) rates of the gyro in the camera's nominal axes, rad/s.
        visual: (N, 3) rates from the images, rad/s.
        R_cam_imu: (3, 3) the nominal mount.
    """
    a, b = measured - np.median(measured, axis=0), visual - np.median(visual, axis=0)

    def square(R: Array) -> Array:
        """(N,) squared differences with a rotation of the mount, (rad/s)²."""
        return np.asarray(np.sum((a @ R.T - b) ** 2, axis=1))

    best = square(turn)
    most = _OUTLIER * float(np.median(best))
    # the inverse of the nominal mount in its place, and exchanged axes
    usual = [R for R in (R_cam_imu.T @ R_cam_imu.T, *exchange_axes()) if angle_deg(R) > MOUNT_OFF_DEG]
    costs = [float(np.mean(np.minimum(square(R), most))) for R in usual]
    least = int(np.argmin(costs))
    if costs[0] <= _AS_GOOD * costs[least]:
        least = 0  # of mistakes that are one and the same, and of those that look alike, the inverse is the likeliest
    return usual[least] if costs[least] <= _AS_GOOD * float(np.mean(np.minimum(best, most))) else turn


@dataclass(frozen=True, kw_only=True, eq=False)
class _Window:
    """Shifts around one of the candidates.

    Attributes:
        fit: The best of them; None unless there is a clear one.
        turn: (3, 3) rotation of the mount with which it fits; the identity for the nominal one.
        nominal: (N,) squared differences of the rates at the best shift with the nominal mount, (rad/s)²; NaN for pairs
            of images during which the gyro does not run.
        turned: (N,) likewise with the best rotation of the mount.
    """

    fit: _ShiftFit | None
    turn: Array
    nominal: Array
    turned: Array

    @property
    def is_turned(self) -> bool:
        """Whether the fit is one with another mount than the nominal one."""
        return not np.array_equal(self.turn, np.eye(3))

    @property
    def squared(self) -> Array:
        """(N,) the squared differences with the mount of the fit."""
        return self.turned if self.is_turned else self.nominal


def _choose_window(near: _Window | None, windows: Sequence[_Window], block: NDArray[np.intp]) -> _Window | None:
    """The window with the clock: the one around the calibrated shift, unless another is significantly better than all.

    Args:
        near: The window around the calibrated shift; None if the gyro does not run there.
        windows: All windows, that one among them.
        block: (N,) number of the block of each pair.
    """
    far = [w for w in windows if w is not near and w.fit is not None and w.fit.correlation >= _MIN_FAR_CORRELATION]
    if far:
        best = min(far, key=lambda w: float(np.nanmean(_limit(w.squared))))
        others = [w for w in windows if w is not best]
        rivals = [w.nominal for w in others] + ([w.turned for w in others] if best.is_turned else [])
        if all(_fits_better(best.squared, rival, block) for rival in rivals):
            return best
    return near


def _limit(squared: Array) -> Array:
    """Squared differences (N,), each up to `_OUTLIER` times their median."""
    return np.asarray(np.minimum(squared, _OUTLIER * np.nanmedian(squared)))


def _fits_better(squared: Array, rival: Array, block: NDArray[np.intp]) -> bool:
    """Whether squared differences (N,) are significantly less than those of a rival, over the blocks of both."""
    both = np.isfinite(squared) & np.isfinite(rival)
    if not both.any():
        return True
    most = _OUTLIER * max(float(np.median(squared[both])), float(np.median(rival[both])))
    more = np.minimum(rival[both], most) - np.minimum(squared[both], most)
    _, number = np.unique(block[both], return_inverse=True)
    by_block = np.asarray(np.bincount(number, more), float)
    ratio = float(np.sum(np.minimum(rival[both], most)) / max(float(np.sum(np.minimum(squared[both], most))), 1e-30))
    if len(by_block) < _MIN_BLOCKS:  # they hardly cover the same images
        return ratio > _BETTER
    return ratio > _BETTER and bool(exceeds_zero(by_block))


def _fit_window(
    gyro: GyroRates, spans: NDArray[np.int64], visual: Array, block: NDArray[np.intp], centre_s: float
) -> _Window | None:
    """Compares gyro and images at the shifts around `centre_s`.

    The nominal mount comes first. A rotated one (`_align_mounts`) is taken instead if it is more than `MOUNT_OFF_DEG`
    off and the nominal one fits worse by the factor `_BETTER`, or not at all.

    Args:
        gyro: Rates of the gyro.
        spans: (N, 2) stamps of both images of each pair, ns.
        visual: (N, 3) rates from the images, rad/s.
        block: (N,) number of the block of each pair.
        centre_s: Shift in the middle, s.

    Returns:
        None if the gyro does not run during enough of the images.
    """
    is_covered = gyro.covers(spans, centre_s)
    _, covered_block = np.unique(block[is_covered], return_inverse=True)  # numbered from 0 without gaps
    if is_covered.mean() < _MIN_COVERED or covered_block[-1] + 1 < _MIN_BLOCKS:
        return None
    shifts = centre_s + np.arange(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + _STEP_S / 2, _STEP_S)
    measured, seen = gyro.mean_between(spans[is_covered], shifts), visual[is_covered]
    fit = _fit_shift(shifts, measured, seen, covered_block)
    turn = np.eye(3)
    # with a wrong nominal mount the two rates may agree only after a rotation of one of them:
    # (S, 3, 3) best rotation at each shift, and (S,) its cost
    rotations, costs = _align_mounts(measured, seen)
    turned = measured @ rotations.transpose(0, 2, 1)
    likely_shift = int(np.argmin(costs)) if fit is None else fit.at  # number of the most likely shift
    if angle_deg(rotations[likely_shift]) > MOUNT_OFF_DEG:
        rotated = _fit_shift(shifts, turned, seen, covered_block)
        off = 0.0 if rotated is None else angle_deg(rotations[rotated.at])
        if rotated is not None and off > MOUNT_OFF_DEG and (fit is None or rotated.cost * _BETTER < fit.cost):
            fit, turn = rotated, rotations[rotated.at]
    squared = np.full((2, len(visual)), np.nan)
    for row, rates in enumerate((measured, turned)):
        squared[row, is_covered] = _find_least_residuals(rates, seen)
    return _Window(fit=fit, turn=turn, nominal=squared[0], turned=squared[1])


def _find_least_residuals(measured: Array, visual: Array) -> Array:
    """(N,) squared differences of rates of the gyro (S, N, 3) and the images (N, 3) at the best shift, (rad/s)²."""
    residual = measured - visual
    residual = residual - np.median(residual, axis=1, keepdims=True)  # without the gyro's bias
    squared = np.sum(residual**2, axis=2)
    means = np.mean(np.minimum(squared, _OUTLIER * np.median(squared, axis=1, keepdims=True)), axis=1)
    return np.asarray(squared[int(np.argmin(means))])


def _gyro_rates(spans: NDArray[np.int64], shifts: Array, t_ns: NDArray[np.int64], rate: Array) -> Array:
    """(S, N, 3) mean rate of the gyro over N intervals between images, shifted by each of S shifts, rad/s.

    Args:
        spans: (N, 2) start and end of each interval by the camera's clock, ns.
        shifts: (S,) s, added to them.
        t_ns: (M,) stamps of the gyro, ns.
        rate: (M, 3) rates of the gyro, rad/s.
    """
    t = (t_ns - t_ns[0]) * 1e-9  # (M,) s
    angle = accumulate(np.diff(t), rate[1:])  # (M, 3) rad, integral of the rates
    at = (spans - t_ns[0]) * 1e-9 + shifts[:, None, None]  # (S, N, 2) s, ends of the intervals by the gyro's clock
    # (S, N, 2, 3) integral at the start and the end of each interval
    ends = interpolate(at, t, angle)
    # the mean rate over an interval is the change of the integral, divided by the duration
    return np.asarray((ends[:, :, 1] - ends[:, :, 0]) / (at[:, :, 1] - at[:, :, 0])[..., None])


@dataclass(frozen=True, kw_only=True)
class _ShiftFit:
    """The shift that best aligns the rates.

    Attributes:
        shift_s: The shift, interpolated between the compared ones.
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
    # (S, N) weighted squared differences; and, without the weights of the axes, the best shift and its mean difference
    squared, unweighted_best, cost = _robust_residuals(measured, visual)
    if unweighted_best in (0, len(shifts) - 1):
        return None  # the minimum may lie beyond the range
    count = int(block[-1]) + 1  # of the blocks
    # (B, S) cost of each block at each shift: the sum over its pairs
    by_block = np.zeros((count, len(shifts)))
    np.add.at(by_block, block, squared.T)
    total = by_block.sum(axis=0)
    at = int(np.argmin(total))  # number of the best shift
    correlation = _correlation(measured[at], visual)
    # unique means that every shift far from the best one costs significantly more than that
    is_far = np.abs(shifts - shifts[at]) > _PEAK_S
    if correlation < _MIN_CORRELATION or not exceeds_zero(by_block - by_block[:, [at]])[is_far].all():
        return None
    # jackknife: (B,) best shift without each of the blocks
    minima = np.array([_parabola_minimum(shifts, total - block_cost) for block_cost in by_block])
    sd = math.hypot(math.sqrt((count - 1) * float(np.var(minima))), _MODEL_SD_S)
    half = student_quantile(count - 1) * sd
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
    most = _OUTLIER * np.median(squared, axis=1, keepdims=True)  # (S, 1), up to this a squared difference counts
    means = np.mean(np.minimum(squared, most), axis=1)
    at = int(np.argmin(means))
    # (3,) variance of each axis, from the median of its squares, which outliers hardly change
    variance = np.median(residual[at] ** 2, axis=0) / _MEDIAN_OF_SQUARED_NORMAL + 1e-12
    weighted = np.sum(residual**2 / variance, axis=2)
    return np.minimum(weighted, _OUTLIER * np.median(weighted[at])), at, float(means[at])


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
    # rates without their medians, so that the gyro's bias does not count
    a = measured - np.median(measured, axis=1, keepdims=True)
    b = visual - np.median(visual, axis=0)
    weight = np.ones(a.shape[:2])  # (S, N) 0 for a pair that is left out
    for _ in range(_ROUNDS):
        # (S,) typical size of H, to which the weight of the nominal mount is relative
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
    # the rotations of the last round, and their costs
    return R, np.mean(np.minimum(squared, most), axis=1)


def angle_deg(R: Array) -> float:
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
