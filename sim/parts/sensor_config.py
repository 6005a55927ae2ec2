"""Configuration of each sensor group: its part, mount and clock.

A field with an alias has the alias's unit in scenario files, such as `position_mm` for `position_m`, and so have its
limits; its value here is in SI units or radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from pydantic import Field, StrictBool

from stridetwin.sim.choices import KIND as KIND
from stridetwin.sim.choices import STANDARD as STANDARD
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.kinds import Part
from stridetwin.sim.parts.library import load_part, make_ideal
from stridetwin.sim.parts.nominal import CalibrationSd
from stridetwin.sim.parts.population import POPULATIONS
from stridetwin.streams.fields import DEGREES, MILLIMETRES, MILLISECONDS, Number, OneOf, Unit

_Length = Annotated[Number, Field(ge=-300, le=300), MILLIMETRES]
_Angle = Annotated[Number, Field(ge=-180, le=180), DEGREES]
STANDARD_BACK_AHRS, STANDARD_BACK_IMU = "3DM-GX4-25", "3DM-GX4-25-imu"  # default parts on the back panel


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Errors of a sensor's stamps relative to the true time of its samples.

    Attributes:
        offset_s: Constant offset; for a camera, of its trigger.
        drift_ppm: Growth of the offset, µs per second.
        jitter_s: Standard deviation from sample to sample.
        latency_s: Time from the sample to the stamp.
        calibrated: Whether the rig's calibration contains the constant part (offset and latency).
    """

    offset_s: Annotated[Number, Field(ge=-1, le=1)] = 0.0
    drift_ppm: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    jitter_s: Annotated[Number, Field(ge=0, le=0.1)] = 0.0
    latency_s: Annotated[Number, Field(ge=0, le=1)] = 0.0
    calibrated: StrictBool = False

    @property
    def shift_s(self) -> float:
        """The constant part: delay of the stamps relative to true time at the start."""
        return self.offset_s + self.latency_s


@dataclass(frozen=True, kw_only=True)
class Facing:
    """Pose of a sensor or board on the body that carries it; both shoes use the same numbers, mirrored.

    Attributes:
        position_m: In the body's frame: forward, aside, up. Aside is towards the other foot on shoes, and left on head
            and chest.
        faces_rad: From forward aside, and up: viewing direction of a camera or sonar, or normal of a board.
    """

    position_m: Annotated[tuple[_Length, _Length, _Length], Field(alias="position_mm")]
    faces_rad: Annotated[tuple[_Angle, _Angle], Field(alias="faces_deg")]


@dataclass(frozen=True, kw_only=True)
class Seat(Facing):
    """Pose with a roll about the viewing direction.

    Attributes:
        roll_rad: Rotation of a camera about its viewing direction, positive when the top of the image moves aside.
    """

    roll_rad: Annotated[_Angle, Field(alias="roll_deg")] = 0.0


@dataclass(frozen=True, kw_only=True)
class SensorConfig:
    """Differences of a group of sensors from the standard one.

    Attributes:
        part: Part in place of the standard one.
        ideal: Whether to use the noise-free version of the part.
        rate_hz: Rate in place of the part's.
        population: Class of IMUs from which the errors of the part are drawn, once per walk; estimators get the figures
            of the nominal part all the same. None keeps the part's. IMUs only.
        clock: Clock of every sensor of the group.
        strike: Acceleration of the case after heel strikes, m/s²; for the IMU beside the depth camera, and for IMUs on
            the body off the shoes.
        light: Brightness of the scene relative to the camera's setting; cameras only.
        exposure_s: Exposure time in place of the camera's.
        calibration_sd: Accuracy of the nominal calibration; for the depth camera only.
        pitch_down_rad: Downward pitch of the depth camera and of the IMU beside it.
        frames: `board`: the shoe cameras render the other shoe's board and its surroundings only; `full`: everything.
        shadows: Whether the sun casts shadows in the images, which doubles the time to render them; cameras only.
        position_m: Position of an IMU in the frame of the shoe or segment that carries it: forward, outward, up; left
            in place of outward on pelvis, chest and head.
        rotation_rad: Rotation of such an IMU: roll, pitch, yaw of the left one; the right one is its mirror image.
        mount: Pose of a shoe's camera or sonar, or of the depth camera (and the IMU beside it).
        board: Pose of a shoe's board; with the cameras.
        places: For the IMUs on the body alone: the worn ones by place, each with its own configuration; None for one
            IMU at every place.
    """

    part: Part | None = None
    ideal: StrictBool = False
    rate_hz: Annotated[Number | None, Field(ge=1, le=2000)] = None
    population: Annotated[str, OneOf(tuple(POPULATIONS))] | None = None
    clock: Clock = field(default_factory=Clock)
    strike: Annotated[Number, Field(ge=0, le=5, alias="strike_g"), Unit(G)] = 0.0
    light: Annotated[Number, Field(ge=0.001, le=10)] = 1.0
    exposure_s: Annotated[Number | None, Field(ge=0, le=100, alias="exposure_ms"), MILLISECONDS] = None
    calibration_sd: CalibrationSd = field(default_factory=CalibrationSd)
    pitch_down_rad: Annotated[Number | None, Field(ge=-30, le=75, alias="pitch_down_deg"), DEGREES] = None
    frames: Annotated[str, OneOf(("board", "full"))] = "board"
    shadows: StrictBool = False
    position_m: Annotated[tuple[_Length, _Length, _Length] | None, Field(alias="position_mm")] = None
    rotation_rad: Annotated[tuple[_Angle, _Angle, _Angle] | None, Field(alias="rotation_deg")] = None
    mount: Seat | None = None
    board: Seat | None = None
    places: Mapping[str, SensorConfig] | None = None


def part_of(
    fittings: Mapping[str, SensorConfig], group: str, every_ideal: bool, standard: str | None = None
) -> tuple[Part, Part]:
    """The part of a group that is simulated, and the part whose figures estimators get.

    They differ only where the simulated one is noise-free: estimators still get the figures of the real part.

    Args:
        fittings: Differences from the standard, by group.
        group: Group of sensors.
        every_ideal: Whether all parts are noise-free.
        standard: Name of the default part; None for the group's.
    """
    sensor_config = fittings.get(group, SensorConfig())
    nominal: Any = sensor_config.part or load_part(standard or STANDARD[group])
    if sensor_config.rate_hz is not None:
        nominal = replace(nominal, rate_hz=sensor_config.rate_hz)
    if sensor_config.exposure_s is not None:
        nominal = replace(nominal, imager=replace(nominal.imager, exposure_s=sensor_config.exposure_s))
    return (make_ideal(nominal) if every_ideal or sensor_config.ideal else nominal), nominal
