"""The poses of a terrain map: which are taken, which are jumps, and where the camera is between them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from stridetwin.estimators.terrain_map.depth_camera import _MIN_JUMP_M, Poses
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.streams.samples import Odometry

P = TerrainMapParameters()
FIRST = Odometry(
    topic="/poses",
    t_ns=10**9,
    p_frame_in_world=np.array([1.0, 2.0, 3.0]),
    v_frame_in_world=np.array([0.5, -0.3, 0.1]),
    q_world_frame=np.array([math.cos(0.4), 0.0, 0.0, math.sin(0.4)]),
    angular_rate=np.array([0.2, 1.5, -0.4]),
)


def after(seconds, moved=(0.0, 0.0, 0.0), **changed):
    return replace(
        FIRST,
        t_ns=FIRST.t_ns + round(seconds * 1e9),
        p_frame_in_world=FIRST.p_frame_in_world + np.array(moved),
        **changed,
    )


@pytest.mark.parametrize(("since", "known"), [(0.99, True), (1.01, False), (-0.99, True), (-1.01, False), (0.0, True)])
def test_a_pose_is_propagated_by_its_velocities_until_it_is_too_old(since, known):
    """The rate is that of the frame: T(t) = T exp(t [rate, v in the frame])."""
    poses, seconds = Poses(P), since * P.max_pose_age_s
    assert poses.at(FIRST.t_ns) is None
    poses.add(FIRST)
    T = poses.at(FIRST.t_ns + round(seconds * 1e9))
    assert (T is not None) == known
    if known:
        c, s = math.cos(0.8), math.sin(0.8)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(T[:3, :3], R @ expm(np.cross(seconds * FIRST.angular_rate, np.eye(3)).T), atol=1e-9)
        np.testing.assert_allclose(T[:3, 3], FIRST.p_frame_in_world + seconds * FIRST.v_frame_in_world, atol=1e-9)
        np.testing.assert_array_equal(T[3], [0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("name", ["v_frame_in_world", "angular_rate"])
def test_a_pose_whose_velocities_are_unknown_stays(name):
    poses = Poses(P)
    poses.add(replace(FIRST, **{name: np.full(3, np.nan)}))
    np.testing.assert_allclose(poses.at(FIRST.t_ns + 1_000_000)[:3, 3], FIRST.p_frame_in_world)


def test_a_repeated_or_late_or_infinite_pose_is_ignored():
    poses = Poses(P)
    assert not poses.add(FIRST)
    for other in (after(0.0, (9.0, 0.0, 0.0)), after(-0.01, (9.0, 0.0, 0.0)), after(0.01, (math.nan, 0.0, 0.0))):
        assert not poses.add(other)
        np.testing.assert_array_equal(poses.at(FIRST.t_ns)[:3, 3], FIRST.p_frame_in_world)


@pytest.mark.parametrize(
    ("seconds", "moved", "jumps"),
    [
        (0.01, 0.99 * _MIN_JUMP_M, False),
        (0.01, 1.01 * _MIN_JUMP_M, True),
        (0.99 * P.max_gap_s, 0.0, False),
        (1.01 * P.max_gap_s, 0.0, True),
        (0.9 * P.max_gap_s, 0.95 * P.max_speed_mps * 0.9 * P.max_gap_s, False),
    ],
)
def test_a_jump_is_far_and_faster_than_anyone_walks(seconds, moved, jumps):
    poses = Poses(P)
    poses.add(FIRST)
    assert poses.add(after(seconds, moved * np.array([0.6, 0.0, 0.8]))) == jumps
    assert not poses.add(
        after(seconds + 0.01, moved * np.array([0.6, 0.0, 0.8]))
    )  # where it jumped to counts from now on
