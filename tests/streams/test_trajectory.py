"""Paths, and errors, as values that are cut and carried about."""

import pickle

import numpy as np
import pytest

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.trajectory import Trajectory


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
