"""The table of faults: what is done to samples and geometry, and what a small one comes to."""

import numpy as np
import pytest

from stridetwin.scenarios.exo_geometry import nominal_geometry
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.studies.experiment import experiment
from stridetwin.studies.fault_injection import fault_plans
from stridetwin.studies.shim2019 import shim_faults
from tests.studies.short_experiment import make_case, shorten

pytest.importorskip("mujoco")
MOUNT_OFF = "left foot's AHRS mount 2° off in the geometry"

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 3}
gait: {stand_s: 1}
"""


def test_geometry_errors_are_where_the_fault_says(tmp_path):
    case = make_case(experiment("shim_faults"), tmp_path)
    sensors = case.setup.sensors
    config = TwinConfig(name="plain", route=Route(segments=(Level(length_m=3.0),)), sensors=sensors)
    twin = Twin(config, 0)
    plans = fault_plans(case, twin.rig, 10.0)

    def geometry_of(label):
        return nominal_geometry(twin.size, plans[label].rig, 0, [fault for fault, _ in plans[label].planned])

    long, rotated = map(geometry_of, ("left thigh 10 mm too long in the geometry", MOUNT_OFF))
    exo = geometry_of("no fault")
    apart = [b.a - a.a for a, b in zip(exo.legs["l"].rows, long.legs["l"].rows, strict=True)]
    assert apart[exo.legs["l"].knee.frame - 1] == max(apart) == pytest.approx(0.010)
    assert np.count_nonzero(apart) == 1
    R = exo.legs["l"].foot.R_frame_sensor.T @ rotated.legs["l"].foot.R_frame_sensor
    assert np.arccos((np.trace(R) - 1) / 2) == pytest.approx(np.radians(2.0))
    lateral = exo.legs["l"].sole.T_foot_sole[:3, 1]
    assert np.linalg.norm(rotated.legs["l"].foot.R_frame_sensor @ [0, 1, 0] - lateral) < 0.02
    for other in (long, rotated):
        np.testing.assert_array_equal(other.legs["r"].foot.R_frame_sensor, exo.legs["r"].foot.R_frame_sensor)
        assert other.legs["r"].rows == exo.legs["r"].rows


def test_a_small_table(tmp_path):
    faults = {
        "no fault": [],
        "heel dead": [{"kind": "dead_cell", "topic": "/foot_l/insole", "at_s": 0, "cell": "heel"}],
        "thigh long": [{"kind": "miscalibration", "topic": "/exo/knee_l/encoder", "thigh_mm": 10}],
        "AHRS dead": [{"kind": "dropout", "topic": "/exo/thigh_l/ahrs", "at_s": 1}],
    }
    manners = {"subject": [1], "manner": {"usual": {}, "shuffling": {"gait.shuffle": 1}}}
    study = shorten("shim_faults", tmp_path, SHORT, faults=faults, vary=manners)
    row = shim_faults.run_case(make_case(study, tmp_path, seed=0))
    result = study.result([row])
    of = result["summary"]
    assert list(of) == [*faults, "shuffling"]
    assert row["faults"]["shuffling"] != row["faults"]["no fault"]
    assert of["no fault"]["classification_accuracy_pct"] == 100.0
    assert row["faults"]["thigh long"] != row["faults"]["no fault"] != row["faults"]["heel dead"]
    assert of["thigh long"]["elevation_max_mm"] < 35.0
    assert of["no fault"]["false_steps"] == 0
    assert of["heel dead"]["wrong_pct"] == 0.0
    assert of["AHRS dead"]["steps_missed"] == of["AHRS dead"]["steps"] > 0
    lines = study.table(result)
    assert len(lines) == 4 + len(of)
    assert lines[2].endswith("none")
