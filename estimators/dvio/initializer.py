"""Start in motion: images are collected until structure from motion and the pre-integrated IMU align.

After Qin et al. 2018, §V-B, on which Zhao et al. 2023 build: gyroscope bias from the rotations; velocities, gravity
and, without depth, scale from one linear problem; then gravity of fixed magnitude. The last step here is the least
squares of all of them, weighted with the uncertainty of the cameras, the IMU noise, and the priors of biases and
calibration. Its covariance is that of the whole problem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.noise_model import LATER_DEPTH_SD
from stridetwin.estimators.dvio.optimiser import preintegrate
from stridetwin.estimators.dvio.projection import directions
from stridetwin.estimators.dvio.sliding_window import SlidingWindow
from stridetwin.estimators.dvio.state import LANDMARK_SLOTS, Preintegration, blank_preintegration
from stridetwin.estimators.dvio.structure_from_motion import (
    Observations,
    Structure,
    structure_with_depth,
    structure_without_depth,
)
from stridetwin.estimators.dvio.tracker import CameraFrame, Tracker
from stridetwin.streams.algebra.arrays import exp, hat, log, matvec
from stridetwin.streams.samples import Array

# Errors that one interval depends on: pose of the two cameras, the two velocities, tilt, biases, scale,
# the camera's position and attitude on the IMU, time offset.
# First index of each, and their number: a pose has position before rotation, the biases gyroscope before accelerometer.
_CAMERA_A, _CAMERA_B, _V_A, _V_B, _TILT, _BIAS, _SCALE, _MOUNT, _OFFSET, _LOCAL = 0, 6, 12, 15, 18, 20, 26, 27, 33, 34
_STEP = 1e-6  # of numerical derivatives
# Gauss-Newton: largest number of steps; a step above the second value recomputes the derivatives, one below the last
# ends the iteration.
_STEPS, _LARGE, _SETTLED = 4, 0.1, 1e-4
# Hand-chosen on tuning seeds.
_IMAGES, _MIN_IMAGES = 10, 5  # kept, and needed for an alignment
_MIN_INTERVAL_S = 0.09  # between images that are kept
_MAX_GAP_S = 0.5  # points are not followed over a longer one
_MAX_TILT_SD_RAD, _MAX_SPEED_SD_MPS = 0.03, 0.1  # while vertical or velocity are less certain, collection continues
_MAX_GRAVITY_ERROR = 0.3  # relative, of the gravity that the linear alignment finds
_MAX_SCALE_STEP = 5.0  # of the logarithm of the scale, beyond which the problem has no solution nearby
_MAX_MISFIT = 3.0  # mean squared residual, in variances, beyond which vision and IMU contradict each other


@dataclass(frozen=True, kw_only=True, eq=False)
class Priors:
    """Prior knowledge of an alignment in motion; a standard deviation of 0 means exactly known.

    Attributes:
        T_imu_camera: (4, 4) camera to IMU.
        bias: (6,) rad/s and m/s², biases with which the intervals were integrated.
        bias_sd: (6,) standard deviations of the biases of gyroscope (rad/s) and accelerometer (m/s²).
        mount_sd: (6,) standard deviations of the camera's position (m) and attitude (rad) on the IMU.
        offset_sd: Standard deviation of the offset of the camera's clock, s.
        scale_sd: Relative standard deviation of the scale of measured depths.
        gravity: Size of gravity, m/s².
    """

    T_imu_camera: Array
    bias: Array
    bias_sd: Array
    mount_sd: Array
    offset_sd: float
    scale_sd: float
    gravity: float


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraMotion:
    """All unknowns of K images, in the axes of the IMU at the newest image's nominal time.

    Attributes:
        R: (K, 3, 3) newest camera <- camera, as in `Structure`.
        p: (K, 3) position of each camera, as in `Structure`.
        v: (K, 3) velocity of the IMU at each image, m/s.
        up: (3,) unit vector against gravity.
        tilt_axes: (3, 2) unit vectors about which the tilt errors of `up` rotate.
        bias: (6,) gyroscope (rad/s) and accelerometer (m/s²).
        scale: Length of the structure's unit, m.
        mount_R: (3, 3) IMU <- camera.
        mount_p: (3,) camera in the IMU's frame, m.
        offset: Correction of the camera's clock, s.
    """

    R: Array
    p: Array
    v: Array
    up: Array
    tilt_axes: Array
    bias: Array
    scale: float
    mount_R: Array
    mount_p: Array
    offset: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment(CameraMotion):
    """The result of an alignment of vision and IMU: motion with its uncertainty.

    Attributes:
        covariance: (12, 12) of 0-1 the tilt about `tilt_axes` (rad, on the right of the attitude), 2-4 the newest
            velocity (m/s), 5-10 the biases (rad/s, m/s²), 11 the logarithm of the scale.
        misfit: Mean squared residual, in variances.
    """

    covariance: Array
    misfit: float

    def state_covariance(self, R_world_imu: Array, place: Array, heading_sd: float) -> Array:
        """(15, 15) covariance of position, attitude (error on the right), velocity and biases in the world.

        The world's z axis is up; its heading and origin are not observable, so they have the given uncertainty.

        Args:
            R_world_imu: (3, 3) attitude of the IMU at the newest image.
            place: (3, 3) covariance of the position, m².
            heading_sd: Standard deviation of the heading, rad.
        """
        # Derivative of the 15 errors by those of `covariance`, whose last entry, the scale, is replaced by the heading:
        # an attitude error about `tilt_axes` or `up`, which turns the velocity in the world, too.
        # Rows of J: 0-2 position, 3-5 attitude, 6-8 velocity, 9-14 biases.
        J = np.zeros((15, 12))
        by_turn = -R_world_imu @ hat(self.v[-1])  # (3, 3) derivative of the velocity in the world by an attitude error
        J[3:6, :2], J[3:6, 11] = self.tilt_axes, self.up
        J[6:9, :2], J[6:9, 11] = by_turn @ self.tilt_axes, by_turn @ self.up
        J[6:9, 2:5] = R_world_imu
        J[9:15, 5:11] = np.eye(6)
        P = self.covariance.copy()
        P[11], P[:, 11] = 0.0, 0.0  # the scale is no error of the state; the heading is independent of the others
        P[11, 11] = heading_sd**2
        out: Array = J @ P @ J.T
        out[:3, :3] = place
        return 0.5 * (out + out.T)


def align_vision_imu(
    structure: Structure, preintegrations: Preintegration, rates: Array, priors: Priors
) -> Alignment | None:
    """Aligns structure from motion with the preintegrated IMU, for a start in motion.

    After Qin 2018 (15)-(19): gyroscope bias from the rotations, then velocities, gravity and scale from one linear
    problem; at last Gauss-Newton over all unknowns with their priors.

    Args:
        structure: Cameras of K ≥ 3 images.
        preintegrations: Preintegrated IMU over the K − 1 intervals between them.
        rates: (K, 3) measured angular rate at each image, rad/s.
        priors: Priors of calibration and biases.

    Returns:
        The state at the newest image; None if vision and IMU contradict each other.
    """
    bias = priors.bias.copy()
    bias[:3] += solve_gyro_bias(structure, preintegrations, priors)
    start = _solve_linear(structure, preintegrations, bias, priors)
    if start is None:
        return None
    return _refine(start, structure, preintegrations, rates, priors)


def solve_gyro_bias(structure: Structure, preintegrations: Preintegration, priors: Priors) -> Array:
    """(3,) rad/s, correction of the gyroscope bias at which the intervals were integrated.

    Weighted least squares of Log(ΔRᵀ R_kᵀ R_(k+1)) = J_R δb with the prior of the bias, after Qin 2018 (15).

    Args:
        structure: Cameras of K images, of which the rotations are used.
        preintegrations: Preintegrated IMU over the K − 1 intervals between them.
        priors: Nominal mount, and standard deviation of the bias.
    """
    R_ic = priors.T_imu_camera[:3, :3]
    R = R_ic @ structure.R @ R_ic.T  # of the IMU at each image, in the axes of that at the newest
    # (K - 1, 3, 3) ΔRᵀ R_kᵀ R_(k+1): rotation that the cameras have turned more than the gyroscope measured
    excess_rotation = np.swapaxes(preintegrations.delta_R, 1, 2) @ np.swapaxes(R[:-1], 1, 2) @ R[1:]
    r = log(excess_rotation)
    # rows 3-5 of a measurement are its rotation, columns 0-2 of `by_bias` the gyroscope's bias
    J, W = preintegrations.by_bias[:, 3:6, :3], np.linalg.inv(preintegrations.covariance[:, 3:6, 3:6])
    JtW = np.swapaxes(J, 1, 2) @ W
    # H δb = Jᵀ W r, summed over the intervals, with the information of the prior
    H = (JtW @ J).sum(axis=0) + np.diag(priors.bias_sd[:3] ** -2.0)
    return np.asarray(np.linalg.solve(H, (JtW @ r[..., None])[..., 0].sum(axis=0)))


def _solve_linear(structure: Structure, z: Preintegration, bias: Array, priors: Priors) -> CameraMotion | None:
    """Velocities, gravity of free magnitude and, without measured depths, scale by linear least squares.

    After Qin 2018 (16)-(19), per interval of duration dt between images a and b, with every row divided to be in m/s:
    scale (p_b − p_a) / dt − v_a − g dt / 2 = (ΔP − arm_b + arm_a) / dt and v_b − v_a − g dt = ΔV, in the axes of the
    newest camera's IMU. `arm` is how much the camera's offset from its IMU has changed until the newest image. None if
    the scale is not positive or |g| is far from gravity.

    Args:
        structure: Cameras of K images.
        z: Preintegrated IMU over the K − 1 intervals between them.
        bias: (6,) biases of gyroscope (rad/s) and accelerometer (m/s²), to which the measurements are corrected.
        priors: Mount, and size of gravity.
    """
    K = len(structure.R)
    R_ic, p_ic = priors.T_imu_camera[:3, :3], priors.T_imu_camera[:3, 3]
    R = R_ic @ structure.R @ R_ic.T  # (K, 3, 3) of the IMU at each image, in the axes of that at the newest
    # (K, 3) in the same axes: offset of the newest camera from its IMU less that of each; position of each camera
    arm, cameras = p_ic - R @ p_ic, structure.p @ R_ic.T
    # (K - 1, 9) changes of position, rotation and velocity by the difference of the biases
    by_bias = (z.by_bias @ (bias - z.bias)[..., None])[..., 0]
    # (K - 1, 3, 1) ΔP and ΔV: corrected measurements in the axes of the newest image's IMU
    delta_p = R[:-1] @ (z.delta_p + by_bias[:, :3])[..., None]
    delta_v = R[:-1] @ (z.delta_v + by_bias[:, 6:])[..., None]
    n = 3 * K + 4  # unknowns: K velocities and gravity, of three axes each, and the scale
    A, b = np.zeros((6 * (K - 1), n)), np.zeros(6 * (K - 1))
    for k in range(K - 1):
        dt, i, j = z.dt[k, 0], 6 * k, 3 * k  # i: first row of the interval, j: first column of the velocity v_a
        # position: scale (p_b - p_a) / dt - v_a - g dt / 2 = (ΔP - arm_b + arm_a) / dt
        A[i : i + 3, j : j + 3] = -np.eye(3)
        A[i : i + 3, -4:-1] = -0.5 * dt * np.eye(3)
        A[i : i + 3, -1] = (cameras[k + 1] - cameras[k]) / dt
        b[i : i + 3] = (delta_p[k, :, 0] - arm[k + 1] + arm[k]) / dt
        # velocity: v_b - v_a - g dt = ΔV
        A[i + 3 : i + 6, j : j + 3], A[i + 3 : i + 6, j + 3 : j + 6] = -np.eye(3), np.eye(3)
        A[i + 3 : i + 6, -4:-1] = -dt * np.eye(3)
        b[i + 3 : i + 6] = delta_v[k, :, 0]
    if structure.scaled:  # the scale is 1: its column moves to the right-hand side
        b = b - A[:, -1]
        A = A[:, :-1]
    x: Array = np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], float)
    scale, g = (1.0 if structure.scaled else float(x[-1])), x[3 * K : 3 * K + 3]
    size = float(np.linalg.norm(g))
    if not (scale > 0.0 and abs(size - priors.gravity) < _MAX_GRAVITY_ERROR * priors.gravity):
        return None
    up: Array = np.asarray(-g / size, float)
    return CameraMotion(
        R=structure.R,
        p=structure.p,
        v=x[: 3 * K].reshape(K, 3),
        up=up,
        tilt_axes=np.linalg.svd(up[None])[2][1:].T,  # the right singular vectors beside `up`: perpendicular to it
        bias=bias,
        scale=scale,
        mount_R=R_ic,
        mount_p=p_ic,
        offset=0.0,
    )


def _refine(s: CameraMotion, structure: Structure, z: Preintegration, rates: Array, priors: Priors) -> Alignment | None:
    """Gauss-Newton over all unknowns of `CameraMotion`, weighted with the structure, the IMU noise and the priors.

    Minimises Σ rᵀ Σ⁻¹ r of docs/dvio.md (4) plus the structure's information on the cameras and the priors of biases,
    scale, mount and clock. Error vector (n,): 6 of each of K cameras, 3 of each velocity, 2 of the tilt, 6 of the
    biases, logarithm of the scale, 6 of the mount, clock. The newest camera is the reference and does not move. A value
    whose prior standard deviation is 0 does not move either. None if the problem is singular.

    Args:
        s: Start of the iteration, from `_solve_linear`.
        structure: Cameras of K images.
        z: Preintegrated IMU over the K − 1 intervals between them.
        rates: (K, 3) measured angular rate at each image, rad/s.
        priors: Priors of calibration and biases.
    """
    K = len(structure.R)
    V, TILT = 6 * K, 9 * K  # first index of the velocities and of the tilt; biases, scale, mount and clock follow
    n = TILT + 2 + 6 + 1 + 6 + 1
    # per error: whether it is estimated, and the information 1/σ² of its prior
    free, prior = np.ones(n, bool), np.zeros(n)
    free[6 * K - 6 : 6 * K] = False  # the newest camera is the reference
    # of the errors after the tilt; without measured depths nothing is known of the scale
    scale_sd = priors.scale_sd if structure.scaled else np.inf
    prior_sd = np.concatenate([priors.bias_sd, [scale_sd], priors.mount_sd, [priors.offset_sd]])
    prior[TILT + 2 :] = np.where(prior_sd > 0, np.maximum(prior_sd, 1e-12), 1.0) ** -2.0
    free[TILT + 2 :] = prior_sd > 0
    deviation = np.zeros(n)  # sum of all steps, from the means of the priors
    # indices of the errors of each interval, in the order of `_CAMERA_A` to `_OFFSET`
    index = [np.r_[6 * k : 6 * k + 12, V + 3 * k : V + 3 * k + 6, TILT : TILT + 16] for k in range(K - 1)]
    deviation[TILT + 2 : TILT + 8] = s.bias - priors.bias
    large = True  # whether the last step was so large that the derivatives must be computed anew
    for step in range(_STEPS):
        if step == 0 or large:
            r, J = _residual_jacobian(s, z, rates, priors.gravity)
        else:  # J of an earlier step is used again
            r = _residuals(s, z, rates, priors.gravity, np.zeros((1, 1, _LOCAL)))[0]
        H, b = np.diag(prior), -prior * deviation
        H[:V, :V] += structure.information  # on the cameras, whose errors come first
        b[:V] -= structure.information @ deviation[:V]
        JtW = np.swapaxes(J, 1, 2) @ z.weight  # Jᵀ Σ⁻¹ of each interval
        H_interval, b_interval = JtW @ J, -(JtW @ r[..., None])[..., 0]
        for k in range(K - 1):
            H[np.ix_(index[k], index[k])] += H_interval[k]
            b[index[k]] += b_interval[k]
        e = np.zeros(n)  # step of all errors
        try:
            P = np.linalg.inv(H[np.ix_(free, free)])
        except np.linalg.LinAlgError:
            return None
        e[free] = P @ b[free]
        if not np.isfinite(e).all() or abs(e[TILT + 8]) > _MAX_SCALE_STEP:
            return None
        s = _apply_step(s, e, K)
        # Attitude errors add to first order, as their information is of that order.
        deviation += e
        size = np.abs(e[6 * K :]).max()  # of the step without that of the cameras
        large = size > _LARGE
        if size < _SETTLED:
            break
    r = _residuals(s, z, rates, priors.gravity, np.zeros((1, 1, _LOCAL)))[0]
    cost = float(np.einsum("ki,kij,kj", r, z.weight, r) + deviation[:V] @ structure.information @ deviation[:V])
    full_covariance = np.zeros((n, n))
    full_covariance[np.ix_(free, free)] = P
    # rows of `Alignment.covariance`: tilt, newest velocity, then biases and scale
    reported = np.r_[TILT : TILT + 2, V + 3 * K - 3 : V + 3 * K, TILT + 2 : TILT + 9]
    covariance = full_covariance[np.ix_(reported, reported)]
    if not (np.isfinite(covariance).all() and (np.diag(covariance) >= 0).all()):
        return None
    # degrees of freedom: nine residuals per interval, less the velocities and the tilt
    return Alignment(**vars(s), covariance=covariance, misfit=cost / (9 * (K - 1) - 3 * K - 2))


def _residual_jacobian(s: CameraMotion, z: Preintegration, rates: Array, gravity: float) -> tuple[Array, Array]:
    """(K − 1, 9) residuals of docs/dvio.md (4), and their (K − 1, 9, 34) derivatives by finite differences.

    The derivatives are by the 34 errors that an interval depends on, in the order of `_CAMERA_A` to `_OFFSET`.

    Args:
        s: Unknowns of K images.
        z: Preintegrated IMU over the K − 1 intervals.
        rates: (K, 3) measured angular rate at each image, rad/s.
        gravity: Size of gravity, m/s².
    """
    # (35, 1, 34) error vectors: first all zeros, then each error in turn by `_STEP`
    x = np.concatenate([np.zeros((1, _LOCAL)), _STEP * np.eye(_LOCAL)])[:, None]
    r = _residuals(s, z, rates, gravity, x)
    return r[0], np.moveaxis((r[1:] - r[0]) / _STEP, 0, -1)


def _residuals(s: CameraMotion, z: Preintegration, rates: Array, gravity: float, x: Array) -> Array:
    """(D, K − 1, 9) IMU residuals, docs/dvio.md (4), of consecutive images a and b, for D error vectors x (D, 1, 34).

    The IMU's pose at an image follows from the camera's by the mount (R_c, p_c), the scale and the time offset τ: M =
    R_c R R_cᵀ Exp(−τ ω) and R_c scale p + p_c − M p_c, seen from the IMU at the newest image's nominal time. Position
    (m), rotation (rad) and velocity (m/s) in that order.

    Args:
        s: Unknowns of K images.
        z: Preintegrated IMU over the K − 1 intervals.
        rates: (K, 3) measured angular rate at each image, rad/s.
        gravity: Size of gravity, m/s².
        x: (D, 1, 34) errors added to the unknowns of every interval, in the order of `_CAMERA_A` to `_OFFSET`.
    """
    # the unknowns with their errors added; `R_ic` and `p_ic` are the mount, IMU <- camera
    R_ic = s.mount_R @ exp(x[..., _MOUNT + 3 : _MOUNT + 6])
    p_ic, offset = s.mount_p + x[..., _MOUNT : _MOUNT + 3], s.offset + x[..., _OFFSET, None]
    scale = s.scale * np.exp(x[..., _SCALE, None])
    up = matvec(exp(-x[..., _TILT : _TILT + 2] @ s.tilt_axes.T), s.up)
    bias = s.bias + x[..., _BIAS : _BIAS + 6]
    # pose of the IMU at each image's nominal time, in its axes at that of the newest; `back` turns from the axes at the
    # newest image's exposure to those at its nominal time
    back = exp(offset * (rates[-1] - bias[..., :3]))
    poses = []
    # images at the beginning and at the end of each interval
    for k, column in ((slice(0, -1), _CAMERA_A), (slice(1, None), _CAMERA_B)):
        M = R_ic @ s.R[k] @ exp(x[..., column + 3 : column + 6]) @ np.swapaxes(R_ic, -1, -2)
        p = matvec(R_ic, scale * (s.p[k] + x[..., column : column + 3])) + p_ic - matvec(M, p_ic)
        poses.append((back @ M @ exp(-offset * (rates[k] - bias[..., :3])), matvec(back, p)))
    (R_a, p_a), (R_b, p_b) = poses
    v_a, v_b = s.v[:-1] + x[..., _V_A : _V_A + 3], s.v[1:] + x[..., _V_B : _V_B + 3]
    dv, dt = v_b - v_a, z.dt
    by_bias = matvec(z.by_bias, bias - z.bias)  # changes of the measurements by the difference of the biases
    to_a = np.swapaxes(R_a, -1, -2)  # into the axes of the IMU at the interval's beginning
    # docs/dvio.md (4) with g = -gravity up; positions at nominal times differ by v τ from those at the exposures
    rotation = np.swapaxes(z.delta_R, -1, -2) @ to_a @ R_b
    r = np.empty((*dv.shape[:-1], 9))
    r[..., :3] = matvec(to_a, p_b - p_a - dv * offset - v_a * dt + 0.5 * gravity * up * dt**2) - z.delta_p
    r[..., :3] -= by_bias[..., :3]
    r[..., 3:6] = log(rotation) - by_bias[..., 3:6]
    r[..., 6:] = matvec(to_a, dv + gravity * up * dt) - z.delta_v - by_bias[..., 6:]
    return r


def _apply_step(s: CameraMotion, e: Array, K: int) -> CameraMotion:
    """Applies an error vector (n,) of `_refine` to the unknowns of K images; rotation errors are on the right."""
    # globals_: 0-1 tilt, 2-7 biases, 8 logarithm of the scale, 9-11 and 12-14 position and rotation of the mount, 15
    # clock; a positive tilt turns `up` and its axes back, because the attitude's error is on the right
    cameras, globals_ = e[: 6 * K].reshape(K, 6), e[9 * K :]
    back = exp(-(s.tilt_axes @ globals_[:2]))
    return replace(
        s,
        R=s.R @ exp(cameras[:, 3:]),
        p=s.p + cameras[:, :3],
        v=s.v + e[6 * K : 9 * K].reshape(K, 3),
        up=back @ s.up,
        tilt_axes=back @ s.tilt_axes,
        bias=s.bias + globals_[2:8],
        scale=s.scale * float(np.exp(globals_[8])),
        mount_R=s.mount_R @ exp(globals_[12:15]),
        mount_p=s.mount_p + globals_[9:12],
        offset=s.offset + float(globals_[15]),
    )


class Initializer:
    """Collects images and IMU samples of a moving sensor until they align, to start the window; constant memory.

    It tracks points from image to image and keeps the observations of about every third image.

    Args:
        core: Provides tracker, lens, IMU and calibration, which no window needs yet.
    """

    def __init__(self, core: SlidingWindow) -> None:
        """Begins without images; `core` provides tracker, lens, IMU samples and calibration."""
        self._core = core
        self._tracker = Tracker(core.lens.shape)  # of its own: a window may track meanwhile
        # Times on the IMU's clock of the images kept so far, and of the last image, kept or not.
        self._t_ns: list[int] = []
        self._before_ns = 0
        # Per kept image and point: whether it is seen, where on the plane at depth 1, and its inverse depth there, 1/m.
        self._seen = np.zeros((_IMAGES, LANDMARK_SLOTS), bool)
        self._at, self._rho = np.zeros((_IMAGES, LANDMARK_SLOTS, 2)), np.zeros((_IMAGES, LANDMARK_SLOTS))
        # Per point: whether the last image shows it, and where, px.
        self._alive, self._pixels = np.zeros(LANDMARK_SLOTS, bool), np.zeros((LANDMARK_SLOTS, 2), np.float32)

    def reset(self) -> None:
        """Drops all images and points, to start anew."""
        self._t_ns.clear()
        self._alive[:] = False

    def process_image(self, frame: CameraFrame) -> Alignment | None:
        """Takes an image whose time the IMU has reached; returns the state there once it is certain enough.

        Every image serves to track points, but its observations are kept only if it is `_MIN_INTERVAL_S` after the last
        kept one. After a gap in the images, or if the IMU samples no longer reach back to the oldest kept image, the
        collection starts anew.

        Returns:
            The alignment; None if this image is not kept, while there are too few images, if vision and IMU contradict
            each other, or while tilt or velocity are too uncertain.
        """
        core, t_ns = self._core, self._core.imu_time(frame.t_ns)
        is_covered = not self._t_ns or core.inertial.covers(self._t_ns[0])
        if not is_covered or (self._t_ns and not 0 < t_ns - self._before_ns < _MAX_GAP_S * 1e9):
            self.reset()
        self._tracker.set_image(frame.grey)
        self._track(t_ns)
        self._before_ns = t_ns
        if self._t_ns and (t_ns - self._t_ns[-1]) * 1e-9 < _MIN_INTERVAL_S:
            return None
        self._store_observations(frame, t_ns)
        if len(self._t_ns) < _MIN_IMAGES:
            return None
        alignment = self._align()
        if alignment is None or alignment.misfit > _MAX_MISFIT:
            return None
        variance = alignment.covariance.diagonal()  # 0-1 tilt, 2-4 velocity
        is_certain = variance[:2].max() < _MAX_TILT_SD_RAD**2 and variance[2:5].sum() < _MAX_SPEED_SD_MPS**2
        return alignment if is_certain else None

    def _track(self, t_ns: int) -> None:
        """Tracks the points of the previous image into the tracker's last image, which was taken at `t_ns`.

        The search begins where the rotation by the gyroscope puts them. Points that are lost are no longer alive.
        """
        ids = np.flatnonzero(self._alive)  # points that the previous image shows
        if not len(ids):
            return
        core, z = self._core, blank_preintegration()
        kernel.integrate(z, core.inertial.imu_samples, self._before_ns, t_ns, core.nav.bias, core.noise)
        R_ic, previous_px = core.window.calibration.R, self._pixels[ids]
        # (N, 3) in the new camera; a depth of at least 0.2 keeps points that have left the view finite
        rays = directions(core.lens.to_normalized(previous_px)) @ (R_ic.T @ z.delta_R @ R_ic)
        expected_px = core.lens.pixels(rays[:, :2] / np.maximum(rays[:, 2:], 0.2))
        tracked_px, good = self._tracker.track(previous_px, expected_px)
        self._alive[ids] = good
        self._pixels[ids] = tracked_px

    def _store_observations(self, frame: CameraFrame, t_ns: int) -> None:
        """Stores the observations of an image at `t_ns`, and searches for new points in it.

        The oldest image is dropped if there are `_IMAGES` already. Observations and depths are corrected by the
        estimated focal lengths and depth scale. A slot is free for a new point if no kept image sees its old one.
        """
        core, c = self._core, self._core.window.calibration
        if len(self._t_ns) == _IMAGES:
            self._t_ns.pop(0)
            for a in (self._seen, self._at, self._rho):
                a[:-1] = a[1:].copy()
        k = len(self._t_ns)  # row of this image
        self._t_ns.append(t_ns)
        free = np.flatnonzero(~self._seen[:k].any(axis=0) & ~self._alive)
        wanted = min(core.parameters.landmarks - int(self._alive.sum()), len(free))
        points = self._tracker.find(self._pixels[self._alive], wanted)
        new = free[: len(points)]
        self._pixels[new], self._alive[new] = points, True
        ids = np.flatnonzero(self._alive)
        self._seen[k], self._rho[k] = self._alive, 0.0
        self._at[k, ids] = core.lens.to_normalized(self._pixels[ids]) * (1.0 + c.focal)
        self._rho[k, ids] = core.inverse_depths(frame, self._pixels[ids]) / c.scale[0]

    def _align(self) -> Alignment | None:
        """The alignment of the images collected so far; None if their structure is not determined."""
        structure = self._estimate_structure()
        if structure is None:
            return None
        core, t_ns = self._core, self._t_ns[structure.first :]  # times of the images that the structure has
        preintegrations = blank_preintegration(len(t_ns) - 1)
        for k in range(len(t_ns) - 1):
            preintegrate(preintegrations, k, core.inertial.imu_samples, t_ns[k], t_ns[k + 1], core.nav.bias, core.noise)
        rates = np.array([core.inertial.rate_at(t) for t in t_ns])
        return align_vision_imu(structure, preintegrations, rates, self._build_priors())

    def _estimate_structure(self) -> Structure | None:
        """Structure of the kept images, with measured depths where there are any.

        None if it is not determined, or if fewer than `_MIN_IMAGES` of them are connected.
        """
        p, K = self._core.parameters, len(self._t_ns)
        in_two_images = self._seen[:K].sum(axis=0) > 1  # points of any use
        s = Observations(
            seen=self._seen[:K, in_two_images],
            at=self._at[:K, in_two_images],
            rho=self._rho[:K, in_two_images],
            sd=p.pixel_noise_px / self._core.lens.focal_px,
            rho_sd=LATER_DEPTH_SD * p.inverse_depth_sd_per_m,
        )
        structure = structure_with_depth(s) if (s.rho > 0).any() else structure_without_depth(s)
        return None if structure is None or len(structure.R) < _MIN_IMAGES else structure

    def _build_priors(self) -> Priors:
        """Prior knowledge of mount, clock, depth scale and biases from the window's parameters."""
        # the estimated calibration, and how far it may be off
        core, c, prior = self._core, self._core.window.calibration, self._core.calibration_prior
        T_imu_camera: Array = np.eye(4)
        T_imu_camera[:3, :3], T_imu_camera[:3, 3] = c.R, c.p
        return Priors(
            T_imu_camera=T_imu_camera,
            bias=core.nav.bias.copy(),
            bias_sd=core.bias_sd,
            mount_sd=np.repeat(prior.mount_sd, 3),  # three axes of position, then of rotation
            offset_sd=prior.offset_sd_s,
            scale_sd=prior.depth_scale_sd,
            gravity=core.parameters.gravity_mps2,
        )
