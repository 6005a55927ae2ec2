"""Small tables as common apps and loggers write them, all of the same walk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stridetwin.streams.formats.imu_columns import parse_mapping
from stridetwin.streams.formats.imu_text import TableRequest
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2 as G

N, RATE_HZ = 120, 100.0
T = np.arange(N) / RATE_HZ
DEG = np.pi / 180
RNG = np.random.default_rng(7)
FORCE = RNG.normal((0.3, -0.4, 9.7), 0.05, (N, 3))
GYRO = RNG.normal(0, 0.8, (N, 3))
FORCE_R, GYRO_R = FORCE[::-1] + 0.01, -GYRO


def table(path: Path, header: str, *columns: np.ndarray, separator: str = ",") -> Path:
    rows = [separator.join(repr(float(v)) for v in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([*header.splitlines(), *rows]) + "\n", encoding="utf-8")
    return path


def ngimu(folder: Path) -> Path:
    names = [f"Gyroscope {a} (deg/s)" for a in "XYZ"] + [f"Accelerometer {a} (g)" for a in "XYZ"]
    header = ",".join(["Time (s)", *names, *(f"Magnetometer {a} (uT)" for a in "XYZ"), "Barometer (hPa)"])
    return table(folder / "sensors.csv", header, T, GYRO / DEG, FORCE / G, 30 * GYRO, 1000 + T)


def x_imu(folder: Path) -> Path:
    names = [f"Gyroscope {a} (deg/s)" for a in "XYZ"] + [f"Accelerometer {a} (g)" for a in "XYZ"]
    header = ",".join(["Packet number", *names, *(f"Magnetometer {a} (G)" for a in "XYZ")])
    return table(folder / "walk_CalInertialAndMag.csv", header, 3 * np.arange(N), GYRO / DEG, FORCE / G, GYRO)


def xsens(folder: Path, time: str = "SampleTimeFine") -> Path:
    names = [f"{s}_{a}" for s in ("Acc", "Gyr", "Mag") for a in "XYZ"]
    comments = "// Start Time: Unknown\n// Update Rate: 100.0Hz\n// Filter Profile: human (46.1)\n// Firmware: 4.6.0\n"
    if time == "SampleTimeFine":  # without a rate, its clock of 10 kHz counts, here across its end
        comments, count = "// Start Time: Unknown\n", (2**32 - 3000 + 100 * np.arange(N)) % 2**32
    else:
        count = (65500 + np.arange(N)) % 65536
    header = comments + "\t".join([time, *names])
    return table(folder / "MT_012-000_00B4.txt", header, count, FORCE, GYRO, GYRO, separator="\t")


def metamotion(folder: Path) -> Path:
    start = "epoc (ms),timestamp (-0700),elapsed (s)"
    for name, unit, values in (("Accelerometer", "g", FORCE / G), ("Gyroscope", "deg/s", GYRO / DEG)):
        header = ",".join([start, *(f"{a}-axis ({unit})" for a in "xyz")])
        rows = [f"{1576e9 + 1000 * t:.0f},2019-12-10T09:46:40.000,{t!r}," for t in T.tolist()]
        cells = [",".join(map(repr, row)) for row in values.tolist()]
        file = folder / f"Walk_MetaWear_2019-12-10T09.46.40_E1F2_{name}_100.000Hz_1.4.4.csv"
        file.write_text("\n".join([header, *map(str.__add__, rows, cells)]) + "\n")
    return folder


def movesense(folder: Path) -> Path:
    return table(folder / "imu.csv", "timestamp,x,y,z,gx,gy,gz", 1000 * T, FORCE, GYRO / DEG)


def movesense_two(folder: Path) -> Path:
    table(folder / "20201_acc_stream.csv", "timestamp,x,y,z", 1000 * T, FORCE)
    table(folder / "20201_gyro_stream.csv", "timestamp,x,y,z", 1000 * T, GYRO / DEG)
    return folder


def phyphox(folder: Path) -> Path:
    accel = '"Time (s)";"Acceleration x (m/s^2)";"Acceleration y (m/s^2)";"Acceleration z (m/s^2)";"Absolute (m/s^2)"'
    path = table(folder / "Accelerometer.csv", accel, T, FORCE, FORCE[:, 0], separator=";")
    path.write_text(path.read_text().replace(".", ","))  # as exported in German
    gyro = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"'
    table(folder / "Gyroscope.csv", gyro, T, GYRO)
    return folder


def sensor_logger(folder: Path, total: bool = True, sign: float = 1.0) -> Path:
    header, stamps = "time,seconds_elapsed,z,y,x", 1.7e18 + 1e9 * T
    gravity = np.array([0.2, -0.3, 9.6])
    table(folder / "Accelerometer.csv", header, stamps, T, sign * (FORCE - gravity)[:, ::-1])
    table(folder / "Gravity.csv", header, stamps, T, sign * np.tile(gravity, (N, 1))[:, ::-1])
    if total:
        table(folder / "TotalAcceleration.csv", header, stamps, T, sign * FORCE[:, ::-1])
    table(folder / "AccelerometerUncalibrated.csv", header, stamps, T, FORCE[:, ::-1] / G)
    table(folder / "Gyroscope.csv", header, stamps, T, GYRO[:, ::-1])
    table(folder / "Magnetometer.csv", header, stamps, T, 30 * GYRO)
    platform = "ios" if sign < 0 else "android"
    (folder / "Metadata.csv").write_text(f"version,platform,standardisation\n3,{platform},false\n")
    return folder


def gaitmap(folder: Path) -> Path:
    names = [f"{s}_{a}" for s in ("acc", "gyr") for a in "xyz"]
    header = "\n".join([",".join(["", *["left_sensor"] * 6, *["right_sensor"] * 6]), ",".join(["", *names, *names])])
    return table(folder / "both_feet.csv", header, T, FORCE, GYRO / DEG, FORCE_R, GYRO_R / DEG)


def opensense(folder: Path) -> Path:
    for name, left, right in (("linear_accelerations", FORCE, FORCE_R), ("angular_velocity", GYRO, GYRO_R)):
        rows = ["DataRate=100.0", "DataType=Vec3", "version=3", "OpenSimVersion=4.4", "endheader"]
        rows.append("time\tcalcn_l_imu\tcalcn_r_imu")
        for t, a, b in zip(T.tolist(), left.tolist(), right.tolist()):
            rows.append("\t".join([repr(t), ",".join(map(repr, a)), ",".join(map(repr, b))]))
        (folder / f"walk_{name}.sto").write_text("\n".join(rows) + "\n")
    return folder


def other(folder: Path) -> Path:
    return table(folder / "logger.csv", "clock,accX,accY,accZ,p,q,r", 1000 * T, 1000 * FORCE / G, GYRO / DEG)


ONE: dict[str, tuple[Callable[[Path], Path], TableRequest]] = {
    "NGIMU": (ngimu, TableRequest()),
    "x-IMU": (x_imu, TableRequest(rate_hz=RATE_HZ)),
    "Xsens, ticks": (xsens, TableRequest()),
    "Xsens, packets": (lambda folder: xsens(folder, "PacketCounter"), TableRequest()),
    "MetaMotion": (metamotion, TableRequest()),
    "Movesense": (movesense, TableRequest()),
    "Movesense, two files": (movesense_two, TableRequest()),
    "phyphox": (phyphox, TableRequest()),
    "Sensor Logger": (sensor_logger, TableRequest()),
    "Sensor Logger, gravity": (lambda folder: sensor_logger(folder, total=False), TableRequest()),
    "Sensor Logger, iPhone": (lambda folder: sensor_logger(folder, sign=-1.0), TableRequest()),
    "another": (
        other,
        TableRequest(
            columns=parse_mapping("t=clock[ms],ax=accX[mg],ay=accY[mg],az=accZ[mg],gx=p[deg/s],gy=q[dps],gz=r[°/s]")
        ),
    ),
}
"""One sensor each: how it is written, and what its header leaves open."""
