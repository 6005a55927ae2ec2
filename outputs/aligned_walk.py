"""A walk as its odometry saw it, beside the truth: what scores of terrain and modes, and their figures, are based on.

Estimates of terrain and modes live in the world of the odometry's poses. They are aligned with the truth at each
instant, so that drift of the poses counts only as an error of the odometry.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import PathEstimate
from stridetwin.outputs.alignment import MovingAlignment
from stridetwin.outputs.truth import FOOTPRINTS, project_on_way, true_footprints, true_path
from stridetwin.streams.pose_restart import restart_poses
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout, terrain_layout
from stridetwin.streams.trajectory import Trajectory

_SOLE_M = 0.27
"""Length of the soles where the recording does not say it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AlignedWalk:
    """The poses of an odometry over N instants, in a world of its own, beside the truth.

    Attributes:
        frame: Frame of the poses, such as `head/imu`.
        poses: N poses that the odometry trusts, in its own world.
        camera: Its estimates of the camera's pose in the frame, one per change; None if it gives none.
        statuses: (N,) what holds each of the poses; None if the odometry does not say.
        alignment: From the odometry's world to the true one, per instant.
        p_frame_in_world: (N, 3) m, true positions of the frame.
        place_m: (N,) m along the route, true.
        layout: The true terrain.
        footprints: The true footprints; the two initial ones come first.
        foot_places_m: (F,) m along the route, of the footprints.
        sole_m: Length of the soles.
    """

    frame: str
    poses: Trajectory
    camera: Trajectory | None
    statuses: NDArray[np.str_] | None
    alignment: MovingAlignment
    p_frame_in_world: Array
    place_m: Array
    layout: Layout
    footprints: list[Footprint]
    foot_places_m: Array
    sole_m: float = _SOLE_M

    def place_at(self, t_ns: int) -> float | None:
        """The true place along the route at the last pose up to a time, m; None before the first pose."""
        i = int(np.searchsorted(self.poses.t_ns, t_ns, side="right")) - 1
        return float(self.place_m[i]) if i >= 0 else None


def odometry_of(recording: Recording, paths: Iterable[PathEstimate]) -> PathEstimate | None:
    """Selects the path that supplies the poses for terrain and modes, if the recording has what their scores need.

    Args:
        recording: With depth on the body of the odometry's IMU, and true footprints, terrain and path of the IMU.
        paths: Estimated paths.

    Returns:
        None if no odometry is among the paths, none of its poses is healthy, or the recording lacks one of these.
    """
    odometry = next((path for path in paths if path.supplies_poses), None)
    if odometry is None or FOOTPRINTS not in recording.topics or terrain_layout(recording.metadata) is None:
        return None
    # the depth camera must be on the body of the odometry's IMU, since its pose follows from that of the IMU
    body = recording.rig.imu(f"/{odometry.frame}").mount.body
    camera = next((c for c in recording.rig.cameras.values() if c.depth_topic), None)
    has_depth = camera is not None and camera.depth_topic in recording.topics and camera.mount.body == body
    has_true_path = f"/truth/{odometry.frame}/odometry" in recording.topics
    has_poses = len(odometry.path) > 1 and (odometry.healthy is None or bool(odometry.healthy.any()))
    return odometry if has_depth and has_true_path and has_poses else None


def align_walk(recording: Recording, odometry: PathEstimate) -> AlignedWalk:
    """The walk with the poses of an odometry beside the truth.

    Poses that the odometry does not trust, or that lie outside the span of the truth, are left out.

    Args:
        recording: The walk, for which `odometry_of` has returned the odometry.
        odometry: Path of the odometry.
    """
    layout = terrain_layout(recording.metadata)
    assert layout is not None, "odometry_of has checked it"
    truth, path = true_path(recording, odometry.frame), odometry.path
    is_kept = (path.t_ns >= truth.t_ns[0]) & (path.t_ns <= truth.t_ns[-1])
    if odometry.healthy is not None:  # (N,) whether the odometry trusts each pose
        is_kept = is_kept & odometry.healthy
    # the metadata may ask for a restart of the odometry, after which its poses are in another world
    poses = restart_poses(path[is_kept], recording.metadata)
    true_poses = truth.at(poses.t_ns)
    footprints = true_footprints(recording)
    return AlignedWalk(
        frame=odometry.frame,
        poses=poses,
        camera=odometry.camera,
        statuses=None if odometry.status is None else odometry.status[is_kept],
        alignment=MovingAlignment(poses, true_poses),
        p_frame_in_world=true_poses.p_frame_in_world,
        place_m=layout.way.project(true_poses.p_frame_in_world[:, :2]),
        layout=layout,
        footprints=footprints,
        foot_places_m=project_on_way([f.p_foot_in_world for f in footprints], layout),
        sole_m=float(recording.metadata.get("shoe_length_m", _SOLE_M)),
    )
