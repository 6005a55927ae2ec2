"""What a terrain map does with what comes in, sound or not, and what it holds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import EYE_M, PERIOD_NS, RIG, Box, approach, attitude, depth, flight, image, pose
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import CAMERA_POSES, Options
from stridetwin.estimators.terrain_map import TerrainMap, TerrainMapParameters
from stridetwin.estimators.terrain_map.voxel_blocks import CAPACITY
from stridetwin.outputs.pose_feed import pose_sample
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Imu

STAIRS = flight(0.16, 0.30, 5)
EYE = np.array([-1.2, 0.0, EYE_M])
IMU = ImuCalibration(
    topic="/head/imu",
    part="",
    rate_hz=200.0,
    mount=Mount(body="head"),
    gyroscope_noise_density=2e-4,
    gyroscope_random_walk=1e-6,
    accelerometer_noise_density=1e-3,
    accelerometer_random_walk=1e-5,
)
WITH_IMU = replace(RIG, imus={"/head/imu": IMU})


@pytest.fixture(scope="module")
def seen():
    return image(STAIRS, EYE, attitude(0.0), np.random.default_rng(0))


def known(terrain_map, pixels, t_ns=0, eye=EYE):
    terrain_map.update(pose(t_ns, eye, attitude(0.0)))
    return terrain_map.update(depth(t_ns, pixels))


def everything(estimate):
    """Every number of an estimate."""
    found = []
    for p in estimate.planes.values():
        found += [*p.centre, *p.normal, *p.covariance.ravel(), p.area_m2, p.votes]
    for s in estimate.stairs:
        found += [s.riser, s.heading, s.start, s.base, *s.risers]
    return np.array(found)


def test_one_image_is_enough(seen):
    estimate = known(TerrainMap(RIG), seen)
    ours = max(estimate.stairs, key=lambda s: s.steps)
    assert ours.steps >= 2
    assert ours.riser == pytest.approx(0.16, abs=0.01)


def test_planes_are_extracted_once_per_period():
    terrain_map, estimate = approach([Box(x=(-5, 40), y=(-5, 5))], start=2.0, end=2.0, frames=1)
    assert estimate.t_ns == 0
    period_ns = round(terrain_map.parameters.period_s * 1e9)
    assert [terrain_map.due(t_ns) for t_ns in (period_ns - 1, period_ns)] == [False, True]


def test_an_estimated_pose_of_the_camera_replaces_its_mount(seen):
    """A nominal mount 5 degrees off makes the floor slope; the estimated one, the identity, mends it."""
    tilted = np.eye(4)
    tilted[:3, :3] = Rotation.from_rotvec([math.radians(5.0), 0.0, 0.0]).as_matrix()
    camera = RIG.cameras["/head/color"]
    off = replace(WITH_IMU, cameras={"/head/color": replace(camera, mount=Mount(body="head", T_body_sensor=tilted))})
    mount = pose_sample(0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), CAMERA_POSES)
    corrupt = replace(mount, p_frame_in_world=np.full(3, np.nan))

    def estimated(rig, *samples):
        terrain_map = TerrainMap(rig, options=Options(poses_of="head/imu"))
        for sample in samples:
            assert terrain_map.update(sample) is None
        return known(terrain_map, seen)

    np.testing.assert_array_equal(everything(estimated(off, mount, corrupt)), everything(estimated(WITH_IMU)))
    floor = max(estimated(off).planes.values(), key=lambda p: p.area_m2)
    assert math.degrees(floor.slope) > 3.0


@pytest.mark.parametrize("corrupted", [0.0, np.nan, np.inf, -1.0, 30.0])
def test_an_image_without_depth_says_nothing(seen, corrupted):
    terrain_map = TerrainMap(RIG)
    before = known(terrain_map, seen)
    assert known(terrain_map, np.full_like(seen, corrupted), PERIOD_NS) is None
    assert terrain_map.estimate is before


def test_pixels_that_are_no_depth_are_none(seen):
    corrupted = seen.copy()
    corrupted[::7, ::5] = np.nan
    corrupted[1::7, ::5] = -np.inf
    estimate = known(TerrainMap(RIG), corrupted)
    assert np.isfinite(everything(estimate)).all()
    assert max(s.steps for s in estimate.stairs) >= 2


def test_a_pose_that_is_not_finite_is_none(seen):
    terrain_map = TerrainMap(RIG)
    bad = pose(0, EYE, attitude(0.0))
    for field in ("p_frame_in_world", "q_world_frame"):
        terrain_map.update(replace(bad, **{field: np.full_like(getattr(bad, field), np.nan)}))
        assert terrain_map.update(depth(0, seen)) is None
    assert known(terrain_map, seen, PERIOD_NS) is not None


def test_an_image_without_a_pose_of_its_time_says_nothing(seen):
    terrain_map = TerrainMap(RIG)
    assert terrain_map.update(depth(0, seen)) is None
    terrain_map.update(pose(0, EYE, attitude(0.0)))
    assert terrain_map.update(depth(PERIOD_NS, seen)) is None
    assert terrain_map.update(depth(20_000_000, seen)) is not None


def test_an_image_that_is_late_or_comes_twice_says_nothing(seen):
    terrain_map = TerrainMap(RIG)
    assert known(terrain_map, seen, PERIOD_NS) is not None
    assert known(terrain_map, seen, PERIOD_NS) is None
    assert known(terrain_map, seen, PERIOD_NS - 1) is None


def test_other_samples_are_passed_over(seen):
    terrain_map = TerrainMap(RIG)
    terrain_map.update(pose(0, EYE, attitude(0.0)))
    assert (
        terrain_map.update(Imu(topic="/head/imu", t_ns=0, angular_rate=np.zeros(3), specific_force=np.ones(3))) is None
    )
    assert terrain_map.update(replace(depth(0, seen), topic="/chest/depth")) is None


def test_after_a_jump_of_the_pose_the_map_begins_anew(seen):
    terrain_map = TerrainMap(RIG)
    known(terrain_map, seen)
    away = EYE + [3.0, 0.0, 0.4]
    terrain_map.update(pose(PERIOD_NS, away, attitude(0.0)))
    assert terrain_map.estimate is None
    assert len(terrain_map.surface_points()[0]) == 0
    estimate = terrain_map.update(depth(PERIOD_NS, seen))  # the same stairs, now elsewhere in the odometry's world
    ours = max(estimate.stairs, key=lambda s: s.steps)
    assert ours.start == pytest.approx(3.0, abs=0.03)
    assert ours.base == pytest.approx(0.4, abs=0.01)


def test_an_image_of_another_size_is_refused(seen):
    terrain_map = TerrainMap(RIG)
    terrain_map.update(pose(0, EYE, attitude(0.0)))
    with pytest.raises(StrideTwinError, match=r"invalid image size \(100, 100\): expected \(240, 320\)"):
        terrain_map.update(depth(0, seen[:100, :100]))


def test_a_rig_without_depth_is_refused():
    with pytest.raises(StrideTwinError, match="no depth camera; it has none"):
        TerrainMap(Rig())
    with pytest.raises(StrideTwinError, match="no depth /x; it has /head/depth"):
        TerrainMap(RIG, topic="/x")


@pytest.mark.parametrize(("field", "value"), [("voxel_size_m", 0.0), ("min_riser_m", 0.5), ("max_weight", math.nan)])
def test_parameters_are_checked(field, value):
    with pytest.raises(ConfigError, match=field):
        TerrainMapParameters(**{field: value})


def test_the_mount_gives_the_place_of_the_camera(seen):
    """Poses of an IMU 10 cm behind the camera, with other axes."""
    T = np.eye(4)
    T[:3, :3] = attitude(0.0).as_matrix()
    T[:3, 3] = [0.1, 0.0, 0.05]
    camera = replace(RIG.cameras["/head/color"], mount=Mount(body="head", T_body_sensor=T))
    rig = replace(WITH_IMU, cameras={"/head/color": camera})
    terrain_map = TerrainMap(rig, options=Options(poses_of="head/imu"))
    body = pose(0, EYE - T[:3, 3], attitude(0.0))
    terrain_map.update(replace(body, q_world_frame=np.array([1.0, 0.0, 0.0, 0.0])))
    ours = max(terrain_map.update(depth(0, seen)).stairs, key=lambda s: s.steps)
    assert ours.start == pytest.approx(0.0, abs=0.02)


def test_velocity_propagates_a_pose_to_the_image(seen):
    terrain_map = TerrainMap(RIG)
    moving = replace(pose(0, EYE - [0.04, 0.0, 0.0], attitude(0.0)), v_frame_in_world=np.array([1.0, 0.0, 0.0]))
    terrain_map.update(moving)
    ours = max(terrain_map.update(depth(40_000_000, seen)).stairs, key=lambda s: s.steps)
    assert ours.start == pytest.approx(0.0, abs=0.02)


def test_a_long_way_keeps_to_its_memory():
    """40 m over steps here and there: no more voxels, planes or columns than the window holds."""
    steps = [Box(x=(x, x + 1.0), z=(-1.0, 0.15)) for x in np.arange(0.0, 40.0, 4.0)]
    ground = Box(x=(-5, 60), y=(-5, 5))
    terrain_map = TerrainMap(RIG)
    held = []
    for i, x in enumerate(np.arange(-2.0, 38.0, 0.5)):
        eye, R = np.array([x, 0.0, EYE_M]), attitude(0.0)
        terrain_map.update(pose(i * 400_000_000, eye, R))
        estimate = terrain_map.update(depth(i * 400_000_000, image([ground, *steps], eye, R, None)))
        held.append(terrain_map._volume.blocks_used)
        assert len(estimate.planes) < 40
    assert max(held) < CAPACITY
    assert max(held[-20:]) < 1.3 * max(held[10:30])
    points, _ = terrain_map.surface_points()
    assert points[:, 0].min() > 37.5 - 9.0


def test_the_profile_of_nothing_is_nothing():
    profile = TerrainMap(RIG).profile(np.zeros(2), 0.0)
    assert np.isnan(profile.height).all()
    assert profile.changes == ()
    assert TerrainMap(RIG).ground(np.zeros(2)) is None


def test_the_profile_up_a_flight():
    terrain_map, _ = approach(STAIRS, start=2.2, end=1.2)
    profile = terrain_map.profile(np.array([-1.2, 0.0]), 0.0)
    edges = [c for c in profile.changes if c.kind == "edge"]
    assert len(edges) >= 4
    np.testing.assert_allclose([c.s for c in edges[:4]], 1.2 + 0.3 * np.arange(4), atol=0.015)
    np.testing.assert_allclose([c.drop for c in edges[:4]], 0.16, atol=0.012)
    at = np.argmin(np.abs(profile.s - 1.35))
    assert profile.height[at] == pytest.approx(0.16, abs=0.008)


@pytest.mark.parametrize("ground", [0.0, -0.16, 0.07])
def test_ground_that_is_not_looked_at_stays(ground):
    """Also where it lies on the border between two blocks, and the air over it in another block than itself."""
    terrain_map, eye = TerrainMap(RIG), np.array([0.0, 0.0, ground + EYE_M])
    for k in range(20):
        t_ns, R = k * PERIOD_NS, attitude(0.0, 0.6 if k < 3 else -0.2)
        terrain_map.update(pose(t_ns, eye, R))
        wall = Box(x=(3.0, 3.2), z=(ground, ground + 3.0))
        floor = Box(x=(-5.0, 20.0), z=(ground - 2.0, ground))
        terrain_map.update(depth(t_ns, image([floor, wall], eye, R, None)))
    assert terrain_map.heights(np.array([[1.5, 0.0]]))[0] == pytest.approx(ground, abs=0.01)
