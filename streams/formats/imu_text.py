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
from numpy.typing import NDArray

from stridetwin.streams.bounded import LONGEST_ROW, read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats import imu_columns
from stridetwin.streams.formats.column_names import AXES, is_counter_name, parse_column
from stridetwin.streams.formats.imu_clocks import (
    TICKS,
    Clock,
    choose_clock,
    has_nanoseconds,
    is_dot_tick,
    parse_stamps,
    preamble_rate,
    read_times,
    report_rate,
    tick_length,
)
from stridetwin.streams.formats.imu_long import (
    LongLayout,
    find_long_layout,
    find_sensor_column,
    has_text_stamps,
    read_long_groups,
    read_mapped_groups,
)
from stridetwin.streams.formats.imu_units import ACCEL, GYRO, TIME, unit_of
from stridetwin.streams.formats.table_head import TableHead, no_names_error, read_table_head
from stridetwin.streams.formats.table_rows import RowReader, read_groups
from stridetwin.streams.formats.text_encoding import detect_encoding
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

SUFFIXES = (".csv", ".txt", ".tsv", ".tab", ".dat", ".log", ".asc", ".prn", ".sto")
"""Endings of the files of text tables, in lower case."""
OPEN_SUFFIXES = (".txt", ".dat", ".log", ".asc", ".prn")
"""Those of them that other kinds of text have as well."""
_APPLE = re.compile(r"accelerometerAcceleration[XYZ]\b")
"""Names of Core Motion's acceleration, which is the opposite of the specific force."""
_MOST_NAMED = 6
"""Most columns that the report of unused ones names."""
_QUANTITIES = (
    (ACCEL, re.compile(r"acc(?:el|_|$)|_acc", re.IGNORECASE)),
    (GYRO, re.compile(r"gyr|angular|rotation_?rate", re.IGNORECASE)),
)
"""What the name of a file or folder with forces, or with rates, contains, as `left_acc.csv` and `Gyroscope.csv`."""


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
        zero_s: Time of t = 0 since 1970, where the table gives both; None otherwise.
    """

    file: Path
    sensor: str
    quantity: str
    t: Array
    values: Array
    zero_s: float | None = None


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
    if path.suffix.lower() == ".sto":
        return _read_vectors(path, text, quantity)
    try:
        return _read_scalars(path, text, request, notes, quantity)
    except csv.Error as error:
        raise StrideTwinError(f"{path}: cannot be read: {error}") from error


def is_imu_text(path: Path) -> bool:
    """Whether a text table has columns of an IMU: forces or rates, or what is refused in place of them.

    No error is raised.
    """
    head = _read_head(path)
    if head is None:
        return False
    is_other = imu_columns.find_force_without_gravity(head.names) or imu_columns.find_increment(head.names)
    return bool(find_quantities(path)) or (head.has_names and bool(is_other))


def find_quantities(path: Path) -> set[str]:
    """Quantities of the columns of a text table, `accel` and `gyro`, by their names; no error is raised."""
    head = _read_head(path)
    if head is None:
        return set()
    if find_long_layout(head) is not None:
        return {ACCEL, GYRO}
    if not head.has_names:
        return set()
    named = imu_columns.name_numbered_axes(imu_columns.parse_header(head.names, head.units))
    return {column.quantity for column in named if column.axis and column.quantity}


def has_table_suffix(path: Path) -> bool:
    """Whether the name of a file ends as those of text tables do, in any case."""
    return path.suffix.lower() in SUFFIXES


def _read_head(path: Path) -> TableHead | None:
    """Head of a text table; None for a file that is none."""
    try:
        return read_table_head(read_lines(path, detect_encoding(path), LONGEST_ROW))
    except (StrideTwinError, csv.Error):
        return None


def _read_text(path: Path, notes: Notes) -> Iterator[str]:
    """The lines of a file in the encoding that it has; one that is not Unicode is reported.

    Raises:
        StrideTwinError: The file cannot be read, is too large, or is not text.
    """
    encoding = detect_encoding(path)
    if not encoding.startswith("utf"):
        notes.warn(f"{path.name}: is not UTF-8; read as {encoding}")
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
    if imu_columns.KIND in request.columns:
        return _read_mapped(path, head, request, notes)
    is_numbered = all(text.partition("[")[0].strip().isdecimal() for text in request.columns.values())
    if not is_numbered or not request.columns:
        _check_width(path, head)
    else:  # cells beyond the names have numbers alone
        width = max((len(row) for row in head.sample), default=0)
        head = replace(head, names=(*head.names, *(str(k + 1) for k in range(len(head.names), width))))
    columns = _columns_of(path, head, request, quantity, notes)
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


def _columns_of(path: Path, head: TableHead, request: TableRequest, quantity: str, notes: Notes) -> imu_columns.Columns:
    """The columns of time, forces and rates, as the user or the header names them.

    Raises:
        ConfigError: The table has no names of columns, or an axis or a unit is missing.
    """
    if request.columns:
        columns = imu_columns.map_columns(path, head.names, request.columns, head.units)
    elif not head.has_names and head.sample:
        raise no_names_error(path, head, imu_columns.OPTION, imu_columns.NUMBERED)
    else:
        columns = imu_columns.find_columns(
            path, head.names, head.sensors, quantity, units=head.units, sample=head.sample, dialect=_dialect_of(head)
        )
        if any(_APPLE.match(name) for name in head.names):
            notes.warn(f"{path.name}: Apple's forces have the opposite sign, which is corrected")
            columns = replace(columns, signals=tuple(map(_turn_force, columns.signals)))
        named = imu_columns.parse_header(head.names, head.units)
        if columns.time is not None and not imu_columns.is_stamp_column(named[columns.time]):
            notes.warn(f"{path.name}: column {head.names[columns.time] or columns.time + 1} is taken for the stamps")
    without = imu_columns.find_force_without_gravity(head.names)
    if without and all(signal.quantity != ACCEL for signal in columns.signals) and quantity != GYRO:
        valid = f"forces with gravity, as the sensor measures them: export those beside {without} as well"
        raise ConfigError(path, "forces", without, valid)
    if not columns.signals:
        raise imu_columns.missing_axis_error(path, quantity or ACCEL, AXES[0], head.names)
    return columns


def _turn_force(signal: imu_columns.Signal) -> imu_columns.Signal:
    """A signal with the opposite sign if it is a force."""
    return replace(signal, factor=-signal.factor) if signal.quantity == ACCEL else signal


def _check_width(path: Path, head: TableHead) -> None:
    """Refuses a table whose rows have more cells than names, as where commas separate cells and decimals.

    Raises:
        ConfigError: All rows of the sample have more cells than there are names.
    """
    widths = [len(row) - _count_empty_at_end(row) for row in head.sample if row]
    if widths and min(widths) > len(head.names):
        valid = (
            f"{len(head.names)}, as many as names ({', '.join(head.names[:9])}); if decimals have commas, cells need "
            "another separator: export with ; or with decimal points; "
            f"{imu_columns.OPTION} numbers columns without a name"
        )
        raise ConfigError(path, "cells of a row", min(widths), valid)


def _count_empty_at_end(row: Sequence[str]) -> int:
    """Number of empty cells at the end of a row, behind separators."""
    return next((k for k, cell in enumerate(reversed(row)) if cell.strip()), len(row))


def _report_dialect(path: Path, head: TableHead, columns: imu_columns.Columns, notes: Notes) -> None:
    """Reports units that are assumed by the form of the table alone, as no line of it gives them.

    Args:
        path: Named by the report.
        head: Head of the table.
        columns: Its columns.
        notes: Collects the report.
    """
    named = imu_columns.parse_header(head.names, head.units)
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


def _dialect_of(head: TableHead) -> imu_columns.Dialect | None:
    """The units that the names leave out, by the lines above them or by the length of ticks; None: by the names."""
    preamble = "\n".join(head.preamble).lower()
    if "picoquake" in preamble:
        return imu_columns.PICOQUAKE
    tick_s = tick_length(head.names, head.sample, preamble_rate(head.preamble))
    if is_dot_tick(tick_s) or (not tick_s and "devicetag" in preamble):
        return imu_columns.XSENS_DOT
    if head.sensors:
        return None
    return (
        imu_columns.ANDROID if has_nanoseconds(imu_columns.parse_header(head.names, head.units), head.sample) else None
    )


def _read_cells(
    path: Path,
    head: TableHead,
    columns: imu_columns.Columns,
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

    Returns:
        The parts, by the texts in these columns; without such columns there is one key, an empty one.

    Raises:
        ConfigError: A cell is no number, or the table has no stamps and no rate.
    """
    rate_hz = preamble_rate(head.preamble)
    tick_s = tick_length(head.names, head.sample, rate_hz)
    clock = choose_clock(path, columns, head.sample, request.rate_hz, rate_hz, tick_s, notes)
    at = [clock.at] if clock.at is not None else []
    texts_at = at[0] if at and has_text_stamps(head, at[0]) else None
    has_fraction = columns.fraction is not None and clock.kind == "stamps"
    at += [columns.fraction] if has_fraction and columns.fraction is not None else []
    own_times = [s.time for s in columns.signals if s.time is not None] if clock.kind == "stamps" else []
    # first times, then x, y, z of each signal, then stamps of a signal alone, then stamps that the rate replaces
    read_at = [*at, *(index for signal in columns.signals for index in signal.at), *own_times]
    unused = columns.time if clock.kind == "rows" and not has_text_stamps(head, columns.time or 0) else None
    read_at += [] if unused is None else [unused]
    read_at += [] if columns.epoch is None or own_times else [columns.epoch]
    times = 0 if own_times else len(at)  # where signals have stamps of their own, rows may lack others
    reader = RowReader(wanted=read_at, times=times, texts_at=texts_at, unused_at=unused)
    groups = read_groups(path, head, reader, notes, key_at)
    _report_unused(path, head, [*read_at, *key_at], notes)
    result: dict[tuple[str, ...], list[TablePart]] = {}
    for key, (table, texts) in groups.items():
        if not len(table):
            raise ConfigError(path, "rows", 0, "rows of numbers below the names of the columns")
        cells = {index: table[:, place] for place, index in reversed(list(enumerate(read_at)))}
        if unused is not None:
            report_rate(path, columns, cells[unused], clock.rate_hz, notes)
        if own_times:
            clocks = _read_own_times(path, head, columns, cells, notes)
        else:
            t = _read_shared_times(path, head, columns, clock, cells, texts if texts_at is not None else None, notes)
            clocks = [(t, np.arange(len(t)))] * len(columns.signals)
        result[key] = [
            _to_part(path, columns, signal, cells, t, rows)
            for signal, (t, rows) in zip(columns.signals, clocks, strict=True)
        ]
    return result


def _to_part(
    path: Path,
    columns: imu_columns.Columns,
    signal: imu_columns.Signal,
    cells: Mapping[int, Array],
    t: Array,
    rows: NDArray[np.int64],
) -> TablePart:
    """The part of a signal.

    Args:
        path: The table.
        columns: The columns.
        signal: The signal.
        cells: (N,) numbers by the index of their column.
        t: (K,) times, s.
        rows: (K,) rows that they are of.

    Returns:
        K values in m/s² or rad/s with their times, and the time of t = 0 since 1970 where the table gives both.
    """
    values = signal.factor * np.column_stack([cells[index] for index in signal.at])[rows]
    zero_s = None
    if columns.epoch is not None and columns.epoch in cells and len(t):
        zero_s = float(columns.epoch_s * cells[columns.epoch][rows[0]] - t[0])
    return TablePart(file=path, sensor=signal.sensor, quantity=signal.quantity, t=t, values=values, zero_s=zero_s)


def _read_shared_times(
    path: Path,
    head: TableHead,
    columns: imu_columns.Columns,
    clock: Clock,
    cells: Mapping[int, Array],
    texts: Sequence[str] | None,
    notes: Notes,
) -> Array:
    """Times of the rows, (N,) s, of a table with one clock.

    Args:
        path: Named by errors.
        head: Head of the table.
        columns: The columns.
        clock: What tells the times.
        cells: (N,) numbers by the index of their column.
        texts: The stamps, if they are dates or times of day; then they are seconds, whatever the unit in the header.
        notes: Collects what was assumed.

    Raises:
        ConfigError: A stamp is invalid, no unit of time fits, or a counter goes back.
    """
    count = len(cells[columns.signals[0].at[0]])
    if texts is not None:
        t = parse_stamps(path, head.names[clock.at or 0], texts)
    else:
        t = read_times(path, columns, clock, np.empty(0) if clock.at is None else cells[clock.at], count, notes)
    if columns.fraction in cells and columns.fraction is not None and clock.kind == "stamps":
        t = t + columns.fraction_s * cells[columns.fraction]
    return t


def _read_own_times(
    path: Path, head: TableHead, columns: imu_columns.Columns, cells: Mapping[int, Array], notes: Notes
) -> list[tuple[Array, NDArray[np.int64]]]:
    """Times (K,) s of each signal, and the rows (K,) that they are of, in a table of several clocks.

    Args:
        path: Named by errors.
        head: Head of the table.
        columns: The columns, some of whose signals have stamps of their own.
        cells: (N,) numbers by the index of their column; not a number where a row has no stamp.
        notes: Collects what was assumed.

    Raises:
        ConfigError: A signal has no stamps, or no unit of time fits them.
    """
    named = imu_columns.parse_header(head.names, head.units)
    by_column: dict[int, tuple[Array, NDArray[np.int64]]] = {}  # by that of the stamps
    result = []
    for signal in columns.signals:
        at = columns.time if signal.time is None else signal.time
        if at is None:
            raise imu_columns.missing_axis_error(path, TIME, "", head.names)
        if at not in by_column:
            rows = np.flatnonzero(np.isfinite(cells[at]))
            unit = unit_of(named[at].unit)
            of_signal = replace(columns, time=at, time_unit=columns.time_unit if unit is None else unit[1])
            t = read_times(path, of_signal, Clock(at=at, kind="stamps"), cells[at][rows], len(rows), notes)
            by_column[at] = (t, rows)
        result.append(by_column[at])
    return result


def _report_unused(path: Path, head: TableHead, used: Sequence[int], notes: Notes) -> None:
    """Names the columns that are neither stamps nor forces nor rates, as a misspelled one would be among them.

    Args:
        path: Named by the report.
        head: Head of the table.
        used: Indices of the columns that are used.
        notes: Collects the report.
    """
    names = [
        name
        for at, name in enumerate(head.names)
        if head.has_names and at not in used and name.strip() and not _counts_or_times(name)
    ]
    if names:
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        notes.warn(f"{path.name}: columns that are not used: {', '.join(names[:_MOST_NAMED])}{more}")


def _counts_or_times(name: str) -> bool:
    """Whether a column has other stamps or numbers of the rows."""
    column = parse_column(name)
    joined = column.name.replace("_", "")
    is_index = joined.startswith("unnamed") or joined in ("index", "row", TICKS)
    return is_index or is_counter_name(column.name) or imu_columns.is_stamp_column(column)


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


def _read_mapped(path: Path, head: TableHead, request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads a table whose rows are readings of one sensor each, by the columns that the user names.

    Raises:
        ConfigError: A column is unknown, a cell is no number, or stamps or a quantity are missing.
    """
    columns = imu_columns.map_columns(path, head.names, request.columns, head.units)
    kind_at = imu_columns.find_named_column(path, head.names, imu_columns.KIND, request.columns[imu_columns.KIND])
    return [
        TablePart(file=path, sensor=sensor, quantity=quantity, t=t, values=values)
        for sensor, quantity, t, values in read_mapped_groups(path, head, columns, kind_at, request.rate_hz, notes)
    ]


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
