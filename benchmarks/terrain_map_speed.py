"""How long map, planes and prediction take for a depth picture, and whether their memory stays.

`python -m benchmarks.terrain_map_speed [--json] [--walks 2] [--seed 900] [--scenario zhao_stair_20cm] [--mount head]`.
A kinematic walk, told so many times, each time later; where it begins again the poses jump, the map begins anew, and
so does the odometry. Time is that of `LocomotionMode.update`, which feeds the map, from depth picture to depth picture,
poses and insoles included: once with the poses that came with the walk, once with those of the odometry, and then that
odometry's own time besides (`odometry_ms`). Milliseconds as the processor has them, those as a clock has them beside.
Decoding is left out, and so is the first walk, in which everything is compiled. Memory is the growth of the process's
peak from its end to that of the last.

With `--minutes 10`, also memory alone: so long on a way through a building (`shim_building`), each time on from where
it ended, so that all the ground is new; resident MiB after a tenth of it, at its end, and at the most.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.command import answer, command, show_summary
from benchmarks.foot_ins_speed import peak_mib
from benchmarks.memory import LIMIT_MIB, resident_mib
from benchmarks.repeated import again
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.locomotion_mode import INSOLES, LocomotionMode
from stridetwin.scenarios.experiments.odometry_walks import HEALTHY
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.scenarios.terrain_files import depth_camera, given_poses, pose_sample
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array, Depth, Image, Imu, Odometry, Sample

POSES = ("given", "dvio")
GAP_NS = 1_000_000_000
SENSORS = ("insole", "head_imu", "head_camera")
BUILDING = "shim_building"
LOOKED_AT = 15  # pictures from one look at the memory to the next


class Estimators:
    """Map, prediction and odometry on one walk, and the time of each since the last depth picture.

    Args:
        walk: Tells the rig and where the poses sit.
        mount: Where the camera sits.
        poses: Of `POSES`.
    """

    def __init__(self, walk: Recording, mount: str, poses: str) -> None:
        camera = depth_camera(walk.rig)
        topic, frame = given_poses(walk, camera)
        self._rig, self._mount, self._poses = walk.rig, mount, poses
        self._ground = LocomotionMode(walk.rig, options=Options(poses_of=frame))
        moving = [topic] if poses == "given" else [f"/{mount}/imu", camera.topic]
        self.topics = [*moving, *INSOLES, camera.depth_topic]
        self.spent: Array = np.zeros(4)  # ground by processor and clock, odometry by processor and clock
        self.begin()

    def begin(self) -> None:
        """A walk begins, and with it a new odometry."""
        self._odometry = Dvio(self._rig, options=Options(mount=self._mount)) if self._poses == "dvio" else None

    def update(self, sample: Sample) -> None:
        """Takes a sample in order of time."""
        taken = [sample]
        if self._odometry is not None and isinstance(sample, Imu | Image | Depth):
            start = _now()
            estimate = self._odometry.update(sample)
            self.spent[2:] += _now() - start
            taken = [sample] if isinstance(sample, Depth) else []
            if estimate is not None and estimate.health in HEALTHY:
                pose = estimate.pose
                taken.insert(0, pose_sample(pose.t_ns, pose.p_frame_in_world, pose.q_world_frame))
        start = _now()
        for one in taken:
            self._ground.update(one)
        self.spent[:2] += _now() - start


def _now() -> Array:
    return np.array([time.process_time(), time.perf_counter()])


def figures(walk: Recording, mount: str, poses: str, walks: int) -> dict[str, float]:
    """Times and growth of memory over so many walks one after the other."""
    estimators, before, last = Estimators(walk, mount, poses), 0.0, 0
    rows: list[Array] = []
    for turn, sample in again(lambda: walk.samples(estimators.topics), walks, round(walk.duration * 1e9) + GAP_NS):
        if turn != last:
            estimators.begin()
            before, last = before or peak_mib(), turn
        estimators.update(sample)
        if isinstance(sample, Depth):
            if turn > 0:
                rows.append(1e3 * estimators.spent)
            estimators.spent = np.zeros(4)
    ms = np.array(rows)
    found = {
        "ms_mean": float(ms[:, 0].mean()),
        "ms_p95": float(np.percentile(ms[:, 0], 95)),
        "clock_ms_mean": float(ms[:, 1].mean()),
        "clock_ms_p95": float(np.percentile(ms[:, 1], 95)),
    }
    if poses == "dvio":
        both = ms[:, 0] + ms[:, 2]
        found |= {
            "odometry_ms_mean": float(ms[:, 2].mean()),
            "with_odometry_ms_mean": float(both.mean()),
            "with_odometry_ms_p95": float(np.percentile(both, 95)),
        }
    return found | {"frames": len(ms), "memory_growth_mib": peak_mib() - before}


def building(walk: Recording, mount: str, minutes: float) -> dict[str, float]:
    """Resident memory, MiB, on a way that goes on and on over new ground."""
    estimators = Estimators(walk, mount, "given")
    turns = max(2, round(60 * minutes / (walk.duration + GAP_NS * 1e-9)))
    sizes: list[float] = []
    pictures = 0
    for sample in onward(walk, estimators.topics, turns):
        estimators.update(sample)
        if isinstance(sample, Depth):
            pictures += 1
            if pictures % LOOKED_AT == 0:
                sizes.append(resident_mib(os.getpid()))
    tenth = max(1, len(sizes) // 10)
    return {
        "minutes": turns * (walk.duration + GAP_NS * 1e-9) / 60,
        "frames": pictures,
        "first_mib": max(sizes[:tenth]),
        "last_mib": max(sizes[-tenth:]),
        "largest_mib": max(sizes),
        "limit_mib": LIMIT_MIB,
    }


def onward(walk: Recording, topics: list[str], turns: int) -> Iterator[Sample]:
    """A walk so many times, each later, and from where the one before ended."""
    first: Odometry | None = None
    last: Odometry | None = None
    moved, R, told = np.zeros(3), Rotation.identity(), -1
    for turn, sample in again(lambda: walk.samples(topics), turns, round(walk.duration * 1e9) + GAP_NS):
        if isinstance(sample, Odometry):
            if turn != told:
                told, first = turn, first or sample
                if last is not None:
                    R = Rotation.from_rotvec([0.0, 0.0, _yaw(last) - _yaw(first)])
                    moved = last.p_frame_in_world - R.apply(first.p_frame_in_world)
            last = sample = replace(
                sample,
                p_frame_in_world=moved + R.apply(sample.p_frame_in_world),
                q_world_frame=(R * _rotation(sample)).as_quat(scalar_first=True),
                v_frame_in_world=R.apply(sample.v_frame_in_world),
            )
        yield sample


def _rotation(pose: Odometry) -> Rotation:
    return Rotation.from_quat(pose.q_world_frame, scalar_first=True)


def _yaw(pose: Odometry) -> float:
    return float(_rotation(pose).as_euler("ZYX")[0])


def recorded(folder: str, scenario: str, seed: int, mount: str, sensors: tuple[str, ...]) -> Recording:
    """A kinematic walk of a scenario."""
    path = Path(folder) / f"{scenario}.mcap"
    config = replace(load_scenario(scenario).config, sensors=sensors, rig_mount=mount, physics="kinematic")
    record(Twin(config, seed), path, lambda stage, share: None)
    return Recording(path)


def measure(walks: int, seed: int, scenario: str, mount: str, minutes: float) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    summary = {}
    with TemporaryDirectory() as folder:
        walk = recorded(folder, scenario, seed, mount, SENSORS)
        for poses in POSES:
            summary[f"{scenario}, {mount}, poses {poses}"] = figures(walk, mount, poses, max(2, walks))
        if minutes > 0:
            walk = recorded(folder, BUILDING, seed, mount, SENSORS)
            summary[f"{BUILDING}, {mount}, memory"] = building(walk, mount, minutes)
    return {"experiment": "terrain_map_speed", "summary": summary}


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--walks", type=int, default=2, help="how often the walk is told, at least twice (2)")
    parser.add_argument("--seed", type=int, default=900, help="of the walk (900)")
    parser.add_argument("--scenario", default="zhao_stair_20cm", help="a walk over stairs or ramps (zhao_stair_20cm)")
    parser.add_argument("--mount", default="head", choices=("head", "chest"), help="where the camera sits (head)")
    parser.add_argument("--minutes", type=float, default=0.0, help="memory on so long a way through a building (none)")
    return answer(parser, lambda a: measure(a.walks, a.seed, a.scenario, a.mount, a.minutes), show_summary(24, "8.2f"))


if __name__ == "__main__":
    sys.exit(main())
