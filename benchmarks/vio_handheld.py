"""Visual-inertial odometry of a camera that is carried by hand through a furnished room, as with a phone.

`python -m benchmarks.vio_handheld [--seeds FIRST COUNT] [--seconds 60] [--rigs NAME ...] [--folder DIR] [--json]`. The
twin's camera with its IMU leaves the head: it moves up and down a small room and turns to all sides, at up to 3 rad/s,
with the tremor of a hand, in motion from the first sample on. Rolling shutter of 16 ms that no calibration knows, axes
of the IMU as in a phone, and an IMU of 100 Hz. The rigs differ in what is wrong: `late` has the camera 56 ms late and
forces 2.8 % too large. Figures per recording: path of the camera, error at the end with the start aligned, largest one,
reported standard deviation at the end, NEES, share of the time within the 95 % bound, and shares by health.
"""

from __future__ import annotations

import math
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from benchmarks.command import answer, command
from benchmarks.furniture import furnish_rooms
from benchmarks.vio_errors import scale_forces
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.outputs.path.scores import compare, score
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.gait.reference import Reference, plan_reference
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.algebra.arrays import from_euler, from_quaternion, to_quaternion
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Depth, Image, Imu, Sample
from stridetwin.streams.trajectory import trajectory_of
from stridetwin.studies.zhao2023.odometry_walks import odometry_samples, true_path

FIGURES = (
    "way_m",
    "end_error_m",
    "largest_error_m",
    "end_sd_m",
    "nees_position_mean",
    "nees_position_within_95_pct",
    "first_s",
    "offset_ms",
    "health",
)
COLOR, DEPTH, IMU = "/head/color", "/head/depth", "/head/imu"
PHONE_AXES = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""IMU of the twin <- IMU as in a phone that is held upright: both look along z, turned by a quarter about it."""
_DEGREE = 5  # of the splines
_GRID_S = 0.01  # of the root's coordinates
_ROOM_MARGIN_M, _LENGTH_M, _WIDTH_M = 1.3, 2.0, 1.0  # a room of 4.6 m by 3.6 m
_FIRST_ROOM = 200_000  # seed of the furniture of recording 0
# Control points of the motion: time between them (s), and their spread, uniform in position (m), Gaussian in angle.
_PLACE_S, _TURN_S, _NOD_S = 1.1, 0.6, 0.5
_ALONG_M, _ASIDE_M, _HEIGHT_M = (-0.4, 2.4), (-1.1, 1.1), (0.9, 1.8)
_TURN_SD_RAD = 1.0  # of the heading, from one to the next
_NOD_RAD, _ROLL_SD_RAD = (-0.4, 0.9), 0.3
# Tremor: frequencies, Hz, and amplitudes of position (m) and attitude (rad).
_TREMOR_HZ, _TREMOR_M, _TREMOR_RAD = (4.0, 7.0, 9.0), 1e-4, 1e-3


@dataclass(frozen=True, kw_only=True)
class HandRig:
    """What is wrong with a rig, and whether it has depth.

    Attributes:
        clock_s: By how much the camera's stamps are late.
        force: Factor on the forces.
        depth: Whether it has depth images.
        knows_readout: Whether the calibration has the readout time of the rolling shutter.
    """

    clock_s: float = 0.0
    force: float = 1.0
    depth: bool = False
    knows_readout: bool = False


RIGS = {
    "sound": HandRig(),
    "clock": HandRig(clock_s=0.056),
    "force": HandRig(force=1.028),
    "late": HandRig(clock_s=0.056, force=1.028),
    "sound_depth": HandRig(depth=True),
    "late_depth": HandRig(clock_s=0.056, force=1.028, depth=True),
    "sound_readout": HandRig(knows_readout=True),
    "late_readout": HandRig(clock_s=0.056, force=1.028, knows_readout=True),
}


def draw_spline(rng: np.random.Generator, points: Array, step_s: float) -> BSpline:
    """A spline from t = 0 on whose control points (N, K) are a time apart; it stays in their convex hull."""
    knots = (np.arange(len(points) + _DEGREE + 1) - _DEGREE - rng.uniform()) * step_s
    return BSpline(knots, points, _DEGREE)


def draw_motion(rng: np.random.Generator, t: Array, end_s: float) -> tuple[Array, Array]:
    """Position (N, 3), m, and yaw, pitch and roll (N, 3), rad, of a camera in a hand, at (N,) s."""

    def count(step_s: float) -> int:
        return math.ceil(end_s / step_s) + _DEGREE + 2

    n = count(_PLACE_S)
    places = np.column_stack([rng.uniform(*limits, n) for limits in (_ALONG_M, _ASIDE_M, _HEIGHT_M)])
    turns = np.cumsum(_TURN_SD_RAD * rng.standard_normal((count(_TURN_S), 1)), axis=0)
    nods = np.column_stack([rng.uniform(*_NOD_RAD, count(_NOD_S)), _ROLL_SD_RAD * rng.standard_normal(count(_NOD_S))])
    p = draw_spline(rng, places, _PLACE_S)(t)
    angles = np.hstack([draw_spline(rng, turns, _TURN_S)(t), draw_spline(rng, nods, _NOD_S)(t)])
    for hz in _TREMOR_HZ:
        phase = rng.uniform(0, 2 * np.pi, 6)
        wave = np.sin(2 * np.pi * hz * t[:, None] + phase)
        p, angles = p + _TREMOR_M * wave[:, :3], angles + _TREMOR_RAD * wave[:, 3:]
    return p, angles


def plan_hand(seconds: float) -> Callable[..., Reference]:
    """A planner of the twin that carries the camera by hand: the person is stiff, and hangs on it as its root."""

    def plan(
        config: TwinConfig, model: mujoco.MjModel, size: Wearer, terrain: Terrain, rng: np.random.Generator
    ) -> Reference:
        walk = plan_reference(config, model, size, terrain, rng)
        data = mujoco.MjData(model)
        layout = walk.coordinates
        upright = np.zeros((1, len(layout.names)))
        data.qpos = layout.to_mujoco(upright, upright, upright)[0][0]
        mujoco.mj_kinematics(model, data)
        lever = data.body("head").xpos + [0.10, 0.0, 0.12]
        t = np.arange(-0.5, seconds + 0.5, _GRID_S)
        p, angles = draw_motion(rng, np.clip(t, 0.0, seconds), seconds)
        x = np.zeros((len(t), len(layout.names)))
        x[:, :3], x[:, 3:6] = p - from_euler(angles) @ lever, angles
        loads = walk.loads(np.clip(t, 0.0, walk.duration_s))
        return replace(
            walk,
            duration_s=seconds,
            splines=make_interp_spline(t, x, k=_DEGREE),
            loads=make_interp_spline(t, loads, k=3),
        )

    return plan


def make_config(seed: int, texture: str = "rich") -> TwinConfig:
    """The room and the rig, level, with furniture drawn from the seed."""
    route = Route(segments=(Level(length_m=_LENGTH_M),), width_m=_WIDTH_M, scenery="room", texture=texture)
    fittings = {
        "head_camera": SensorConfig(part=load_part("D435"), pitch_down_rad=0.0),
        "head_imu": SensorConfig(part=load_part("BMI055"), rate_hz=100.0),
    }
    return replace(
        load_scenario("level_20m").config,
        name=f"handheld_{seed}",
        sensors=("head_imu", "head_camera"),
        physics="kinematic",
        exo=None,
        route=route,
        gait=Gait(stand_s=0.5, speed_mps=0.8),
        fittings=fittings,
    )


def record_hand(seed: int, seconds: float, folder: Path, texture: str = "rich") -> Path:
    """The recording of a seed, which is generated if the folder lacks it."""
    path = folder / f"handheld_{texture}_{seed}_{seconds:.0f}.mcap"
    if not path.exists():
        with furnish_rooms(_FIRST_ROOM + seed, _ROOM_MARGIN_M):
            record(Twin(make_config(seed, texture), seed, plan=plan_hand(seconds)), path)
    return path


def hand_rig(rig: Rig, kind: HandRig) -> Rig:
    """The calibration that an estimator gets: the IMU's axes as in a phone, and what the rig does not know."""
    camera, imu = rig.cameras[COLOR], rig.imu(IMU)
    turned = np.eye(4)
    turned[:3, :3] = PHONE_AXES
    camera = replace(
        camera,
        depth_topic=camera.depth_topic if kind.depth else "",
        readout_s=camera.readout_s if kind.knows_readout else 0.0,
    )
    imu = replace(imu, mount=replace(imu.mount, T_body_sensor=imu.mount.T_body_sensor @ turned))
    return replace(rig, cameras={COLOR: camera}, imus={IMU: imu})


def hand_samples(samples: Iterator[Sample], kind: HandRig) -> Iterator[Sample]:
    """The samples with late images, in order of arrival, and with the IMU's axes as in a phone."""
    for sample in scale_forces(samples, kind.force):
        if isinstance(sample, Imu):
            rate, force = sample.angular_rate @ PHONE_AXES, sample.specific_force @ PHONE_AXES
            yield replace(sample, angular_rate=rate, specific_force=force)
        elif isinstance(sample, Image) or kind.depth:
            assert isinstance(sample, Image | Depth)
            yield replace(sample, t_ns=sample.t_ns + round(kind.clock_s * 1e9))


def follow(recording: Recording, kind: HandRig) -> dict[str, Any]:
    """Figures of the odometry of a recording with a rig."""
    odometry = Dvio(hand_rig(recording.rig, kind), options=Options(mount="head"))
    estimates = [
        estimate
        for sample in hand_samples(odometry_samples(recording, "head"), kind)
        if (estimate := odometry.update(sample)) is not None
    ]
    if not estimates:
        return {"health": {"never started": 1.0}}
    truth = turn_truth(true_path(recording, "head"))
    compared = compare(trajectory_of([estimate.pose for estimate in estimates]), truth)
    scores = score(compared)
    errors_m = np.linalg.norm(compared.estimate.p_frame_in_world - compared.truth.p_frame_in_world, axis=1)
    health = np.array([estimate.health for estimate in estimates])
    covariance = estimates[-1].covariance[:3, :3]
    return {
        "way_m": float(np.linalg.norm(np.diff(truth.p_frame_in_world, axis=0), axis=1).sum()),
        "end_error_m": float(errors_m[-1]),
        "largest_error_m": float(errors_m.max()),
        "end_sd_m": float(np.sqrt(np.trace(covariance))),
        "nees_position_mean": float(scores["nees_position_mean"]),
        "nees_position_within_95_pct": float(scores["nees_position_within_95_pct"]),
        "first_s": float(estimates[0].t_ns) * 1e-9,
        "offset_ms": 1e3 * odometry.time_offset_s,
        "health": {name: round(float(np.mean(health == name)), 3) for name in np.unique(health).tolist()},
    }


def turn_truth(truth: TruePath) -> TruePath:
    """The true path of the IMU with axes as in a phone."""
    R = from_quaternion(truth.q_world_frame) @ PHONE_AXES
    return replace(truth, q_world_frame=to_quaternion(R))


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures of every seed with every rig."""
    first, count = arguments.seeds
    cases: dict[str, list[dict[str, Any]]] = {name: [] for name in arguments.rigs}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(arguments.folder or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for seed in range(first, first + count):
            recording = Recording(record_hand(seed, arguments.seconds, folder, arguments.texture))
            for name, rows in cases.items():
                rows.append({"seed": seed, **follow(recording, RIGS[name])})
                if not arguments.json:
                    print(name, rows[-1], flush=True)
    return {"benchmark": "vio_handheld", "seconds": arguments.seconds, "cases": cases}


def show(result: dict[str, Any]) -> None:
    """Prints one line per recording and rig."""
    names = [name for name in FIGURES if name != "health"]
    print(f"{'rig':<14}{'seed':>6}" + "".join(f"{name:>20.20}" for name in names) + "  health")
    for rig, rows in result["cases"].items():
        for row in rows:
            cells = "".join(f"{row[name]:>20.3f}" if name in row else f"{'-':>20}" for name in names)
            print(f"{rig:<14}{row['seed']:>6}{cells}  {row['health']}")


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=[1000, 1], metavar=("FIRST", "COUNT"))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--texture", default="rich", choices=("rich", "plain", "white"))
    parser.add_argument("--rigs", nargs="+", choices=list(RIGS), default=list(RIGS))
    parser.add_argument("--folder", help="keep the recordings here")
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
