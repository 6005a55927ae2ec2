"""Parts of the odometry against plain arithmetic: prediction, samples, planes of an image, level ground."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import DvioParameters, level, nav_state, plane_cells
from stridetwin.estimators.dvio.estimate import DvioEstimate
from stridetwin.estimators.dvio.level import LevelGround, Slope
from stridetwin.estimators.dvio.nav_state import ImuBuffer, blank_nav_state
from stridetwin.estimators.dvio.sliding_window import SlidingWindow
from stridetwin.estimators.dvio.state import blank_preintegration, blank_window
from stridetwin.estimators.dvio.tracker import Lens
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount
from stridetwin.streams.samples import Imu
from stridetwin.streams.trajectory import Pose
from tests.estimators.dvio.scenes import NOISE
from tests.estimators.from_python import from_python

GRAVITY = 9.81


def measured(rng):
    """A preintegrated measurement with arbitrary values, and a nav state with an arbitrary covariance."""
    z, nav = blank_preintegration(), blank_nav_state()
    z.dt[0], z.delta_p[:], z.delta_v[:] = 0.2, rng.normal(size=3), rng.normal(size=3)
    z.delta_R[:] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    z.by_bias[:] = 0.1 * rng.normal(size=(9, 6))
    B, C = rng.normal(size=(9, 9)), rng.normal(size=(15, 15))
    z.covariance[:], nav.covariance[:] = 1e-4 * B @ B.T, 1e-3 * C @ C.T
    nav.R[:] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    nav.p[:], nav.v[:], nav.bias[:] = rng.normal(size=3), rng.normal(size=3), 0.01 * rng.normal(size=6)
    return z, nav


def predicted(nav, z, error, noise):
    """(R, p, v, bias) after the measurement, from a state with an error (15,) and with its own noise (9,)."""
    R = nav.R @ Rotation.from_rotvec(error[3:6]).as_matrix()
    change = z.by_bias @ error[9:] + noise
    delta_R = z.delta_R @ Rotation.from_rotvec(change[3:6]).as_matrix()
    dt, down = z.dt[0], np.array([0.0, 0.0, GRAVITY])
    p = nav.p + error[:3] + (nav.v + error[6:9]) * dt - 0.5 * down * dt**2 + R @ (z.delta_p + nav.R.T @ np.zeros(3))
    p = p + nav.R @ change[:3]
    v = nav.v + error[6:9] - down * dt + R @ z.delta_v + nav.R @ change[6:]
    return R @ delta_R, p, v, nav.bias + error[9:]


@pytest.mark.parametrize("seed", range(3))
def test_a_predicted_state_has_the_covariance_of_its_slopes(seed):
    z, nav = measured(np.random.default_rng(seed))
    before = SimpleNamespace(**{name: getattr(nav, name).copy() for name in ("R", "p", "v", "bias", "covariance")})
    from_python(nav_state.add_increment)(nav, z, NOISE, GRAVITY)
    R, p, v, bias = predicted(before, z, np.zeros(15), np.zeros(9))
    for a, b in ((nav.R, R), (nav.p, p), (nav.v, v), (nav.bias, bias)):
        np.testing.assert_allclose(a, b, atol=1e-12)

    def off(error, noise):
        R1, p1, v1, bias1 = predicted(before, z, error, noise)
        return np.r_[p1 - p, Rotation.from_matrix(R.T @ R1).as_rotvec(), v1 - v, bias1 - bias]

    h = 1e-6
    F = np.array([(off(h * e, np.zeros(9)) - off(-h * e, np.zeros(9))) / (2 * h) for e in np.eye(15)]).T
    G = np.array([(off(np.zeros(15), h * e) - off(np.zeros(15), -h * e)) / (2 * h) for e in np.eye(9)]).T
    walk = np.r_[np.zeros(9), np.full(3, NOISE.rate_walk**2 * 0.2), np.full(3, NOISE.force_walk**2 * 0.2)]
    expected = F @ before.covariance @ F.T + G @ z.covariance @ G.T + np.diag(walk)
    np.testing.assert_allclose(nav.covariance, expected, rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(nav.covariance, nav.covariance.T)


def test_a_pose_and_its_covariance_are_in_world_axes():
    _, nav = measured(np.random.default_rng(3))
    camera_pose = Pose(t_ns=0, p_frame_in_world=np.zeros(3), rotation=np.eye(3), frame="head/color")
    found = DvioEstimate.of(nav, "tracking", camera_pose)
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = nav.R, nav.p
    np.testing.assert_array_equal(found.pose.T_world_frame, expected)
    turn = np.eye(6)
    turn[3:, 3:] = nav.R
    np.testing.assert_allclose(found.covariance, turn @ nav.covariance[:6, :6] @ turn.T, atol=1e-15)


def test_a_state_is_plausible_if_all_of_it_is_finite_and_within_its_limits():
    plausible = from_python(nav_state.is_plausible)
    assert plausible(blank_nav_state())
    for name, at in (
        ("p", 0),
        ("p", 2),
        ("R", (0, 0)),
        ("R", (1, 1)),
        ("R", (2, 2)),
        ("v", 1),
        ("bias", 0),
        ("bias", 5),
        ("covariance", (0, 14)),
        ("covariance", (14, 14)),
    ):
        for value in (math.nan, math.inf):
            nav = blank_nav_state()
            getattr(nav, name)[at] = value
            assert not plausible(nav), (name, at)
    for name, at, most in (("v", 2, 15.0), ("bias", 1, 0.5), ("bias", 2, 0.5), ("bias", 3, 3.0), ("bias", 4, 3.0)):
        for factor, expected in ((0.99, True), (1.01, False), (-0.99, True), (-1.01, False)):
            nav = blank_nav_state()
            getattr(nav, name)[at] = factor * most
            assert plausible(nav) == expected, (name, at, factor)


def inertial(rate_hz=100.0):
    return ImuBuffer(
        ImuCalibration(
            topic="/head/imu",
            part="",
            rate_hz=rate_hz,
            mount=Mount(body="head"),
            gyroscope_noise_density=2.4e-4,
            gyroscope_random_walk=5e-6,
            accelerometer_noise_density=1.5e-3,
            accelerometer_random_walk=4e-5,
            gyroscope_range=10.0,
            accelerometer_range=50.0,
        ),
        DvioParameters(),
    )


def imu(t_ms, rate=(0.1, 0.2, 0.3), force=(0.0, 0.0, 9.8)):
    return Imu(topic="/head/imu", t_ns=round(t_ms * 1e6), angular_rate=np.array(rate), specific_force=np.array(force))


def test_samples_are_taken_in_order_and_marked_where_saturated_or_missing():
    x = inertial()
    assert x.add(imu(0))
    for bad in (imu(0), imu(-5), imu(10, (101.0, 0, 0)), imu(10, force=(0, 1001.0, 0)), imu(10, (math.nan, 0, 0))):
        assert not x.add(bad)
    assert x.add(imu(16.9, (0.3, 0.2, 0.3)))
    assert x.add(imu(34.0, (0.5, 0.2, 0.3)))  # more than 1.7 periods after the last one
    assert x.add(imu(44.0, (-9.96, 0.0, 0.0)))
    assert x.add(imu(54.0, (9.94, 0.0, 0.0)))
    assert x.add(imu(64.0, force=(0.0, -49.8, 0.0)))
    kept = x.imu_samples
    assert kept.invalid.tolist() == [0, 0, 1, 1, 0, 1]
    np.testing.assert_allclose(x.samples[:6, 0], [0.1, 0.3, 0.4, -9.96, 9.94, 0.1])
    assert (x.newest_ns, x.gap_s()) == (64_000_000, pytest.approx(0.01))
    assert inertial().gap_s() == 0.0
    assert [x.covers(t) for t in (-1, 0, 5)] == [False, True, True]
    assert not inertial().covers(10**9)
    np.testing.assert_allclose(x.since(16_900_000, 44_000_000)[:, 0], [0.4, -9.96])


def test_the_rate_between_samples_is_linear_between_the_middles_of_their_periods():
    x = inertial()
    for k in range(20):
        x.add(imu(10 * k, (k - 0.5, 2.0 * (k - 0.5), 0.0)))  # mean of the rate t / 10 ms over the period before
    for t_ms in (30.0, 33.0, 35.0, 38.0, 101.0, 109.0):
        np.testing.assert_allclose(x.rate_at(round(t_ms * 1e6)), [t_ms / 10, t_ms / 5, 0.0], atol=1e-9)
    np.testing.assert_allclose(x.rate_at(190_000_000), [18.5, 37.0, 0.0])  # nothing is known beyond the last middle


@pytest.mark.parametrize(
    ("rate_sd", "force_sd", "missing", "stationary"),
    [(0.9, 0.9, 0, True), (1.1, 0.9, 0, False), (0.9, 1.1, 0, False), (0.9, 0.9, 7, True), (0.9, 0.9, 8, False)],
)
@pytest.mark.parametrize("axis", range(3))
def test_a_sensor_is_stationary_by_the_scatter_of_a_quarter_second(rate_sd, force_sd, missing, stationary, axis):
    x, p = inertial(), DvioParameters()
    for k in range(100):
        if k in range(80, 80 + missing):
            continue
        sign = 1.0 if k % 2 else -1.0
        wild = 50.0 if k < 60 else 1.0  # before the quarter second it moves
        along = sign * wild * np.eye(3)[axis]
        x.add(
            imu(
                10 * k,
                np.array([0.1, 0.2, 0.0]) + along * rate_sd * p.stationary_rate_sd_radps,
                np.array([0.0, 0.3, 9.8]) + along * force_sd * p.stationary_force_sd_mps2,
            )
        )
    assert x.is_stationary(990_000_000) == stationary
    assert not x.is_stationary(650_000_000)
    assert not x.is_stationary(200_000_000)


def test_the_inverse_of_a_symmetric_matrix_is_numpys():
    B = np.random.default_rng(0).normal(size=(3, 3))
    A, out = B @ B.T, np.empty((3, 3))
    upper = A[np.triu_indices(3)]
    assert from_python(plane_cells.invert_symmetric)(upper, out)
    np.testing.assert_allclose(out, np.linalg.inv(A), rtol=1e-9)
    v = np.array([1.0, 2.0, 3.0])
    assert not from_python(plane_cells.invert_symmetric)(np.outer(v, v)[np.triu_indices(3)], out)


FOCAL = 190.0


def two_planes(sd=0.002, seed=0, wall_per_m=0.30):
    """Depth image of a floor and a wall, its samples' rays, and the planes: inverse depth (x, y, 1) times them."""
    height, width = 240, 320
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - 159.5) / FOCAL, (v - 119.5) / FOCAL
    wall, floor = np.array([0.05, 0.0, wall_per_m]), np.array([0.0, 0.6, 0.32])
    inverse = np.maximum(
        np.einsum("i,ihw", wall, [x, y, np.ones_like(x)]), np.einsum("i,ihw", floor, [x, y, np.ones_like(x)])
    )
    inverse += np.random.default_rng(seed).normal(0, sd, inverse.shape)
    pixels = plane_cells.sample_pixels((height, width))
    rays = (pixels - [159.5, 119.5]) / FOCAL
    return (1.0 / inverse).astype(np.float32), rays, pixels, wall, floor


def test_samples_fill_whole_cells():
    pixels = plane_cells.sample_pixels((250, 330))
    assert pixels.shape == (60, 80, 2)
    np.testing.assert_array_equal(pixels[0, 0], [2, 2])
    np.testing.assert_array_equal(pixels[7, 9], [38, 30])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("wall_per_m", "first"), [(0.30, 1), (0.45, 0)])
def test_the_planes_of_an_image_are_those_of_its_samples(wall_per_m, first, seed):
    """The larger one first: the floor, where the wall is far."""
    sd = 0.002
    depth, rays, pixels, wall, floor = two_planes(sd, seed, wall_per_m)
    planes, weights = np.zeros((4, 3)), np.zeros((4, 3, 3))
    count = from_python(plane_cells.read_planes)(depth, rays, plane_cells.SIDE, 0.3, sd, planes, weights)
    assert count == 2
    largest = np.zeros((1, 3))
    assert (
        from_python(plane_cells.read_planes)(depth, rays, plane_cells.SIDE, 0.3, sd, largest, np.zeros((1, 3, 3))) == 1
    )
    np.testing.assert_array_equal(largest[0], planes[0])
    assert not planes[2:].any()
    for k, true in enumerate((wall, floor) if first == 0 else (floor, wall)):
        covariance = np.linalg.inv(weights[k])
        off = planes[k] - true
        assert off @ weights[k] @ off < 16.0
        np.testing.assert_allclose(planes[k], true, atol=0.004)
        extra = plane_cells.PLANE_ERROR**2 * (planes[k] @ planes[k])
        noise = covariance - extra * np.eye(3)
        assert (np.linalg.eigvalsh(noise) > 0.0).all()
        # as of least squares over the samples of this plane that lie in whole cells
        sampled = depth[pixels[..., 1].astype(int), pixels[..., 0].astype(int)]
        A = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], -1)
        on = np.abs(1.0 / sampled - A @ true) < 5 * sd
        cells = on.reshape(6, 10, 8, 10).mean(axis=(1, 3)) > 0.97
        rows = A[np.repeat(np.repeat(cells, 10, 0), 10, 1)]
        np.testing.assert_allclose(
            np.sqrt(np.diag(noise)), sd * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))), rtol=0.1
        )


def test_an_image_without_depth_or_that_is_rough_has_no_planes():
    depth, rays, *_ = two_planes()
    planes, weights = np.zeros((4, 3)), np.zeros((4, 3, 3))
    read = from_python(plane_cells.read_planes)
    rough = (1.0 / np.random.default_rng(0).uniform(0.3, 0.9, depth.shape)).astype(np.float32)
    for image in (np.zeros_like(depth), np.full_like(depth, np.nan), 0.1 * depth, 9.0 * depth, rough):
        assert read(image, rays, plane_cells.SIDE, 0.45, 0.002, planes, weights) == 0


GROUND_SD_RAD = DvioParameters().level_ground_sd_rad


def slope(r, J=None):
    return Slope(r=np.array(r, float), J=np.hstack([np.eye(2), np.zeros((2, 4))]) if J is None else J)


def test_level_ground_weighs_by_its_construction_and_a_ramp_nothing():
    tilt = np.diag([0.004**2, 0.006**2, 1.0, 1.0, 1.0, 1.0])
    total = np.diag([0.004**2 + 0.003**2, 0.006**2 + 0.003**2])
    for r in ((0.0, 0.0), (0.004, 0.0), (0.0, 0.012), (0.008, -0.012)):
        square = np.array(r) @ np.linalg.inv(total) @ r
        expected = min(1.0, 1.5 / max(math.sqrt(square), 1e-9)) / 0.003**2 if square <= 9.2 else 0.0
        assert level.level_weight(slope(r), tilt, GROUND_SD_RAD) == pytest.approx(expected, rel=1e-9)
    sure = np.diag([0.019**2, 0.019**2, 1.0, 1.0, 1.0, 1.0])
    assert level.level_weight(slope((0.0349, 0.0)), sure, GROUND_SD_RAD) > 0.0
    assert level.level_weight(slope((0.0, -0.0351)), sure, GROUND_SD_RAD) == 0.0
    assert level.level_weight(slope((0.0, 0.0)), np.diag([0.0201**2, 0.0201**2, 1, 1, 1, 1]), GROUND_SD_RAD) == 0.0
    assert level.level_weight(slope((0.0, 0.0)), np.diag([0.0279**2, 0.0, 1, 1, 1, 1]), GROUND_SD_RAD) > 0.0


def test_level_ground_is_due_once_a_metre_and_only_where_it_is_used():
    ground, place = LevelGround(GROUND_SD_RAD, used=True), np.array([1.0, 2.0, 3.0])
    assert ground.is_due(place)
    ground._p_last = place
    assert [ground.is_due(place + s * np.array([0.6, 0.0, 0.8])) for s in (0.0, 0.99, 1.01)] == [False, False, True]
    ground.restart()
    assert ground.is_due(place)
    assert not LevelGround(GROUND_SD_RAD, used=False).is_due(place)


def test_the_covariance_of_some_states_is_a_block_of_the_inverse():
    B = np.random.default_rng(0).normal(size=(8, 8))
    H = B @ B.T + np.eye(8)
    which = np.array([1, 4, 5])
    L = np.zeros((10, 10))
    L[:8, :8] = np.linalg.cholesky(H)
    np.testing.assert_allclose(level.covariance_of(which, L, 8), np.linalg.inv(H)[np.ix_(which, which)], rtol=1e-9)


def window_of_points(rng, count):
    """A window of three frames, and points that the first one hosts."""
    camera = CameraCalibration(
        topic="/head/color",
        part="",
        rate_hz=30.0,
        mount=Mount(body="head"),
        width=640,
        height=360,
        intrinsics=(465.0, 465.0, 319.5, 179.5),
        distortion=(0.0,) * 4,
    )
    T_imu_camera = np.eye(4)
    T_imu_camera[:3, :3], T_imu_camera[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3)
    window = blank_window(3, count, T_imu_camera, 0.0)
    marks = window.landmarks
    marks.host[:], marks.measured[:], marks.inverse_depth[:] = 0, 1, rng.uniform(0.2, 1.0, count)
    marks.at[:, 0] = rng.uniform([-0.5, -0.3], [0.5, 0.3], (count, 2))
    return SimpleNamespace(window=window, lens=Lens(camera), parameters=DvioParameters())


def test_points_agree_that_one_pose_explains_wherever_it_is():
    rng, count, wrong = np.random.default_rng(3), 60, 18
    part = window_of_points(rng, count)
    marks, lens = part.window.landmarks, part.lens
    points = np.column_stack([marks.at[:, 0], np.ones(count)]) / marks.inverse_depth[:, None]  # in the first camera
    moved = Rotation.from_rotvec([0.05, -0.1, 0.08]).apply(points) + [0.3, -0.1, 0.2]
    there = lens.pixels(moved[:, :2] / moved[:, 2:]).astype(np.float32)
    there[:wrong] += rng.uniform(20.0, 60.0, (wrong, 2)).astype(np.float32)
    good = np.ones(count, bool)
    good[-3:] = False
    agree = SlidingWindow._pnp_inliers(part, np.arange(count), there, good)
    np.testing.assert_array_equal(agree, (np.arange(count) >= wrong) & good)


@pytest.mark.parametrize(
    ("moved_px", "common", "after_s", "key"),
    [(0.0, 50, 0.1, False), (40.0, 50, 0.1, True), (0.0, 10, 0.1, True), (0.0, 50, 30.0, True)],
)
def test_a_frame_is_a_keyframe_if_it_moved_or_shares_few_points_or_is_late(moved_px, common, after_s, key):
    part = window_of_points(np.random.default_rng(4), 60)
    marks, frames = part.window.landmarks, part.window.frames
    frames.t_ns[:] = 0, round(after_s * 1e9), round(after_s * 1e9)
    marks.seen[:, 0], marks.seen[:common, 1] = 1, 1
    marks.at[:, 1] = marks.at[:, 0] + np.array([moved_px / part.lens.focal_px, 0.0])
    assert SlidingWindow._is_key(part, 1) == key
