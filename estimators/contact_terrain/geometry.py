"""The calibration of an exoskeleton, read from a file: D-H table, sensor mounts, soles and compliance.

Another exoskeleton needs only another file; `docs/contact_terrain.md` explains each key. Angles are
degrees in the file (`_deg`) and radians here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.samples import Array
from stridetwin.streams.yaml_file import Dumper
from stridetwin.streams.yaml_node import Node, parse_node, read_node

SIDES = ("l", "r")
METADATA_KEY = "exoskeleton"
"""Key of the geometry file in a recording's metadata."""
_JOINTS_MAX = 3


@dataclass(frozen=True, kw_only=True)
class DhRow:
    """One row of a modified (Craig's) D-H table: Rx(alpha) Tx(a) Rz(theta + q) Tz(d).

    Attributes:
        alpha: rad, twist before this frame.
        a: m, along the x axis of the frame before.
        d: m, along this frame's z axis.
        theta: rad, added to the joint's angle.
        turns: Whether a joint rotates this frame.
        stops: rad, smallest and largest angle of that joint; infinite if not given.
    """

    alpha: float
    a: float
    d: float
    theta: float
    turns: bool
    stops: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Attitude:
    """An AHRS on a frame of the table.

    Attributes:
        topic: Its stream.
        frame: Number of the frame that carries it; 0 is the back panel.
        R_frame_sensor: (3, 3) rotation, sensor to frame.
    """

    topic: str
    frame: int
    R_frame_sensor: Array


@dataclass(frozen=True, kw_only=True)
class Knee:
    """The encoder of the joint between thigh and shank.

    Attributes:
        topic: Its stream.
        frame: Number of the frame that it rotates.
        sign: q = sign · angle.
    """

    topic: str
    frame: int
    sign: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Sole:
    """The sole and its insole.

    Attributes:
        topic: Stream of the insole.
        T_foot_sole: (4, 4) pose of the sole in the last frame: x forward, y left, z up, the ground at z = 0.
        cells: (4, 2) m, places of the cells heel, lateral ball, medial ball and toe on the sole.
        heel_x: Back edge, m.
        hinge_x: Axis about which the toes bend: forward, m.
        hinge_z: The same above the ground, m; also the radius with which the forefoot rolls.
        tip_x: Tip of the toes, m.
    """

    topic: str
    T_foot_sole: Array
    cells: Array
    heel_x: float
    hinge_x: float
    hinge_z: float
    tip_x: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """One leg.

    Attributes:
        rows: D-H table from the back panel, frame 0, to the foot, the last frame.
        thigh: AHRS on the thigh.
        knee: Encoder.
        foot: AHRS on the foot.
        sole: Sole and insole.
    """

    rows: tuple[DhRow, ...]
    thigh: Attitude
    knee: Knee
    foot: Attitude
    sole: Sole


@dataclass(frozen=True, kw_only=True)
class Compliance:
    """Compliance of an exoskeleton under its wearer.

    The defaults describe the twin's exoskeleton (holder of the heel 15 kN/m, cuffs 4 kN/m, `sim/wearer/coupling.py`)
    and serve files and recordings without a section `compliance`. They were chosen by hand on simulated walks of S1-S3,
    seeds 0-16 (docs/contact_terrain.md); another exoskeleton needs its own.
    """

    vector_sd_m: tuple[float, float, float] = (0.006, 0.006, 0.002)
    """Standard deviation of a step's vector, x, y, z, from slack in the heel holder and soft soles."""
    sag_sd_m: float = 0.006
    """Standard deviation of a loaded heel's sag in its holder, relative to push-off."""
    climb_share: float = 0.04
    """Yielding of holder and cuffs under the lifting leg, as a share of the height climbed."""
    slope_sd_rad: float = math.radians(0.32)
    """Standard deviation of a foot's pitch in its holder: a foot is never exactly flat."""
    slope_share: float = 0.06
    """The same as a share of the slope: the steeper the ground, the more the holder yields."""
    sloping_sd_m: float = 0.002
    """How holders and cuffs yield differently on a slope than on the level, in the same way at every step: +2 mm up and
    -2 mm down a ramp of 5°, the mean errors of the walks named above."""
    stop_margin_rad: float = math.radians(2.0)
    """An ankle this close to a stop may be at it: rubber stops yield by up to 0.7° (docs/design.md)."""
    strained_slope_sd_rad: float = math.radians(8.0)
    """Standard deviation of the foot's pitch with the ankle at its stop."""
    strained_sd_m: float = 0.015
    """Standard deviation of the foot's position with the ankle at its stop."""
    steady_m: float = 0.0015
    """Variation of the vector between two stationary feet while the frame does not yield."""
    spread_gain: float = 5.0
    """Ratio of that vector's error to its variation beyond `steady_m`."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0."""
        values = asdict(self)
        values |= {f"vector_sd_m[{i}]": sd for i, sd in enumerate(values.pop("vector_sd_m"))}
        check_numbers("Compliance", values, values)


_COMPLIANCE_KEYS = {f.name.replace("_rad", "_deg"): f.name for f in fields(Compliance)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Exoskeleton:
    """Both legs and the back panel between them.

    Attributes:
        description: One line.
        back: AHRS on the back panel.
        legs: By `l` and `r`.
        compliance: Its compliance.
    """

    description: str
    back: Attitude
    legs: Mapping[str, Leg]
    compliance: Compliance = Compliance()

    @property
    def topics(self) -> tuple[str, ...]:
        """Every stream read: the back, and thigh, foot, knee and insole of each leg."""
        each = [(g.thigh.topic, g.foot.topic, g.knee.topic, g.sole.topic) for g in self.legs.values()]
        return (self.back.topic, *(topic for leg in each for topic in leg))


def read_exoskeleton(path: str | Path) -> Exoskeleton:
    """An exoskeleton from its file.

    Raises:
        ConfigError: A key is missing, unknown or invalid; the message names file, key and the valid values.
        StrideTwinError: The file cannot be read or is not YAML.
    """
    return _exoskeleton(read_node(path))


def parse_exoskeleton(text: str, source: str) -> Exoskeleton:
    """An exoskeleton from the text of a file; `source` names it in errors, which are those of `read_exoskeleton`."""
    return _exoskeleton(parse_node(text, source))


def to_text(exo: Exoskeleton) -> str:
    """The file of an exoskeleton."""
    legs = {
        side: {
            "frames": [
                {
                    "alpha_deg": math.degrees(row.alpha), "a_m": float(row.a), "d_m": float(row.d),
                    "theta_deg": math.degrees(row.theta), "turns": row.turns,
                }
                | ({"range_deg": [math.degrees(q) for q in row.stops]} if math.isfinite(row.stops[0]) else {})
                for row in leg.rows
            ],
            "thigh": {
                "topic": leg.thigh.topic, "frame": leg.thigh.frame, "R_frame_sensor": leg.thigh.R_frame_sensor.tolist()
            },
            "knee": {"topic": leg.knee.topic, "frame": leg.knee.frame, "sign": leg.knee.sign},
            "foot": {"topic": leg.foot.topic, "R_frame_sensor": leg.foot.R_frame_sensor.tolist()},
            "sole": {
                "topic": leg.sole.topic, "T_foot_sole": leg.sole.T_foot_sole.tolist(),
                "cells_m": leg.sole.cells.tolist(), "heel_x_m": float(leg.sole.heel_x),
                "hinge_x_m": float(leg.sole.hinge_x),
                "hinge_z_m": float(leg.sole.hinge_z),
                "tip_x_m": float(leg.sole.tip_x),
            },
        }
        for side, leg in exo.legs.items()
    }  # fmt: skip
    back = {"topic": exo.back.topic, "R_frame_sensor": exo.back.R_frame_sensor.tolist()}
    values = {"description": exo.description, "back": back, "legs": legs, "compliance": _told(exo.compliance)}
    return yaml.dump(values, Dumper=Dumper, sort_keys=False)


def _told(compliance: Compliance) -> dict[str, float | list[float]]:
    told: dict[str, float | list[float]] = {"vector_sd_m": [float(sd) for sd in compliance.vector_sd_m]}
    for key, name in _COMPLIANCE_KEYS.items():
        if name != "vector_sd_m":
            value = float(getattr(compliance, name))
            told[key] = math.degrees(value) if key.endswith("_deg") else value
    return told


def _compliance(node: Node) -> Compliance:
    node.only(_COMPLIANCE_KEYS)
    values: dict[str, Any] = {}
    for key in node:
        at = node.at(key)
        if key == "vector_sd_m":
            at.numbers(3)
            values[key] = tuple(sd.number(0.0) for sd in at.items())
        else:
            value = at.number(0.0)
            values[_COMPLIANCE_KEYS[key]] = math.radians(value) if key.endswith("_deg") else value
    return Compliance(**values)


def _exoskeleton(root: Node) -> Exoskeleton:
    root.only(("description", "back", "legs", "compliance"))
    root.at("legs").only(SIDES)
    return Exoskeleton(
        description=root.at("description").text(),
        back=_attitude(root.at("back"), 0),
        legs={side: _leg(root.at("legs").at(side)) for side in SIDES},
        compliance=_compliance(root.at("compliance", {})),
    )


def _leg(node: Node) -> Leg:
    node.only(("frames", "thigh", "knee", "foot", "sole"))
    rows = tuple(_row(item) for item in node.at("frames").items())
    thigh, knee = node.at("thigh"), node.at("knee")
    knee.only(("topic", "frame", "sign"))
    at_thigh, at_knee = thigh.at("frame"), knee.at("frame")
    if not 1 <= at_thigh.integer(1) < len(rows):
        raise at_thigh.error(f"1-{len(rows) - 1}, a frame before the foot's")
    turning = [i for i, row in enumerate(rows, 1) if row.turns]
    if at_knee.integer(1) not in turning or at_knee.value <= at_thigh.value:
        raise at_knee.error("a frame beyond the thigh's that a joint turns")
    hip = [i for i in turning if i <= at_thigh.value]
    ankle = [i for i in turning if i > at_knee.value]
    between = len(turning) - len(hip) - len(ankle) - 1
    if between or not all(1 <= len(joints) <= _JOINTS_MAX for joints in (hip, ankle)):
        raise node.at("frames").error(f"1-{_JOINTS_MAX} joints before the thigh, 1-{_JOINTS_MAX} beyond the knee")
    sign = knee.at("sign", 1.0).number()
    if abs(sign) != 1.0:
        raise knee.at("sign").error("1 or -1")
    return Leg(
        rows=rows,
        thigh=_attitude(thigh, at_thigh.value, ("frame",)),
        knee=Knee(topic=knee.at("topic").text(), frame=at_knee.value, sign=sign),
        foot=_attitude(node.at("foot"), len(rows)),
        sole=_sole(node.at("sole")),
    )


def _row(node: Node) -> DhRow:
    node.only(("alpha_deg", "a_m", "d_m", "theta_deg", "turns", "range_deg"))
    turns = node.at("turns", False)
    if not isinstance(turns.value, bool):
        raise turns.error("true or false")
    low, high = -math.inf, math.inf
    if "range_deg" in node:
        low, high = (math.radians(q) for q in node.at("range_deg").numbers(2))
        if low >= high:
            raise node.at("range_deg").error("the least and the greatest angle")
    return DhRow(
        alpha=math.radians(node.at("alpha_deg").number()), a=node.at("a_m").number(), d=node.at("d_m").number(),
        theta=math.radians(node.at("theta_deg").number()), turns=turns.value, stops=(low, high),
    )  # fmt: skip


def _attitude(node: Node, frame: int, more: tuple[str, ...] = ()) -> Attitude:
    node.only(("topic", "R_frame_sensor", *more))
    mount = node.at("R_frame_sensor")
    rows = mount.items()
    if len(rows) != 3:
        raise mount.error("3 rows of 3 numbers")
    R = np.array([row.numbers(3) for row in rows])
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0:
        raise mount.error("a rotation matrix")
    return Attitude(topic=node.at("topic").text(), frame=frame, R_frame_sensor=R)


def _sole(node: Node) -> Sole:
    node.only(("topic", "T_foot_sole", "cells_m", "heel_x_m", "hinge_x_m", "hinge_z_m", "tip_x_m"))
    cells = node.at("cells_m")
    places = cells.items()
    if len(places) != 4:
        raise cells.error("4 places: heel, lateral ball, medial ball, toe")
    heel, hinge, tip = (node.at(f"{name}_x_m").number() for name in ("heel", "hinge", "tip"))
    if not heel < hinge < tip:
        raise node.at("hinge_x_m").error("a number between heel_x_m and tip_x_m")
    return Sole(
        topic=node.at("topic").text(), T_foot_sole=node.at("T_foot_sole").transform(),
        cells=np.array([place.numbers(2) for place in places]), heel_x=heel, hinge_x=hinge,
        hinge_z=node.at("hinge_z_m").number(0.0), tip_x=tip,
    )  # fmt: skip
