"""The table of faults: what is done to samples and geometry, and what a small one comes to."""

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.scenarios.exo_geometry import geometry
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Ahrs, Encoder, Insole
from stridetwin.studies.case import Case
from stridetwin.studies.shim2019 import shim_faults
from stridetwin.studies.shim2019.shim_faults import FAULTS
from stridetwin.studies.shim2019.shim_table5 import SENSORS

pytest.importorskip("mujoco")

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 3}
gait: {stand_s: 1}
"""


def encoder(t_s, side="l"):
    return Encoder(topic=f"/exo/knee_{side}/encoder", t_ns=int(t_s * 1e9), angle=0.5)


def test_an_encoder_slips_on_one_side_from_an_instant_on():
    measured = list(FAULTS["encoder_slip"].samples(iter([encoder(1), encoder(9), encoder(9, "r")])))
    assert [s.angle for s in measured] == pytest.approx([0.5, 0.5 + np.radians(2), 0.5])


def test_an_insole_creeps_up_to_its_most():
    cells = [Insole(topic="/foot_l/insole", t_ns=int(t * 1e9), force=np.zeros(4)) for t in (0, 10, 90)]
    measured = [s.force.tolist() for s in FAULTS["insole_drift"].samples(cells)]
    np.testing.assert_allclose(measured, np.outer([0.0, 30.0, 60.0], np.ones(4)))


def test_a_low_zero_gives_a_negative_force_in_the_air():
    cells = [Insole(topic=f"/foot_{side}/insole", t_ns=0, force=np.zeros(4)) for side in "lr"]
    measured = [s.force.tolist() for s in FAULTS["insole_low"].samples(cells)]
    assert measured == [[-3.0] * 4, [0.0] * 4]


def test_geometry_errors_are_where_the_fault_says():
    config = TwinConfig(name="plain", route=Route(segments=(Level(length_m=3.0),)), sensors=SENSORS)
    twin = Twin(config, 0)
    exo = geometry(twin.size, twin.rig)
    long, turned = FAULTS["link_10mm"].calibration(exo), FAULTS["mount_2deg"].calibration(exo)
    apart = [b.a - a.a for a, b in zip(exo.legs["l"].rows, long.legs["l"].rows, strict=True)]
    assert sorted(apart)[-1] == pytest.approx(0.010)
    assert np.count_nonzero(apart) == 1
    R = turned.legs["l"].foot.R_frame_sensor @ exo.legs["l"].foot.R_frame_sensor.T
    assert np.arccos((np.trace(R) - 1) / 2) == pytest.approx(np.radians(2.0))
    assert long.legs["r"] is turned.legs["r"] is exo.legs["r"]


def test_yaw_drifts_and_tilt_does_not():
    level = Ahrs(
        topic="/exo/back/ahrs", t_ns=60_000_000_000, q_world_sensor=np.array([1.0, 0, 0, 0]), angular_rate=np.zeros(3)
    )
    w, x, y, z = next(iter(FAULTS["yaw_drift"].samples([level]))).q_world_sensor
    assert 2 * np.degrees(np.arctan2(z, w)) == pytest.approx(1.0)
    assert (x, y) == pytest.approx((0.0, 0.0))


def test_walks_that_differ_are_walked_anew():
    plain = TwinConfig(name="plain", route=Route(segments=(Level(length_m=3.0),)))
    other = {name for name, fault in FAULTS.items() if fault.walk(plain) != plain}
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
