"""The rig file of an exoskeleton of the user's own: what ties it to the wearer, what drives it, what it senses.

Lengths in the file are millimetres and angles degrees, as in scenarios; places are in the frames of the model's links.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.exo_description import Cuff, Link, Module, OnLink, OwnExo, hinge_of
from stridetwin.sim.parts.kinds import ActuatorPart, ImuPart, Part
from stridetwin.sim.parts.library import kind_of, library, part, read_part
from stridetwin.sim.wearer.own_exo_model import Chains, read_model
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array
from stridetwin.streams.yaml_node import Node, read_node

P = TypeVar("P", bound=Part)
_FLEXION_Y = {"hip": -1, "knee": 1, "ankle": -1}
"""Which way along y, to the left, an axis points that counts flexion (thigh forward, knee bent, toes up)."""
_MOST_ASLANT_DEG = 60.0
_KEYS = ("description", "base", "cuffs", "joints", "encoders", "motors", "ahrs", "imus")
_BODIES = tuple(f"{part}_{side}" for part in ("thigh", "shank", "foot") for side in "lr")
_SHORT = re.compile(r"[a-z]+_[lr]")
_LAWS = ("stiffness_n_m", "damping_ns_m", "turn_stiffness_nm", "turn_damping_nms")
# Those of the built-in exoskeleton (`exoskeleton.couplings`): a cuff slides along the limb, a holder does not.
_DEFAULTS = {
    "strap": ((4000.0, 4000.0, 0.0), (90.0, 90.0, 20.0), (3.0, 3.0, 20.0), (0.1, 0.1, 0.5)),
    "holder": ((15e3, 15e3, 15e3), (80.0, 80.0, 80.0), (120.0, 160.0, 120.0), (0.5, 1.0, 0.5)),
}
_MOST = dict(zip(_LAWS, (1e5, 1e4, 1e4, 1e3)))
_FARTHEST_MM = 2000.0


def read_own_exo(model: Path, rig: Path) -> OwnExo:
    """Reads an exoskeleton.

    Args:
        model: MJCF or URDF file.
        rig: YAML file.

    Raises:
        ConfigError: A value in one of them that is not valid; names file, field, value and what is valid.
        StrideTwinError: One of them cannot be read.
    """
    root = read_node(rig)
    root.only(_KEYS)
    base = root.at("base")
    base.only(("link", "position_mm", "rpy_deg"))
    joints = _joints(root)
    T_base = _place(base)
    names = {joint: hinge_of(short) for short, joint in joints.items()}
    chains = read_model(model, base.at("link").text(), T_base[:3, 3], T_base[:3, :3], names)
    there = {link.joint for leg in chains.legs for link in leg}
    for short, joint in joints.items():
        if hinge_of(short) not in there:
            node = root.at("joints").at(short)
            raise ConfigError(rig, node.path, joint, f"a hinge of {model}")
    cuffs, sides = _cuffs(root, chains)
    legs = {side: chains.legs[sides[side]] for side in "lr"}
    for short in joints:
        if hinge_of(short) not in {link.joint for link in legs[short[-1]]}:
            raise ConfigError(rig, f"joints.{short}", joints[short], f"a joint of the leg that is tied to {short[-1]}")
    _check_axes(model, rig, joints, legs)
    modules, motors = _motors(root, joints, [link for leg in legs.values() for link in leg])
    return OwnExo(
        source=str(model),
        rig=str(rig),
        description=root.at("description", model.stem).text(),
        base=chains.base,
        legs=legs,
        cuffs=cuffs,
        modules=modules,
        motors=motors,
        encoders=tuple(_known_joint(node, joints) for node in root.at("encoders", []).items()),
        ahrs={place: _seat(node, chains) for place, node in _places(root, "ahrs")},
        imus={
            place: (_seat(node, chains, ("part",)), _part(node, "imu", ImuPart))
            for place, node in _places(root, "imus")
        },
    )


def _joints(root: Node) -> dict[str, str]:
    """Joint in the model's file by its short name."""
    node = root.at("joints", {})
    joints = {}
    for short in node:
        if not _SHORT.fullmatch(short):
            raise ConfigError(root.source, "joints", short, "names such as hip_l, knee_r")
        joints[short] = node.at(short).text()
    twice = [j for j in joints.values() if list(joints.values()).count(j) > 1]
    if twice:
        raise ConfigError(root.source, "joints", twice[0], "every joint once")
    return joints


def _cuffs(root: Node, chains: Chains) -> tuple[tuple[Cuff, ...], dict[str, int]]:
    """The cuffs, and which chain is the leg of a side."""
    node = root.at("cuffs")
    node.only(_BODIES)
    cuffs, sides = [], dict[str, int]()
    for body in node:
        told = node.at(body)
        told.only(("link", "at_mm", "kind", "force_cells", *_LAWS))
        name = _link(told.at("link"), chains)
        leg, number = chains.carrier[name]
        if leg < 0:
            raise told.at("link").error("a link of a leg: the base is fixed to the pelvis")
        side = body[-1]
        if sides.setdefault(side, leg) != leg or any(s != side and k == leg for s, k in sides.items()):
            raise told.at("link").error(f"a link of the leg that other cuffs tie to the wearer's {side} leg")
        T, at = chains.T_carrier[name], _triple(told.at("at_mm"), _FARTHEST_MM)
        kind = told.at("kind", "holder" if body.startswith("foot") else "strap").choice(tuple(_DEFAULTS))
        law = [_law(told, key, default) for key, default in zip(_LAWS, _DEFAULTS[kind])]
        cells = told.at("force_cells", False)
        if not isinstance(cells.value, bool):
            raise cells.error("true or false")
        cuffs.append(
            Cuff(
                body=body, link=chains.legs[leg][number].name, p_in_link=T[:3, :3] @ (1e-3 * at) + T[:3, 3],
                law=np.array(law), force_cells=cells.value,
            )
        )  # fmt: skip
    if set(sides) != {"l", "r"}:
        raise node.error("cuffs on both legs, such as thigh_l and thigh_r")
    return tuple(cuffs), sides


def _check_axes(model: Path, rig: Path, joints: dict[str, str], legs: dict[str, tuple[Link, ...]]) -> None:
    """Refuses hips, knees and ankles that do not count flexion: laws and whoever reads a sensor take it to be so."""
    for short, joint in joints.items():
        name, _, side = short.rpartition("_")
        y = _FLEXION_Y.get(name)
        axis = next(link.axis for link in legs[side] if link.joint == hinge_of(short))
        if y is not None and y * axis[1] < np.cos(np.radians(_MOST_ASLANT_DEG)):
            valid = (
                f"within {_MOST_ASLANT_DEG:g} deg of [0, {y}, 0] (x forward, y left), flexion positive, as it is "
                f"joints.{short} of {rig}; turn axis and range round"
            )
            raise ConfigError(model, f"joint {joint}, axis", (np.round(axis, 3) + 0.0).tolist(), valid)


def _law(node: Node, key: str, default: Iterable[float]) -> Array:
    """(3, 3) of the three values fore-aft, sideways and along the limb."""
    told = node.at(key, list(default))
    values = told.numbers(3)
    if not all(0.0 <= v <= _MOST[key] for v in values):
        raise told.error(f"three numbers, 0-{_MOST[key]:g}")
    return np.diag(values)


def _motors(root: Node, joints: dict[str, str], links: list[Link]) -> tuple[dict[str, Module], dict[str, ActuatorPart]]:
    """Powered joints: what drives them, and the part that tells of it. Rotor, gear and mass are the model's."""
    node = root.at("motors", {})
    modules, motors = {}, {}
    for short in node:
        if short not in joints:
            raise ConfigError(root.source, "motors", short, f"one of the joints {', '.join(joints) or '(none named)'}")
        told = node.at(short)
        told.only(("torque_max_nm", "speed_max_radps", "part"))
        link = next(link for link in links if link.joint == hinge_of(short))
        modules[short] = Module(
            gear=1.0, rotor_inertia=link.armature, friction_nm=link.friction, viscous_nms=link.damping,
            torque_max_nm=told.at("torque_max_nm").number(0, above=True),
            speed_max_radps=told.at("speed_max_radps", 10.0).number(0, above=True), mass_kg=0.0,
        )  # fmt: skip
        motors[short] = _part(told, "actuator", ActuatorPart, "actuation-module")
    return modules, motors


def _places(root: Node, key: str) -> Iterable[tuple[str, Node]]:
    node = root.at(key, {})
    for place in node:
        if place != "back" and not _SHORT.fullmatch(place):
            raise ConfigError(root.source, key, place, "names such as back, thigh_l, foot_r")
        yield place, node.at(place)


def _seat(node: Node, chains: Chains, more: tuple[str, ...] = ()) -> OnLink:
    node.only(("link", "position_mm", "rpy_deg", *more))
    name = _link(node.at("link"), chains)
    leg, number = chains.carrier[name]
    link = chains.base if leg < 0 else chains.legs[leg][number]
    return OnLink(link=link.name, T_link=chains.T_carrier[name] @ _place(node))


def _link(node: Node, chains: Chains) -> str:
    if node.text() not in chains.carrier:
        raise node.error(f"a link of the model: {', '.join(chains.carrier)}")
    return node.text()


def _place(node: Node) -> Array:
    """(4, 4) pose that `position_mm` and `rpy_deg` (roll, pitch, yaw about fixed axes, as in URDF) tell."""
    T = np.eye(4)
    T[:3, 3] = 1e-3 * _triple(node.at("position_mm", [0, 0, 0]), _FARTHEST_MM)
    turn = _triple(node.at("rpy_deg", [0, 0, 0]), 360.0)
    T[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    return T


def _triple(node: Node, most: float) -> Array:
    values = np.array(node.numbers(3))
    if np.any(np.abs(values) > most):
        raise node.error(f"three numbers, {-most:g} to {most:g}")
    return values


def _known_joint(node: Node, joints: dict[str, str]) -> str:
    if node.text() not in joints:
        raise node.error(f"one of the joints {', '.join(joints) or '(none named)'}")
    return node.text()


def _part(node: Node, kind: str, of: type[P], standard: str | None = None) -> P:
    """A part of the library, or of the user's own beside the rig file."""
    told = node.at("part", standard) if standard else node.at("part")
    name = told.text()
    found = read_part(Path(node.source).parent / name) if name.endswith((".yaml", ".yml")) else None
    if found is None and name in library():
        found = part(name)
    if found is None or not isinstance(found, of):
        names = ", ".join(n for n in library() if kind_of(part(n)) == kind)
        raise told.error(f"{names}, or the path of a .yaml file of kind {kind}")
    return found
