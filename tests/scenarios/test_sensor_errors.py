"""A short walk with every error of drivers and clocks, from the scenario file to the samples."""

import numpy as np
import pytest
import yaml

from stridetwin.scenarios.scenario_file import read_scenario
from stridetwin.sim.choices import part_files
from stridetwin.sim.faults.faults import FaultPlan
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Imu

LEFT, RIGHT = "/foot_l/imu", "/foot_r/imu"
FAULT = {"kind": "interpolated", "topic": LEFT, "at_s": 0, "share": 0.5, "packet_samples": 3, "above_deg_s": 100}
WALK = {
    "description": "a few steps with late forces and filled packets, in the mountains",
    "terrain": [{"level": {"length_m": 2}}],
    "exo": "none",
    "gait": {"stand_s": 1},
    "sensors": {name: False for name in ("foot_camera", "sonar", "insole", "head_imu", "head_camera")}
    | {"foot_imu": "x-IMU"},
    "site": {"latitude_deg": 46, "height_m": 3000},
    "faults": [FAULT],
}


def walk(folder, **changes):
    """Samples of a walk by topic, rates and forces (N, 6) with their stamps (N,) ns, after its faults."""
    path = folder / "errors.yaml"
    path.write_text(yaml.safe_dump(WALK | changes))
    twin = Twin(read_scenario(path).config, 4)
    plan = FaultPlan.of(twin.config.faults, twin.rig, 4, twin.duration_s)
    samples = [s for s in plan.samples(item for items in twin.blocks() for item in items) if isinstance(s, Imu)]
    return {
        topic: (
            np.array([s.t_ns for s in samples if s.topic == topic]),
            np.array([np.hstack([s.angular_rate, s.specific_force]) for s in samples if s.topic == topic]),
        )
        for topic in (LEFT, RIGHT)
    }


def test_a_walk_with_every_error_has_regular_stamps_and_finite_values(tmp_path):
    faulty, whole = (
        walk(tmp_path),
        walk(tmp_path, faults=[{**FAULT, "topic": RIGHT, "share": 0.001, "above_deg_s": 9000}]),
    )
    for topic in (LEFT, RIGHT):
        t_ns, values = faulty[topic]
        np.testing.assert_array_equal(t_ns, whole[topic][0][: len(t_ns)])
        assert np.isfinite(values).all()
        assert np.ptp(np.diff(t_ns)) <= 1
    changed = (faulty[LEFT][1] != whole[LEFT][1][: len(faulty[LEFT][1])]).any(axis=1)
    assert 0.05 < changed.mean() < 0.6
    assert not changed[: 256 // 2].any()  # standing
    np.testing.assert_array_equal(faulty[RIGHT][1], whole[RIGHT][1])


def test_the_part_with_late_forces_is_late_in_forces_alone(tmp_path):
    part = tmp_path / "prompt.yaml"
    text = part_files()["x-IMU"].read_text(encoding="utf-8").splitlines(keepends=True)
    part.write_text("".join(line for line in text if "delay_ms" not in line), encoding="utf-8")
    late = walk(tmp_path)[RIGHT][1]
    prompt = walk(tmp_path, sensors=WALK["sensors"] | {"foot_imu": "prompt.yaml"})[RIGHT][1]
    np.testing.assert_array_equal(late[:, :3], prompt[:, :3])
    forces = [np.linalg.norm(x[:, 3:], axis=1) for x in (prompt, late)]
    # 12.5 ms are 3.2 samples of 256 Hz
    match = [np.corrcoef(forces[0][:-10], np.roll(forces[1], -lag)[:-10])[0, 1] for lag in range(8)]
    assert np.argmax(match) == 3
    assert match[3] == pytest.approx(1.0, abs=0.05)
