"""The odometry before a painted wall: accuracy, what it finds out about its sensors, and faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import METHODS, Dvio, DvioMethod, DvioParameters
from stridetwin.estimators.dvio.loss import compute_strayed_variance
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image, Imu
from tests.estimators.dvio.wall import Wall, rig, still, swaying
from tests.pinned import SAME_IMAGES, assert_pinned, columns


def followed(wall, samples=None, **parameters):
    """The odometry, and its estimates."""
    odometry = Dvio(rig(), parameters=DvioParameters(**parameters))
    made = [odometry.update(s) for s in (wall.samples() if samples is None else samples)]
    return odometry, [e for e in made if e is not None]


def errors(wall, made):
    """(N,) m, after laying the first estimate over the truth by its place and heading."""
    R, p = wall.pose(made[0].t_ns * 1e-9)
    heading = R @ made[0].pose.T_world_frame[:3, :3].T
    turn = Rotation.from_euler("z", np.arctan2(heading[1, 0], heading[0, 0])).as_matrix()
    measured = np.array([turn @ (e.pose.T_world_frame[:3, 3] - made[0].pose.T_world_frame[:3, 3]) + p for e in made])
    return np.linalg.norm(measured - np.array([wall.pose(e.t_ns * 1e-9)[1] for e in made]), axis=1)


@pytest.fixture(scope="module")
def sway():
    wall = Wall(swaying, 8.0, seed=2)
    return wall, list(wall.samples())


@pytest.fixture(scope="module")
def plain(sway):
    """Estimates where nothing is wrong."""
    return followed(*sway)[1]


def pinned(made):
    """Numbers of an estimate per second."""
    rows = [
        {
            "p": e.pose.p_frame_in_world,
            "q": e.pose.q_world_frame,
            "log_sd": 0.5 * np.log(np.diag(e.covariance)),
            "v": e.v_imu_in_world,
            "gyro_bias": e.gyro_bias,
            "accel_bias": e.accel_bias,
            "mount": e.camera_pose.T_world_frame,
        }
        for e in made[::200]
    ]
    return columns(rows)


def test_pinned_numbers(plain, num_regression):
    assert_pinned(num_regression, pinned(plain), SAME_IMAGES)


def estimates_of(made, samples):
    """Those of the estimates that were measured by the last of some samples."""
    return [e for e in made if e.t_ns <= max(s.t_ns for s in samples if isinstance(s, Imu))]


def test_follows_a_swaying_head(sway, plain):
    wall, made = sway[0], plain
    off = errors(wall, made)
    assert off.max() < 0.03
    R, _ = wall.pose(made[-1].t_ns * 1e-9)
    tilt = np.arccos(np.clip((R.T[:, 2] @ made[-1].pose.T_world_frame[:3, :3].T[:, 2]), -1, 1))
    assert tilt < np.radians(0.5)
    assert {e.health for e in made} == {"tracking"}


def test_estimates_poses_at_the_rate_of_the_imu_with_covariances(plain):
    steps = np.diff([e.t_ns for e in plain])
    assert np.all(steps == 5_000_000)
    assert plain[0].t_ns < 400_000_000
    for e in plain[::50]:
        assert np.linalg.eigvalsh(e.covariance).min() > -1e-12
        assert e.pose.T_world_frame[:3, :3] @ e.pose.T_world_frame[:3, :3].T == pytest.approx(np.eye(3), abs=1e-6)


def test_stationary_sensor():
    wall = Wall(still, 15.0, seed=4)
    _, made = followed(wall)
    assert errors(wall, made).max() < 0.002
    assert np.linalg.norm(made[-1].v_imu_in_world) < 0.01


def test_finds_a_large_gyro_bias_at_a_start_at_rest():
    bias = np.array([0.08, -0.08, 0.08, 0.0, 0.0, 0.0])
    wall = Wall(still, 2.2, seed=5, bias=bias)
    _, made = followed(wall)
    assert np.abs(made[-1].gyro_bias - bias[:3]).max() < 2e-3
    assert np.abs(made[0].gyro_bias - bias[:3]).max() < 1e-2


def test_finds_a_late_camera():
    wall = Wall(swaying, 10.0, seed=6, late_s=0.010)
    odometry, made = followed(wall)
    assert odometry.time_offset_s == pytest.approx(0.010, abs=1e-3)
    assert errors(wall, made).max() < 0.05


def test_finds_a_mount_that_is_off():
    """By 4.8 degrees and 30 mm; a prior of the calibration's own 0.3 degrees leaves 0.5 degrees of it."""
    wall, nominal = Wall(swaying, 10.0, seed=7), rig()
    camera = nominal.cameras["/head/color"]
    true, T = camera.mount.T_body_sensor, camera.mount.T_body_sensor.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([0.05, 0.03, -0.06]).as_matrix()
    T[:3, 3] += [0.02, -0.02, 0.01]
    off = replace(camera, mount=replace(camera.mount, T_body_sensor=T))
    odometry = Dvio(replace(nominal, cameras={"/head/color": off}))
    made = [e for s in wall.samples() if (e := odometry.update(s)) is not None]
    T_imu_camera = made[-1].camera_pose.T_world_frame
    left = Rotation.from_matrix(true[:3, :3].T @ T_imu_camera[:3, :3]).magnitude()
    assert np.degrees(left) < 0.15
    assert np.abs(T_imu_camera[:3, 3] - true[:3, 3]).max() < 0.016
    assert errors(wall, made)[-1] < 0.03


@pytest.mark.parametrize("method", ["dvio", "vins_rgbd"])
def test_published_methods_follow_too(sway, method, num_regression):
    wall, samples = sway
    odometry = Dvio(rig(), parameters=METHODS[method])
    made = [e for s in samples if (e := odometry.update(s)) is not None]
    assert errors(wall, made).max() < 0.10
    assert_pinned(num_regression, pinned(made), SAME_IMAGES)


def moving(seconds, seed=7, begin_s=3.0):
    """A wall before a head that sways from the first sample on."""
    return Wall(lambda t: swaying(t + begin_s), seconds, seed=seed)


def tilt_and_speed_errors(wall, e):
    """rad and m/s, which no heading changes."""
    t, h = e.t_ns * 1e-9, 1e-4
    R, _ = wall.pose(t)
    measured = e.pose.T_world_frame[:3, :3]
    v = (wall.pose(t + h)[1] - wall.pose(t - h)[1]) / (2 * h)
    tilt = np.arccos(np.clip(R[2] @ measured[2], -1, 1))
    return tilt, np.linalg.norm(R.T @ v - measured.T @ e.v_imu_in_world)


@pytest.mark.parametrize("method", ["proposed", "dvio", "vins_mono"])
@pytest.mark.parametrize("begin_s", [3.0, 4.1])
def test_starts_in_motion(method, begin_s):
    wall = moving(4.0, begin_s=begin_s)
    odometry = Dvio(rig(), parameters=METHODS[method])
    made = [e for s in wall.samples() if (e := odometry.update(s)) is not None]
    assert made[0].t_ns < 1_200_000_000
    tilt, speed = tilt_and_speed_errors(wall, made[0])
    assert tilt < np.radians(1.5)
    assert speed < (0.10 if method == "vins_mono" else 0.05)
    tilt, speed = tilt_and_speed_errors(wall, made[-1])
    assert tilt < np.radians(1.5)
    assert speed < (0.20 if method == "vins_mono" else 0.05)
    assert errors(wall, made).max() < (0.30 if method == "vins_mono" else 0.05)


def test_a_start_in_motion_is_deterministic():
    samples = list(moving(0.8).samples())
    a, b = (followed(None, samples)[1][0] for _ in range(2))
    assert a.t_ns == b.t_ns
    assert np.array_equal(a.pose.T_world_frame, b.pose.T_world_frame)
    assert np.array_equal(a.covariance, b.covariance)


def test_starts_in_motion_as_well_as_it_can_where_the_images_do_not_fit():
    wall, elsewhere = moving(4.0), Wall(lambda t: swaying(9.0 + 1.7 * t), 4.0, seed=8)
    images = {(type(s), s.t_ns): s for s in elsewhere.samples() if not isinstance(s, Imu)}
    _, made = followed(wall, [images.get((type(s), s.t_ns), s) for s in wall.samples()])
    assert 2_900_000_000 < made[0].t_ns < 3_400_000_000
    assert made[0].covariance[3:5, 3:5].max() > 0.1**2
    assert all(np.isfinite(e.pose.T_world_frame).all() and np.isfinite(e.covariance).all() for e in made)


def corrupted(samples, change):
    return [c for s in samples for c in ([change(s)] if change(s) is not None else [])]


def fault(kind, start_s, end_s, **change):
    """Changes the samples of a kind within a time; without a change they are missing."""

    def of(s):
        if not (isinstance(s, kind) and start_s * 1e9 < s.t_ns < end_s * 1e9):
            return s
        return replace(s, **{name: f(getattr(s, name)) for name, f in change.items()}) if change else None

    return of


def missing(a):
    return np.full_like(a, np.nan)


FAULTS = {
    "nan": fault(Imu, 3.0, 3.03, angular_rate=missing, specific_force=missing),
    "missing_imu": fault(Imu, 3.0, 3.05),
    "saturated": fault(Imu, 4.0, 4.03, specific_force=lambda a: np.clip(8 * a, -39, 39)),
    "no_depth": fault(Depth, 2.0, 99.0),
    "nan_depth": fault(Depth, 5.0, 99.0, depth=missing),
    "frames_dropped": lambda s: None if isinstance(s, Image) and (s.t_ns // 33_333_333) % 5 == 2 else s,
    "covered": fault(Image, 4.0, 5.0, pixels=np.zeros_like),
}


@pytest.mark.parametrize("name", FAULTS)
def test_bears_faults(sway, name):
    wall, samples = sway
    _, made = followed(wall, corrupted(samples, FAULTS[name]))
    assert all(np.isfinite(e.pose.T_world_frame).all() and np.isfinite(e.covariance).all() for e in made)
    assert errors(wall, made).max() < 0.12


def test_ignores_what_is_late_or_repeated(sway, plain):
    wall, samples = sway
    some = samples[:1500]
    again = [c for i, s in enumerate(some) for c in ([s, s, some[max(i - 40, 0)]] if i % 7 == 0 else [s])]
    _, made = followed(wall, again)
    assert np.array_equal(estimates_of(plain, some)[-1].pose.T_world_frame, made[-1].pose.T_world_frame)


def test_says_that_it_is_lost_and_starts_anew_in_the_same_frame(sway):
    wall, samples = sway
    gap = [s for s in samples if not (isinstance(s, Imu) and 3.0e9 < s.t_ns < 4.5e9)]
    _, made = followed(wall, gap)
    healths = [e.health for e in made]
    assert "lost" in healths
    assert healths[-1] == "tracking"
    before = next(e for e in reversed(made) if e.t_ns <= 3_000_000_000)
    first = next(e for e in made if e.t_ns > 4_600_000_000 and e.health == "tracking")
    assert np.linalg.norm(first.pose.T_world_frame[:3, 3] - before.pose.T_world_frame[:3, 3]) < 1.0
    assert first.covariance[0, 0] > 100 * before.covariance[0, 0]
    assert first.t_ns < 5_700_000_000
    tilt, speed = tilt_and_speed_errors(wall, first)
    assert tilt < np.radians(1.5)
    assert speed < 0.05
    assert all(np.isfinite(e.pose.T_world_frame).all() for e in made)


def test_camera_covered_is_said(sway):
    wall, samples = sway
    _, made = followed(wall, corrupted(samples, FAULTS["covered"]))
    dark = [e.health for e in made if 4.2e9 < e.t_ns < 5e9]
    assert set(dark) == {"depth_only"}
    assert made[-1].health == "tracking"
    without_depth = [s for s in corrupted(samples, FAULTS["covered"]) if not isinstance(s, Depth)]
    _, made = followed(wall, without_depth)
    assert {e.health for e in made if 4.2e9 < e.t_ns < 5e9} == {"imu_only"}


def unseen(samples, start_s, end_s=np.inf):
    """The samples without the images of a time."""
    return [s for s in samples if isinstance(s, Imu) or not start_s * 1e9 < s.t_ns < end_s * 1e9]


def delayed(samples, seconds, first_s=0.0):
    """The samples as they come where images from a time on take so long."""
    return sorted(
        samples, key=lambda s: s.t_ns + (0 if isinstance(s, Imu) or s.t_ns < first_s * 1e9 else seconds * 1e9)
    )


@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.6])
def test_begins_anew_after_blind_times_though_images_come_late(sway, late_s):
    wall, samples = sway
    _, made = followed(wall, delayed(unseen(samples, 3.0, 6.3), late_s, 6.0))
    again = [e for e in made if e.t_ns * 1e-9 > 6.3 + 0.05 + late_s]
    assert {e.health for e in made if 3.4e9 < e.t_ns < 6.3e9} == {"imu_only"}
    assert {e.health for e in again} == {"tracking" if late_s < 0.3 else "imu_only"}
    blind = next(e for e in reversed(made) if e.t_ns < 6.3e9)
    assert again[-1].covariance[0, 0] < 0.5 * blind.covariance[0, 0]
    if late_s < 0.3:
        assert errors(wall, made)[-1] < 0.05


def test_images_that_come_late_after_longer_than_samples_stay_are_used():
    wall = blindfolded(swaying, 2.0, 20.0, 21.0)
    odometry, made = followed(wall, delayed(wall.samples(), 0.02, 20.0))
    assert made[-1].health == "tracking"
    assert odometry._core.newest_ns > 20.9e9
    assert all(np.isfinite(e.covariance).all() for e in made)


def blindfolded(motion, start_s, end_s, seconds):
    """A wall that nobody sees for a while; no image of it is made meanwhile."""
    wall = Wall(motion, seconds, seed=2)
    images = wall.images
    wall.images = lambda t_ns: () if start_s * 1e9 < t_ns < end_s * 1e9 else images(t_ns)
    return wall


def test_health_is_imu_only_where_images_stop(sway):
    wall, samples = sway
    some = [s for s in samples if s.t_ns < 4e9]
    _, made = followed(wall, unseen(some, 2.5))
    assert {e.health for e in made if e.t_ns < 2.75e9} == {"tracking"}
    assert {e.health for e in made if e.t_ns > 2.85e9} == {"imu_only"}


def test_what_was_unknown_before_a_loss_is_unknown_after_it():
    wall = blindfolded(swaying, 2.0, np.inf, 14.0)
    gap = [s for s in wall.samples() if not (isinstance(s, Imu) and 12.0e9 < s.t_ns < 12.6e9)]
    gap = [s for s in gap if not (isinstance(s, Imu) and 13.0e9 < s.t_ns < 13.6e9)]
    _, made = followed(wall, gap)
    before, after = (next(e for e in made if e.t_ns > t_ns) for t_ns in (11.99e9, 12.5e9))
    assert before.health == "imu_only"
    assert after.health == "lost"
    added = after.covariance - before.covariance
    assert np.linalg.eigvalsh(added[:3, :3]).min() > 0.5**2 + 0.6
    assert np.linalg.eigvalsh(added[3:, 3:]).min() == pytest.approx(0.3**2 + (0.01 * 0.6) ** 2, rel=1e-4)
    # a second gap while all is lost makes nothing known either
    lost = [(e.t_ns * 1e-9, e.covariance[0, 0]) for e in made if 12.7e9 < e.t_ns < 12.99e9]
    variance = np.diff(lost, axis=0)[:, 1]
    assert variance.min() > 0
    assert lost[-1][1] - lost[0][1] > compute_strayed_variance(lost[-1][0] - lost[0][0])


def test_does_without_samples_of_the_imu_that_have_gone(sway):
    wall, samples = sway
    # an IMU of ten times the measured rate, whose samples stay for 0.6 s
    fast = [
        c
        for s in unseen(samples, 3.0, 5.0)
        for c in ([replace(s, t_ns=s.t_ns - k * 500_000) for k in reversed(range(10))] if isinstance(s, Imu) else [s])
    ]
    fast.sort(key=lambda s: s.t_ns)
    _, made = followed(wall, fast)
    assert errors(wall, made).max() < 0.12
    assert made[-1].health == "tracking"


def test_memory_is_constant_and_landmarks_are_seen_from_their_host_on(sway):
    _, samples = sway
    odometry = Dvio(rig())
    sizes = []
    for s in samples:
        odometry.update(s)
        w = odometry._core.window
        sizes.append((int(w.frames.count[0]), len(odometry._images), odometry._core.inertial.count))
        hosted = w.landmarks.host >= 0  # a landmark is seen by its host, and by no frame before it
        first = w.landmarks.seen[hosted].argmax(axis=1)
        assert np.array_equal(first, w.landmarks.host[hosted])
    assert max(n for n, _, _ in sizes) <= DvioParameters().keyframes + 1
    assert max(n for _, n, _ in sizes) <= 4


def test_refuses_what_it_cannot_use():
    with pytest.raises(ConfigError, match="head or chest"):
        Dvio(rig(), options=Options(mount="wrist"))
    with pytest.raises(StrideTwinError, match="no camera"):
        Dvio(Rig())
    with pytest.raises(ConfigError, match="host_depth"):
        DvioMethod(host_depth="some")
    with pytest.raises(ConfigError, match="calibration: invalid 'some': expected nominal, mount_and_clock, all"):
        DvioMethod(calibration="some")
    with pytest.raises(ConfigError, match="steps"):
        DvioMethod(steps=0)
    with pytest.raises(ConfigError, match="pixel_noise_px"):
        DvioParameters(pixel_noise_px=0.0)
    with pytest.raises(ConfigError, match="min_depth_m"):
        DvioParameters(min_depth_m=7.0)
    with pytest.raises(StrideTwinError, match="/foot_l/imu"):
        Dvio(rig()).update(Imu(topic="/foot_l/imu", t_ns=0, angular_rate=np.zeros(3), specific_force=np.zeros(3)))
