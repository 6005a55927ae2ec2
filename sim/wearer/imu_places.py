"""Where IMUs are worn on the body: by default at the places of wearable sensor sets, flat on clothes or shoe.

The places are those of full-body sets (sacrum, sternum, head, and laterally upper arms, wrists or hands, thighs and
shanks; Roetenberg, Luinge & Slycke 2009, Xsens MVN) and of foot sensors (instep, heel cap, beside the ankle). They
scale with the wearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.choices import BODY_PLACES
from stridetwin.sim.people import Person
from stridetwin.sim.wearer.anthropometry import anthropometry, compute_girth, leaf_scales
from stridetwin.streams.samples import Array

_HALF_CASE_M = 0.006  # half the thickness of a housing (`imu_pod.xml`)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A place on a segment of the mean person of the leaf files (`assets/mjcf`), on the left where it has a side.

    Attributes:
        body: Segment, without the side.
        within_m: Point inside the segment, in its frame: forward, left, up.
        axis: Axis along which the surface is reached from there: 0 forward, 1 left, 2 up.
        reach_m: Distance to the surface along that axis, negative the other way.
    """

    body: str
    within_m: tuple[float, float, float]
    axis: int
    reach_m: float


_PLACES = {
    "pelvis": _Place(body="pelvis", within_m=(-0.010, 0.0, 0.050), axis=0, reach_m=-0.103),  # sacrum
    "chest": _Place(body="torso", within_m=(0.012, 0.0, 0.340), axis=0, reach_m=0.105),  # sternum
    "head": _Place(body="head", within_m=(-0.003, 0.0, 0.137), axis=0, reach_m=-0.093),  # on a head band, behind
    "upper_arm": _Place(body="upper_arm", within_m=(0.0, 0.0, -0.200), axis=1, reach_m=0.046),  # lateral, distal
    "wrist": _Place(body="forearm", within_m=(0.0, 0.0, -0.230), axis=1, reach_m=0.038),  # dorsal, as a watch
    "hand": _Place(body="hand", within_m=(0.004, 0.0, -0.060), axis=1, reach_m=0.020),  # back of the hand
    "thigh": _Place(body="thigh", within_m=(0.004, 0.0, -0.300), axis=1, reach_m=0.078),  # lateral, distal third
    "shank": _Place(body="shank", within_m=(0.0, 0.0, -0.260), axis=1, reach_m=0.043),  # lateral, below the calf
    "instep": _Place(body="foot", within_m=(0.110, 0.0, 0.044), axis=2, reach_m=0.035),  # on the laces
    "heel": _Place(body="foot", within_m=(0.008, 0.0, 0.052), axis=0, reach_m=-0.050),  # heel cap
    # beside the ankle, where the recorded people of docs/transfer.md wore it
    "ankle": _Place(body="foot", within_m=(0.033, 0.0, 0.046), axis=1, reach_m=0.033),
}


def split_side(place: str) -> tuple[str, str]:
    """Name of a place without its side, and the side, `l` or `r`, or "" in the middle of the body."""
    name, _, side = place.rpartition("_")
    return (name, side) if side in ("l", "r") else (place, "")


def body_of(place: str) -> str:
    """Body of the model that carries a place, such as `forearm_l` for `wrist_l`."""
    name, side = split_side(place)
    return f"{_PLACES[name].body}_{side}" if side else _PLACES[name].body


def thin_axis(place: str) -> int:
    """Axis of a place's frame across which its housing is thin: 0 forward, 1 left, 2 up."""
    return _PLACES[split_side(place)[0]].axis


def default_position(place: str, person: Person) -> Array:
    """(3,) m, standard position of an IMU at a place of a person, in its segment: forward, outward, up.

    In the middle of the body, left stands for outward.
    """
    name, _ = split_side(place)
    standard, body = _PLACES[name], anthropometry(person)
    # the trunk's scale is that of all its parts; a shoe is stretched along the foot alone
    scales = leaf_scales(body)
    segment = "trunk" if standard.body in ("pelvis", "torso", "head") else standard.body
    length = scales.get(segment, 1.0)
    position = length * np.array(standard.within_m)
    if name == "instep":  # in front of the heel
        position[0] *= scales["shoe"]
    girth = 1.0 if standard.body == "foot" else compute_girth(person)
    position[standard.axis] += girth * standard.reach_m + np.copysign(_HALF_CASE_M, standard.reach_m)
    return position


assert {split_side(place)[0] for place in BODY_PLACES} == set(_PLACES)
