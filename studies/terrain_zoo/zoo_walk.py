"""One walk of the zoo: rendered, followed by the odometry, predicted, and scored."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.batch.jobs import Row
from stridetwin.estimators.locomotion_mode import METHODS
from stridetwin.estimators.terrain_map.depth_camera import camera_in_frame, transform
from stridetwin.outputs.path.scores import compare, score
from stridetwin.outputs.truth import TruePath
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Odometry
from stridetwin.streams.trajectory import Pose, trajectory_of
from stridetwin.studies.case import CaseWalk, ExperimentCase
from stridetwin.studies.terrain_zoo.kinds import WALK_KINDS, draw_walk
from stridetwin.studies.walks import fell_at_s, record_walk
from stridetwin.studies.zhao2023.mode_walks import predict, samples_with_poses, score_rows, sole_length_m

ESTIMATORS = ("dvio", "locomotion_mode", "terrain_map")
"""Estimators whose parameters `--set` changes here."""

_SETTLED_M = 5.0  # way after which the tilt is scored
_EVERY = 20
"""Every n-th of the odometry's poses is scored, which come at the IMU's rate."""


def run_case(case: ExperimentCase, kinds: str = "all") -> Row:
    """Simulates the walk of a case on a drawn terrain, and runs the odometry and every predictor of modes on it.

    Consecutive seeds are of consecutive kinds of terrain.

    Args:
        case: Its seed and options.
        kinds: Which kinds take turns: `all`, `tuned` (those on which parameters may be tuned), or one by its name.

    Returns:
        The case's row with `kind`, `mount`, `fell_at_s`, `odometry` (`odometry_figures`, and `mount_rad`, the error of
        the camera's estimated mount), and `methods`: method to the rows of `ModeScores`, and `time_ms` per depth image.
    """
    names = kinds_of(kinds)
    kind = names[case.seed % len(names)]
    (config,) = list_configs(case, kinds)
    mount = config.rig_mount  # body of the camera
    poses: list[Pose] = []  # valid ones of the odometry, which runs while `predict` reads the samples
    with record_walk(CaseWalk(name=kind, labels={}, config=config), case) as recording:
        predictions = predict(
            samples_with_poses(recording, mount, "dvio", on_pose=poses.append), recording, (*METHODS, *case.estimators)
        )
        odometry = odometry_figures(poses[::_EVERY], recording, mount)
        return case.row(
            kind=kind,
            mount=mount,
            fell_at_s=fell_at_s(recording),
            odometry=odometry | {"mount_rad": mount_error(predictions.camera, config)},
            methods=score_rows(predictions, recording, sole_length_m(config)),
        )


def list_configs(case: ExperimentCase, kinds: str = "all") -> list[TwinConfig]:
    """The one walk of a case, as a list.

    Args:
        case: Its seed draws the walk and chooses its kind.
        kinds: Which kinds take turns from seed to seed: `all`, `tuned`, or one by its name (`kinds_of`).
    """
    names = kinds_of(kinds)
    return [replace(draw_walk(names[case.seed % len(names)], case.seed), physics=case.physics)]


def kinds_of(kinds: str) -> list[str]:
    """Names of the kinds of walks that a choice stands for.

    Args:
        kinds: `all`, `tuned` (those on which parameters may be tuned), or one by its name.
    """
    return [name for name, entry in WALK_KINDS.items() if kinds in ("all", name) or (kinds == "tuned" and entry.tuned)]


def odometry_figures(poses: list[Pose], recording: Recording, mount: str) -> dict[str, float]:
    """Figures of an odometry, whose path is moved so that its first pose has the true position and heading.

    Args:
        poses: Poses of the IMU, in time order.
        recording: The walk, with the truth.
        mount: Body of the camera and its IMU: head or chest.

    Returns:
        `distance_m`; `end_height_m`, signed; `tilt_rad`, the RMS error of the vertical after 5 m; `inside_pct`, the
        share of the walk with the position within its own 95 % bound.
    """
    comparison = compare(trajectory_of(poses), TruePath.of(recording.block(f"/truth/{mount}/imu/odometry")))
    tilt = _tilt_rad(comparison.estimate.q_world_frame, comparison.truth.q_world_frame)  # (K,) rad, of K poses
    settled = comparison.distance_m - comparison.distance_m[0] > _SETTLED_M  # (K,) whether 5 m have been walked before
    scores = score(comparison)
    return {
        "distance_m": scores["distance_m"],
        "end_height_m": float(comparison.error_m[-1, 2]),
        "tilt_rad": float(np.sqrt(np.mean(tilt[settled] ** 2))) if settled.any() else math.nan,
        "inside_pct": scores["nees_position_within_95_pct"],
    }


def mount_error(estimated: Odometry | None, config: TwinConfig) -> float:
    """Rotation between the camera's estimated mount on its IMU and the true one, rad; NaN without an estimate."""
    if estimated is None:
        return math.nan
    rig, mount = standard_rig(config), config.rig_mount
    # (4, 4) true pose of the camera in its IMU's frame
    true = camera_in_frame(rig, rig.cameras[f"/{mount}/color"], f"{mount}/imu")
    return float(Rotation.from_matrix(true[:3, :3].T @ transform(estimated)[:3, :3]).magnitude())


def _tilt_rad(estimated: Array, true: Array) -> Array:
    """(N,) rad, angle between the estimated and the true vertical, seen from the sensor.

    Args:
        estimated: (N, 4) quaternions from the sensor to the world, w first.
        true: (N, 4) true ones.
    """
    # (N, 3) the world's vertical in the sensor's axes
    est, ref = (Rotation.from_quat(q, scalar_first=True).inv().apply([0.0, 0.0, 1.0]) for q in (estimated, true))
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(est, ref), axis=1), np.sum(est * ref, axis=1)))
