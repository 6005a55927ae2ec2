"""Feet and head estimated in parallel give what they give one after the other."""

import numpy as np
import pytest

from stridetwin.estimators.base import BACKENDS, PathEstimate
from stridetwin.outputs import terrain_ahead as ahead_module
from stridetwin.outputs.feeding import all_paths
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory


def test_two_processes_estimate_the_same_as_one(seen, monkeypatch):
    asked = []
    monkeypatch.setattr(ahead_module, "two_see", lambda recording, only: asked.append(recording.path) or True)
    made, ahead = ahead_module.all_estimates(Recording(seen), lambda stage, share: None)
    assert asked == [seen]
    alone = all_paths(Recording(seen))
    assert [e.name for e in made] == [e.name for e in alone]
    assert {e.name for e in made} >= {"foot_ins_l", "foot_to_foot_r", "dvio"}
    for one, other in zip(made, alone, strict=True):
        assert one.frame == other.frame
        assert one.nis == other.nis
        assert np.array_equal(one.path.t_ns, other.path.t_ns)
        assert np.array_equal(one.path.p_frame_in_world, other.path.p_frame_in_world)
    assert ahead is not None
    assert "terrain_map" in ahead.scores


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_map_of_either_backend_is_scored_and_predicts_modes(seen, backend):
    recording = Recording(seen)
    truth = recording.block("/truth/head/imu/odometry")
    path = Trajectory(
        t_ns=truth.t_ns,
        p_frame_in_world=truth.columns["p_frame_in_world"],
        q_world_frame=truth.columns["q_world_frame"],
    )
    odometry = ahead_module.odometry_of(
        recording, [PathEstimate(name="truth", frame="head/imu", path=path, leads=True)]
    )
    ahead = ahead_module.look_ahead(recording, odometry, backend=backend)
    scores = ahead.scores["terrain_map"]
    assert scores["accuracy_rmse_mm"] < 15.0
    assert scores["completeness_pct"] > 70.0
    assert ahead.predicted["locomotion_mode"]
    assert {e.steps[0].mode for e in ahead.predicted["locomotion_mode"]} == {"LG"}
    alone = ahead_module.look_ahead(recording, odometry, backend=backend, only=("terrain_map",))
    assert alone.predicted == {}
    same = scores if backend == "numba" else pytest.approx(scores, rel=0.1)  # Open3D's sums differ from run to run
    assert alone.scores == {"terrain_map": same}
