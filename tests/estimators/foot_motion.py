"""A walking foot in closed form, and what an IMU on its heel measures: a filter's test without the twin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Imu

GRAVITY = 9.8029
SENSOR_FROM_TOE = np.array([-0.24, 0.0, 0.07])  # m, foot frame; the foot rolls over its toe

ADIS16485 = ImuCalibration(
    topic="/foot_l/imu",
    part="ADIS16485",
    rate_hz=120.0,
    mount=Mount(body="foot_l"),
    gyroscope_noise_density=np.radians(0.3) / 60.0,
    gyroscope_random_walk=1e-6,
    accelerometer_noise_density=0.023 / 60.0,
    accelerometer_random_walk=1e-5,
    gyroscope_bias_sd=np.radians(0.2),
    accelerometer_bias_sd=0.03,
)


def rig_of(calibration: ImuCalibration) -> Rig:
    """A rig with one IMU alone."""
    return Rig(imus={calibration.topic: calibration})


LEFT_FOOT = rig_of(ADIS16485)
# with a known scale error of the forces; the filter of one foot then considers no error of the sensor
CALIBRATED = replace(ADIS16485, accelerometer_scale_sd=0.01)


def ranges(gyro_radps: float = 0.0, accel_mps2: float = 0.0) -> ImuCalibration:
    """A sensor of which the limits alone are known; 0: not even these."""
    return ImuCalibration(
        topic="/foot_l/imu",
        part="",
        rate_hz=120.0,
        mount=Mount(body="foot_l"),
        gyroscope_noise_density=0.0,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=0.0,
        accelerometer_random_walk=0.0,
        gyroscope_range=gyro_radps,
        accelerometer_range=accel_mps2,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """Truth of the sensor and what it measures.

    Attributes:
        t_ns: (N,) ends of the samples.
        p_imu_in_world: (N, 3) m.
        q_world_imu: (N, 4) w, x, y, z.
        imu: N samples.
        distance: Length of the way, m.
    """

    t_ns: np.ndarray
    p_imu_in_world: Array
    q_world_imu: Array
    imu: Block[Imu]
    distance: float


def walk(
    *,
    strides: int = 15,
    rise: float = 0.0,
    rate_hz: float = 120.0,
    rest_s: float = 2.0,
    stride_m: float = 1.35,
    stride_s: float = 1.1,
    turn_rad: float = 0.0,
    slow_heel_rad: float = 0.0,
    R_foot_imu: Array | None = None,
    calibration: ImuCalibration | None = None,
    rng: np.random.Generator | None = None,
) -> Walk:
    """Rest, walk, rest. `rise` is climbed in each stride of the first half and descended in the second.

    Args:
        strides: Number of strides of the foot.
        rise: m.
        rate_hz: Sample rate.
        rest_s: Rest before and after.
        stride_m: Stride length.
        stride_s: Stride time.
        turn_rad: Heading gained over the whole walk.
        slow_heel_rad: How far the heel rises, at leisure, before it pushes off.
        R_foot_imu: (3, 3) mounting; identity by default.
        calibration: Noise and turn-on biases of the sensor; exact samples without.
        rng: Draws the noise.
    """
    mount = np.eye(3) if R_foot_imu is None else R_foot_imu
    n = round((2 * rest_s + strides * stride_s) * rate_hz)
    t = np.arange(n + 1) / rate_hz
    phase = (t - rest_s) / stride_s
    k = np.clip(np.floor(phase), 0, strides - 1)
    u = np.clip(phase - k, 0.0, 1.0)  # 0 foot flat, 0.35..0.6 heel off, 0.5..0.9 swing, 1 foot flat

    s = np.clip((u - 0.5) / 0.4, 0.0, 1.0)
    advance = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    lift = 64.0 * (s * (1.0 - s)) ** 3 * 0.06
    up = np.where(k < strides / 2, rise, -rise)
    height = np.concatenate([[0.0], np.cumsum(np.where(np.arange(strides) < strides / 2, rise, -rise))])
    heading = turn_rad / strides * np.arange(strides + 1)
    way = np.vstack([np.zeros(2), np.cumsum(stride_m * np.c_[np.cos(heading[1:]), np.sin(heading[1:])], axis=0)])
    i = k.astype(int)
    toe = np.column_stack([way[i] + advance[:, None] * (way[i + 1] - way[i]), height[i] + advance * up + lift])
    pitch = CubicSpline(
        [0.0, 0.15, 0.30, 0.52, 0.72, 0.86, 0.93, 1.0],
        np.radians([0.0, 0.0, 0.0, 55.0, 10.0, -18.0, 0.0, 0.0]),
        bc_type=((1, 0.0), (1, 0.0)),
    )(u)
    pitch[(u < 0.30) | (u > 0.93)] = 0.0
    pitch += slow_heel_rad * np.interp(u, [0.1, 0.3, 0.5, 0.7], [0.0, 1.0, 1.0, 0.0])
    smooth = np.exp(-0.5 * (np.arange(-30, 31) / (0.012 * rate_hz)) ** 2)
    pitch = np.convolve(np.pad(pitch, 30), smooth / smooth.sum(), "valid")
    yaw = heading[i] + advance * (heading[i + 1] - heading[i])
    R_world_foot = Rotation.from_euler("ZY", np.column_stack([yaw, pitch]))
    p = toe + R_world_foot.apply(SENSOR_FROM_TOE)

    R = R_world_foot * Rotation.from_matrix(mount)
    step = R[:-1].inv() * R[1:]
    rate = step.as_rotvec() * rate_hz
    middle = R[:-1] * Rotation.from_rotvec(0.5 * step.as_rotvec())
    velocity = CubicSpline(t, p)(t, 1)
    force = middle.inv().apply(np.diff(velocity, axis=0) * rate_hz + [0.0, 0.0, GRAVITY])
    if calibration is not None and rng is not None:
        white = np.sqrt(rate_hz)
        rate = rate + calibration.gyroscope_bias_sd * rng.standard_normal(3)
        rate += calibration.gyroscope_noise_density * white * rng.standard_normal(rate.shape)
        force = force + calibration.accelerometer_bias_sd * rng.standard_normal(3)
        force += calibration.accelerometer_noise_density * white * rng.standard_normal(force.shape)
    t_ns = np.round(t[1:] * 1e9).astype(np.int64)
    block = Block(topic="/foot_l/imu", kind=Imu, t_ns=t_ns, columns={"angular_rate": rate, "specific_force": force})
    return Walk(
        t_ns=t_ns,
        p_imu_in_world=p[1:],
        q_world_imu=R[1:].as_quat(scalar_first=True),
        imu=block,
        distance=strides * stride_m,
    )
