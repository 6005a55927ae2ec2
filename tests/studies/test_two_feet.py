"""Figures of both feet's paths."""

from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.outputs.truth import TruePath
from stridetwin.streams.trajectory import Trajectory
from stridetwin.studies.jao2020.two_feet import score_paths


def columns(n):
    t = np.arange(n)
    p = np.column_stack([0.1 * t, np.zeros(n), np.zeros(n)])
    return {"t_ns": t * 100_000_000, "p_frame_in_world": p, "q_world_frame": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))}


def test_a_foot_whose_imu_died_is_scored_where_it_died_and_says_so():
    truth = {f: TruePath(**columns(101), v_frame_in_world=np.tile([1.0, 0.0, 0.0], (101, 1))) for f in "lr"}
    paths = {
        f: SimpleNamespace(trajectory=Trajectory(**columns(n), covariance=np.tile(1e-4 * np.eye(6), (n, 1, 1))))
        for f, n in (("l", 101), ("r", 41))
    }
    found = score_paths(paths, truth)
    assert found["coverage_pct"] == pytest.approx([100.0, 40.0])
    assert np.allclose(found["end_error_m"], 0.0)
