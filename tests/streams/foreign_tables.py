"""Small tables in forms that other programs write: preambles, units, encodings, decimal marks, counters, long form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from logger_files import DEG, FORCE, GYRO, G, N, T

NAMES = "t,ax,ay,az,gx,gy,gz"
MAPPING = "t=1[s],ax=2[m/s^2],ay=3[m/s^2],az=4[m/s^2],gx=5[rad/s],gy=6[rad/s],gz=7[rad/s]"


def rows(*columns: np.ndarray, separator: str = ",", decimal: str = ".") -> list[str]:
    """A line per row of columns (N,) or (N, K) of numbers; integers keep all digits."""
    cells = []
    for column in columns:
        parts = column.reshape(len(column), -1).T.tolist()
        cells += [[repr(value).replace(".", decimal) for value in part] for part in parts]
    return [separator.join(row) for row in zip(*cells)]


def save(path: Path, head: str, body: list[str], encoding: str = "utf-8") -> Path:
    path.write_bytes("\n".join([*([head] if head else []), *body, ""]).encode(encoding))
    return path


BODY = rows(T, FORCE, GYRO)


def commented(folder: Path) -> Path:
    body = [*BODY[:30], "# a note of the operator", "// another one", *BODY[30:60], "% and a third", "", *BODY[60:]]
    return save(folder / "a.csv", f"# lab 3\n; sensor 4\n% 100, 200, 300\n# {NAMES}", body)


def long_preamble(folder: Path) -> Path:
    properties = "\n".join(f"Property {k},value {k}" for k in range(3000))
    return save(folder / "a.csv", f"My Logger 2.0, walk of today\n{properties}\n\n{NAMES}", BODY)


def units_below(folder: Path) -> Path:
    names = "Timestamp,Acc X,Acc Y,Acc Z,Gyro X,Gyro Y,Gyro Z,Temperature"
    units = "ms,g,g,g,deg/s,deg/s,deg/s,°C"
    return save(folder / "a.csv", f"{names}\n{units}", rows(1e3 * T, FORCE / G, GYRO / DEG, 20 + T))


def units_below_in_brackets(folder: Path) -> Path:
    names = "time;accel_x;accel_y;accel_z;gyro_x;gyro_y;gyro_z"
    units = "[us];[m/s^2];[m/s^2];[m/s^2];[dps];[dps];[dps]"
    return save(folder / "a.csv", f"{names}\n{units}", rows(1e6 * T, FORCE, GYRO / DEG, separator=";", decimal=","))


def blue_trident(folder: Path) -> Path:
    names = "time_s,ax_m/s/s,ay_m/s/s,az_m/s/s,gx_deg/s,gy_deg/s,gz_deg/s,mx_Ut,my_Ut,mz_Ut"
    return save(folder / "TS-00556_lowg.csv", names, rows(T, FORCE, GYRO / DEG, GYRO))


def shimmer(folder: Path) -> Path:
    signals = ["Timestamp_Unix_CAL", *(f"Accel_LN_{a}_CAL" for a in "XYZ"), *(f"Accel_WR_{a}_CAL" for a in "XYZ")]
    signals += [f"Gyro_{a}_CAL" for a in "XYZ"]
    names = "\t".join(f"Shimmer_B5C8_{s}" for s in signals) + "\t"
    units = "\t".join(["ms", *["m/(s^2)"] * 6, *["deg/s"] * 3]) + "\t"
    body = [row + "\t" for row in rows(1.6e12 + 1e3 * T, FORCE, FORCE + 0.3, GYRO / DEG, separator="\t")]
    return save(folder / "a.csv", f'"sep=\t"\n{names}\n{units}', body)


def xsens_dot(folder: Path, preamble: bool = True) -> Path:
    head = "sep=,\nDeviceTag:,left\nFirmwareVersion:,2.0.0\nAppVersion:,2021.0\nOutputRate:,100Hz\n\n"
    names = ",".join(["PacketCounter", "SampleTimeFine", *(f"Acc_{a}" for a in "XYZ"), *(f"Gyr_{a}" for a in "XYZ")])
    ticks = (2**32 - 500_000 + np.rint(1e6 * T).astype(np.int64)) % 2**32
    head = head + names if preamble else names
    return save(folder / "a.csv", head, rows(np.arange(N), ticks, FORCE, GYRO / DEG))


def physics_toolbox(folder: Path) -> Path:
    names = "time,gFx,gFy,gFz,ax,ay,az,wx,wy,wz"
    return save(folder / "a.csv", names, rows(T, FORCE / G, FORCE - 9.8, GYRO))


def picoquake(folder: Path) -> Path:
    head = "# PLab PicoQuake Data\n# Num. samples: 120, Duration: 1.2 s\n# Config: data_rate = 100.0 Hz, filter = 42 Hz"
    body = rows(1 + np.arange(N), FORCE / G, GYRO / DEG)
    return save(folder / "a.csv", f"{head}\ncount,a_x,a_y,a_z,g_x,g_y,g_z", body)


def realsense(folder: Path) -> Path:
    lines = ["Configuration:", "Stream Type,Stream Name,Format,FPS,Width,Height", "Depth 0,Depth,Z16,30,640,480"]
    stamps = "Stream Type,Index,F#,HW Timestamp (ms),Host Timestamp(ms)"
    lines += ["", stamps, *(f"\nDepth,0,{k},{1e6 + 10 * k:.3f},{10 * k + 3:.3f}" for k in range(N))]
    for name, values in (("Gyro", GYRO), ("Accel", FORCE)):
        lines += ["", "", f"{stamps},3DOF_x,3DOF_y,3DOF_z"]
        lines += [
            f"\n{name},0,{k},{1e6 + 10 * k:.3f},{10 * k + 3:.3f},{x!r},{y!r},{z!r}"
            for k, (x, y, z) in enumerate(values.tolist())
        ]
    return save(folder / "frames_data.csv", "\n".join(lines), [])


def android(folder: Path, names: tuple[str, str] = ("TYPE_ACCELEROMETER", "TYPE_GYROSCOPE")) -> Path:
    body = []
    for k, (f, w) in enumerate(zip(FORCE.tolist(), GYRO.tolist())):
        stamp = 84_000_000_000_000 + 10_000_000 * k
        body += [f"{stamp},{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(names, (f, w))]
    return save(folder / "log.csv", "timestamp,sensor_type,values[0],values[1],values[2]", body)


def one_value_per_row(folder: Path) -> Path:
    body = []
    for k, values in enumerate(np.hstack([FORCE / G, GYRO / DEG]).tolist()):
        names = [f"{q}_{a}" for q in ("acc", "gyr") for a in "xyz"]
        body += [f"{10 * k};{n};{v!r};{u}" for n, v, u in zip(names, values, ["g"] * 3 + ["deg/s"] * 3)]
    return save(folder / "log.csv", "time [ms];signal;value;unit", body)


def euroc_table(folder: Path) -> Path:
    names = ["#timestamp [ns]", *(f"w_RS_S_{a} [rad s^-1]" for a in "xyz"), *(f"a_RS_S_{a} [m s^-2]" for a in "xyz")]
    stamps = 1_403_636_579_758_555_392 + 10_000_000 * np.arange(N)
    return save(folder / "data.csv", ",".join(names), rows(stamps, GYRO, FORCE))


def rostopic(folder: Path) -> Path:
    names = ["%time", "field.header.seq", "field.header.stamp", "field.orientation.x"]
    names += [f"field.{q}.{a}" for q in ("angular_velocity", "linear_acceleration") for a in "xyz"]
    stamps = 1_600_000_000_000_000_000 + 10_000_000 * np.arange(N)
    return save(folder / "imu.csv", ",".join(names), rows(stamps, np.arange(N), stamps, T, GYRO, FORCE))


def spaces(folder: Path) -> Path:
    return save(folder / "a.txt", "#  t    ax ay az   gx gy gz", rows(T, FORCE, GYRO, separator="   "))


def clock_times(folder: Path) -> Path:
    stamps = [
        f"2024-01-31 23:59:59.{10 * k:03d}" if k < 100 else f"2024-02-01 00:00:00.{10 * (k - 100):03d}"
        for k in range(N)
    ]
    body = [f"{stamp},{row}" for stamp, row in zip(stamps, rows(FORCE, GYRO / DEG))]
    return save(folder / "a.csv", "datetime,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyro_x_dps,gyro_y_dps,gyro_z_dps", body)


def quoted_commas(folder: Path) -> Path:
    body = [
        ",".join(f'"{cell}"' for cell in row.split(";")) for row in rows(T, FORCE, GYRO, separator=";", decimal=",")
    ]
    return save(folder / "a.csv", NAMES, body)


def merged_streams(folder: Path) -> Path:
    body = []
    for force, rate in zip(rows(T, FORCE), rows(T, GYRO)):
        stamp, cells = rate.split(",", 1)
        body += [f"{force},,,", f"{stamp},,,,{cells}"]
    return save(folder / "a.csv", NAMES, body)


def encoded(encoding: str, mark: bytes = b"") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        names = "t,accel_x,accel_y,accel_z,gyro_x (°/s),gyro_y (°/s),gyro_z (°/s)"
        path = save(folder / "a.csv", names, rows(T, FORCE, GYRO / DEG), encoding)
        path.write_bytes(mark + path.read_bytes())
        return path

    return write


def separated(separator: str, decimal: str = ".") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        body = rows(T, FORCE, GYRO, separator=separator, decimal=decimal)
        return save(folder / "a.csv", NAMES.replace(",", separator), body)

    return write


FOREIGN: dict[str, Callable[[Path], Path]] = {
    "comments": commented,
    "long preamble": long_preamble,
    "units below": units_below,
    "units below in brackets": units_below_in_brackets,
    "Blue Trident": blue_trident,
    "Shimmer": shimmer,
    "Xsens DOT": xsens_dot,
    "Xsens DOT without preamble": lambda folder: xsens_dot(folder, preamble=False),
    "Physics Toolbox": physics_toolbox,
    "PicoQuake": picoquake,
    "rs-data-collect": realsense,
    "Android": android,
    "Android, numbers of types": lambda folder: android(folder, ("1", "4")),
    "one value per row": one_value_per_row,
    "EuRoC": euroc_table,
    "rostopic": rostopic,
    "blanks": spaces,
    "times of day": clock_times,
    "quoted decimal commas": quoted_commas,
    "rows of one quantity": merged_streams,
    "UTF-8 with a mark": encoded("utf-8", b"\xef\xbb\xbf"),
    "UTF-16": encoded("utf-16"),
    "UTF-16, little end first": encoded("utf-16-le"),
    "UTF-16, big end first": encoded("utf-16-be"),
    "cp1252": encoded("cp1252"),
    "tabs": separated("\t"),
    "tabs and commas": separated("\t", ","),
    "semicolons and commas": separated(";", ","),
    "bars": separated("|"),
}
"""Each writes a table of one sensor that needs no options."""
