"""Scores estimated paths against the truth of their recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PathEstimate as Estimate
from stridetwin.outputs.alignment import Rigid
from stridetwin.outputs.path.scores import Comparison, Scores, compare, score
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.errors import ConfigError, RecordingError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Array, Block, Odometry

LARGEST_SCORE = 1e100
"""Larger values, also in metres, would overflow in squares and sums."""
_NOT_UNIT = 1e-3
__all__ = ["Estimate", "Result", "evaluate", "summary", "true_frames", "true_path"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """An estimate, aligned with the truth and scored."""

    estimate: Estimate
    comparison: Comparison
    scores: Scores


def true_path(recording: Recording, frame: str) -> TruePath:
    """The true path of a frame: as recorded, or derived from another sensor on the same body through their mounts.

    Raises:
        RecordingError: The recording has no truth for the frame; the message lists the available frames.
    """
    frames = true_frames(recording.topics)
    if frame in frames:
        return TruePath.of(recording.block(f"/truth/{frame}/odometry"))
    mounts = _mounts(recording.rig) if recording.has_rig else {}
    for other in mounts if frame in mounts else ():
        if other in frames and mounts[other].body == mounts[frame].body:
            T_other_frame = np.linalg.inv(mounts[other].T_body_sensor) @ mounts[frame].T_body_sensor
            return _rigidly_mounted(recording.block(f"/truth/{other}/odometry"), T_other_frame)
    raise RecordingError(f"{recording.path}: no truth of frame {frame!r}; it has {', '.join(frames) or 'none'}")


def _mounts(rig: Rig) -> dict[str, Mount]:
    """Mounts of IMUs and cameras, by their frames."""
    mounts = {topic: imu.mount for topic, imu in rig.imus.items()}
    mounts |= {topic: camera.mount for topic, camera in rig.cameras.items()}
    return {topic.removeprefix("/"): mount for topic, mount in mounts.items()}


def _rigidly_mounted(recorded: Block[Odometry], T_recorded_frame: Array) -> TruePath:
    """The path of a frame that is rigidly mounted in the recorded one, (4, 4) m."""
    path, arm = TruePath.of(recorded), T_recorded_frame[:3, 3]
    attitude = Rotation.from_quat(path.q_world_frame, scalar_first=True)
    relative = np.cross(recorded.columns["angular_rate"], arm)  # m/s in the axes of the recorded frame
    return TruePath(
        t_ns=path.t_ns,
        p_frame_in_world=path.p_frame_in_world + attitude.apply(arm),
        v_frame_in_world=path.v_frame_in_world + attitude.apply(relative),
        q_world_frame=(attitude * Rotation.from_matrix(T_recorded_frame[:3, :3])).as_quat(scalar_first=True),
    )


def true_frames(topics: Iterable[str]) -> list[str]:
    """Frames whose true path is among the topics."""
    prefix, suffix = "/truth/", "/odometry"
    return sorted(t[len(prefix) : -len(suffix)] for t in topics if t.startswith(prefix) and t.endswith(suffix))


def evaluate(recording: Recording, made: Iterable[Estimate], alignment: str = "start") -> list[Result]:
    """Scores estimates against the truth of the recording.

    Raises:
        ConfigError: An invalid pose or score; the message names the estimator and the time.
        RecordingError: Truth is missing or too short, see `true_path` and `compare`.
    """
    results = []
    worlds: dict[str, Rigid] = {}
    for estimate in made:
        _check_poses(estimate)
        path = true_path(recording, estimate.frame).since(estimate.ready_ns)
        comparison = compare(estimate.path, path, alignment, worlds.get(estimate.world))
        if estimate.world:
            worlds.setdefault(estimate.world, comparison.transform)
        scores = score(comparison, not estimate.world) | {f"nis_{kind}": v for kind, v in estimate.nis.items()}
        for metric, value in scores.items():
            if not abs(value) <= LARGEST_SCORE:
                raise ConfigError(estimate.name, metric, value, f"a number of up to {LARGEST_SCORE:g}")
        results.append(Result(estimate=estimate, comparison=comparison, scores=scores))
    return results


def _check_poses(estimate: Estimate) -> None:
    path = estimate.path
    with np.errstate(over="ignore"):
        far_from_unit = np.abs(np.linalg.norm(path.q_world_frame, axis=1) - 1.0)
    near = (np.abs(path.p_frame_in_world) <= LARGEST_SCORE).all(axis=1)
    for name, fits, valid in (
        ("p_frame_in_world", near, f"finite numbers of up to {LARGEST_SCORE:g} m"),
        ("q_world_frame", far_from_unit <= _NOT_UNIT, f"a unit quaternion, its norm within {_NOT_UNIT:g} of 1"),
    ):
        if not fits.all():
            first = int(np.argmin(fits))
            where = f"{name} at t = {path.t_ns[first] / 1e9:.3f} s"
            raise ConfigError(estimate.name, where, getattr(path, name)[first].tolist(), valid)


def summary(all_scores: Iterable[dict[str, Scores]]) -> dict[str, Scores]:
    """Mean of each score over recordings (the largest of the `_max_` ones), per estimator."""
    gathered: dict[str, dict[str, list[float]]] = {}
    for recording in all_scores:
        for name, scores in recording.items():
            for metric, value in scores.items():
                gathered.setdefault(name, {}).setdefault(metric, []).append(value)
    return {
        name: {m: max(v) if "_max_" in m else sum(v) / len(v) for m, v in metrics.items()}
        for name, metrics in gathered.items()
    }
