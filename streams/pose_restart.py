"""Restarts of an odometry that a recording prescribes for its replay: a fault of the poses that estimators take.

A recording holds no estimated poses, so the fault is written as metadata and applied to the poses when they are there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import metadata_error
from stridetwin.streams.trajectory import Trajectory

RESTARTS = "pose_restarts"
"""Key in the metadata: JSON rows of times (ns) of loss and restart, yaw (rad), and translation (x, y, z in m)."""


def restart_poses(path: Trajectory, metadata: Mapping[str, str]) -> Trajectory:
    """Poses of an odometry after the restarts that a recording's metadata prescribes; covariances keep their axes.

    From a loss to the restart there are no poses; from then on they are rotated about the vertical, then translated.

    Raises:
        RecordingError: The metadata are not restarts.
    """
    try:
        rows = [tuple(map(float, row)) for row in json.loads(metadata.get(RESTARTS, "[]"))]
        # each: time of the loss and of the restart, and the rotation and translation (m) of the poses from then on
        restarts = [(from_ns, until_ns, yaw_rad, (x, y, z)) for from_ns, until_ns, yaw_rad, x, y, z in rows]
    except (ValueError, TypeError, RecursionError) as error:
        raise metadata_error(RESTARTS, "restarts written by StrideTwin", error) from error
    for from_ns, until_ns, yaw_rad, translation in restarts:
        path = path[(path.t_ns < from_ns) | (path.t_ns >= until_ns)]  # no poses between loss and restart
        later = (path.t_ns >= until_ns)[:, None]  # (N, 1) whether a pose is after the restart
        yaw = Rotation.from_rotvec([0.0, 0.0, yaw_rad])
        q = (yaw * Rotation.from_quat(path.q_world_frame, scalar_first=True)).as_quat(scalar_first=True)
        path = replace(
            path,
            p_frame_in_world=np.where(later, yaw.apply(path.p_frame_in_world) + translation, path.p_frame_in_world),
            q_world_frame=np.where(later, q, path.q_world_frame),
        )
    return path
