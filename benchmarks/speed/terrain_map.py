"""Speed and memory of terrain map, planes and mode prediction, with given poses and with those of the odometry."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.memory import LIMIT_MIB, resident_mib
from benchmarks.speed.timing import Replay, Stopwatch, Summary, recorded
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.locomotion_mode import INSOLES, LocomotionMode
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.chosen_poses import find_pose_topic
from stridetwin.outputs.pose_feed import pose_sample
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import TwinConfig
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Depth, Image, Imu, Odometry, Sample

POSES = ("given", "dvio")
GAP_NS = 1_000_000_000
SENSORS = ("insole", "head_imu", "head_camera")
BUILDING = "shim_building"
MEMORY_PERIOD = 15  # depth images from one reading of the memory to the next


def terrain_map(walks: int, seed: int, scenario: str, mount: str, minutes: float) -> Summary:
    """Map, planes and prediction per depth image, without decoding, on a kinematic walk that is replayed.

    Times are those of `LocomotionMode.update`, which feeds the map, from one depth image to the next: CPU time, and
    wall-clock time as `wall_`. `odometry_ms_mean` is the CPU time of the odometry. The first repetition compiles and
    is left out; map and odometry start anew with each. `--minutes` adds the resident memory on a long way through a
    building in which all the ground is new: after a tenth of it, at its end, and its largest.
    """
    summary = {}
    with recorded(_config(scenario, mount), seed) as walk:
        for poses in POSES:
            summary[f"{scenario}, {mount}, poses {poses}"] = _figures(walk, mount, poses, max(2, walks))
    if minutes > 0:
        with recorded(_config(BUILDING, mount), seed) as walk:
            summary[f"{BUILDING}, {mount}, memory"] = _memory_figures(walk, mount, minutes)
    return summary


def _config(scenario: str, mount: str) -> TwinConfig:
    return replace(load_scenario(scenario).config, sensors=SENSORS, rig_mount=mount, physics="kinematic")


class _Chain:
    """Map, prediction and odometry on one walk, and the time of each since the last reset.

    Args:
        walk: Provides the rig and the frame of the given poses.
        mount: Where the camera sits.
        poses: Of `POSES`.
    """

    def __init__(self, walk: Recording, mount: str, poses: str) -> None:
        camera = depth_calibration(walk.rig)
        topic, frame = find_pose_topic(walk, camera)
        self._rig, self._mount, self._poses = walk.rig, mount, poses
        self._terrain = LocomotionMode(walk.rig, options=Options(poses_of=frame))
        moving = [topic] if poses == "given" else [f"/{mount}/imu", camera.topic]
        self.topics = [*moving, *INSOLES, camera.depth_topic]
        self.terrain_time, self.odometry_time = Stopwatch(), Stopwatch()
        self.start_walk()

    def start_walk(self) -> None:
        """Starts a repetition of the walk, with a new odometry."""
        self._odometry = Dvio(self._rig, options=Options(mount=self._mount)) if self._poses == "dvio" else None

    def read_times_ms(self) -> Array:
        """(4,) CPU and wall-clock time of terrain, then of odometry, since the last reading, ms."""
        read = 1e3 * np.concatenate([self.terrain_time.seconds, self.odometry_time.seconds])
        self.terrain_time.reset()
        self.odometry_time.reset()
        return read

    def update(self, sample: Sample) -> None:
        """Processes a sample; samples come in time order."""
        inputs = [sample]
        odometry = self._odometry
        if odometry is not None and isinstance(sample, Imu | Image | Depth):
            estimate = self.odometry_time.time(lambda: odometry.update(sample))
            inputs = [sample] if isinstance(sample, Depth) else []
            if estimate is not None and estimate.pose.valid:
                pose = estimate.pose
                inputs.insert(0, pose_sample(pose.t_ns, pose.p_frame_in_world, pose.q_world_frame))
        self.terrain_time.time(lambda: [self._terrain.update(s) for s in inputs])


def _replay(walk: Recording, topics: list[str], repetitions: int) -> Replay:
    return Replay(
        read=lambda: walk.samples(topics), repetitions=repetitions, span_ns=round(walk.duration * 1e9) + GAP_NS
    )


def _figures(walk: Recording, mount: str, poses: str, repetitions: int) -> dict[str, float]:
    chain, last = _Chain(walk, mount, poses), 0
    replay, rows = _replay(walk, chain.topics, repetitions), list[Array]()
    for repetition, sample in replay:
        if repetition != last:
            chain.start_walk()
            last = repetition
        chain.update(sample)
        if isinstance(sample, Depth):
            times_ms = chain.read_times_ms()
            if repetition > 0:
                rows.append(times_ms)
    ms = np.array(rows)
    figures = {
        "ms_mean": float(ms[:, 0].mean()),
        "ms_p95": float(np.percentile(ms[:, 0], 95)),
        "wall_ms_mean": float(ms[:, 1].mean()),
        "wall_ms_p95": float(np.percentile(ms[:, 1], 95)),
    }
    if poses == "dvio":
        both = ms[:, 0] + ms[:, 2]
        figures |= {
            "odometry_ms_mean": float(ms[:, 2].mean()),
            "with_odometry_ms_mean": float(both.mean()),
            "with_odometry_ms_p95": float(np.percentile(both, 95)),
        }
    return figures | {"frames": len(ms), "memory_growth_mib": replay.memory_growth_mib}


def _memory_figures(walk: Recording, mount: str, minutes: float) -> dict[str, float]:
    chain, span_s = _Chain(walk, mount, "given"), walk.duration + GAP_NS * 1e-9
    repetitions = max(2, round(60 * minutes / span_s))
    sizes: list[float] = []
    frames = 0
    for sample in _onward(_replay(walk, chain.topics, repetitions)):
        chain.update(sample)
        if isinstance(sample, Depth):
            frames += 1
            if frames % MEMORY_PERIOD == 0:
                sizes.append(resident_mib(os.getpid()))
    tenth = max(1, len(sizes) // 10)
    return {
        "minutes": repetitions * span_s / 60,
        "frames": frames,
        "first_mib": max(sizes[:tenth]),
        "last_mib": max(sizes[-tenth:]),
        "largest_mib": max(sizes),
        "limit_mib": LIMIT_MIB,
    }


def _onward(replay: Replay) -> Iterator[Sample]:
    """The replayed walk; each repetition starts at the pose at which the one before ended."""
    first: Odometry | None = None
    last: Odometry | None = None
    translation, R, current = np.zeros(3), Rotation.identity(), -1
    for repetition, sample in replay:
        if isinstance(sample, Odometry):
            if repetition != current:
                current, first = repetition, first or sample
                if last is not None:
                    R = Rotation.from_rotvec([0.0, 0.0, _yaw(last) - _yaw(first)])
                    translation = last.p_frame_in_world - R.apply(first.p_frame_in_world)
            last = sample = replace(
                sample,
                p_frame_in_world=translation + R.apply(sample.p_frame_in_world),
                q_world_frame=(R * _rotation(sample)).as_quat(scalar_first=True),
                v_frame_in_world=R.apply(sample.v_frame_in_world),
            )
        yield sample


def _rotation(pose: Odometry) -> Rotation:
    return Rotation.from_quat(pose.q_world_frame, scalar_first=True)


def _yaw(pose: Odometry) -> float:
    return float(_rotation(pose).as_euler("ZYX")[0])
