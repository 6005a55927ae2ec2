"""Tables of inertial sensors, `.npz` and text: reads a file or a folder of them, and writes that of one IMU.

The samples of an IMU are checked to be plausible, and short gaps are bridged (`imu_bridging`).
"""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.files import atomic_file
from stridetwin.streams.formats.column_names import AXES
from stridetwin.streams.formats.derived import check_overlap, join_at_gyro_stamps
from stridetwin.streams.formats.imu_bridging import bridge_gaps
from stridetwin.streams.formats.imu_clocks import RATE
from stridetwin.streams.formats.imu_columns import EXAMPLE, OPTION, missing_axis_error
from stridetwin.streams.formats.imu_folder import read_folder_parts
from stridetwin.streams.formats.imu_text import SUFFIXES, TablePart, TableRequest, has_table_suffix, read_text_table
from stridetwin.streams.formats.imu_units import ACCEL, GYRO
from stridetwin.streams.formats.imu_unmeasured import leave_out_unmeasured
from stridetwin.streams.formats.text_rows import VALID_NUMBER
from stridetwin.streams.formats.tum import LATEST_S
from stridetwin.streams.plausible import find_implausible_values
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import LARGEST_NUMBER, Array, Block, Imu, Stamps

MIN_ROWS = 20
"""Fewest rows of a table."""
_FREE_BYTES, _BYTES_PER_BYTE = 16 << 20, 20
"""Bytes to which an array of a `.npz` may unpack: this many, and this many for each packed byte."""
_ADVICE = {
    "t": f"the unit of the stamps is given as {OPTION} t=NAME[ms]",
    ACCEL: f"units are given as {OPTION} ax=NAME[g], those of raw counts as [g/16384]",
    GYRO: f"units and axes are given as {OPTION} gx=NAME[deg/s], units of raw counts as [deg/s/131]",
}
"""What the user can give, by the field that is not plausible."""
_COLUMNS = {ACCEL: "specific_force", GYRO: "angular_rate"}
"""Field of an `Imu` by quantity."""


def read_imu_table(path: str | Path, topic: str = "/foot/imu", request: TableRequest | None = None) -> Block[Imu]:
    """Reads the IMU of a table or a folder of tables that has only one; `read_imu_tables` reads several.

    Args:
        path: `.npz` with `t` (N,), `accel` (N, 3) and `gyro` (N, 3), or a text table with a header.
        topic: Topic of the samples.
        request: Columns and rate of a table whose header leaves them open; None: by the header.

    Returns:
        One sample per row, m/s² and rad/s. Times are rounded to ns.

    Raises:
        StrideTwinError: The table cannot be read, is invalid, or has several IMUs; names file, column, row and value.
    """
    imus = read_imu_tables(Path(path), request or TableRequest(), Notes(Path(path), lenient=False))
    if len(imus) > 1:
        raise ConfigError(path, "sensors", ", ".join(imus), "one IMU; import the table to use several")
    (block,) = imus.values()
    return replace(block, topic=topic)


def read_imu_tables(path: Path, request: TableRequest, notes: Notes) -> dict[str, Block[Imu]]:
    """Reads all IMUs of a table or a folder of tables.

    Args:
        path: `.npz`, a text table (`.csv`, `.txt`, `.sto`), or a folder of text tables.
        request: Columns and rate of a table whose header leaves them open.
        notes: Collects what was assumed and bridged.

    Returns:
        Samples in m/s² and rad/s, by the name of the sensor in the source; "" for the only one. Where force and rate
        have stamps of their own, the force is interpolated to those of the rate.

    Raises:
        StrideTwinError: A table cannot be read, or is invalid; names file, column, row and value.
    """
    if path.is_dir():
        parts = read_folder_parts(path, request, notes)
    elif path.suffix == ".npz":
        t, accel, gyro = _read_npz(path)
        parts = [
            TablePart(file=path, sensor="", quantity=ACCEL, t=t, values=accel),
            TablePart(file=path, sensor="", quantity=GYRO, t=t, values=gyro),
        ]
    elif has_table_suffix(path) or request.columns:
        parts = read_text_table(path, request, notes)
    else:
        raise ConfigError(path, "", path.suffix, f"a table {', '.join(('.npz', *SUFFIXES))}")
    by_sensor: dict[str, dict[str, TablePart]] = {}  # force and rate, by sensor and quantity
    for part in parts:
        by_sensor.setdefault(part.sensor, {})[part.quantity] = part
    if not by_sensor:
        raise missing_axis_error(path, ACCEL, "x", ())
    return {sensor: _to_imu_block(path, sensor, sensor_parts, notes) for sensor, sensor_parts in by_sensor.items()}


def _to_imu_block(path: Path, sensor: str, parts: Mapping[str, TablePart], notes: Notes) -> Block[Imu]:
    """Joins the force and the rate of one sensor to a checked IMU without short gaps.

    If both have the same stamps they are joined row by row. Otherwise the gaps of each are bridged first, and the force
    is interpolated to the stamps of the rate.

    Args:
        path: The source, for errors.
        sensor: Name of the sensor; "" for the only one.
        parts: Force and rate, by `accel` and `gyro`.
        notes: Collects what was bridged and joined.

    Raises:
        ConfigError: One of them is missing, a number or a stamp is invalid, or the values are no IMU's.
    """
    for quantity in (ACCEL, GYRO):
        if quantity not in parts:
            (only_part,) = parts.values()
            what = "forces" if quantity == ACCEL else "rates"
            raise ConfigError(
                only_part.file,
                quantity,
                None,
                f"{what} of {sensor or 'the sensor'} as well; where they are in a second file, give the folder of both"
                f"; other names: {OPTION} {EXAMPLE}",
            )
    force, rate = parts[ACCEL], parts[GYRO]
    name = sensor or "IMU"
    for part in (force, rate):
        _check_numbers(part)
        _check_times(part)
    if force.t is rate.t:  # both are columns of one table
        columns = {"angular_rate": rate.values, "specific_force": force.values}
        block: Block[Imu] = Block(topic=name, kind=Imu, t_ns=_to_nanoseconds(rate.t), columns=columns)
        block = bridge_gaps(name, leave_out_unmeasured(name, block, notes), notes)
    else:
        blocks: list[Block[Imu]] = []  # of the rate and of the force, each with a column of its own alone
        for part in (rate, force):
            columns = {_COLUMNS[part.quantity]: part.values}
            single: Block[Imu] = Block(topic=name, kind=Imu, t_ns=_to_nanoseconds(part.t), columns=columns)
            part_name = f"{name} ({part.quantity})"
            measured = leave_out_unmeasured(part_name, single, notes)
            if len(measured) < MIN_ROWS:
                raise ConfigError(part.file, f"rows with {part.quantity}", len(measured), f"at least {MIN_ROWS}")
            blocks.append(bridge_gaps(part_name, measured, notes))
        block = join_at_gyro_stamps(name, *blocks)
        notes.warn(f"{name}: forces and rates are joined, the force interpolated to the stamps of the rate")
        check_overlap(f"{name} ({GYRO})", blocks[0].t_ns, f"{name} ({ACCEL})", blocks[1].t_ns, notes)
        if len(block) < MIN_ROWS:
            raise ConfigError(path, "stamps of forces and rates", f"{len(block)} in common", "stamps of one clock")
    if len(block) < MIN_ROWS:
        raise ConfigError(path, "rows with forces and rates", len(block), f"at least {MIN_ROWS}")
    for implausible in find_implausible_values(block):  # the first error counts
        if implausible.is_error:
            advice = _ADVICE.get(implausible.field)
            valid = implausible.valid if advice is None else f"{implausible.valid}; {advice}"
            raise ConfigError(path, implausible.field, implausible.value, valid)
        notes.warn(f"{name}: {implausible}")
    return block


def _to_nanoseconds(t: Array) -> Stamps:
    """Stamps (N,) ns of times (N,) s."""
    return np.rint(t * 1e9).astype(np.int64)


def _read_npz(path: Path) -> tuple[Array, Array, Array]:
    """Reads `t` (N,) s, `accel` (N, 3) m/s² and `gyro` (N, 3) rad/s of a `.npz` file.

    Raises:
        StrideTwinError: The file is damaged, too large unpacked, or an array is missing or has another shape.
    """
    try:
        _check_packing(path)
        with np.load(path, allow_pickle=False) as table:
            columns: dict[str, Array] = {n: table[n] for n in ("t", "accel", "gyro") if n in table}
            names = table.files
    except StrideTwinError:
        raise
    except Exception as error:  # damaged ZIP files raise many unrelated exceptions
        reason = " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
        raise StrideTwinError(f"{path}: cannot be read: {reason[:200]}") from error
    for name, shape in (("t", "(N,)"), ("accel", "(N, 3)"), ("gyro", "(N, 3)")):
        if name not in columns:
            raise ConfigError(path, name, None, f"an array {name} {shape}; the table has {', '.join(names) or 'none'}")
        count = columns["t"].size
        valid_shape = (count,) if name == "t" else (count, 3)
        if columns[name].shape != valid_shape or columns[name].dtype.kind not in "fiu":  # floats or integers
            valid = f"numbers of shape {valid_shape}"
            raise ConfigError(path, name, f"{columns[name].dtype} {columns[name].shape}", valid)
    return tuple(columns[n].astype(np.float64) for n in ("t", "accel", "gyro"))  # type: ignore[return-value]


def _check_packing(path: Path) -> None:
    """Rejects arrays that unpack to more bytes than sensor data.

    Raises:
        ConfigError: An array is too large.
        zipfile.BadZipFile: The file is not a ZIP file.
    """
    with zipfile.ZipFile(path) as packed:
        for member in packed.infolist():
            most = _FREE_BYTES + _BYTES_PER_BYTE * member.compress_size
            if member.file_size > most:
                raise ConfigError(path, f"size of {member.filename[:40]}, unpacked", member.file_size, f"up to {most}")


def _check_numbers(part: TablePart) -> None:
    """Rejects a table of fewer than `MIN_ROWS` rows, or with an invalid number beside others in its row."""
    if len(part.t) < MIN_ROWS:
        raise ConfigError(part.file, "rows", len(part.t), f"at least {MIN_ROWS}")
    for name, values in (("t", part.t[:, None]), (part.quantity, part.values)):
        # rows without a measurement are left out elsewhere
        is_empty = np.asarray(np.isnan(values).all(axis=1) & (name != "t"), bool)
        # times that are too large are refused with their unit in mind
        most = sys.float_info.max if name == "t" else LARGEST_NUMBER
        bad = np.argwhere(~(np.abs(values) <= most) & ~is_empty[:, None])  # (K, 2) row and column of each
        if len(bad):
            row, axis = bad[0]
            column = name if name == "t" else f"{name}_{AXES[axis]}"
            raise ConfigError(part.file, f"{column}, row {row + 1}", float(values[row, axis]), VALID_NUMBER)


def _check_times(part: TablePart) -> None:
    """Rejects stamps that decrease, are negative or later than `LATEST_S`, or are all equal."""
    path, t = part.file, part.t
    step = np.diff(t)
    if np.any(step < 0):
        row = int(np.argmax(step < 0)) + 1  # index of the first time that is before the previous one
        count = int(np.count_nonzero(step < 0))
        if t[row] < 0.5 * (t[0] + t[row - 1]):  # near the first stamp
            cause = (
                "did the recording begin again, as in files of several sessions? Cut the file there, and import each"
            )
        else:
            cause = (
                f"stamps go back {count} times: sort the rows by their stamps; or are rows of several sensors mixed?"
            )
        valid = f"a time after that of the previous row, {t[row - 1]:g} s; {cause}"
        raise ConfigError(path, f"t, row {row + 1}", float(t[row]), valid)
    if t[0] < 0:
        raise ConfigError(path, "t, row 1", float(t[0]), "a time from 0 s on")
    if t[-1] >= LATEST_S:
        raise ConfigError(path, f"t, row {len(t)}", float(t[-1]), f"a time before {LATEST_S:g} s")
    if t[0] == t[-1]:
        valid = f"stamps that increase; were their last digits lost? Write them in full, or give {RATE} HZ"
        raise ConfigError(path, "t", float(t[0]), valid)


TABLES = (".npz", ".csv")
_HEADER = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"


def write_imu_table(path: Path, block: Block[Imu]) -> None:
    """Writes a `.npz` or `.csv` that `read_imu_table` reads back, whole or not at all.

    Raises:
        ConfigError: Another suffix.
    """
    t, accel, gyro = block.t_ns * 1e-9, block.columns["specific_force"], block.columns["angular_rate"]
    if path.suffix not in TABLES:
        raise ConfigError(path, "", path.suffix, f"a table {' or '.join(TABLES)}")
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        if path.suffix == ".npz":
            np.savez_compressed(file, t=t, accel=accel, gyro=gyro)
        else:
            rows = np.column_stack([t, accel, gyro])
            formats = ["%.9f"] + ["%.9g"] * 6  # times to 1 ns, the six numbers to nine digits
            np.savetxt(file, rows, fmt=formats, delimiter=",", header=_HEADER, comments="")
