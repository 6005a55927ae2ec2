"""What a twin is made of: person, exoskeleton, terrain, gait and rig, as frozen dataclasses in SI and radians."""

from __future__ import annotations

from dataclasses import dataclass, field

SIDES = ("l", "r")


@dataclass(frozen=True, kw_only=True)
class Person:
    """Who walks.

    Attributes:
        height_m: Standing height without shoes, 1.50-1.95.
        mass_kg: Body mass, 45-110.
        sex: `male` or `female` (de Leva's tables).
        shoe_m: Shoe size as the length of the foot that it fits (260 mm and the like), 0.20-0.32; None takes the
            stature's.
    """

    height_m: float = 1.75
    mass_kg: float = 75.0
    sex: str = "male"
    shoe_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class Exo:
    """The exoskeleton of Shim et al. 2019 and its actuation modules.

    Attributes:
        mode: 0 no modules (measurement only), 1 both hips and knees, 2 both hips or both knees, 3 hip and knee of one
            leg, 4 one joint.
        joints: Which joints have a module (hip_l, hip_r, knee_l, knee_r), where the mode leaves a choice.
    """

    mode: int = 0
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Level:
    """Level ground, `length_m` along the route; `cross_slope_rad` tilts it sideways, the left side up positive."""

    length_m: float
    cross_slope_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Stairs:
    """Straight stair; `down` from the walker's view.

    The first riser stands where the segment begins; `risers` risers with `risers - 1` treads between them, so that
    the next segment is the landing. `riser_m` is the height of every riser, or of each in the order of the walk.
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

    The way leads over one of them. Where the next `Lanes` leads over another one, the level between the two is a
    landing as wide as all lanes, which the walker crosses aslant. Shorter lanes are lengthened by level ground.

    Attributes:
        lanes: From left to right, each a chain of `Level`, `Stairs` and `Ramp`.
        walk: Number of the lane that is walked, 0 is the leftmost.
    """

    lanes: tuple[tuple[Level | Stairs | Ramp, ...], ...]
    walk: int


Segment = Level | Stairs | Ramp | Turn | Lanes


@dataclass(frozen=True, kw_only=True)
class Route:
    """Terrain along the walk, piece by piece from the world's origin along its x axis.

    Attributes:
        segments: Each begins where the one before ends, in its direction and at its height.
        width_m: Of the way, or of each lane.
        scenery: What stands around: `outdoor` or `room`.
    """

    segments: tuple[Segment, ...]
    width_m: float = 2.4
    scenery: str = "outdoor"


@dataclass(frozen=True, kw_only=True)
class Gait:
    """How the person walks.

    Attributes:
        speed_mps: Preferred speed on level ground.
        step_sd: Step-to-step variability of length and time, as a fraction (SD).
        stand_s: Standing at the start and at the end.
    """

    speed_mps: float = 1.2
    step_sd: float = 0.015
    stand_s: float = 2.0


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """Everything that a walk is made of; with a seed it fixes every byte of the recording.

    Attributes:
        exo: The exoskeleton; None for a person without it, and then without its sensors.
        sensors: Groups of sensors that are on: foot_imu, foot_camera, sonar, insole, ahrs, encoder, interaction,
            actuator, head_imu, head_camera.
        rig_mount: `head` or `chest`: where the RGB-D camera sits.
        ideal: Noise-free sensors.
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
    rig_mount: str = "head"
    ideal: bool = False
