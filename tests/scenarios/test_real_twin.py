"""The commands with the twin itself, on a walk that is as short as it gets."""

import json

import pytest

from stridetwin.cli.main import main
from stridetwin.streams.recording.reader import Recording

pytest.importorskip("mujoco")

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 3}
gait: {stand_s: 1}
sensors: [foot_imu, insole, ahrs, encoder]
"""


def test_a_short_walk_is_recorded_estimated_and_scored(tmp_path, capsys):
    scenario = tmp_path / "short.yaml"
    scenario.write_text(SHORT)
    folder = tmp_path / "out"
    assert main(["run", str(scenario), "--no-film", "-o", str(folder), "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)["estimators"]
    assert main(["score", str(folder / "recording.mcap"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["estimators"] == scores
    steps = scores.pop("contact_terrain")
    phases = [scores.pop(f"gait_phase_{side}") for side in "lr"]
    assert all(foot["rmse_pct"] < 10.0 for foot in phases)
    assert set(scores) == {"foot_ins_l", "foot_ins_r", "foot_to_foot_l", "foot_to_foot_r"}
    assert (steps["classification_accuracy_pct"], steps["missed_pct"]) == (100.0, 0.0)
    assert steps["elevation_rmse_mm"] < 15.0
    assert len((folder / "contact_terrain.csv").read_text().splitlines()) >= 1 + steps["steps"]
    for foot in scores.values():
        assert foot["distance_m"] == pytest.approx(3, abs=1)
        assert foot["end_error_pct"] < 5
        assert foot["coverage_pct"] > 95
    topics = Recording(folder / "recording.mcap").topics
    assert {"/truth/pelvis/odometry", "/truth/joints", "/truth/footprints", "/foot_l/insole"} <= set(topics)
    assert "/foot_l/camera" not in topics
    report = (folder / "report.html").read_text()
    assert all(words in report for words in ("Accuracy", "Paths", "Terrain estimated from the legs", "Sensor streams"))
