"""Configuration of a twin: person, exoskeleton, terrain, gait and rig, as frozen dataclasses in SI and radians.

A field with `MILLIMETRES` or `DEGREES` has that unit in scenario files, such as `tread_mm` for `tread_m`. Its limits
(`ge`, `le`) are in the file's unit; its value here is in SI units or radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, StrictBool, StrictInt

from stridetwin.sim.acts import ACTS, Act
from stridetwin.sim.choices import DEFAULT_SENSORS
from stridetwin.sim.choices import PHYSICS as PHYSICS
from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.faults.faults import Fault
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.people import Person as Person
from stridetwin.streams.fields import DEGREES, MILLIMETRES, Number, OneKind, OneOf, ReadAs
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2, compute_normal_gravity

SIDES = ("l", "r")  # left, right
DIRECTIONS = {"up": False, "down": True}  # value of a segment's `down` by its word in scenario files
SPEED_RANGE_MPS = (0.05, 2.1)
MAX_ASYMMETRY = 0.4
STAIRS = ("step_over_step", "step_by_step", "two_at_a_time")
GAZES = ("ahead", "terrain", "wandering")
SWAY_RANGE_HZ = (0.05, 3.0)
MAX_LANES = 6
SCENERIES = ("outdoor", "room", "corridor")
TEXTURES = ("rich", "plain", "white")
LIGHT_RANGE = (0.2, 1.4)
MAX_BYSTANDERS = 4
THINGS = ("stripe", "shadow", "mat", "table", "chair", "crate", "wall", "glass", "door")
OPENING_M = 0.90  # of a door, clear width


DRIVES = ("idle", "assist")


@dataclass(frozen=True, kw_only=True)
class Exo:
    """The exoskeleton of Shim et al. 2019 with its actuation modules, or an exoskeleton of the user's own.

    Attributes:
        mode: 0 no modules (measurement only), 1 both hips and knees, 2 both hips or both knees, 3 hip and knee of one
            leg, 4 one joint.
        joints: Which joints have a module (hip_l, hip_r, knee_l, knee_r), where the mode leaves a choice.
        drive: What the motors do in the forward simulation: `idle` or `assist` (help both hips).
        user_exo: The user's own exoskeleton; it defines its powered joints itself, so `mode` and `joints` are ignored.
    """

    mode: int = 0
    joints: tuple[str, ...] = ()
    drive: str = "idle"
    user_exo: OwnExo | None = None


@dataclass(frozen=True, kw_only=True)
class Level:
    """Level ground.

    Attributes:
        length_m: Along the route.
        cross_slope_rad: Tilt sideways, the left side up positive.
    """

    length_m: Annotated[Number, Field(ge=0.5, le=500)]
    cross_slope_rad: Annotated[Number, Field(ge=-5, le=5, alias="cross_slope_deg"), DEGREES] = 0.0


Riser = Annotated[Number, Field(ge=20, le=250), MILLIMETRES]
"""Height of a riser: mm in files, m here."""


@dataclass(frozen=True, kw_only=True)
class Stairs:
    """Stair, straight or winding.

    The first riser is where the segment begins. There are `risers` risers with `risers - 1` treads between them, so the
    next segment is the landing.

    Attributes:
        risers: Number of risers.
        riser_m: Height of every riser, or one height per riser in walking order.
        tread_m: Depth of a tread.
        down: Which way it leads from the walker's view.
        nosing_m: How far a tread overhangs the riser below it.
        open_risers: Treads are planks without risers between them.
        tread_slope_rad: By which a tread falls towards its edge, so that rain runs off.
        edge_radius_m: Of the rounded edge of every tread and of the upper level.
        turn_rad: By which the flight turns, left positive; 0 is straight. Its treads are wedges around one pole, as
            deep as `tread_m` in the middle of the way.
    """

    risers: Annotated[StrictInt, Field(ge=1, le=60)]
    riser_m: Annotated[float | tuple[float, ...], ReadAs(Riser), Field(alias="riser_mm")] = 0.165
    tread_m: Annotated[Number, Field(ge=200, le=600, alias="tread_mm"), MILLIMETRES] = 0.29
    down: Annotated[bool, OneOf(DIRECTIONS), Field(alias="direction")] = False
    nosing_m: Annotated[Number, Field(ge=0, le=40, alias="nosing_mm"), MILLIMETRES] = 0.0
    open_risers: bool = False
    tread_slope_rad: Annotated[Number, Field(ge=0, le=3, alias="tread_slope_deg"), DEGREES] = 0.0
    edge_radius_m: Annotated[Number, Field(ge=0, le=40, alias="edge_radius_mm"), MILLIMETRES] = 0.0
    turn_rad: Annotated[Number, Field(ge=-270, le=270, alias="turn_deg"), DEGREES] = 0.0

    @property
    def heights_m(self) -> tuple[float, ...]:
        """Height of each riser, m."""
        return self.riser_m if isinstance(self.riser_m, tuple) else (self.riser_m,) * self.risers


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """Straight ramp.

    Attributes:
        angle_rad: Slope, positive.
        rise_m: Height from its lower to its upper end.
        cross_slope_rad: Tilt sideways, the left side up positive.
        down: Which way it leads from the walker's view.
    """

    angle_rad: Annotated[Number, Field(ge=1, le=20, alias="angle_deg"), DEGREES]
    rise_m: Annotated[Number, Field(ge=0.05, le=10)]
    cross_slope_rad: Annotated[Number, Field(ge=-5, le=5, alias="cross_slope_deg"), DEGREES] = 0.0
    down: Annotated[bool, OneOf(DIRECTIONS), Field(alias="direction")] = False


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Turn on the level.

    Attributes:
        angle_rad: Of the turn, left positive.
        radius_m: Of the arc; 0 turns on the spot.
    """

    angle_rad: Annotated[Number, Field(ge=-360, le=360, alias="angle_deg"), DEGREES]
    radius_m: Annotated[Number, Field(ge=0, le=100)] = 3.0


@dataclass(frozen=True, kw_only=True)
class Lanes:
    """Terrains side by side, each as wide as the way, that begin on one line at one height.

    The way leads over one of them. If the next `Lanes` continues on another lane, the level between the two is a
    landing as wide as all lanes, and the walker crosses it diagonally. Shorter lanes are extended by level ground.

    Attributes:
        lanes: From left to right, each a chain of `Level`, `Stairs` and `Ramp`.
        walk: Number of the lane that is walked, 0 is the leftmost.
    """

    lanes: tuple[tuple[Level | Stairs | Ramp, ...], ...]
    walk: int


Segment = Level | Stairs | Ramp | Turn | Lanes


@dataclass(frozen=True, kw_only=True)
class Thing:
    """An object on or beside the way that is not walkable ground, but looks like it or occludes it.

    Attributes:
        kind: Flat across the way are `stripe`, a hazard marking, `shadow`, and `mat`, black and without depth; upright
            are `table`, `chair`, `crate`, as high as a step, `wall`, and `glass`, a pane that cameras look through; a
            `door` is a wall across the way with an opening in a frame, through which the walker goes.
        at_m: Where it begins along the way, from the world's origin.
        left_m: Distance of its middle to the left of the way.
        opening_m: Clear width of a door.
    """

    kind: str
    at_m: float
    left_m: float = 0.0
    opening_m: float = OPENING_M


@dataclass(frozen=True, kw_only=True)
class LightChange:
    """A change of sun and sky, or of the lamps of a building, during the walk.

    Attributes:
        to: Brightness afterwards; 1 is daylight.
        at_s: Time at which it begins.
        at_m: Arc length along the way at which it begins, in place of a time: as the walker gets there.
        over_s: How long it takes.
    """

    to: Annotated[Number, Field(ge=0.002, le=LIGHT_RANGE[1])]
    at_s: Annotated[Number | None, Field(ge=0, le=3600)] = None
    at_m: Annotated[Number | None, Field(ge=0, le=2000)] = None
    over_s: Annotated[Number, Field(ge=0, le=600)] = 0.0


@dataclass(frozen=True, kw_only=True)
class Route:
    """Terrain along the walk, segment by segment from the world's origin along its x axis.

    Attributes:
        segments: Each begins where the one before ends, in its direction and at its height.
        width_m: Width of the way, or of each lane.
        scenery: Surroundings: `outdoor`, `room` or `corridor`.
        texture: Visual texture of ground and walls: `rich`, `plain` or bare `white`.
        light: Brightness of sun and sky; 1 is daylight.
        light_changes: Changes of the light during the walk.
        bystanders: Number of people who walk about, 0-4.
        things: Objects on the way, beside it or at its end.
        unevenness_m: Of the floor: standard deviation of the difference in height of two places 3 m apart, beyond that
            of the segments; 0 is an exact floor.
    """

    segments: tuple[Segment, ...]
    width_m: float = 2.4
    scenery: str = "outdoor"
    texture: str = "rich"
    light: float = 1.0
    light_changes: tuple[LightChange, ...] = ()
    bystanders: int = 0
    things: tuple[Thing, ...] = ()
    unevenness_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Gaze:
    """Gaze of the walker.

    Attributes:
        kind: `ahead` along the way, `terrain` down at the ground of the next steps, or `wandering` around.
        pitch_rad: Added to the pitch of the head, down positive.
        yaw_rad: Added to the yaw of the head, left positive.
        sway_yaw_rad: Amplitude of a periodic rotation to both sides, added to all of the above.
        sway_pitch_rad: Amplitude of a nod at the same frequency, delayed by a quarter of a period.
        sway_hz: Frequency of the sway; the head's highest angular rate is 2 pi times frequency and amplitude, rad/s.
    """

    kind: Annotated[str, OneOf(GAZES)] = "ahead"
    pitch_rad: Annotated[Number, Field(ge=-34, le=45, alias="pitch_deg"), DEGREES] = 0.0
    yaw_rad: Annotated[Number, Field(ge=-40, le=40, alias="yaw_deg"), DEGREES] = 0.0
    sway_yaw_rad: Annotated[Number, Field(ge=0, le=40, alias="sway_yaw_deg"), DEGREES] = 0.0
    sway_pitch_rad: Annotated[Number, Field(ge=0, le=40, alias="sway_pitch_deg"), DEGREES] = 0.0
    sway_hz: Annotated[Number, Field(ge=SWAY_RANGE_HZ[0], le=SWAY_RANGE_HZ[1])] = 0.5


def _expand_gaze(node: object) -> object:
    """Mapping of a gaze that a scenario file gives by its kind alone, such as `terrain`; other values are unchanged."""
    return {"kind": node} if isinstance(node, str) else node


@dataclass(frozen=True, kw_only=True)
class Stop:
    """A stop on the way, on both feet, at any place: the level, a ramp or a stair's tread.

    Attributes:
        at_m: Along the way; the walker stops at about the first foothold from there on.
        for_s: How long the walker stands.
    """

    at_m: Annotated[Number, Field(ge=0, le=2000)]
    for_s: Annotated[Number, Field(ge=0.3, le=60)]


def _bool_to_share(node: object) -> object:
    """A share: 1 for `true` and 0 for `false` in a scenario file; other values are unchanged."""
    return float(node) if isinstance(node, bool) else node


@dataclass(frozen=True, kw_only=True)
class Gait:
    """How the person walks.

    Attributes:
        pattern: `walk`; `wander`, a stroll of changing speed with pauses; `jog`, the fastest walk (no flight); or
            `run`, with a flight between the steps (kinematic alone).
        speed_mps: Preferred speed on level ground.
        step_sd: Step-to-step variability of length and time, as a fraction (SD).
        stand_s: Standing time at the start and at the end.
        stairs: `step_over_step`; `step_by_step` with both feet on every tread; or `two_at_a_time` on the way up, where
            the legs are long enough for it.
        leading_foot: Foot that goes first on stairs that are walked step by step, `l` or `r`.
        asymmetry: Limp: steps of the left leg are longer in space and time by this fraction, and those of the right leg
            shorter; the stance of the left leg is shorter as a result (Balasubramanian et al. 2007).
        shuffle: From 0, feet that are lifted, to 1, feet that slide flat along the ground in short steps.
        gaze: Where the walker looks.
        stops: Where the walker stands still for a while.
        acts: What the walker does on the way beside walking on.
    """

    pattern: Annotated[str, OneOf(("walk", "wander", "jog", "run"))] = "walk"
    speed_mps: Annotated[Number, Field(ge=SPEED_RANGE_MPS[0], le=SPEED_RANGE_MPS[1])] = 1.2
    step_sd: Annotated[Number, Field(ge=0, le=0.1)] = 0.015
    stand_s: Annotated[Number, Field(ge=0.5, le=60)] = 2.0
    stairs: Annotated[str, OneOf(STAIRS)] = "step_over_step"
    leading_foot: Annotated[str, OneOf({"left": "l", "right": "r"})] = "r"
    asymmetry: Annotated[Number, Field(ge=-MAX_ASYMMETRY, le=MAX_ASYMMETRY)] = 0.0
    shuffle: Annotated[
        Annotated[Number, Field(ge=0, le=1)],
        BeforeValidator(_bool_to_share, json_schema_input_type=bool | Annotated[Number, Field(ge=0, le=1)]),
    ] = 0.0
    gaze: Annotated[Gaze, BeforeValidator(_expand_gaze, json_schema_input_type=Annotated[str, OneOf(GAZES)] | Gaze)] = (
        field(default_factory=Gaze)
    )
    stops: Annotated[tuple[Stop, ...], Field(min_length=1)] = ()
    acts: Annotated[tuple[Annotated[Act, OneKind(ACTS)], ...], Field(min_length=1, max_length=100)] = ()

    @classmethod
    def of_pattern(cls, pattern: str = "walk", **values: Any) -> Gait:
        """Gait with the speed and variability of its pattern, except for the given `values`."""
        # the given values replace those of the pattern
        return cls(pattern=pattern, **(PATTERNS[pattern] | values))


# Zhao et al. 2023 give the speeds of their three patterns together: 0.78 +- 0.27 m/s, 0.05 to 2.12 m/s.
PATTERNS: dict[str, dict[str, float]] = {
    "wander": {"speed_mps": 0.6, "step_sd": 0.04},
    "walk": {},
    "jog": {"speed_mps": 1.8, "step_sd": 0.02},
    "run": {"speed_mps": 2.0, "step_sd": 0.02},
}


@dataclass(frozen=True, kw_only=True)
class Push:
    """An external push on the pelvis.

    Attributes:
        at_s: Start time.
        duration_s: Duration.
        forward_n, left_n: Force along and across the way, N; negative backward and to the right.
    """

    at_s: Annotated[Number, Field(ge=0, le=3600)]
    duration_s: Annotated[Number, Field(ge=0.01, le=5)] = 0.1
    forward_n: Annotated[Number, Field(ge=-500, le=500)] = 0.0
    left_n: Annotated[Number, Field(ge=-500, le=500)] = 0.0


@dataclass(frozen=True, kw_only=True)
class Misstep:
    """A foot that lands beside its planned foothold.

    Attributes:
        at_s: The first foot to land after this instant.
        forward_m, left_m: Offset from the foothold, along and across the way.
    """

    at_s: Annotated[Number, Field(ge=0, le=3600)]
    forward_m: Annotated[Number, Field(ge=-200, le=200, alias="forward_mm"), MILLIMETRES] = 0.0
    left_m: Annotated[Number, Field(ge=-100, le=100, alias="left_mm"), MILLIMETRES] = 0.0


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """Forward simulation of a walk: assistance at the root, and disturbances unknown to the wearer's controller.

    Attributes:
        assist: Whether a soft wrench may help at the root; the applied wrench is recorded.
        mass_error: Relative excess of the true body mass over the controller's model.
        torque_noise: SD of the joint torque error, as a fraction of each torque.
        floor_offset_m: Height of the true floor above the planned one.
        friction: Coefficient of friction of soles on the ground.
        pushes: External pushes.
        missteps: Feet that land beside their footholds.
    """

    assist: StrictBool = False
    mass_error: Annotated[Number, Field(ge=-0.2, le=0.2)] = 0.0
    torque_noise: Annotated[Number, Field(ge=0, le=0.5)] = 0.0
    floor_offset_m: Annotated[Number, Field(ge=-14, le=6, alias="floor_offset_mm"), MILLIMETRES] = 0.0
    friction: Annotated[Number, Field(ge=0.2, le=1.5)] = 0.9
    pushes: Annotated[tuple[Push, ...], Field(min_length=1)] = ()
    missteps: Annotated[tuple[Misstep, ...], Field(min_length=1)] = ()


@dataclass(frozen=True, kw_only=True)
class Site:
    """Where on the Earth the walk is, for its gravity.

    Attributes:
        latitude_rad: Geodetic latitude, north positive.
        height_m: Height above the ellipsoid of the WGS 84, about that above the sea.
    """

    latitude_rad: Annotated[Number, Field(ge=-90, le=90, alias="latitude_deg"), DEGREES]
    height_m: Annotated[Number, Field(ge=-500, le=9000)] = 0.0


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A recording of a person that the wearer moves like.

    Attributes:
        file: Path of the recording, possibly `.gz`: markers (`.trc`, `.c3d`) or joint angles (`.mot`, `.sto`, `.bvh`,
            `.npz`).
        angles: Format of joint angles; None for the one that fits the file's name.
        markers: Set of markers by name; None for the one that fits the names.
        places: The user's own table in place of a set: name of each marker, body, and place in its frame, m.
        duration_s: Length to which a short recording is looped; None for its own length.
        finds_terrain: Whether the terrain follows from the rests of the feet; otherwise it is the route's.
        given_person: The person of the scenario, once lengths are fitted; None before.
        fitted_s: Length of the walk, once it is fitted; None before.
    """

    file: str
    angles: str | None = None
    markers: str | None = None
    places: tuple[tuple[str, str, tuple[float, float, float]], ...] = ()
    duration_s: float | None = None
    finds_terrain: bool = True
    given_person: Person | None = None
    fitted_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """Complete definition of a walk; together with a seed it determines every byte of the recording.

    Attributes:
        name: Name of the scenario.
        route: Terrain and surroundings.
        person: The person who walks.
        exo: The exoskeleton; None for a person without it, and then without its sensors.
        gait: How the person walks.
        physics: `kinematic`, a walk exactly as planned, or `dynamic`, its forward simulation.
        sensors: Groups of sensors that are on: foot_imu, foot_camera, sonar, insole, ahrs, encoder, interaction,
            actuator, head_imu, head_camera; and, off by default, exo_imu, the AHRSs' inertial sensors, and body_imu,
            IMUs on segments of the body.
        fittings: Groups whose part, rate or clock differs from the standard.
        rig_mount: `head` or `chest`: where the RGB-D camera sits.
        ideal: Noise-free sensors on rigid shoes.
        shock: Whether the shoes' uppers vibrate at heel strike and rock in stance; never with ideal sensors.
        dynamics: Parameters of `physics: dynamic`; None for its defaults.
        faults: Faults between sensors and recorder, and faults of the sensor mounts.
        site: Where the walk is; None for a site of nominal gravity.
        motion: A recorded motion in place of a planned one; lengths of the person, and the terrain unless it is given,
            follow from it.
    """

    name: str
    route: Route
    person: Person = field(default_factory=Person)
    exo: Exo | None = field(default_factory=Exo)
    gait: Gait = field(default_factory=Gait)
    physics: str = "kinematic"
    sensors: tuple[str, ...] = DEFAULT_SENSORS
    fittings: Mapping[str, SensorConfig] = field(default_factory=dict)
    rig_mount: str = "head"
    ideal: bool = False
    shock: bool = True
    dynamics: Dynamics | None = None
    faults: tuple[Fault, ...] = ()
    site: Site | None = None
    motion: Motion | None = None

    @property
    def gravity_mps2(self) -> float:
        """Gravity of the walk: normal gravity at its site (WGS 84), or the nominal one."""
        if self.site is None:
            return NOMINAL_GRAVITY_MPS2
        return compute_normal_gravity(self.site.latitude_rad, self.site.height_m)
