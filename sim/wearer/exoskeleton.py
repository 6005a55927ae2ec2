"""The exoskeleton of Shim et al. 2019 (Sensors 19(20):4418): links, D-H table, ranges of motion and actuation modules.

The table is Craig's (modified) convention. Its frames 0-8 differ from this twin's bodies (x forward, y left, z up when
the wearer stands) by the constant rotations `R_DH_BODY`, and its angles from the twin's joints by the signs `DH_SIGNS`:
with all angles zero the leg hangs straight down in both.

The axis of hip ad-/abduction (z1, forward) and that of hip flexion (z5, to the left) cross in the anatomical hip centre
when L_hip3 = L_hip4 + L_hip5. The axis of hip rotation (z3, up) is beside the leg, L_hip2 from the centre. The
sliders P1 and P2 that the paper adds for this are not in its table; here the cuffs absorb their motion.

An actuation module, a motor with a strain wave gear beside a hip or knee (2.1.3 of the paper), is bolted to the link
above its joint. An unpowered module still acts on the joint: its rotor turns with the joint, and its gear has friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import SIDES, Exo
from stridetwin.sim.exo_description import Module
from stridetwin.sim.wearer.anthropometry import Anthropometry, leaf_scales
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

# hinges of a leg of the frame, and the bodies that they move, from the pelvis to the foot; names without the side
EXO_LEG_JOINTS = (
    "exo_hip_adduction",
    "exo_hip_rotation",
    "exo_hip_flexion",
    "exo_knee_flexion",
    "exo_ankle_dorsiflexion",
    "exo_ankle_inversion",
)
EXO_LEG_BODIES = ("exo_hip_abduction", "exo_hip_rotation", "exo_thigh", "exo_shank", "exo_ankle", "exo_foot")
DH_SIGNS = {"l": np.array([-1.0, -1, -1, 1, -1, -1]), "r": np.array([1.0, 1, -1, 1, -1, 1])}
"""(q1, q3, q5, q6, q7, q8) of the table over the angles of `EXO_LEG_JOINTS`."""
# body axes (columns) in the axes of a D-H frame whose joint pitches: hip flexion, knee and ankle
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

CUFF_SHARE = {"thigh": 0.51, "shank": 0.43}
"""Distance of a cuff from the top of its segment, as a share of it."""
_HOLE_SPACING_M = 0.010  # links are set in holes, so the fit to a person is never perfect
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
    # lengths of links that follow from the thickness of the body are rounded up, so that nothing presses on it
    beside = _next_hole(0.078 * girth + _CLEARANCE_M)  # 0.078 m: the mean person's leg, from its middle outwards
    # from the hips back to the skin: a part that grows with the trunk, 0.045 m at 0.826 m, and one with the girth
    to_back = leaf_scales(body)["trunk"] * 0.045 + 0.085 * girth
    return ExoLinks(
        hip1=_nearest_hole(body.hip_half_width_m),
        hip2=beside,
        hip3=_HIP_ARM_M,
        hip4=_HIP_ROTOR_M,
        hip5=_HIP_ARM_M - _HIP_ROTOR_M,
        hip6=_next_hole(to_back + _PANEL_M),
        thigh=_nearest_hole(body.thigh_m),
        shank=_nearest_hole(body.shank_m),
        ankle1=ankle_x - heel_back_x,
        ankle2=beside,
    )


def dh_table(links: ExoLinks, side: str) -> tuple[DhRow, ...]:
    """Denavit-Hartenberg rows 1-8 of the leg `l` or `r`, table 2 of Shim et al. 2019."""
    s, half = outward(side), math.pi / 2
    # alpha, a, d, theta, joint
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


def chain(links: ExoLinks, side: str) -> tuple[Array, Array]:
    """Offsets and joint axes of a leg in the twin's body axes, with the kinematics of `dh_table`.

    Returns:
        (6, 3) m, origin of each body of `EXO_LEG_BODIES` in its parent's frame, the pelvis being the first parent; and
        (6, 3) axis of its joint, about which a positive angle is that of `dh_table`. The pelvis' origin is midway
        between the hip centres, and `hip6`, from there back to the panel, is no part of the leg.
    """
    s = outward(side)
    # one row per body: hip abduction, hip rotation, thigh, shank, ankle, foot
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


def outward(side: str) -> float:
    """Sign of the outward direction along y: 1 for `l`, -1 for `r`."""
    return 1.0 if side == "l" else -1.0


def _nearest_hole(length: float) -> float:
    """Length of a link that is set in the hole nearest to the wanted length, m."""
    return round(length / _HOLE_SPACING_M) * _HOLE_SPACING_M


def _next_hole(length: float) -> float:
    """Length of a link that is set in the first hole at or beyond the wanted length, m."""
    return math.ceil(length / _HOLE_SPACING_M) * _HOLE_SPACING_M


JOINTS = tuple(f"{joint}_{side}" for joint in ("hip", "knee") for side in SIDES)
FRICTION_SPEED_RADPS = 0.2
"""Joint speed at which dry friction reaches three quarters of its full value."""


# Gears, motors (Kollmorgen TBMS-6025-B and -6013-B, Harmonic Drive SHD-20-2SH) and the 6.0 kg of all four are the
# paper's; it gives no figures of the parts. The rotors are estimated as steel rings of 18 by 31 mm, 5 mm longer than
# the stacks (25 and 13 mm): 1.9e-5 and 1.1e-5 kg m², plus 0.9e-5 for the wave generator. The friction is of the
# order at which gears of this size can be driven backwards; torque and speed (6500 rpm in) are typical of their class.
HIP = Module(
    gear=100, rotor_inertia=2.8e-5, friction_nm=4.0, viscous_nms=1.5, torque_max_nm=57, speed_max_radps=6.8, mass_kg=1.6
)
KNEE = Module(
    gear=80, rotor_inertia=2.0e-5, friction_nm=3.5, viscous_nms=1.0, torque_max_nm=53, speed_max_radps=8.5, mass_kg=1.4
)

# by mode: the sets of joints that may be powered
_CHOICES: dict[int, tuple[tuple[str, ...], ...]] = {
    0: ((),),
    1: (JOINTS,),
    2: (("hip_l", "hip_r"), ("knee_l", "knee_r")),
    3: (("hip_l", "knee_l"), ("hip_r", "knee_r")),
    4: tuple((joint,) for joint in JOINTS),
}


def modules(exo: Exo) -> dict[str, Module]:
    """Modules by joint (`hip_l`, `knee_r`, ...) of an exoskeleton in its mode (figure 12 of the paper).

    Raises:
        ConfigError: Unknown mode, joints that the mode does not power, or assistance of hips that have no modules.
    """
    if exo.user_exo is not None:
        if exo.drive == "assist" and not {"hip_l", "hip_r"} <= set(exo.user_exo.modules):
            raise ConfigError("exo", "drive", exo.drive, f"idle, or motors.hip_l and .hip_r in {exo.user_exo.rig}")
        return dict(exo.user_exo.modules)
    if exo.mode not in _CHOICES:
        raise ConfigError("exo", "mode", exo.mode, ", ".join(map(str, _CHOICES)))
    choices = _CHOICES[exo.mode]
    chosen = exo.joints or (choices[0] if len(choices) == 1 else ())
    # the order does not matter, but no joint may be named twice
    if set(chosen) not in map(set, choices) or len(set(chosen)) != len(chosen):
        valid = " or ".join(f"[{', '.join(choice)}]" for choice in choices)
        raise ConfigError("exo", "joints", list(exo.joints), f"{valid} in mode {exo.mode}")
    if exo.drive == "assist" and not {"hip_l", "hip_r"} <= set(chosen):
        raise ConfigError("exo", "drive", exo.drive, "idle, or a mode that powers both hips")
    return {joint: HIP if joint.startswith("hip") else KNEE for joint in chosen}
