"""Feet and head beside each other tell what they tell one after the other."""

import numpy as np

from stridetwin.evaluation import terrain_ahead as ahead_module
from stridetwin.pipeline.run import all_paths
from stridetwin.streams.recording.reader import Recording


def test_two_processes_tell_the_same_as_one(seen, monkeypatch):
    asked = []
    monkeypatch.setattr(ahead_module, "two_see", lambda recording: asked.append(recording.path) or True)
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
