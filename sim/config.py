"""Configuration of a twin: person, exoskeleton, terrain, gait and rig, as frozen dataclasses in SI and radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from stridetwin.sim.faults import Fault
from stridetwin.sim.fitting import SensorConfig

if TYPE_CHECKING:
    from stridetwin.sim.own_exo import OwnExo

SIDES = ("l", "r")


@dataclass(frozen=True, kw_only=True)
class Person:
    """The person who walks.

    Attributes:
        height_m: Standing height without shoes, 1.50-1.95.
        mass_kg: Body mass, 45-110.
        sex: `male` or `female` (de Leva's tables).
        shoe_m: Shoe size as the length of the foot that it fits (260 mm and the like), 0.20-0.32; None derives it from
            the stature.
    """

    height_m: float = 1.75
    mass_kg: float = 75.0
    sex: str = "male"
    shoe_m: float | None = None


DRIVES = ("idle", "assist")


@dataclass(frozen=True, kw_only=True)
class Exo:
    """The exoskeleton of Shim et al. 2019 with its actuation modules, or an exoskeleton of the user's own.

    Attributes:
        mode: 0 no modules (measurement only), 1 both hips and knees, 2 both hips or both knees, 3 hip and knee of one
            leg, 4 one joint.
        joints: Which joints have a module (hip_l, hip_r, knee_l, knee_r), where the mode leaves a choice.
        drive: What the motors do in the forward simulation: `idle` or `assist` (help both hips).
        own: The user's own exoskeleton; it defines its powered joints itself, so `mode` and `joints` are ignored.
    """

    mode: int = 0
    joints: tuple[str, ...] = ()
    drive: str = "idle"
    own: OwnExo | None = None


@dataclass(frozen=True, kw_only=True)
class Level:
    """Level ground, `length_m` along the route; `cross_slope_rad` tilts it sideways, the left side up positive."""

    length_m: float
    cross_slope_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Stairs:
    """Straight stair; `down` from the walker's view.

    The first riser is where the segment begins. There are `risers` risers with `risers - 1` treads between them, so the
    next segment is the landing. `riser_m` is the height of every riser, or one height per riser in walking order.
    """

    risers: int
    riser_m: float | tuple[float, ...] = 0.165
    tread_m: float = 0.29
    down: bool = False

    @property
    def heights_m(self) -> tuple[float, ...]:
        """Height of each riser, m."""
        return self.riser_m if isinstance(self.riser_m, tuple) else (self.riser_m,) * self.risers


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """Straight ramp; positive angle goes up."""

    angle_rad: float
    rise_m: float
    down: bool = False


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Turn on the level, left positive: an arc of `radius_m`, or on the spot where that is 0."""

    angle_rad: float
    radius_m: float = 3.0


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
        kind: `stripe`, a hazard marking painted across the way, or `shadow`, both flat; upright `table` or `wall`.
        at_m: Where it begins along the way, from the world's origin.
        left_m: Distance of its middle to the left of the way.
    """

    kind: str
    at_m: float
    left_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Route:
    """Terrain along the walk, segment by segment from the world's origin along its x axis.

    Attributes:
        segments: Each begins where the one before ends, in its direction and at its height.
        width_m: Width of the way, or of each lane.
        scenery: Surroundings: `outdoor`, `room` or `corridor`.
        texture: Visual texture of ground and walls: `rich`, `plain` or bare `white`.
        light: Brightness of sun and sky; 1 is daylight.
        bystanders: Number of people who walk about, 0-4.
        things: Objects on the way, beside it or at its end.
    """

    segments: tuple[Segment, ...]
    width_m: float = 2.4
    scenery: str = "outdoor"
    texture: str = "rich"
    light: float = 1.0
    bystanders: int = 0
    things: tuple[Thing, ...] = ()


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

    kind: str = "ahead"
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    sway_yaw_rad: float = 0.0
    sway_pitch_rad: float = 0.0
    sway_hz: float = 0.5


@dataclass(frozen=True, kw_only=True)
class Gait:
    """How the person walks.

    Attributes:
        pattern: `walk`; `wander`, a stroll of changing speed with pauses; or `jog`, the fastest walk (no flight).
        speed_mps: Preferred speed on level ground, 0.05-2.1.
        step_sd: Step-to-step variability of length and time, as a fraction (SD).
        stand_s: Standing time at the start and at the end.
        stairs: `step_over_step`, or `step_by_step` with both feet on every tread.
        leading_foot: Foot that goes first on stairs that are walked step by step, `l` or `r`.
        asymmetry: Limp, -0.4-0.4: steps of the left leg are longer in space and time by this fraction, and those of the
            right leg shorter; the stance of the left leg is shorter as a result (Balasubramanian et al. 2007).
        shuffle: From 0, feet that are lifted, to 1, feet that slide flat along the ground in short steps.
        gaze: Where the walker looks.
    """

    pattern: str = "walk"
    speed_mps: float = 1.2
    step_sd: float = 0.015
    stand_s: float = 2.0
    stairs: str = "step_over_step"
    leading_foot: str = "r"
    asymmetry: float = 0.0
    shuffle: float = 0.0
    gaze: Gaze = field(default_factory=Gaze)

    @classmethod
    def of_pattern(cls, pattern: str = "walk", **rest: Any) -> Gait:
        """Gait with the speed and variability of its pattern, except for the values in `rest`."""
        return cls(pattern=pattern, **(PATTERNS[pattern] | rest))


# Zhao et al. 2023 give the speeds of their three patterns together: 0.78 +- 0.27 m/s, 0.05 to 2.12 m/s.
PATTERNS: dict[str, dict[str, float]] = {
    "wander": {"speed_mps": 0.6, "step_sd": 0.04},
    "walk": {},
    "jog": {"speed_mps": 1.8, "step_sd": 0.02},
}


@dataclass(frozen=True, kw_only=True)
class Push:
    """An external push on the pelvis.

    Attributes:
        at_s: Start time.
        duration_s: Duration.
        forward_n, left_n: Force along and across the way, N; negative backward and to the right.
    """

    at_s: float
    duration_s: float = 0.1
    forward_n: float = 0.0
    left_n: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Misstep:
    """A foot that lands beside its planned foothold.

    Attributes:
        at_s: The first foot to land after this instant.
        forward_m, left_m: Offset from the foothold, along and across the way.
    """

    at_s: float
    forward_m: float = 0.0
    left_m: float = 0.0


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

    assist: bool = False
    mass_error: float = 0.0
    torque_noise: float = 0.0
    floor_offset_m: float = 0.0
    friction: float = 0.9
    pushes: tuple[Push, ...] = ()
    missteps: tuple[Misstep, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """Complete definition of a walk; together with a seed it determines every byte of the recording.

    Attributes:
        exo: The exoskeleton; None for a person without it, and then without its sensors.
        sensors: Groups of sensors that are on: foot_imu, foot_camera, sonar, insole, ahrs, encoder, interaction,
            actuator, head_imu, head_camera; and exo_imu, off by default: the AHRSs' inertial sensors.
        fittings: Groups whose part, rate or clock differs from the standard.
        rig_mount: `head` or `chest`: where the RGB-D camera sits.
        ideal: Noise-free sensors on rigid shoes.
        shock: Whether the shoes' uppers vibrate at heel strike and rock in stance; never with ideal sensors.
        dynamics: Parameters of `physics: dynamic`; None for its defaults.
        faults: Faults between sensors and recorder, and faults of the sensor mounts.
    """

    name: str
    route: Route
    person: Person = field(default_factory=Person)
    exo: Exo | None = field(default_factory=Exo)
    gait: Gait = field(default_factory=Gait)
    physics: str = "kinematic"
    sensors: tuple[str, ...] = (
        "foot_imu",
        "foot_camera",
        "sonar",
        "insole",
        "ahrs",
        "encoder",
        "interaction",
        "actuator",
        "head_imu",
        "head_camera",
    )
    fittings: Mapping[str, SensorConfig] = field(default_factory=dict)
    rig_mount: str = "head"
    ideal: bool = False
    shock: bool = True
    dynamics: Dynamics | None = None
    faults: tuple[Fault, ...] = ()
