"""The calibration of an exoskeleton, read from a file: D-H table, sensor mounts, soles and compliance.

Another exoskeleton needs only another file; `docs/contact_terrain.md` explains each key. Angles are
degrees in the file (`_deg`) and radians here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import AfterValidator, Field, StrictBool, StrictInt

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.fields import DEG, DEGREES, FileModel, NotNegative, Number, ReadAs, field_error
from stridetwin.streams.matrix_fields import RigidTransform, RotationMatrix
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import validate
from stridetwin.streams.yaml_file import Dumper, parse_yaml, read_yaml

SIDES = ("l", "r")
"""Letters of the left and the right leg, in the order of arrays over both."""
METADATA_KEY = "exoskeleton"
"""Key of the geometry file in a recording's metadata."""
_JOINTS_MAX, _FRAMES_MAX = 3, 99  # largest number of joints of a hip or an ankle, and of frames of a leg
_Angle = Annotated[Number, DEGREES]
_CellPosition = tuple[Number, Number]  # x and y on the sole, m


def _check_increasing(stops: tuple[float, float]) -> tuple[float, float]:
    """The stops (rad), or an error if the least angle is not below the greatest."""
    if stops[0] >= stops[1]:
        raise field_error([round(math.degrees(q), 9) for q in stops], "the least and the greatest angle")
    return stops


def _check_sign(sign: float) -> float:
    """The sign, or an error if it is not 1 or -1."""
    if abs(sign) != 1.0:
        raise field_error(sign, "1 or -1")
    return sign


def _check_order(sole: Sole) -> Sole:
    """The sole, or an error if heel, hinge and tip do not follow one another forwards."""
    if not sole.heel_x < sole.hinge_x < sole.tip_x:
        raise field_error(sole.hinge_x, "a number between heel_x_m and tip_x_m", "hinge_x_m")
    return sole


@dataclass(frozen=True, kw_only=True)
class DhRow:
    """One row of a modified (Craig's) D-H table: Rx(alpha) Tx(a) Rz(theta + q) Tz(d); rad and m.

    Attributes:
        alpha: Twist about x before this frame.
        a: Distance along the x axis of the frame before.
        d: Distance along this frame's z axis.
        theta: Added to the joint's angle about z.
        turns: Whether a joint rotates this frame.
        stops: Smallest and largest angle of that joint; infinite if not given.
    """

    alpha: Annotated[Number, Field(alias="alpha_deg"), DEGREES]
    a: Annotated[Number, Field(alias="a_m")]
    d: Annotated[Number, Field(alias="d_m")]
    theta: Annotated[Number, Field(alias="theta_deg"), DEGREES]
    turns: StrictBool = False
    stops: Annotated[
        tuple[float, float], ReadAs(tuple[_Angle, _Angle], _check_increasing), Field(alias="range_deg")
    ] = (
        -math.inf,
        math.inf,
    )


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
        sign: 1 or -1: the joint's angle q is sign · angle of the encoder.
    """

    topic: str
    frame: Annotated[StrictInt, Field(ge=1, le=_FRAMES_MAX)]
    sign: Annotated[Number, AfterValidator(_check_sign)] = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Sole:
    """The sole and its insole.

    Attributes:
        topic: Stream of the insole.
        T_foot_sole: (4, 4) pose of the sole in the last frame: x forward, y left, z up, the ground at z = 0.
        cells: (4, 2) m, places of the cells heel, lateral ball, medial ball and toe on the sole.
        heel_x: Back edge, m.
        hinge_x: Axis about which the toes bend, m forward.
        hinge_z: Height of that axis above the ground, m; also the radius with which the forefoot rolls.
        tip_x: Tip of the toes, m.
    """

    topic: str
    T_foot_sole: RigidTransform
    cells: Annotated[
        Array,
        ReadAs(tuple[_CellPosition, _CellPosition, _CellPosition, _CellPosition], np.array),
        Field(alias="cells_m"),
    ]
    heel_x: Annotated[Number, Field(alias="heel_x_m")]
    hinge_x: Annotated[Number, Field(alias="hinge_x_m")]
    hinge_z: Annotated[Number, Field(ge=0, alias="hinge_z_m")]
    tip_x: Annotated[Number, Field(alias="tip_x_m")]


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """Chain of an exoskeleton's leg from the back panel to the foot, with the sensors on it.

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

    vector_sd_m: tuple[NotNegative, NotNegative, NotNegative] = (0.006, 0.006, 0.002)
    """Standard deviation of a step's vector, x, y, z, from slack in the heel holder and soft soles."""
    sag_sd_m: NotNegative = 0.006
    """Standard deviation of a loaded heel's sag in its holder, relative to push-off."""
    climb_share: NotNegative = 0.04
    """Yielding of holder and cuffs under the lifting leg, as a share of the height climbed."""
    slope_sd_rad: Annotated[Number, Field(ge=0, alias="slope_sd_deg"), DEGREES] = 0.32 * DEG
    """Standard deviation of a foot's pitch in its holder: a foot is never exactly flat."""
    slope_share: NotNegative = 0.06
    """Standard deviation of that pitch as a share of the slope: the steeper the ground, the more the holder yields."""
    sloping_sd_m: NotNegative = 0.002
    """How holders and cuffs yield differently on a slope than on the level, in the same way at every step: +2 mm up and
    -2 mm down a ramp of 5°, the mean errors of the walks named above."""
    stop_margin_rad: Annotated[Number, Field(ge=0, alias="stop_margin_deg"), DEGREES] = 2.0 * DEG
    """An ankle this close to a stop may be at it: rubber stops yield by up to 0.7° (docs/design.md)."""
    strained_slope_sd_rad: Annotated[Number, Field(ge=0, alias="strained_slope_sd_deg"), DEGREES] = 8.0 * DEG
    """Standard deviation of the foot's pitch with the ankle at its stop."""
    strained_sd_m: NotNegative = 0.015
    """Standard deviation of the foot's position with the ankle at its stop."""
    steady_m: NotNegative = 0.0015
    """Variation of the vector between two stationary feet while the frame does not yield."""
    spread_gain: NotNegative = 5.0
    """Ratio of that vector's error to its variation beyond `steady_m`."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0."""
        values = asdict(self)
        # the three deviations of the vector are checked as single numbers, so that an error names the invalid one
        values |= {f"vector_sd_m[{i}]": sd for i, sd in enumerate(values.pop("vector_sd_m"))}
        check_numbers("Compliance", values, values)  # any of them may be 0


_COMPLIANCE_KEYS = {f.name.replace("_rad", "_deg"): f.name for f in fields(Compliance)}
"""Name of each field of `Compliance`, by its key in a file, where angles are in degrees."""


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
        topics = [self.back.topic]
        for leg in self.legs.values():
            topics += [leg.thigh.topic, leg.foot.topic, leg.knee.topic, leg.sole.topic]
        return tuple(topics)


def read_exoskeleton(path: str | Path) -> Exoskeleton:
    """An exoskeleton from its file.

    Raises:
        ConfigError: A key is missing, unknown or invalid; the message names file, key and the valid values.
        StrideTwinError: The file cannot be read or is not YAML.
    """
    return _to_exoskeleton(read_yaml(path), path)


def parse_exoskeleton(text: str, source: str) -> Exoskeleton:
    """An exoskeleton from the text of a file; `source` names it in errors, which are those of `read_exoskeleton`."""
    return _to_exoskeleton(parse_yaml(text, source), source)


def to_text(exo: Exoskeleton) -> str:
    """The YAML text of an exoskeleton, which `parse_exoskeleton` reads back: angles in degrees, lengths in m.

    A joint without stops has no `range_deg`. The frame of a foot's AHRS is not written, as it is always the last one.
    """
    legs = {side: _leg_to_file_values(leg) for side, leg in exo.legs.items()}
    back = {"topic": exo.back.topic, "R_frame_sensor": exo.back.R_frame_sensor.tolist()}
    values = {
        "description": exo.description,
        "back": back,
        "legs": legs,
        "compliance": _to_file_values(exo.compliance),
    }
    return yaml.dump(values, Dumper=Dumper, sort_keys=False)


def _leg_to_file_values(leg: Leg) -> dict[str, object]:
    """One leg of a file: values by key, angles in degrees, lengths in m."""
    sole = leg.sole
    return {
        "frames": [_row_to_file_values(row) for row in leg.rows],
        "thigh": {
            "topic": leg.thigh.topic,
            "frame": leg.thigh.frame,
            "R_frame_sensor": leg.thigh.R_frame_sensor.tolist(),
        },
        "knee": {"topic": leg.knee.topic, "frame": leg.knee.frame, "sign": leg.knee.sign},
        "foot": {"topic": leg.foot.topic, "R_frame_sensor": leg.foot.R_frame_sensor.tolist()},
        "sole": {
            "topic": sole.topic,
            "T_foot_sole": sole.T_foot_sole.tolist(),
            "cells_m": sole.cells.tolist(),
            "heel_x_m": float(sole.heel_x),
            "hinge_x_m": float(sole.hinge_x),
            "hinge_z_m": float(sole.hinge_z),
            "tip_x_m": float(sole.tip_x),
        },
    }


def _row_to_file_values(row: DhRow) -> dict[str, object]:
    """One row of the D-H table of a file: values by key; without `range_deg` where the joint has no stops."""
    values: dict[str, object] = {
        "alpha_deg": math.degrees(row.alpha),
        "a_m": float(row.a),
        "d_m": float(row.d),
        "theta_deg": math.degrees(row.theta),
        "turns": row.turns,
    }
    if math.isfinite(row.stops[0]):
        values["range_deg"] = [math.degrees(q) for q in row.stops]
    return values


def _to_file_values(compliance: Compliance) -> dict[str, float | list[float]]:
    """The section `compliance` of a file: values by key, angles in degrees."""
    values: dict[str, float | list[float]] = {"vector_sd_m": [float(sd) for sd in compliance.vector_sd_m]}
    for key, name in _COMPLIANCE_KEYS.items():
        if name != "vector_sd_m":
            value = float(getattr(compliance, name))
            values[key] = math.degrees(value) if key.endswith("_deg") else value
    return values


class _Ahrs(FileModel):
    """An AHRS.

    Attributes:
        topic: Its stream.
        R_frame_sensor: Rotation, sensor to frame, three rows.
    """

    topic: str
    R_frame_sensor: RotationMatrix


class _ThighAhrs(_Ahrs):
    """An AHRS on the thigh.

    Attributes:
        frame: Number of the frame that carries it.
    """

    frame: Annotated[StrictInt, Field(ge=1, le=_FRAMES_MAX)]


class _Leg(FileModel):
    """One leg.

    Attributes:
        frames: D-H table from the back panel, frame 0, to the foot, the last frame.
        thigh: AHRS on the thigh.
        knee: Encoder.
        foot: AHRS on the foot.
        sole: Sole and insole.
    """

    frames: tuple[DhRow, ...]
    thigh: _ThighAhrs
    knee: Knee
    foot: _Ahrs
    sole: Annotated[Sole, AfterValidator(_check_order)]


def _to_leg(leg: _Leg) -> Leg:
    """Converts the leg of a file, after a check that its joints are one to three of the hip, the knee, and the ankle's.

    The numbers of the frames count from 1, the first row of the table. Joints before the thigh's frame are those of the
    hip; then comes the knee's joint alone; those beyond are the ankle's.

    Raises:
        PydanticCustomError: The thigh's frame is not before the foot's, the knee's is not a turning frame beyond the
            thigh's, another joint lies between the two, or hip or ankle has not 1 to `_JOINTS_MAX` joints.
    """
    rows, thigh, knee = leg.frames, leg.thigh.frame, leg.knee.frame
    if not 1 <= thigh < len(rows):
        raise field_error(thigh, f"1-{len(rows) - 1}, a frame before the foot's", "thigh", "frame")
    turning = [i for i, row in enumerate(rows, 1) if row.turns]  # numbers of the frames that a joint rotates
    if knee not in turning or knee <= thigh:
        raise field_error(knee, "a frame beyond the thigh's that a joint turns", "knee", "frame")
    hip = [i for i in turning if i <= thigh]
    ankle = [i for i in turning if i > knee]
    between = len(turning) - len(hip) - len(ankle) - 1  # joints between the thigh and the knee: there must be none
    if between or not all(1 <= len(joints) <= _JOINTS_MAX for joints in (hip, ankle)):
        expected = f"1-{_JOINTS_MAX} joints before the thigh, 1-{_JOINTS_MAX} beyond the knee"
        raise field_error(f"{len(hip)} and {len(ankle)} joints", expected, "frames")
    return Leg(
        rows=rows,
        thigh=Attitude(topic=leg.thigh.topic, frame=thigh, R_frame_sensor=leg.thigh.R_frame_sensor),
        knee=leg.knee,
        foot=Attitude(topic=leg.foot.topic, frame=len(rows), R_frame_sensor=leg.foot.R_frame_sensor),
        sole=leg.sole,
    )


class _Legs(FileModel):
    """Both legs.

    Attributes:
        l, r: The left and the right leg.
    """

    l: Annotated[_Leg, AfterValidator(_to_leg)]
    r: Annotated[_Leg, AfterValidator(_to_leg)]


class ExoskeletonFile(FileModel):
    """The calibration of an exoskeleton.

    Attributes:
        description: One line.
        back: AHRS on the back panel, frame 0.
        legs: Both legs.
        compliance: How it yields under its wearer.
    """

    description: str
    back: _Ahrs
    legs: _Legs
    compliance: Compliance = Compliance()


def _to_exoskeleton(data: object, source: object) -> Exoskeleton:
    """An exoskeleton from the values of a file; `source` names it in errors, which are those of `read_exoskeleton`."""
    file = validate(ExoskeletonFile, data, source)  # which has already converted each leg by `_to_leg`
    return Exoskeleton(
        description=file.description,
        back=Attitude(topic=file.back.topic, frame=0, R_frame_sensor=file.back.R_frame_sensor),
        legs=dict(file.legs),
        compliance=file.compliance,
    )
