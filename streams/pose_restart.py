"""Restarts of an odometry that a recording prescribes for its replay: a fault of the poses that estimators take.

A recording holds no estimated poses, so the fault is written as metadata and applied to the poses when they are there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace

from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import invalid_metadata
from stridetwin.streams.trajectory import Trajectory

_KEY = "pose_restarts"


@dataclass(frozen=True, kw_only=True)
class PoseRestart:
    """Poses that are lost from an instant until another one, and belong to another frame from then on.

    Attributes:
        from_ns: First instant without a pose.
        until_ns: First instant with poses in the new frame.
        yaw_rad: Rotation about the vertical from the old frame to the new one.
        translation_m: Translation from the old frame to the new one, after the rotation.
    """

    from_ns: int
    until_ns: int
    yaw_rad: float
    translation_m: tuple[float, float, float]


def restart_metadata(restarts: Iterable[PoseRestart]) -> dict[str, str]:
    """Restarts as metadata of a recording; empty without any."""
    rows = [asdict(restart) for restart in restarts]
    return {_KEY: json.dumps(rows)} if rows else {}


def read_restarts(metadata: Mapping[str, str]) -> list[PoseRestart]:
    """The restarts that a recording prescribes, in time order.

    Raises:
        RecordingError: They are not a list of restarts.
    """
    try:
        return [PoseRestart(**row) for row in json.loads(metadata.get(_KEY, "[]"))]
    except (ValueError, TypeError, RecursionError) as error:
        raise invalid_metadata(_KEY, "restarts written by StrideTwin", error) from error


def restart_poses(path: Trajectory, restarts: Iterable[PoseRestart]) -> Trajectory:
    """Poses of an odometry, as they are after restarts in time order; covariances keep their axes."""
    for restart in restarts:
        path = path[(path.t_ns < restart.from_ns) | (path.t_ns >= restart.until_ns)]
        later = path.t_ns >= restart.until_ns
        if later.any():
            yaw = Rotation.from_rotvec([0.0, 0.0, restart.yaw_rad])
            p, q = path.p_frame_in_world.copy(), path.q_world_frame.copy()
            p[later] = yaw.apply(p[later]) + restart.translation_m
            q[later] = (yaw * Rotation.from_quat(q[later], scalar_first=True)).as_quat(scalar_first=True)
            path = replace(path, p_frame_in_world=p, q_world_frame=q)
    return path
