"""The odometry's state and noise model, as arrays of fixed size that the compiled kernels change in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array


class FactorParameters(NamedTuple):
    """Noise model of the factors, and which factors are used.

    Attributes:
        gravity: m/s².
        pixel_weight: 1 / variance of an observation on the plane at depth 1.
        depth_weight: 1 / variance of the host's measured inverse depth, m².
        later_depth_weight: 1 / variance of an inverse depth measured by another frame, m².
        huber_sd: Observations and measured depths beyond this many standard deviations are down-weighted.
        host_depth: docs/dvio.md (8) is used.
        depth_fixed: A landmark keeps the host's measured depth.
        projection_depth: docs/dvio.md (9) is used.
        host_depth_in_prior: docs/dvio.md (8) is marginalised into the prior.
        first_estimates: Jacobians of frames in the prior are taken at their first estimates.
        rate_walk: Random walk of the gyroscope's bias, rad/s²/√Hz.
        force_walk: Random walk of the accelerometer's bias, m/s³/√Hz.
    """

    gravity: float
    pixel_weight: float
    depth_weight: float
    later_depth_weight: float
    huber_sd: float
    host_depth: bool
    depth_fixed: bool
    projection_depth: bool
    host_depth_in_prior: bool
    first_estimates: bool
    rate_walk: float
    force_walk: float


# Error state: that of the calibration first, then of each frame from the oldest to the newest.
# Rotations have their error on the right, R_true = R Exp(e).
# Calibration: 0-2 position and 3-5 rotation of the camera on the IMU (IC), 6 time offset, 7 depth scale, 8-9 focal
# lengths. Frame: 0-2 position, 3-5 attitude, 6-8 velocity, 9-11 bias of the gyroscope, 12-14 of the accelerometer.
D_POSITION_IC, D_ATTITUDE_IC, D_OFFSET, D_SCALE, D_FOCAL = 0, 3, 6, 7, 8
CALIBRATION = 10
D_POSITION, D_ATTITUDE, D_VELOCITY, D_GYRO_BIAS, D_ACCEL_BIAS = 0, 3, 6, 9, 12
FRAME = 15
NO_HOST = -1
LANDMARK_SLOTS = 256
"""Number of landmarks in the window, tracked or not."""


class ImuNoise(NamedTuple):
    """Noise of an IMU's samples.

    Attributes:
        rate: Density of the white noise of the angular rate, rad/s/√Hz.
        force: Density of the white noise of the specific force, m/s²/√Hz.
        rate_share: Noise proportional to the rate, for errors of scale and axes that last about a second, √s.
        rate_walk: Density of the random walk of the gyroscope's bias, rad/s²/√Hz.
        force_walk: Density of the random walk of the accelerometer's bias, m/s³/√Hz.
        invalid_rate: Standard deviation of a rate that is saturated or replaces missing ones, rad/s.
        invalid_force: Standard deviation of such a specific force, m/s².
    """

    rate: float
    force: float
    rate_share: float
    rate_walk: float
    force_walk: float
    invalid_rate: float
    invalid_force: float


class ImuSamples(NamedTuple):
    """Samples of the IMU in time order.

    Attributes:
        t_ns: (N,) end of the interval that each is the mean of.
        values: (N, 6) rate (rad/s) and specific force (m/s²).
        invalid: (N,) 1 where a sample is saturated or replaces missing ones.
    """

    t_ns: NDArray[np.int64]
    values: Array
    invalid: NDArray[np.uint8]


class Preintegration(NamedTuple):
    """Preintegrated IMU measurement between two frames, in the first one's axes, without gravity.

    Attributes:
        dt: (1,) time between the frames, s.
        delta_p: (3,) change of position, m.
        delta_R: (3, 3) rotation, second to first frame.
        delta_v: (3,) change of velocity, m/s.
        by_bias: (9, 6) derivative of position, rotation and velocity by the biases of gyroscope and accelerometer.
        covariance: (9, 9) of position, rotation and velocity.
        weight: (9, 9) its inverse, where the increment is a factor of the window.
        bias: (6,) at which it was integrated, rad/s and m/s².
    """

    dt: Array
    delta_p: Array
    delta_R: Array
    delta_v: Array
    by_bias: Array
    covariance: Array
    weight: Array
    bias: Array


class Frames(NamedTuple):
    """States of the window's frames: F slots, of which the first `count` are in use, the last of them the newest.

    Attributes:
        count: (1,) int64, number of slots in use.
        t_ns: (F,) time of the state on the IMU's clock.
        R: (F, 3, 3) world <- IMU.
        p: (F, 3) IMU in the world, m.
        v: (F, 3) velocity in the world, m/s.
        bias: (F, 6) of gyroscope (rad/s) and accelerometer (m/s²).
        in_prior: (F,) 1 where the prior contains the frame; its Jacobians are then taken at its first estimate.
        R_first: (F, 3, 3) first estimate of `R`.
        p_first: (F, 3) first estimate of `p`.
        v_first: (F, 3) first estimate of `v`.
        bias_first: (F, 6) first estimate of `bias`.
        moved: (F, 15) deviation of the state from its first estimate.
        rate: (F, 3) angular rate at the frame, rad/s.
        offset: (F,) time offset by which `t_ns` was computed, s.
        zero_velocity_sd: (F,) standard deviation of the velocity about 0, m/s; inf if not known to be stationary.
    """

    count: NDArray[np.int64]  # type: ignore[assignment]
    t_ns: NDArray[np.int64]
    R: Array
    p: Array
    v: Array
    bias: Array
    in_prior: NDArray[np.uint8]
    R_first: Array
    p_first: Array
    v_first: Array
    bias_first: Array
    moved: Array
    rate: Array
    offset: Array
    zero_velocity_sd: Array


class Landmarks(NamedTuple):
    """Tracked points: L slots.

    Attributes:
        host: (L,) slot of the frame that first saw it, NO_HOST where the slot is free.
        inverse_depth: (L,) in the host's camera, 1/m.
        slope: (L, 2) change of the inverse depth about it over the plane at depth 1 of the host, 1/m.
        measured: (L,) 1 if a depth camera or parallax has measured it.
        seen: (L, F) 1 where the frame saw it.
        at: (L, F, 2) where, on the plane at depth 1.
        rho: (L, F) measured 1 / depth there, 1/m; 0 where none.
    """

    host: NDArray[np.int64]
    inverse_depth: Array
    slope: Array
    measured: NDArray[np.uint8]
    seen: NDArray[np.uint8]
    at: Array
    rho: Array


class Calibration(NamedTuple):
    """Estimated calibration of the sensors.

    Attributes:
        R: (3, 3) IMU <- camera.
        p: (3,) camera in the IMU's frame, m.
        offset: (1,) t_imu = t_cam + offset, s.
        scale: (1,) true over measured depth.
        focal: (2,) relative corrections of x and y of an observation by the nominal focal lengths.
        moved: (10,) deviation from the prior's linearisation point.
    """

    R: Array
    p: Array
    offset: Array
    scale: Array
    focal: Array
    moved: Array


class Prior(NamedTuple):
    """Information of marginalised states: ½ dᵀ H d − bᵀ d of errors d from first estimates (Zhao 2023 (6)).

    Attributes:
        H: (N, N) information matrix.
        b: (N,) information vector.
    """

    H: Array
    b: Array


class WindowState(NamedTuple):
    """State of the sliding window: all that the optimisation reads and changes.

    Attributes:
        frames: States of the frames.
        preintegrations: Preintegrated IMU from each frame to the next, each array with a leading axis F.
        landmarks: Landmarks with their observations.
        calibration: Estimated calibration of the sensors.
        prior: Information on calibration and frames from marginalised states.
    """

    frames: Frames
    preintegrations: Preintegration
    landmarks: Landmarks
    calibration: Calibration
    prior: Prior


def blank_preintegration(slots: int | None = None) -> Preintegration:
    """Preintegrated measurements of zero duration: one, or `slots` of them with a leading axis."""
    lead = () if slots is None else (slots,)
    delta_R = np.zeros((*lead, 3, 3))
    delta_R[...] = np.eye(3)
    return Preintegration(
        dt=np.zeros((*lead, 1)),
        delta_p=np.zeros((*lead, 3)),
        delta_R=delta_R,
        delta_v=np.zeros((*lead, 3)),
        by_bias=np.zeros((*lead, 9, 6)),
        covariance=np.zeros((*lead, 9, 9)),
        weight=np.zeros((*lead, 9, 9)),
        bias=np.zeros((*lead, 6)),
    )


def blank_window(frames: int, landmarks: int, T_imu_camera: Array, offset_s: float) -> WindowState:
    """An empty window: no frame, no landmark, no prior, and the nominal calibration.

    Args:
        frames: Number of slots for frames.
        landmarks: Number of slots for landmarks.
        T_imu_camera: (4, 4) nominal mount, camera to IMU, m.
        offset_s: Nominal offset of the camera's clock: t_imu = t_cam + offset.
    """
    F, L, states = frames, landmarks, CALIBRATION + FRAME * frames
    identities = np.zeros((F, 3, 3))
    identities[:] = np.eye(3)
    return WindowState(
        frames=Frames(
            count=np.zeros(1, np.int64),
            t_ns=np.zeros(F, np.int64),
            R=identities.copy(),
            p=np.zeros((F, 3)),
            v=np.zeros((F, 3)),
            bias=np.zeros((F, 6)),
            in_prior=np.zeros(F, np.uint8),
            R_first=identities.copy(),
            p_first=np.zeros((F, 3)),
            v_first=np.zeros((F, 3)),
            bias_first=np.zeros((F, 6)),
            moved=np.zeros((F, FRAME)),
            rate=np.zeros((F, 3)),
            offset=np.zeros(F),
            zero_velocity_sd=np.full(F, np.inf),
        ),
        preintegrations=blank_preintegration(F),
        landmarks=Landmarks(
            host=np.full(L, NO_HOST, np.int64),
            inverse_depth=np.zeros(L),
            slope=np.zeros((L, 2)),
            measured=np.zeros(L, np.uint8),
            seen=np.zeros((L, F), np.uint8),
            at=np.zeros((L, F, 2)),
            rho=np.zeros((L, F)),
        ),
        calibration=Calibration(
            R=np.array(T_imu_camera[:3, :3], dtype=float, order="C"),
            p=np.array(T_imu_camera[:3, 3], dtype=float),
            offset=np.array([float(offset_s)]),
            scale=np.ones(1),
            focal=np.zeros(2),
            moved=np.zeros(CALIBRATION),
        ),
        prior=Prior(H=np.zeros((states, states)), b=np.zeros(states)),
    )
