"""The twin as a whole: every stream at its rate, the same bytes for the same seed, inertial streams that integrate."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.sim.config import Gait, Level, Route, Stairs, TwinConfig
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import STANDARD, Clock, SensorConfig
from stridetwin.sim.playback import Playback
from stridetwin.sim.rendering.camera_processes import CameraProcesses
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.samples import Block, Depth, Footprint, Image

SHORT = TwinConfig(name="short", route=Route(segments=(Level(length_m=1.0),)), gait=Gait(stand_s=0.5))
QUIET = replace(SHORT, sensors=tuple(s for s in SHORT.sensors if "camera" not in s))
RATES_HZ = {
    "/head/color": 30,
    "/head/depth": 30,
    "/head/imu": 200,
    "/foot_l/imu": 120,
    "/foot_r/imu": 120,
    "/foot_l/camera": 60,
    "/foot_r/camera": 60,
    "/foot_l/sonar": 25,
    "/foot_r/sonar": 25,
    "/foot_l/insole": 100,
    "/foot_r/insole": 100,
    "/exo/back/ahrs": 100,
    "/exo/thigh_l/ahrs": 100,
    "/exo/thigh_r/ahrs": 100,
    "/exo/foot_l/ahrs": 100,
    "/exo/foot_r/ahrs": 100,
    "/exo/knee_l/encoder": 100,
    "/exo/knee_r/encoder": 100,
    "/exo/thigh_l/interaction": 100,
    "/exo/thigh_r/interaction": 100,
    "/exo/shank_l/interaction": 100,
    "/exo/shank_r/interaction": 100,
    "/exo/hip_l/actuator": 100,
    "/exo/hip_r/actuator": 100,
    "/exo/knee_l/actuator": 100,
    "/exo/knee_r/actuator": 100,
    "/truth/joints": 200,
    "/truth/pelvis/odometry": 200,
    "/truth/foot_l/odometry": 200,
    "/truth/foot_r/imu/odometry": 200,
    "/truth/head/imu/odometry": 200,
    "/truth/foot_l/wrench": 200,
    "/truth/foot_r/phase": 200,
    "/truth/root_residual": 200,
}


@pytest.fixture(scope="module")
def quiet() -> Twin:
    return Twin(QUIET, 5)


@pytest.fixture(scope="module")
def plain(quiet: Twin) -> dict[str, list[Block]]:
    return blocks(quiet)


@pytest.fixture(scope="module")
def short() -> Twin:
    return Twin(SHORT, 5)


def record(twin: Twin, path: Path) -> Path:
    with RecordingWriter(path, twin.rig) as writer:
        for items in twin.blocks():
            for item in items:
                writer.write(item)
    return path


def blocks(twin: Twin) -> dict[str, list[Block]]:
    found: dict[str, list[Block]] = {}
    for items in twin.blocks():
        for item in items:
            if isinstance(item, Block):
                found.setdefault(item.topic, []).append(item)
    return found


def small_camera(group: str) -> SensorConfig:
    """The standard camera of a group with a sixteenth of its width and height in pixels."""
    standard: Any = load_part(STANDARD[group])
    small = {name: getattr(standard.imager, name) / 16 for name in ("width", "height", "focal")}
    return SensorConfig(part=replace(standard, imager=replace(standard.imager, **small)))


def test_every_stream_is_recorded_at_its_rate(tmp_path: Path) -> None:
    fittings = {group: small_camera(group) for group in ("head_camera", "foot_camera")}
    twin = Twin(replace(SHORT, fittings=fittings), 1)
    recording = Recording(record(twin, tmp_path / "short.mcap"))
    for topic, rate in RATES_HZ.items():
        info = recording.topics[topic]
        assert abs(info.count - rate * twin.duration_s) <= 1.5, topic
        assert info.first_ns == 0, topic
    assert {"/truth/footprints", "/truth/foot_l/cop", "/truth/foot_r/cop"} < set(recording.topics)
    for topic in recording.topics:
        times = [s.t_ns for s in recording.samples([topic])]
        assert np.all(np.diff(times) > 0), topic
    head, depth = next(iter(recording.samples(["/head/color"]))), next(iter(recording.samples(["/head/depth"])))
    shoe = next(iter(recording.samples(["/foot_l/camera"])))
    assert isinstance(head, Image)
    assert isinstance(depth, Depth)
    assert isinstance(shoe, Image)
    assert (head.pixels.shape, depth.depth.shape, shoe.pixels.shape) == ((30, 40, 3), (30, 40), (38, 50))
    prints = list(recording.samples(["/truth/footprints"]))
    assert all(isinstance(p, Footprint) for p in prints)
    assert [p.foot for p in prints[:3]] == ["l", "r", "r"]


def test_same_seed_same_bytes_other_seed_others(tmp_path: Path, quiet: Twin) -> None:
    one = record(quiet, tmp_path / "one.mcap").read_bytes()
    assert one == record(Twin(QUIET, 5), tmp_path / "two.mcap").read_bytes()
    assert one != record(Twin(QUIET, 6), tmp_path / "three.mcap").read_bytes()


def test_a_sensor_more_or_less_changes_no_other_sensor(plain: dict[str, list[Block]]) -> None:
    few = blocks(Twin(replace(SHORT, sensors=("foot_imu",)), 5))["/foot_l/imu"]
    for a, b in zip(few, plain["/foot_l/imu"], strict=True):
        assert all(np.array_equal(a.columns[name], b.columns[name]) for name in a.columns)


@pytest.mark.parametrize("body", ["foot_l", "foot_r", "head", "torso"])
def test_the_fast_track_of_a_body_is_that_of_the_physics_engine(quiet: Twin, body: str) -> None:
    t_ns = np.arange(0, int(quiet.duration_s * 1e9), 7_000_000, dtype=np.int64)
    fast, slow = quiet.player().track(body, t_ns), quiet.player().motion(t_ns).carrier(body)
    for name in ("p_body_in_world", "v_body_in_world", "w_body"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), atol=1e-9)
    assert (fast.rotation.inv() * slow.rotation).magnitude().max() < 1e-9


def test_another_part_or_clock_of_one_group_changes_no_other_sensor(plain: dict[str, list[Block]]) -> None:
    late = Clock(offset_s=0.002, drift_ppm=50.0, jitter_s=0.0002)
    other = Twin(
        replace(
            QUIET, fittings={"foot_imu": SensorConfig(part=load_part("MPU-9250")), "sonar": SensorConfig(clock=late)}
        ),
        5,
    )
    changed = blocks(other)
    for topic, own in plain.items():
        same = all(
            np.array_equal(a.t_ns, b.t_ns) and all(np.array_equal(a.columns[n], b.columns[n]) for n in a.columns)
            for a, b in zip(own, changed[topic])
        ) and len(own) == len(changed[topic])
        assert same == (topic not in {f"/foot_{s}/{kind}" for s in "lr" for kind in ("imu", "sonar")}), topic
    sonar, before = changed["/foot_l/sonar"][0], plain["/foot_l/sonar"][0]
    assert np.array_equal(sonar.columns["distance"], before.columns["distance"])
    assert np.mean(sonar.t_ns - before.t_ns) == pytest.approx(2e6, rel=0.1)


def test_a_rendering_process_that_dies_is_reported(short: Twin) -> None:
    t_ns = np.round(np.arange(0, 60) * 1e9 / 60).astype(np.int64)
    motion = Playback(short.model, short.reference).motion(t_ns)
    with CameraProcesses(short.model, short.sensor_rig, Crowd(), 5) as processes:
        images = processes.request(motion, -1, int(t_ns[-1]))
        os.kill(processes.pids[0], signal.SIGKILL)
        with pytest.raises(StrideTwinError, match="rendering process ended early"):
            list(images)


def test_an_ideal_imu_integrates_back_onto_the_true_path() -> None:
    """Within 1 mm after 20 s, from the true start, by the samples alone."""
    route = Route(segments=(Level(length_m=6.0), Stairs(risers=5), Level(length_m=12.0)))
    twin = Twin(TwinConfig(name="ideal", route=route, sensors=("foot_imu", "head_imu"), ideal=True), 3)
    streams = blocks(twin)
    playback = Playback(twin.model, twin.reference)
    for topic in ("/foot_l/imu", "/head/imu"):
        t_ns = np.concatenate([b.t_ns for b in streams[topic]])
        rate = np.concatenate([b.columns["angular_rate"] for b in streams[topic]])
        force = np.concatenate([b.columns["specific_force"] for b in streams[topic]])
        imu = twin.rig.imu(topic)
        truth = playback.motion(t_ns).tracks[imu.mount.body].to_sensor(imu.mount.T_body_sensor)
        R, p, v = truth.rotation[0].as_matrix(), truth.p_body_in_world[0], truth.v_body_in_world[0]
        end = int(np.searchsorted(t_ns, 20_000_000_000))
        assert end < len(t_ns)
        for k in range(1, end + 1):
            dt = (t_ns[k] - t_ns[k - 1]) * 1e-9
            turn = Rotation.from_rotvec(rate[k] * dt).as_matrix()
            half = Rotation.from_rotvec(rate[k] * dt / 2).as_matrix()
            # mean of the rotation over the interval by Simpson's rule: exact to the sixth order of the turn
            mean = (np.eye(3) + 4 * half + turn) / 6
            v_next = v + dt * (R @ mean @ force[k] + np.array([0.0, 0.0, -9.81]))
            p, v, R = p + dt * (v + v_next) / 2, v_next, R @ turn
        assert np.linalg.norm(p - truth.p_body_in_world[end]) < 1e-3, topic


def test_physics_that_is_not_there_is_refused_with_what_is() -> None:
    with pytest.raises(StrideTwinError, match="kinematic"):
        Twin(replace(QUIET, physics="magnetic"), 1)


def test_no_joint_of_the_frame_jumps_and_cuffs_push_both_ways() -> None:
    twin = Twin(replace(QUIET, route=Route(segments=(Level(length_m=6.0),))), 2)
    t_ns = np.arange(0, int(twin.duration_s * 1e9), 5_000_000)
    motion = Playback(twin.model, twin.reference).motion(t_ns)
    for name, speed in motion.speed.items():
        assert np.abs(speed).max() < 25.0, name  # rad/s
    for place, force in motion.cuff_force.items():
        assert force.min() < 0.0 < force.max(), place
        assert np.abs(force).max() < 120.0, place


def test_no_footprint_falls_between_two_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = Twin(replace(QUIET, sensors=("foot_imu",)), 0)
    steps = [s for own in twin.walk.steps.values() for s in own if s.t_touch <= twin.duration_s]
    touch = min(s.t_touch for s in steps if np.isfinite(s.t_touch))
    assert touch % 0.005 < 0.0049  # no instant of the truth follows before the chunk ends
    monkeypatch.setattr("stridetwin.sim.twin.CHUNK_S", touch + 1e-4)
    printed = [item for chunk in twin.blocks() for item in chunk if isinstance(item, Footprint)]
    assert len(printed) == len(steps)
