"""Kinematics of a leg from its D-H table, the attitudes of thigh and foot, and the knee's angle.

The joints of hip and ankle have no encoders: their angles follow from the AHRS attitudes of the frames before and
beyond them, Shim 2019 (4)-(10). `joint_angles` is the closed form for any axes; for the table of that paper it is Shim
2019 (7) and (10). `foot_position` gives a foot's position and its derivative by the filter's offsets.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.contact_terrain.geometry import DhRow, Leg
from stridetwin.streams.algebra.matrices import apply, copy_matrix, dot, hat, identity, multiply, transposed
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent


class Links(NamedTuple):
    """A leg as compiled code reads it, of N frames.

    Attributes:
        table: (N, 4) alpha, a, d, theta of each frame.
        turns: (N,) bool, which frames a joint rotates.
        thigh: Number of the frame on the thigh.
        knee: Number of the frame that the knee rotates.
        hip_parts: (joints + 1, 3, 3) constant rotations before, between and beyond the joints of the hip.
        ankle_parts: (joints + 1, 3, 3) constant rotations before, between and beyond the joints of the ankle.
        ankle_stops: (joints, 2) rad, least and greatest angle of each joint of the ankle.
    """

    table: Array
    turns: Array
    thigh: int
    knee: int
    hip_parts: Array
    ankle_parts: Array
    ankle_stops: Array


def links(leg: Leg) -> Links:
    """Converts a leg into the arrays that compiled code reads: its D-H table, joints, constant parts and stops."""
    thigh, knee = leg.thigh.frame, leg.knee.frame
    return Links(
        table=np.array([[row.alpha, row.a, row.d, row.theta] for row in leg.rows]),
        turns=np.array([row.turns for row in leg.rows]),
        thigh=thigh,
        knee=knee,
        hip_parts=_constant_rotations(leg.rows[:thigh]),
        ankle_parts=_constant_rotations(leg.rows[knee:]),
        ankle_stops=np.array([row.stops for row in leg.rows[knee:] if row.turns]),
    )


def _constant_rotations(rows: tuple[DhRow, ...]) -> Array:
    """(joints + 1, 3, 3) constant rotations before, between and beyond the joints of consecutive rows of a table."""
    parts, rotation = [], np.eye(3)
    for row in rows:
        row_without_lengths = np.array([[row.alpha, 0.0, 0.0, row.theta]])  # a D-H table of one frame
        poses = forward(row_without_lengths, np.array([False]), np.empty(0))  # (1, 4, 4), without a joint's angle
        rotation = rotation @ poses[0, :3, :3]
        if row.turns:  # a joint rotates after the constant rotation of its row: the next part begins there
            parts.append(rotation)
            rotation = np.eye(3)
    return np.array([*parts, rotation])


@njit(**INNER_KERNEL)
def frame(alpha: float, a: float, d: float, theta: float) -> Array:
    """(4, 4) pose of a frame in the one before: Rx(alpha) Tx(a) Rz(theta) Tz(d), multiplied out.

    Shim 2019 (1), docs/contact_terrain.md (1).

    Args:
        alpha: Twist about x, rad.
        a: Distance along x, m.
        d: Distance along z, m.
        theta: Rotation about z, rad, the joint's angle included.
    """
    c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    T = identity(4)
    T[0, 0], T[0, 1], T[0, 3] = c, -s, a
    T[1, 0], T[1, 1], T[1, 2], T[1, 3] = s * ca, c * ca, -sa, -sa * d
    T[2, 0], T[2, 1], T[2, 2], T[2, 3] = s * sa, c * sa, ca, ca * d
    return T


@entry_kernel(_HERE)
def forward(table: Array, turns: Array, q: Array) -> Array:
    """(N, 4, 4) poses of all frames in frame 0, Shim 2019 (2): the product of the poses up to each frame.

    Args:
        table: (N, 4) alpha, a, d, theta of each frame.
        turns: (N,) bool, which frames a joint rotates.
        q: Angles of the joints in the order of the frames that they rotate, rad.
    """
    poses = np.empty((len(table), 4, 4))
    T, joint = identity(4), 0  # pose of the frame before; index of the next angle in q
    for i in range(len(table)):
        theta = table[i, 3]
        if turns[i]:
            theta += q[joint]
            joint += 1
        T = multiply(T, frame(table[i, 0], table[i, 1], table[i, 2], theta))
        copy_matrix(T, poses[i])
    return poses


@njit(**INNER_KERNEL)
def joint_angles(parts: Array, R: Array) -> Array:
    """Angles of n = 1-3 joints from the rotation that they and the parts between them make up, rad.

    docs/contact_terrain.md (2): R = C_0 Rz(q_1) C_1 ... Rz(q_n) C_n. The first and the last angle follow from where R
    takes the other one's axis; of three, the middle one from the angle between those two axes, the solution nearer to
    zero. Where R is no such product (two joints, real sensors), the residual is not distributed: each axis is placed as
    R gives it.

    Args:
        parts: (n + 1, 3, 3) constant rotations C.
        R: (3, 3) rotation from beyond the last joint to before the first.
    """
    n = len(parts) - 1
    M = multiply(multiply(transposed(parts[0]), R), transposed(parts[n]))  # Rz(q_1) C_1 ... Rz(q_n)
    q = np.empty(n)
    if n == 1:  # M is the rotation about z that is closest to R
        q[0] = math.atan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1])
        return q
    between = parts[1]  # rotation from the last joint to the first, with the middle joint's angle if there is one
    if n == 3:
        # M[2, 2], the cosine between the first and the last axis, is a cos q_2 + b sin q_2 + constant
        a = parts[1, 2, 0] * parts[2, 0, 2] + parts[1, 2, 1] * parts[2, 1, 2]
        b = parts[1, 2, 1] * parts[2, 0, 2] - parts[1, 2, 0] * parts[2, 1, 2]
        # with a = r cos m and b = r sin m that sum is r cos(q_2 - m) + constant: q_2 is m plus or minus `apart`
        middle, reach = math.atan2(b, a), math.hypot(a, b)
        cosine = max(-1.0, min(1.0, (M[2, 2] - parts[1, 2, 2] * parts[2, 2, 2]) / reach))
        apart = math.acos(cosine)
        first, second = _wrap_angle(middle + apart), _wrap_angle(middle - apart)
        q[1] = first if abs(first) < abs(second) else second
        turn = identity(3)  # Rz(q_2)
        turn[0, 0], turn[0, 1] = math.cos(q[1]), -math.sin(q[1])
        turn[1, 0], turn[1, 1] = math.sin(q[1]), math.cos(q[1])
        between = multiply(multiply(parts[1], turn), parts[2])
    # M = Rz(q_1) between Rz(q_n). So q_1 rotates the last axis about the first one, from column 2 of `between` to that
    # of M, and q_n rotates the first axis about the last one, from row 2 of M to that of `between`.
    q[0] = _wrap_angle(math.atan2(M[1, 2], M[0, 2]) - math.atan2(between[1, 2], between[0, 2]))
    q[n - 1] = _wrap_angle(math.atan2(between[2, 1], between[2, 0]) - math.atan2(M[2, 1], M[2, 0]))
    return q


@entry_kernel(_HERE)
def leg_angles(leg: Links, R: Array, side: int, knee: float) -> Array:
    """Angles of all joints of a leg, rad, in order: those of the hip, the knee's, those of the ankle.

    Shim 2019 (4)-(10): the hip's follow from the attitudes of back and thigh, the ankle's from those of thigh and foot.

    Args:
        leg: The leg's D-H table, joints and constant rotations.
        R: (5, 3, 3) frame to world, of the back, the left and the right thigh, and the left and the right foot.
        side: Index of the leg in `SIDES`, 0 left, 1 right.
        knee: Angle of the joint that rotates the knee's frame, rad.
    """
    R_world_thigh, R_world_foot = R[1 + side], R[3 + side]
    hip = joint_angles(leg.hip_parts, multiply(transposed(R[0]), R_world_thigh))
    # rotation from the thigh's frame to the knee's; lengths are not needed and left out as 0
    T_thigh_knee, R_thigh_knee = identity(4), np.empty((3, 3))
    for i in range(leg.thigh, leg.knee):
        theta = leg.table[i, 3] + (knee if leg.turns[i] else 0.0)
        T_thigh_knee = multiply(T_thigh_knee, frame(leg.table[i, 0], 0.0, 0.0, theta))
    for i in range(3):
        for j in range(3):
            R_thigh_knee[i, j] = T_thigh_knee[i, j]
    R_knee_foot = multiply(multiply(transposed(R_thigh_knee), transposed(R_world_thigh)), R_world_foot)
    ankle = joint_angles(leg.ankle_parts, R_knee_foot)
    q = np.empty(len(hip) + 1 + len(ankle))
    for i in range(len(hip)):
        q[i] = hip[i]
    q[len(hip)] = knee
    for i in range(len(ankle)):
        q[len(hip) + 1 + i] = ankle[i]
    return q


@entry_kernel(_HERE)
def at_stop(ankle_stops: Array, q: Array, margin: float) -> bool:
    """Whether at least one joint of the ankle is within a margin of one of its stops, or beyond it.

    Args:
        ankle_stops: (joints, 2) rad of `Links`.
        q: Angles of all joints, rad, from `leg_angles`.
        margin: Largest distance from a stop, rad.
    """
    for i in range(len(ankle_stops)):
        angle = q[len(q) - len(ankle_stops) + i]  # the ankle's joints are the last ones
        if angle < ankle_stops[i, 0] + margin or angle > ankle_stops[i, 1] - margin:
            return True
    return False


@njit(**INNER_KERNEL)
def _wrap_angle(angle: float) -> float:
    """The angle within [-π, π], rad."""
    return math.atan2(math.sin(angle), math.cos(angle))


# First index of each kind of offset in the filter's vector of offsets, and the length of that vector. The offsets are
# rotations of the frames of back, thighs and feet (rad, frame axes, 3 numbers each), the zeros of both knees (rad),
# lengths of thigh and shank of the left leg, then of the right one (m), and the sag of a loaded heel in its holder
# relative to push-off (m).
BACK, THIGH, FOOT, KNEE, LENGTH, SAG, OFFSETS = 0, 3, 9, 15, 17, 21, 22


@entry_kernel(_HERE)
def foot_position(leg: Links, R: Array, side: int, q: Array) -> tuple[Array, Array]:
    """Position of a foot's last frame relative to frame 0, in world axes, and its derivative by the offsets.

    The columns of the derivative begin at `BACK`, `THIGH`, `FOOT`, `KNEE` and `LENGTH`; from `THIGH` on, those of the
    left leg come before those of the right. Columns of the other leg, and `SAG`, are 0.

    Args:
        leg: The leg's D-H table, joints and constant rotations.
        R: (5, 3, 3) frame to world, of the back, the left and the right thigh, and the left and the right foot.
        side: Index of the leg in `SIDES`, 0 left, 1 right.
        q: Angles of all joints, rad, from `leg_angles`.

    Returns:
        (3,) m, origin of the last frame; (3, OFFSETS) its derivative by the offsets.
    """
    poses = forward(leg.table, leg.turns, q)
    # origins of the frames at the joints, relative to frame 0, world axes, m
    hip, at_knee = _rotate_column(R[0], poses[leg.thigh - 1], 3), _rotate_column(R[0], poses[leg.knee - 1], 3)
    ankle, foot = _rotate_column(R[0], poses[leg.knee], 3), _rotate_column(R[0], poses[len(poses) - 1], 3)
    thigh, shank = _vector_between(hip, at_knee), _vector_between(at_knee, ankle)
    axis = _rotate_column(R[0], poses[leg.knee - 1], 2)  # of the knee, world axes
    by_knee = apply(hat(axis), shank)  # derivative of the ankle's position by the knee's angle, m/rad
    thigh_m, shank_m = math.sqrt(dot(thigh, thigh)), math.sqrt(dot(shank, shank))
    # a rotation of one frame moves what this frame carries: the back the hip, the thigh the leg down to the ankle (the
    # shank's attitude is the thigh's with the knee's angle), the foot what lies beyond the ankle
    J = np.zeros((3, OFFSETS))
    _set_block(rotation_jacobian(hip, R[0]), J, BACK)
    _set_block(rotation_jacobian(_vector_between(hip, ankle), R[1 + side]), J, THIGH + 3 * side)
    _set_block(rotation_jacobian(_vector_between(ankle, foot), R[3 + side]), J, FOOT + 3 * side)
    for i in range(3):  # a longer thigh or shank moves the foot along that segment
        J[i, KNEE + side] = by_knee[i]
        J[i, LENGTH + 2 * side] = thigh[i] / thigh_m
        J[i, LENGTH + 2 * side + 1] = shank[i] / shank_m
    return foot, J


@entry_kernel(_HERE)
def rotation_jacobian(arm: Array, R: Array) -> Array:
    """(3, 3) derivative of a vector in the world by a small rotation of the frame that carries it: -[arm]× R.

    The rotation is a rotation vector (rad) in that frame's axes.

    Args:
        arm: (3,) m, the vector in the world.
        R: (3, 3) rotation, frame to world.
    """
    return multiply(transposed(hat(arm)), R)


@njit(**INNER_KERNEL)
def _rotate_column(R: Array, pose: Array, column: int) -> Array:
    """(3,) column of a (4, 4) pose, rotated by R; column 3 is the pose's origin."""
    v = np.empty(3)
    for i in range(3):
        v[i] = pose[i, column]
    return apply(R, v)


@njit(**INNER_KERNEL)
def _vector_between(a: Array, b: Array) -> Array:
    """(3,) vector from a to b."""
    v = np.empty(3)
    for i in range(3):
        v[i] = b[i] - a[i]
    return v


@njit(**INNER_KERNEL)
def _set_block(block: Array, J: Array, column: int) -> None:
    """Writes a (3, 3) block into the rows of J (3, n), from `column` on."""
    for i in range(3):
        for j in range(3):
            J[i, column + j] = block[i, j]
