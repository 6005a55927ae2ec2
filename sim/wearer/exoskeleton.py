"""The exoskeleton of Shim et al. 2019 (Sensors 19(20):4418): links, D-H table, ranges of motion and couplings.

The table is Craig's (modified) convention. Its frames 0-8 differ from this twin's bodies (x forward, y left, z up when
the wearer stands) by the constant rotations `R_DH_BODY`, and its angles from the twin's joints by the signs `DH_SIGNS`:
with all angles zero the leg hangs straight down in both.

The axis of hip ad-/abduction (z1, forward) and that of hip flexion (z5, to the left) cross in the anatomical hip centre
when L_hip3 = L_hip4 + L_hip5. The axis of hip rotation (z3, up) is beside the leg, L_hip2 from the centre. The
sliders P1 and P2 that the paper adds for this are not in its table; here the cuffs absorb their motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.wearer.anthropometry import Anthropometry
from stridetwin.streams.samples import Array

EXO_LEG_JOINTS = (
    "exo_hip_adduction", "exo_hip_rotation", "exo_hip_flexion", "exo_knee_flexion", "exo_ankle_dorsiflexion",
    "exo_ankle_inversion",
)  # fmt: skip
EXO_LEG_BODIES = ("exo_hip_abduction", "exo_hip_rotation", "exo_thigh", "exo_shank", "exo_ankle", "exo_foot")
DH_FRAMES = (1, 3, 5, 6, 7, 8)
"""Frame of the table at which each body of `EXO_LEG_BODIES` sits."""
DH_SIGNS = {"l": np.array([-1.0, -1, -1, 1, -1, -1]), "r": np.array([1.0, 1, -1, 1, -1, 1])}
"""(q1, q3, q5, q6, q7, q8) of the table over the angles of `EXO_LEG_JOINTS`."""
_PITCHING = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
R_DH_BODY = {
    0: np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    1: np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]),
    3: np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    5: _PITCHING,
    6: _PITCHING,
    7: _PITCHING,
    8: np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
}
"""Body axes (columns) in the axes of the D-H frame on that body."""

# Table 1 of the paper, in the order and with the signs of EXO_LEG_JOINTS; but its ankle has ±20 deg of dorsiflexion,
# where a wearer on stairs uses -36 to 38: a stop within that range would rotate the frame's foot off the shoe
RANGE_RAD = np.radians(np.array([[-30.0, 20], [-20, 20], [-25, 110], [-10, 110], [-50, 45], [-10, 10]]))

HOLE_SPACING_M = 0.010  # links are set in holes, so the fit to a person is never perfect
_HIP_ARM_M = 0.080  # L_hip3: the arm rises over the greater trochanter and descends to the hip's axis
_HIP_ROTOR_M = 0.030  # L_hip4
_CLEARANCE_M = 0.040  # from the skin to the middle of the bars beside the leg
_PANEL_M = 0.028  # from the skin of the back to the middle of the back panel, pad included


@dataclass(frozen=True, kw_only=True)
class ExoLinks:
    """Lengths of the paper's figures 2-4, m.

    Attributes:
        hip1: Middle of the back panel to the axis of hip abduction, sideways.
        hip2: Axis of hip abduction to the axis of hip rotation, sideways.
        hip3: Axis of hip abduction up to the hip's arm.
        hip4: The arm down to the rotor of hip rotation.
        hip5: The rotor down to the axis of hip flexion.
        hip6: Back panel forward to the hip.
        thigh: Hip flexion to knee.
        shank: Knee to ankle.
        ankle1: Axis of dorsiflexion back to the heel holder.
        ankle2: Bar beside the shank inwards to the axis of inversion.
    """

    hip1: float
    hip2: float
    hip3: float
    hip4: float
    hip5: float
    hip6: float
    thigh: float
    shank: float
    ankle1: float
    ankle2: float


@dataclass(frozen=True, kw_only=True)
class DhRow:
    """One row of the table: Rx(alpha) Tx(a) Rz(theta + q) Tz(d).

    Attributes:
        alpha: rad, twist before this frame.
        a: m, along the x axis of the frame before.
        d: m, along this frame's z axis.
        theta: rad, added to the joint's angle.
        joint: Which of the six angles rotates this frame; None for the two virtual frames.
    """

    alpha: float
    a: float
    d: float
    theta: float
    joint: int | None


def fit_links(body: Anthropometry, girth: float, ankle_x: float, heel_back_x: float) -> ExoLinks:
    """Links fitted to a person, as closely as the holes allow.

    Args:
        body: The wearer's dimensions.
        girth: Thickness of trunk and limbs over that of the mean person.
        ankle_x: Ankle's axis in the foot's frame, m.
        heel_back_x: Back of the heel in the foot's frame, m.
    """
    beside = _next_hole(0.078 * girth + _CLEARANCE_M)
    return ExoLinks(
        hip1=_nearest_hole(body.hip_half_width_m), hip2=beside, hip3=_HIP_ARM_M, hip4=_HIP_ROTOR_M,
        hip5=_HIP_ARM_M - _HIP_ROTOR_M, hip6=_next_hole(body.trunk_m / 0.826 * 0.045 + 0.085 * girth + _PANEL_M),
        thigh=_nearest_hole(body.thigh_m), shank=_nearest_hole(body.shank_m), ankle1=ankle_x - heel_back_x,
        ankle2=beside,
    )  # fmt: skip


def dh_table(links: ExoLinks, side: str) -> tuple[DhRow, ...]:
    """Rows 1-8 of table 2 of the paper for the leg `l` or `r`."""
    s, half = outward(side), math.pi / 2
    rows = (
        (0.0, s * links.hip1, links.hip6, half, 0),
        (half, links.hip3, s * links.hip2, half, None),
        (half, 0.0, -links.hip4, half, 1),
        (half, 0.0, 0.0, -half, None),
        (-half, links.hip5, 0.0, 0.0, 2),
        (0.0, links.thigh, 0.0, 0.0, 3),
        (0.0, links.shank, -s * links.ankle2, 0.0, 4),
        (half, 0.0, -links.ankle1, 0.0, 5),
    )
    return tuple(DhRow(alpha=alpha, a=a, d=d, theta=theta, joint=joint) for alpha, a, d, theta, joint in rows)


def forward_kinematics(links: ExoLinks, side: str, q: Array) -> Array:
    """(..., 8, 4, 4) poses of frames 1-8 in frame 0: equations (1) and (2) of the paper.

    Args:
        links: Lengths.
        side: `l` or `r`.
        q: (..., 6) rad, the table's (q1, q3, q5, q6, q7, q8).
    """
    T, frames = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4)), []
    for row in dh_table(links, side):
        angle = row.theta + (0.0 if row.joint is None else q[..., row.joint])
        T = T @ _craig(row, np.broadcast_to(angle, q.shape[:-1]))
        frames.append(T)
    return np.stack(frames, -3)


def frame_0_in_pelvis(links: ExoLinks) -> Array:
    """(4, 4) pose of the D-H frame 0 in the pelvis' frame: the hip's axes meet the line of the hip centres."""
    T = np.eye(4)
    T[:3, :3] = R_DH_BODY[0].T
    T[:3, 3] = [-links.hip6, 0.0, links.hip4 + links.hip5 - links.hip3]
    return T


def chain(links: ExoLinks, side: str) -> tuple[Array, Array]:
    """(6, 3) origin of each body of `EXO_LEG_BODIES` in its parent's frame, m, and (6, 3) the axis of its joint.

    The same leg as `dh_table` in this twin's body axes; the first parent is the pelvis.
    """
    s = outward(side)
    offsets = [
        [0.0, s * links.hip1, links.hip4 + links.hip5 - links.hip3],
        [0.0, s * links.hip2, links.hip3 - links.hip4],
        [0.0, 0.0, -links.hip5],
        [0.0, 0.0, -links.thigh],
        [0.0, -s * links.ankle2, -links.shank],
        [-links.ankle1, 0.0, 0.0],
    ]
    axes = [[-s, 0, 0], [0, 0, -s], [0, -1, 0], [0, 1, 0], [0, -1, 0], [-s, 0, 0]]
    return np.array(offsets), np.array(axes, dtype=float)


CUFF_SHARE = {"thigh": 0.51, "shank": 0.43}
"""Distance of a cuff from the top of its segment."""


def _craig(row: DhRow, angle: Array) -> Array:
    c, s, ca, sa = np.cos(angle), np.sin(angle), math.cos(row.alpha), math.sin(row.alpha)
    T = np.zeros((*angle.shape, 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 3] = c, -s, row.a
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = s * ca, c * ca, -sa, -sa * row.d
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2], T[..., 2, 3] = s * sa, c * sa, ca, ca * row.d
    T[..., 3, 3] = 1.0
    return T


def outward(side: str) -> float:
    """Sign of the outward direction along y: 1 for `l`, -1 for `r`."""
    return 1.0 if side == "l" else -1.0


def _nearest_hole(length: float) -> float:
    return round(length / HOLE_SPACING_M) * HOLE_SPACING_M


def _next_hole(length: float) -> float:
    return math.ceil(length / HOLE_SPACING_M) * HOLE_SPACING_M
