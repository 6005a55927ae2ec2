"""A walk that is sensed while it is made."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from stridetwin.sim.config import Exo, Gait, Level, Route, TwinConfig
from stridetwin.sim.faults.sample_faults import Dropout
from stridetwin.sim.live import LATENCY_S, LiveTwin
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Actuator, Block

WALK = TwinConfig(
    name="live",
    route=Route(segments=(Level(length_m=0.6),)),
    sensors=("insole", "encoder", "ahrs", "actuator"),
    gait=Gait(stand_s=0.5),
    physics="dynamic",
    exo=Exo(mode=1),
    shock=False,
)


def test_what_arrives_live_is_what_a_recording_holds() -> None:
    recorded = {
        (sample.topic, sample.t_ns): sample
        for blocks in Twin(WALK, 3).blocks()
        for block in blocks
        if isinstance(block, Block) and not block.topic.startswith("/truth")
        for sample in block
    }
    delivered, at = 0, 0.0
    with LiveTwin(Twin(WALK, 3)) as live:
        while not live.simulation.is_over:
            at += 0.05
            for sample in live.advance(at):
                assert sample.t_ns * 1e-9 <= live.simulation.time_s - LATENCY_S
                for field in fields(sample):
                    value, same = (getattr(s, field.name) for s in (sample, recorded[sample.topic, sample.t_ns]))
                    if isinstance(value, np.ndarray):
                        np.testing.assert_allclose(value, same, rtol=0, atol=1e-6, err_msg=f"{sample.topic} {field}")
                delivered += 1
        assert live.advance(at) == []
    assert delivered > 0.98 * len(recorded)


def test_an_imu_of_narrow_bandwidth_waits_for_the_motion_that_it_needs() -> None:
    standard = load_part("ADIS16485")
    assert isinstance(standard, ImuPart)
    slow = replace(
        standard,
        gyroscope=replace(standard.gyroscope, bandwidth_hz=20.0),
        accelerometer=replace(standard.accelerometer, bandwidth_hz=20.0),
    )
    walk = replace(WALK, sensors=("foot_imu",), exo=None, fittings={"foot_imu": SensorConfig(part=slow)})
    held = {
        (sample.topic, sample.t_ns): sample
        for blocks in Twin(walk, 3).blocks()
        for block in blocks
        if isinstance(block, Block) and block.topic == "/foot_l/imu"
        for sample in block
    }
    with LiveTwin(Twin(walk, 3)) as live:
        delivered = [s for k in range(1, 50) for s in live.advance(0.05 * k) if s.topic == "/foot_l/imu"]
    assert len(delivered) > 200
    for sample in delivered:
        same = held[sample.topic, sample.t_ns]
        np.testing.assert_allclose(sample.specific_force, same.specific_force, rtol=0, atol=1e-5)
        np.testing.assert_allclose(sample.angular_rate, same.angular_rate, rtol=0, atol=1e-6)


def test_motors_follow_a_law_and_their_sensors_measure_it() -> None:
    """Knees are helped with 5 N m, hips not, from the start."""
    with LiveTwin(Twin(WALK, 3), lambda angle: np.array([0.0, 0.0, 5.0, 5.0])) as live:
        samples = [s for k in range(1, 16) for s in live.advance(0.02 * k) if isinstance(s, Actuator)]
    by_joint = {
        joint: [s.torque for s in samples if joint in s.topic and s.t_ns > 5e7] for joint in ("knee_l", "hip_l")
    }
    assert np.mean(by_joint["knee_l"]) == pytest.approx(5.0, abs=1.0)
    assert abs(np.mean(by_joint["hip_l"])) < 1.0


def test_what_is_planned_for_whole_walks_is_refused() -> None:
    with pytest.raises(ConfigError, match="physics"):
        LiveTwin(Twin(replace(WALK, physics="kinematic"), 3))
    lost = Dropout(topic="/foot_l/insole", at_s=1.0, duration_s=0.5, name="lost")
    with pytest.raises(ConfigError, match="faults"):
        LiveTwin(Twin(replace(WALK, faults=(lost,)), 3))
