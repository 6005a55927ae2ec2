import json
import sys

import pytest

from benchmarks import every_walk
from stridetwin.sim.config import Dynamics, Gait


@pytest.mark.parametrize("manner", ["wander", "jog", "step_by_step"])
def test_a_terrain_is_walked_in_every_pattern(manner):
    outcome = every_walk.walk("stair_up_down", manner, "kinematic", None, 1000)
    assert (outcome.verdict, outcome.why) == ("ok", "")
    assert outcome.duration_s > 10.0
    assert outcome.help_mean_pct is None


def test_help_at_the_root_is_reported_and_too_much_of_it_is_wrong(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["every_walk", "--assist"])
    with pytest.raises(SystemExit):
        every_walk.main()
    monkeypatch.setattr(every_walk, "HELP_MEAN_PCT", 0.0)
    outcome = every_walk.walk("shim_level", "walk", "dynamic", Dynamics(assist=True), 1000)
    assert outcome.verdict == "wrong"
    assert "% of the body weight" in outcome.why
    assert 0.0 < outcome.help_mean_pct < outcome.help_p95_pct < outcome.help_max_pct


def test_a_walk_that_cannot_be_is_reported_with_its_reason(monkeypatch, capsys):
    monkeypatch.setitem(every_walk.MANNERS, "sprint", Gait(speed_mps=5.0))
    monkeypatch.setattr(sys, "argv", ["every_walk", "--json", "--terrains", "level_20m", "--manners", "sprint"])
    assert every_walk.main() == 1
    case = json.loads(capsys.readouterr().out)["cases"][0]
    assert case["verdict"] == "refused"
    assert "0.05-2.1 m/s" in case["why"]
