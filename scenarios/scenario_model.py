"""The fields of a scenario file as pydantic types; `scenario_file` turns the file into a scenario.

Files hold degrees and millimetres in keys that end in `_deg` and `_mm`; attributes are in SI units and radians. The
fields of people, terrain, gait, faults and sensors are defined by their dataclasses in `sim`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from stridetwin.scenarios.sensor_model import Sensors, SensorsInFile
from stridetwin.sim.config import (
    BYSTANDERS_MAX,
    DIRECTIONS,
    DRIVES,
    LANES_MAX,
    LIGHT_RANGE,
    PATTERNS,
    PHYSICS,
    SCENERIES,
    TEXTURES,
    THINGS,
    Dynamics,
    Exo,
    Gait,
    Lanes,
    Level,
    Person,
    Ramp,
    Riser,
    Stairs,
    Thing,
    Turn,
)
from stridetwin.sim.faults.catalogue import FAULTS
from stridetwin.sim.faults.faults import Fault, TimedFault
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.sim.wearer.exoskeleton import JOINTS, modules
from stridetwin.sim.world.mesh_terrain import MeshWay
from stridetwin.streams.errors import ConfigError, Missing, StrideTwinError
from stridetwin.streams.fields import (
    FileModel,
    OneKey,
    OneKind,
    ReadAs,
    Required,
    elsewhere,
    file_beside,
    flag,
    number,
    refused,
    text,
    unique,
    whole,
    words,
)


@dataclass(frozen=True, kw_only=True)
class _UnevenStairs(Stairs):
    """A stair with risers of different heights.

    Attributes:
        riser_m: Height of each riser, in walking order.
        down: Direction of the stair, as the walker takes it.
    """

    # Keys that differ from those of `Stairs`; field() without a default makes a key required.
    risers: int = field(init=False)
    riser_m: Annotated[tuple[Riser, ...], Field(min_length=1, alias="risers_mm")] = field()
    down: Annotated[bool, words(DIRECTIONS, key="direction")] = field()

    def build(self) -> Stairs:
        """The stair, with as many risers as there are heights."""
        return Stairs(risers=len(self.riser_m), **vars(self))


_Stairs = Annotated[
    Annotated[Stairs, Required("direction"), Tag("=even")]
    | Annotated[_UnevenStairs, AfterValidator(_UnevenStairs.build), Tag("=uneven")],
    Discriminator(lambda node: "=uneven" if isinstance(node, dict) and "risers_mm" in node else "=even"),
]
_STRAIGHT: dict[str, Any] = {"level": Level, "stairs": _Stairs, "ramp": Annotated[Ramp, Required("direction")]}


class _Lanes(FileModel):
    """Terrains side by side, one of which is walked.

    Attributes:
        walk: Number of the lane to walk on; 1 is the leftmost.
        lanes: Lanes from left to right, each a list of segments.
    """

    walk: Annotated[int, whole(1, LANES_MAX)]
    lanes: Annotated[
        tuple[Annotated[tuple[Annotated[Any, OneKey(_STRAIGHT)], ...], Field(min_length=1)], ...], Field(min_length=1)
    ]

    def build(self) -> Lanes:
        """The lanes, counted from 0."""
        if self.walk > len(self.lanes):
            raise refused(self.walk, f"1-{len(self.lanes)}, the number of a lane", "walk")
        return Lanes(lanes=self.lanes, walk=self.walk - 1)


def _named_mesh(node: object) -> object:
    return {"file": node} if isinstance(node, str) else node


_Segments = Annotated[
    tuple[
        Annotated[Any, OneKey({**_STRAIGHT, "turn": Turn, "lanes": Annotated[_Lanes, AfterValidator(_Lanes.build)]})],
        ...,
    ],
    Field(min_length=1),
]
_Mesh = Annotated[MeshWay, BeforeValidator(_named_mesh, json_schema_input_type=str | MeshWay)]
_Terrain = Annotated[
    Annotated[_Segments, Tag("=segments")] | Annotated[Any, OneKey({"mesh": _Mesh}), Tag("=mesh")],
    Discriminator(lambda node: "=mesh" if isinstance(node, dict) else "=segments"),
]
_Person = Annotated[
    Annotated[Any, words(PEOPLE), Tag("=name")] | Annotated[Person, Tag("=body")],
    Discriminator(lambda node: "=name" if isinstance(node, str) else "=body"),
]


class _Exo(FileModel):
    """The exoskeleton of Shim et al. 2019.

    Attributes:
        mode: Which joints are driven: 0 none (measurement only), 1 both hips and knees, 2 both hips or both knees,
            3 hip and knee of one leg, 4 one joint.
        joints: Names of the driven joints, if the mode allows several choices.
        drive: Control of the motors in the forward simulation.
    """

    mode: Annotated[int, whole(0, 4)]
    joints: Annotated[tuple[Annotated[str, words(JOINTS)], ...], AfterValidator(unique)] = ()
    drive: Annotated[str, words(DRIVES)] = "idle"

    def build(self) -> Exo:
        """The exoskeleton, if its mode powers these joints."""
        return _powered(Exo(mode=self.mode, joints=self.joints, drive=self.drive))


class _OwnExo(FileModel):
    """A user-supplied exoskeleton.

    Attributes:
        model: MJCF or URDF file, relative to the scenario's folder.
        rig: YAML file with its cuffs, joints, motors and sensors.
        drive: Control of the motors in the forward simulation.
    """

    model: Annotated[Any, file_beside()]
    rig: Annotated[Any, file_beside()]
    drive: Annotated[str, words(DRIVES)] = "idle"

    def build(self) -> Exo:
        """The exoskeleton."""
        from stridetwin.sim.wearer.own_exo_rig import read_own_exo  # reading this field alone needs the simulator

        try:
            own = read_own_exo(self.model, self.rig)
        except StrideTwinError as error:
            raise elsewhere(error) from None
        return _powered(Exo(own=own, drive=self.drive))


def _powered(exo: Exo) -> Exo:
    try:
        modules(exo)
    except ConfigError as error:
        raise refused(error.value, error.valid, error.field) from None
    return exo


def _exo_tag(node: object) -> str:
    if not isinstance(node, dict):
        return "=none"
    return "=own" if {"model", "rig"} & set(node) else "=shim"


_ExoInFile = Annotated[
    Annotated[Any, words({"none": None}), Tag("=none")]
    | Annotated[_Exo, AfterValidator(_Exo.build), Tag("=shim")]
    | Annotated[_OwnExo, AfterValidator(_OwnExo.build), Tag("=own")],
    Discriminator(_exo_tag),
]


def _patterned(node: object) -> object:
    """A gait, with the speed and variability of its pattern unless the file sets them."""
    if not isinstance(node, dict):
        return node
    pattern = node.get("pattern")
    return PATTERNS.get(pattern, {}) | node if isinstance(pattern, str) else node


class _Place(FileModel):
    """Position of an object along the route.

    Attributes:
        at_m: Distance of its near end along the route, from the world's origin.
        left_m: Offset of its middle to the left of the route.
    """

    at_m: Annotated[float, number(-2, 500)]
    left_m: Annotated[float, number(-10, 10)] = 0.0


_Thing = OneKey(
    {kind: _Place for kind in THINGS}, lambda kind, place: Thing(kind=kind, at_m=place.at_m, left_m=place.left_m)
)


def _when(fault: Fault) -> Fault:
    """Checks that a fault with times has either a time or a rate."""
    if not isinstance(fault, TimedFault):
        return fault
    given = {key: value for key in ("at_s", "rate_per_min") if (value := getattr(fault, key)) is not None}
    if len(given) != 1:
        raise refused(list(given), "either at_s or rate_per_min")
    if fault.rate_per_min is not None and fault.duration_s is None:
        raise refused(Missing(), "this key, beside rate_per_min", "duration_s")
    return fault


FaultInFile = Annotated[Any, OneKind(FAULTS), AfterValidator(_when)]
"""Type of an item of the list `faults`, which becomes a `Fault`."""

FaultList = tuple[FaultInFile, ...]
"""Type of a list of faults in a file."""


class ScenarioFile(FileModel):
    """A scenario: the walker, the terrain, the gait and the sensors.

    Attributes:
        description: Purpose of the walk, in one line.
        terrain: Segments in walking order, or a mesh.
        width_m: Width of the route, or of each lane.
        scenery: Surroundings of the route.
        person: The walker: a predefined person by name, or body measures.
        exo: The exoskeleton; `none` for a person without one.
        texture: Amount of visual detail on ground and walls.
        light: Brightness of sun and sky; 1 is daylight.
        bystanders: Number of other people who walk around.
        things: Objects on the route, beside it or at its end.
        gait: Speed, style and variability of the walk.
        physics: `kinematic` plays the plan, `dynamic` simulates it forward.
        dynamics: How `physics: dynamic` simulates.
        sensors: Enabled groups of sensors, with options that differ from the standard rig.
        rig_mount: Mount of the RGB-D camera.
        ideal: Sensors without errors, on rigid shoes.
        shock: Heel-strike vibration and rocking of the shoes' uppers; never with ideal sensors.
        faults: Faults between sensors and recorder, of the sensors' mounts, and of the calibration.
    """

    description: Annotated[str, text()]
    terrain: _Terrain
    width_m: Annotated[float, number(1.2, 10)] = 2.4
    scenery: Annotated[str, words(SCENERIES)] = "outdoor"
    person: _Person = Person()
    exo: _ExoInFile = Exo()
    texture: Annotated[str, words(TEXTURES)] = "rich"
    light: Annotated[float, number(*LIGHT_RANGE)] = 1.0
    bystanders: Annotated[int, whole(0, BYSTANDERS_MAX)] = 0
    things: Annotated[tuple[Annotated[Any, _Thing], ...], Field(min_length=1)] = ()
    gait: Annotated[Gait, BeforeValidator(_patterned)] = Gait()
    physics: Annotated[str, words(PHYSICS)] = "kinematic"
    dynamics: Dynamics | None = None
    sensors: Annotated[Any, ReadAs(SensorsInFile)] = Sensors(groups=(), paths={})
    rig_mount: Annotated[str, words(("head", "chest"), key="camera_mount")] = "head"
    ideal: Annotated[bool, flag(key="ideal_sensors")] = False
    shock: Annotated[bool, flag()] = True
    faults: Annotated[FaultList, Field(min_length=1)] = ()
