"""A compliant coupling between the exoskeleton and the wearer: strap, soft tissue, heel holder.

The strain is the position of the wearer's attachment point relative to the exoskeleton's, in the exoskeleton body's
axes, and the vector part of the relative rotation. Both give an elastic energy whose gradient is the wrench. Force and
counterforce act at one point, the wearer's, so that a coupling adds neither momentum nor angular momentum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.streams.samples import Array
from stridetwin.streams.so3 import cross


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """Spring and damper between a body of the exoskeleton and one of the wearer.

    Attributes:
        name: `thigh_l`, `shank_l`, `heel_l`, ...
        exo_body: Body of the exoskeleton.
        body: Body of the wearer.
        p_in_exo: (3,) m, attachment in the exoskeleton body's frame.
        p_in_body: (3,) m, attachment in the wearer's body frame.
        stiffness: (3, 3) N/m, exoskeleton body's axes.
        damping: (3, 3) N s/m, likewise.
        rotation_stiffness: (3, 3) N m/rad, likewise.
        rotation_damping: (3, 3) N m s/rad, likewise.
    """

    name: str
    exo_body: str
    body: str
    p_in_exo: Array
    p_in_body: Array
    stiffness: Array
    damping: Array
    rotation_stiffness: Array
    rotation_damping: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Pose and twist of a body in any common frame.

    Attributes:
        p: (..., 3) m, origin.
        R: (..., 3, 3) body to common frame.
        v: (..., 3) m/s of the origin.
        w: (..., 3) rad/s, common axes.
    """

    p: Array
    R: Array
    v: Array
    w: Array


def strain(c: Coupling, p_exo: Array, R_exo: Array, p_body: Array, R_body: Array) -> tuple[Array, Array, Array, Array]:
    """Displacement and rotation of a coupling.

    Args:
        c: The coupling.
        p_exo: (..., 3) m, origin of the exoskeleton's body in a common frame.
        R_exo: (..., 3, 3) its rotation.
        p_body: (..., 3) m, origin of the wearer's body.
        R_body: (..., 3, 3) its rotation.

    Returns:
        (..., 3) displacement of the wearer's point, m, and (..., 3) vector part of the relative rotation
        (sine of the angle), both in the exoskeleton body's axes; (..., 3, 3) derivative of that vector by the relative
        rotation; and (..., 3) the point where the force acts, in the common frame.
    """
    point = p_body + R_body @ c.p_in_body
    displacement = np.einsum("...ji,...j->...i", R_exo, point - p_exo) - c.p_in_exo
    R = np.swapaxes(R_exo, -1, -2) @ R_body
    turn = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    trace = np.trace(R, axis1=-2, axis2=-1)[..., None, None]
    return displacement, turn, 0.5 * (trace * np.eye(3) - R), point


def wrench(c: Coupling, exo: Pose, body: Pose) -> tuple[Array, Array, Array]:
    """Wrench of the wearer on the exoskeleton; the exoskeleton exerts the opposite on the wearer.

    Args:
        c: The coupling.
        exo: Motion of the exoskeleton's body.
        body: Motion of the wearer's body.

    The elastic part is the gradient of ½ dᵀ K d + ½ rᵀ K_turn r in the strains d and r.

    Returns:
        (..., 3) force, N, and (..., 3) torque, N m, in the common axes, and (..., 3) the point where the force acts.
    """
    displacement, turn, change, point = strain(c, exo.p, exo.R, body.p, body.R)
    relative = body.v + cross(body.w, point - body.p) - exo.v - cross(exo.w, point - exo.p)
    rate = np.einsum("...ji,...j->...i", exo.R, relative)
    turning = np.einsum("...ij,...kj,...k->...i", change, exo.R, body.w - exo.w)
    force = displacement @ c.stiffness.T + rate @ c.damping.T
    torque = np.einsum("...ji,...j->...i", change, turn @ c.rotation_stiffness.T + turning @ c.rotation_damping.T)
    return np.einsum("...ij,...j->...i", exo.R, force), np.einsum("...ij,...j->...i", exo.R, torque), point
