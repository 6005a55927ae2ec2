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
    """Level ground, `length_m` along the route."""

    length_m: float


@dataclass(frozen=True, kw_only=True)
class Stairs:
    """Straight stair of equal risers; `down` from the walker's view.

    The first riser stands where the segment begins; `risers` risers with `risers - 1` treads between them, so that
    the next segment is the landing.
    """

    risers: int
    riser_m: float = 0.165
    tread_m: float = 0.29
    down: bool = False


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """Straight ramp; positive angle goes up."""

    angle_rad: float
    rise_m: float
    down: bool = False


Segment = Level | Stairs | Ramp


@dataclass(frozen=True, kw_only=True)
class Route:
    """Terrain along the walk, from x = 0 onwards along world x."""

    segments: tuple[Segment, ...]
    width_m: float = 2.4


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
