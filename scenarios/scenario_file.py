"""Scenarios: YAML files that say who walks where, with which sensors; validated key by key.

Files hold degrees and millimetres where the key says so (`_deg`, `_mm`); what comes out is SI and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from stridetwin.scenarios.fault_fields import fault
from stridetwin.scenarios.fields import (
    Field,
    Where,
    choice,
    flag,
    integer,
    mapping,
    names_of,
    number,
    one_of,
    one_word,
    pair,
    sequence,
    suggest,
    text,
)
from stridetwin.scenarios.sensor_fields import Sensors, sensors
from stridetwin.scenarios.strict_yaml import read_yaml
from stridetwin.sim.actuation import JOINTS, modules
from stridetwin.sim.config import (
    DRIVES,
    PATTERNS,
    Dynamics,
    Exo,
    Gait,
    Gaze,
    Lanes,
    Level,
    Misstep,
    Person,
    Push,
    Ramp,
    Route,
    Segment,
    Stairs,
    Thing,
    Turn,
    TwinConfig,
)
from stridetwin.sim.fault_plan import check_faults
from stridetwin.sim.gait_checks import ASYMMETRY_MAX, GAZES, SPEED_RANGE_MPS, STAIRS, SWAY_RANGE_HZ
from stridetwin.sim.mesh_terrain import MeshWay, mesh_terrain
from stridetwin.sim.people import PEOPLE
from stridetwin.sim.route import lay_out
from stridetwin.sim.route_checks import BYSTANDERS_MAX, LANES_MAX, LIGHT_RANGE, SCENERIES, TEXTURES, THINGS
from stridetwin.sim.standard_rig import EXO_GROUPS, standard_rig
from stridetwin.sim.things import check_things
from stridetwin.streams.errors import ConfigError, StrideTwinError

SENSORS: tuple[str, ...] = TwinConfig.sensors
CAMERAS = ("foot_camera", "head_camera")
PHYSICS = ("kinematic", "dynamic")
DIRECTIONS = {"up": False, "down": True}
_OF_ROUTE = ("width_m", "scenery", "texture", "light", "bystanders", "things")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A named walk.

    Attributes:
        description: One line that says what the walk is for.
        config: What the twin is made of.
        notes: What its user should know of it.
    """

    description: str
    config: TwinConfig
    notes: tuple[str, ...] = ()


def _scenario(description: str, terrain: tuple[Segment, ...] | MeshWay, **rest: Any) -> dict[str, Any]:
    of_route = {key: rest.pop(key) for key in _OF_ROUTE if key in rest}
    if isinstance(terrain, MeshWay):
        made = mesh_terrain(terrain, of_route.get("width_m", Route.width_m))
        terrain, rest["notes"] = made.segments, (made.summary,)
    if "sensors" in rest:
        asked: Sensors = rest.pop("sensors")
        rest |= {"sensors": asked.groups, "fittings": asked.fittings, "asked": asked.asked}
    return {"description": description, "route": Route(segments=terrain, **of_route), **rest}


_MM, _DEG = 1e-3, math.pi / 180.0
_RISER_MM = number(20, 250, scale=_MM)
_ANY_STAIRS = {
    "tread_mm": Field(attribute="tread_m", read=number(200, 600, scale=_MM)),
    "direction": Field(attribute="down", read=choice(DIRECTIONS), required=True),
}
_EVEN_STAIRS = mapping(
    {
        "risers": Field(attribute="risers", read=integer(1, 60), required=True),
        "riser_mm": Field(attribute="riser_m", read=_RISER_MM),
        **_ANY_STAIRS,
    },
    Stairs,
)
_UNEVEN_STAIRS = mapping(
    {"risers_mm": Field(attribute="riser_m", read=sequence(_RISER_MM), required=True), **_ANY_STAIRS},
    lambda riser_m, **rest: Stairs(risers=len(riser_m), riser_m=riser_m, **rest),
)


def _stairs(node: object, where: Where) -> Stairs:
    """A stair of equal risers, or of the risers that are listed."""
    uneven = isinstance(node, dict) and "risers_mm" in node
    stairs: Stairs = (_UNEVEN_STAIRS if uneven else _EVEN_STAIRS)(node, where)
    return stairs


def _lanes(node: object, where: Where) -> Lanes:
    """Terrains side by side; files count lanes from 1."""
    lanes: Lanes = _LANES(node, where)
    if lanes.walk >= len(lanes.lanes):
        raise where.key("walk").error(lanes.walk + 1, f"1-{len(lanes.lanes)}, the lanes that there are")
    return lanes


_STRAIGHT = {
    "level": mapping(
        {
            "length_m": Field(attribute="length_m", read=number(0.5, 500), required=True),
            "cross_slope_deg": Field(attribute="cross_slope_rad", read=number(-5, 5, scale=_DEG)),
        },
        Level,
    ),
    "stairs": _stairs,
    "ramp": mapping(
        {
            "angle_deg": Field(attribute="angle_rad", read=number(1, 20, scale=_DEG), required=True),
            "rise_m": Field(attribute="rise_m", read=number(0.05, 10), required=True),
            "direction": Field(attribute="down", read=choice(DIRECTIONS), required=True),
        },
        Ramp,
    ),
}
_PERSON = mapping(
    {
        "height_m": Field(attribute="height_m", read=number(1.5, 1.95)),
        "mass_kg": Field(attribute="mass_kg", read=number(45, 110)),
        "sex": Field(attribute="sex", read=choice({"male": "male", "female": "female"})),
        "shoe_mm": Field(attribute="shoe_m", read=number(200, 320, scale=_MM)),
    },
    Person,
)
_EXO = mapping(
    {
        "mode": Field(attribute="mode", read=integer(0, 4), required=True),
        "joints": Field(attribute="joints", read=names_of(JOINTS)),
        "drive": Field(attribute="drive", read=one_word(DRIVES)),
    },
    Exo,
)


def _beside(node: object, where: Where) -> Path:
    """The path of a file, from the folder of the scenario."""
    if not isinstance(node, str) or not node.strip():
        raise where.error(node, "the path of a file, from the folder of the scenario")
    return Path(where.source).parent / node


def _own_exo(model: Path, rig: Path, **rest: Any) -> Exo:
    from stridetwin.sim.own_exo_rig import read_own_exo  # the one scenario that takes the simulator to be read

    return Exo(own=read_own_exo(model, rig), **rest)


_OWN_EXO = mapping(
    {
        "model": Field(attribute="model", read=_beside, required=True),
        "rig": Field(attribute="rig", read=_beside, required=True),
        "drive": Field(attribute="drive", read=one_word(DRIVES)),
    },
    _own_exo,
)
_DYNAMICS = mapping(
    {
        "assist": Field(attribute="assist", read=flag),
        "mass_error": Field(attribute="mass_error", read=number(-0.2, 0.2)),
        "torque_noise": Field(attribute="torque_noise", read=number(0, 0.5)),
        "floor_offset_mm": Field(attribute="floor_offset_m", read=number(-14, 6, scale=_MM)),
        "friction": Field(attribute="friction", read=number(0.2, 1.5)),
        "pushes": Field(
            attribute="pushes",
            read=sequence(
                mapping(
                    {
                        "at_s": Field(attribute="at_s", read=number(0, 3600), required=True),
                        "duration_s": Field(attribute="duration_s", read=number(0.01, 5)),
                        "forward_n": Field(attribute="forward_n", read=number(-500, 500)),
                        "left_n": Field(attribute="left_n", read=number(-500, 500)),
                    },
                    Push,
                )
            ),
        ),
        "missteps": Field(
            attribute="missteps",
            read=sequence(
                mapping(
                    {
                        "at_s": Field(attribute="at_s", read=number(0, 3600), required=True),
                        "forward_mm": Field(attribute="forward_m", read=number(-200, 200, scale=_MM)),
                        "left_mm": Field(attribute="left_m", read=number(-100, 100, scale=_MM)),
                    },
                    Misstep,
                )
            ),
        ),
    },
    Dynamics,
)


def _person(node: object, where: Where) -> Person:
    """Someone of the catalogue by name, or a mapping."""
    person: Person = (choice(PEOPLE) if isinstance(node, str) else _PERSON)(node, where)
    return person


def _exo(node: object, where: Where) -> Exo | None:
    """`none`, or a mapping whose joints its mode powers."""
    if node == "none":
        return None
    if not isinstance(node, dict):
        raise where.error(node, "none, or keys mode, joints, drive; or model, rig, drive")
    exo: Exo = (_OWN_EXO if {"model", "rig"} & set(node) else _EXO)(node, where)
    try:
        modules(exo)
    except ConfigError as error:
        raise where.key(error.field).error(error.value, error.valid) from None
    return exo


_GAZE = mapping(
    {
        "kind": Field(attribute="kind", read=one_word(GAZES)),
        "pitch_deg": Field(attribute="pitch_rad", read=number(-34, 45, scale=_DEG)),
        "yaw_deg": Field(attribute="yaw_rad", read=number(-40, 40, scale=_DEG)),
        "sway_yaw_deg": Field(attribute="sway_yaw_rad", read=number(0, 40, scale=_DEG)),
        "sway_pitch_deg": Field(attribute="sway_pitch_rad", read=number(0, 40, scale=_DEG)),
        "sway_hz": Field(attribute="sway_hz", read=number(*SWAY_RANGE_HZ)),
    },
    Gaze,
)


def _gaze(node: object, where: Where) -> Gaze:
    """A kind of gaze, or a mapping."""
    if isinstance(node, str):
        return Gaze(kind=one_word(GAZES)(node, where))
    gaze: Gaze = _GAZE(node, where)
    return gaze


def _shuffle(node: object, where: Where) -> float:
    """`true`, `false`, or how much."""
    return float(node) if isinstance(node, bool) else number(0, 1)(node, where)


_GAIT = mapping(
    {
        "pattern": Field(attribute="pattern", read=one_word(PATTERNS)),
        "speed_mps": Field(attribute="speed_mps", read=number(*SPEED_RANGE_MPS)),
        "step_sd": Field(attribute="step_sd", read=number(0, 0.1)),
        "stand_s": Field(attribute="stand_s", read=number(0.5, 60)),
        "stairs": Field(attribute="stairs", read=one_word(STAIRS)),
        "leading_foot": Field(attribute="leading_foot", read=choice({"left": "l", "right": "r"})),
        "asymmetry": Field(attribute="asymmetry", read=number(-ASYMMETRY_MAX, ASYMMETRY_MAX)),
        "shuffle": Field(attribute="shuffle", read=_shuffle),
        "gaze": Field(attribute="gaze", read=_gaze),
    },
    Gait.of_pattern,
)
_LANES = mapping(
    {
        "walk": Field(attribute="walk", read=integer(1, LANES_MAX), required=True),
        "lanes": Field(attribute="lanes", read=sequence(sequence(one_of(_STRAIGHT))), required=True),
    },
    lambda walk, lanes: Lanes(lanes=lanes, walk=walk - 1),
)
_TERRAIN = {
    **_STRAIGHT,
    "turn": mapping(
        {
            "angle_deg": Field(attribute="angle_rad", read=number(-360, 360, scale=_DEG), required=True),
            "radius_m": Field(attribute="radius_m", read=number(0, 100)),
        },
        Turn,
    ),
    "lanes": _lanes,
}
_MESH = mapping(
    {
        "file": Field(attribute="path", read=_beside, required=True),
        "unit": Field(attribute="scale", read=choice({"m": 1.0, "mm": 1e-3})),
        "up": Field(attribute="up", read=one_word(("z", "y"))),
        "start_m": Field(attribute="start_m", read=pair(number(-1000, 1000))),
        "heading_deg": Field(attribute="heading_rad", read=number(-360, 360, scale=_DEG)),
        "length_m": Field(attribute="length_m", read=number(1, 500)),
    },
    MeshWay,
)


def _terrain(node: object, where: Where) -> tuple[Segment, ...] | MeshWay:
    """A list of segments, or a mesh."""
    if not isinstance(node, dict):
        segments: tuple[Segment, ...] = sequence(one_of(_TERRAIN))(node, where)
        return segments
    way: MeshWay = one_of({"mesh": _mesh})(node, where)
    return way


def _mesh(node: object, where: Where) -> MeshWay:
    """A file, or a file and where the way lies on it."""
    way: MeshWay = MeshWay(path=_beside(node, where)) if isinstance(node, str) else _MESH(node, where)
    return way


_THING = {
    "at_m": Field(attribute="at_m", read=number(-2, 500), required=True),
    "left_m": Field(attribute="left_m", read=number(-10, 10)),
}
_THINGS = {kind: mapping(_THING, partial(Thing, kind=kind)) for kind in THINGS}
_FILE = mapping(
    {
        "description": Field(attribute="description", read=text, required=True),
        "terrain": Field(attribute="terrain", read=_terrain, required=True),
        "width_m": Field(attribute="width_m", read=number(1.2, 10)),
        "scenery": Field(attribute="scenery", read=one_word(SCENERIES)),
        "person": Field(attribute="person", read=_person),
        "exo": Field(attribute="exo", read=_exo),
        "texture": Field(attribute="texture", read=one_word(TEXTURES)),
        "light": Field(attribute="light", read=number(*LIGHT_RANGE)),
        "bystanders": Field(attribute="bystanders", read=integer(0, BYSTANDERS_MAX)),
        "things": Field(attribute="things", read=sequence(one_of(_THINGS))),
        "gait": Field(attribute="gait", read=_GAIT),
        "physics": Field(attribute="physics", read=one_word(PHYSICS)),
        "dynamics": Field(attribute="dynamics", read=_DYNAMICS),
        "sensors": Field(attribute="sensors", read=sensors),
        "camera_mount": Field(attribute="rig_mount", read=choice({"head": "head", "chest": "chest"})),
        "ideal_sensors": Field(attribute="ideal", read=flag),
        "shock": Field(attribute="shock", read=flag),
        "faults": Field(attribute="faults", read=sequence(fault)),
    },
    _scenario,
)


def catalogue() -> dict[str, Path]:
    """The scenarios that come with the project, name to file, sorted by name."""
    folder = Path(str(resources.files("stridetwin.scenarios"))) / "catalogue"
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))}


def load_scenario(name: str) -> Scenario:
    """Reads a scenario by its name in the catalogue, or from a YAML file.

    Args:
        name: Name of the catalogue, or path of a file (with a suffix or a separator in it).

    Raises:
        StrideTwinError: No such scenario (the message lists those there are).
        ConfigError: A bad file; the message names the file, the key, the value and what is valid.
    """
    known = catalogue()
    if name in known:
        return read_scenario(known[name])
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.parent != Path("."):
        return read_scenario(path)
    raise StrideTwinError(f"there is no scenario {name!r}; valid: {suggest(name, known)}, or the path of a .yaml file")


def read_scenario(path: Path) -> Scenario:
    """Reads one scenario file.

    Raises:
        ConfigError: As `load_scenario`.
        StrideTwinError: The file cannot be read.
    """
    return scenario_of(read_yaml(path), path)


def scenario_of(node: object, path: Path) -> Scenario:
    """The scenario that plain data describe.

    Args:
        node: What a scenario file holds.
        path: Whose the data are: it names the scenario, and parts of the user's own are looked for beside it.

    Raises:
        ConfigError: As `load_scenario`.
    """
    where = Where(source=str(path))
    values = _FILE(node, where)
    _check_order(path, values["route"].segments)
    if "dynamics" in values and values.get("physics") != "dynamic":
        raise where.key("physics").error(values.get("physics", TwinConfig.physics), "dynamic (as there is dynamics)")
    asked, notes = values.pop("asked", {}), values.pop("notes", ())
    if values.get("exo", Exo()) is None:
        _check_worn(path, asked)
    try:
        check_things(values["route"].things, lay_out(values["route"]))
    except ConfigError as error:
        at = error.field.replace("segments", "terrain")
        raise ConfigError(path, at, error.value, error.valid) from error
    scenario = Scenario(description=values.pop("description"), config=TwinConfig(name=path.stem, **values), notes=notes)
    check_faults(path, scenario.config.faults, standard_rig(scenario.config))
    return scenario


def _check_order(path: Path, segments: tuple[Segment, ...]) -> None:
    for i, segment in enumerate(segments):
        kind = type(segment).__name__.lower()
        if i in (0, len(segments) - 1) and kind != "level":
            raise ConfigError(path, f"terrain[{i}]", kind, "level (a walk starts and ends standing on the level)")
        if i and kind == "stairs" and isinstance(segments[i - 1], Stairs):
            valid = "level, ramp (the last riser of the stairs before needs a landing)"
            raise ConfigError(path, f"terrain[{i}]", kind, valid)


def _check_worn(path: Path, asked: dict[str, str]) -> None:
    for name, at in asked.items():
        if name in EXO_GROUPS:
            valid = ", ".join(n for n in SENSORS if n not in EXO_GROUPS) + " (exo: none)"
            raise ConfigError(path, at, name, valid)
