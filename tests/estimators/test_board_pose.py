"""Pose of a board from its corners: both solutions of the plane, and an honest covariance."""

import numpy as np
import pytest
from board_images import BOARD, pose
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.checkerboard.pattern import BoardPattern
from stridetwin.estimators.checkerboard.pose import BoardObservation, find_board_poses, select_poses
from stridetwin.streams.samples import Array

POINTS = BoardPattern(BOARD).points_in_board
SD = 1e-4


def observation(T: Array, rng: np.random.Generator, sd: float = SD, which: slice = slice(None)) -> BoardObservation:
    p = POINTS[which] @ T[:3, :3].T + T[:3, 3]
    rays = p[:, :2] / p[:, 2:] + rng.normal(0.0, sd, (len(p), 2))
    return BoardObservation(
        topic="/foot_l/camera", t_ns=0, points_in_board=POINTS[which], rays=rays, ray_sd=np.full(len(p), sd)
    )


def error(T_estimated: Array, T: Array) -> Array:
    turn = Rotation.from_matrix(T[:3, :3] @ T_estimated[:3, :3].T).as_rotvec()
    return np.concatenate([T[:3, 3] - T_estimated[:3, 3], turn])


@settings(deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_true_pose_is_among_the_admissible(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = pose(*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.2, 0.6), *rng.uniform(-0.8, 0.8, 3))
    poses = find_board_poses(observation(T, rng))
    assert 1 <= len(poses) <= 2
    assert [p.chi2 for p in poses] == sorted(p.chi2 for p in poses)
    nees = [e @ np.linalg.solve(p.covariance, e) for p in select_poses(poses) for e in [error(p.T_camera_board, T)]]
    assert min(nees) < 40  # chi-square of 6: one in a million


def test_covariance_is_consistent() -> None:
    rng = np.random.default_rng(0)
    T = pose(0.02, 0.01, 0.25, 0.3, 0.5, 0.4)
    nees = []
    for _ in range(200):
        best = find_board_poses(observation(T, rng))[0]
        e = error(best.T_camera_board, T)
        nees.append(e @ np.linalg.solve(best.covariance, e))
    assert 5.2 < np.mean(nees) < 6.8


def test_a_far_plane_has_two_poses_until_its_orientation_is_known() -> None:
    rng = np.random.default_rng(1)
    T = pose(0.0, 0.0, 0.6, 0.2, 0.25, 0.0)
    poses = find_board_poses(observation(T, rng, sd=5e-4))
    assert len(select_poses(poses)) == 2
    known = select_poses(poses, T[:3, :3], rotation_sd=0.02)
    assert len(known) == 1
    assert np.linalg.norm(error(known[0].T_camera_board, T)[3:]) < 0.2


@pytest.mark.parametrize("which", [slice(0, 5), slice(0, 40, 5), slice(1, 5)])
def test_corners_on_a_line_show_no_plane(which: slice) -> None:
    seen = observation(pose(0.0, 0.0, 0.3, 0.0, 0.2, 0.2), np.random.default_rng(3), which=which)
    assert find_board_poses(seen) == ()


def test_half_a_board_is_less_certain() -> None:
    rng = np.random.default_rng(4)
    T = pose(0.0, 0.0, 0.3, 0.0, 0.4, 0.3)
    whole, half = (find_board_poses(observation(T, rng, which=w))[0] for w in (slice(None), slice(0, 20)))
    assert np.trace(half.covariance) > 2 * np.trace(whole.covariance)
