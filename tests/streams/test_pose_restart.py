"""Restarts of an odometry: lost poses, another frame, and metadata that are checked."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.pose_restart import RESTARTS, restart_poses
from stridetwin.streams.trajectory import Trajectory

PATH = Trajectory(
    t_ns=np.arange(10, dtype=np.int64) * 10**9,
    p_frame_in_world=np.outer(np.arange(10.0), [1.0, 0, 0]),
    q_world_frame=np.tile([1.0, 0, 0, 0], (10, 1)),
)


def test_poses_are_lost_and_then_belong_to_another_frame() -> None:
    rows = [(2 * 10**9, 4 * 10**9, np.pi / 2, 0.0, 0.0, 1.0), (6 * 10**9, 7 * 10**9, 0.0, 5.0, 0.0, 0.0)]
    path = restart_poses(PATH, {RESTARTS: json.dumps(rows)})
    assert (path.t_ns // 10**9).tolist() == [0, 1, 4, 5, 7, 8, 9]
    np.testing.assert_allclose(path.p_frame_in_world[:2], PATH.p_frame_in_world[:2])
    np.testing.assert_allclose(path.p_frame_in_world[2:4], [[0, 4, 1], [0, 5, 1]], atol=1e-12)
    np.testing.assert_allclose(path.p_frame_in_world[4:], [[5, 7, 1], [5, 8, 1], [5, 9, 1]], atol=1e-12)
    np.testing.assert_allclose(path.q_world_frame[2:], np.tile([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (5, 1)))


def test_a_recording_without_restarts_leaves_the_path() -> None:
    assert restart_poses(PATH, {}) is PATH


@pytest.mark.parametrize("text", ["{", "[1]", "[[1, 2]]", '[["a", 1, 1, 1, 1, 1]]'])
def test_other_metadata_is_refused(text) -> None:
    with pytest.raises(RecordingError, match="invalid metadata pose_restarts"):
        restart_poses(PATH, {RESTARTS: text})
