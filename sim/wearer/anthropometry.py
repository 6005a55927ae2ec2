"""Body segments from height and mass: de Leva 1996, J. Biomech. 29(9):1223-1230, table 4.

Lengths scale with height, masses with body mass; centres of mass and radii of gyration are fractions of the segment's
length. Segments run from proximal to distal, with x forward, y left, z up in the segment's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.people import Person, Segments
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

# mass %, length mm, centre of mass % of length from the proximal end, radii of gyration % (sagittal, transverse,
# longitudinal axis: about x, y, z here)
_TABLE: dict[str, dict[str, tuple[float, ...]]] = {
    "male": {
        "head": (6.94, 203.3, 59.76, 36.2, 37.6, 31.2),
        "upper_trunk": (15.96, 170.7, 29.99, 71.6, 45.4, 65.9),
        "middle_trunk": (16.33, 215.5, 45.02, 48.2, 38.3, 46.8),
        "lower_trunk": (11.17, 145.7, 61.15, 61.5, 55.1, 58.7),
        "upper_arm": (2.71, 281.7, 57.72, 28.5, 26.9, 15.8),
        "forearm": (1.62, 268.9, 45.74, 27.6, 26.5, 12.1),
        "hand": (0.61, 86.2, 79.00, 62.8, 51.3, 40.1),
        "thigh": (14.16, 422.2, 40.95, 32.9, 32.9, 14.9),
        "shank": (4.33, 434.0, 44.59, 25.5, 24.9, 10.3),
        "foot": (1.37, 258.1, 44.15, 25.7, 24.5, 12.4),
    },
    "female": {
        "head": (6.68, 200.2, 58.94, 33.0, 35.9, 31.8),
        "upper_trunk": (15.45, 142.5, 20.77, 74.6, 50.2, 71.8),
        "middle_trunk": (14.65, 205.3, 45.12, 43.3, 35.4, 41.5),
        "lower_trunk": (12.47, 181.5, 49.20, 43.3, 40.2, 44.4),
        "upper_arm": (2.55, 275.1, 57.54, 27.8, 26.0, 14.8),
        "forearm": (1.38, 264.3, 45.59, 26.1, 25.7, 9.4),
        "hand": (0.56, 78.0, 74.74, 53.1, 45.4, 33.5),
        "thigh": (14.78, 368.5, 36.12, 36.9, 36.4, 16.2),
        "shank": (4.81, 432.3, 44.16, 27.1, 26.7, 9.3),
        "foot": (1.29, 228.3, 40.14, 29.9, 27.9, 13.9),
    },
}
_STATURE_M = {"male": 1.741, "female": 1.735}  # of the mean person of the table
_HIP_HALF_WIDTH = 0.050  # of stature, between the hip centres / 2
_ANKLE_HEIGHT = 0.043  # of stature, ankle centre above the bare sole
LEAF_LENGTHS_M = {
    "trunk": 0.826, "thigh": 0.4222, "shank": 0.4340, "upper_arm": 0.2817, "forearm": 0.2689, "shoe": 0.270,
}  # fmt: skip
"""Lengths of the mean person's segments in the leaf files (`assets/mjcf`), m."""
_SHOULDER_HALF_WIDTH = 0.185 / LEAF_LENGTHS_M["trunk"]  # of the trunk's length (trunk.xml)
_FOOT_LENGTH = 0.148  # of stature
SHOE_OVER_FOOT_M = 0.012  # outer length of the shoe over the foot's
SHOE_SOLE_M = 0.025  # thickness of the sole under the foot


@dataclass(frozen=True, kw_only=True, eq=False)
class MassProperties:
    """Mass properties of a body.

    Attributes:
        mass: kg.
        com: (3,) m, centre of mass in the body's frame.
        inertia: (3,) kg m², moments of inertia about the centre of mass and the body's axes.
    """

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Anthropometry:
    """Dimensions and masses of one person (shoes on).

    Attributes:
        thigh_m: Hip centre to knee centre.
        shank_m: Knee centre to ankle centre.
        upper_arm_m: Shoulder centre to elbow centre.
        forearm_m: Elbow centre to wrist centre.
        ankle_height_m: Ankle centre above the shoe's sole.
        hip_half_width_m: Half the distance of the hip centres.
        shoe_length_m: Outer length of the shoe.
        trunk_m: Hip centres to the top of the head.
        shoulder_half_width_m: Half the distance of the shoulder centres.
        shank_twist_rad: Turn of the foot outward against the knee.
        inertials: Mass properties by body: pelvis, torso, head, upper_arm, forearm, hand, thigh, shank, foot, toe.
    """

    thigh_m: float
    shank_m: float
    upper_arm_m: float
    forearm_m: float
    ankle_height_m: float
    hip_half_width_m: float
    shoe_length_m: float
    trunk_m: float
    shoulder_half_width_m: float
    shank_twist_rad: float
    inertials: dict[str, MassProperties]


def anthropometry(person: Person) -> Anthropometry:
    """Dimensions and mass properties of `person`.

    Raises:
        ConfigError: Height, mass, sex or shoe size outside the range of the tables.
    """
    for field, is_valid, valid in (
        ("height_m", 1.50 <= person.height_m <= 1.95, "1.50-1.95"),
        ("mass_kg", 45.0 <= person.mass_kg <= 110.0, "45-110"),
        ("sex", person.sex in _TABLE, "male, female"),
        ("shoe_m", person.shoe_m is None or 0.20 <= person.shoe_m <= 0.32, "0.20-0.32"),
    ):
        if not is_valid:
            raise ConfigError("person", field, getattr(person, field), valid)
    # `k` scales the table's lengths to this person
    table, k = _TABLE[person.sex], person.height_m / _STATURE_M[person.sex]

    own = person.segments or Segments()
    measured = {"thigh": own.thigh_m, "shank": own.shank_m, "upper_arm": own.upper_arm_m, "forearm": own.forearm_m}

    def length(name: str) -> float:
        """Length of a segment of this person, m: the measured one, or that of the table."""
        return measured.get(name) or table[name][1] * 1e-3 * k

    def segment(name: str, z_proximal: float) -> MassProperties:
        """Segment that hangs down (−z) from a proximal end at height `z_proximal` of its body's frame."""
        # %: share of the body mass; place of the centre of mass from the proximal end, and radii of gyration, as shares
        # of the length
        percent, _, com, *radii = table[name]
        mass, size = person.mass_kg * percent / 100.0, length(name)
        return MassProperties(
            mass=mass,
            com=np.array([0.0, 0.0, z_proximal - com / 100.0 * size]),
            inertia=mass * (np.array(radii) / 100.0 * size) ** 2,
        )

    bare_ankle = _ANKLE_HEIGHT * person.height_m
    trunk = own.trunk_m or person.height_m - bare_ankle - length("shank") - length("thigh")
    lumbar = trunk * 0.133  # where the torso's joint sits above the hip centres (trunk.xml)
    lower = length("lower_trunk")  # heights above the hip centres of the tops of the lower and the middle trunk
    middle = lower + length("middle_trunk")
    torso = _combine(
        segment("middle_trunk", middle - lumbar),
        segment("upper_trunk", middle + length("upper_trunk") - lumbar),
    )
    foot = segment("foot", 0.0)
    # part of the foot in front of the toe hinge; its share of the mass, the shares of the inertia and the centres of
    # mass below are chosen by hand
    toe_mass = 0.12 * foot.mass
    # the table's foot hangs along z; in the body's frame it lies along x
    lying_inertia = np.array([foot.inertia[2], foot.inertia[0], foot.inertia[1]])
    inertials = {
        "pelvis": segment("lower_trunk", lower),
        "torso": torso,
        "head": segment("head", 0.286 * trunk),  # from its top, this far above the neck's joint (trunk.xml)
        "upper_arm": segment("upper_arm", 0.0),
        "forearm": segment("forearm", 0.0),
        "hand": segment("hand", 0.0),
        "thigh": segment("thigh", 0.0),
        "shank": segment("shank", 0.0),
        "foot": MassProperties(
            mass=foot.mass - toe_mass, com=np.array([0.050, 0.0, 0.045]), inertia=0.7 * lying_inertia
        ),
        "toe": MassProperties(mass=toe_mass, com=np.array([0.030, 0.0, 0.0]), inertia=0.05 * lying_inertia),
    }
    return Anthropometry(
        thigh_m=length("thigh"),
        shank_m=length("shank"),
        upper_arm_m=length("upper_arm"),
        forearm_m=length("forearm"),
        ankle_height_m=own.ankle_height_m or bare_ankle + SHOE_SOLE_M,
        hip_half_width_m=own.hip_width_m / 2 if own.hip_width_m else _HIP_HALF_WIDTH * person.height_m,
        shoe_length_m=(person.shoe_m or _FOOT_LENGTH * person.height_m) + SHOE_OVER_FOOT_M,
        trunk_m=trunk,
        shoulder_half_width_m=own.shoulder_width_m / 2 if own.shoulder_width_m else _SHOULDER_HALF_WIDTH * trunk,
        shank_twist_rad=own.shank_twist_rad or 0.0,
        inertials=inertials,
    )


def leaf_scales(body: Anthropometry) -> dict[str, float]:
    """Length of each segment of a person over that of the leaf files, by the names of `LEAF_LENGTHS_M`."""
    lengths = {
        "trunk": body.trunk_m,
        "thigh": body.thigh_m,
        "shank": body.shank_m,
        "upper_arm": body.upper_arm_m,
        "forearm": body.forearm_m,
        "shoe": body.shoe_length_m,
    }
    return {name: lengths[name] / leaf_m for name, leaf_m in LEAF_LENGTHS_M.items()}


def compute_girth(person: Person) -> float:
    """Thickness of trunk and limbs over that of the mean person of 73 kg and 1.741 m, as mass ~ height · girth²."""
    return float(np.sqrt((person.mass_kg / 73.0) / (person.height_m / 1.741)))


def _combine(a: MassProperties, b: MassProperties) -> MassProperties:
    """Mass properties of two bodies together, in their common frame, by the parallel-axis theorem.

    The centres of mass lie on one axis of the frame, so that no products of inertia arise.
    """
    mass = a.mass + b.mass
    com = (a.mass * a.com + b.mass * b.com) / mass
    inertia = np.zeros(3)
    for part in (a, b):
        # about each axis: mass times the sum of the squared distances along the two others
        squared = (part.com - com) ** 2
        inertia += part.inertia + part.mass * (squared.sum() - squared)
    return MassProperties(mass=mass, com=com, inertia=inertia)
