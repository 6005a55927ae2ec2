"""Text tables of inertial sensors: CSV of many apps and loggers, Xsens `.txt`, OpenSense `.sto`.

A folder may have forces and rates in separate tables. Sensor Logger: `TotalAcceleration.csv`, or `Accelerometer.csv`
and `Gravity.csv`; `Metadata.csv` names the platform, since iPhones report forces with the opposite sign. phyphox,
MetaMotion, Movesense and OpenSense name force and rate in the files' names.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.imu_columns import (
    ACCEL,
    AXES,
    GYRO,
    OPTION,
    TIME,
    UNITS,
    Columns,
    find_columns,
    map_columns,
    missing_axis_error,
)
from stridetwin.streams.plausible import IMU_RATES_HZ
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

SUFFIXES = (".csv", ".txt", ".sto")
"""Endings of the files of text tables."""
RATE = "--rate"
"""Option of the command line for the rate of a table without stamps, as errors name it."""
_TICK_S = 1e-4  # of Xsens' SampleTimeFine
_COUNTERS = {"packetcounter": 2**16, "sampletimefine": 2**32}
"""Number of counts after which each of Xsens' counters begins again, by the name of its column in lower case."""
_RATE_COMMENT = re.compile(r"//\s*update rate:\s*([0-9.]+)\s*hz", re.IGNORECASE)
"""The line in the head of Xsens' tables that gives the rate."""
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
    text = read_lines(path, "utf-8-sig")
    if path.suffix == ".sto":
        return _read_vectors(path, text, quantity)
    try:
        return _read_scalars(path, text, request, notes, quantity)
    except csv.Error as error:
        raise StrideTwinError(f"{path}: cannot be read: {error}") from error


def _read_scalars(
    path: Path, text: Iterator[str], request: TableRequest, notes: Notes, quantity: str
) -> list[TablePart]:
    """Reads a table with one number per cell, as CSV of any separator or Xsens' `.txt`.

    Times are the column of stamps, Xsens' counter divided by its rate, or the row's number divided by the rate in the
    request.

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
    comments: list[str] = []  # lines of Xsens' head, which may name the rate
    first = ""  # the first line of the table
    for first in text:
        if first.startswith("//"):
            comments.append(first)
        elif first.strip():
            break
    separator = max("\t;,", key=first.count)
    rows = csv.reader(chain([first], text), delimiter=separator)
    header = [cell.strip() for cell in next(rows, [])]
    head = next(rows, None)
    sensors: list[str] = []
    if head is not None and any(head[1:]) and not any(map(_is_number, head)):
        # a second row of names, as gaitmap writes: the first row has the sensors, the second the axes
        sensors, header = header, [cell.strip() for cell in head]
        head = next(rows, None)
    if request.columns:
        columns = map_columns(path, header, request.columns)
    else:
        columns = find_columns(path, header, sensors, quantity)
    if not columns.signals:
        raise missing_axis_error(path, quantity or ACCEL, AXES[0], header)
    counter, rate_hz = _find_counter(columns, comments, request)
    # index of the column of times or of the counter, in a list; empty without one, or with a rate in the request
    at = [c for c in (columns.time if counter is None else counter,) if c is not None and request.rate_hz is None]
    wanted = [*at, *(index for signal in columns.signals for index in signal.at)]  # first times, then x, y, z of each
    body = chain([head], rows) if head is not None else rows
    table = _read_numbers(path, header, body, wanted, decimal="," if separator == ";" else "")
    if at and counter is not None:
        t = _unwrap_counter(table[:, 0], header[counter]) / rate_hz
    elif at:
        t = table[:, 0] * _find_time_factor(path, columns, table[:, 0], notes)
    elif request.rate_hz is not None:
        t = np.arange(len(table)) / request.rate_hz
    else:
        columns_text = ", ".join(header) or "none"
        raise ConfigError(path, "t", None, f"a column of time; the table has {columns_text}; without one: {RATE} HZ")
    parts: list[TablePart] = []
    for k, signal in enumerate(columns.signals):
        x_column = len(at) + 3 * k  # in `table`; those of y and z follow
        values = signal.factor * table[:, x_column : x_column + 3]
        parts.append(TablePart(file=path, sensor=signal.sensor, quantity=signal.quantity, t=t, values=values))
    return parts


def quantity_of(name: str) -> str:
    """Quantity that the name of a file or a folder implies, `accel` or `gyro`; "" for none or both."""
    quantities = [quantity for quantity, pattern in _QUANTITIES if pattern.search(name)]
    return quantities[0] if len(quantities) == 1 else ""


def _find_counter(columns: Columns, comments: Sequence[str], request: TableRequest) -> tuple[int | None, float]:
    """Finds the counter of packets or ticks that stands for the time in Xsens' tables.

    Args:
        columns: The columns of the table.
        comments: Lines above the table, one of which may give the rate of packets.
        request: What the user gives; columns that the user names take precedence.

    Returns:
        Index of the counter's column, and its counts per second; (None, 0) for a table with stamps or without counter.
    """
    names = [name.strip().lower() for name in columns.names]
    rate_hz = next((float(m[1]) for line in comments if (m := _RATE_COMMENT.match(line))), 0.0)
    if request.columns or columns.time is not None:
        return None, 0.0
    if "packetcounter" in names and rate_hz > 0:
        return names.index("packetcounter"), rate_hz
    return (names.index("sampletimefine"), 1 / _TICK_S) if "sampletimefine" in names else (None, 0.0)


def _unwrap_counter(counts: Array, name: str) -> Array:
    """Counts (N,) since the first row, from a counter that overflows at 2¹⁶ (packets) or 2³² (ticks).

    Args:
        counts: (N,) values of the counter.
        name: Header of its column, which says where it overflows.
    """
    size = _COUNTERS[name.strip().lower()]
    steps = np.diff(counts)
    steps = np.where(steps < -size / 2, steps + size, steps)  # a large step back is an overflow
    return np.concatenate(([0.0], np.cumsum(steps)))


def _find_time_factor(path: Path, columns: Columns, t: Array, notes: Notes) -> float:
    """Finds the factor from the table's stamps (N,) to s.

    Without a unit it is the first of s, ms, µs and ns that gives a rate of an IMU, which is reported.

    Args:
        path: Named by errors.
        columns: The columns of the table.
        t: (N,) stamps in the table's unit.
        notes: Collects the unit that is assumed.

    Raises:
        ConfigError: No unit gives such a rate, or the column only numbers the rows.
    """
    if columns.time_unit:
        return UNITS[TIME][columns.time_unit]
    assert columns.time is not None
    steps = np.diff(t)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else math.nan  # period in the table's unit
    name = columns.names[columns.time]
    if name in ("", "axis") and np.all(steps == 1):
        raise ConfigError(path, "column 1", "numbers of rows", f"stamps in s, or {RATE} HZ")
    for unit, factor in UNITS[TIME].items():
        if IMU_RATES_HZ[0] < 1 / (factor * step) < IMU_RATES_HZ[1]:
            notes.warn(f"{path.name}: {name or 'time'} has no unit; {unit} assumed: {1 / (factor * step):.4g} Hz")
            return factor
    raise ConfigError(path, f"{name}, unit", None, f"a unit of time in brackets, as in {OPTION} t={name}[ms]")


def _read_numbers(
    path: Path, header: Sequence[str], rows: Iterable[list[str]], wanted: Sequence[int], decimal: str
) -> Array:
    """Reads some columns of the rows that are not empty as numbers: (N, K).

    Args:
        path: Named by errors.
        header: Name of every column.
        rows: Cells of each row.
        wanted: (K,) indices of the columns.
        decimal: Decimal separator in place of the point; "" for the point.

    Raises:
        ConfigError: A cell is missing or no number.
    """
    numbers = array("d")  # row after row
    count = 0  # rows so far that are not empty
    for cells in rows:
        if not any(cells):
            continue
        count += 1
        for at in wanted:
            try:
                numbers.append(float(cells[at].replace(decimal, ".") if decimal else cells[at]))
            except (ValueError, IndexError):
                value = cells[at] if at < len(cells) else None
                raise ConfigError(path, f"{header[at]}, row {count}", value, "a number") from None
    return np.array(numbers).reshape(count, len(wanted))


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


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
    """Whether a folder has a table of forces and one of rates, by the names of its files."""
    return {ACCEL, GYRO} <= {quantity_of(file.stem) for file in _list_tables(path)}


def read_folder_parts(path: Path, request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads the forces and rates of all tables in a folder; those of one sensor have the same sensor name.

    Gravity in a table of its own is added to forces without it, and the sign of an iPhone's forces is corrected; both
    are reported.

    Args:
        path: The folder.
        request: Columns and rate that the user gives.
        notes: Collects what was assumed.

    Raises:
        StrideTwinError: A table cannot be read, or all forces are without gravity.
    """
    parts: list[TablePart] = []
    for file in _list_tables(path):
        sensor = _WORDS.sub("", file.stem)  # what the name of the file says beside the quantity
        for part in read_text_table(file, request, notes):
            name = part.sensor or sensor
            # of two tables with the same quantity of one sensor the first counts
            if all((known.sensor, known.quantity) != (name, part.quantity) for known in parts):
                parts.append(replace(part, sensor=name))
    if (path / _GRAVITY).is_file() and not (path / _TOTAL).is_file():
        (gravity,) = read_text_table(path / _GRAVITY, request, notes, ACCEL)
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
    return parts


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
        rows = list(csv.reader(read_lines(file, "utf-8-sig")))
    except csv.Error as error:
        raise StrideTwinError(f"{file}: cannot be read: {error}") from error
    properties = dict(zip(*rows[:2])) if len(rows) > 1 else {}  # value by name
    is_iphone = properties.get("platform", "").lower() == "ios"
    return is_iphone and properties.get("standardisation", "").lower() != "true"
