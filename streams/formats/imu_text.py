"""Text tables of inertial sensors: CSV of many apps and loggers, Xsens `.txt`, OpenSense `.sto`.

A folder may have forces and rates in separate tables. Sensor Logger: `TotalAcceleration.csv`, or `Accelerometer.csv`
and `Gravity.csv`; `Metadata.csv` names the platform, since iPhones report forces with the opposite sign. phyphox,
MetaMotion, Movesense and OpenSense name force and rate in the files' names.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.column_names import AXES
from stridetwin.streams.formats.imu_clocks import (
    RATE,
    choose_clock,
    has_nanoseconds,
    is_dot_tick,
    parse_stamps,
    preamble_rate,
    read_times,
    report_rate,
    tick_length,
)
from stridetwin.streams.formats.imu_columns import (
    ANDROID,
    NUMBERED,
    OPTION,
    PICOQUAKE,
    XSENS_DOT,
    Columns,
    Dialect,
    find_columns,
    find_force_without_gravity,
    map_columns,
    missing_axis_error,
    parse_header,
)
from stridetwin.streams.formats.imu_long import (
    LongLayout,
    find_long_layout,
    find_sensor_column,
    has_text_stamps,
    read_long_groups,
)
from stridetwin.streams.formats.imu_units import ACCEL, GYRO
from stridetwin.streams.formats.table_head import TableHead, no_names_error, read_table_head
from stridetwin.streams.formats.table_rows import read_groups
from stridetwin.streams.formats.text_encoding import FALLBACK, detect_encoding
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

__all__ = ["RATE"]

SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".sto")
"""Endings of the files of text tables."""
OPEN_SUFFIXES = (".txt", ".dat")
"""Those of them that other kinds of text have as well."""
_MOST_HEADS = 64  # files of a folder that are looked at for a header
# what the name of a file or folder with forces, or with rates, contains
_QUANTITIES = (
    (ACCEL, re.compile(r"acc(?:el|_|$)|_acc", re.IGNORECASE)),
    (GYRO, re.compile(r"gyr|angular|rotation_?rate", re.IGNORECASE)),
)

# what the names of files with forces without gravity contain, and those of files that are neither forces nor rates
_WITHOUT_GRAVITY = re.compile(r"linear(?!_?accelerations?\.sto)|user", re.IGNORECASE)
_OTHER = re.compile(r"gravity|uncalibrated|metadata|magnet|orientation|annotation", re.IGNORECASE)
# the part of a file's name that says what it contains, with what follows; the rest names the sensor
_WORDS = re.compile(
    r"[\W_]*(?:linear_accelerations?|angular_velocity|(?:total)?accel\w*?(?:eration|erometer)|gyr(?:o|oscope)?|acc(?:el)?"
    r"|rotation_?rate)(?![a-z]).*",
    re.IGNORECASE,
)
_TOTAL, _GRAVITY, _METADATA = "TotalAcceleration.csv", "Gravity.csv", "Metadata.csv"
"""Files of Sensor Logger: forces with gravity, gravity alone (both m/s²), and properties of the phone."""


@dataclass(frozen=True, kw_only=True)
class TableRequest:
    """How to read tables whose header leaves something open.

    Attributes:
        columns: Column and unit in brackets, such as `Acc X[g]`, of `t` and `ax` ... `gz`; empty: by the header.
        rate_hz: Rate of a table without stamps; None: from the table.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class TablePart:
    """The force or the rate of one sensor.

    Attributes:
        file: The table.
        sensor: Name of the sensor in the table; "" in a table of one.
        quantity: `accel` or `gyro`.
        t: (N,) s.
        values: (N, 3) m/s² or rad/s.
    """

    file: Path
    sensor: str
    quantity: str
    t: Array
    values: Array


def read_text_table(path: Path, request: TableRequest, notes: Notes, quantity: str | None = None) -> list[TablePart]:
    """The parts of a table `.csv`, `.txt` or `.sto`.

    Args:
        path: The table.
        request: Columns and rate that the user gives.
        notes: Collects what was assumed.
        quantity: What columns named `x`, `y`, `z` alone are: `accel`, `gyro` or ""; None: what the file's name implies.

    Raises:
        StrideTwinError: The table cannot be read, or lacks stamps, an axis or a unit; names file and column.
    """
    quantity = quantity_of(path.stem) if quantity is None else quantity
    text = _read_text(path, notes)
    if path.suffix == ".sto":
        return _read_vectors(path, text, quantity)
    try:
        return _read_scalars(path, text, request, notes, quantity)
    except csv.Error as error:
        raise StrideTwinError(f"{path}: cannot be read: {error}") from error


def _read_text(path: Path, notes: Notes) -> Iterator[str]:
    """The lines of a file in the encoding that it has; one that is not Unicode is reported.

    Raises:
        StrideTwinError: The file cannot be read, is too large, or is not text.
    """
    encoding = detect_encoding(path)
    if encoding == FALLBACK:
        notes.warn(f"{path.name}: is not UTF-8; read as {FALLBACK}")
    return read_lines(path, encoding)


def _read_scalars(
    path: Path, text: Iterator[str], request: TableRequest, notes: Notes, quantity: str
) -> list[TablePart]:
    """Reads a table with one number per cell, as CSV of any separator or Xsens' `.txt`.

    Times are the column of stamps, a counter divided by its rate, or the row's number divided by the rate.

    Args:
        path: Named by errors.
        text: Lines of the file.
        request: Columns and rate that the user gives.
        notes: Collects what was assumed.
        quantity: What columns named `x`, `y`, `z` alone are: `accel`, `gyro` or "".

    Raises:
        ConfigError: A cell is no number, or stamps, an axis or a unit are missing.
        csv.Error: The text is no table.
    """
    head = read_table_head(text, _names_of(request.columns))
    if skipped := head.skipped:
        notes.warn(f"{path.name}: {len(skipped)} lines between names and numbers are left out: {skipped[0][:60]}")
    if not request.columns and (layout := find_long_layout(head)) is not None:
        return _read_long(path, head, layout, request, notes)
    if request.columns:  # cells beyond the names have numbers alone
        width = max((len(row) for row in head.sample), default=0)
        head = replace(head, names=(*head.names, *(str(k + 1) for k in range(len(head.names), width))))
    columns = _columns_of(path, head, request, quantity)
    used = [at for signal in columns.signals for at in signal.at]
    sensor_at = None if request.columns or head.sensors else find_sensor_column(head, used)
    _report_dialect(path, head, columns, notes)
    groups = _read_cells(path, head, columns, request, notes, [] if sensor_at is None else [sensor_at])
    if len(groups) == 1:
        return next(iter(groups.values()))
    return [
        replace(part, sensor=" ".join(filter(None, (*key, part.sensor))))
        for key, parts in groups.items()
        for part in parts
    ]


def _names_of(mapping: Mapping[str, str]) -> list[str]:
    """Names of columns in the user's mapping, with and without units."""
    return [name for text in mapping.values() for name in (text, re.sub(r"\s*[\[(][^\[(]*[\])]\s*$", "", text))]


def _columns_of(path: Path, head: TableHead, request: TableRequest, quantity: str) -> Columns:
    """The columns of time, forces and rates, as the user or the header names them.

    Raises:
        ConfigError: The table has no names of columns, or an axis or a unit is missing.
    """
    if request.columns:
        columns = map_columns(path, head.names, request.columns, head.units)
    elif not head.has_names and head.sample:
        raise no_names_error(path, head, OPTION, NUMBERED)
    else:
        columns = find_columns(
            path, head.names, head.sensors, quantity, units=head.units, sample=head.sample, dialect=_dialect_of(head)
        )
    without = find_force_without_gravity(head.names)
    if without and all(signal.quantity != ACCEL for signal in columns.signals) and quantity != GYRO:
        valid = f"forces with gravity, as the sensor measures them: export those beside {without} as well"
        raise ConfigError(path, "forces", without, valid)
    if not columns.signals:
        raise missing_axis_error(path, quantity or ACCEL, AXES[0], head.names)
    if not request.columns:
        _check_width(path, head)
    return columns


def _check_width(path: Path, head: TableHead) -> None:
    """Refuses a table whose rows have more cells than names, as where commas separate cells and decimals."""
    widths = [len(row) - (not row[-1].strip()) for row in head.sample if row]
    if widths and min(widths) > len(head.names):
        valid = (
            f"{len(head.names)}, as many as names ({', '.join(head.names[:9])}); if decimals have commas, cells need "
            f"another separator: export with ; or with decimal points; {OPTION} numbers columns without a name"
        )
        raise ConfigError(path, "cells of a row", min(widths), valid)


def _report_dialect(path: Path, head: TableHead, columns: Columns, notes: Notes) -> None:
    """Reports units that are assumed by the clock alone, as no name and no line above the numbers gives them."""
    named = parse_header(head.names, head.units)
    rate_hz = preamble_rate(head.preamble)
    lacks = any(not named[signal.at[0]].unit for signal in columns.signals)
    if not lacks or rate_hz:
        return
    if is_dot_tick(tick_length(head.names, head.sample, rate_hz)):
        notes.warn(f"{path.name}: SampleTimeFine counts µs, as of a DOT: rates in deg/s assumed, forces in m/s²")
    elif has_nanoseconds(named, head.sample):
        notes.warn(f"{path.name}: stamps in ns, as of Android: forces in m/s² and rates in rad/s assumed")


def _dialect_of(head: TableHead) -> Dialect | None:
    """The units that the names leave out, by the lines above them or by the length of ticks; None: by the names."""
    preamble = "\n".join(head.preamble).lower()
    if "picoquake" in preamble:
        return PICOQUAKE
    tick_s = tick_length(head.names, head.sample, preamble_rate(head.preamble))
    if is_dot_tick(tick_s) or (not tick_s and "devicetag" in preamble):
        return XSENS_DOT
    return ANDROID if has_nanoseconds(parse_header(head.names, head.units), head.sample) else None


def _read_cells(
    path: Path,
    head: TableHead,
    columns: Columns,
    request: TableRequest,
    notes: Notes,
    key_at: Sequence[int],
) -> dict[tuple[str, ...], list[TablePart]]:
    """Reads the forces and rates of the rows, by the texts in some columns.

    Args:
        path: Named by errors.
        head: Head of the table.
        columns: Columns of time, forces and rates.
        request: Rate that the user gives.
        notes: Collects what was assumed.
        key_at: Columns whose texts tell rows of different sensors apart.

    Raises:
        ConfigError: A cell is no number, or the table has no stamps and no rate.
    """
    rate_hz = preamble_rate(head.preamble)
    clock = choose_clock(path, columns, request.rate_hz, rate_hz, tick_length(head.names, head.sample, rate_hz), notes)
    at = [clock.at] if clock.at is not None else []
    texts_at = at[0] if at and has_text_stamps(head, at[0]) else None
    has_fraction = columns.fraction is not None and clock.kind == "stamps"
    at += [columns.fraction] if has_fraction and columns.fraction is not None else []
    wanted = [*at, *(index for signal in columns.signals for index in signal.at)]  # first times, then x, y, z of each
    unused = columns.time if clock.kind == "rows" and not has_text_stamps(head, columns.time or 0) else None
    more = [] if unused is None else [unused]  # stamps that the rate replaces
    groups = read_groups(path, head, [*wanted, *more], key_at, times=len(at), texts_at=texts_at, unused_at=unused)
    result: dict[tuple[str, ...], list[TablePart]] = {}
    for key, (table, texts) in groups.items():
        if texts_at is not None:  # dates or times of day: seconds, whatever the unit in the header
            t = parse_stamps(path, head.names[at[0]], texts)
        else:
            t = read_times(path, columns, clock, table[:, 0] if at else table, len(table), notes)
        if has_fraction:
            t = t + columns.fraction_s * table[:, 1]
        if unused is not None:
            report_rate(path, columns, table[:, -1], clock.rate_hz, notes)
        parts = result.setdefault(key, [])
        for k, signal in enumerate(columns.signals):
            x_column = len(at) + 3 * k  # in `table`; those of y and z follow
            values = signal.factor * table[:, x_column : x_column + 3]
            parts.append(TablePart(file=path, sensor=signal.sensor, quantity=signal.quantity, t=t, values=values))
    return result


def _read_long(path: Path, head: TableHead, layout: LongLayout, request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads a table with a column that names the sensor or the quantity of each row.

    Raises:
        ConfigError: A cell is no number, or stamps or a unit are missing.
    """
    parts = [
        TablePart(file=path, sensor=sensor, quantity=quantity, t=t, values=values)
        for sensor, quantity, t, values in read_long_groups(path, head, layout, request.rate_hz, notes)
    ]
    return _without_only_sensor(parts)


def _without_only_sensor(parts: Sequence[TablePart]) -> list[TablePart]:
    """The parts, without names of sensors if there is one force and one rate alone."""
    if len(parts) == 2 and {part.quantity for part in parts} == {ACCEL, GYRO}:
        return [replace(part, sensor="") for part in parts]
    return list(parts)


def quantity_of(name: str) -> str:
    """Quantity that the name of a file or a folder implies, `accel` or `gyro`; "" for none or both."""
    quantities = [quantity for quantity, pattern in _QUANTITIES if pattern.search(name)]
    return quantities[0] if len(quantities) == 1 else ""


def _read_vectors(path: Path, text: Iterator[str], quantity: str) -> list[TablePart]:
    """Reads OpenSim's table with vectors `x,y,z` in its cells, one column per sensor.

    Args:
        path: Named by errors.
        text: Lines of the file.
        quantity: `accel` or `gyro`, which the file's name tells; "" is refused.

    Raises:
        ConfigError: The table has no vectors, its quantity is unknown, or a row is invalid.
    """
    keys: dict[str, str] = {}  # of the file's head, which ends with `endheader`
    for line in text:
        if line.strip().lower() == "endheader":
            break
        key, _, value = line.partition("=")
        keys[key.strip().lower()] = value.strip()
    kind = keys.get("datatype", "double")
    if kind.lower() != "vec3" or not quantity:
        valid = "Vec3, in files named ...linear_accelerations.sto and ...angular_velocity.sto"
        raise ConfigError(path, "DataType", kind, f"{valid}; orientations alone are no IMU")
    header = next(text, "").split()  # `time` and the names of the sensors
    vectors: dict[str, list[list[float]]] = {name: [] for name in header[1:]}  # (x, y, z) of each row, by sensor
    t: list[float] = []
    for row, line in enumerate((line for line in text if line.strip()), 1):
        cells = line.split()
        try:
            t.append(float(cells[0]))
            for name, cell in zip(header[1:], cells[1:], strict=True):
                x, y, z = map(float, cell.split(","))
                vectors[name].append([x, y, z])
        except ValueError:
            raise ConfigError(path, f"row {row}", line.strip(), f"time and {len(header) - 1} vectors x,y,z") from None
    stamps = np.array(t)
    return [
        TablePart(file=path, sensor=name, quantity=quantity, t=stamps, values=np.array(rows).reshape(-1, len(AXES)))
        for name, rows in vectors.items()
    ]


def is_imu_folder(path: Path) -> bool:
    """Whether a folder has a table of forces and one of rates, by the names of its files, or a table of both."""
    if {ACCEL, GYRO} <= {quantity_of(file.stem) for file in _list_tables(path)}:
        return True
    return bool(_list_complete_tables(path))


def is_imu_text(path: Path) -> bool:
    """Whether the names of a text table's columns are those of forces and rates of an IMU; no error is raised."""
    try:
        head = read_table_head(read_lines(path, detect_encoding(path)))
        if find_long_layout(head) is not None:
            return True
        kinds = {column.quantity for column in parse_header(head.names, head.units) if column.axis}
    except (StrideTwinError, csv.Error):
        return False
    return head.has_names and {ACCEL, GYRO} <= kinds


def read_folder_parts(path: Path, request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads the forces and rates of all tables in a folder; those of one sensor have the same sensor name.

    Tables of both, one for each sensor, count before those of one quantity. Gravity in a table of its own is added to
    forces without it, and the sign of an iPhone's forces is corrected; both are reported.

    Args:
        path: The folder.
        request: Columns and rate that the user gives.
        notes: Collects what was assumed.

    Raises:
        StrideTwinError: A table cannot be read, or all forces are without gravity.
    """
    if complete := _list_complete_tables(path):
        return _read_sensor_tables(complete, request, notes)
    parts: list[TablePart] = []
    for file in _list_tables(path):
        sensor = _WORDS.sub("", file.stem)  # what the name of the file says beside the quantity
        for part in read_text_table(file, request, notes):
            name = part.sensor or sensor
            # of two tables with the same quantity of one sensor the first counts
            if all((known.sensor, known.quantity) != (name, part.quantity) for known in parts):
                parts.append(replace(part, sensor=name))
    if (path / _GRAVITY).is_file() and not (path / _TOTAL).is_file():
        gravity = read_text_table(path / _GRAVITY, request, notes, ACCEL)[0]
        parts = [_add_gravity(p, gravity) if p.quantity == ACCEL else p for p in parts]
        notes.warn(f"{_GRAVITY} is added to the forces")
    if all(part.quantity != ACCEL for part in parts):
        # a table of forces without gravity, if there is one, for the message
        without = next((f.name for f in sorted(path.iterdir()) if _WITHOUT_GRAVITY.search(f.name)), None)
        raise ConfigError(path, "forces", without, "an accelerometer with gravity, as the sensor measures it")
    if (path / _METADATA).is_file() and _is_raw_iphone(path / _METADATA):
        notes.warn(f"{_METADATA}: an iPhone's forces have the opposite sign, which is corrected")
        parts = [replace(p, values=-p.values) if p.quantity == ACCEL else p for p in parts]
    if len({part.sensor for part in parts}) == 1:  # the only sensor needs no name
        parts = [replace(part, sensor="") for part in parts]
    return _without_only_sensor(parts)


def _read_sensor_tables(files: Sequence[Path], request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads tables of both quantities; the name of the file is that of the sensor, unless there is one alone."""
    parts: list[TablePart] = []
    for file in files:
        for part in read_text_table(file, request, notes):
            name = " ".join(filter(None, (file.stem, part.sensor))) if len(files) > 1 else part.sensor
            parts.append(replace(part, sensor=name))
    return parts


def _list_complete_tables(path: Path) -> list[Path]:
    """Lists the tables in a folder that have forces and rates, one for each sensor."""
    files = [f for f in sorted(path.iterdir()) if f.is_file() and f.suffix in SUFFIXES and f.suffix != ".sto"]
    files = [f for f in files if not _OTHER.search(f.name) and not quantity_of(f.stem)]
    return [file for file in files[:_MOST_HEADS] if is_imu_text(file)]


def _add_gravity(force: TablePart, gravity: TablePart) -> TablePart:
    """A force with gravity (both m/s²) interpolated to its stamps and added."""
    added = np.column_stack([np.interp(force.t, gravity.t, gravity.values[:, k]) for k in range(3)])
    return replace(force, values=force.values + added)


def _list_tables(path: Path) -> list[Path]:
    """Lists the tables of forces and rates in a folder by their names.

    Tables of orientation, magnetic field and forces without gravity are left out; `TotalAcceleration.csv` stands for
    all forces where it exists.
    """
    files = [f for f in sorted(path.iterdir()) if f.is_file() and f.suffix in SUFFIXES and quantity_of(f.stem)]
    files = [f for f in files if not _OTHER.search(f.name) and not _WITHOUT_GRAVITY.search(f.name)]
    if (path / _TOTAL).is_file():
        files = [f for f in files if f.name == _TOTAL or quantity_of(f.stem) == GYRO]
    return files


def _is_raw_iphone(file: Path) -> bool:
    """Whether Sensor Logger's metadata name an iPhone whose forces have Apple's sign, opposite to Android's.

    The app can write both platforms' measurements alike; the metadata then say that they are standardised.

    Args:
        file: `Metadata.csv`: a row of names and a row of values.

    Raises:
        StrideTwinError: The file cannot be read.
    """
    try:
        rows = list(csv.reader(read_lines(file, detect_encoding(file))))
    except csv.Error as error:
        raise StrideTwinError(f"{file}: cannot be read: {error}") from error
    properties = dict(zip(*rows[:2])) if len(rows) > 1 else {}  # value by name
    is_iphone = properties.get("platform", "").lower() == "ios"
    return is_iphone and properties.get("standardisation", "").lower() != "true"
