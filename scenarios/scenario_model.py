"""The fields of a scenario file as pydantic types; `scenario_file` turns the file into a scenario.

Files hold degrees and millimetres in keys that end in `_deg` and `_mm`; attributes are in SI units and radians. The
fields of people, terrain, gait, faults and sensors are defined by their dataclasses in `sim`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Discriminator,
    Field,
    StrictBool,
    StrictInt,
    Tag,
    ValidationInfo,
    create_model,
)

from stridetwin.sim.choices import BODY_PLACES, part_files
from stridetwin.sim.config import (
    DIRECTIONS,
    DRIVES,
    LIGHT_RANGE,
    MAX_BYSTANDERS,
    MAX_LANES,
    OPENING_M,
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
    LightChange,
    Motion,
    Person,
    Ramp,
    Riser,
    Site,
    Stairs,
    Thing,
    Turn,
    TwinConfig,
)
from stridetwin.sim.faults.catalogue import FAULTS
from stridetwin.sim.faults.faults import Fault, TimedFault
from stridetwin.sim.motion.marker_sets import MARKED_BODIES, MARKER_SETS
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.kinds import Part
from stridetwin.sim.parts.library import IDEAL, kind_of, load_part, read_part
from stridetwin.sim.parts.sensor_config import KIND, Clock, Facing, Seat, SensorConfig
from stridetwin.sim.people import PEOPLE
from stridetwin.sim.wearer.exoskeleton import JOINTS, modules
from stridetwin.sim.wearer.imu_places import body_of
from stridetwin.sim.world.mesh_terrain import MeshWay
from stridetwin.streams.errors import ConfigError, Missing, StrideTwinError
from stridetwin.streams.fields import (
    DEG,
    MILLIMETRES,
    MM,
    FileModel,
    InputFile,
    Number,
    OneKey,
    OneKind,
    OneOf,
    ReadAs,
    Required,
    Text,
    check_unique,
    context_folder,
    field_error,
    other_file_error,
)
from stridetwin.streams.json_schema import attribute_descriptions
from stridetwin.streams.validation import suggest


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
    down: Annotated[bool, OneOf(DIRECTIONS), Field(alias="direction")] = field()

    def build(self) -> Stairs:
        """The stair, with as many risers as there are heights."""
        # `vars` has no `risers`, which no file may set here and which has no default
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

    walk: Annotated[StrictInt, Field(ge=1, le=MAX_LANES)]
    lanes: Annotated[
        tuple[Annotated[tuple[Annotated[Any, OneKey(_STRAIGHT)], ...], Field(min_length=1)], ...], Field(min_length=1)
    ]

    def build(self) -> Lanes:
        """The lanes, with the number of the walked lane counted from 0."""
        if self.walk > len(self.lanes):
            raise field_error(self.walk, f"1-{len(self.lanes)}, the number of a lane", "walk")
        return Lanes(lanes=self.lanes, walk=self.walk - 1)


def _mesh_as_keys(node: object) -> object:
    """A mesh file's name as a mapping with the key `file`; mappings stay."""
    return {"file": node} if isinstance(node, str) else node


_Segments = Annotated[
    tuple[
        Annotated[Any, OneKey({**_STRAIGHT, "turn": Turn, "lanes": Annotated[_Lanes, AfterValidator(_Lanes.build)]})],
        ...,
    ],
    Field(min_length=1),
]
_Mesh = Annotated[MeshWay, BeforeValidator(_mesh_as_keys, json_schema_input_type=str | MeshWay)]
_Terrain = Annotated[
    Annotated[_Segments, Tag("=segments")] | Annotated[Any, OneKey({"mesh": _Mesh}), Tag("=mesh")],
    Discriminator(lambda node: "=mesh" if isinstance(node, dict) else "=segments"),
]
_Person = Annotated[
    Annotated[Any, OneOf(PEOPLE), Tag("=name")] | Annotated[Person, Tag("=body")],
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

    mode: Annotated[StrictInt, Field(ge=0, le=4)]
    joints: Annotated[tuple[Annotated[str, OneOf(JOINTS)], ...], AfterValidator(check_unique)] = ()
    drive: Annotated[str, OneOf(DRIVES)] = "idle"

    def build(self) -> Exo:
        """The exoskeleton, if its mode powers these joints."""
        return _check_powered_joints(Exo(mode=self.mode, joints=self.joints, drive=self.drive))


class _OwnExo(FileModel):
    """A user-supplied exoskeleton.

    Attributes:
        model: MJCF or URDF file, relative to the scenario's folder.
        rig: YAML file with its cuffs, joints, motors and sensors.
        drive: Control of the motors in the forward simulation.
    """

    model: InputFile
    rig: InputFile
    drive: Annotated[str, OneOf(DRIVES)] = "idle"

    def build(self) -> Exo:
        """Reads the user's model and rig file; refuses a mode without powered joints."""
        from stridetwin.sim.wearer.own_exo_rig import read_own_exo  # reading this field alone needs the simulator

        try:
            user_exo = read_own_exo(self.model, self.rig)
        except StrideTwinError as error:
            raise other_file_error(error) from None
        return _check_powered_joints(Exo(user_exo=user_exo, drive=self.drive))


def _check_powered_joints(exo: Exo) -> Exo:
    """Returns an exoskeleton if its mode can power its joints; refuses others."""
    try:
        modules(exo)
    except ConfigError as error:
        raise field_error(error.value, error.valid, error.field) from None
    return exo


def _exo_tag(node: object) -> str:
    """Which form of an exoskeleton a value in a file has: `none`, the user's own, or the built-in one."""
    if not isinstance(node, dict):
        return "=none"
    return "=own" if {"model", "rig"} & set(node) else "=shim"


_ExoInFile = Annotated[
    Annotated[Any, OneOf({"none": None}), Tag("=none")]
    | Annotated[_Exo, AfterValidator(_Exo.build), Tag("=shim")]
    | Annotated[_OwnExo, AfterValidator(_OwnExo.build), Tag("=own")],
    Discriminator(_exo_tag),
]


def _fill_pattern(node: object) -> object:
    """A gait as plain data, with the speed and variability of its pattern unless the file sets them."""
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

    at_m: Annotated[Number, Field(ge=-2, le=500)]
    left_m: Annotated[Number, Field(ge=-10, le=10)] = 0.0


def _check_change(change: LightChange) -> LightChange:
    """Returns a change of the light; refuses one whose beginning is not clear."""
    keys = [key for key in ("at_s", "at_m") if getattr(change, key) is not None]
    if len(keys) != 1:
        raise field_error(keys, "either at_s or at_m")
    return change


class _Door(_Place):
    """A door frame on the route, in a wall across it.

    Attributes:
        at_m: Distance of its near side along the route, from the world's origin.
        left_m: Offset of the opening's middle to the left of the route.
        opening_m: Clear width of the opening.
    """

    opening_m: Annotated[Number, Field(ge=0.8, le=2.5)] = OPENING_M


_THING_KEYS: dict[str, type[_Place]] = {kind: _Door if kind == "door" else _Place for kind in THINGS}
_Thing = OneKey(_THING_KEYS, lambda kind, place: Thing(kind=kind, **dict(place)))


def _check_times(fault: Fault) -> Fault:
    """Returns a fault; refuses one whose times are not clear.

    A fault with times needs either a time (`at_s`) or a rate (`rate_per_min`), and with a rate also a duration.
    """
    if not isinstance(fault, TimedFault):
        return fault
    keys = [key for key in ("at_s", "rate_per_min") if getattr(fault, key) is not None]  # those that the file has
    if len(keys) != 1:
        raise field_error(keys, "either at_s or rate_per_min")
    if fault.rate_per_min is not None and fault.duration_s is None:
        raise field_error(Missing(), "this key, beside rate_per_min", "duration_s")
    return fault


FaultInFile = Annotated[Any, OneKind(FAULTS), AfterValidator(_check_times)]
"""Type of an item of the list `faults`, which becomes a `Fault`."""

FaultList = tuple[FaultInFile, ...]
"""Type of a list of faults in a file."""


_FILE_SUFFIXES = (".yaml", ".yml")
_CALIBRATED_CLOCKS = ("foot_camera", "foot_imu", "head_camera", "head_imu")
"""Groups whose clock a calibration can hold: cameras relative to the IMUs beside them."""
_OPTIONS = {
    "foot_camera": ("light", "exposure_s", "frames", "shadows", "board", "mount"),
    "head_camera": ("light", "exposure_s", "shadows", "calibration_sd", "pitch_down_rad", "mount"),
    "head_imu": ("strike", "population"),
    "foot_imu": ("position_m", "rotation_rad", "population"),
    "exo_imu": ("population",),
    "body_imu": ("position_m", "rotation_rad", "population", "strike"),
    "sonar": ("mount",),
}
"""Attributes of a `SensorConfig` that only some groups have."""
_COMMON_OPTIONS = ("ideal", "rate_hz", "clock")
"""Attributes of a `SensorConfig` that all groups have."""
_HIGHEST_ON_SHOE_M = 0.15
"""Height of the upper of a high shoe above its sole."""
_ON_SHOE = (
    f"up to {_HIGHEST_ON_SHOE_M / MM:g}, as foot_imu is fixed to the shoe and turns with the foot; an IMU on the shank "
    "is sensors.body_imu.shank_l"
)
_OnSegment = Annotated[Number, Field(ge=-600, le=600), MILLIMETRES]
"""Coordinate on a segment of the body, which is longer than a shoe: mm in files, m here."""


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """The sensors of a scenario.

    Attributes:
        groups: Enabled groups.
        paths: Key path of every group that the file names.
        configs: Options of each group that differ from the standard rig.
    """

    groups: tuple[str, ...]
    paths: dict[str, str]
    configs: dict[str, SensorConfig] = field(default_factory=dict)


def _read_sensor_part(group: str, node: object, info: ValidationInfo) -> SensorConfig:
    """A part by its name in the library, with or without `-ideal`, or by the path of its file.

    Args:
        group: Group of sensors, which fixes the kind of the part.
        node: The name or the path, as the file has it.
        info: Pydantic's context with the folder of the scenario file.

    Returns:
        Options with the part, which is ideal if the name ends in `-ideal`.
    """
    if not isinstance(node, str):
        raise field_error(node, _valid_parts(group))
    part_name = node.removesuffix(IDEAL)
    if part_name in part_files():
        sensor_part: Part = load_part(part_name)
    elif node.endswith(_FILE_SUFFIXES):
        try:
            sensor_part, part_name = read_part(context_folder(info) / node), node
        except StrideTwinError as error:
            raise other_file_error(error) from None
    else:
        raise field_error(node, _valid_parts(group, node))
    if kind_of(sensor_part) != KIND[group]:
        raise field_error(node, _valid_parts(group))
    return SensorConfig(part=sensor_part, ideal=node != part_name)  # they differ by the suffix alone


def _valid_parts(group: str, near: str = "") -> str:
    """The valid parts of a group of sensors, as text for an error; `near` is the name that was not found."""
    names: Iterable[str] = [n for n in part_files() if kind_of(load_part(n)) == KIND[group]]
    return f"{suggest(near, names)}, each with or without {IDEAL}, or the path of a .yaml file of kind {KIND[group]}"


def _check_uncalibrated(clock: Clock) -> Clock:
    """Returns the errors of a clock; refuses `calibrated` for a group whose clock no calibration can hold."""
    if clock.calibrated:
        raise field_error(
            "calibrated", "keys offset_s, drift_ppm, jitter_s, latency_s: no calibration holds this clock"
        )
    return clock


def _seat(facing: Facing) -> Seat:
    """Position and direction of a board or sensor, from the keys of a file that give no roll about the direction."""
    return Seat(position_m=facing.position_m, faces_rad=facing.faces_rad)


def _check_direction(options: Any) -> Any:
    """Returns the options of the head camera; refuses `mount` beside `pitch_down_deg`, as both set the direction."""
    if {"mount", "pitch_down_rad"} <= options.model_fields_set:
        raise field_error(
            round(options.pitch_down_rad / DEG, 6), "no pitch_down_deg, as mount sets the direction", "pitch_down_deg"
        )
    return options


def _check_on_shoe(position_m: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    """Returns the position of a shoe's IMU; refuses one above the shoe, which in reality the shank would carry."""
    if position_m is not None and position_m[2] > _HIGHEST_ON_SHOE_M:
        raise field_error(round(position_m[2] / MM, 6), _ON_SHOE, 2)  # at item 2 of the list, z
    return position_m


def _group_type(group: str, name: str = "", own_options: tuple[str, ...] | None = None) -> Any:
    """Pydantic type of a sensor group in a file: `true`, `false`, the name of a part, or a mapping of options.

    Args:
        group: The group.
        name: Name of the mapping in the schema; "" for that of the group.
        own_options: Attributes beside those that all groups have; None for those of the group.
    """
    hints = get_type_hints(SensorConfig, include_extras=True)  # type of each option, some of them narrowed below
    if group not in _CALIBRATED_CLOCKS:
        hints["clock"] = Annotated[Clock, AfterValidator(_check_uncalibrated)]
    # a board and a sonar have no roll about the direction that they face; other mounts have
    hints["board"] = Annotated[Facing, AfterValidator(_seat)]
    hints["mount"] = hints["board"] if group == "sonar" else Seat
    position = hints["position_m"]
    hints["position_m"] = Annotated[position, AfterValidator(_check_on_shoe)]
    if group == "body_imu":
        hints["position_m"] = Annotated[tuple[_OnSegment, _OnSegment, _OnSegment], Field(alias="position_mm")]
    # None stands for an option that the file does not give
    names = (*_COMMON_OPTIONS, *(_OPTIONS.get(group, ()) if own_options is None else own_options))
    fields: dict[str, Any] = {
        "part": (Annotated[Any, BeforeValidator(partial(_read_sensor_part, group), json_schema_input_type=str)], None)
    }
    fields |= {name: (hints[name], None) for name in names}
    model = create_model(name or group, __base__=FileModel, **fields)
    descriptions = attribute_descriptions(SensorConfig)
    model.__doc__ = "Options of a group.\n\nAttributes:\n" + "".join(f"    {n}: {descriptions[n]}\n" for n in fields)
    options: Any = Annotated[model, BeforeValidator(_part_as_keys, json_schema_input_type=str | model)]
    if group == "head_camera":
        options = Annotated[options, AfterValidator(_check_direction)]
    return Annotated[
        Annotated[StrictBool, Tag("=switch")] | Annotated[options, Tag("=options")],
        Discriminator(lambda node: "=switch" if isinstance(node, bool) else "=options"),
    ]


def _part_as_keys(node: object) -> object:
    """The long form of a sensor that is given by the name of its part alone."""
    return {"part": node} if isinstance(node, str) else node


def _sensor_config(options: BaseModel, base: SensorConfig | None = None) -> SensorConfig:
    """The configuration of a group: that of its part, with the keys that the file sets in place of the part's.

    Args:
        options: What the file says.
        base: Configuration that holds where the file says nothing; None for the standard one.
    """
    values = {name: getattr(options, name) for name in options.model_fields_set}
    part: SensorConfig | None = values.pop("part", None)
    config = base or SensorConfig()
    if part is not None:
        config = replace(config, part=part.part, ideal=part.ideal)
    return replace(config, **values)


def _sensors_of_names(names: tuple[str, ...]) -> Sensors:
    """The sensors of a list of enabled groups."""
    return Sensors(groups=names, paths={group: f"sensors[{i}]" for i, group in enumerate(names)})


def _sensors_of_groups(groups: BaseModel) -> Sensors:
    """The sensors of a mapping of groups; groups that it does not name are as in `TwinConfig`."""
    # what the file says of each group: True, False, or a mapping of options, which also switches it on
    values = {name: getattr(groups, name) for name in KIND if name in groups.model_fields_set}
    return Sensors(
        groups=tuple(g for g in KIND if values.get(g, g in TwinConfig.sensors) is not False),
        paths={name: f"sensors.{name}" for name, value in values.items() if value is not False},
        configs={
            name: value if isinstance(value, SensorConfig) else _sensor_config(value)
            for name, value in values.items()
            if not isinstance(value, bool)
        },
    )


def _worn_places(places: Any) -> SensorConfig:
    """The configuration of the IMUs on the body from what the file says of each place; others have none.

    What it says of every IMU holds where a place says nothing else; without any place, all of them have one.
    """
    if places.every is False:
        raise field_error(False, "true, a part, or options; body_imu: false has none at all", "every")
    base = _sensor_config(places.every) if isinstance(places.every, BaseModel) else SensorConfig()
    values = {name: getattr(places, name) for name in BODY_PLACES if name in places.model_fields_set}
    if not values and "every" in places.model_fields_set:
        values = dict.fromkeys(BODY_PLACES, True)
    for name, value in values.items():
        if getattr(value, "strike", None) and body_of(name).startswith("foot_"):
            valid = "0 on a shoe, whose upper vibrates with shock: true"
            raise field_error(round(value.strike / G, 6), valid, name, "strike_g")
    return SensorConfig(
        places={
            name: _sensor_config(value, base) if isinstance(value, BaseModel) else base
            for name, value in values.items()
            if value is not False
        }
    )


_place_type = _group_type("body_imu")
_place_fields: dict[str, Any] = {place: (_place_type, None) for place in BODY_PLACES}
_place_fields["every"] = (_group_type("body_imu", "every_body_imu", ("population",)), None)
_Places: Any = create_model("BodyImus", __base__=FileModel, **_place_fields)
_Places.__doc__ = "IMUs on the body by place; places that are not named have none.\n\nAttributes:\n" + "".join(
    f"    {place}: IMU there: on, the name of its part, or its options.\n" for place in BODY_PLACES
)
_Places.__doc__ += "    every: Part or options of all IMUs, where a place does not name others.\n"
_BodyImus = Annotated[
    Annotated[StrictBool, Tag("=switch")] | Annotated[_Places, AfterValidator(_worn_places), Tag("=places")],
    Discriminator(lambda node: "=switch" if isinstance(node, bool) else "=places"),
]
_group_fields: dict[str, Any] = {
    group: (_BodyImus if group == "body_imu" else _group_type(group), None) for group in KIND
}
_Groups: Any = create_model("Sensors", __base__=FileModel, **_group_fields)
_Names = Annotated[
    tuple[Annotated[str, OneOf(tuple(KIND))], ...], AfterValidator(check_unique), AfterValidator(_sensors_of_names)
]
SensorsInFile = Annotated[
    Annotated[_Names, Tag("=names")] | Annotated[_Groups, AfterValidator(_sensors_of_groups), Tag("=groups")],
    Discriminator(lambda node: "=groups" if isinstance(node, dict) else "=names"),
]
"""Type of `sensors`: the list of enabled groups, or a mapping of those that differ from `TwinConfig`."""


class _MarkerPlace(FileModel):
    """Where a marker is fixed.

    Attributes:
        body: Body of the wearer, such as `pelvis`, `thigh_l` or `foot_r`.
        at_m: About where in the body's frame, x forward, y left, z up; the fit moves it by some centimetres.
    """

    body: Annotated[str, OneOf(MARKED_BODIES)]
    at_m: tuple[Number, Number, Number]


class _Motion(FileModel):
    """A recording of a person, in place of a planned walk.

    Attributes:
        file: Markers (`.trc`, `.c3d`) or joint angles (`.mot`, `.sto`, `.bvh`, `.npz`), possibly packed by gzip.
        angles: Format of joint angles; without it, the one that fits the file's name.
        markers: Set of markers; without it, the one that knows most of the names.
        places: Table of markers in place of a set, by their names in the file.
        duration_s: Length to which a short recording is looped.
    """

    file: Text
    angles: Annotated[str, OneOf(("opensim", "bvh", "amass"))] | None = None
    markers: Annotated[str, OneOf(tuple(MARKER_SETS))] | None = None
    places: dict[str, _MarkerPlace] = {}  # noqa: RUF012 (pydantic copies it)
    duration_s: Annotated[Number, Field(ge=1, le=600)] | None = None


def _build_motion(motion: _Motion, info: ValidationInfo) -> Motion:
    """The recording, whose file is relative to the folder of the scenario."""
    path = context_folder(info) / motion.file
    if not path.is_file():
        raise field_error(motion.file, "an existing file, relative to the scenario's folder", "file")
    return Motion(
        file=str(path),
        angles=motion.angles,
        markers=motion.markers,
        places=tuple((name, place.body, place.at_m) for name, place in motion.places.items()),
        duration_s=motion.duration_s,
    )


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
        light_changes: Changes of the light during the walk, each at a time or at a place of the way.
        bystanders: Number of other people who walk around.
        things: Objects on the route, beside it or at its end.
        unevenness_m: Of the floor: standard deviation of the difference in height of two places 3 m apart; 0 is an
            exact floor.
        gait: Speed, style and variability of the walk.
        physics: `kinematic` plays the plan, `dynamic` simulates it forward.
        dynamics: How `physics: dynamic` simulates.
        sensors: Enabled groups of sensors, with options that differ from the standard rig.
        rig_mount: Mount of the RGB-D camera.
        ideal: Sensors without errors, on rigid shoes.
        shock: Heel-strike vibration and rocking of the shoes' uppers; never with ideal sensors.
        faults: Faults between sensors and recorder, of the sensors' mounts, and of the calibration.
        site: Where on the Earth the walk is, for its gravity; without it gravity is 9.81 m/s².
        motion: A recording of a person that replaces the planned walk; then `terrain` may be left out, and is found.
    """

    description: Text
    terrain: _Terrain | None = None
    width_m: Annotated[Number, Field(ge=1.2, le=10)] = 2.4
    scenery: Annotated[str, OneOf(SCENERIES)] = "outdoor"
    person: _Person = Person()
    exo: _ExoInFile = Exo()
    texture: Annotated[str, OneOf(TEXTURES)] = "rich"
    light: Annotated[Number, Field(ge=LIGHT_RANGE[0], le=LIGHT_RANGE[1])] = 1.0
    light_changes: Annotated[
        tuple[Annotated[LightChange, AfterValidator(_check_change)], ...], Field(min_length=1, max_length=50)
    ] = ()
    bystanders: Annotated[StrictInt, Field(ge=0, le=MAX_BYSTANDERS)] = 0
    things: Annotated[tuple[Annotated[Any, _Thing], ...], Field(min_length=1)] = ()
    unevenness_m: Annotated[Number, Field(ge=0, le=20, alias="unevenness_mm"), MILLIMETRES] = 0.0
    gait: Annotated[Gait, BeforeValidator(_fill_pattern)] = Gait()
    physics: Annotated[str, OneOf(PHYSICS)] = "kinematic"
    dynamics: Dynamics | None = None
    sensors: Annotated[Any, ReadAs(SensorsInFile)] = Sensors(groups=(), paths={})
    rig_mount: Annotated[str, OneOf(("head", "chest")), Field(alias="camera_mount")] = "head"
    ideal: Annotated[StrictBool, Field(alias="ideal_sensors")] = False
    shock: StrictBool = True
    faults: Annotated[FaultList, Field(min_length=1)] = ()
    site: Site | None = None
    motion: Annotated[_Motion, AfterValidator(_build_motion)] | None = None
