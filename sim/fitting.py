"""Which part each group of sensors is made of, and how its clock runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from pydantic import Field

from stridetwin.sim.calibration import CalibrationSd
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.kinds import Part
from stridetwin.sim.parts.library import ideal, part
from stridetwin.streams.fields import DEG, MM, flag, number, words

KIND = {
    "foot_imu": "imu",
    "foot_camera": "camera",
    "sonar": "sonar",
    "insole": "force_cell",
    "ahrs": "ahrs",
    "exo_imu": "imu",
    "encoder": "encoder",
    "interaction": "force_cell",
    "actuator": "actuator",
    "head_imu": "imu",
    "head_camera": "rgbd",
}
"""The kind of part that each group takes."""

STANDARD = {
    "foot_imu": "ADIS16485",
    "foot_camera": "acA800-200gc",
    "sonar": "SRF08",
    "insole": "FlexiForce-A401",
    "ahrs": "MW-AHRSv1",
    "exo_imu": "MW-AHRSv1-imu",
    "encoder": "AMT203",
    "interaction": "FlexiForce-A301",
    "actuator": "actuation-module",
    "head_imu": "BMI055",
    "head_camera": "D455",
}
"""The part of each group where nothing else is asked for; the back's AHRS is `STANDARD_BACK_AHRS`."""

_Length = Annotated[float, number(-300, 300, scale=MM)]
_Angle = Annotated[float, number(-180, 180, scale=DEG)]
STANDARD_BACK_AHRS, STANDARD_BACK_IMU = "3DM-GX4-25", "3DM-GX4-25-imu"


@dataclass(frozen=True, kw_only=True)
class Clock:
    """How the stamps of a sensor differ from the true time of its samples.

    Attributes:
        offset_s: Constant; for a camera, of its trigger.
        drift_ppm: Growth of the offset, µs a second.
        jitter_s: Standard deviation from sample to sample.
        latency_s: From the sample to the stamp.
        told: Whether the rig's calibration knows the constant part (offset and latency).
    """

    offset_s: Annotated[float, number(-1, 1)] = 0.0
    drift_ppm: Annotated[float, number(-1000, 1000)] = 0.0
    jitter_s: Annotated[float, number(0, 0.1)] = 0.0
    latency_s: Annotated[float, number(0, 1)] = 0.0
    told: Annotated[bool, flag()] = False

    @property
    def shift_s(self) -> float:
        """The constant part: how much later than the truth the stamps are at the start."""
        return self.offset_s + self.latency_s


@dataclass(frozen=True, kw_only=True)
class Facing:
    """Where something sits on the body that carries it; on shoes the same numbers serve both, mirrored.

    Attributes:
        position_m: In the body's frame: forward, aside, up. Aside is towards the other foot on shoes, and left on head
            and chest.
        faces_rad: From forward aside, and up: where a camera or a sonar looks, or what a board faces.
    """

    position_m: Annotated[tuple[_Length, _Length, _Length], Field(alias="position_mm")]
    faces_rad: Annotated[tuple[_Angle, _Angle], Field(alias="faces_deg")]


@dataclass(frozen=True, kw_only=True)
class Seat(Facing):
    """Where something sits, and how it is rolled.

    Attributes:
        roll_rad: A camera's rotation about where it looks, the image's top aside positive.
    """

    roll_rad: Annotated[_Angle, Field(alias="roll_deg")] = 0.0


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """What a group of sensors has that the standard one has not.

    Attributes:
        part: Instead of the standard part.
        ideal: The part's ideal twin.
        rate_hz: Instead of the part's.
        clock: Of every sensor of the group.
        strike: What the strikes of the heels leave of themselves, m/s²; the IMU beside the camera with depth alone.
        light: Light on the scene over what the camera is set for; cameras alone.
        exposure_s: Instead of the camera's.
        calibration_sd: How far what is told of it may be off; the camera with depth alone.
        pitch_down_rad: How far the camera with depth, and the IMU beside it, look down instead.
        frames: `board`, where the shoe cameras draw nothing but the surroundings of the other shoe's board, or `full`.
        position_m: Where a shoe's IMU sits instead, in the foot's frame: forward, outward, up.
        rotation_rad: How a shoe's IMU is turned: roll, pitch, yaw of the left one; the right one is its mirror image.
        mount: Where a shoe's camera or sonar, or the camera with depth (and the IMU beside it), sits instead.
        board: Where a shoe's board sits instead; with the cameras.
    """

    part: Part | None = None
    ideal: Annotated[bool, flag()] = False
    rate_hz: Annotated[float | None, number(1, 2000)] = None
    clock: Clock = field(default_factory=Clock)
    strike: Annotated[float, number(0, 5, key="strike_g", scale=G)] = 0.0
    light: Annotated[float, number(0.001, 10)] = 1.0
    exposure_s: Annotated[float | None, number(0, 100, key="exposure_ms", scale=1e-3)] = None
    calibration_sd: CalibrationSd = field(default_factory=CalibrationSd)
    pitch_down_rad: Annotated[float | None, number(-30, 75, key="pitch_down_deg", scale=DEG)] = None
    frames: Annotated[str, words(("board", "full"))] = "board"
    position_m: Annotated[tuple[_Length, _Length, _Length] | None, Field(alias="position_mm")] = None
    rotation_rad: Annotated[tuple[_Angle, _Angle, _Angle] | None, Field(alias="rotation_deg")] = None
    mount: Seat | None = None
    board: Seat | None = None


def part_of(
    fittings: Mapping[str, Fitting], group: str, every_ideal: bool, standard: str | None = None
) -> tuple[Any, Any]:
    """The part of a group as it is, and as its data sheet tells it: an ideal twin is told like the part itself.

    Args:
        fittings: What differs from the standard, by group.
        group: Of sensors.
        every_ideal: Ideal twins throughout.
        standard: Name of the part where none is asked for; None takes the group's.
    """
    fitting = fittings.get(group, Fitting())
    told: Any = fitting.part or part(standard or STANDARD[group])
    if fitting.rate_hz is not None:
        told = replace(told, rate_hz=fitting.rate_hz)
    if fitting.exposure_s is not None:
        told = replace(told, imager=replace(told.imager, exposure_s=fitting.exposure_s))
    return (ideal(told) if every_ideal or fitting.ideal else told), told
