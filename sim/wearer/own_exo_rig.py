"""The rig file of an exoskeleton of the user's own: what ties it to the wearer, what drives it, what it senses.

Lengths in the file are millimetres and angles degrees, as in scenarios; places are in the frames of the model's links.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, StrictBool, ValidationInfo
from scipy.spatial.transform import Rotation

from stridetwin.sim.choices import part_files
from stridetwin.sim.exo_description import Cuff, Link, Module, OnLink, OwnExo, hinge_of
from stridetwin.sim.parts.kinds import ActuatorPart, ImuPart, Part
from stridetwin.sim.parts.library import kind_of, load_part, read_part
from stridetwin.sim.wearer.exo_couplings import coupling_law
from stridetwin.sim.wearer.own_exo_model import Chains, read_model
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.fields import (
    MM,
    FileModel,
    Number,
    Positive,
    ReadAs,
    context_folder,
    field_error,
    other_file_error,
)
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import combine_errors, suggest, validate
from stridetwin.streams.yaml_file import read_yaml

_FLEXION_Y = {"hip": -1, "knee": 1, "ankle": -1}
"""Which way along y, to the left, an axis points that counts flexion (thigh forward, knee bent, toes up)."""
_MOST_ASLANT_DEG = 60.0  # largest angle of such an axis from that direction
_BODIES = tuple(f"{limb}_{side}" for limb in ("thigh", "shank", "foot") for side in "lr")
_SHORT = re.compile(r"[a-z]+_[lr]")  # a short name, such as `hip_l`
_FARTHEST_MM = 2000.0  # largest coordinate of a place on a link


def _vector(most: float, low: float | None = None, scale: float = 1.0) -> ReadAs:
    """Annotation of an array (3,): three numbers of the file, each times `scale`, the file's unit in that of the array.

    The limits are in the file's unit: from `low`, by default -`most`, to `most`.
    """
    entry = Annotated[Number, Field(ge=-most if low is None else low, le=most)]
    return ReadAs(GenericAlias(tuple, (entry,) * 3), lambda values: scale * np.array(values))


def _part_field(kind: str) -> Any:
    """Validator of a field that names a part of a kind: one of the library, or a YAML file beside the rig file."""

    def read_named_part(name: object, info: ValidationInfo) -> Part:
        """The part; refuses unknown names and parts of another kind."""
        read = None  # the part, if there is one of that name
        if isinstance(name, str) and name.endswith((".yaml", ".yml")):
            try:
                read = read_part(context_folder(info) / name)
            except StrideTwinError as error:
                raise other_file_error(error) from None
        elif isinstance(name, str) and name in part_files():
            read = load_part(name)
        if read is None or kind_of(read) != kind:
            names = ", ".join(n for n in part_files() if kind_of(load_part(n)) == kind)
            raise field_error(name, f"{names}, or the path of a .yaml file of kind {kind}")
        return read

    return BeforeValidator(read_named_part, json_schema_input_type=str)


def _check_short_names(valid: str, *more: str) -> AfterValidator:
    """Validator of a mapping whose keys are names with a side, such as `hip_l`, or one of `more`.

    Args:
        valid: Examples of valid names, for the message.
        more: Further valid keys.
    """

    def check(named: dict[str, object]) -> dict[str, object]:
        """The mapping, unchanged, if its keys are valid."""
        for name in named:
            if name not in more and not _SHORT.fullmatch(name):
                raise field_error(name, f"names such as {valid}")
        return named

    return AfterValidator(check)


def _check_unique(joints: dict[str, str]) -> dict[str, str]:
    """The mapping of short names to joints of the model, unchanged; refuses a joint that two short names share."""
    names = list(joints.values())
    if twice := [name for name in names if names.count(name) > 1]:
        raise field_error(twice[0], "every joint once")
    return joints


def _check_joint_names(names: Any, info: ValidationInfo) -> Any:
    """The names, unchanged; refuses short names of joints that the file's `joints` does not have.

    `names` is a sequence of short names, or a mapping by short name.
    """
    joints = info.data.get("joints")  # None if that field is invalid itself
    for i, name in enumerate(names):
        if joints is not None and name not in joints:
            # place of the invalid name below the field: its number in a sequence; nothing more for a mapping
            below = () if isinstance(names, dict) else (i,)
            raise field_error(name, f"one of the joints {', '.join(joints) or '(none named)'}", *below)
    return names


def _check_both_legs(cuffs: dict[str, Any]) -> dict[str, Any]:
    """The cuffs by body, unchanged; refuses cuffs on anything but thighs, shanks and feet, and on one leg only."""
    for body in cuffs:
        if body not in _BODIES:
            raise field_error(body, f"keys {suggest(body, _BODIES)}")
    if {body[-1] for body in cuffs} != {"l", "r"}:
        raise field_error(list(cuffs), "cuffs on both legs, such as thigh_l and thigh_r")
    return cuffs


class _Seat(FileModel):
    """A place on a link of the model.

    `position_mm` is named after its unit in the file, but here it is an array (3,) in metres; `rpy_deg` (3,) stays in
    degrees.

    Attributes:
        link: Name of the link.
        position_mm: In the link's frame.
        rpy_deg: Roll, pitch and yaw about fixed axes, as in URDF.
    """

    link: str
    # mm in the file, m here
    position_mm: Annotated[Array, _vector(_FARTHEST_MM, scale=MM)] = Field(default_factory=lambda: np.zeros(3))
    rpy_deg: Annotated[Array, _vector(360.0)] = Field(default_factory=lambda: np.zeros(3))

    @property
    def pose(self) -> Array:
        """(4, 4) pose in the link's frame, m."""
        T = np.eye(4)
        T[:3, 3] = self.position_mm  # already in m
        T[:3, :3] = Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix()
        return T


class _ImuSeat(_Seat):
    """An IMU on a link.

    Attributes:
        part: Part of the library, or the path of a .yaml file.
    """

    part: Annotated[ImuPart, _part_field("imu")]


class _CuffFile(FileModel):
    """A tie of a link to the wearer; three values are fore-aft, sideways and along the limb.

    `at_mm` is named after its unit in the file, but here it is an array (3,) in metres.

    Attributes:
        link: Name of the link.
        at_mm: Place in the link's frame.
        kind: `strap` slides along the limb, `holder` does not; the default of a foot is `holder`.
        force_cells: Whether it has the force-cell pair of the interaction sensors.
        stiffness_n_m: N/m.
        damping_ns_m: N s/m.
        turn_stiffness_nm: N m/rad.
        turn_damping_nms: N m s/rad.
    """

    link: str
    at_mm: Annotated[Array, _vector(_FARTHEST_MM, scale=MM)]  # mm in the file, m here
    kind: Literal["strap", "holder"] | None = None
    force_cells: StrictBool = False
    stiffness_n_m: Annotated[Array, _vector(1e5, 0.0)] | None = None
    damping_ns_m: Annotated[Array, _vector(1e4, 0.0)] | None = None
    turn_stiffness_nm: Annotated[Array, _vector(1e4, 0.0)] | None = None
    turn_damping_nms: Annotated[Array, _vector(1e3, 0.0)] | None = None

    def law(self, body: str) -> Array:
        """(4, 3, 3) stiffness, damping, rotational stiffness and damping of a cuff on a body of the wearer."""
        diagonals = (self.stiffness_n_m, self.damping_ns_m, self.turn_stiffness_nm, self.turn_damping_nms)
        return coupling_law(self.kind or ("holder" if body.startswith("foot") else "strap"), diagonals)


class _Motor(FileModel):
    """The motor of a joint; rotor, gear and mass are the model's.

    Attributes:
        torque_max_nm: Largest torque at the joint.
        speed_max_radps: Largest speed of the joint.
        part: Part of the library that senses it, or the path of a .yaml file.
    """

    torque_max_nm: Positive
    speed_max_radps: Positive = 10.0
    part: Annotated[ActuatorPart, _part_field("actuator")] = Field("actuation-module", validate_default=True)


class OwnExoFile(FileModel):
    """The rig of an exoskeleton of the user's own.

    Attributes:
        description: One line; by default the name of the model.
        base: The base link, which is fixed to the pelvis, and its pose in the pelvis' frame.
        cuffs: Ties on both legs, by the limb of the wearer.
        joints: Hinge of the model by its short name, such as `hip_l`; hips, knees and ankles count flexion.
        encoders: Short names of the joints with an encoder.
        motors: Motors by the short name of their joint.
        ahrs: AHRS by place, such as `back`, `thigh_l`.
        imus: Further IMUs by place.
    """

    description: str | None = None
    base: _Seat
    cuffs: Annotated[
        dict[str, _CuffFile],
        AfterValidator(_check_both_legs),
        Field(json_schema_extra={"propertyNames": {"enum": list(_BODIES)}}),
    ]
    joints: Annotated[dict[str, str], _check_short_names("hip_l, knee_r"), AfterValidator(_check_unique)] = Field(
        default_factory=dict
    )
    encoders: Annotated[tuple[str, ...], AfterValidator(_check_joint_names)] = ()
    motors: Annotated[dict[str, _Motor], AfterValidator(_check_joint_names)] = Field(default_factory=dict)
    ahrs: Annotated[dict[str, _Seat], _check_short_names("back, thigh_l, foot_r", "back")] = Field(default_factory=dict)
    imus: Annotated[dict[str, _ImuSeat], _check_short_names("back, thigh_l, foot_r", "back")] = Field(
        default_factory=dict
    )


def read_own_exo(model: Path, rig: Path) -> OwnExo:
    """Reads a custom exoskeleton from its model and its rig file.

    Args:
        model: MJCF or URDF file.
        rig: YAML file.

    Raises:
        ConfigError: A value in one of them is invalid.
        StrideTwinError: One of them cannot be read.
    """
    file = validate(OwnExoFile, read_yaml(rig), rig, context={"folder": rig.parent})
    # name of each named joint in the wearer's model, by its name in the model's file
    names = {joint: hinge_of(short) for short, joint in file.joints.items()}
    T_base = file.base.pose
    chains = read_model(model, file.base.link, T_base[:3, 3], T_base[:3, :3], names)
    if errors := list(_find_unknown_names(file, chains, rig, model)):
        raise combine_errors(errors)
    cuffs, sides = _cuffs(file, chains, rig)  # `sides`: number of the chain that is the leg of each side
    legs = {side: chains.legs[sides[side]] for side in "lr"}
    for short, joint in file.joints.items():  # a short name ends with its side
        if hinge_of(short) not in {link.joint for link in legs[short[-1]]}:
            raise ConfigError(rig, f"joints.{short}", joint, f"a joint of the leg that is tied to {short[-1]}")
    _check_axes(model, rig, file.joints, legs)
    hinges = {link.joint: link for leg in legs.values() for link in leg}
    return OwnExo(
        source=str(model),
        rig=str(rig),
        description=model.stem if file.description is None else file.description,
        base=chains.base,
        legs=legs,
        cuffs=cuffs,
        modules={short: _module(motor, hinges[hinge_of(short)]) for short, motor in file.motors.items()},
        motors={short: motor.part for short, motor in file.motors.items()},
        encoders=file.encoders,
        ahrs={place: _on_link(seat, chains) for place, seat in file.ahrs.items()},
        imus={place: (_on_link(seat, chains), seat.part) for place, seat in file.imus.items()},
    )


def _find_unknown_names(file: OwnExoFile, chains: Chains, rig: Path, model: Path) -> Iterator[ConfigError]:
    """An error for each joint and each link in the rig file that the model does not have."""
    hinges = {link.joint for leg in chains.legs for link in leg}
    for short, joint in file.joints.items():
        if hinge_of(short) not in hinges:
            yield ConfigError(rig, f"joints.{short}", joint, f"a hinge of {model}")
    for key in ("cuffs", "ahrs", "imus"):
        for place, seat in getattr(file, key).items():
            if seat.link not in chains.carrier:
                valid = f"a link of the model: {', '.join(chains.carrier)}"
                yield ConfigError(rig, f"{key}.{place}.link", seat.link, valid)


def _cuffs(file: OwnExoFile, chains: Chains, rig: Path) -> tuple[tuple[Cuff, ...], dict[str, int]]:
    """The cuffs in the frames of their links, and by side the number of the chain that is its leg.

    Raises:
        ConfigError: A cuff on the base, or cuffs of both sides on one chain.
    """
    cuffs, sides = [], dict[str, int]()
    for body, cuff in file.cuffs.items():
        leg, at = chains.carrier[cuff.link]  # number of the chain, -1 for the base, and of the link in it
        place, side = f"cuffs.{body}.link", body[-1]
        if leg < 0:
            raise ConfigError(rig, place, cuff.link, "a link of a leg: the base is fixed to the pelvis")
        # all cuffs of a side must be on one chain, and those of the other side on the other chain
        if sides.setdefault(side, leg) != leg or any(s != side and k == leg for s, k in sides.items()):
            valid = f"a link of the leg that other cuffs tie to the wearer's {side} leg"
            raise ConfigError(rig, place, cuff.link, valid)
        T = chains.T_carrier[cuff.link]  # the named link may be merged into another one
        cuffs.append(
            Cuff(
                body=body,
                link=chains.legs[leg][at].name,
                p_in_link=T[:3, :3] @ cuff.at_mm + T[:3, 3],  # `at_mm` is in m after reading
                law=cuff.law(body),
                force_cells=cuff.force_cells,
            )
        )
    return tuple(cuffs), sides


def _check_axes(model: Path, rig: Path, joints: Mapping[str, str], legs: dict[str, tuple[Link, ...]]) -> None:
    """Refuses hips, knees and ankles whose positive angle is not flexion.

    Control laws and the readers of the sensors assume that: thigh forward, knee bent, toes up.

    Raises:
        ConfigError: An axis farther than `_MOST_ASLANT_DEG` from the direction across the body.
    """
    for short, joint in joints.items():
        name, _, side = short.rpartition("_")
        y = _FLEXION_Y.get(name)  # None for joints other than hips, knees and ankles
        axis = next(link.axis for link in legs[side] if link.joint == hinge_of(short))
        if y is not None and y * axis[1] < np.cos(np.radians(_MOST_ASLANT_DEG)):
            raise ConfigError(
                model,
                f"joint {joint}, axis",
                (np.round(axis, 3) + 0.0).tolist(),
                f"within {_MOST_ASLANT_DEG:g} deg of [0, {y}, 0] (x forward, y left), flexion positive, as "
                f"joints.{short} of {rig}; reverse axis and range",
            )


def _module(motor: _Motor, link: Link) -> Module:
    """Module of a powered joint: limits from the rig file, rotor, gear and friction from the model.

    The model's armature is the inertia of the rotor at the joint, so that the gear is 1; its links include the mass.
    """
    return Module(
        gear=1.0,
        rotor_inertia=link.armature,
        friction_nm=link.friction,
        viscous_nms=link.damping,
        torque_max_nm=motor.torque_max_nm,
        speed_max_radps=motor.speed_max_radps,
        mass_kg=0.0,
    )


def _on_link(seat: _Seat, chains: Chains) -> OnLink:
    """Pose of a seat on the link that its place is merged into."""
    leg, at = chains.carrier[seat.link]  # number of the chain, -1 for the base, and of the link in it
    link = chains.base if leg < 0 else chains.legs[leg][at]
    return OnLink(link=link.name, T_link=chains.T_carrier[seat.link] @ seat.pose)
