"""The IMU of a table: read from its samples, a part of the library, or unknown."""

from __future__ import annotations

import math

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.measured_calibration import measured_imu
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Imu

AUTO, UNKNOWN = "auto", "none"


def rig_of_table(choice: str, block: Block[Imu], foot: str) -> Rig | None:
    """A rig with the IMU of a table on a foot; None if it is unknown.

    Args:
        choice: `AUTO`, `UNKNOWN` or the name of a part.
        block: All samples.
        foot: `l` or `r`.

    Raises:
        StrideTwinError: No IMU of that name.
    """
    if choice == UNKNOWN:
        return None
    topic, body = f"/foot_{foot}/imu", f"foot_{foot}"
    imu = measured_imu(block, topic, body) if choice == AUTO else _nominal(choice, topic, body)
    return Rig(imus={topic: imu})


def described(imu: ImuCalibration) -> str:
    """One line on what is known of an IMU."""
    known = [
        f"{imu.rate_hz:.0f} Hz",
        f"noise {math.degrees(imu.gyroscope_noise_density):.2g} °/s/√Hz and "
        f"{imu.accelerometer_noise_density:.2g} m/s²/√Hz",
    ]
    if imu.gyroscope_bias_sd:
        known.append(f"gyro bias {math.degrees(imu.gyroscope_bias_sd):.2g} °/s")
    if imu.gyroscope_range:
        known.append(f"gyro limit {math.degrees(imu.gyroscope_range):.0f} °/s")
    if imu.accelerometer_range:
        known.append(f"accelerometer limit {imu.accelerometer_range:.0f} m/s²")
    return f"IMU {imu.part or 'as measured'}: {', '.join(known)}"


def _nominal(name: str, topic: str, body: str) -> ImuCalibration:
    from stridetwin.sim.parts.kinds import ImuPart
    from stridetwin.sim.parts.library import library, part
    from stridetwin.sim.sensors.standard_rig import nominal_imu

    imus = [n for n in library() if isinstance(part(n), ImuPart)]
    if name not in imus:
        raise StrideTwinError(f"invalid --imu {name}: expected {AUTO}, {UNKNOWN}, {', '.join(imus)}")
    found = part(name)
    assert isinstance(found, ImuPart)
    return nominal_imu(topic, found, Mount(body=body))
