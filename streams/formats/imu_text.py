"""Text tables of inertial sensors: CSV of many apps and loggers, Xsens `.txt`, OpenSense `.sto`.

What stands above the numbers is read by `table_head`, the columns are told by `imu_columns`, times by `imu_clocks`, and
tables of one reading per row by `imu_long`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import LONGEST_ROW, read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.column_names import AXES
from stridetwin.streams.formats.imu_clocks import (
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

SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".sto")
"""Endings of the files of text tables."""
OPEN_SUFFIXES = (".txt", ".dat")
"""Those of them that other kinds of text have as well."""
# what the name of a file or folder with forces, or with rates, contains
_QUANTITIES = (
    (ACCEL, re.compile(r"acc(?:el|_|$)|_acc", re.IGNORECASE)),
    (GYRO, re.compile(r"gyr|angular|rotation_?rate", re.IGNORECASE)),
)


@dataclass(frozen=True, kw_only=True)
class TableRequest:
    """How to read tables whose header leaves something open.

    Attributes:
        columns: Column, by its name or its number from 1, and unit in brackets, such as `Acc X[g]` or `2[g]`, of `t`
            and `ax` ... `gz`; empty: by the header.
        rate_hz: Rate of the table's counter of packets, or of its rows without one; None: from the table.
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


def is_imu_text(path: Path) -> bool:
    """Whether the names of a text table's columns are those of forces and rates of an IMU; no error is raised."""
    try:
        head = read_table_head(read_lines(path, detect_encoding(path), LONGEST_ROW))
        if find_long_layout(head) is not None:
            return True
        kinds = {column.quantity for column in parse_header(head.names, head.units) if column.axis}
    except (StrideTwinError, csv.Error):
        return False
    return head.has_names and {ACCEL, GYRO} <= kinds


def _read_text(path: Path, notes: Notes) -> Iterator[str]:
    """The lines of a file in the encoding that it has; one that is not Unicode is reported.

    Raises:
        StrideTwinError: The file cannot be read, is too large, or is not text.
    """
    encoding = detect_encoding(path)
    if encoding == FALLBACK:
        notes.warn(f"{path.name}: is not UTF-8; read as {FALLBACK}")
    return read_lines(path, encoding, LONGEST_ROW)


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
    is_numbered = all(text.partition("[")[0].strip().isdecimal() for text in request.columns.values())
    if not is_numbered or not request.columns:
        _check_width(path, head)
    else:  # cells beyond the names have numbers alone
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
    """Reports units that are assumed by the form of the table alone, as no line of it gives them."""
    named = parse_header(head.names, head.units)
    rate_hz = preamble_rate(head.preamble)
    lacks = any(not named[signal.at[0]].unit for signal in columns.signals)
    if not lacks or rate_hz:
        return
    if is_dot_tick(tick_length(head.names, head.sample, rate_hz)):
        notes.warn(f"{path.name}: SampleTimeFine counts µs, as of a DOT: rates in deg/s assumed, forces in m/s²")
    elif has_nanoseconds(named, head.sample):
        notes.warn(f"{path.name}: stamps in ns, as of Android: forces in m/s² and rates in rad/s assumed")
    elif head.sensors or [column.name for column in named[:4]] == ["timestamp", "x", "y", "z"]:
        maker = "gaitmap" if head.sensors else "Movesense"
        notes.warn(f"{path.name}: no units in the header; those of {maker} assumed: m/s², deg/s")


def _dialect_of(head: TableHead) -> Dialect | None:
    """The units that the names leave out, by the lines above them or by the length of ticks; None: by the names."""
    preamble = "\n".join(head.preamble).lower()
    if "picoquake" in preamble:
        return PICOQUAKE
    tick_s = tick_length(head.names, head.sample, preamble_rate(head.preamble))
    if is_dot_tick(tick_s) or (not tick_s and "devicetag" in preamble):
        return XSENS_DOT
    if head.sensors:
        return None
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
    return without_only_sensor(parts)


def without_only_sensor(parts: Sequence[TablePart]) -> list[TablePart]:
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
    if len(set(header)) < len(header):
        raise ConfigError(path, "names of the sensors", " ".join(header), "another name for each sensor")
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
