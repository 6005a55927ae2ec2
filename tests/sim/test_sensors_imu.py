import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.sim.noise import Noise
from stridetwin.sim.sensors.imu import GRAVITY, ImuModel
from stridetwin.sim.track import Track
from stridetwin.streams.rig import ImuCalibration, Mount

STILL = Noise(None)


def imu(T_body_sensor=None, rate_hz=120.0):
    return ImuCalibration(
        topic="/foot_l/imu",
        part="",
        rate_hz=rate_hz,
        mount=Mount(body="foot_l", T_body_sensor=np.eye(4) if T_body_sensor is None else T_body_sensor),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=2e-3,
        accelerometer_random_walk=0.0,
        gyroscope_bias_sd=0.01,
        accelerometer_bias_sd=0.05,
    )


def attitude(t):
    return Rotation.from_euler(
        "ZYX",
        np.column_stack([0.4 * np.sin(0.9 * t), 1.1 * np.sin(4 * np.pi * t), 0.25 * np.sin(6 * np.pi * t + 0.3)]),
    )


def foot_like(t):
    """A foot's motion with peaks of 4.5 m/s and 800 deg/s; analytic but for the rate (central difference)."""
    w = 2 * np.pi
    p = np.column_stack([1.5 * t + 3 / w * np.sin(w * t), 0.05 * np.sin(w * t), 0.1 * (1 - np.cos(2 * w * t))])
    v = np.column_stack([1.5 + 3 * np.cos(w * t), 0.05 * w * np.cos(w * t), 0.2 * w * np.sin(2 * w * t)])
    h = 1e-5
    rate = (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2 * h)
    return Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=p,
        q_world_body=attitude(t).as_quat(scalar_first=True),
        v_body_in_world=v,
        w_body=rate,
    )


def instants(rate_hz, seconds):
    return np.round(np.arange(int(seconds * rate_hz) + 1) / rate_hz, 9)


def strapdown(block, start):
    """Velocity in closed form for constant rate and force over an interval, position by its trapezoids."""
    R, p, v = start.rotation[0], start.p_body_in_world[0], start.v_body_in_world[0]
    t = block.t_ns * 1e-9
    path = [p]
    for k in range(1, len(block)):
        dt = t[k] - t[k - 1]
        phi, f = block.columns["angular_rate"][k] * dt, block.columns["specific_force"][k]
        hat = np.cross(np.eye(3), phi)
        gamma1, power = np.eye(3), np.eye(3)
        for n in range(1, 14):  # integral of Exp(s phi) over s in 0-1, as a series
            power = power @ hat / n
            gamma1 = gamma1 + power / (n + 1)
        before = v
        v = v + np.array([0.0, 0.0, -GRAVITY]) * dt + R.apply(gamma1 @ f) * dt
        p = p + (before + v) / 2 * dt
        R = R * Rotation.from_rotvec(phi)
        path.append(p)
    return np.array(path), v, R


@pytest.mark.parametrize("rate_hz", [120.0, 200.0])
def test_an_ideal_imu_integrates_back_to_the_true_path(rate_hz):
    track = foot_like(instants(rate_hz, 20.0))
    assert np.linalg.norm(track.v_body_in_world, axis=1).max() > 4.4
    assert np.degrees(np.linalg.norm(track.w_body, axis=1)).max() > 780
    lever = np.eye(4)
    lever[:3, :3] = Rotation.from_euler("XYZ", [0.3, -0.2, 0.5]).as_matrix()
    lever[:3, 3] = [-0.03, 0.04, 0.06]
    block = ImuModel(imu(lever, rate_hz), STILL).read(track)
    sensor = track.mounted(lever)
    path, v, R = strapdown(block, sensor)
    error = np.linalg.norm(path - sensor.p_body_in_world, axis=1)
    assert error[-1] < 1e-4
    assert error.max() < 1e-3
    np.testing.assert_allclose(v, sensor.v_body_in_world[-1], atol=1e-9)
    assert (R.inv() * sensor.rotation[-1]).magnitude() < 1e-9


def test_chunks_make_no_difference():
    track = foot_like(instants(120.0, 2.0))
    whole = ImuModel(imu(), Noise.of_topic(3, "/foot_l/imu")).read(track)
    model = ImuModel(imu(), Noise.of_topic(3, "/foot_l/imu"))
    parts = [model.read(track[a:b]) for a, b in ((0, 1), (1, 100), (100, 241))]
    for name, column in whole.columns.items():
        np.testing.assert_allclose(np.concatenate([p.columns[name] for p in parts]), column, atol=1e-9)


def test_at_rest_it_feels_gravity_upwards():
    t = instants(120.0, 1.0)
    still = Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=np.zeros((len(t), 3)),
        q_world_body=np.tile([1.0, 0, 0, 0], (len(t), 1)),
        v_body_in_world=np.zeros((len(t), 3)),
        w_body=np.zeros((len(t), 3)),
    )
    block = ImuModel(imu(), STILL).read(still)
    np.testing.assert_allclose(block.columns["specific_force"], np.tile([0, 0, 9.81], (len(t), 1)), atol=1e-12)
    np.testing.assert_allclose(block.columns["angular_rate"], 0.0, atol=1e-12)
    assert next(iter(block)).specific_force.shape == (3,)


def test_noise_has_the_density_and_the_bias_of_the_part():
    t = instants(120.0, 300.0)
    n = len(t)
    still = Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=np.zeros((n, 3)),
        q_world_body=np.tile([1.0, 0, 0, 0], (n, 1)),
        v_body_in_world=np.zeros((n, 3)),
        w_body=np.zeros((n, 3)),
    )
    blocks = [ImuModel(imu(), Noise.of_topic(seed, "/foot_l/imu")).read(still) for seed in range(30)]
    rate = np.array([b.columns["angular_rate"] for b in blocks])
    np.testing.assert_allclose(rate.std(axis=1).mean(), 1e-3 * np.sqrt(120), rtol=0.02)
    np.testing.assert_allclose(rate.mean(axis=1).std(), 0.01, rtol=0.25)
    force = np.array([b.columns["specific_force"] for b in blocks])
    np.testing.assert_allclose(force.std(axis=1).mean(), 2e-3 * np.sqrt(120), rtol=0.02)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_a_mounted_track_is_a_rigid_body(seed):
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(0, 0.2, 3)
    h = 1e-4
    t = rng.uniform(0, 5) + np.array([-h, 0.0, h])
    sensor = foot_like(t).mounted(T)
    speed = (sensor.p_body_in_world[2] - sensor.p_body_in_world[0]) / (2 * h)
    np.testing.assert_allclose(sensor.v_body_in_world[1], speed, atol=1e-4)
    turn = (sensor.rotation[0].inv() * sensor.rotation[2]).as_rotvec() / (2 * h)
    np.testing.assert_allclose(sensor.w_body[1], turn, atol=1e-3)
    np.testing.assert_allclose(sensor.poses(), foot_like(t).poses() @ T, atol=1e-12)


def test_one_topic_never_changes_another():
    a = Noise.of_topic(7, "/foot_l/imu").normal(1.0, 5)
    Noise.of_topic(7, "/foot_r/imu").normal(1.0, 99)
    np.testing.assert_array_equal(a, Noise.of_topic(7, "/foot_l/imu").normal(1.0, 5))
    assert not np.allclose(a, Noise.of_topic(7, "/foot_r/imu").normal(1.0, 5))
    assert not np.allclose(a, Noise.of_topic(8, "/foot_l/imu").normal(1.0, 5))
    assert np.all(Noise.of_topic(7, "/foot_l/imu", ideal=True).normal(1.0, 5) == 0)
