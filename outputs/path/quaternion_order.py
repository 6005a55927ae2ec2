"""Quaternions in another order than w, x, y, z, which the true attitudes show.

The rotation since the first pose, R₀ᵀ Rᵢ, does not depend on the alignment; in another order it is wrong by much unless
the frame turns about one axis alone, as a foot on a straight way does. Then the attitude is half a turn off all the
way, in a world in which the positions are upright.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

_MIN_ERROR_RAD, _RATIO, _MAX_POSES = 0.09, 3.0, 1000
"""Mean error of the attitude from which another order of the quaternions is tried, how many times smaller the error
must then be, and how many poses are compared."""
_LEAST_M, _NO_WORSE = 1e-3, 1.5
"""A smaller difference of the shapes is one of rounding, and a misfit up to so many times the other is no worse."""
_LEAST_MIRROR_M, _MIRROR_RATIO = 1.0, 5.0
"""A mirrored way is at least so far from the true one, RMS, and so many times as far as when it is mirrored again."""
_TILTED_RAD, _UPRIGHT_RAD = math.radians(40.0), math.radians(20.0)
"""Least tilt of the attitude in a wrong order, which is mostly half a turn, and largest one in the right order."""


def steps_to_order(
    estimate: Trajectory, truth: Trajectory, steps: tuple[int, ...] = (1, -1), *, by_shape: bool = False
) -> int:
    """How far the components of the quaternions must be rolled to agree with the truth; 0 as they are.

    Args:
        estimate: N poses in a world of their own.
        truth: The true poses at the same stamps.
        steps: Rolls to try: 1 makes w, x, y, z of x, y, z, w, and -1 of z, w, x, y (w first read as w last).
        by_shape: Another order is also right if the attitudes turn the positions to the true ones much better with it.
    """
    estimate, truth = _thin_out(estimate), _thin_out(truth)
    read = _misfit(estimate, truth)
    for step in steps:
        q = np.roll(estimate.q_world_frame, step, axis=1)
        other = _misfit(replace(estimate, q_world_frame=q), truth)
        if _agrees(other, read, by_shape=by_shape):
            return step
    return 0


def _thin_out(path: Trajectory) -> Trajectory:
    """Up to `_MAX_POSES` poses, evenly over a path: enough to compare attitudes."""
    return path[:: 1 + len(path) // _MAX_POSES]


class _Misfit(NamedTuple):
    """How far the attitudes of an estimate are off the truth in one order of its quaternions.

    Attributes:
        turn: Mean error of the rotation since the first pose, rad.
        tilt: Of the estimate's world, rad.
        shape: RMS distance of the positions in the true world as the attitudes turn them, m.
    """

    turn: float
    tilt: float
    shape: float


def _misfit(estimate: Trajectory, truth: Trajectory) -> _Misfit:
    """The misfit of an estimate at the stamps of the truth."""
    return _Misfit(
        _turning_error(estimate.q_world_frame, truth), tilt_of_world(estimate, truth), _shape_error(estimate, truth)
    )


def _agrees(other: _Misfit, read: _Misfit, *, by_shape: bool) -> bool:
    """Whether another order of the quaternions agrees with the truth, and the one that was read does not."""
    if read.turn >= _MIN_ERROR_RAD and other.turn * _RATIO < read.turn:
        return True
    if other.turn > _NO_WORSE * read.turn + _MIN_ERROR_RAD:
        return False
    is_turn = read.tilt > _TILTED_RAD and other.tilt < _UPRIGHT_RAD
    if is_turn and other.shape < (_NO_WORSE if by_shape else 1.0) * read.shape:
        return True
    return by_shape and other.shape * _RATIO < read.shape - _LEAST_M


def is_inverse(estimate: Trajectory, truth: Trajectory) -> bool:
    """Whether the quaternions turn the world's axes to the frame's instead of the frame's to the world's.

    Args:
        estimate: N poses in a world of their own.
        truth: The true poses at the same stamps.
    """
    estimate, truth = _thin_out(estimate), _thin_out(truth)
    error = _turning_error(estimate.q_world_frame, truth)
    return error > _MIN_ERROR_RAD and _RATIO * _turning_error(estimate.q_world_frame * [1, -1, -1, -1], truth) < error


def turn_of_frame(estimate: Trajectory, truth: Trajectory) -> float:
    """Angle, rad, by which the frame of an estimate is turned from that of the truth all the way; 0 if it is not.

    It is then the frame of another sensor, such as of a camera. A world of another attitude turns all attitudes from
    the other side, which differs from it as soon as the frame turns.

    Args:
        estimate: N poses in a world of their own.
        truth: The true poses at the same stamps.
    """
    paths = (_thin_out(estimate), _thin_out(truth))
    of_estimate, of_truth = (Rotation.from_quat(path.q_world_frame, scalar_first=True) for path in paths)
    in_frame, in_world = of_truth.inv() * of_estimate, of_estimate * of_truth.inv()
    mean = in_frame.mean()
    turn = float(mean.magnitude())
    if turn < _UPRIGHT_RAD or _spread(in_frame) > _MIN_ERROR_RAD or _spread(in_world) < _RATIO * _MIN_ERROR_RAD:
        return 0.0
    return turn


def is_mirrored(estimate: Trajectory, truth: Trajectory) -> bool:
    """Whether the ways on the ground agree only with left and right exchanged, as those of a left-handed world do.

    Args:
        estimate: N poses in a world of their own whose z axis is up.
        truth: The true poses at the same stamps.
    """
    ways = [path.p_frame_in_world[:, :2] - path.p_frame_in_world[:, :2].mean(axis=0) for path in (estimate, truth)]
    H = ways[0].T @ ways[1]
    if np.linalg.det(H) >= 0.0:
        return False
    s1, s2 = np.linalg.svd(H, compute_uv=False)  # by the Procrustes problem with a rotation, and with a reflection
    size = float(sum(np.sum(way**2) for way in ways))
    rotated_m, mirrored_m = (math.sqrt(max(0.0, size - 2.0 * fit) / len(truth)) for fit in (s1 - s2, s1 + s2))
    return rotated_m > max(_LEAST_MIRROR_M, _MIRROR_RATIO * mirrored_m)


def _spread(rotations: Rotation) -> float:
    """Mean angle of N rotations from their mean, rad."""
    return float((rotations.mean().inv() * rotations).magnitude().mean())


def tilt_of_world(estimate: Trajectory, truth: Trajectory) -> float:
    """Median angle, rad, by which the attitudes say that the estimate's z axis is off the true one.

    Args:
        estimate: N poses.
        truth: The true poses at the same stamps.
    """
    return float(np.median(np.arccos(np.clip(_to_truth(estimate.q_world_frame, truth)[:, 2, 2], -1.0, 1.0))))


def _turning_error(q: Array, truth: Trajectory) -> float:
    """Mean angle between the rotations since the first pose, of attitudes (N, 4) and the truth, rad."""
    rotations = [Rotation.from_quat(quaternions, scalar_first=True) for quaternions in (q, truth.q_world_frame)]
    since_first = [rotation[0].inv() * rotation for rotation in rotations]
    return float((since_first[0].inv() * since_first[1]).magnitude().mean())


def _to_truth(q: Array, truth: Trajectory) -> Array:
    """(N, 3, 3) rotations from the estimate's world to the true one, by attitudes (N, 4) and the true ones."""
    rotations = [Rotation.from_quat(quaternions, scalar_first=True) for quaternions in (truth.q_world_frame, q)]
    return np.asarray((rotations[0] * rotations[1].inv()).as_matrix())


def _shape_error(estimate: Trajectory, truth: Trajectory) -> float:
    """RMS distance, m, of the positions about their means, rotated to the true world as the attitudes say."""
    mean = Rotation.from_matrix(_to_truth(estimate.q_world_frame, truth)).mean().as_matrix()
    p = (estimate.p_frame_in_world - estimate.p_frame_in_world.mean(axis=0)) @ mean.T
    true_p = truth.p_frame_in_world - truth.p_frame_in_world.mean(axis=0)
    return float(np.sqrt(np.mean((p - true_p) ** 2)))
