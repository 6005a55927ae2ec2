"""The visual-inertial odometry over a whole recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import MOUNTS, Dvio
from stridetwin.estimators.dvio.estimate import LOST
from stridetwin.estimators.dvio.parameters import named
from stridetwin.estimators.dvio.stereo import Stereo, with_stereo
from stridetwin.scenarios.evaluate import Estimate
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array, Depth, Image, Imu, Sample
from stridetwin.streams.trajectory import Trajectory


class PoseEstimate(Protocol):
    """What an odometry tells at one instant.

    Attributes:
        t_ns: When.
        T_world_imu: (4, 4) pose of the IMU in a world of its own, z up.
        covariance: (6, 6) of position (m) and of rotation about the world's axes (rad).
    """

    @property
    def t_ns(self) -> int: ...  # noqa: D102
    @property
    def T_world_imu(self) -> Array: ...  # noqa: D102
    @property
    def covariance(self) -> Array: ...  # noqa: D102


def mount_of(recording: Recording) -> str:
    """Where the recording's RGB-D camera with IMU is worn.

    Raises:
        RecordingError: It has none.
    """
    if mounts := _mounts(recording):
        return mounts[0]
    wanted = " or ".join(f"/{m}/color and /{m}/imu" for m in MOUNTS)
    raise RecordingError(f"{recording.path}: feeds no dvio; valid: a recording with {wanted}")


def feeds_odometry(recording: Recording) -> bool:
    """Whether the recording has a camera with an IMU on head or chest, and depth or a second picture beside it."""
    return any(not {f"/{m}/depth", f"/{m}/color_right"}.isdisjoint(recording.topics) for m in _mounts(recording))


def _mounts(recording: Recording) -> list[str]:
    """Where the recording's cameras with IMU are worn."""
    return [m for m in MOUNTS if {f"/{m}/color", f"/{m}/imu"} <= set(recording.topics)]


def estimate_odometry(
    recording: Recording, method: str = "stridetwin", progress: Callable[[str, float], None] | None = None
) -> Estimate:
    """Path of the camera's IMU.

    Args:
        recording: Needs /head/color and /head/imu or those of the chest; depth, or a second picture /head/color_right,
            as EuRoC folders have, where it can.
        method: See `estimators.dvio.METHODS`.
        progress: Is told how far it is.

    Raises:
        StrideTwinError: A topic or calibration is missing, or the method is unknown.
    """
    mount = mount_of(recording)
    color, depth, right = (f"/{mount}/{s}" for s in ("color", "depth", "color_right"))
    rig, parameters = recording.rig, named(method)
    topics = [t for t in (f"/{mount}/imu", color, depth) if t in recording.topics]
    samples: Iterable[Sample] = recording.samples(topics)
    if depth not in recording.topics and right in recording.topics and parameters.uses_depth:
        stereo, rig = Stereo(rig.cameras[color], rig.cameras[right], depth), with_stereo(rig, color, depth)
        samples = _with_depth(recording.samples([*topics, right]), stereo, right)
    estimator = Dvio(rig, mount=mount, parameters=parameters)
    first = int(recording.image_times(f"/{mount}/color")[0])
    estimates = []
    for sample in samples:
        if not isinstance(sample, Imu | Image | Depth):
            continue
        estimate = estimator.update(sample)
        if progress is not None and isinstance(sample, Image):
            progress("estimate", min(1.0, (sample.t_ns - first) * 1e-9 / max(recording.duration, 1e-9)))
        if estimate is not None:
            estimates.append(estimate)
    if not estimates:
        raise RecordingError(f"{recording.path}: dvio never starts; it needs a second of IMU and pictures together")
    path = path_of(estimates)
    name = "dvio" if method == "stridetwin" else f"dvio_{method}"
    healthy = np.array([e.health != LOST for e in estimates], bool)
    return Estimate(name=name, frame=f"{mount}/imu", path=path, ready_ns=int(path.t_ns[0]), healthy=healthy)


def path_of(estimates: Sequence[PoseEstimate]) -> Trajectory:
    """Trajectory of N estimates, N ≥ 0."""
    T = np.array([e.T_world_imu for e in estimates]).reshape(-1, 4, 4)
    return Trajectory(
        t_ns=np.array([e.t_ns for e in estimates], np.int64),
        p_frame_in_world=T[:, :3, 3],
        q_world_frame=Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True) if len(T) else np.zeros((0, 4)),
        covariance=np.array([e.covariance for e in estimates]).reshape(-1, 6, 6),
    )


def _with_depth(samples: Iterable[Sample], stereo: Stereo, right: str) -> Iterator[Sample]:
    """The samples with the depth of each pair of pictures in the place of the right ones."""
    pair: dict[bool, Image] = {}
    for sample in samples:
        if isinstance(sample, Image):
            pair[sample.topic == right] = sample
        if not (isinstance(sample, Image) and sample.topic == right):
            yield sample
        if len(pair) == 2 and pair[False].t_ns == pair[True].t_ns:
            yield stereo.depth(pair[False], pair[True])
            pair.clear()
