"""Paths, and errors, as values that are cut and carried about."""

import pickle

import numpy as np
import pytest

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.trajectory import Pose, Trajectory, trajectory_of


@pytest.mark.parametrize("covariance", [None, np.arange(4 * 36.0).reshape(4, 6, 6)])
def test_some_poses_of_a_path(covariance):
    q = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    path = Trajectory(
        t_ns=np.arange(4), p_frame_in_world=np.arange(12.0).reshape(4, 3), q_world_frame=q, covariance=covariance
    )
    for which, left in ((slice(1, None), [1, 2, 3]), (np.array([True, False, False, True]), [0, 3]), (slice(0), [])):
        part = path[which]
        assert part.t_ns.tolist() == left
        assert part.p_frame_in_world.tolist() == [[3 * i, 3 * i + 1, 3 * i + 2] for i in left]
        assert (part.covariance is None) == (covariance is None)
        assert covariance is None or part.covariance.tolist() == [covariance[i].tolist() for i in left]


def test_errors_travel_between_processes():
    for error in (
        ConfigError("a.yaml", "exo.mode", 7, "0-4"),
        ConfigError("b", "", "x", "y"),
        StrideTwinError("words"),
    ):
        there = pickle.loads(pickle.dumps(error))
        assert type(there) is type(error)
        assert str(there) == str(error)
        assert vars(there) == vars(error)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"covariance": np.eye(3)},
            r"Pose.covariance at t = 1.500 s: invalid shape \(3, 3\): expected \(6, 6\), of x",
        ),
        ({"rotation": np.eye(4)}, r"Pose.rotation .* \(4, 4\): expected \(4,\) or \(3, 3\), a quaternion, w first"),
        ({"p_frame_in_world": np.zeros(2)}, r"Pose.p_frame_in_world .* \(2,\): expected \(3,\), m"),
    ],
)
def test_an_array_of_another_shape_is_named_with_its_time(changes, message):
    valid = {"t_ns": 1, "p_frame_in_world": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    with pytest.raises(StrideTwinError, match=message):
        trajectory_of([Pose(**valid), Pose(**{**valid, "t_ns": 1_500_000_000, **changes})])
    path = trajectory_of([Pose(**valid, covariance=np.eye(6)), Pose(**{**valid, "t_ns": 2}, covariance=np.eye(6))])
    assert path.covariance.shape == (2, 6, 6)
