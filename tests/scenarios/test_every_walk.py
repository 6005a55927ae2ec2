import json
import sys

import pytest

from benchmarks import every_walk
from stridetwin.sim.config import Gait


@pytest.mark.parametrize("manner", ["wander", "jog", "step_by_step"])
def test_a_terrain_is_walked_in_every_pattern(manner):
    outcome = every_walk.walk("stair_up_down", manner, "kinematic", 1000)
    assert (outcome.verdict, outcome.why) == ("ok", "")
    assert outcome.duration_s > 10.0


def test_a_walk_that_cannot_be_is_told_with_its_reason(monkeypatch, capsys):
    monkeypatch.setitem(every_walk.MANNERS, "sprint", Gait(speed_mps=5.0))
    monkeypatch.setattr(sys, "argv", ["every_walk", "--json", "--terrains", "level_20m", "--manners", "sprint"])
    assert every_walk.main() == 1
    case = json.loads(capsys.readouterr().out)["cases"][0]
    assert case["verdict"] == "refused"
    assert "0.05-2.1 m/s" in case["why"]
