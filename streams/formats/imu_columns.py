"""Which columns of a table are time, specific force and angular rate, and in which units, by the table's header.

Units in the header count before those that are usual for a kind of file (`Dialect`). A mapping names the columns of
any other table: `t=Time[ms],ax=Acc X[g],...,gx=Gyr X[deg/s]`, or numbers them from 1: `t=1[s],ax=2[g],...`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.column_names import (
    AXES,
    ColumnName,
    is_counter_name,
    is_time_name,
    is_without_gravity,
    parse_column,
    split_unit,
    time_rank,
)
from stridetwin.streams.formats.imu_stamps import is_stamp
from stridetwin.streams.formats.imu_units import ACCEL, COUNTS, GYRO, TIME, UNITS, factor_of, spell_unit, unit_of
from stridetwin.streams.formats.table_head import is_count, is_number, is_plain_number
from stridetwin.streams.segments import side_of

OPTION = "--columns"
"""Option of the command line that names the columns."""
EXAMPLE = "t=Time[ms],ax=Acc X[g],...,gx=Gyr X[deg/s],..."
"""Example of its text, for errors."""
NUMBERED = '"t=1[s],ax=2[m/s^2],ay=3[m/s^2],az=4[m/s^2],gx=5[rad/s],gy=6[rad/s],gz=7[rad/s]"'
"""Example of its text for a table without names of columns."""
KIND = "kind"
"""Key of the mapping for the column that tells whether a row has forces or rates."""
KIND_MEANS = "the column that names the sensor of each row"
"""What errors say of this key."""
_MOST_STEPS = 20.0
"""Largest step of stamps, in mean steps."""
_NUMBER_AT_END = re.compile(r"(.*?)_?(\d)")
"""The number of an axis at the end of a name."""
_NAMES = {ACCEL: ("accel_{}", "a{}", "acc_{}"), GYRO: ("gyro_{}", "g{}", "w{}")}
"""Names of the column of an axis that errors suggest."""


Dialect = Mapping[str, str]
"""The units by quantity that a kind of file leaves out of its header. Without one for time it is found from the rate;
one for force or rate must then be in the header."""
OURS: Dialect = {TIME: "s", ACCEL: "m/s²", GYRO: "rad/s"}
XSENS: Dialect = {ACCEL: "m/s²", GYRO: "rad/s"}
SENSOR_LOGGER: Dialect = {TIME: "s", ACCEL: "m/s²", GYRO: "rad/s"}
PX4: Dialect = {TIME: "µs", ACCEL: "m/s²", GYRO: "rad/s"}
MOVESENSE: Dialect = {TIME: "ms", ACCEL: "m/s²", GYRO: "deg/s"}
GAITMAP: Dialect = {ACCEL: "m/s²", GYRO: "deg/s"}
XSENS_DOT: Dialect = {ACCEL: "m/s²", GYRO: "deg/s"}
PICOQUAKE: Dialect = {ACCEL: "g", GYRO: "deg/s"}
PHYSICS_TOOLBOX: Dialect = {ACCEL: "g", GYRO: "rad/s"}
ROS: Dialect = {ACCEL: "m/s²", GYRO: "rad/s"}
ANDROID: Dialect = {TIME: "ns", ACCEL: "m/s²", GYRO: "rad/s"}
UNKNOWN: Dialect = {}
"""Dialects by the maker or program whose files they are; `UNKNOWN` is that of all other files."""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """Three columns of a table.

    Attributes:
        sensor: Name of its sensor; "" in a table of one.
        quantity: `accel` or `gyro`.
        at: Indices of x, y and z.
        factor: From the table's unit to m/s² or rad/s.
        time: Index of stamps of its own; None for those of the table.
    """

    sensor: str
    quantity: str
    at: tuple[int, int, int]
    factor: float
    time: int | None = None


@dataclass(frozen=True, kw_only=True)
class Columns:
    """The columns of a table.

    Attributes:
        names: Header of every column.
        time: Index of the stamps; None in a table without.
        time_unit: Unit of the stamps; "" is found from the rate.
        signals: Forces and rates, by sensor.
        fraction: Index of the part of a second beside stamps in whole seconds; None without.
        fraction_s: Unit of that part, s.
        of_minute: Whether the stamps are seconds of a minute, beside columns of minutes and hours.
        epoch: Index of stamps since 1970 beside those since the begin of the file; None without.
        epoch_s: Their unit, s.
    """

    names: tuple[str, ...]
    time: int | None
    time_unit: str
    signals: tuple[Signal, ...] = field(default_factory=tuple)
    fraction: int | None = None
    fraction_s: float = 0.0
    of_minute: bool = False
    epoch: int | None = None
    epoch_s: float = 0.0


def find_columns(
    path: Path,
    header: Sequence[str],
    sensors: Sequence[str] = (),
    quantity: str = "",
    *,
    units: Sequence[str] = (),
    sample: Sequence[Sequence[str]] = (),
    dialect: Dialect | None = None,
) -> Columns:
    """Finds the columns of time, force and rate of a table by its header.

    Args:
        path: Named by errors.
        header: Name, and unit in brackets or at the end, of each column.
        sensors: Sensor of each column, of a header with two rows.
        quantity: What bare columns `x`, `y`, `z` are, as the file's name implies: `accel`, `gyro` or "".
        units: Unit of each column in a row of its own.
        sample: Cells of some rows, by which a column of time without stamps is left out.
        dialect: Units that the header leaves out; None: by the names.

    Returns:
        Indices and factors to SI; no signals if no column is a force or a rate.

    Raises:
        ConfigError: An axis or a unit is missing.
    """
    named = name_numbered_axes(parse_header(header, units))
    names = [column.name for column in named]
    if dialect is None:
        dialect = _find_dialect(names, bool(sensors))
    axes_by_group = _group_axes(named, list(sensors) or [""] * len(names), quantity)
    seconds = _find_seconds(names)
    time = find_time(named, sample) if seconds is None else seconds
    signals = tuple(
        _to_signal(path, header, sensor, kind, axes, named, dialect, sample)
        for (sensor, kind), axes in _pair_groups(axes_by_group, named).items()
    )
    signals = tuple(replace(signal, time=_find_own_time(signal, named, time, sample)) for signal in signals)
    if time is None and sensors and names[0] in ("", "axis"):  # gaitmap's table has times in its unnamed first column
        time = 0
    time_text = "s" if seconds is not None else named[time].unit if time is not None else ""
    time_unit = spell_unit(time_text, TIME) or dialect.get(TIME, "")
    epoch, epoch_s = _find_epoch(named, time) if quantity else (None, 0.0)
    columns = Columns(
        names=tuple(header),
        time=time,
        time_unit=time_unit,
        signals=signals,
        of_minute=seconds is not None,
        epoch=epoch,
        epoch_s=epoch_s,
    )
    for second, part, unit_s in _list_split_stamps(named, sample):
        return replace(columns, time=second, time_unit="s", fraction=part, fraction_s=unit_s, of_minute=True)
    return columns


def _group_axes(
    named: Sequence[ColumnName], sensors: Sequence[str], quantity: str
) -> dict[tuple[str, str, str], dict[str, int]]:
    """The columns of forces and rates that belong together; raw ones count only where there are no others.

    Args:
        named: The columns.
        sensors: Sensor of each column by a header with two rows; "" without.
        quantity: What bare columns `x`, `y`, `z` are: `accel`, `gyro` or "".

    Returns:
        Index of the column by axis, by sensor, quantity and what else the name says. Of two columns of one axis the
        first counts.
    """
    axes_by_group: dict[tuple[str, str, str], dict[str, int]] = {}
    for at, column in enumerate(named):
        kind, axis = _classify_column(column, quantity, named)
        if kind:
            group = (sensors[at], kind, f"{column.sensor} raw".strip() if column.is_raw else column.sensor)
            axes_by_group.setdefault(group, {}).setdefault(axis, at)
    for sensor, kind, label in list(axes_by_group):
        if (sensor, kind, label.removesuffix("raw").strip()) in axes_by_group and label.endswith("raw"):
            del axes_by_group[sensor, kind, label]
    return axes_by_group


def _list_split_stamps(
    named: Sequence[ColumnName], sample: Sequence[Sequence[str]]
) -> Iterator[tuple[int, int, float]]:
    """Yields pairs of columns of whole seconds and of the rest, as `stamp.sec` and `stamp.nanosec`.

    Args:
        named: The columns.
        sample: Cells of some rows; the rest is below 1 s in all of them.

    Yields:
        Index of the seconds and of the rest, and the unit of the rest in s.
    """
    stems: dict[tuple[str, str], int] = {}  # index, by the name without the unit and the unit
    for at, column in enumerate(named):
        stem, _, last = column.name.rpartition("_")
        if (unit := spell_unit(last, TIME)) is not None:
            stems.setdefault((stem, unit), at)
        elif (unit := spell_unit(column.unit, TIME)) is not None:
            stems.setdefault((column.name, unit), at)
    for (stem, unit_name), second in stems.items():
        for fine in ("ns", "µs", "ms"):
            part, unit_s = stems.get((stem, fine)), UNITS[TIME][fine]
            if unit_name != "s" or part is None or not sample:
                continue
            cells = [(row[second], row[part]) for row in sample if max(second, part) < len(row)]
            if all(is_count(a) and is_count(b) and int(b) * unit_s < 1.0 for a, b in cells):
                yield second, part, unit_s


def parse_header(header: Sequence[str], units: Sequence[str] = ()) -> list[ColumnName]:
    """What each column is by its name and the unit in a row of its own.

    `linear_acceleration` counts as a force only beside an `angular_velocity`, as in the IMU messages of ROS.
    """
    in_rows = [*units, *[""] * (len(header) - len(units))]
    is_ros = any("angular_velocity" in cell for cell in header) and not any("(" in cell for cell in header)
    return [parse_column(cell, unit, with_linear=is_ros) for cell, unit in zip(header, in_rows)]


def find_time(named: Sequence[ColumnName], sample: Sequence[Sequence[str]] = ()) -> int | None:
    """Index of the column of time; None without one.

    Args:
        named: The columns.
        sample: Cells of some rows; a column whose cells are no stamps in any of them is left out.
    """
    places = [at for at, column in enumerate(named) if is_stamp_column(column)]
    usable = [at for at in places if not sample or any(at < len(row) and is_stamp(row[at]) for row in sample)]
    numeric = [at for at in usable if not sample or any(at < len(row) and is_number(row[at]) for row in sample)]
    best = min(numeric or usable or places, key=lambda at: time_rank(named[at].name), default=None)
    return _find_rising_column(named, sample) if best is None else best


def is_stamp_column(column: ColumnName) -> bool:
    """Whether a column has stamps by its name, or as LabVIEW's and Delsys' `X [s]` by its unit."""
    is_abscissa = column.name in ("x", "x_value") and spell_unit(column.unit, TIME) is not None
    return is_abscissa or (is_time_name(column.name) and not column.axis)


def _find_seconds(names: Sequence[str]) -> int | None:
    """Index of the seconds of a minute in a table with columns of minutes and seconds, by their names; None without."""
    if not {"minute", "minutes", "min"} & set(names):
        return None
    return next((names.index(name) for name in ("second", "seconds", "sec") if name in names), None)


def _find_epoch(named: Sequence[ColumnName], time: int | None) -> tuple[int | None, float]:
    """Index and unit in s of stamps since 1970 beside those since the begin of the file, as MetaMotion's.

    Tables of force and rate that begin at different times have only these in common.

    Args:
        named: The columns.
        time: Index of the stamps that are used.
    """
    if time is None or named[time].name != "elapsed":
        return None, 0.0
    for at, column in enumerate(named):
        unit = spell_unit(column.unit, TIME)
        if column.name in ("epoc", "epoch") and unit is not None:
            return at, UNITS[TIME][unit]
    return None, 0.0


def _find_rising_column(named: Sequence[ColumnName], sample: Sequence[Sequence[str]]) -> int | None:
    """Index of a column of another name with stamps: with a unit of time, or the first one if it rises as stamps do.

    Args:
        named: The columns.
        sample: Cells of some rows.
    """
    for at, column in enumerate(named):
        if spell_unit(column.unit, TIME) is not None and not column.axis and _holds_stamps(sample, at):
            return at
    if not named or named[0].quantity or is_counter_name(named[0].name):
        return None
    is_index = all(is_count(row[0]) for row in sample if row)
    return 0 if not is_index and _holds_stamps(sample, 0) else None


def _holds_stamps(sample: Sequence[Sequence[str]], at: int) -> bool:
    """Whether the cells of a column are dates or times of day, or numbers that rise as stamps do."""
    cells = [row[at] for row in sample if at < len(row)]
    is_clock = len(cells) > 1 and all(is_stamp(cell) and not is_number(cell) for cell in cells)
    return is_clock or _rises(sample, at)


def _rises(sample: Sequence[Sequence[str]], at: int) -> bool:
    """Whether the numbers of a column rise from row to row by steps of about one size."""
    numbers = [float(row[at].replace(",", ".")) for row in sample if at < len(row) and is_plain_number(row[at])]
    steps = [after - before for before, after in pairwise(numbers)]
    return len(steps) > 1 and min(steps) >= 0 < max(steps) <= _MOST_STEPS * sum(steps) / len(steps)


def _find_own_time(
    signal: Signal, named: Sequence[ColumnName], time: int | None, sample: Sequence[Sequence[str]]
) -> int | None:
    """Index of the stamps that belong to a signal alone, as `gyr_time`, `left_time` or Delsys' pairs; None without.

    Args:
        signal: The signal.
        named: The columns.
        time: Index of the stamps of the table.
        sample: Cells of some rows.
    """
    first = min(signal.at)
    places = [at for at, column in enumerate(named) if is_stamp_column(column) and (not sample or _rises(sample, at))]
    if time not in places or len(places) < 2:
        return None
    sensor = signal.sensor or named[first].sensor
    of_quantity = [at for at in places if named[at].quantity == signal.quantity]
    of_sensor = [at for at in places if sensor and f"_{sensor}_" in f"_{named[at].name}_"]
    alike = [at for at in places if at < first and named[at].name == named[time].name]
    nearest = next((at for group in (of_quantity, of_sensor, alike[::-1]) for at in group), time)
    return None if nearest == time else nearest


def name_numbered_axes(named: Sequence[ColumnName]) -> list[ColumnName]:
    """The columns, with axes in place of numbers of three that belong together, as `acc_1` to `acc_3`."""
    families: dict[tuple[str, str], dict[int, int]] = {}  # index of the column by number, by quantity and sensor
    for at, column in enumerate(named):
        matched = _NUMBER_AT_END.fullmatch(column.sensor)
        if column.quantity and not column.axis and matched is not None:
            families.setdefault((column.quantity, matched[1]), {}).setdefault(int(matched[2]), at)
    result = list(named)
    for (_, label), places in families.items():
        if sorted(places) not in ([0, 1, 2], [1, 2, 3]):
            continue
        for axis, number in zip(AXES, sorted(places)):
            column, unit = named[places[number]], label.replace("_", "/")
            has_unit = not column.unit and unit_of(unit) is not None
            result[places[number]] = replace(
                column, axis=axis, sensor="" if has_unit else label, unit=unit if has_unit else column.unit
            )
    return result


def map_columns(path: Path, header: Sequence[str], mapping: Mapping[str, str], units: Sequence[str] = ()) -> Columns:
    """Finds the columns that the user's mapping names, for a table whose header is not understood.

    Args:
        path: Named by errors.
        header: Names of the columns; units in brackets may be left out in the mapping.
        mapping: Column and unit in brackets, such as `Acc X[g]` or `2[g]`, of `t` (may be missing), `ax` ... `gz`; a
            number that is no name counts columns from 1.
        units: Unit of each column in a row of its own.

    Raises:
        ConfigError: An unknown column or unit, or only some axes of a quantity; names what is valid.
    """
    places: dict[str, int] = {}  # index of the column, by `t` and `ax` ... `gz`
    factors: dict[str, float] = {}  # from its unit to SI, by the same keys
    time_unit = ""
    for key, text in mapping.items():
        if key == KIND:
            continue
        quantity = TIME if key == "t" else ACCEL if key[0] == "a" else GYRO
        matched = _UNIT.fullmatch(text)
        unit = matched[2] if matched else ""
        at = find_named_column(path, header, key, text)
        row_unit = units[at] if at < len(units) else ""
        places[key], text_unit = at, unit or row_unit or parse_column(header[at]).unit
        factor = factor_of(text_unit, quantity)
        if factor is None and (quantity != TIME or unit):  # stamps need no unit: dates, and those whose rate tells it
            scaled = "" if quantity == TIME else ", of raw counts with their number per unit as [g/16384]"
            valid = f"one of {', '.join(UNITS[quantity])} in []{scaled}, as in {EXAMPLE}"
            raise ConfigError(path, f"{OPTION} {key}, unit", unit or None, valid)
        factors[key] = factor or 0.0
        if quantity == TIME:
            time_unit = spell_unit(text_unit, TIME) or ""
    signals = []
    for quantity, letter in ((ACCEL, "a"), (GYRO, "g")):
        keys = [letter + axis for axis in AXES]
        if any(key in places for key in keys):
            if lacking := [key for key in keys if key not in places]:
                raise ConfigError(path, OPTION, ",".join(mapping), f"also {lacking[0]}, as in {EXAMPLE}")
            x, y, z = (places[key] for key in keys)
            if len({factors[key] for key in keys}) > 1:
                different = ", ".join(f"{key}={mapping[key]}" for key in keys)
                raise ConfigError(path, OPTION, different, f"one unit of {', '.join(keys)}")
            signals.append(Signal(sensor="", quantity=quantity, at=(x, y, z), factor=factors[keys[0]]))
    return Columns(names=tuple(header), time=places.get("t"), time_unit=time_unit, signals=tuple(signals))


def find_named_column(path: Path, header: Sequence[str], key: str, text: str) -> int:
    """Index of the column that a text of the mapping names.

    Args:
        path: Named by errors.
        header: Names of the columns.
        key: Key of the text in the mapping.
        text: Name or number from 1, and perhaps a unit in brackets.

    Raises:
        ConfigError: The table has no such column.
    """
    matched = _UNIT.fullmatch(text)
    name = matched[1] if matched else text
    at = _find_column(header, text, name)
    if at is None:
        valid = f"one of the columns {', '.join(header)}, or its number from 1 to {len(header)}"
        raise ConfigError(path, f"{OPTION} {key}", name, valid)
    return at


def _find_column(header: Sequence[str], text: str, name: str) -> int | None:
    """Index of the column of a text of the mapping; None without one.

    The header as it is is searched first, then that without units; each for the whole text, then for its name. At last
    a number counts columns from 1.
    """
    bare_header = [split_unit(cell)[0] for cell in header]
    spellings = ((names, spelling) for names in (list(header), bare_header) for spelling in (text, name))
    at = next((names.index(spelling) for names, spelling in spellings if spelling in names), None)
    if at is None and is_count(name) and 1 <= int(name) <= len(header):
        at = int(name) - 1
    return at


def parse_mapping(text: str) -> dict[str, str]:
    """The mapping in the text of the option `--columns`, such as `t=Time[ms],ax=Acc X[g]`.

    Raises:
        ConfigError: The text has another form, or a key other than `t` and `ax` to `gz`.
    """
    mapping = {}
    for part in text.split(","):
        key, equals, value = (word.strip() for word in part.partition("="))
        if not (equals and value) or key not in ("t", KIND, *(q + a for q in "ag" for a in AXES)):
            valid = f"t, ax, ay, az, gx, gy, gz with a column and its unit: {EXAMPLE}; {KIND} with {KIND_MEANS}"
            raise ConfigError("import", OPTION, part, valid)
        mapping[key] = value
    return mapping


def find_force_without_gravity(header: Sequence[str]) -> str:
    """Name of the first column of a force without gravity, such as `FreeAcc_X`; "" for none."""
    return next((cell for cell in header if is_without_gravity(cell)), "")


_INCREMENT = re.compile(
    r"(?:d[qv][\W_]?(?:[wxyz]|[0-3])|velinc|oriinc|delta[\W_]?(?:v|theta|angle|velocity|q)).*", re.IGNORECASE
)
"""Names of changes of velocity and attitude from sample to sample."""


def find_increment(header: Sequence[str]) -> str:
    """Name of the first column of a change of velocity or attitude from sample to sample; "" for none."""
    return next((cell for cell in header if _INCREMENT.fullmatch(cell.strip())), "")


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
    increment = find_increment(header)
    advice = (
        f"increments as {increment} are not read: export accelerations and angular velocities; " if increment else ""
    )
    valid = f"a column {' or '.join(names)}; {advice}the table has {columns}; other names: {OPTION} {EXAMPLE}"
    return ConfigError(path, names[0], None, valid)


_UNIT = re.compile(r"(.*?)\s*[(\[]([^()\[\]]*)[)\]]\s*")
"""A text of the mapping with a unit in brackets of either form: the name and the unit."""


def _find_dialect(names: Sequence[str], has_sensors: bool) -> Dialect:
    """The units that a kind of file leaves out of its header, by the column names that are typical of the kind."""
    joined = [name.replace("_", "") for name in names]
    if has_sensors:
        return GAITMAP
    if "gyro_rad_0" in names:
        return PX4
    if "sampletimefine" in joined or "packetcounter" in joined:
        return XSENS
    if "seconds_elapsed" in names:
        return SENSOR_LOGGER
    if names[:4] == ["timestamp", "x", "y", "z"]:
        return MOVESENSE
    if "gfx" in joined:
        return PHYSICS_TOOLBOX
    if any(name.endswith("angular_velocity_x") for name in names):
        return ROS
    return OURS if "t" in names else UNKNOWN


def _classify_column(column: ColumnName, quantity: str, named: Sequence[ColumnName]) -> tuple[str, str]:
    """Quantity (`accel` or `gyro`) and axis of a column; two empty texts for any other, such as force without gravity.

    Args:
        column: The column.
        quantity: What bare columns `x`, `y`, `z` are.
        named: All columns.
    """
    known = unit_of(column.unit)  # quantity and unit; None for an unknown unit
    names = [each.name for each in named]
    if column.quantity and column.axis:
        # Physics Toolbox has forces in g, and beside them those without gravity as ax, ay, az
        is_linear = column.quantity == ACCEL and "g_fx" in names and not re.fullmatch(r"g_f[xyz]", column.name)
        if is_linear or (known is not None and known[0] != column.quantity):
            return "", ""
        return column.quantity, column.axis
    if column.axis and re.fullmatch(r"([xyz])(?:_axis)?|axis_[xyz]", column.name):
        if known is not None and known[0] in (ACCEL, GYRO):  # the unit tells the quantity
            return known[0], column.axis
        if not column.unit and (quantity or "gx" in names):  # Movesense: x, y, z, gx, gy, gz
            return quantity or ACCEL, column.axis
    return "", ""


def _pair_groups(
    axes_by_group: Mapping[tuple[str, str, str], dict[str, int]], named: Sequence[ColumnName]
) -> dict[tuple[str, str], dict[str, int]]:
    """The columns of the forces and of the rates of each sensor.

    Where names alone tell sensors apart, as `left_acc_x` and `left_gyr_x`, each sensor with both counts, and the only
    one keeps its side. Otherwise the first force and the first rate are those of the only sensor, calibrated ones
    before raw ones.

    Args:
        axes_by_group: Index of the column by axis, by sensor, quantity and what else the name says.
        named: All columns.

    Returns:
        Index of the column by axis, by sensor and quantity.
    """
    result: dict[tuple[str, str], dict[str, int]] = {}
    for sensor in dict.fromkeys(key[0] for key in axes_by_group):
        labels: dict[str, list[str]] = {}  # what else the names say, by quantity: the best first
        for kind in (ACCEL, GYRO):
            groups = {label: axes for (s, k, label), axes in axes_by_group.items() if (s, k) == (sensor, kind)}
            labels[kind] = sorted(groups, key=lambda label: _rank_group(groups[label], named))
        complete = {
            kind: [label for label in labels[kind] if len(axes_by_group[sensor, kind, label]) == len(AXES)]
            for kind in (ACCEL, GYRO)
        }
        common = [label for label in complete[ACCEL] if label in complete[GYRO]]
        for kind in (ACCEL, GYRO):
            if not sensor and (len(common) > 1 or (len(common) == 1 and side_of(common[0]))):
                result |= {(label, kind): axes_by_group[sensor, kind, label] for label in common}
            elif labels[kind]:
                result[sensor, kind] = axes_by_group[sensor, kind, (common or labels[kind])[0]]
    return result


def _rank_group(axes: Mapping[str, int], named: Sequence[ColumnName]) -> tuple[bool, bool, bool, bool, int]:
    """What makes one group of columns of a quantity better than another; the least is the best."""
    columns = [named[at] for at in axes.values()]
    has_units = all(unit_of(column.unit) is not None for column in columns)
    is_guess = any(column.is_by_unit for column in columns)
    return len(axes) < len(AXES), is_guess, any(column.is_raw for column in columns), not has_units, min(axes.values())


def _to_signal(
    path: Path,
    header: Sequence[str],
    sensor: str,
    kind: str,
    axes: Mapping[str, int],
    named: Sequence[ColumnName],
    dialect: Dialect,
    sample: Sequence[Sequence[str]],
) -> Signal:
    """Three columns as a signal, with the factor of their common unit to SI.

    Args:
        path: Named by errors.
        header: Cells of the header.
        sensor: Name of the sensor; "" in a table of one.
        kind: `accel` or `gyro`.
        axes: Index of the column by axis, `x`, `y` and `z`.
        named: What each column is.
        dialect: Units that the header leaves out.
        sample: Cells of some rows.

    Raises:
        ConfigError: An axis is missing, the units differ, or there is none.
    """
    if lacking := [axis for axis in AXES if axis not in axes]:
        raise missing_axis_error(path, kind, lacking[0], header)
    x, y, z = (axes[axis] for axis in AXES)
    texts = {named[at].unit for at in (x, y, z)} - {""}
    units = {spell_unit(text, kind) or "" for text in texts} or {dialect.get(kind, "")}  # "" for an unknown unit
    if len(units) != 1 or not (unit := units.pop()):  # different units, or none
        valid = f"a unit in brackets ({', '.join(UNITS[kind])}), or {OPTION} {EXAMPLE}"
        whole = all(row[at].strip().lstrip("+-").isdigit() for row in sample for at in (x, y, z) if at < len(row))
        if (whole and sample) or any(map(COUNTS.fullmatch, texts)):
            letter, scale = ("a", "g/16384") if kind == ACCEL else ("g", "deg/s/131")
            valid += f"; raw counts need those per unit in the data sheet: {letter}x={header[x]}[{scale}]"
        raise ConfigError(path, f"header, unit of {header[x]}", named[x].unit or None, valid)
    return Signal(sensor=sensor, quantity=kind, at=(x, y, z), factor=UNITS[kind][unit])
