"""Gross errors of units and frames: metres and radians, z up, quaternions of unit norm, on a short quiet walk."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stridetwin.estimators.contact_terrain import MODES as STEP_MODES
from stridetwin.estimators.contact_terrain import UNKNOWN, StepEstimate
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.estimators.terrain_map import TerrainEstimate
from stridetwin.streams.samples import Array, Imu
from stridetwin.streams.trajectory import Pose, Trajectory
from stridetwin.testing.subject import ConformanceError, Subject, pose_of

_FACTOR = 3.0
"""Ratio of an estimated to a true length, or count, that no unit or frame explains."""
_SLACK_M = 0.5  # added to a length before it is compared
_UNIT = 1e-3  # tolerance of unit vectors, unit quaternions and rotation matrices
_UPRIGHT = 0.8
"""Least cosine of the angle between the estimated and the true vertical."""
_STEEPEST_RAD, _HIGHEST_M = 0.35, 0.3
"""On level ground, in slope and in height from step to step."""
_CAMERA_HEIGHT_M = (0.5, 3.0)  # of a head or chest above the ground
_FARTHEST_STEP_M, _LATEST_STEP_S = 8.0, 10.0  # of a predicted step, from the body and from now
_STEP_LENGTH_M, _STEP_TIME_S = (0.05, 2.5), (0.1, 5.0)  # of a person: shortest and longest


def check_plausible(subject: Subject) -> None:
    """Units and frames are those of the project.

    Raises:
        ConformanceError: A path, step, map or prediction is far from what the walk can be.
    """
    estimates = [returned.estimate for returned in subject.reference]
    paths: dict[str, list[Pose]] = {}
    for estimate in estimates:
        if (pose := pose_of(estimate)) is not None:
            paths.setdefault(pose.frame, []).append(pose)
    for frame, poses in paths.items():
        _check_path(subject, frame, poses)
    _check_steps(subject, [e for e in estimates if isinstance(e, StepEstimate)])
    for estimate in estimates:
        if isinstance(estimate, TerrainEstimate):
            _check_terrain(estimate)
        elif isinstance(estimate, ModeEstimate):
            _check_modes(estimate)


def _check_path(subject: Subject, frame: str, poses: list[Pose]) -> None:
    """The poses of one frame are rotations, as far apart as the true ones, and upright.

    Args:
        subject: The estimator under test, with its walk.
        frame: Frame of the poses; "" is the estimator's only IMU, if there is one.
        poses: Poses of the frame, in time order; only valid ones are compared with the truth.

    Raises:
        ConformanceError: They are not.
    """
    for pose in poses:
        _check_rotation(np.asarray(pose.rotation, float), pose.t_ns)
    imu_topics = [stream.topic for stream in subject.walk.streams if stream.kind is Imu]
    if not frame and len(imu_topics) == 1:
        frame = imu_topics[0].removeprefix("/")
    valid = [pose for pose in poses if pose.valid]
    if not valid:
        return
    truth = subject.walk.truth_of(frame)
    if truth is not None:
        _check_length(valid, truth)
    if f"/{frame}" in imu_topics:
        _check_vertical(subject, f"/{frame}", valid)


def _check_rotation(rotation: Array, t_ns: int) -> None:
    """A rotation is a unit quaternion (4,) or a rotation matrix (3, 3).

    Raises:
        ConformanceError: It is neither.
    """
    at = f"the rotation at {t_ns * 1e-9:.3f} s"
    if rotation.shape == (4,):
        if abs(np.linalg.norm(rotation) - 1.0) > _UNIT:
            raise ConformanceError(f"{at} is a quaternion of norm {np.linalg.norm(rotation):.4g}: normalise it")
    elif rotation.shape != (3, 3):
        raise ConformanceError(f"{at} has the shape {rotation.shape}: expected a quaternion (4,) or a matrix (3, 3)")
    elif np.abs(rotation @ rotation.T - np.eye(3)).max() > _UNIT or np.linalg.det(rotation) < 0.0:
        raise ConformanceError(f"{at} is no rotation matrix: orthonormalise it")


def _check_length(poses: Sequence[Pose], truth: Trajectory) -> None:
    """Compares the largest distance from the start with the true one, which reveals wrong units.

    A path that never leaves its start is accepted: an estimator of the attitude alone gives one.

    Args:
        poses: Valid poses of one frame.
        truth: True path of the frame; only its part during these poses counts.

    Raises:
        ConformanceError: The path is far too long or too short.
    """
    positions = np.array([pose.p_frame_in_world for pose in poses], float)
    estimated_m = float(np.linalg.norm(positions - positions[0], axis=1).max())
    during = (truth.t_ns >= poses[0].t_ns) & (truth.t_ns <= poses[-1].t_ns)
    if not during.any():  # nothing to compare with
        return
    way = truth.p_frame_in_world[during]
    true_m = float(np.linalg.norm(way - way[0], axis=1).max())
    too_short = 0.0 < estimated_m < true_m / _FACTOR - _SLACK_M
    if estimated_m > _FACTOR * true_m + _SLACK_M or too_short:
        raise ConformanceError(
            f"the path leads {estimated_m:.3g} m from its start, the true one {true_m:.3g} m: positions are in metres"
        )


def _check_vertical(subject: Subject, topic: str, poses: Sequence[Pose]) -> None:
    """The mean specific force, rotated into the world by the estimated attitudes, points upwards.

    A walk from rest to rest has no mean acceleration, so that only the reaction to gravity remains.

    Args:
        subject: The estimator under test, with its walk.
        topic: Topic of the IMU.
        poses: Poses of the IMU's frame; those at the stamp of a sample of the IMU count.

    Raises:
        ConformanceError: It points elsewhere: frames or the order of quaternions are wrong.
    """
    # (3,) m/s² by stamp
    forces = {s.t_ns: s.specific_force for s in subject.walk.samples if isinstance(s, Imu) and s.topic == topic}
    rotated = [pose.T_world_frame[:3, :3] @ forces[pose.t_ns] for pose in poses if pose.t_ns in forces]
    if not rotated:
        return
    mean = np.mean(rotated, axis=0)
    if mean[2] < _UPRIGHT * np.linalg.norm(mean):
        direction = ", ".join(f"{v:.2f}" for v in mean / np.linalg.norm(mean))
        raise ConformanceError(
            f"the mean specific force, rotated into the world, points along ({direction}) instead of (0, 0, 1): "
            "rotation is from the frame to the world, scalar first, and the world's z axis is up"
        )


def _check_steps(subject: Subject, estimates: list[StepEstimate]) -> None:
    """Steps name their foot and mode, are level on the twin's walk, and are about as many as the footprints.

    Raises:
        ConformanceError: They do not.
    """
    if not estimates:
        return
    for estimate in estimates:
        at = f"the step at {estimate.t_ns * 1e-9:.3f} s"
        if estimate.foot not in ("l", "r"):
            raise ConformanceError(f"{at}: foot: invalid {estimate.foot!r}: expected l or r")
        if estimate.mode not in (*STEP_MODES, UNKNOWN):
            valid = ", ".join((*STEP_MODES, UNKNOWN))
            raise ConformanceError(f"{at}: mode: invalid {estimate.mode!r}: expected one of {valid}")
        _check_normal(estimate.normal, at)
        if subject.walk.is_twin and abs(estimate.slope) > _STEEPEST_RAD:
            raise ConformanceError(f"{at}: slope is {estimate.slope:.3g} rad on level ground: slopes are in radians")
        if subject.walk.is_twin and abs(estimate.elevation) > _HIGHEST_M:
            raise ConformanceError(f"{at}: elevation is {estimate.elevation:.3g} m on level ground: it is in metres")
    # numbers of the steps, each once; 0 is standing at the start
    steps, footprints = len({e.step for e in estimates if e.step > 0}), subject.walk.footprints
    if footprints and not footprints / _FACTOR <= steps <= footprints * _FACTOR:
        raise ConformanceError(f"{steps} steps where the walk has {footprints}: each step has a number of its own")


def _check_normal(normal: Array, at: str) -> None:
    """A normal (3,) is a unit vector that points up; `at` names the estimate in the error.

    Raises:
        ConformanceError: It is not.
    """
    if abs(np.linalg.norm(normal) - 1.0) > _UNIT:
        raise ConformanceError(f"{at}: normal has the length {np.linalg.norm(normal):.4g}: normalise it")
    if normal[2] <= 0.0:
        raise ConformanceError(f"{at}: normal points down: the world's z axis is up")


def _check_terrain(estimate: TerrainEstimate) -> None:
    """Planes have normals and areas, and the largest is as far below the camera as a person's ground.

    Raises:
        ConformanceError: They do not.
    """
    at = f"the map at {estimate.t_ns * 1e-9:.3f} s"
    for plane in estimate.planes.values():
        _check_normal(plane.normal, at)
        if not plane.area_m2 > 0.0:
            raise ConformanceError(f"{at}: plane {plane.id} has an area of {plane.area_m2:.3g} m²: it is positive")
    if estimate.planes:
        largest = max(estimate.planes.values(), key=lambda plane: plane.area_m2)
        camera = np.asarray(estimate.p_camera_in_world, float)
        height_m = float(camera[2] - largest.height(camera[:2]))
        if not _CAMERA_HEIGHT_M[0] < height_m < _CAMERA_HEIGHT_M[1]:
            raise ConformanceError(
                f"{at}: the largest plane is {height_m:.3g} m below the camera: heights are in metres, in the world of "
                "the poses, z up"
            )


def _check_modes(estimate: ModeEstimate) -> None:
    """Predicted steps are near in place and time, and as long and fast as a person's.

    Raises:
        ConformanceError: They are not.
    """
    at = f"the prediction at {estimate.t_ns * 1e-9:.3f} s"
    (shortest_m, longest_m), (shortest_s, longest_s) = _STEP_LENGTH_M, _STEP_TIME_S
    if not shortest_m < estimate.step_length < longest_m or not shortest_s < estimate.step_time < longest_s:
        raise ConformanceError(
            f"{at}: a step of {estimate.step_length:.3g} m in {estimate.step_time:.3g} s: expected metres and seconds"
        )
    if abs(estimate.heading) > 2.0 * math.pi:
        raise ConformanceError(f"{at}: heading is {estimate.heading:.3g}: it is in radians")
    for step in estimate.steps:
        if step.mode not in (*STEP_MODES, UNKNOWN) or step.foot not in ("l", "r", ""):
            raise ConformanceError(f"{at}: invalid mode {step.mode!r} or foot {step.foot!r}: expected such as LG, l")
        seconds = (step.t_ns - estimate.t_ns) * 1e-9
        if not -_LATEST_STEP_S < seconds < _LATEST_STEP_S:
            raise ConformanceError(
                f"{at}: a step is predicted in {seconds:.3g} s: t_ns is in ns, of the samples' clock"
            )
        away_m = float(np.linalg.norm(step.p_foot_in_world[:2] - np.asarray(estimate.p_body_in_world)[:2]))
        if not away_m < _FARTHEST_STEP_M:
            raise ConformanceError(f"{at}: a step is predicted {away_m:.3g} m from the body: positions are in metres")
