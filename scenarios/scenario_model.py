"""What a scenario file may say, field by field, as pydantic types; `scenario_file` makes a scenario of it.

Files hold degrees and millimetres where the key says so (`_deg`, `_mm`); attributes are SI and radians. The fields of
people, terrain, gait, faults and sensors are those of the dataclasses that they become.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag

from stridetwin.scenarios.sensor_model import Sensors, SensorsInFile
from stridetwin.sim.config import (
    BYSTANDERS_MAX,
    DIRECTIONS,
    DRIVES,
    LANES_MAX,
    LIGHT_RANGE,
    PATTERNS,
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
from stridetwin.sim.faults.faults import Fault, LooseStrap
from stridetwin.sim.faults.image_faults import LensDirt, Occlusion
from stridetwin.sim.faults.sample_faults import (
    ClockJump,
    DeadCell,
    Dropout,
    Freeze,
    Late,
    Nan,
    OutOfOrder,
    Repeat,
    Saturation,
)
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.sim.wearer.exoskeleton import JOINTS, modules
from stridetwin.sim.world.mesh_terrain import MeshWay
from stridetwin.streams.errors import ConfigError, Missing, StrideTwinError
from stridetwin.streams.fields import (
    MM,
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

PHYSICS = ("kinematic", "dynamic")
FAULTS: dict[str, type[Fault]] = {
    kind.kind: kind
    for kind in (
        Dropout, Freeze, Repeat, Nan, Late, OutOfOrder, ClockJump, Saturation, DeadCell, Occlusion, LensDirt, LooseStrap
    )
}  # fmt: skip


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _UnevenStairs(_Model):
    """Straight stair of the risers that are listed.

    Attributes:
        risers_mm: Height of each riser in the order of the walk.
        tread_m: Depth of a tread.
        down: Which way it leads from the walker's view.
    """

    risers_mm: Annotated[tuple[Riser, ...], Field(min_length=1)]
    tread_m: Annotated[float, number(200, 600, key="tread_mm", scale=MM)] = Stairs.tread_m
    down: Annotated[bool, words(DIRECTIONS, key="direction")]

    def build(self) -> Stairs:
        """The stair."""
        return Stairs(risers=len(self.risers_mm), riser_m=self.risers_mm, tread_m=self.tread_m, down=self.down)


_Stairs = Annotated[
    Annotated[Stairs, Required("direction"), Tag("=even")]
    | Annotated[_UnevenStairs, AfterValidator(_UnevenStairs.build), Tag("=uneven")],
    Discriminator(lambda node: "=uneven" if isinstance(node, dict) and "risers_mm" in node else "=even"),
]
_STRAIGHT: dict[str, Any] = {"level": Level, "stairs": _Stairs, "ramp": Annotated[Ramp, Required("direction")]}


class _Lanes(_Model):
    """Terrains side by side.

    Attributes:
        walk: Number of the lane that is walked, from 1, the leftmost.
        lanes: From left to right, each a list of segments.
    """

    walk: Annotated[int, whole(1, LANES_MAX)]
    lanes: Annotated[
        tuple[Annotated[tuple[Annotated[Any, OneKey(_STRAIGHT)], ...], Field(min_length=1)], ...], Field(min_length=1)
    ]

    def build(self) -> Lanes:
        """The lanes, counted from 0."""
        if self.walk > len(self.lanes):
            raise refused(self.walk, f"1-{len(self.lanes)}, the lanes that there are", "walk")
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


class _Exo(_Model):
    """The exoskeleton of Shim et al. 2019.

    Attributes:
        mode: 0 no modules (measurement only), 1 both hips and knees, 2 both hips or both knees, 3 hip and knee of one
            leg, 4 one joint.
        joints: Which joints have a module, where the mode leaves a choice.
        drive: What the motors do in the forward simulation.
    """

    mode: Annotated[int, whole(0, 4)]
    joints: Annotated[tuple[Annotated[str, words(JOINTS)], ...], AfterValidator(unique)] = ()
    drive: Annotated[str, words(DRIVES)] = "idle"

    def build(self) -> Exo:
        """The exoskeleton, if its mode powers these joints."""
        return _powered(Exo(mode=self.mode, joints=self.joints, drive=self.drive))


class _OwnExo(_Model):
    """An exoskeleton of the user's own.

    Attributes:
        model: MJCF or URDF file, from the folder of the scenario.
        rig: YAML file of its cuffs, joints, motors and sensors.
        drive: What the motors do in the forward simulation.
    """

    model: Annotated[Any, file_beside()]
    rig: Annotated[Any, file_beside()]
    drive: Annotated[str, words(DRIVES)] = "idle"

    def build(self) -> Exo:
        """The exoskeleton."""
        from stridetwin.sim.wearer.own_exo_rig import read_own_exo  # the one field that takes the simulator to be read

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
    """A gait with the speed and variability of its pattern where the file does not say otherwise."""
    if not isinstance(node, dict):
        return node
    pattern = node.get("pattern")
    return PATTERNS.get(pattern, {}) | node if isinstance(pattern, str) else node


class _Place(_Model):
    """Where something lies or stands.

    Attributes:
        at_m: Where it begins along the way, from the world's origin.
        left_m: How far its middle lies to the left of the way.
    """

    at_m: Annotated[float, number(-2, 500)]
    left_m: Annotated[float, number(-10, 10)] = 0.0


_Thing = OneKey(
    {kind: _Place for kind in THINGS}, lambda kind, place: Thing(kind=kind, at_m=place.at_m, left_m=place.left_m)
)


def _when(fault: Fault) -> Fault:
    """A fault that says either when or how often."""
    given = {key: value for key in ("at_s", "rate_per_min") if (value := getattr(fault, key)) is not None}
    if len(given) != 1:
        raise refused(list(given), "either at_s or rate_per_min")
    if fault.rate_per_min is not None and fault.duration_s is None:
        raise refused(Missing(), "this key, beside rate_per_min", "duration_s")
    return fault


class ScenarioFile(_Model):
    """A scenario: who walks where, with which sensors.

    Attributes:
        description: One line that says what the walk is for.
        terrain: Segments from the start of the walk to its end, or a mesh.
        width_m: Of the way, or of each lane.
        scenery: What stands around.
        person: Who walks: someone of the catalogue, or a body.
        exo: The exoskeleton; `none` for a person without it.
        texture: How much there is to see on ground and walls.
        light: Brightness of sun and sky, 1 as by day.
        bystanders: Number of people who walk about.
        things: What lies on the way or stands beside it or at its end.
        gait: How the person walks.
        physics: `kinematic` plays the plan, `dynamic` simulates it forward.
        dynamics: How `physics: dynamic` simulates.
        sensors: Groups of sensors that are on, and what each has that the standard one has not.
        rig_mount: Where the RGB-D camera sits.
        ideal: Noise-free sensors on rigid shoes.
        shock: The shoes' uppers vibrate when the feet strike and rock in stance; never with ideal sensors.
        faults: What goes wrong between sensors and recorder, and with what holds the sensors.
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
    sensors: Annotated[Any, ReadAs(SensorsInFile)] = Sensors(groups=(), asked={})
    rig_mount: Annotated[str, words(("head", "chest"), key="camera_mount")] = "head"
    ideal: Annotated[bool, flag(key="ideal_sensors")] = False
    shock: Annotated[bool, flag()] = True
    faults: Annotated[tuple[Annotated[Any, OneKind(FAULTS), AfterValidator(_when)], ...], Field(min_length=1)] = ()
