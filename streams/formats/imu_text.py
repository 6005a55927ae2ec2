"""Text tables of inertial sensors: CSV of many apps and loggers, Xsens `.txt`, OpenSense `.sto`."""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.imu_columns import (
    AXES,
    OPTION,
    Columns,
    Signal,
    columns_of,
    mapped_columns,
    missing_axis,
)
from stridetwin.streams.formats.units import ACCEL, GYRO, TIME, UNITS, factor_of
from stridetwin.streams.plausible import IMU_RATES_HZ
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

SUFFIXES = (".csv", ".txt", ".sto")
RATE = "--rate"
_TICK_S = 1e-4  # of Xsens' SampleTimeFine
_COUNTERS = {"packetcounter": 2**16, "sampletimefine": 2**32}
_RATE_COMMENT = re.compile(r"//\s*update rate:\s*([0-9.]+)\s*hz", re.IGNORECASE)
_QUANTITIES = (
    (ACCEL, re.compile(r"acc(?:el|_|$)|_acc", re.IGNORECASE)),
    (GYRO, re.compile(r"gyr|angular|rotation_?rate", re.IGNORECASE)),
)


@dataclass(frozen=True, kw_only=True)
class TableRequest:
    """How to read tables whose header leaves something open.

    Attributes:
        columns: Column and unit of `t`, `ax` ... `gz`, see `imu_columns.mapped_columns`; empty: by the header.
        rate_hz: Rate of a table without stamps; None: from the table.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
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


def read_text_table(path: Path, request: TableRequest, notes: Notes, quantity: str | None = None) -> list[Part]:
    """The parts of a table `.csv`, `.txt` or `.sto`.

    Args:
        path: The table.
        request: See `TableRequest`.
        notes: Collects what was assumed.
        quantity: What columns named `x`, `y`, `z` alone are: `accel`, `gyro` or ""; None: what the file's name implies.

    Raises:
        StrideTwinError: The table cannot be read, or lacks stamps, an axis or a unit; names file and column.
    """
    quantity = quantity_of(path.stem) if quantity is None else quantity
    text = lines(path, "utf-8-sig")
    if path.suffix == ".sto":
        return _vectors(path, text, quantity)
    try:
        return _scalars(path, text, request, notes, quantity)
    except csv.Error as error:
        raise StrideTwinError(f"{path}: cannot be read: {error}") from error


def _scalars(path: Path, text: Iterator[str], request: TableRequest, notes: Notes, quantity: str) -> list[Part]:
    comments: list[str] = []
    first = ""
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
        sensors, header = header, [cell.strip() for cell in head]  # gaitmap: sensor, axis
        head = next(rows, None)
    if request.columns:
        columns = mapped_columns(path, header, request.columns)
    else:
        columns = columns_of(path, header, sensors, quantity)
    if not columns.signals:
        raise missing_axis(path, quantity or ACCEL, AXES[0], header)
    counter, rate_hz = _counter(columns, comments, request)
    at = [c for c in (columns.time if counter is None else counter,) if c is not None and request.rate_hz is None]
    wanted = [*at, *(index for signal in columns.signals for index in signal.at)]
    body = chain([head], rows) if head is not None else rows
    table = _numbers(path, header, body, wanted, decimal="," if separator == ";" else "")
    if at:
        t = _unwrapped(table[:, 0], header[at[0]]) / rate_hz if counter is not None else table[:, 0]
        if counter is None:
            t = t * _time_factor(path, columns, t, notes)
    elif request.rate_hz is not None:
        t = np.arange(len(table)) / request.rate_hz
    else:
        there = ", ".join(header) or "none"
        raise ConfigError(path, "t", None, f"a column of time; the table has {there}; without one: {RATE} HZ")
    return _parts(path, columns.signals, t, table[:, len(at) :])


def _parts(path: Path, signals: Sequence[Signal], t: Array, values: Array) -> list[Part]:
    return [
        Part(file=path, sensor=s.sensor, quantity=s.quantity, t=t, values=s.factor * values[:, 3 * k : 3 * k + 3])
        for k, s in enumerate(signals)
    ]


def quantity_of(name: str) -> str:
    """Quantity that the name of a file or a folder implies, `accel` or `gyro`; "" for none or both."""
    found = [quantity for quantity, pattern in _QUANTITIES if pattern.search(name)]
    return found[0] if len(found) == 1 else ""


def _counter(columns: Columns, comments: Sequence[str], request: TableRequest) -> tuple[int | None, float]:
    """Index of Xsens' counter of packets or ticks, and its rate; None for a table with plain stamps."""
    names = [name.strip().lower() for name in columns.names]
    given = next((float(m[1]) for line in comments if (m := _RATE_COMMENT.match(line))), 0.0)
    if request.columns or columns.time is not None:
        return None, 0.0
    if "packetcounter" in names and given > 0:
        return names.index("packetcounter"), given
    return (names.index("sampletimefine"), 1 / _TICK_S) if "sampletimefine" in names else (None, 0.0)


def _unwrapped(counts: Array, name: str) -> Array:
    """A counter without its overflows, from 0."""
    size = _COUNTERS[name.strip().lower()]
    steps = np.diff(counts)
    steps = np.where(steps < -size / 2, steps + size, steps)
    return np.concatenate(([0.0], np.cumsum(steps)))


def _time_factor(path: Path, columns: Columns, t: Array, notes: Notes) -> float:
    """Factor of the stamps to s; without a unit, the only one that gives a rate of an IMU."""
    if columns.time_unit:
        return factor_of(TIME, columns.time_unit)
    assert columns.time is not None
    steps = np.diff(t)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else math.nan
    name = columns.names[columns.time]
    if name in ("", "axis") and np.all(steps == 1):
        raise ConfigError(path, "column 1", "numbers of rows", f"stamps in s, or {RATE} HZ")
    for unit, factor in UNITS[TIME].items():
        if IMU_RATES_HZ[0] < 1 / (factor * step) < IMU_RATES_HZ[1]:
            notes.warn(f"{path.name}: {name or 'time'} has no unit; {unit} assumed: {1 / (factor * step):.4g} Hz")
            return factor
    raise ConfigError(path, f"{name}, unit", None, f"a unit of time in brackets, as in {OPTION} t={name}[ms]")


def _numbers(
    path: Path, header: Sequence[str], rows: Iterable[list[str]], wanted: Sequence[int], decimal: str
) -> Array:
    """(N, K) numbers of some columns."""
    table, row = array("d"), 0
    for line in rows:
        if not any(line):
            continue
        row += 1
        for at in wanted:
            try:
                table.append(float(line[at].replace(decimal, ".") if decimal else line[at]))
            except (ValueError, IndexError):
                value = line[at] if at < len(line) else None
                raise ConfigError(path, f"{header[at]}, row {row}", value, "a number") from None
    return np.array(table).reshape(row, len(wanted))


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _vectors(path: Path, text: Iterator[str], quantity: str) -> list[Part]:
    """A table of OpenSim with vectors `x,y,z` in its cells, one column per sensor."""
    keys: dict[str, str] = {}
    for line in text:
        if line.strip().lower() == "endheader":
            break
        key, _, value = line.partition("=")
        keys[key.strip().lower()] = value.strip()
    kind = keys.get("datatype", "double")
    if kind.lower() != "vec3" or not quantity:
        valid = "Vec3, in files named ...linear_accelerations.sto and ...angular_velocity.sto"
        raise ConfigError(path, "DataType", kind, f"{valid}; orientations alone are no IMU")
    header = next(text, "").split()
    vectors: dict[str, list[list[float]]] = {name: [] for name in header[1:]}
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
        Part(file=path, sensor=name, quantity=quantity, t=stamps, values=np.array(rows).reshape(-1, len(AXES)))
        for name, rows in vectors.items()
    ]
