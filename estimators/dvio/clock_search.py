"""The camera's clock from the first seconds of motion: rotation seen in images against that of the gyroscope.

The window refines an offset of a few milliseconds. One of 100 ms makes it reject most points of a turning head as
moving things, so it has to be known before: two successive images give a rotation that needs no IMU, and the shift in
time at which the gyroscope explains the last seconds of them best is the offset (Kelly & Sukhatme 2014, IJRR 33(2),
align sensors by their rotations alone). See docs/dvio.md (16).
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio.nav_state import ImuBuffer
from stridetwin.estimators.dvio.tracker import Lens, flow_matrix
from stridetwin.streams.samples import Array

# Hand-chosen on tuning seeds.
_POINTS, _MIN_POINTS = 60, 15  # corners that are followed from one image to the next, and fewest that must be found
_QUALITY, _DISTANCE_PX = 0.01, 10.0  # of these corners, in the image of half the resolution
_WINDOW_PX, _LEVELS, _STEPS = 13, 3, 10  # of the optical flow in it; it reaches as far as a head turns
_MAX_FORWARD_BACKWARD_PX = 0.5
_UNKNOWN_INVERSE_DEPTH_PER_M = 0.3  # of points without measured depth
_ROUNDS, _OUTLIER = 3, 3.0  # of the fit of a rotation, and the error in medians beyond which a point is left out
_MAX_GAP_S = 0.12  # between two images
_BASELINE_S = 0.09  # time over which corners are followed: the noise of a rate decreases with it
_SPEED_SD_MPS = 1.5  # of the camera, before its images
_FLOW_SD_PER_S = 0.005  # least noise of the motion of a corner
_MEMORY_S = 4.0  # pairs of images that are compared; the IMU's samples reach back 6 s
_STEP_S = 0.005  # between the shifts that are compared
_MOST_S = 0.15  # farthest shift
_MIN_PAIRS = 5  # fewest rotations that are compared
_ROTATION_CAP = 6.0  # squared differences count up to this many times their median
_RATE_FLOOR_RADPS = 0.005  # standard deviation of a rate beyond that, for rolling shutter and moving things
_CORRELATED = 1.5  # neighbouring differences that count as one
_MAX_SD_S = 0.003  # of a shift that is taken
_FAR_OFF_SHARE, _MAX_FAR_OFF_SD_S = 1 / 7, 0.008  # the same, of the shift itself, and at most
_PEAK_S = 0.04  # farther from the best shift all must be worse, by `_WORSE` variances
_WORSE = 16.0
_SETTLED_SD_S = 0.002  # a clock this well known, and near to the present one, is right
MIN_OFF_S = 0.010
"""Smaller errors of the present clock are left to the window: a third of a frame."""


class ImageRotation(NamedTuple):
    """Mean angular rate of the camera between two images.

    Attributes:
        start_ns: Time of the earlier image, by the camera's clock.
        end_ns: Time of the later one.
        rate: (3,) rad/s, in the camera's axes.
        covariance: (3, 3) of it, (rad/s)².
    """

    start_ns: int
    end_ns: int
    rate: Array
    covariance: Array


class ClockFit(NamedTuple):
    """The shift at which the gyroscope explains the images.

    Attributes:
        shift_s: Correction of the camera's offset, s.
        sd_s: Its standard deviation, s.
        is_unique: Whether all shifts farther away are clearly worse.
        advantage: How much worse no correction is, in variances of a difference.
    """

    shift_s: float
    sd_s: float
    is_unique: bool
    advantage: float


class ClockSearch:
    """Compares images and gyroscope until the camera's clock is known; bounded memory.

    Args:
        lens: Maps pixels to rays.

    Attributes:
        is_settled: Whether the clock is known, so that no more images are needed.
    """

    def __init__(self, lens: Lens) -> None:
        """Begins without images."""
        self._lens = lens
        self.is_settled = False
        # the last image at half the resolution, its time, and that of the image in which the corners were found
        self._grey: NDArray[np.uint8] | None = None
        self._t_ns, self._start_ns = 0, 0
        # corners where they were found, at `_start_ns`, and where they are in the last image: (N, 1, 2) px each
        self._corners: NDArray[np.float32] = np.zeros((0, 1, 2), np.float32)
        self._followed = self._corners
        self._rotations: deque[ImageRotation] = deque()
        self._has_new = False  # whether a rotation has come since the last comparison

    def restart(self) -> None:
        """Begins anew, as after a failure."""
        self.is_settled, self._grey = False, None
        self._rotations.clear()

    def add_image(self, t_ns: int, grey: NDArray[np.uint8], depth: NDArray[np.float32] | None) -> None:
        """Follows the corners into an image; once per `_BASELINE_S` their motion gives a rotation, and new ones follow.

        Args:
            t_ns: Time by the camera's clock.
            grey: (H, W) image.
            depth: (H, W) m, 0 where none, of the same instant; or None.
        """
        half = np.asarray(cv2.pyrDown(grey), np.uint8)
        if self._grey is None or not 0 < (t_ns - self._t_ns) * 1e-9 < _MAX_GAP_S:
            self._followed = self._corners[:0]
        else:
            self._follow(self._grey, half)
        elapsed_s = (t_ns - self._start_ns) * 1e-9
        if len(self._followed) < _MIN_POINTS or elapsed_s >= _BASELINE_S:
            if len(self._followed) >= _MIN_POINTS:
                fit = self._fit_rotation(depth, elapsed_s)
                if fit is not None:
                    self._rotations.append(ImageRotation(self._start_ns, t_ns, *fit))
                    self._has_new = True
            corners = cv2.goodFeaturesToTrack(half, _POINTS, _QUALITY, _DISTANCE_PX)
            self._corners = np.zeros((0, 1, 2), np.float32) if corners is None else np.asarray(corners, np.float32)
            self._followed, self._start_ns = self._corners.copy(), t_ns
        while self._rotations and (t_ns - self._rotations[0].start_ns) * 1e-9 > _MEMORY_S:
            self._rotations.popleft()
        self._grey, self._t_ns = half, t_ns

    def _follow(self, before: NDArray[np.uint8], half: NDArray[np.uint8]) -> None:
        """Follows the corners from the last image into a new one, both of half the resolution, and drops lost ones."""
        if not len(self._followed):
            return
        size, flags = (_WINDOW_PX, _WINDOW_PX), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, 0.03)
        start, options = self._followed, {"winSize": size, "maxLevel": _LEVELS, "criteria": flags}
        tracked, status, _ = cv2.calcOpticalFlowPyrLK(before, half, start, None, **options)  # type: ignore[call-overload]
        back, back_status, _ = cv2.calcOpticalFlowPyrLK(half, before, tracked, None, **options)  # type: ignore[call-overload]
        good = (status[:, 0] > 0) & (back_status[:, 0] > 0)
        good &= np.abs(back - start).max(axis=(1, 2)) < _MAX_FORWARD_BACKWARD_PX
        self._corners, self._followed = self._corners[good], np.asarray(tracked[good], np.float32)

    def find_offset(
        self, inertial: ImuBuffer, R_imu_camera: Array, offset_s: float, first_offset_s: float, is_new: bool
    ) -> float:
        """The camera's offset, s, if images have been used by one that was clearly wrong; otherwise `offset_s`.

        It sets `is_settled` once the offset is known to have been right.

        Args:
            inertial: Samples of the gyroscope.
            R_imu_camera: (3, 3) IMU <- camera.
            offset_s: Present offset: the IMU's time less the camera's.
            first_offset_s: That with which the window began, and by which its first images were used.
            is_new: Whether the odometry has begun a short time ago, or is lost. An offset that is far off need not be
                known so well then, because the window refines it; a window that has tracked for long contradicts it.
        """
        if not self._has_new or len(self._rotations) < _MIN_PAIRS:
            return offset_s
        self._has_new = False
        spans = np.array([(r.start_ns, r.end_ns) for r in self._rotations], np.int64)
        rates = np.array([r.rate for r in self._rotations]) @ R_imu_camera.T
        covariances = R_imu_camera @ np.array([r.covariance for r in self._rotations]) @ R_imu_camera.T
        fit = fit_shift(spans + round(first_offset_s * 1e9), rates, covariances, inertial)
        if fit is None or not fit.is_unique:
            return offset_s
        max_far_off_sd_s = min(_FAR_OFF_SHARE * abs(fit.shift_s), _MAX_FAR_OFF_SD_S) if is_new else 0.0
        if fit.sd_s > max(_MAX_SD_S, max_far_off_sd_s):
            return offset_s
        if abs(fit.shift_s) > MIN_OFF_S and fit.advantage > _WORSE:
            return first_offset_s + fit.shift_s
        self.is_settled = fit.sd_s < _SETTLED_SD_S
        return offset_s

    def _fit_rotation(self, depth: NDArray[np.float32] | None, dt: float) -> tuple[Array, Array] | None:
        """Mean rate of the camera (3,), rad/s, while the corners were followed for `dt`, and its covariance (3, 3).

        None where it is undetermined.

        Args:
            depth: (H, W) m of the last image, 0 where none; or None.
            dt: Time since the corners were found, s.
        """
        # pixels of the whole resolution: pixel (0, 0) of the half one is centred on the whole one's
        pixels = 2.0 * self._corners[:, 0], 2.0 * self._followed[:, 0]
        at, moved = self._lens.to_normalized(pixels[0]), self._lens.to_normalized(pixels[1])
        middle = 0.5 * (at + moved)  # where the motion is that of a constant velocity, to second order
        inverse_depth = np.full(len(at), _UNKNOWN_INVERSE_DEPTH_PER_M)
        if depth is not None:
            u, v = np.rint(pixels[1]).astype(int).T
            z = depth[np.clip(v, 0, depth.shape[0] - 1), np.clip(u, 0, depth.shape[1] - 1)]
            measured = np.isfinite(z) & (z > 0)
            if measured.any():
                inverse_depth[:] = np.median(1.0 / z[measured])
                inverse_depth[measured] = 1.0 / z[measured]
        return fit_rate(middle, (moved - at) / dt, inverse_depth)


def fit_rate(at: Array, flow: Array, inverse_depth: Array) -> tuple[Array, Array] | None:
    """Rate of a camera from the motion of resting points, by docs/dvio.md (14).

    Velocity and rate are fitted together; points that move otherwise are left out.

    Args:
        at: (N, 2) points on the plane at depth 1.
        flow: (N, 2) their motion, 1/s.
        inverse_depth: (N,) 1/m.

    Returns:
        (3,) rad/s, and its covariance (3, 3), in which the velocity is unknown; None where too few points agree.
    """
    A, b = flow_matrix(at, inverse_depth), flow
    use = np.ones(len(at), bool)
    x: Array = np.zeros(6)
    prior, noise = np.diag([_SPEED_SD_MPS**-2] * 3 + [0.0] * 3), _FLOW_SD_PER_S
    for _ in range(_ROUNDS):
        if use.sum() < _MIN_POINTS:
            return None
        M = A[use].reshape(-1, 6)
        information = M.T @ M / noise**2 + prior
        x = np.asarray(np.linalg.solve(information, M.T @ b[use].ravel() / noise**2), float)
        error = np.linalg.norm(b - A @ x, axis=1)
        noise = max(float(np.median(error[use])), _FLOW_SD_PER_S)
        use = error <= _OUTLIER * noise
    covariance = np.linalg.inv(information)[3:, 3:]
    return x[3:], covariance + _RATE_FLOOR_RADPS**2 * np.eye(3)


def fit_shift(spans: NDArray[np.int64], rates: Array, covariances: Array, inertial: ImuBuffer) -> ClockFit | None:
    """The shift of N intervals between images at which the gyroscope measures the rotation that they show.

    It minimises J(s) = Σ rᵀ Σ⁻¹ r of r = ω̄(s) − ω_k − b, with ω̄ the mean rate of the gyroscope in the shifted interval
    and its bias b: docs/dvio.md (16). The standard deviation is that of least squares, from the curvature of J.

    Args:
        spans: (N, 2) ns, begin and end of each interval on the IMU's clock, by the present offset.
        rates: (N, 3) rad/s, mean rates by the images in the IMU's axes.
        covariances: (N, 3, 3) of these.
        inertial: Samples of the gyroscope.

    Returns:
        None where its samples do not cover enough intervals, or the best shift is at the end of the range.
    """
    n = inertial.count
    t_ns, measured = inertial.t_ns[:n], inertial.samples[:n, :3]
    most_ns = round(_MOST_S * 1e9)
    covered = (spans[:, 0] - most_ns >= t_ns[0]) & (spans[:, 1] + most_ns <= t_ns[-1])
    if covered.sum() < _MIN_PAIRS:
        return None
    spans, rates, weights = spans[covered], rates[covered], np.linalg.inv(covariances[covered])
    t = (t_ns - t_ns[0]) * 1e-9
    # (M, 3) rad, integral of the rates; a sample is the mean of the interval that ends with it
    angle = np.zeros((n, 3))
    angle[1:] = np.cumsum(measured[1:] * np.diff(t)[:, None], axis=0)
    shifts = np.arange(-_MOST_S, _MOST_S + _STEP_S / 2, _STEP_S)
    at = (spans - t_ns[0])[None] * 1e-9 + shifts[:, None, None]  # (S, N, 2) s
    ends = np.stack([np.interp(at, t, angle[:, i]) for i in range(3)], axis=-1)
    by_gyro = (ends[:, :, 1] - ends[:, :, 0]) / (at[:, :, 1] - at[:, :, 0])[..., None]
    residual = by_gyro - rates
    residual -= np.median(residual, axis=1, keepdims=True)
    squared = np.einsum("sni,nij,snj->sn", residual, weights, residual)
    best = int(np.argmin(np.mean(np.minimum(squared, _ROTATION_CAP * np.median(squared, axis=1, keepdims=True)), 1)))
    if best in (0, len(shifts) - 1):
        return None
    cap = _ROTATION_CAP * max(float(np.median(squared[best])), 3.0)
    J = np.minimum(squared, cap).sum(axis=1)
    best = int(np.clip(np.argmin(J), 1, len(shifts) - 2))
    variance = _CORRELATED * max(float(J[best]) / (3 * len(rates)), 1.0)  # of a component, over that assumed
    # parabola through the best shift and its neighbours but one: noise of one step does not count
    i = int(np.clip(best, 2, len(shifts) - 3))
    a, b, _ = np.polyfit(shifts[i - 2 : i + 3], J[i - 2 : i + 3], 2)
    if not a > 0:
        return None
    shift = float(np.clip(-b / (2 * a), shifts[i - 2], shifts[i + 2]))
    far = np.abs(shifts - shift) > _PEAK_S
    return ClockFit(
        shift_s=shift,
        sd_s=float(np.sqrt(variance / a)),
        is_unique=bool((J[far] - J[best] > _WORSE * variance).all()),
        advantage=float((J[len(shifts) // 2] - J[best]) / variance),
    )
