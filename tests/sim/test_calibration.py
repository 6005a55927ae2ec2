"""Nominal calibration of a camera against the true one; and the vibration of its case after heel strikes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.nominal import CalibrationSd, depth_scale
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.rendering.cameras import Cameras, FrameRequest
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Depth

SD = CalibrationSd(rotation_rad=0.004, position_m=0.002, intrinsics=0.001, offset_s=0.001, depth_scale=0.005)
CONFIG = TwinConfig(
    name="few steps",
    route=Route(segments=(Level(length_m=2.0),), scenery="room"),
    gait=Gait(stand_s=0.5),
    exo=None,
    sensors=("head_imu", "head_camera"),
    fittings={"head_camera": SensorConfig(calibration_sd=SD, rate_hz=1.0)},
)
SEEDS = range(300)


def test_a_perfect_calibration_is_the_true_one() -> None:
    worn = sensor_rig(replace(CONFIG, fittings={}))
    assert worn.nominal(3) is worn.rig
    assert depth_scale("/head/color", CalibrationSd(), 3) == 1.0


def test_errors_are_as_large_as_they_are_said_to_be_and_of_one_seed_always_the_same() -> None:
    worn = sensor_rig(CONFIG)
    true = worn.rig.cameras["/head/color"]
    drawn = [worn.nominal(seed).cameras["/head/color"] for seed in SEEDS]
    between = [np.linalg.inv(true.mount.T_body_sensor) @ c.mount.T_body_sensor for c in drawn]
    turns = np.array([Rotation.from_matrix(T[:3, :3]).as_rotvec() for T in between])
    for values, sd in (
        (turns, SD.rotation_rad),
        (np.array([T[:3, 3] for T in between]), SD.position_m),
        (np.array([np.array(c.intrinsics) / true.intrinsics - 1 for c in drawn]), SD.intrinsics),
        (np.array([[c.timeshift_cam_imu_s] for c in drawn]), SD.offset_s),
        (np.array([[depth_scale("/head/color", SD, seed) - 1] for seed in SEEDS]), SD.depth_scale),
    ):
        assert values.std(axis=0) == pytest.approx(np.full(values.shape[1], sd), rel=0.15)
        assert np.abs(values.mean(axis=0)).max() < 0.2 * sd
    again = worn.nominal(7).cameras["/head/color"]
    np.testing.assert_array_equal(again.mount.T_body_sensor, drawn[7].mount.T_body_sensor)
    assert worn.nominal(7).imus is worn.rig.imus


def test_only_a_rolling_shutter_has_a_readout_time_and_its_error_is_a_share_of_it() -> None:
    def readout_s(name: str, sd: float, seed: int = 0) -> float:
        camera = SensorConfig(part=load_part(name), calibration_sd=CalibrationSd(readout=sd))
        worn = sensor_rig(replace(CONFIG, fittings={"head_camera": camera}))
        return worn.nominal(seed).cameras["/head/color"].readout_s

    assert readout_s("D455", 0.03) == 0.0
    assert readout_s("D435", 0.0) == pytest.approx(0.016)
    errors = np.array([readout_s("D435", 0.03, seed) / 0.016 - 1.0 for seed in range(100)])
    assert errors.std() == pytest.approx(0.03, rel=0.25)


def test_calibration_errors_change_no_sample_but_the_scale_of_depth() -> None:
    twin, perfect = Twin(CONFIG, 4), Twin(replace(CONFIG, fittings={"head_camera": SensorConfig(rate_hz=1.0)}), 4)
    assert not np.array_equal(
        twin.rig.cameras["/head/color"].mount.T_body_sensor, perfect.rig.cameras["/head/color"].mount.T_body_sensor
    )
    here, there = (depth_seen(t) for t in (twin, perfect))
    both = (here > 0) & (there > 0)
    scale = depth_scale("/head/color", SD, 4)
    assert abs(scale - 1) > 1e-4
    assert np.median(here[both] / there[both]) == pytest.approx(scale, abs=4e-4)  # depth is in whole millimetres


def depth_seen(twin: Twin) -> np.ndarray:
    """An image in the middle of the walk."""
    t_ns = np.array([round(0.5e9 * twin.duration_s)])
    motion, due = (
        twin.player().motion(t_ns),
        FrameRequest(t_ns=int(t_ns[0]), topic="/head/color", twist=np.zeros((2, 6))),
    )
    with Cameras(twin.model, twin.sensor_rig, twin.crowd, twin.seed) as cameras:
        taken = list(cameras.frames([due], motion.qpos, motion.upper_poses(np.arange(1))))
    (depth,) = [item.depth for item in taken if isinstance(item, Depth)]
    return depth


def test_strikes_shake_the_case_and_truth_and_imu_agree_on_it() -> None:
    quiet = Twin(replace(CONFIG, sensors=("head_imu",)), 4)
    shaken = Twin(
        replace(CONFIG, sensors=("head_imu",), fittings={"head_imu": SensorConfig(strike=9.81, ideal=True)}), 4
    )
    t_ns = np.arange(0, int(quiet.duration_s * 1e9), 1_000_000)
    still, moved = (t.player().motion(t_ns).carrier("head") for t in (quiet, shaken))
    apart = np.linalg.norm(moved.p_body_in_world - still.p_body_in_world, axis=1)
    push = np.diff(moved.v_body_in_world - still.v_body_in_world, axis=0) * 1e3
    assert 0.5e-3 < apart.max() < 5e-3
    assert 5.0 < np.abs(push[:, 2]).max() < 25.0
    assert np.abs(moved.w_body - still.w_body).max() < 1e-12
    touched = [s.t_touch for side in "lr" for s in shaken.walk.steps[side] if 0.0 < s.t_touch < shaken.duration_s]
    before = t_ns < 1e9 * min(touched)
    assert apart[before].max() == 0.0
    blocks = [b for chunk in shaken.blocks() for b in chunk if getattr(b, "topic", "") == "/head/imu"]
    force = np.vstack([b.columns["specific_force"] for b in blocks])
    assert np.linalg.norm(force, axis=1).max() > 14.0
    assert not shaken.player().motion(t_ns[:5]).upper_poses(np.arange(5)).keys() & {"head"}
