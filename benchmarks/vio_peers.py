"""Visual-inertial odometry beside OpenCV's RGB-D odometry and ORB-SLAM3, on the same walks of the twin.

`python -m benchmarks.vio_peers [RECORDING ...] [--walks NAME ...] [--seed N] [--json]`. Peers are installed into an
environment of their own (`--environment`), run as separate programs, and read the walk as an RGB-D folder with IMU;
ORB-SLAM3 (GPL) gets a vocabulary learnt from other walks of the twin, and the IMU's noise times `--imu-noise`, as its
authors advise. An unavailable peer is listed with the reason.
Every path is aligned with the truth at its first valid pose, including tilt, which favours peers without an IMU. Errors
are those of `outputs.path.scores`. ORB-SLAM3 closes loops, unlike an odometry: its pose counts as estimated when the
frame arrives.
"""

from __future__ import annotations

import subprocess
import sys
import venv
from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.command import answer, command
from benchmarks.peers.vocabulary import write_vocabulary
from stridetwin.outputs.path.scores import OdometryPath, drift_figures
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion, to_quaternion
from stridetwin.streams.formats.tum import parse_seconds
from stridetwin.streams.formats.tum_rgbd import write_tum_rgbd
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Image
from stridetwin.streams.trajectory import Trajectory
from stridetwin.studies.zhao2023.odometry_walks import (
    make_odometer,
    odometry_samples,
    run_odometry,
    score_odometry,
    time_statistics,
    true_path,
)

WALKS = ("dvio_walk", "dvio_stairs", "dvio_white")
VOCABULARY_WALKS, VOCABULARY_SEED, VOCABULARY_EVERY = ("stroll", "room"), 900, 15
PEERS = {
    "opencv_rgbd": ("opencv-contrib-python-headless<5", "opencv_rgbd.py", ()),
    "orbslam3_rgbd": ("pyorbslam3", "orbslam3.py", ("rgbd",)),
    "orbslam3_inertial": ("pyorbslam3", "orbslam3.py", ("inertial",)),
}
"""By name: what is installed, what is run, and its last arguments."""
FIGURES = ("ape_rmse_m", "rpe_5m_pct", "loop_drift_m")
IMU_NOISE = 10.0
"""A data sheet gives the noise at rest. Of 1, 3, 10 and 30 it has the smallest mean error on `WALKS` of seed 0."""
LIMIT_S = 900
_PROGRAMS = Path(__file__).parent / "peers"


@dataclass(frozen=True, kw_only=True)
class Environment:
    """A Python environment for the peers.

    Attributes:
        folder: Its folder.
        missing: Why a package is unavailable, by its name.
    """

    folder: Path
    missing: Mapping[str, str]

    @classmethod
    def made(cls, folder: Path) -> Environment:
        """The environment in a folder; missing packages are installed."""
        python = folder / "bin" / "python"
        if not python.exists():
            venv.create(folder, with_pip=True)
        missing = {}
        for package in sorted({package for package, _, _ in PEERS.values()} | {"opencv-contrib-python-headless<5"}):
            pip = subprocess.run(
                [python, "-m", "pip", "install", "-q", package], capture_output=True, text=True, check=False
            )
            if pip.returncode:
                missing[package] = (pip.stderr.strip().splitlines() or ["pip failed"])[-1]
        return cls(folder=folder, missing=missing)

    def run(self, program: str, *arguments: object) -> str:
        """Runs a peer; returns the error, or an empty text."""
        line = [str(self.folder / "bin" / "python"), str(_PROGRAMS / program), *map(str, arguments)]
        try:
            done = subprocess.run(line, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            return f"took longer than {LIMIT_S} s"
        if done.returncode < 0:
            return f"crashed with signal {-done.returncode}"
        return "" if not done.returncode else (done.stderr.strip().splitlines() or ["no word of why"])[-1]


def peer_figures(recording: Recording, mount: str, out: Path) -> dict[str, Any]:
    """Figures of the poses that a peer wrote (`peers.folder.row`)."""
    rows = [line.split() for line in out.read_text().splitlines()]
    if not rows:
        return {"failure": "silent"}
    t_ns = np.array([parse_seconds(w[0]) for w in rows], np.int64)
    sure = np.array([w[1] == "1" for w in rows])
    T_world_camera = np.tile(np.eye(4), (len(rows), 1, 1))
    T_world_camera[:, :3] = np.array([w[3:] for w in rows], float).reshape(-1, 3, 4)
    rig, truth = recording.rig, true_path(recording, mount)
    camera, imu = rig.cameras[f"/{mount}/color"], rig.imu(f"/{mount}/imu")
    t_ns = t_ns + round(1e9 * camera.timeshift_cam_imu_s)
    inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
    t_ns, sure, T_world_camera = t_ns[inside], sure[inside], T_world_camera[inside]
    first = int(sure.argmax())
    T_camera_imu = np.linalg.inv(camera.mount.T_body_sensor) @ imu.mount.T_body_sensor
    start = truth.at(t_ns[first : first + 1])
    T_start = np.eye(4)
    T_start[:3, :3] = from_quaternion(start.q_world_frame[0])
    T_start[:3, 3] = start.p_frame_in_world[0]
    T = T_start @ np.linalg.inv(T_world_camera[first] @ T_camera_imu) @ T_world_camera @ T_camera_imu
    path = Trajectory(t_ns=t_ns, p_frame_in_world=T[:, :3, 3], q_world_frame=to_quaternion(T[:, :3, :3]))
    return drift_figures(OdometryPath(path=path, healthy=sure), truth) | {
        "time_ms": time_statistics(np.array([w[2] for w in rows], float))
    }


def settings(camera: CameraCalibration, imu: ImuCalibration, imu_noise: float) -> str:
    """ORB-SLAM3's settings of a camera with IMU, in its version 1.0; features as in its own file for the D435i.

    Args:
        camera: With depth.
        imu: Of the same device.
        imu_noise: Factor on the noise and the random walks of the data sheet.
    """
    T = (np.linalg.inv(imu.mount.T_body_sensor) @ camera.mount.T_body_sensor).ravel()
    fu, fv, pu, pv = camera.intrinsics
    viewer = {
        "KeyFrameSize": 0.05,
        "KeyFrameLineWidth": 1.0,
        "GraphLineWidth": 0.9,
        "PointSize": 2.0,
        "CameraSize": 0.08,
        "CameraLineWidth": 3.0,
        "ViewpointX": 0.0,
        "ViewpointY": -0.7,
        "ViewpointZ": -3.5,
        "ViewpointF": 500.0,
    }
    values: dict[str, Any] = {
        "File.version": '"1.0"',
        "Camera.type": '"PinHole"',
        "Camera1.fx": fu,
        "Camera1.fy": fv,
        "Camera1.cx": pu,
        "Camera1.cy": pv,
        "Camera.width": camera.width,
        "Camera.height": camera.height,
        "Camera.fps": round(camera.rate_hz),
        "Camera.RGB": 1,
        "Stereo.ThDepth": 60.0,
        "Stereo.b": 0.095,
        "RGBD.DepthMapFactor": 1.0,
        "IMU.InsertKFsWhenLost": 0,
        "IMU.Frequency": imu.rate_hz,
        "IMU.NoiseGyro": imu_noise * imu.gyroscope_noise_density,
        "IMU.NoiseAcc": imu_noise * imu.accelerometer_noise_density,
        "IMU.GyroWalk": imu_noise * imu.gyroscope_random_walk,
        "IMU.AccWalk": imu_noise * imu.accelerometer_random_walk,
        "ORBextractor.nFeatures": 1250,
        "ORBextractor.scaleFactor": 1.2,
        "ORBextractor.nLevels": 8,
        "ORBextractor.iniThFAST": 20,
        "ORBextractor.minThFAST": 7,
        **{f"Viewer.{name}": value for name, value in viewer.items()},
    }
    matrix = f"IMU.T_b_c1: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n  data: [{', '.join(f'{v:.9f}' for v in T)}]"
    return "\n".join(["%YAML:1.0", *(f"{name}: {value}" for name, value in values.items()), matrix, ""])


def vocabulary_images() -> Iterator[NDArray[np.uint8]]:
    """Sample images from other walks of the twin."""
    for name in VOCABULARY_WALKS:
        config = replace(load_scenario(name).config, sensors=("head_imu", "head_camera"), physics="kinematic")
        fitting = replace(config.fittings.get("head_camera") or SensorConfig(), rate_hz=30 / VOCABULARY_EVERY)
        twin = Twin(replace(config, fittings={"head_camera": fitting}), VOCABULARY_SEED)
        for chunk in twin.blocks():
            yield from (cv2.cvtColor(item.pixels, cv2.COLOR_RGB2GRAY) for item in chunk if isinstance(item, Image))


def one_walk(
    recording: Recording, environment: Environment, vocabulary: Path, methods: list[str], imu_noise: float
) -> dict[str, Any]:
    """Figures by method; `error` for a peer that could not be run."""
    mount = "head" if "/head/color" in recording.topics else "chest"
    figures_by_method: dict[str, Any] = {}
    if "proposed" in methods:
        ride = run_odometry(make_odometer("proposed", recording.rig, mount), odometry_samples(recording, mount))
        figures_by_method["proposed"] = score_odometry(ride, true_path(recording, mount))
    with TemporaryDirectory() as temporary:
        folder, file = Path(temporary) / "walk", Path(temporary) / "settings.yaml"
        folder.mkdir()
        write_tum_rgbd(recording, folder)
        camera, imu = recording.rig.cameras[f"/{mount}/color"], recording.rig.imu(f"/{mount}/imu")
        file.write_text(settings(camera, imu, imu_noise))
        for name in (m for m in methods if m in PEERS):
            package, program, last = PEERS[name]
            out = Path(temporary) / f"{name}.txt"
            arguments = (vocabulary, file, *last) if last else ()
            error = environment.missing.get(package) or environment.run(program, folder, out, *arguments)
            figures_by_method[name] = {"error": error} if error else peer_figures(recording, mount, out)
    return figures_by_method


def measure(arguments: Namespace) -> dict[str, Any]:
    """Every method on every walk."""
    environment = Environment.made(arguments.environment)
    vocabulary = arguments.environment / "vocabulary.txt"
    if not vocabulary.exists() and any(m.startswith("orbslam3") for m in arguments.methods):
        write_vocabulary(vocabulary_images(), vocabulary, np.random.default_rng(0))
    last = environment, vocabulary, arguments.methods, arguments.imu_noise
    cases: dict[str, Any] = {path.stem: one_walk(Recording(path), *last) for path in arguments.recordings}
    for name in () if arguments.recordings else arguments.walks:
        with TemporaryDirectory() as temporary:
            path = Path(temporary) / "walk.mcap"
            config = replace(load_scenario(name).config, sensors=("head_imu", "head_camera"))
            record(Twin(config, arguments.seed), path, lambda stage, share: None)
            cases[name] = one_walk(Recording(path), *last)
    return {"benchmark": "vio_peers", "summary": {m: summary(cases, m) for m in arguments.methods}, "cases": cases}


def summary(cases: Mapping[str, Any], method: str) -> dict[str, Any]:
    """Figures of a method by walk, its number of failures, and why it was not run."""
    of = {walk: figures_by_method[method] for walk, figures_by_method in cases.items()}
    times = [w["time_ms"] for w in of.values() if "time_ms" in w]
    return {
        **{figure: {walk: w.get(figure) for walk, w in of.items()} for figure in FIGURES},
        "failures": {walk: w.get("failure", "not run") for walk, w in of.items()},
        "time_ms": {k: float(np.mean([t[k] for t in times])) for k in ("mean", "p99")} if times else None,
        "error": next((w["error"] for w in of.values() if "error" in w), ""),
    }


def show(result: dict[str, Any]) -> None:
    """Prints one line per method and walk."""
    print(f"{'':<20}{'':<28}{'APE m':>8}{'over 5 m %':>12}{'end m':>8}  {'failure':<12}{'ms a frame, p99':>18}")
    for method in result["summary"]:
        for walk, figures_by_method in result["cases"].items():
            method_figures = figures_by_method[method]
            if "error" in method_figures:
                print(f"{method:<20}{walk:<28}could not be run: {method_figures['error']}")
                continue
            cells = [method_figures.get(name) for name in FIGURES]
            texts = ["-" if value is None else f"{value:.3f}" for value in cells]
            ms = method_figures.get("time_ms", {"mean": 0.0, "p99": 0.0})
            print(
                f"{method:<20}{walk:<28}{texts[0]:>8}{texts[1]:>12}{texts[2]:>8}  {method_figures['failure']:<12}"
                f"{ms['mean']:>10.1f}{ms['p99']:>8.1f}"
            )


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("recordings", nargs="*", type=Path, help="walks with a camera with depth; default: --walks")
    parser.add_argument("--walks", nargs="+", default=list(WALKS), help="scenarios that are walked")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--imu-noise", type=float, default=IMU_NOISE, help="factor on the IMU's noise, ORB-SLAM3 only")
    parser.add_argument("--methods", nargs="+", choices=["proposed", *PEERS], default=["proposed", *PEERS])
    parser.add_argument(
        "--environment", type=Path, default=Path("runs/vio_peers"), help="where the peers are installed"
    )
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
