"""Times of the rows of a table: from stamps, from a counter of packets or ticks, or from the number of the row."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.column_names import ColumnName, is_counter_name, parse_column
from stridetwin.streams.formats.imu_columns import OPTION, Columns, find_time
from stridetwin.streams.formats.imu_stamps import parse_stamp, unwrap_days
from stridetwin.streams.formats.imu_units import TIME, UNITS, unit_of
from stridetwin.streams.formats.table_head import is_plain_number
from stridetwin.streams.plausible import IMU_RATES_HZ
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.row_patterns import LOST_ROW_PERIODS
from stridetwin.streams.samples import Array

RATE = "--rate"
"""Option of the command line for the rate of a table without stamps, as errors name it."""
TICKS = "sampletimefine"
"""Name of Xsens' column of ticks, in lower case and without `_`."""
_TICK_UNITS_S = (1e-4, 1e-6)
"""A tick of an MTw or MTi, and of a DOT, s."""
_TICK_SIZE = 2**32
"""Number of ticks after which they begin again: they have 32 bits."""
_COUNTER_SIZES = tuple(sorted({*(2**k for k in range(5, 33)), *(10**k for k in range(2, 10)), 60_000}))
"""Numbers of counts after which counters begin again."""
_USUAL_SIZES = (2**8, 2**16, 2**24, 2**32)
"""Those of whole bytes, of which more may be missing where they begin again."""
_MOST_AT_END, _FEW_AT_END, _LEAST_AT_END = 0.02, 50, 5
"""Counts that may be lost where a counter begins again: a share of all its counts, or few; fewer of unusual sizes."""
_STAMP_SIZES = (2**16, 86_400, 604_800, 2**24, 86_400_000, 604_800_000, 2**32, 86_400_000_000)
"""Numbers after which clocks begin again: those of 16, 24 and 32 bits, days and weeks."""
_LAST_CLOCK, _MINUTE_NUMBER, _HOUR_NUMBER = 240_000.0, 40.0, 4000.0
"""Least number that is no time `hhmmss`; and what its step has beyond the time at the end of a minute, and once more at
that of an hour, as from `115959` to `120000`."""
_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Digits of an exponent, by the usual ones."""
_DAYS = (719_529.0, 25_569.0)
"""1970 in days of MATLAB and of spreadsheets."""
_MINUTE_S, _FEWEST_STEPS = 60, 10
"""Seconds of a minute, which count on their own in tables of whole seconds; steps that are needed to know a clock."""
_MOST_STEPS_AT_END = 50.0
"""Usual steps that may lie between the last stamp before a clock begins again and the first one after it."""
_LONGEST_RATE = 300
"""Characters of a line above the numbers in which a rate is looked for; the patterns take the square of its length."""
_INTEGER = re.compile(r"\s*\d+\s*")
"""A cell with a whole number."""
_FEWEST_REGULAR, _FEWEST_OF_ONE_STEP = 0.98, 0.5
"""Share of the steps of a counter that are multiples of the usual one, and of those that equal it."""
_OTHER_RATE = 0.02
"""Share by which a rate may differ from that of the stamps."""
_RATES = (
    re.compile(
        r"(?:update|output|data|sampl\w*|frame|acquisition|recording)[\s_-]*(?:rate|freq\w*|hz)?[^0-9\n]{0,16}?"
        r"(\d+(?:[.,]\d+)?)\s*(k?hz|sps)",
        re.IGNORECASE,
    ),
    re.compile(
        r"(?:rate|freq\w*)[\s_]*[\[(]\s*(k?hz)\s*[\])][^0-9\n]{0,6}(\d+(?:\.\d+)?)(?![.\d])",
        re.IGNORECASE,
    ),
)
"""Lines of a preamble that give the rate of samples, such as `// Update Rate: 100.0Hz` and `OutputRate:,60Hz`."""


_SHORT_RATE = re.compile(
    r"[\W_]*(?:fs|f_s|odr|freq(?:uency)?|rate)\b[^0-9a-z]{0,8}(\d+(?:[.,]\d+)?)\s*(k?hz|sps)", re.IGNORECASE
)
"""Lines that begin with the rate of samples, such as `fs = 100 Hz`."""


@dataclass(frozen=True, kw_only=True)
class Clock:
    """What tells the times of the rows.

    Attributes:
        at: Index of the column; None if the rows are counted.
        kind: `stamps`, `counter`, `ticks` or `rows`.
        rate_hz: Rate of the counter or of the rows; 0 for stamps, and for ticks of a known length.
        tick_s: Length of a tick, s; 0 for others.
    """

    at: int | None
    kind: str
    rate_hz: float = 0.0
    tick_s: float = 0.0


def preamble_rate(preamble: Sequence[str]) -> float:
    """Rate in Hz that a line above the numbers gives; 0 without one."""
    for line in (line[:_LONGEST_RATE] for line in preamble):
        if (matched := _RATES[0].search(line) or _SHORT_RATE.match(line)) is not None:
            return float(matched[1].replace(",", ".")) * (1000.0 if matched[2].lower() == "khz" else 1.0)
        if (matched := _RATES[1].search(line)) is not None:
            return float(matched[2]) * (1000.0 if matched[1].lower() == "khz" else 1.0)
    return 0.0


def tick_length(names: Sequence[str], sample: Sequence[Sequence[str]], rate_hz: float) -> float:
    """Length in s of a tick of Xsens' SampleTimeFine: 0.1 ms of an MTw, 1 µs of a DOT.

    The rate in the preamble decides, else the first length that gives the rate of an IMU.

    Args:
        names: Names of the columns.
        sample: Cells of the first rows.
        rate_hz: Rate in the preamble; 0 without one.

    Returns:
        The length; 0 for a table without ticks.
    """
    at = _find_name(names, TICKS)
    if at is None:
        return 0.0
    steps = _list_rises([row[at] for row in sample if at < len(row) and is_plain_number(row[at])])
    if not len(steps):
        return _TICK_UNITS_S[0]
    step = float(np.median(steps))
    if rate_hz > 0:
        return min(_TICK_UNITS_S, key=lambda unit: abs(math.log(unit * step * rate_hz)))
    likely = (unit for unit in _TICK_UNITS_S if IMU_RATES_HZ[0] <= 1 / (unit * step) <= IMU_RATES_HZ[1])
    return next(likely, _TICK_UNITS_S[0])


def is_dot_tick(tick_s: float) -> bool:
    """Whether a tick has the length of a DOT's."""
    return tick_s == _TICK_UNITS_S[1]


def has_nanoseconds(named: Sequence[ColumnName], sample: Sequence[Sequence[str]]) -> bool:
    """Whether the stamps of a table count nanoseconds, by their unit, or without one by the rate of the first rows."""
    at = find_time(named, sample)
    if at is None:
        return False
    known = unit_of(named[at].unit)
    if known is not None:
        return known[1] == "ns"
    rising = _list_rises([row[at] for row in sample if at < len(row) and _INTEGER.fullmatch(row[at])])
    step = float(np.median(rising)) if len(rising) else math.inf
    return bool(IMU_RATES_HZ[0] < 1e9 / step < IMU_RATES_HZ[1])


def choose_clock(
    path: Path,
    columns: Columns,
    sample: Sequence[Sequence[str]],
    rate_hz: float | None,
    given_hz: float,
    tick_s: float,
    notes: Notes,
) -> Clock:
    """Decides what tells the times of the rows.

    Args:
        path: Named by errors.
        columns: The columns of the table.
        sample: Cells of the first rows, by which a counter of another name is known.
        rate_hz: Rate that the user gives: of the counter, if the table has one, else of the rows; None without one.
        given_hz: Rate in the preamble; 0 without one.
        tick_s: Length of a tick (`tick_length`); 0 in a table without ticks.
        notes: Collects what is assumed.

    Raises:
        ConfigError: The table has no stamps, and no rate is given.
    """
    counter = next((at for at, name in enumerate(columns.names) if is_counter_name(parse_column(name).name)), None)
    ticks = _find_name(columns.names, TICKS)
    if counter is None and ticks is None and (rate_hz is not None or given_hz > 0):
        counter = _find_counting_column(columns, sample)
    if rate_hz is not None:
        if counter is not None:
            return Clock(at=counter, kind="counter", rate_hz=rate_hz)
        return Clock(at=ticks, kind="rows" if ticks is None else "counter", rate_hz=rate_hz)
    if columns.time is not None:
        return Clock(at=columns.time, kind="stamps")
    if counter is not None and given_hz > 0:
        return Clock(at=counter, kind="counter", rate_hz=given_hz)
    if ticks is not None:
        return Clock(at=ticks, kind="ticks", tick_s=tick_s)
    if given_hz > 0:
        notes.warn(f"{path.name}: no column of time; {given_hz:g} Hz of the lines above the numbers is taken")
        return Clock(at=None, kind="rows", rate_hz=given_hz)
    text = ", ".join(columns.names) or "none"
    counted = "" if counter is None else f", which is then the rate of {columns.names[counter]}"
    raise ConfigError(path, "t", None, f"a column of time; the table has {text}; without one: {RATE} HZ{counted}")


def read_times(path: Path, columns: Columns, clock: Clock, cells: Array, count: int, notes: Notes) -> Array:
    """Times of the rows: (N,) s.

    Args:
        path: Named by errors.
        columns: The columns of the table.
        clock: What tells the times.
        cells: (N,) numbers of its column; empty for `rows`.
        count: N.
        notes: Collects what is assumed.

    Raises:
        ConfigError: No unit of time fits the stamps, or the counter goes back.
    """
    if clock.kind == "rows" or clock.at is None:
        return np.arange(count) / clock.rate_hz
    name = columns.names[clock.at]
    if not np.isfinite(cells).all():
        row = int(np.argmin(np.isfinite(cells)))
        valid = "a finite number" if clock.kind == "stamps" else "a count"
        raise ConfigError(path, f"{name}, row {row + 1}", float(cells[row]), valid)
    if clock.kind == "stamps":
        cells = _unwrap_stamps(path, name, _split_clock_numbers(path, name, cells, notes), columns.of_minute, notes)
        factor = _find_time_factor(path, columns, cells, notes)
        return factor * (_count_days(cells) if factor == UNITS[TIME]["d"] else cells)
    if clock.kind == "ticks":
        return _unwrap_counter(path, name, cells, _TICK_SIZE) * clock.tick_s
    return _count_times(path, name, cells, clock.rate_hz, notes)


def report_rate(path: Path, columns: Columns, stamps: Array, rate_hz: float, notes: Notes) -> None:
    """Reports where the rate that the user gives contradicts the stamps that it replaces.

    Args:
        path: Named by the report.
        columns: The columns of the table, which has stamps.
        stamps: (N,) numbers of their column.
        rate_hz: The rate, with which the rows are counted.
        notes: Collects the report.
    """
    steps = np.diff(stamps[np.isfinite(stamps)])
    if columns.time is None or not len(steps) or np.any(steps < 0) or 2 * np.count_nonzero(steps > 0) < len(steps):
        return
    name, usual = columns.names[columns.time], float(np.median(steps[steps > 0]))
    gaps = steps > LOST_ROW_PERIODS * usual
    if missing := int(np.sum(np.rint(steps[gaps] / usual) - 1)):
        notes.warn(
            f"{path.name}: {RATE} counts the rows, although {missing} are missing by the stamps of {name}: "
            f"leave {RATE} out to use them"
        )
    units = [columns.time_unit] if columns.time_unit else ["s", "ms", "µs", "ns"]
    rates = [1 / (UNITS[TIME][unit] * usual) for unit in units]
    by_stamps = min(rates, key=lambda rate: abs(math.log(rate / rate_hz)))
    if abs(by_stamps / rate_hz - 1) > _OTHER_RATE and (columns.time_unit or 0.5 < by_stamps / rate_hz < 2):
        notes.warn(f"{path.name}: {RATE} {rate_hz:g} replaces the stamps of {name}, which give {by_stamps:.4g} Hz")


def parse_stamps(path: Path, name: str, texts: Sequence[str]) -> Array:
    """Times (N,) s of dates or times of day as text.

    Raises:
        ConfigError: A text is none.
    """
    t = np.empty(len(texts))
    for row, text in enumerate(texts):
        try:
            t[row] = parse_stamp(text)
        except ValueError:
            raise ConfigError(path, f"{name}, row {row + 1}", text, "a number, or a time as 12:34:56.789") from None
    return unwrap_days(t)


def _list_rises(cells: Sequence[str]) -> Array:
    """Steps (N,) from one number to the next, where it is larger; cells beyond the range of floats are left out."""
    numbers = np.array([float(cell.replace(",", ".")) for cell in cells])
    steps = np.diff(numbers[np.isfinite(numbers)])
    return steps[steps > 0]


def _find_name(names: Sequence[str], wanted: str) -> int | None:
    """Index of the column of a name, whatever its case and its gaps; None without one."""
    return next((at for at, name in enumerate(names) if re.sub(r"[\s_]", "", name).lower() == wanted), None)


def _split_clock_numbers(path: Path, name: str, stamps: Array, notes: Notes) -> Array:
    """Stamps (N,) as they are, or seconds of the day of those that are times as numbers, as `115959.99` of a GPS.

    Args:
        path: Named by the report.
        name: Name of the column.
        stamps: (N,) its numbers.
        notes: Collects the report.
    """
    steps = np.diff(stamps)
    if len(steps) < _FEWEST_STEPS or not (np.all(steps >= 0) and stamps[0] >= 0 and stamps[-1] < _LAST_CLOCK):
        return stamps
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    gaps = steps[steps > LOST_ROW_PERIODS * usual]
    of_minutes = np.abs(np.mod(gaps, _HOUR_NUMBER) - _MINUTE_NUMBER) <= usual * _MOST_STEPS_AT_END
    if not len(gaps) or not of_minutes.all() or usual > 1.0 or np.any(np.mod(stamps, 100) >= _MINUTE_S):
        return stamps
    notes.warn(f"{path.name}: {name} has times of day as numbers, hhmmss, by its steps of {gaps[0]:.4g}")
    hours, minutes = np.floor(stamps / 1e4), np.floor(np.mod(stamps, 1e4) / 100)
    return np.asarray(3600 * hours + 60 * minutes + np.mod(stamps, 100))


def _count_days(days: Array) -> Array:
    """Days (N,) since 1970, from those of spreadsheets (since 1900) and of MATLAB (since the year 0)."""
    first = days[0] if len(days) else 0.0
    offset = next((offset for offset in _DAYS if first > offset), 0.0)
    return np.asarray(days - offset)


def _unwrap_stamps(path: Path, name: str, stamps: Array, is_of_minute: bool, notes: Notes) -> Array:
    """Stamps (N,) of a clock that began again, as `micros()` of an Arduino or seconds of a day, without the steps back.

    The clock's size is the one with which the steps back become about as long as the others.

    Args:
        path: Named by the report.
        name: Name of the column.
        stamps: (N,) numbers in the unit of the column.
        is_of_minute: Whether they may be seconds of a minute, beside columns of minutes or of the rest.
        notes: Collects the report.
    """
    steps = np.diff(stamps)
    rising = steps[steps > 0]
    if not np.any(steps < 0) or len(rising) < (1 if is_of_minute else _FEWEST_STEPS):
        return stamps
    usual = float(np.median(rising))
    for size in (_MINUTE_S, *_STAMP_SIZES) if is_of_minute else _STAMP_SIZES:
        back = steps < -size / 2
        gaps = steps[back] + size
        span = stamps.max() - stamps.min()
        if span < size and len(gaps) and np.all((gaps > 0) & (gaps <= _MOST_STEPS_AT_END * usual)):
            count = str(size) if size & (size - 1) else f"2{str(size.bit_length() - 1).translate(_RAISED)}"
            notes.warn(
                f"{path.name}: {name} begins again after {count} counts {len(gaps)} times; its stamps are continued"
            )
            return np.asarray(stamps + size * np.concatenate(([0], np.cumsum(back))))
    return stamps


def _count_times(path: Path, name: str, counts: Array, rate_hz: float, notes: Notes) -> Array:
    """Times (N,) s of a counter with a rate; of the rows, with a report, where the counter does not count samples.

    A counter that rises by a number of its own per sample, as one of several streams, is divided by that number.

    Args:
        path: Named by the report.
        name: Name of the counter's column.
        counts: (N,) its numbers.
        rate_hz: Samples per second.
        notes: Collects the report.

    Raises:
        ConfigError: The counter goes back.
    """
    size = _TICK_SIZE if re.sub(r"[\s_]", "", name).lower() == TICKS else _find_counter_size(counts)
    since = _unwrap_counter(path, name, counts, size)
    steps = np.diff(since)
    rising = steps[steps > 0]
    if not len(rising) or 2 * len(rising) < len(steps):  # one count for several rows
        notes.warn(f"{path.name}: {name} repeats its counts; the rows are counted at {rate_hz:g} Hz")
        return np.arange(len(counts)) / rate_hz
    values, numbers = np.unique(rising, return_counts=True)
    usual = float(values[np.argmax(numbers)])  # counts per sample
    periods = rising / usual
    regular = np.mean(np.abs(periods - np.rint(periods)) < 0.25)
    of_one_step = np.mean(np.abs(periods - 1) < 0.25)
    if regular < _FEWEST_REGULAR or of_one_step < _FEWEST_OF_ONE_STEP:
        notes.warn(
            f"{path.name}: {name} is no counter of samples: its steps differ; the rows are counted at {rate_hz:g} Hz"
        )
        return np.arange(len(counts)) / rate_hz
    return np.rint(since / usual) / rate_hz


def _find_counting_column(columns: Columns, sample: Sequence[Sequence[str]]) -> int | None:
    """Index of the first column that is not used and counts up, mostly by one, in some rows; None without.

    Args:
        columns: The columns of the table.
        sample: Cells of these rows.
    """
    used = {columns.time, columns.fraction, *(at for signal in columns.signals for at in signal.at)}
    for at in range(len(columns.names)):
        cells = [row[at] for row in sample if at < len(row)]
        if at in used or len(cells) < _FEWEST_STEPS or not all(map(_INTEGER.fullmatch, cells)):
            continue
        steps = np.diff(np.array(cells, np.float64))
        if np.count_nonzero(steps <= 0) <= 1 and np.median(steps) == 1:
            return at
    return None


def _find_counter_size(counts: Array) -> int:
    """Number of counts after which a counter (N,) begins again: the least with which few are lost wherever it does."""
    steps = np.diff(counts)
    back = steps[steps < 0]
    sizes = [size for size in _COUNTER_SIZES if counts.max(initial=0.0) < size]
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0

    def fits(size: int) -> bool:
        """Whether no more counts are lost at any step back than a counter of that size allows."""
        most = max(_FEW_AT_END, _MOST_AT_END * size) if size in _USUAL_SIZES else _LEAST_AT_END
        return bool(np.all(back + size <= usual * most))

    return next((size for size in sizes if len(back) and fits(size)), _COUNTER_SIZES[-1])


def _unwrap_counter(path: Path, name: str, counts: Array, size: int) -> Array:
    """Counts (N,) since the first row, from a counter that begins again after `size` counts.

    Raises:
        ConfigError: The counter goes back elsewhere, as after a restart.
    """
    steps = np.diff(counts)
    steps = np.where(steps < -size / 2, steps + size, steps)  # a large step back is an overflow
    if np.any(steps < 0):
        row = int(np.argmax(steps < 0)) + 1
        raise ConfigError(
            path,
            f"{name}, row {row + 1}",
            float(counts[row]),
            f"a count from {counts[row - 1]:g} on; did the sensor restart, or are rows of several sensors mixed? "
            "Cut the file there",
        )
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
    rising = steps[steps > 0]
    step = float(np.median(rising)) if len(rising) else math.nan  # period in the table's unit
    name = columns.names[columns.time]
    if name in ("", "axis") and np.all(steps == 1):
        raise ConfigError(path, "column 1", "numbers of rows", f"stamps in s, or {RATE} HZ")
    # rows per stamp, as of packets; the rate of the rows decides on the unit
    packet = max(1.0, (len(t) - 1) / max(1, len(rising)))
    for unit in ("s", "ms", "µs", "ns", "d"):
        rate = packet / (UNITS[TIME][unit] * step)
        if IMU_RATES_HZ[0] < rate < IMU_RATES_HZ[1]:
            notes.warn(f"{path.name}: {name or 'time'} has no unit; {unit} assumed: {rate:.4g} Hz")
            return UNITS[TIME][unit]
    raise ConfigError(path, f"{name}, unit", None, f"a unit of time in brackets, as in {OPTION} t={name}[ms]")
