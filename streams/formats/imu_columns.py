"""Which columns of a table are time, specific force and angular rate, and in which units, by the table's header.

Units in the header count before those that are usual for a kind of file (`Dialect`). A mapping names the columns of
any other table: `t=Time[ms],ax=Acc X[g],...,gx=Gyr X[deg/s]`. Units are read in any usual spelling.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

TIME, ACCEL, GYRO = "time", "accel", "gyro"
UNITS: Mapping[str, Mapping[str, float]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9},
    ACCEL: {"m/s²": 1.0, "g": STANDARD_GRAVITY_MPS2, "mg": STANDARD_GRAVITY_MPS2 * 1e-3},
    GYRO: {"rad/s": 1.0, "deg/s": math.pi / 180, "mdeg/s": math.pi / 180e3},
}
"""Factor to s, m/s² and rad/s of each unit, by quantity."""
_SPELLINGS = {
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "millisecond": "ms",
    "milliseconds": "ms",
    "us": "µs",
    "usec": "µs",
    "microseconds": "µs",
    "nanoseconds": "ns",
    "nsec": "ns",
    "m/s^2": "m/s²",
    "m/s2": "m/s²",
    "m/s/s": "m/s²",
    "ms^-2": "m/s²",
    "ms⁻²": "m/s²",
    "ms-2": "m/s²",
    "m.s-2": "m/s²",
    "ms^-²": "m/s²",
    "m/sec^2": "m/s²",
    "m*s^-2": "m/s²",
    "milli-g": "mg",
    "gees": "g",
    "rad/sec": "rad/s",
    "rads^-1": "rad/s",
    "rads-1": "rad/s",
    "rps": "rad/s",
    "°/s": "deg/s",
    "º/s": "deg/s",
    "degree/s": "deg/s",
    "degrees/s": "deg/s",
    "deg/sec": "deg/s",
    "dps": "deg/s",
    "degrees/second": "deg/s",
    "mdps": "mdeg/s",
}
"""Name of a unit in `UNITS`, by another spelling in lower case."""
AXES = "xyz"
OPTION = "--columns"
"""Option of the command line that names the columns, and an example of its text, for errors."""
EXAMPLE = "t=Time[ms],ax=Acc X[g],...,gx=Gyr X[deg/s],..."
_NAMES = {ACCEL: ("accel_{}", "a{}", "acc_{}"), GYRO: ("gyro_{}", "g{}", "w{}")}
"""Names of the column of an axis that errors suggest."""


Dialect = Mapping[str, str]
"""The units by quantity that a kind of file leaves out of its header. Without one for time it is found from the rate;
one for force or rate must then be in the header."""
OURS: Dialect = {TIME: "s", ACCEL: "m/s²", GYRO: "rad/s"}
XSENS: Dialect = {ACCEL: "m/s²", GYRO: "rad/s"}
SENSOR_LOGGER: Dialect = {TIME: "s", ACCEL: "m/s²", GYRO: "rad/s"}
MOVESENSE: Dialect = {TIME: "ms", ACCEL: "m/s²", GYRO: "deg/s"}
GAITMAP: Dialect = {ACCEL: "m/s²", GYRO: "deg/s"}
UNKNOWN: Dialect = {}


@dataclass(frozen=True, kw_only=True)
class Signal:
    """Three columns of a table.

    Attributes:
        sensor: Name of its sensor; "" in a table of one.
        quantity: `accel` or `gyro`.
        at: Indices of x, y and z.
        factor: From the table's unit to m/s² or rad/s.
    """

    sensor: str
    quantity: str
    at: tuple[int, int, int]
    factor: float


@dataclass(frozen=True, kw_only=True)
class Columns:
    """The columns of a table.

    Attributes:
        names: Header of every column.
        time: Index of the stamps; None in a table without.
        time_unit: Unit of the stamps; "" is found from the rate.
        signals: Forces and rates, by sensor.
    """

    names: tuple[str, ...]
    time: int | None
    time_unit: str
    signals: tuple[Signal, ...] = field(default_factory=tuple)


# names of columns, as `_split_unit` gives them: of times, the first of which counts; of an axis of each quantity; of an
# axis of a quantity that the name leaves open; and of forces without gravity
_TIME = ("t", "seconds_elapsed", "elapsed", "time", "timestamp", "time_stamp", "timestamps", "epoc", "epoch")
_PREFIX = {
    ACCEL: re.compile(r"(?:accel|accelerometer|acceleration|acc|a|total_acceleration)_?([xyz])(?:_axis)?"),
    GYRO: re.compile(
        r"(?:gyro|gyroscope|gyr|g|w|omega|angular_velocity|angular_rate|rotation_rate|alpha)_?([xyz])(?:_axis)?"
    ),
}
_BARE = re.compile(r"([xyz])(?:_axis)?")
_WITHOUT_GRAVITY = re.compile(r"(?:free|linear|lin|user)_?acc|^freeacc|^linear")
_UNIT = re.compile(r"(.*?)\s*[(\[]([^()\[\]]*)[)\]]\s*")
"""A header's cell with a unit in brackets, of either form: the name and the unit."""


def find_columns(path: Path, header: Sequence[str], sensors: Sequence[str] = (), quantity: str = "") -> Columns:
    """Finds the columns of time, force and rate of a table by its header.

    Args:
        path: Named by errors.
        header: Name, and unit in brackets, of each column.
        sensors: Sensor of each column, of a header with two rows.
        quantity: What bare columns `x`, `y`, `z` are, as the file's name implies: `accel`, `gyro` or "".

    Returns:
        Indices and factors to SI; no signals if no column is a force or a rate.

    Raises:
        ConfigError: An axis or a unit is missing.
    """
    named = [_split_unit(cell) for cell in header]  # name and unit of each column
    names = [name for name, _ in named]
    dialect = _find_dialect(names, bool(sensors))  # units that the header leaves out
    sensor_of_column = list(sensors) or [""] * len(names)
    # index of the column, by sensor and quantity and then by axis
    axes_by_signal: dict[tuple[str, str], dict[str, int]] = {}
    for at, (name, unit) in enumerate(named):
        kind, axis = _classify_column(name, unit, quantity, names)
        if kind:  # of two columns of one axis the first counts
            axes_by_signal.setdefault((sensor_of_column[at], kind), {}).setdefault(axis, at)
    signals = tuple(
        _to_signal(path, header, sensor, kind, axes, named, dialect) for (sensor, kind), axes in axes_by_signal.items()
    )
    time = next((names.index(name) for name in _TIME if name in names), None)  # index of the column
    if time is None and sensors and names[0] in ("", "axis"):  # gaitmap's table has times in its unnamed first column
        time = 0
    known = unit_of(named[time][1]) if time is not None else None  # quantity and unit in the header
    time_unit = known[1] if known is not None and known[0] == TIME else dialect.get(TIME, "")
    return Columns(names=tuple(header), time=time, time_unit=time_unit, signals=signals)


def map_columns(path: Path, header: Sequence[str], mapping: Mapping[str, str]) -> Columns:
    """Finds the columns that the user's mapping names, for a table whose header is not understood.

    Args:
        path: Named by errors.
        header: Names of the columns; units in brackets may be left out in the mapping.
        mapping: Column and unit in brackets, such as `Acc X[g]`, of `t` (may be missing), `ax` ... `gz`.

    Raises:
        ConfigError: An unknown column or unit, or only some axes of a quantity; names what is valid.
    """
    places: dict[str, int] = {}  # index of the column, by `t` and `ax` ... `gz`
    units: dict[str, str] = {}  # its unit in the usual spelling, by the same keys
    bare_header = [_UNIT.sub(lambda m: m[1], cell).strip() for cell in header]  # names without units
    for key, text in mapping.items():
        quantity = TIME if key == "t" else ACCEL if key[0] == "a" else GYRO
        matched = _UNIT.fullmatch(text)
        name, unit = (matched[1], matched[2]) if matched else (text, "")
        # the header as it is is searched first, then that without units; each for the whole text, then for its name
        candidates = ((names, wanted) for names in (list(header), bare_header) for wanted in (text, name))
        at = next((names.index(wanted) for names, wanted in candidates if wanted in names), None)
        if at is None:
            raise ConfigError(path, f"{OPTION} {key}", name, f"one of the columns {', '.join(header)}")
        header_unit = _UNIT.fullmatch(header[at])
        known = unit_of(unit or (header_unit[2] if header_unit else ""))  # quantity and unit
        if known is None or known[0] != quantity:
            raise ConfigError(
                path,
                f"{OPTION} {key}, unit",
                unit or None,
                f"one of {', '.join(UNITS[quantity])} in [], as in {EXAMPLE}",
            )
        places[key], units[key] = at, known[1]
    signals = []
    for quantity, letter in ((ACCEL, "a"), (GYRO, "g")):
        keys = [letter + axis for axis in AXES]
        if any(key in places for key in keys):
            if lacking := [key for key in keys if key not in places]:
                raise ConfigError(path, OPTION, ",".join(mapping), f"also {lacking[0]}, as in {EXAMPLE}")
            x, y, z = (places[key] for key in keys)
            factor = UNITS[quantity][units[keys[0]]]  # the unit of x is that of y and z
            signals.append(Signal(sensor="", quantity=quantity, at=(x, y, z), factor=factor))
    return Columns(names=tuple(header), time=places.get("t"), time_unit=units.get("t", ""), signals=tuple(signals))


def parse_mapping(text: str) -> dict[str, str]:
    """The mapping in the text of the option `--columns`, such as `t=Time[ms],ax=Acc X[g]`.

    Raises:
        ConfigError: The text has another form, or a key other than `t` and `ax` to `gz`.
    """
    mapping = {}
    for part in text.split(","):
        key, equals, value = (word.strip() for word in part.partition("="))
        if not (equals and value) or key not in ("t", *(q + a for q in "ag" for a in AXES)):
            raise ConfigError(
                "import", OPTION, part, f"t, ax, ay, az, gx, gy, gz with a column and its unit: {EXAMPLE}"
            )
        mapping[key] = value
    return mapping


def unit_of(text: str) -> tuple[str, str] | None:
    """Quantity and usual spelling of a unit, such as (`accel`, `m/s²`) for `m/s^2`; None for an unknown one.

    Args:
        text: As in a header, of any case but for `G`, which is also gauss.
    """
    spelling = text.strip().replace("μ", "µ").replace(" ", "").replace("**", "^")  # Greek μ becomes the micro sign µ
    if spelling == "G":
        return None
    unit = _SPELLINGS.get(spelling.lower(), spelling.lower())
    return next(((quantity, unit) for quantity, units in UNITS.items() if unit in units), None)


def missing_axis_error(path: Path, quantity: str, axis: str, header: Sequence[str]) -> ConfigError:
    """The error to raise about a table without an axis of a quantity; it suggests names of the column.

    Args:
        path: The table.
        quantity: `accel` or `gyro`.
        axis: `x`, `y` or `z`.
        header: Names of the columns that the table has.
    """
    names = [name.format(axis) for name in _NAMES[quantity]]
    columns = ", ".join(header) or "none"
    valid = f"a column {' or '.join(names)}; the table has {columns}; other names: {OPTION} {EXAMPLE}"
    return ConfigError(path, names[0], None, valid)


def _split_unit(cell: str) -> tuple[str, str]:
    """Name of a header's cell in lower case with `_` between its words, and the unit in brackets ("" without one)."""
    matched = _UNIT.fullmatch(cell)
    name, unit = (matched[1], matched[2]) if matched else (cell, "")
    return re.sub(r"[^a-z0-9]+", "_", name.strip().lower()).strip("_"), unit


def _find_dialect(names: Sequence[str], has_sensors: bool) -> Dialect:
    """The units that a kind of file leaves out of its header, by the column names that are typical of the kind."""
    if has_sensors:
        return GAITMAP
    if "sampletimefine" in names or "packetcounter" in names:
        return XSENS
    if "seconds_elapsed" in names:
        return SENSOR_LOGGER
    if names[:4] == ["timestamp", "x", "y", "z"]:
        return MOVESENSE
    return OURS if "t" in names else UNKNOWN


def _classify_column(name: str, unit: str, quantity: str, names: Sequence[str]) -> tuple[str, str]:
    """Quantity (`accel` or `gyro`) and axis of a column; two empty texts for any other, such as force without gravity.

    Args:
        name: Name of the column, as `_split_unit` gives it.
        unit: Unit in its header; "" without one.
        quantity: What bare columns `x`, `y`, `z` are.
        names: Names of all columns.
    """
    known = unit_of(unit)  # quantity and unit; None for an unknown unit
    if _WITHOUT_GRAVITY.search(name):
        return "", ""
    for kind, pattern in _PREFIX.items():
        if (matched := pattern.fullmatch(name)) and (known is None or known[0] == kind):
            return kind, matched[1]
    if matched := _BARE.fullmatch(name):
        if known is not None and known[0] in (ACCEL, GYRO):  # the unit tells the quantity
            return known[0], matched[1]
        if not unit and (quantity or "gx" in names):  # Movesense: x, y, z, gx, gy, gz
            return quantity or ACCEL, matched[1]
    return "", ""


def _to_signal(
    path: Path,
    header: Sequence[str],
    sensor: str,
    kind: str,
    axes: Mapping[str, int],
    named: Sequence[tuple[str, str]],
    dialect: Dialect,
) -> Signal:
    """Three columns as a signal, with the factor of their common unit to SI.

    Args:
        path: Named by errors.
        header: Cells of the header.
        sensor: Name of the sensor; "" in a table of one.
        kind: `accel` or `gyro`.
        axes: Index of the column by axis, `x`, `y` and `z`.
        named: Name and unit of each column, as `_split_unit` gives them.
        dialect: Units that the header leaves out.

    Raises:
        ConfigError: An axis is missing, the units differ, or there is none.
    """
    if lacking := [axis for axis in AXES if axis not in axes]:
        raise missing_axis_error(path, kind, lacking[0], header)
    x, y, z = (axes[axis] for axis in AXES)
    known = {unit_of(named[at][1]) for at in (x, y, z)}  # quantity and unit of each axis; None for an unknown unit
    units = {unit[1] for unit in known if unit is not None} or {dialect.get(kind, "")}
    if len(units) != 1 or not (unit := units.pop()):  # different units, or none
        valid = f"a unit in brackets ({', '.join(UNITS[kind])}), or {OPTION} {EXAMPLE}"
        raise ConfigError(path, f"header, unit of {header[x]}", named[x][1] or None, valid)
    return Signal(sensor=sensor, quantity=kind, at=(x, y, z), factor=UNITS[kind][unit])
