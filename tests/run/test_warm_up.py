"""What an estimator is shown before the first true sample, live and offline: nothing is left to compile."""

from __future__ import annotations

import numpy as np
import pytest

from stridetwin.run.live_chain import Chain, Request
from stridetwin.run.warm_up import synthetic_rig, synthetic_samples
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from tests.run.left_to_compile import find_left_to_compile


def last_rows(estimator):
    """The last row of each estimator of a chain."""
    chain, rows = Chain(Request(estimator=estimator), synthetic_rig(), {}), {}
    for sample in synthetic_samples(chain.takes):
        rows |= {name: row for name, row in chain.update(sample) if row}
    return rows


def test_a_stationary_wearer_stays_in_place():
    for name in ("foot_ins", "dvio"):
        row = np.array(last_rows(name)[name].split(), float)
        assert row[0] == pytest.approx(6.0)
        assert np.abs(row[1:4]).max() < 1e-4


def test_the_shoes_see_each_other():
    foot, *row = last_rows("foot_to_foot")["foot_to_foot"].split()
    # Without a board in view the right shoe would stay where it is guessed, at (0, -0.1).
    assert foot == "r"
    assert 0.01 < float(row[1]) < 0.03


def test_the_stair_ahead_is_found():
    cells = last_rows("locomotion_mode")["locomotion_mode"].split(",")
    at = cells.index("SA")
    distance, riser, tread = (float(cells[at + i]) for i in (1, 4, 6))
    assert abs(distance - 1.5) < 0.02
    assert abs(riser - 0.17) < 0.003
    assert abs(tread - 0.3) < 0.005


LIVE, OFFLINE = ("foot_ins", "contact_terrain", "locomotion_mode", "foot_to_foot"), ("foot_ins", "dvio")
CASES = [*[("live", name) for name in LIVE], *[("offline", name) for name in OFFLINE]]


@pytest.fixture(scope="module")
def left_to_compile(seen, tmp_path_factory):
    """Kernels left to compile in each case, all by one process, as a start takes seconds."""
    shoes = tmp_path_factory.mktemp("shoes") / "walk.mcap"
    config = TwinConfig(
        name="shoes",
        route=Route(segments=(Level(length_m=0.5),)),
        gait=Gait(stand_s=0.5),
        sensors=("foot_imu", "foot_camera", "sonar"),
        fittings={"foot_camera": SensorConfig(rate_hz=15.0)},
    )
    record(Twin(config, 5), shoes, lambda *_: None)
    # shoes that see each other are those of the second recording
    asked = [(how, shoes if name == "foot_to_foot" else seen, name) for how, name in CASES]
    return dict(zip(CASES, find_left_to_compile(asked), strict=True))


@pytest.mark.parametrize("case", CASES, ids=" ".join)
def test_nothing_is_left_to_compile(left_to_compile, case):
    assert left_to_compile[case] == []
