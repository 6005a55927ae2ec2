"""Feet and head estimated in parallel give what they give one after the other."""

import numpy as np
import pytest

from stridetwin.estimators.backends import BACKENDS
from stridetwin.estimators.base import PATH, PathEstimate
from stridetwin.outputs.aligned_walk import odometry_of
from stridetwin.outputs.base import scores_by_output
from stridetwin.outputs.path.run import all_paths
from stridetwin.outputs.registry import kinds
from stridetwin.run import recording as run_module
from stridetwin.run.recording import KindEvaluations, Selection, run_driven, run_recording
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory


def test_two_processes_estimate_the_same_as_one(seen, monkeypatch):
    asked = []
    monkeypatch.setattr(
        run_module, "has_two_image_estimators", lambda recording, only: asked.append(recording.path) or True
    )
    of_kinds = dict(run_recording(Recording(seen), in_two_processes=True))
    assert asked == [seen]
    made, alone = [o.estimates for o in of_kinds[kinds()[PATH]]], all_paths(Recording(seen))
    assert [e.name for e in made] == [e.name for e in alone]
    assert {e.name for e in made} >= {"foot_ins_l", "foot_to_foot_r", "dvio"}
    for one, other in zip(made, alone, strict=True):
        assert one.frame == other.frame
        assert one.nis == other.nis
        assert np.array_equal(one.path.t_ns, other.path.t_ns)
        assert np.array_equal(one.path.p_frame_in_world, other.path.p_frame_in_world)
    assert "terrain_map" in {o.name for outputs in of_kinds.values() for o in outputs}


def evaluate(recording, odometry, **selection):
    of_kinds = run_driven(recording, odometry, Selection(**selection))
    return [KindEvaluations(kind=kind, evaluations=kind.evaluate(outputs, recording)) for kind, outputs in of_kinds]


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_map_of_either_backend_is_scored_and_predicts_modes(seen, backend):
    recording = Recording(seen)
    truth = recording.block("/truth/head/imu/odometry")
    path = Trajectory(
        t_ns=truth.t_ns,
        p_frame_in_world=truth.columns["p_frame_in_world"],
        q_world_frame=truth.columns["q_world_frame"],
    )
    odometry = odometry_of(recording, [PathEstimate(name="truth", frame="head/imu", path=path, supplies_poses=True)])
    of_kinds = evaluate(recording, odometry, backend=backend)
    scores = scores_by_output(of_kinds)["terrain_map"]
    assert scores["accuracy_rmse_mm"] < 15.0
    assert scores["completeness_pct"] > 70.0
    (modes,) = (e for o in of_kinds for e in o.evaluations if e.name == "locomotion_mode")
    assert modes.estimates
    assert {e.steps[0].mode for e in modes.estimates} == {"LG"}
    if backend == "numba":  # Open3D's sums differ from run to run
        alone = scores_by_output(evaluate(recording, odometry, backend=backend, only=frozenset({"terrain_map"})))
        assert alone == {"terrain_map": scores}
