"""Good recordings of short generated walks, in plain arrays: a foot's IMU, or the head's IMU with its RGB-D camera.

Corruptions edit the arrays; `benchmarks.implausible.files` writes them in the formats of other tools.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.scenarios.record import make_twin, record
from stridetwin.sim.choices import part_files
from stridetwin.sim.config import Gait, Gaze, Level, Route, Stairs, Turn, TwinConfig
from stridetwin.sim.parts.kinds import ImuPart, Part, RgbdPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.nominal import CalibrationSd
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.people import Person
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Array, Depth, Image, Stamps

Intrinsics = tuple[float, float, float, float]
"""fu, fv, pu, pv, px."""
START_NS = 1_700_000_000 * 10**9
"""Added to the stamps of the twin, which begin at 0, so that they are those of a computer's clock."""
FEET, HEADS = 6, 3
"""Number of different walks with a foot's IMU, and with the head's camera."""
FOOT_PARTS = ("MPU-9250", "MTw-uncalibrated", "NGIMU-uncalibrated")
"""Parts of the good walks of a foot: those whose range a foot rarely exceeds, so that the estimates are good."""
_CAMERA_WIDTH = 320
"""Pixels of the rendered images; more take longer and change no report."""
_CALIBRATION = CalibrationSd(rotation_rad=0.0035, position_m=0.001, intrinsics=0.001, offset_s=0.001, depth_scale=0.005)
"""Errors of a careful calibration, as in the scenario `dvio_walk`: 0.2°, 1 mm, 0.1 %, 1 ms, 0.5 %."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Inertial:
    """Samples of an IMU.

    Attributes:
        t_ns: (N,) stamps of the rates.
        force_t_ns: (N,) stamps of the forces; equal to `t_ns` in a sound recording.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        count: (N,) number of each sample since the first one, as a counter of packets has it.
        q_world_imu: (N, 4) true attitude (w, x, y, z), by which gravity can be taken out; no file has it.
    """

    t_ns: Stamps
    force_t_ns: Stamps
    rate: Array
    force: Array
    count: NDArray[np.int64]
    q_world_imu: Array

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.t_ns)

    def __getitem__(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Inertial:
        """Some rows: (K,) their numbers, or (N,) whether each is kept."""
        return Inertial(
            t_ns=self.t_ns[rows],
            force_t_ns=self.force_t_ns[rows],
            rate=self.rate[rows],
            force=self.force[rows],
            count=self.count[rows],
            q_world_imu=self.q_world_imu[rows],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """Images of an RGB-D camera, depth registered to colour, and its calibration.

    Attributes:
        t_ns: (M,) stamps.
        colour: (M, H, W, 3) RGB.
        depth_m: (M, H, W), 0 without depth.
        intrinsics: fu, fv, pu, pv in pixels, as the calibration has them.
        T_imu_cam: (4, 4) pose of the optical frame in the IMU's frame, m, as the calibration has it.
        T_world_cam: (M, 4, 4) true poses, m.
    """

    t_ns: Stamps
    colour: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    intrinsics: Intrinsics
    T_imu_cam: Array
    T_world_cam: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """A recording in plain arrays.

    Attributes:
        imu: Samples of the foot's IMU, or of the head's beside the camera.
        noise: The IMU's calibration, of which files have the noise.
        views: Images of the head's camera; None for a foot.
        length_m: Way that was walked.
    """

    imu: Inertial
    noise: ImuCalibration
    views: Views | None
    length_m: float


def imu_parts() -> list[str]:
    """Names of the inertial parts of the library."""
    return [name for name in part_files() if isinstance(load_part(name), ImuPart)]


def camera_parts() -> list[str]:
    """Names of the RGB-D parts of the library."""
    return [name for name in part_files() if isinstance(load_part(name), RgbdPart)]


def small_camera(name: str) -> Part:
    """An RGB-D part with images of `_CAMERA_WIDTH` pixels and the same field of view, which are rendered faster."""
    part = load_part(name)
    assert isinstance(part, RgbdPart)
    scale = _CAMERA_WIDTH / part.imager.width
    imager = replace(
        part.imager,
        width=_CAMERA_WIDTH,
        height=round(part.imager.height * scale),
        focal=part.imager.focal * scale,
    )
    return replace(part, imager=imager)


def foot_config(number: int, seed: int) -> TwinConfig:
    """The walk number `number` of a foot's IMU alone, of ten seconds with a turn, and some with a stair."""
    rng = np.random.default_rng([seed, number, 3])
    middle = (Stairs(risers=4, down=bool(number % 4 == 3)), Level(length_m=1.5)) if number % 2 else ()
    angle = float(rng.choice([-1, 1]) * rng.uniform(0.7, 1.6))
    segments = (Level(length_m=3.0), *middle, Turn(angle_rad=angle, radius_m=1.0), Level(length_m=3.0))
    return TwinConfig(
        name=f"foot_{number}",
        route=Route(segments=segments),
        person=Person(height_m=float(rng.uniform(1.6, 1.85))),
        exo=None,
        gait=Gait(speed_mps=float(rng.uniform(0.9, 1.4)), stand_s=1.5),
        sensors=("foot_imu",),
        fittings={"foot_imu": SensorConfig(part=load_part(FOOT_PARTS[number % len(FOOT_PARTS)]))},
    )


def head_config(number: int) -> TwinConfig:
    """The walk number `number` of an RGB-D camera on the head, of eight seconds with a turn and a wandering gaze."""
    parts = ("D455", "D435i", "OAK-D")
    angle = (-1.0) ** number * 1.4
    middle = (Stairs(risers=3), Level(length_m=1.0)) if number % 2 else ()
    segments = (Level(length_m=2.0), *middle, Turn(angle_rad=angle, radius_m=1.2), Level(length_m=2.5))
    camera = SensorConfig(part=small_camera(parts[number % len(parts)]), calibration_sd=_CALIBRATION)
    return TwinConfig(
        name=f"head_{number}",
        route=Route(segments=segments, scenery="room"),
        exo=None,
        gait=Gait(speed_mps=1.1, stand_s=1.0, gaze=Gaze(kind="wandering")),
        sensors=("head_imu", "head_camera"),
        fittings={"head_camera": camera},
    )


def record_walk(config: TwinConfig, seed: int) -> Walk:
    """Generates a walk, and gives its first IMU, and the head's camera if it has one, as plain arrays."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(make_twin(config, seed), path)
        return take_walk(Recording(path))


def take_walk(recording: Recording, topic: str = "") -> Walk:
    """An IMU, and the RGB-D camera on its body if there is one, of one of our own recordings as plain arrays.

    Args:
        recording: With the truth.
        topic: Topic of the IMU; "" for the head's, or the left foot's if there is none.
    """
    topic = topic or next(t for t in ("/head/imu", "/chest/imu", "/foot_l/imu") if t in recording.topics)
    truth = recording.block(f"/truth{topic}/odometry")
    block, calibration = recording.block(topic), recording.rig.imu(topic)
    poses = _Poses(truth.t_ns, truth.columns["p_frame_in_world"], truth.columns["q_world_frame"])
    t_ns = block.t_ns + START_NS
    imu = Inertial(
        t_ns=t_ns,
        force_t_ns=t_ns,
        rate=block.columns["angular_rate"],
        force=block.columns["specific_force"],
        count=np.arange(len(t_ns)),
        q_world_imu=poses.at(block.t_ns)[1],
    )
    cameras = [c for c in recording.rig.cameras.values() if c.imu_topic == topic and c.depth_topic in recording.topics]
    views = _take_views(recording, cameras[0], poses) if cameras else None
    steps = np.diff(truth.columns["p_frame_in_world"][::20, :2], axis=0)  # coarse, so that noise is no way
    return Walk(imu=imu, noise=calibration, views=views, length_m=float(np.linalg.norm(steps, axis=1).sum()))


class _Poses:
    """True poses of a frame, interpolated."""

    def __init__(self, t_ns: Stamps, p: Array, q: Array) -> None:
        """Takes stamps (M,) ns, positions (M, 3) m and quaternions (M, 4), (w, x, y, z)."""
        self._t_ns, self._p, self._q = t_ns, p, q

    def at(self, t_ns: Stamps) -> tuple[Array, Array]:
        """Poses at stamps (K,) ns: interpolated positions (K, 3) m, and quaternions (K, 4) of the nearest pose."""
        p = np.column_stack([np.interp(t_ns, self._t_ns, self._p[:, k]) for k in range(3)])
        nearest = np.clip(np.searchsorted(self._t_ns, t_ns), 0, len(self._t_ns) - 1)
        return p, self._q[nearest]


def _take_views(recording: Recording, camera: CameraCalibration, poses: _Poses) -> Views:
    """All images of a camera that have depth of the same instant; `poses` are those of its IMU."""
    images: Mapping[int, Image] = {s.t_ns: s for s in recording.samples([camera.topic]) if isinstance(s, Image)}
    depths = {s.t_ns: s for s in recording.samples([camera.depth_topic]) if isinstance(s, Depth)}
    stamps = np.array(sorted(images.keys() & depths.keys()), np.int64)
    T_imu_cam = np.linalg.inv(recording.rig.imu(camera.imu_topic).mount.T_body_sensor) @ camera.mount.T_body_sensor
    p, q = poses.at(stamps)
    T_world_imu = np.tile(np.eye(4), (len(stamps), 1, 1))
    T_world_imu[:, :3, :3] = Rotation.from_quat(q, scalar_first=True).as_matrix()
    T_world_imu[:, :3, 3] = p
    pixels = [images[t].pixels for t in stamps.tolist()]
    return Views(
        t_ns=stamps + START_NS + round(camera.timeshift_cam_imu_s * 1e9),
        colour=np.stack([image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2) for image in pixels]),
        depth_m=np.stack([depths[t].depth for t in stamps.tolist()]).astype(np.float32),
        intrinsics=camera.intrinsics,
        T_imu_cam=T_imu_cam,
        T_world_cam=T_world_imu @ T_imu_cam,
    )


def build_walk(file: Path, seed: int) -> None:
    """Generates a good walk, and stores it in a file, which `load_walk` reads.

    Args:
        file: Its name tells the walk, as in `foot_3.pickle`.
        seed: Of the twin, and of a foot's way.
    """
    body, number = file.stem.split("_")
    config = foot_config(int(number), seed) if body == "foot" else head_config(int(number))
    file.write_bytes(pickle.dumps(record_walk(config, seed)))


@lru_cache(maxsize=2)  # images take much memory; jobs are sorted by their walks
def load_walk(file: Path) -> Walk:
    """A walk that `build_walk` has stored in the same run."""
    walk = pickle.loads(file.read_bytes())
    assert isinstance(walk, Walk)
    return walk
