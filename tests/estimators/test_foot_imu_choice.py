"""Which IMU of a foot its filters take, where the shoe's own and others on the body may be worn at once."""

from pathlib import Path

import numpy as np
import pytest

from stridetwin.estimators.base import Options, foot_imu_topic
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_to_foot.shoe_rig import shoes_of
from stridetwin.estimators.gait_phase import GaitPhase
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig

ROUTE = Route(segments=(Level(length_m=3.0),))


def rig(*groups: str, places: tuple[str, ...] = ("ankle_l", "heel_l", "shank_l")) -> Rig:
    worn = SensorConfig(places=dict.fromkeys(places, SensorConfig()))
    return standard_rig(TwinConfig(name="feet", route=ROUTE, sensors=groups, fittings={"body_imu": worn}))


def test_the_shoes_own_imu_comes_first_then_the_first_on_the_foot() -> None:
    both, others = rig("foot_imu", "body_imu"), rig("body_imu")
    assert foot_imu_topic(both, "l") == "/foot_l/imu"
    assert foot_imu_topic(others, "l") == "/body/heel_l/imu"  # in the order of the rig
    assert foot_imu_topic(others, "r") == foot_imu_topic(None, "r") == foot_imu_topic(Rig(), "r") == "/foot_r/imu"


@pytest.mark.parametrize("estimator", [FootIns, GaitPhase])
def test_filters_of_one_foot_read_it_and_are_built_for_it(estimator: type[FootIns] | type[GaitPhase]) -> None:
    worn = rig("body_imu")
    assert [s.topic for s in estimator.streams(worn, Options(foot="l"))] == ["/body/heel_l/imu"]
    estimator(worn, options=Options(foot="l"))
    with pytest.raises(StrideTwinError, match="/foot_r/imu"):
        estimator(worn, options=Options(foot="r"))


def test_two_shoes_stay_those_of_their_own_imus() -> None:
    shoes = shoes_of(rig("foot_imu", "foot_camera", "sonar", "body_imu"))
    alone = shoes_of(rig("foot_imu", "foot_camera", "sonar"))
    assert {foot: imu.topic for foot, imu in shoes.imus.items()} == {"l": "/foot_l/imu", "r": "/foot_r/imu"}
    np.testing.assert_array_equal(shoes.mounts, alone.mounts)
    with pytest.raises(StrideTwinError, match="foot_l carries 2 IMUs"):
        shoes_of(rig("body_imu"))


def test_a_recording_keeps_the_mounts_of_all_imus_on_one_body(tmp_path: Path) -> None:
    node = {
        "description": "IMUs beside each other",
        "terrain": [{"level": {"length_m": 1}}],
        "gait": {"stand_s": 0.5},
        "sensors": {
            "head_camera": False,
            "foot_camera": False,
            "body_imu": {"head": True, "heel_l": True, "wrist_r": True},
        },
    }
    twin = make_twin(scenario_of(node, tmp_path / "beside.yaml"), 3)
    record(twin, tmp_path / "beside.mcap", lambda *_: None)
    read = Recording(tmp_path / "beside.mcap").rig
    assert set(read.imus) == set(twin.rig.imus)
    for topic, imu in twin.rig.imus.items():
        assert read.imus[topic].mount.body == imu.mount.body
        np.testing.assert_allclose(read.imus[topic].mount.T_body_sensor, imu.mount.T_body_sensor, atol=1e-9)
