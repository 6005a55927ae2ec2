"""Points of a rolling shutter at the time of the image: against finite differences, and rows seen one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio.state import blank_window
from stridetwin.estimators.dvio.tracker import Lens, image_velocity
from stridetwin.streams.rig import CameraCalibration, Mount

HEIGHT, READOUT_S = 360, 0.016
three = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


def camera(readout_s: float) -> CameraCalibration:
    return CameraCalibration(
        topic="/head/color",
        part="",
        rate_hz=30.0,
        mount=Mount(body="head"),
        width=640,
        height=HEIGHT,
        intrinsics=(465.0, 465.0, 319.5, 179.5),
        distortion=(0.05, -0.02, 1e-3, 1e-3),
        readout_s=readout_s,
    )


def calibration(T_imu_camera: np.ndarray):
    return blank_window(3, 8, T_imu_camera, 0.0).calibration


@given(st.tuples(st.floats(-0.7, 0.7), st.floats(-0.4, 0.4)), st.floats(0.1, 2.0), three, three)
def test_the_motion_in_the_image_is_its_derivative(at, rho, velocity, rate):
    at, dt = np.array([at]), 1e-6
    point = np.append(at[0], 1.0) / rho
    later = Rotation.from_rotvec(rate * dt).inv().apply(point - velocity * dt)
    found = image_velocity(at, np.array([rho]), velocity, rate)
    np.testing.assert_allclose(found, [(later[:2] / later[2] - at[0]) / dt], atol=1e-4)


@given(st.integers(0, 2**32 - 1), three, three)
def test_points_seen_row_by_row_are_moved_to_where_they_are_at_the_image_s_time(seed, v, rate):
    rng, lens = np.random.default_rng(seed), Lens(camera(READOUT_S))
    R_world_imu = Rotation.random(random_state=rng)
    T_imu_camera = np.eye(4)
    T_imu_camera[:3, :3], T_imu_camera[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3)
    R_world_camera = R_world_imu * Rotation.from_matrix(T_imu_camera[:3, :3])
    p_camera = R_world_imu.apply(T_imu_camera[:3, 3])
    rho = rng.uniform(0.3, 1.0, 12)
    true = rng.uniform([60, 40], [580, 320], (12, 2)).astype(np.float32)
    points = R_world_camera.apply(np.column_stack([lens.to_normalized(true), np.ones(12)]) / rho[:, None]) + p_camera

    def seen(t_s: np.ndarray) -> np.ndarray:
        """Where the points are at a time each."""
        R_t = R_world_imu * Rotation.from_rotvec(t_s[:, None] * rate)
        p_t = R_t.apply(T_imu_camera[:3, 3]) + t_s[:, None] * v
        inside = (R_t * Rotation.from_matrix(T_imu_camera[:3, :3])).inv().apply(points - p_t)
        return lens.pixels(inside[:, :2] / inside[:, 2:])

    rows = true
    for _ in range(5):  # the row decides when a point is seen, and the time in which row
        rows = seen((rows[:, 1] / (HEIGHT - 1) - 0.5) * READOUT_S)
    back = lens.at_image_time(rows, rho, calibration(T_imu_camera), R_world_imu.as_matrix(), v, rate)
    assert np.abs(back - true).max() <= 0.02 * np.abs(rows - true).max() + 0.1


def test_a_global_shutter_leaves_points_as_they_are():
    points = np.array([[10.0, 20.0]], np.float32)
    lens, one = Lens(camera(0.0)), np.ones(3)
    assert lens.at_image_time(points, np.ones(1), calibration(np.eye(4)), np.eye(3), one, one) is points


@given(st.integers(0, HEIGHT - 1), three, three)
def test_a_row_is_as_late_as_it_is_far_from_the_middle(row, v, rate):
    lens, at = Lens(camera(READOUT_S)), np.array([[319.5, row]], np.float32)
    back = lens.at_image_time(at, np.ones(1), calibration(np.eye(4)), np.eye(3), v, rate)
    late_s = (row / (HEIGHT - 1) - 0.5) * READOUT_S
    moved = image_velocity(lens.to_normalized(at), np.ones(1), v, rate) * late_s
    np.testing.assert_allclose(lens.to_normalized(back), lens.to_normalized(at) - moved, atol=1e-6, rtol=1e-5)
