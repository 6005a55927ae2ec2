"""By how much a corruption changes the estimates of a recording."""

from __future__ import annotations

import numpy as np

from stridetwin.estimators.registry import estimator
from stridetwin.estimators.terrain_map import TerrainMap
from stridetwin.outputs.alignment import align
from stridetwin.outputs.base import Output
from stridetwin.outputs.chosen_poses import TRUE_POSES, choose_poses
from stridetwin.outputs.feeding import instance_for
from stridetwin.outputs.path.run import run_paths
from stridetwin.outputs.pose_feed import replay
from stridetwin.outputs.terrain.grid import GroundGrid
from stridetwin.outputs.terrain.kind import TerrainMaps
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

_POSES = 200
"""Number of poses by which two paths are compared."""
_LEAST_COMMON = 0.5
"""Share of the ground, and of the time, that two estimates must share to be compared by place and time."""
_EYES_M = 1.6
"""Height of the camera above the ground, to which errors of the ground are relative."""


def follow_foot(recording: Recording) -> Trajectory:
    """The path of the left foot."""
    return _follow("foot_ins", recording)


def follow_head(recording: Recording) -> Trajectory:
    """The path of the head by its camera and IMU."""
    return _follow("dvio", recording)


def _follow(name: str, recording: Recording) -> Trajectory:
    """The first path of an estimator, with its first method; of an estimator of one foot, that of the left one."""
    (output, *_) = run_paths(instance_for(estimator(name), recording), recording)
    return output.estimates.path


def map_ground(recording: Recording, *, has_truth: bool) -> GroundGrid:
    """The ground by the depth camera, with the true poses of the recording, or with those of the odometry."""
    poses = choose_poses(recording, TRUE_POSES if has_truth else None)
    instance = instance_for(TerrainMap, recording).with_poses_of(poses.frame)
    ((_, outputs),) = replay([(TerrainMaps(), instance)], recording, poses.path, poses.camera)
    output: Output[object] = outputs[0]
    return GroundGrid.of(output.estimates.terrain_map)  # type: ignore[attr-defined]


def compare_paths(path: Trajectory, clean: Trajectory, length_m: float) -> float:
    """Largest distance between two estimated paths, relative to the way that was walked.

    Position and heading are aligned at the first common pose. Poses of equal times are compared; of paths that share
    less than half of the time, as with another clock, those of equal shares of their durations.

    Args:
        path: The path of the corrupted recording.
        clean: The path of the good one.
        length_m: Way that was walked.
    """
    first, last = max(path.t_ns[0], clean.t_ns[0]), min(path.t_ns[-1], clean.t_ns[-1])
    duration = clean.t_ns[-1] - clean.t_ns[0]
    if last - first >= _LEAST_COMMON * duration:
        spans = [(first, last), (first, last)]
    else:
        spans = [(p.t_ns[0], p.t_ns[-1]) for p in (path, clean)]
    estimated, expected = (_resample(p, *span) for p, span in zip((path, clean), spans))
    aligned = align(estimated, expected, "start").apply(estimated)
    distance = np.linalg.norm(aligned.p_frame_in_world - expected.p_frame_in_world, axis=1)
    return float(np.max(distance)) / length_m


def _resample(path: Trajectory, first_ns: int, last_ns: int) -> Trajectory:
    """`_POSES` poses of a path at equal steps of time."""
    t_ns = np.linspace(first_ns, last_ns, _POSES)
    p = np.column_stack([np.interp(t_ns, path.t_ns, path.p_frame_in_world[:, k]) for k in range(3)])
    nearest = np.clip(np.searchsorted(path.t_ns, t_ns), 0, len(path) - 1)
    stamps = np.rint(np.linspace(0, 1e9, _POSES)).astype(np.int64)
    return Trajectory(t_ns=stamps, p_frame_in_world=p, q_world_frame=path.q_world_frame[nearest])


def compare_ground(ground: GroundGrid, clean: GroundGrid) -> float:
    """Mean absolute difference of the heights of two maps where both know them, relative to that of the eyes.

    It is 1 if they share less than half of the ground of the good one.
    """
    points, _ = clean.points()
    heights, _ = ground.at(points[:, :2])
    is_known = np.isfinite(heights)
    if is_known.mean() < _LEAST_COMMON:
        return 1.0
    errors: Array = heights[is_known] - points[is_known, 2]
    return float(np.mean(np.abs(errors))) / _EYES_M
