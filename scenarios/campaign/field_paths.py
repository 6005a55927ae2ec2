"""Paths of keys into a scenario, such as `terrain[1].stairs.riser_mm`, and the assignment of values to them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from stridetwin.scenarios.scenario_model import ScenarioFile
from stridetwin.sim.choices import BODY_PLACES
from stridetwin.sim.config import Person, TwinConfig
from stridetwin.sim.parts.sensor_config import KIND, Seat
from stridetwin.sim.sensors.standard_rig import FOOT_BOARD, FOOT_CAMERA, FOOT_IMU, RGBD_MOUNT, RGBD_PITCH_RAD, SONAR
from stridetwin.sim.wearer.imu_places import default_position
from stridetwin.streams.errors import FieldLocation, StrideTwinError
from stridetwin.streams.fields import DEG, MM
from stridetwin.streams.validation import validate

# one step of a path: a key, and the indices of list items after it
_STEP = re.compile(r"([a-z][a-z0-9_]*)((?:\[\d{1,4}\])*)")
PlainScenario = dict[str, object]
"""Content of a scenario file: its keys, with texts, numbers, lists and mappings as the file has them."""
_FORM = "keys with dots between and numbers of items in brackets, such as terrain[1].stairs.riser_mm"


@dataclass(frozen=True, kw_only=True)
class FieldPath:
    """A field of a scenario: its text in the file, and the keys of mappings and indices of lists from the root."""

    text: str
    keys: tuple[str | int, ...]


def field_path(text: str, where: FieldLocation) -> FieldPath:
    """Parses the path of a field, such as `terrain[1].stairs.riser_mm`.

    Args:
        text: The path, keys with dots between and indices of list items in brackets.
        where: Position of the text in the user's file, for the error.

    Raises:
        ConfigError: The text is not a path.
    """
    keys: list[str | int] = []
    for step in text.split("."):
        match = _STEP.fullmatch(step)  # a key, and the indices after it in brackets, if any
        if match is None:
            raise where.error(text, _FORM)
        keys += [match[1], *(int(number) for number in re.findall(r"\d+", match[2]))]
    return FieldPath(text=text, keys=tuple(keys))


def set_value(scenario: PlainScenario, path: FieldPath, value: object, where: FieldLocation) -> None:
    """Sets a value in a scenario's plain data and creates missing keys on the way.

    A list of sensor groups, and the short forms of a group, become mappings first. A mount of which the value is only a
    part, such as one coordinate, gets the standard values first, so that the rest stays where it was.

    Args:
        scenario: Plain data of the scenario, which is changed.
        path: The field.
        value: Plain data.
        where: Position of the value in the user's file, for errors.

    Raises:
        ConfigError: A node on the way has no such place.
    """
    node: Any = scenario  # a mapping or a list, as the key says
    # below `sensors` (depth 0) there may be a list of groups, below the name of a group (depth 1) its short form, and
    # below `body_imu` that of a place (depth 2)
    short_forms = (1 + (path.keys[1:2] == ("body_imu",))) if path.keys[0] == "sensors" else -1
    for depth, key in enumerate(path.keys[:-1]):
        _check_place(node, path, depth, where)
        if isinstance(key, str) and key not in node:
            node[key] = _standard_mount(scenario, path.keys[: depth + 1])
        if depth <= short_forms:
            node[key] = _expand_short_form(node[key], path.keys[: depth + 1])
        node = node[key]
    _check_place(node, path, len(path.keys) - 1, where)
    node[path.keys[-1]] = value


def _standard_mount(scenario: PlainScenario, keys: tuple[str | int, ...]) -> Any:
    """The standard mount at a path in plain data of a file, such as that of `sensors.foot_imu.position_mm`.

    Args:
        scenario: Plain data; a pitch of its RGB-D camera moves into the camera's mount.
        keys: Path of the mount.

    Returns:
        A list or mapping in mm and degrees; {} where there is no mount.
    """
    match keys:
        case ("sensors", "foot_imu", "position_mm"):
            return _in_units(FOOT_IMU, MM)
        case ("sensors", "foot_imu", "rotation_deg") | ("sensors", "body_imu", _, "rotation_deg"):
            return [0.0, 0.0, 0.0]
        case ("sensors", "body_imu", str(place), "position_mm") if place in BODY_PLACES:
            return _in_units(default_position(place, _read_person(scenario)), MM)
        case ("sensors", "foot_camera", "mount"):
            return _mount_in_file(FOOT_CAMERA) | {"roll_deg": _in_units([FOOT_CAMERA.roll_rad], DEG)[0]}
        case ("sensors", "foot_camera", "board"):
            return _mount_in_file(FOOT_BOARD)
        case ("sensors", "sonar", "mount"):
            return _mount_in_file(SONAR)
        case ("sensors", "head_camera", "mount"):
            sensors: Any = scenario["sensors"]
            pitch_deg = sensors["head_camera"].pop("pitch_down_deg", RGBD_PITCH_RAD / DEG)
            _, position_m = RGBD_MOUNT[str(scenario.get("camera_mount", "head"))]  # the body, and the place on it
            # it faces forward (0° aside), and down by the pitch
            return {"position_mm": _in_units(position_m, MM), "faces_deg": [0.0, -round(pitch_deg, 6)]}
        case _:
            return {}


def _read_person(scenario: PlainScenario) -> Person:
    """The walker of plain data, which may be invalid otherwise; the default one if the data name none that is valid."""
    node = {"description": "a person", "person": scenario["person"]} if "person" in scenario else {}
    try:
        person: Person = validate(ScenarioFile, node, "person").person if node else Person()
    except StrideTwinError:  # an invalid person is reported when the scenario is read
        return Person()
    return person


def _mount_in_file(seat: Seat) -> dict[str, list[float]]:
    """Position and direction of a mount as a scenario file gives them, mm and degrees."""
    return {"position_mm": _in_units(seat.position_m, MM), "faces_deg": _in_units(seat.faces_rad, DEG)}


def _in_units(values: Iterable[float], unit: float) -> list[float]:
    """Values in SI units as multiples of a unit, rounded as in a file."""
    return [round(value / unit, 6) for value in values]


def set_values(scenario: PlainScenario, paths: Iterable[FieldPath], value: object, where: FieldLocation) -> None:
    """Sets a value at several fields of a scenario, each with a copy of its own.

    Args:
        scenario: Plain data of the scenario, which is changed.
        paths: The fields.
        value: Plain data.
        where: Position of the value in the user's file, for errors.

    Raises:
        ConfigError: The scenario has no place for a field.
    """
    for path in paths:
        set_value(scenario, path, deepcopy(value), where)


def _check_place(node: object, path: FieldPath, depth: int, where: FieldLocation) -> None:
    """Checks that a node of plain data has a place for the key of a path at some depth.

    Args:
        node: The node, reached by the keys before this depth.
        path: The path.
        depth: Number of the key.
        where: Position of the value in the user's file, for the error.

    Raises:
        ConfigError: A text key needs a mapping; a number needs a list with so many items.
    """
    key, node_text = path.keys[depth], _text(path.keys[:depth])
    if isinstance(key, str) and isinstance(node, dict):
        return
    if not (isinstance(key, int) and isinstance(node, list)):
        raise where.error(path.text, f"a field of the scenario, where {node_text} is {_short(node)}")
    if key >= len(node):
        raise where.error(path.text, f"{node_text}[0] to {node_text}[{len(node) - 1}]")


def _expand_short_form(node: object, keys: tuple[str | int, ...]) -> object:
    """The sensors of a scenario, one group of them, or an IMU on the body as a mapping, the long form in a file.

    Args:
        node: A list of enabled groups, or of one group the name of its part or whether it is on; a mapping stays.
        keys: Path of the node.
    """
    if keys == ("sensors", "body_imu"):
        return {place: True for place in BODY_PLACES} if node is True else {} if isinstance(node, bool) else node
    if len(keys) > 1:
        if isinstance(node, str):
            return {"part": node}
        # a switch becomes an empty mapping, off as well as on: an option in it switches the group on
        return {} if isinstance(node, bool) else node
    if isinstance(node, list):
        # only the groups whose state differs from the default one
        return {group: group in node for group in KIND if (group in node) != (group in TwinConfig.sensors)}
    return node


def _text(keys: tuple[str | int, ...]) -> str:
    """A path of keys and indices as text, such as `terrain[0].ramp`."""
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).removeprefix(".") or "the scenario"


def _short(node: object) -> str:
    """A value as text for a message, cut off where it is long."""
    text = repr(node)
    return text if len(text) < 60 else f"{text[:56]} ..."
