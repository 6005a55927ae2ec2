"""Paths of a frame: a pose at one instant, the common output of all path estimators, and a trajectory of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array, Mask, Stamps


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of one frame over time.

    Attributes:
        t_ns: (N,) int64, strictly increasing.
        p_frame_in_world: (N, 3) m.
        q_world_frame: (N, 4) unit quaternions (w, x, y, z), frame to world.
        covariance: (N, 6, 6) of position (m) and of rotation about the world axes (rad), see `Pose`; or None.
    """

    t_ns: Stamps
    p_frame_in_world: Array
    q_world_frame: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        """Raises StrideTwinError where an array has another shape, or stamps do not increase."""
        n = len(self.t_ns)
        shapes = {"p_frame_in_world": (n, 3), "q_world_frame": (n, 4), "covariance": (n, 6, 6)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise StrideTwinError(f"Trajectory.{name}: invalid shape {value.shape}: expected {shape}")
        if np.any(np.diff(self.t_ns) <= 0):
            raise StrideTwinError("Trajectory.t_ns: stamps must increase strictly")

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, index: slice | Mask) -> Trajectory:
        """Some of the poses: a slice, or those of a (N,) mask."""
        return Trajectory(
            t_ns=self.t_ns[index],
            p_frame_in_world=self.p_frame_in_world[index],
            q_world_frame=self.q_world_frame[index],
            covariance=None if self.covariance is None else self.covariance[index],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Pose of a frame in the estimator's own world, z up.

    The covariance is that of the six errors (x, y, z, rx, ry, rz), in this order, all along the axes of the estimator's
    world: those of the position in m, and the small rotation δθ in rad with R_true = exp(δθ) R_estimated. An estimator
    that only knows the covariance P of the position returns `np.block([[P, 0], [0, Q]])` with any Q, such as
    1e-4 rad²: scores use the block of the position.

    Attributes:
        t_ns: Time.
        p_frame_in_world: (3,) m.
        rotation: Frame to world, in the estimator's own form: (4,) unit quaternion (w, x, y, z), the scalar first, or
            (3, 3) matrix. SciPy's `Rotation.as_quat` has the scalar last, unless `scalar_first=True`.
        frame: Name of the frame, such as `foot_l/imu`; "" if unknown to the estimator.
        covariance: (6, 6), see above; None if unavailable. A path has a covariance if all of its poses have one.
        valid: False while the estimator does not trust the pose itself.
    """

    t_ns: int
    p_frame_in_world: Array
    rotation: Array
    frame: str = ""
    covariance: Array | None = None
    valid: bool = True

    @property
    def q_world_frame(self) -> Array:
        """(4,) unit quaternion (w, x, y, z), frame to world."""
        rotation = np.asarray(self.rotation)
        return rotation if rotation.ndim == 1 else _to_quaternions(rotation)

    @property
    def T_world_frame(self) -> Array:
        """(4, 4) frame to world, m."""
        T, rotation = np.eye(4), np.asarray(self.rotation)
        T[:3, 3] = self.p_frame_in_world
        T[:3, :3] = rotation if rotation.ndim == 2 else _to_matrices(rotation)
        return T


def trajectory_of(poses: Sequence[Pose]) -> Trajectory:
    """The path of N ≥ 0 poses of one frame; it has a covariance if all of them have one.

    Raises:
        StrideTwinError: Stamps that do not increase, or arrays of another shape; the message has the time of the first.
    """
    n = len(poses)
    _check_shapes(poses)
    # the reshapes give arrays without poses, which have no shape by themselves, the shapes (0, 4) and (0, 3)
    if n and all(np.ndim(pose.rotation) == 2 for pose in poses):  # all matrices: one conversion is faster than N
        q = _to_quaternions(np.array([pose.rotation for pose in poses]))
    else:
        q = np.array([pose.q_world_frame for pose in poses], float).reshape(n, -1 if n else 4)
    known = [pose.covariance for pose in poses if pose.covariance is not None]
    return Trajectory(
        t_ns=np.array([pose.t_ns for pose in poses], np.int64),
        p_frame_in_world=np.array([pose.p_frame_in_world for pose in poses], float).reshape(n, -1 if n else 3),
        q_world_frame=q,
        covariance=np.array(known).reshape(n, 6, 6) if len(known) == n else None,
    )


def _check_shapes(poses: Sequence[Pose]) -> None:
    """Raises StrideTwinError for the first pose with an array of another shape than `Pose` describes."""
    for pose in poses:
        covariance = (6, 6) if pose.covariance is None else np.shape(pose.covariance)  # its shape; none is valid, too
        for name, shape, valid, meaning in (  # attribute, its shape, the valid shapes, and what the numbers are
            ("p_frame_in_world", np.shape(pose.p_frame_in_world), [(3,)], "m"),
            ("rotation", np.shape(pose.rotation), [(4,), (3, 3)], "a quaternion, w first, or a matrix"),
            ("covariance", covariance, [(6, 6)], "of x, y, z in m and of rotation about x, y, z in rad"),
        ):
            if shape not in valid:
                at = f"Pose.{name} at t = {pose.t_ns / 1e9:.3f} s"
                expected = " or ".join(map(str, valid))
                raise StrideTwinError(f"{at}: invalid shape {shape}: expected {expected}, {meaning}")


def _to_quaternions(R: Array) -> Array:
    """Unit quaternions (..., 4), (w, x, y, z), of rotation matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation  # here, as its import would double the start time of the command line

    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def _to_matrices(q: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), (w, x, y, z)."""
    from scipy.spatial.transform import Rotation  # here, as its import would double the start time of the command line

    return Rotation.from_quat(q, scalar_first=True).as_matrix()
