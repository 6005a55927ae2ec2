"""Tables in long form: one row per reading, with a column that names its sensor or its quantity."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.column_names import AXES, parse_column, sensor_of_text
from stridetwin.streams.formats.imu_clocks import RATE, Clock, parse_stamps, read_times
from stridetwin.streams.formats.imu_columns import KIND, OPTION, Columns, find_time, parse_header
from stridetwin.streams.formats.imu_units import ACCEL, GYRO, TIME, UNITS, spell_unit
from stridetwin.streams.formats.table_head import TableHead, is_number
from stridetwin.streams.formats.table_rows import RowReader, read_groups
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

_USUAL = {ACCEL: "m/s²", GYRO: "rad/s"}
"""Units of Android's and RealSense's sensors."""
_ANDROID_TYPES = {"1": ACCEL, "4": GYRO}
"""Android's numbers of the types of sensors."""
_SENSOR_NAME = re.compile(
    r"(?:.*_)?(?:sensor|device|imu|segment|location|placement|position|side|foot|limb|body_?part|node|mac|address|tag"
    r"|serial|serial_number|stream)(?:_?(?:id|name|type|label|address|no|nr|number|index))?"
)
"""Names of columns that name the sensor of a row, as `sensor_id`, `placement` and `device_name`."""
_TYPE_NAME = re.compile(r"(?:.*_)?type(?:_.*)?")
"""Names of columns that tell the type of a sensor or of a reading, as `type` and `sensor_type`."""
_QUANTITY_NAME = re.compile(
    r"quantity|measure(?:ment|d)?|signal|channel|variable|kind|name|source|metric|key|topic|field"
)
"""Names of columns that name the quantity of a row, as `measurement` and `channel`."""
_VALUE_NAME = re.compile(r"(?:value|reading|data|measurement|magnitude|val)s?")
"""Names of the only column of values, as `value` and `readings`."""
_MOST_SENSORS = 16
"""Most sensors that the first rows of a table of several may name."""
_VALUE_FORMS = tuple(
    tuple(form.format(axis) for axis in axes)
    for form in ("{}", "{}_axis", "value_{}", "values_{}", "value{}", "values{}", "val_{}", "val{}", "v_{}", "v{}")
    + ("data_{}", "data{}", "sensor_{}", "{}_value", "reading_{}")
    for axes in (AXES, "012", "123")
    if form != "{}" or axes == AXES
)
"""Names of three columns of values, as (`value_x`, `value_y`, `value_z`) and (`v1`, `v2`, `v3`), the likely first."""


@dataclass(frozen=True, kw_only=True)
class LongLayout:
    """Which columns of a table in long form say what.

    Attributes:
        time: Column of the stamps; None without.
        quantity: Column that names the quantity, and where it has values of one axis, the axis.
        sensor: Column that names the sensor; None without.
        unit: Column of the units; None without.
        values: Columns of x, y and z, or the only one of a value.
        is_guessed: Whether the columns of stamps and values have no names that tell them.
    """

    time: int | None
    quantity: int
    sensor: int | None
    unit: int | None
    values: tuple[int, ...]
    is_guessed: bool = False


def find_long_layout(head: TableHead) -> LongLayout | None:
    """The layout of a table whose rows name their quantity; None for any other.

    Args:
        head: Head of the table, whose sample is looked at.
    """
    named = parse_header(head.names, head.units)
    texts = [{row[at].strip() for row in head.sample if at < len(row)} - {""} for at in range(len(head.names))]
    is_realsense = head.names[:3] == ("Stream Type", "Index", "F#")
    candidates = (at for at, cells in enumerate(texts) if _names_quantities(named[at].name, cells))
    quantity = 0 if is_realsense else next(candidates, None)
    if quantity is None:
        return None
    values = _find_values(head, quantity)
    if not values:
        return _guess_layout(head, quantity)
    names = [column.name for column in named]
    sensor = None if is_realsense else find_sensor_column(head, (quantity, *values))
    unit = next((at for at, name in enumerate(names) if name in ("unit", "units")), None)
    return LongLayout(time=find_time(named, head.sample), quantity=quantity, sensor=sensor, unit=unit, values=values)


def _guess_layout(head: TableHead, quantity: int) -> LongLayout | None:
    """The layout of rows whose columns have no names, as `ACCE;1.2;3.4;x;y;z;3`: stamps rise, and values follow them.

    Args:
        head: Head of the table.
        quantity: Column that names the quantity of each row.
    """
    rows = [row for row in head.sample if quantity < len(row) and _quantity_of(row[quantity].strip())]
    width = min(map(len, rows), default=0)
    numeric = [at for at in range(width) if at != quantity and all(is_number(row[at]) for row in rows)]
    first = next((at for at in numeric if at > quantity and not _never_falls(rows, at)), width)
    stamps = [at for at in numeric if at < first and _never_falls(rows, at)]
    values = [at for at in numeric if at >= first][: len(AXES)]
    if not stamps or len(values) < len(AXES):
        return None
    return LongLayout(time=stamps[-1], quantity=quantity, sensor=None, unit=None, values=tuple(values), is_guessed=True)


def _never_falls(rows: Sequence[Sequence[str]], at: int) -> bool:
    """Whether the numbers of a column never fall, and rise now and then."""
    numbers = [float(row[at].replace(",", ".")) for row in rows]
    return all(a <= b for a, b in pairwise(numbers)) and numbers[0] < numbers[-1]


def read_mapped_groups(
    path: Path, head: TableHead, columns: Columns, kind_at: int, rate_hz: float | None, notes: Notes
) -> Iterator[tuple[str, str, Array, Array]]:
    """Reads the readings of a table in long form whose columns the user names.

    Args:
        path: Named by errors.
        head: Head of the table.
        columns: Columns of the stamps, and of the forces and rates in the rows that have them.
        kind_at: Column that tells which of both a row has.
        rate_hz: Rate of each quantity that the user gives; None: by the stamps.
        notes: Collects what was assumed.

    Yields:
        Sensor, quantity, times (N,) s and values (N, 3) m/s² or rad/s.

    Raises:
        ConfigError: A cell is no number, or stamps or a quantity are missing.
    """
    at = [columns.time] if columns.time is not None and rate_hz is None else []
    if not at and rate_hz is None:
        raise ConfigError(path, OPTION, None, f"also t, or {RATE} HZ")
    is_text = bool(at) and has_text_stamps(head, at[0])
    read_at = [*at, *(column for signal in columns.signals for column in signal.at)]
    reader = RowReader(wanted=read_at, times=len(at), texts_at=at[0] if is_text else None)
    groups = read_groups(path, head, reader, notes, [kind_at], lambda key: bool(_quantity_of_code(key[0])))
    for signal_at, signal in enumerate(columns.signals):
        keys = [key for key in groups if _quantity_of_code(key[0]) == signal.quantity]
        if not keys:
            texts = ", ".join(sorted({row[kind_at] for row in head.sample if kind_at < len(row)}))
            valid = f"names of sensors such as acc and gyro; the first rows have {texts[:80]}"
            raise ConfigError(path, f"{OPTION} {KIND}", head.names[kind_at], valid)
        table, texts_of_rows = groups[keys[0]]
        if is_text:
            t = parse_stamps(path, head.names[at[0]], texts_of_rows)
        else:
            clock = Clock(at=columns.time, kind="stamps" if at else "rows", rate_hz=rate_hz or 0.0)
            t = read_times(path, columns, clock, table[:, 0], len(table), notes)
        begin = len(at) + len(AXES) * signal_at
        yield "", signal.quantity, t, signal.factor * table[:, begin : begin + len(AXES)]


def find_sensor_column(head: TableHead, used: Sequence[int]) -> int | None:
    """Index of the column that names the sensor of each row; None without one.

    Args:
        head: Head of the table.
        used: Columns that say something else.
    """
    for at, column in enumerate(parse_header(head.names, head.units)):
        if at in used or not _SENSOR_NAME.fullmatch(column.name):
            continue
        cells = {row[at].strip() for row in head.sample if at < len(row)}
        if len(cells) <= _MOST_SENSORS and "" not in cells and all(c.isdigit() or not is_number(c) for c in cells):
            return at
    return None


def read_long_groups(
    path: Path, head: TableHead, layout: LongLayout, rate_hz: float | None, notes: Notes
) -> Iterator[tuple[str, str, Array, Array]]:
    """Reads the readings of a table in long form.

    Args:
        path: Named by errors.
        head: Head of the table.
        layout: Which columns say what.
        rate_hz: Rate of each sensor that the user gives; None: by the stamps.
        notes: Collects what was assumed.

    Yields:
        Sensor, quantity, times (N,) s and values (N, 3) m/s² or rad/s.

    Raises:
        ConfigError: A cell is no number, or stamps, a quantity or a unit are missing.
    """
    named = parse_header(head.names, head.units)
    key_at = [layout.quantity, *(at for at in (layout.sensor, layout.unit) if at is not None)]
    at = [layout.time] if layout.time is not None and rate_hz is None else []
    if not at and rate_hz is None:
        raise ConfigError(path, "t", None, f"a column of time; the table has {', '.join(head.names)}; or {RATE} HZ")
    is_text = bool(at) and has_text_stamps(head, at[0])
    reader = RowReader(wanted=[*at, *layout.values], times=len(at), texts_at=at[0] if is_text else None)
    groups = read_groups(path, head, reader, notes, key_at, lambda key: bool(_quantity_of(key[0])))
    if layout.is_guessed and at:
        x, y, z = (column + 1 for column in layout.values)
        notes.warn(
            f"{path.name}: column {layout.quantity + 1} names the sensor of each row; column {at[0] + 1} is taken for "
            f"stamps, {x}, {y}, {z} for x, y, z; otherwise give {OPTION}"
        )
    time_unit = spell_unit(named[at[0]].unit, TIME) if at else None
    columns = Columns(names=head.names, time=layout.time, time_unit=time_unit or "")
    series: dict[tuple[str, str, str], tuple[Array, Array]] = {}  # times and values, by sensor, quantity and axis
    for key, (table, texts) in sorted(groups.items(), key=lambda group: parse_column(group[0][0]).is_raw):
        quantity, axis = _quantity_of(key[0]), parse_column(key[0]).axis
        kind = "stamps" if at else "rows"
        if is_text:
            t = parse_stamps(path, head.names[at[0]], texts)
        else:
            clock = Clock(at=layout.time, kind=kind, rate_hz=rate_hz or 0.0)
            t = read_times(path, columns, clock, table[:, 0], len(table), notes)
        key_unit = key[-1] if layout.unit is not None else parse_column(key[0]).unit or named[layout.values[0]].unit
        key_unit = "" if layout.is_guessed else key_unit
        factor = _find_factor(path, key[0], quantity, key_unit, notes)
        sensor = key[1] if layout.sensor is not None else sensor_of_text(key[0])
        if (sensor, quantity, axis) not in series:
            series[sensor, quantity, axis] = (t, factor * table[:, len(at) :])
    yield from _join_axes(path, series, len(layout.values))


def has_text_stamps(head: TableHead, at: int) -> bool:
    """Whether the cells of a column are dates or times of day in the first rows."""
    cells = [row[at] for row in head.sample if at < len(row) and row[at].strip()]
    return bool(cells) and not any(map(is_number, cells))


def _names_quantities(name: str, cells: set[str]) -> bool:
    """Whether the cells of a column name a force and a rate, as text or as Android's types."""
    if _TYPE_NAME.fullmatch(name) and {"1", "4"} <= cells:
        return True
    quantities = {_quantity_of(cell) for cell in cells if not is_number(cell)} - {""}
    is_likely = _TYPE_NAME.fullmatch(name) or _SENSOR_NAME.fullmatch(name) or _QUANTITY_NAME.fullmatch(name)
    return quantities == {ACCEL, GYRO} or bool(quantities and is_likely)


def _quantity_of(text: str) -> str:
    """Quantity that a text or one of Android's types names; "" for any other."""
    return _ANDROID_TYPES.get(text, "") or parse_column(text).quantity


def _quantity_of_code(text: str) -> str:
    """Quantity that a text names, also as a letter `A` or `G`; "" for any other."""
    return _quantity_of(text) or {"a": ACCEL, "g": GYRO}.get(text.strip().lower(), "")


def _find_values(head: TableHead, quantity: int) -> tuple[int, ...]:
    """Columns of x, y and z, or that of the only value; empty for a table that has its quantities in other columns."""
    names = [parse_column(name).name for name in head.names]
    for forms in _VALUE_FORMS:
        if set(forms) <= set(names):
            return tuple(names.index(form) for form in forms)
    return tuple(at for at, name in enumerate(names) if at != quantity and _VALUE_NAME.fullmatch(name))[:1]


def _find_factor(path: Path, name: str, quantity: str, unit: str, notes: Notes) -> float:
    """Factor from a unit to m/s² or rad/s; without one Android's units are assumed, which is reported.

    Raises:
        ConfigError: The unit is of another quantity, or unknown.
    """
    if not unit.strip():
        notes.warn(f"{path.name}: {name} has no unit; {_USUAL[quantity]} assumed")
        return 1.0
    spelling = spell_unit(unit, quantity)
    if spelling is None:
        valid = f"one of {', '.join(UNITS[quantity])}; {OPTION} names other columns"
        raise ConfigError(path, f"unit of {name}", unit, valid)
    return UNITS[quantity][spelling]


def _join_axes(
    path: Path, series: Mapping[tuple[str, str, str], tuple[Array, Array]], width: int
) -> Iterator[tuple[str, str, Array, Array]]:
    """Joins series of single axes to those of three, at the stamps that all have.

    Args:
        path: Named by errors.
        series: Times (N,) s and values (N, width), by sensor, quantity and axis.
        width: 3 for values of three axes, which come back as they are, or 1.

    Raises:
        ConfigError: An axis is missing.
    """
    if width == len(AXES):
        for (sensor, quantity, _), (t, values) in series.items():
            yield sensor, quantity, t, values
        return
    for sensor, quantity in dict.fromkeys((s, q) for s, q, _ in series):
        axes = [series.get((sensor, quantity, axis)) for axis in AXES]
        if lacking := [axis for axis, part in zip(AXES, axes) if part is None]:
            raise ConfigError(path, f"{quantity}_{lacking[0]}", None, f"readings of {sensor} {quantity} of x, y and z")
        parts = [part for part in axes if part is not None]
        common = parts[0][0]
        for t, _ in parts[1:]:
            common = np.intersect1d(common, t)
        columns = []
        for t, values in parts:
            stamps, first = np.unique(t, return_index=True)
            columns.append(values[first[np.searchsorted(stamps, common)], 0])
        yield sensor, quantity, common, np.column_stack(columns)
