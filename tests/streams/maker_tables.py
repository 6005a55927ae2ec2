"""Small tables as loggers, apps and spreadsheets write them: clocks, counters, languages, lines that are no samples."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from foreign_tables import BODY, rows, save
from logger_files import DEG, FORCE, FORCE_R, GYRO, GYRO_R, G, N, T

UNITS_SI = "Time (s),Acc X (m/s^2),Acc Y (m/s^2),Acc Z (m/s^2),Gyr X (rad/s),Gyr Y (rad/s),Gyr Z (rad/s)"
QUANTITIES = UNITS_SI.split(",", 1)[1]
Writer = Callable[[Path], Path]


def text_rows(stamps: list[str], body: list[str], separator: str = ",") -> list[str]:
    return [f"{stamp}{separator}{row}" for stamp, row in zip(stamps, body, strict=True)]


def clock(form: str, start_s: float = 40_000.0) -> list[str]:
    """A stamp per row by a form of `d`, `h`, `m` and `s`, as `{h:02d}:{m:02d}:{s:06.3f}`."""
    stamps = []
    for t in np.round(start_s + T, 3).tolist():
        s = t % 86_400
        stamps.append(form.format(d=1 + int(t // 86_400), h=int(s // 3600), m=int(s % 3600 // 60), s=round(s % 60, 3)))
    return stamps


def xsens_without_ticks(folder: Path) -> Path:
    head = ["// Start Time: Unknown", "// Sample rate: 100.0Hz", "// Firmware Version: 4.0.2"]
    names = [
        "PacketCounter",
        "SampleTimeFine",
        "UTC_Nano",
        *(f"Acc_{a}" for a in "XYZ"),
        *(f"FreeAcc_{a}" for a in "ENU"),
    ]
    names += [f"Gyr_{a}" for a in "XYZ"] + ["Quat_q0", "Roll", ""]
    body = rows((65_500 + np.arange(N)) % 65_536, FORCE, FORCE - 9.8, GYRO, T, T, separator="\t")
    body = ["\t".join([cells[0], "", "", *cells[1:], ""]) for cells in (row.split("\t") for row in body)]
    return save(folder / "MT_01-000.txt", "\n".join([*head, "\t".join(names)]), body)


def shimmer_connect(folder: Path) -> Path:
    names = ["Timestamp", *(f"Accelerometer {a}" for a in "XYZ"), *(f"Gyroscope {a}" for a in "XYZ")]
    head = ["\t".join(["Shimmer_9C2B"] * 14), "\t".join(name for name in names for _ in range(2))]
    head += ["\t".join(["RAW", "CAL"] * 7)]
    units = ["mSecs", *["m/(sec^2)"] * 3, *["deg/sec"] * 3]
    head += ["\t".join(unit for cal in units for unit in ("no units", cal))]
    columns = [1e3 * T, *FORCE.T, *(GYRO / DEG).T]
    pairs = [column for values in columns for column in (np.rint(77 * values).astype(int), values)]
    return save(folder / "a.csv", "\n".join(head), rows(*pairs, separator="\t"))


def wit_motion(folder: Path) -> Path:
    names = ["address", "Time(s)", "ChipTime", *(f"a{a}(g)" for a in "xyz"), *(f"w{a}(deg/s)" for a in "xyz")]
    names += [*(f"Angle{a}(deg)" for a in "XYZ"), "T(°)", "hx", ""]
    body = rows(FORCE / G, GYRO / DEG, GYRO, T, T, separator="\t")
    times = clock("0x50\t{h:02d}:{m:02d}:{s:06.3f}\t2015-1-1 {h}:{m}:{s:.3f}")
    head = "StartTime: 2022-10-11 17:32:29.000\n" + "\t".join(names)
    return save(folder / "a.txt", head, [f"{row}\t" for row in text_rows(times, body, "\t")])


def wit_motion_in(encoding: str) -> Writer:
    def write(folder: Path) -> Path:
        names = ["时间(s)", *(f"加速度{a}(g)" for a in "XYZ"), *(f"角速度{a}(°/s)" for a in "XYZ"), "温度(°C)"]
        body = text_rows(clock("{h:02d}:{m:02d}:{s:06.3f}"), rows(FORCE / G, GYRO / DEG, T, separator="\t"), "\t")
        return save(folder / "a.csv", "开始时间: 2022-10-11\n" + "\t".join(names), body, encoding)

    return write


def japanese(folder: Path) -> Path:
    names = ["時刻[ms]", *(f"加速度{a}[m/s^2]" for a in "XYZ"), *(f"角速度{a}[dps]" for a in "XYZ")]
    return save(folder / "a.csv", ",".join(names), rows(1e3 * T, FORCE, GYRO / DEG), "cp932")


def french(folder: Path) -> Path:
    names = [
        "Temps (s)",
        *(f"Accélération {a} (m/s²)" for a in "XYZ"),
        *(f"Vitesse angulaire {a} (°/s)" for a in "XYZ"),
    ]
    return save(
        folder / "a.csv", ";".join(names), rows(T, FORCE, GYRO / DEG, separator=";", decimal=","), encoding="cp1252"
    )


def german_phyphox(folder: Path) -> Path:
    for name, unit, values in (("Beschleunigung", "m/s^2", FORCE), ("Drehrate", "rad/s", GYRO)):
        head = ";".join(['"Zeit (s)"', *(f'"{name} {a} ({unit})"' for a in "xyz")])
        save(folder / f"{name}.csv", head, rows(T, values, separator=";", decimal=","))
    head = ";".join(['"Zeit (s)"', *(f'"Lineare Beschleunigung {a} (m/s^2)"' for a in "xyz")])
    save(folder / "Lineare Beschleunigung.csv", head, rows(T, FORCE - 9.8, separator=";", decimal=","))
    return folder


def metamotion_late(folder: Path) -> Path:
    for name, unit, values, late in (("Accelerometer", "g", FORCE / G, 0), ("Gyroscope", "deg/s", GYRO / DEG, 20)):
        head = "epoch (ms),time (-13:00),elapsed (s)," + ",".join(f"{a}-axis ({unit})" for a in "xyz")
        epoch = 1_588_000_000_000 + 10 * np.arange(N)[late:]
        body = text_rows(
            clock("2020-05-06T{h:02d}:{m:02d}:{s:06.3f}")[late:], rows((T - T[late])[late:], values[late:])
        )
        save(folder / f"MetaWear_C5CA_{name}.csv", head, text_rows([str(t) for t in epoch], body))
    return folder


def ios_sensor_log(folder: Path) -> Path:
    names = ["loggingTime(txt)", "loggingSample(N)", "accelerometerTimestamp_sinceReboot(s)"]
    names += [f"accelerometerAcceleration{a}(G)" for a in "XYZ"] + ["gyroTimestamp_sinceReboot(s)"]
    names += [f"gyroRotation{a}(rad/s)" for a in "XYZ"] + [f"motionUserAcceleration{a}(G)" for a in "XYZ"]
    body = rows(np.arange(N), 5000 + T, -FORCE / G, 5000 + T, GYRO, FORCE)
    return save(folder / "a.csv", ",".join(names), text_rows(clock("2020-11-12 {h}:{m:02d}:{s:06.3f} +0100"), body))


def matrix_variables(folder: Path) -> Path:
    return save(folder / "a.csv", "t,acc_1,acc_2,acc_3,gyr_1,gyr_2,gyr_3", BODY)


def px4(folder: Path) -> Path:
    names = ["timestamp", *(f"gyro_rad[{k}]" for k in range(3)), "accelerometer_timestamp_relative"]
    names += [f"accelerometer_m_s2[{k}]" for k in range(3)]
    stamps = 5_000_000 + 10_000 * np.arange(N)
    return save(folder / "a.csv", ",".join(names), rows(stamps, GYRO, 0 * stamps, FORCE))


def get_sensor_data(folder: Path) -> Path:
    lines = ["% ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2);Accuracy(integer)"]
    lines += ["% GYRO;AppTimestamp(s);SensorTimestamp(s);Gyr_X(rad/s);Gyr_Y(rad/s);Gyr_Z(rad/s);Accuracy(integer)"]
    for k, (t, f, w) in enumerate(zip(T.tolist(), FORCE.tolist(), GYRO.tolist(), strict=True)):
        for name, values in (("ACCE", f), ("GYRO", w), ("MAGN", w)):
            lines.append(f"{name};{t + 0.003:.3f};{8400 + t:.6f};{';'.join(map(repr, values))};3")
        lines += [f"WIFI;{t};{t};home;00:0b;5200;-77"] if k % 40 == 0 else []
    return save(folder / "log.txt", "\n".join(lines), [])


def android_with_others(folder: Path) -> Path:
    body = []
    for k, (f, w) in enumerate(zip(FORCE.tolist(), GYRO.tolist(), strict=True)):
        kinds = (("accelerometer", f), ("linear_acceleration", w), ("gyroscope_uncalibrated", f), ("gyroscope", w))
        body += [f"{10_000_000 * k},{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in kinds]
    return save(folder / "a.csv", "timestamp,sensor,x,y,z", body)


def thousands(decimal: str) -> Writer:
    def write(folder: Path) -> Path:
        def mark(values: np.ndarray, digits: int) -> list[str]:
            texts = [f"{value:,.{digits}f}" for value in values.tolist()]
            return texts if decimal == "." else [x.translate(str.maketrans(",.", ".,")) for x in texts]

        columns = [mark(1e3 * T + 900, 3), *(mark(column, 6) for column in (1e3 * FORCE / G).T)]
        columns += [mark(column, 9) for column in GYRO.T]
        names = ["Time (ms)", *(f"Acc {a} (mg)" for a in "XYZ"), *(f"Gyr {a} (rad/s)" for a in "XYZ")]
        body = [",".join(f'"{cell}"' for cell in row) for row in zip(*columns, strict=True)]
        return save(folder / "a.csv", ",".join(names), body)

    return write


def stamped(name: str, form: str, separator: str = ",", start_s: float = 86_399.5) -> Writer:
    """Stamps as text under a name, by default across midnight."""

    def write(folder: Path) -> Path:
        names = separator.join([name, *QUANTITIES.split(",")])
        body = rows(FORCE, GYRO, separator=separator)
        return save(folder / "a.csv", names, text_rows(clock(form, start_s), body, separator))

    return write


def numbered(name: str, stamps: np.ndarray) -> Writer:
    """Stamps as numbers under a name."""
    return lambda folder: save(folder / "a.csv", f"{name},{QUANTITIES}", rows(stamps, FORCE, GYRO))


def lines(*parts: str | list[str], end: str = "\n", form: str = "a.csv") -> Writer:
    """A table of given lines."""

    def write(folder: Path) -> Path:
        flat = [line for part in parts for line in ([part] if isinstance(part, str) else part)]
        path = folder / form
        path.write_bytes((end.join(flat) + end).encode())
        return path

    return write


def with_zeros_at_end(folder: Path) -> Path:
    path = save(folder / "a.csv", UNITS_SI, BODY)
    path.write_bytes(path.read_bytes() + b"\0" * 40_000)
    return path


def two_clocks(folder: Path) -> Path:
    names = (
        "acc_time (s),acc_x (m/s^2),acc_y (m/s^2),acc_z (m/s^2),gyr_time (s),gyr_x (rad/s),gyr_y (rad/s),gyr_z (rad/s)"
    )
    rates = rows(T + 0.2, GYRO)  # the rates begin 0.2 s late: the last ones have no force beside them
    body = [f"{force},{rate}" for force, rate in zip(rows(T, FORCE), [*rates[:-30], *[",,,"] * 30], strict=True)]
    return save(folder / "a.csv", names, body)


ODD: dict[str, Writer] = {
    "Xsens without ticks": xsens_without_ticks,
    "Shimmer, raw and calibrated": shimmer_connect,
    "WitMotion": wit_motion,
    "WitMotion in Chinese, GBK": wit_motion_in("gbk"),
    "WitMotion in Chinese, UTF-8": wit_motion_in("utf-8"),
    "Japanese": japanese,
    "French": french,
    "Russian": lambda folder: save(
        folder / "a.csv",
        ",".join(["Время (с)", *(f"Ускорение {a} (g)" for a in "XYZ"), *(f"Скорость {a} (°/с)" for a in "XYZ")]),
        rows(T, FORCE / G, GYRO / DEG),
        "cp1251",
    ),
    "phyphox in German": german_phyphox,
    "SensorLog of an iPhone": ios_sensor_log,
    "matrices of MATLAB": matrix_variables,
    "PX4": px4,
    "GetSensorData": get_sensor_data,
    "Android with other sensors": android_with_others,
    "marks between thousands": thousands("."),
    "marks between thousands in German": thousands(","),
    "dates with days first": stamped("Zeitstempel", "{d:02d}.03.2024 {h:02d}:{m:02d}:{s:06.3f}", ";"),
    "date and time": stamped("Date,Time", "2024-03-0{d},{h:02d}:{m:02d}:{s:06.3f}"),
    "dates without a name": stamped("", "2024-03-0{d} {h:02d}:{m:02d}:{s:09.6f}+01:00"),
    "colons before milliseconds": stamped("time", "{h:02d}:{m:02d}:{s:06.3f}", start_s=3_599.5),
    "hours, minutes and seconds": stamped("hour,minute,second", "{h},{m},{s:.3f}", start_s=3_599.5),
    "days since 1900": numbered("Time", 45_352.5 + T / 86_400),
    "days since 0": numbered("datenum", 739_312.5 + T / 86_400),
    "minutes": numbered("Time (min)", T / 60),
    "a clock of 16 bits": numbered("time (ms)", (65_000 + 10 * np.arange(N)) % 2**16),
    "a signed clock of 32 bits": numbered("t (us)", (2**31 - 400_000 + 10_000 * np.arange(N) + 2**31) % 2**32 - 2**31),
    "seconds of the day": numbered("Time (s)", np.round(86_399.5 + T, 3) % 86_400),
    "a header again": lines(UNITS_SI, BODY[:50], UNITS_SI, BODY[50:]),
    "two parts with titles": lines("part 1", UNITS_SI, BODY[:50], "", "part 2", UNITS_SI, BODY[50:]),
    "a footer": lines(UNITS_SI, BODY, "", "Recording stopped", f"Total samples: {N}"),
    "a footer of numbers": lines(UNITS_SI, BODY, "Mean,0.1,0.2,9.8,0,0,0"),
    "marks of the operator": lines(UNITS_SI, BODY[:40], "MARK,button", BODY[40:80], "*** battery low ***", BODY[80:]),
    "comments at the ends of rows": lines(
        UNITS_SI, [f"{row}  # a step" if k % 9 == 0 else row for k, row in enumerate(BODY)]
    ),
    "a quote without a partner": lines(UNITS_SI, BODY[:50], f'"{BODY[50]}', BODY[51:]),
    "a matrix above the names": lines("Calibration:", ["1,0,0,0,1,0,0"] * 3, UNITS_SI, BODY),
    "a rate above the names": lines("fs = 100 Hz", QUANTITIES, rows(FORCE, GYRO)),
    "line ends of old computers": lines(UNITS_SI, BODY, end="\r"),
    "separators behind all rows": lines(UNITS_SI, [f"{row},," for row in BODY]),
    "zeros at the end": with_zeros_at_end,
    "other minus signs": lines(UNITS_SI, [row.replace("-", "\u2212") for row in BODY]),
    "blanks that do not break": lines(UNITS_SI.replace(" ", "\u00a0"), [row.replace(",", ",\u00a0") for row in BODY]),
    "names in quotes, blanks between": lines(
        " ".join(f'"{name}"' for name in UNITS_SI.split(",")), rows(T, FORCE, GYRO, separator=" ")
    ),
    "capital letters": lines(UNITS_SI, BODY, form="LOG001.CSV"),
    "capital letters, open ending": lines(UNITS_SI, BODY, form="DATA.TXT"),
    "a log": lines(UNITS_SI, BODY, form="imu.log"),
    "degrees as d/s": lines(UNITS_SI.replace("rad/s", "d/s"), rows(T, FORCE, GYRO / DEG)),
    "axes before names": lines(
        "t (s),xAccel (g),yAccel (g),zAccel (g),xRate (rad/s),yRate (rad/s),zRate (rad/s)", rows(T, FORCE / G, GYRO)
    ),
    "names of an Arduino": lines(
        "t (s),AcX (g),AcY (g),AcZ (g),GyX (rad/s),GyY (rad/s),GyZ (rad/s)", rows(T, FORCE / G, GYRO)
    ),
    "one signal with two clocks": two_clocks,
}
"""Each writes a table of one sensor that needs no options."""


def both(form: str, sides: tuple[str, str]) -> Writer:
    """Both feet in one table: names by side `s`, quantity `q` (acc, gyr) and axis `a`."""

    def write(folder: Path) -> Path:
        names = [form.format(s=s, q=q, a=a) for s in sides for q in ("acc", "gyr") for a in "xyz"]
        return save(folder / "a.csv", ",".join(["t", *names]), rows(T, FORCE, GYRO, FORCE_R, GYRO_R))

    return write


def multi_index(folder: Path) -> Path:
    head = ["sensor," + ",".join(["left"] * 6 + ["right"] * 6), "quantity," + ",".join((["acc"] * 3 + ["gyr"] * 3) * 2)]
    head += ["axis," + ",".join("xyz" * 4), "t" + "," * 12]
    return save(folder / "a.csv", "\n".join(head), rows(T, FORCE, GYRO / DEG, FORCE_R, GYRO_R / DEG))


BOTH_FEET: dict[str, Writer] = {
    "capital letters before": both("{s}_{q}_{a}", ("L", "R")),
    "capital letters behind": both("{q}_{a}_{s}", ("L", "R")),
    "two letters": both("{s}_{q}_{a}", ("LF", "RF")),
    "words": both("{s}Foot_{q}_{a}", ("left", "right")),
    "German": both("{s}_{q}_{a}", ("links", "rechts")),
    "three rows of names": multi_index,
}
"""Each writes a table of both feet that needs no options."""
