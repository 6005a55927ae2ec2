"""The table of faults: what is done to samples and geometry, and what a small one comes to."""

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.scenarios.exo_geometry import nominal_geometry
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.studies.case import Case
from stridetwin.studies.shim2019 import shim_faults
from stridetwin.studies.shim2019.shim_faults import FAULTS, walk_of
from stridetwin.studies.shim2019.shim_table5 import SENSORS

pytest.importorskip("mujoco")

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 3}
gait: {stand_s: 1}
"""


def test_geometry_errors_are_where_the_fault_says():
    config = TwinConfig(name="plain", route=Route(segments=(Level(length_m=3.0),)), sensors=SENSORS)
    twin = Twin(config, 0)

    def geometry_of(name):
        plan = FAULTS[name].plan(twin.rig, 0, 10.0)
        return nominal_geometry(twin.size, plan.rig, 0, FAULTS[name].faults)

    exo, long, rotated = (geometry_of(name) for name in ("none", "link_10mm", "mount_2deg"))
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


def test_walks_that_differ_are_walked_anew():
    plain = TwinConfig(name="plain", route=Route(segments=(Level(length_m=3.0),)))
    other = {name for name in FAULTS if walk_of(name, plain) != plain}
    assert other == {"shuffle", "mode_1"}


def test_a_small_table(monkeypatch, tmp_path):
    scenario = tmp_path / "short.yaml"
    scenario.write_text(SHORT)
    few = {name: FAULTS[name] for name in ("none", "heel_dead", "link_10mm", "ahrs_dead")}
    few["ahrs_dead"] = replace(
        few["ahrs_dead"], faults=tuple(replace(f, at_s=1.0) for f in few["ahrs_dead"].faults)
    )  # fmt: skip
    monkeypatch.setattr(shim_faults, "WALKS", (str(scenario),))
    monkeypatch.setattr(shim_faults, "FAULTS", few)
    case = shim_faults.run_case(Case(seed=0, folder=tmp_path, physics="kinematic"))
    result = shim_faults.collect([case])
    of = result["summary"]
    assert of["none"]["classification_accuracy_pct"] == 100.0
    assert case["faults"]["link_10mm"] != case["faults"]["none"] != case["faults"]["heel_dead"]
    assert of["link_10mm"]["elevation_max_mm"] < 35.0
    assert of["none"]["false_steps"] == 0
    assert of["heel_dead"]["wrong_pct"] == 0.0
    assert of["ahrs_dead"]["steps_missed"] == of["ahrs_dead"]["steps"] > 0
    lines = shim_faults.table(result | {"cases": [case]})
    assert len(lines) == 3 + len(few)
    assert lines[1].endswith("none")
