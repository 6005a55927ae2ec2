"""Scores need estimators, these need sensors, and nothing else is simulated or estimated."""

import json

import pytest

from stridetwin.cli.main import main
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.scenarios.score_needs import estimators_of, sensors_of
from stridetwin.streams.errors import StrideTwinError


def groups(*names, scenario="level_20m"):
    return set(sensors_of(estimators_of(names), load_scenario(scenario).config))


def test_names_of_estimators_parts_and_scores_mean_the_estimator_and_those_that_feed_it():
    assert estimators_of(["foot_ins"]) == {"foot_ins"}
    assert estimators_of(["foot_ins_l", "foot_ins_r.end_error_m"]) == {"foot_ins"}
    assert estimators_of(["terrain_map.completeness_pct"]) == {"terrain_map", "dvio"}
    assert estimators_of(["locomotion_mode"]) == {"locomotion_mode", "dvio"}
    with pytest.raises(StrideTwinError, match="invalid 'foot_inz': expected contact_terrain, dvio, foot_ins"):
        estimators_of(["foot_inz"])


def test_only_the_sensors_that_an_estimator_reads_are_needed():
    assert groups("foot_ins") == {"foot_imu"}
    assert groups("foot_to_foot") == {"foot_imu", "foot_camera", "sonar"}
    assert groups("dvio") == {"head_imu", "head_camera"}
    assert groups("locomotion_mode") == {"head_imu", "head_camera", "insole"}
    assert groups("contact_terrain") == {"ahrs", "encoder", "insole"}
    assert groups("foot_ins", "dvio") == {"foot_imu", "head_imu", "head_camera"}


def test_a_walk_without_the_sensors_of_an_estimator_is_refused_by_name():
    with pytest.raises(StrideTwinError, match="shim_building: dvio cannot run: expected a walk with a camera with IMU"):
        groups("dvio", scenario="shim_building")


def test_run_only_records_and_scores_nothing_else(tmp_path, simulator, capsys):
    assert main(["run", "level_20m", "--only", "foot_ins", "--no-film", "-o", str(tmp_path / "run"), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert set(data["estimators"]) == {"foot_ins_l", "foot_ins_r"}
    recording = str(tmp_path / "run" / "recording.mcap")
    assert main(["score", recording, "--only", "foot_ins_l", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["estimators"] == data["estimators"]
    assert main(["score", recording, "--only", "dvio"]) == 2
    assert "no estimator can run: expected a recording with a camera with IMU" in capsys.readouterr().err
