"""Rows without a measurement in an inertial stream: zeros, fill values and empty cells among other numbers.

Drivers that publish every packet, or merge sensors of different rates in one table, write such rows. They are left out
of the quantity that they lack, and the other quantity of the row is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.imu_bridging import FEWEST, LONGEST_S, SampleT, drop_repeated_rows
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array, Block, Stamps

QUANTITIES: Mapping[str, str] = {"specific_force": "accel", "angular_rate": "gyro"}
"""Quantity of each column of an `Imu`."""

_WHAT: Mapping[str, str] = {"accel": "forces", "gyro": "rates"}
Flags = npt.NDArray[np.bool_]
"""(N,) whether each row is meant."""
_SHORTEST_RUN = 3
"""Longest run of equal rows, in rows, that counts as no measurement beside any numbers that are clearly others."""
_CLEAR = 8.0
"""Steps of the numbers' resolution by which the rows around are others."""
_FAST: Mapping[str, float] = {"accel": 2.0, "gyro": 0.5}
"""By how much the rows at both ends of a longer run must be others, m/s² or rad/s."""
_LEAST_ZEROS, _CLEARLY = 0.05, 3.0
"""Share of rows with a zero on one axis that count as no measurement, and by how many usual steps the rows around are
others."""
_MOST_SHARE = 0.9
"""Share of rows without a measurement from which on the stream is refused."""
_FEWEST_FILLS = 2
_FEWEST_READINGS, _LEAST_HELD = 10, 0.02
"""Readings in motion that must be held for several rows, and their share among all readings in motion."""
_FROZEN_ROWS, _MOST_FROZEN = 5, 3
"""Fewest equal rows that count as those of a sensor that stood still, if a jump is at one of their ends; and most runs
of them without a jump, of a sensor whose noise lets no other row repeat."""
_MOST_FILLS = 16
"""Most values that are tried, the most frequent ones first."""
_FAR = 2.0
"""Multiple of the largest number from which on another one is a fill value, however often it occurs."""


def find_unmeasured(quantity: str, values: Array) -> Flags:
    """Finds the rows in which no axis of a quantity was measured.

    Three cells that are no numbers are none, and so are rows in which one axis is 0 again and again, unlike the rows
    around. Three equal numbers (zeros, or a fill value that occurs twice or is far from all others) are none if the
    rows around are clearly others: by more than the resolution of the numbers in short runs and where measured rows
    stand alone, by a fast movement in longer runs, since a gyroscope at rest may show zeros.

    Args:
        quantity: `accel` or `gyro`.
        values: (N, 3) m/s² or rad/s.
    """
    empty = np.asarray(np.isnan(values).all(axis=1), bool)
    for axis in range(values.shape[1]):
        empty |= _find_zeros(values[:, axis])
    finite = np.asarray(np.isfinite(values).all(axis=1), bool)
    equal = finite & (values[:, 0] == values[:, 1]) & (values[:, 1] == values[:, 2])
    if not equal.any() or len(values) < _SHORTEST_RUN:
        return empty
    result = empty.copy()
    fills, counts = np.unique(values[equal, 0], return_counts=True)
    for at in np.argsort(counts)[::-1][:_MOST_FILLS]:
        fill, count = fills[at], counts[at]
        if fill == 0.0 or count >= _FEWEST_FILLS or abs(fill) > _FAR * np.abs(values[finite & ~equal]).max(initial=0.0):
            result |= _find_fills(quantity, values, equal & (values[:, 0] == fill), float(fill), ~equal & finite)
    return result


def _find_zeros(values: Array) -> Flags:
    """The rows (N,) in which one axis alone is exactly 0 again and again, while the rows around it are clearly others.

    Args:
        values: (N,) numbers of one axis.
    """
    none: Flags = np.zeros(len(values), bool)
    is_zero = values == 0.0
    at = np.flatnonzero(~is_zero & np.isfinite(values))
    if len(at) < 2 or np.count_nonzero(is_zero) < _LEAST_ZEROS * len(values):
        return none
    around = np.abs(np.interp(np.arange(len(values)), at, values[at]))
    jumps = np.abs(np.diff(values[at]))
    resolution = float(np.abs(values[at]).min())
    begins, ends, runs = _find_runs(is_zero)
    typical = float(np.median(jumps))  # between measured rows
    for begin, end, length in zip(begins, ends, runs):
        clear = around[begin:end].min()
        none[begin:end] = length <= _SHORTEST_RUN and clear > _CLEAR * resolution and clear > _CLEARLY * typical
    return none if np.count_nonzero(none) >= _LEAST_ZEROS * len(values) else np.zeros(len(values), bool)


def find_held(values: Array) -> Flags:
    """Finds the rows that only repeat the row before, as where a slower sensor is published as fast as another one.

    Rows that repeat by chance, as of a coarse sensor at rest, are none: many rows must repeat in motion, where the
    numbers change by far more than their resolution from one reading to the next.

    Args:
        values: (N, 3) m/s² or rad/s.
    """
    none: Flags = np.zeros(len(values), bool)
    steps = np.abs(np.diff(values, axis=0)).max(axis=1, initial=0.0)  # (N - 1,); not a number beside empty rows
    begins = np.concatenate(([0], np.flatnonzero(~(steps == 0.0)) + 1))  # first row of each reading
    if len(begins) == len(values) or len(begins) < _FEWEST_READINGS:
        return none
    lengths = np.diff(np.append(begins, len(values)))
    jumps = steps[begins[1:] - 1]  # from each reading to the next one
    resolution = float(np.nanmin(jumps))
    moves = np.concatenate(([False], (jumps[:-1] > _CLEAR * resolution) & (jumps[1:] > _CLEAR * resolution), [False]))
    held = lengths[moves & (lengths > 1)]
    if len(held) < _FEWEST_READINGS or len(held) < _LEAST_HELD * np.count_nonzero(moves):
        return none
    repeats: Flags = np.ones(len(values), bool)
    repeats[begins] = False
    return repeats & (np.repeat(lengths, lengths) <= 2 * np.median(held))


def find_frozen(quantity: str, values: Array) -> Flags:
    """Finds the rows that repeat the row before for long, up to a jump, as where a sensor or its driver stood still.

    Args:
        quantity: `accel` or `gyro`.
        values: (N, 3) m/s² or rad/s.
    """
    steps = np.abs(np.diff(values, axis=0)).max(axis=1, initial=0.0)  # (N - 1,)
    frozen: Flags = np.zeros(len(values), bool)
    begins, ends, runs = _find_runs(np.concatenate(([False], steps == 0.0)))
    is_rare = len(runs) <= _MOST_FROZEN and bool(np.all(runs >= _FROZEN_ROWS))  # noise lets no other row repeat
    for begin, end, length in zip(begins, ends, runs):
        before = steps[begin - 2] if begin > 1 else 0.0
        after = steps[end - 1] if end - 1 < len(steps) else 0.0
        is_inside = begin > 1 and end - 1 < len(steps) and bool(values[begin].any())
        is_sudden = max(before, after) > _FAST[quantity] or (is_rare and is_inside)
        frozen[begin:end] = length >= _FROZEN_ROWS and is_sudden
    return frozen


def leave_out_unmeasured(name: str, block: Block[SampleT], notes: Notes) -> Block[SampleT]:
    """The stream of an IMU or an accelerometer without the rows in which it was not measured.

    Where a row lacks one quantity alone, the other is kept, and the one that lacks is interpolated linearly between
    measured rows that are up to `LONGEST_S` apart.

    Args:
        name: Named by the report.
        block: Forces and rates, or one of them; stamps that do not decrease. Rows may be not a number on all axes.
        notes: Collects the number of rows.

    Returns:
        The stream; the same one if every row is measured.

    Raises:
        StrideTwinError: Nearly all rows of a quantity have no measurement, unless lenient.
    """
    if len(block) < FEWEST or np.any(np.diff(block.t_ns) < 0):
        return block
    block = drop_repeated_rows(name, block, notes)
    flags: dict[str, Flags] = {}  # rows that lack, by column
    for column, quantity in QUANTITIES.items():
        if column not in block.columns:
            continue
        lacking = find_unmeasured(quantity, block.columns[column])
        if lacking.any():
            is_empty = np.isnan(block.columns[column]).all(axis=1)
            _report(name, quantity, lacking, int(np.sum(is_empty)), notes)
            flags[column] = lacking
        elif (held := find_held(block.columns[column])).any():
            notes.warn(
                f"{name}: {int(held.sum())} of {len(held)} rows repeat the {_WHAT[quantity]} of the row before, as of "
                "a slower sensor: left out, and interpolated"
            )
            flags[column] = held
        elif (frozen := find_frozen(quantity, block.columns[column])).any():
            notes.warn(
                f"{name}: {int(frozen.sum())} of {len(frozen)} rows repeat the same {_WHAT[quantity]} for long, as of "
                f"a sensor that stood still: left out, and interpolated over up to {LONGEST_S:g} s"
            )
            flags[column] = frozen
    if not flags:
        return block
    columns = dict(block.columns)
    kept: Flags = np.ones(len(block), bool)
    if all(column in flags for column in columns if column in QUANTITIES):
        kept = ~np.all(list(flags.values()), axis=0)
    for column, lacking in flags.items():
        columns[column], is_near = _interpolate(block.t_ns, columns[column], lacking)
        kept &= is_near
    return replace(block, columns=columns)[kept]


def _interpolate(t_ns: Stamps, values: Array, lacking: Flags) -> tuple[Array, Flags]:
    """Values (N, 3) with rows that lack interpolated, and (N,) whether measured rows are near enough for that.

    Args:
        t_ns: (N,) stamps.
        values: (N, 3) numbers.
        lacking: (N,) rows without a measurement.
    """
    at = np.flatnonzero(~lacking)
    if not len(at):
        return values, np.zeros(len(values), bool)
    places = np.searchsorted(at, np.arange(len(values)))  # index in `at` of the measured row at or after each
    after, before = at[np.minimum(places, len(at) - 1)], at[np.maximum(places - 1, 0)]
    is_inside = (places > 0) & (places < len(at))
    is_near = ~lacking | (is_inside & (t_ns[after] - t_ns[before] <= LONGEST_S * 1e9))
    since, known = (t_ns - t_ns[0]).astype(np.float64), (t_ns[at] - t_ns[0]).astype(np.float64)
    result = np.array(values)
    for axis in range(values.shape[1]):
        result[lacking, axis] = np.interp(since[lacking], known, values[at, axis])
    return result, is_near


def _find_fills(quantity: str, values: Array, filled: Flags, fill: float, measured: Flags) -> Flags:
    """The rows of a fill value whose neighbours are clearly others.

    Args:
        quantity: `accel` or `gyro`.
        values: (N, 3) m/s² or rad/s.
        filled: (N,) rows of the fill value.
        fill: The value.
        measured: (N,) rows that are surely measured, if any are.
    """
    none: Flags = np.zeros(len(values), bool)
    at = np.flatnonzero(measured)
    if len(at) < 2:
        return none
    places = np.arange(len(values))
    # the deviation of each row from the value, interpolated between the measured rows around
    around = np.stack([np.interp(places, at, values[at, axis] - fill) for axis in range(3)])
    deviation = np.abs(around).max(axis=0)
    sizes = np.abs(values[at])
    resolution = float(sizes[sizes > 0].min(initial=np.inf))  # the least number that the sensor gives
    begins, ends, runs = _find_runs(filled)
    clear = np.array([deviation[b:e].min() if e > b else 0.0 for b, e in zip(begins, ends)])
    is_short = runs <= _SHORTEST_RUN
    if _stands_alone(measured) and len(begins) > 0:  # as a slower sensor in the rows of a faster one
        is_short |= True
    threshold = np.where(is_short, _CLEAR * resolution, _FAST[quantity])
    for begin, end, counts in zip(begins, ends, clear > threshold):
        none[begin:end] = counts
    return none


def _find_runs(filled: Flags) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """First row, row after the last one, and number of rows of each run."""
    edges = np.diff(np.concatenate(([0], filled.astype(np.int8), [0])))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return begins, ends, ends - begins


def _stands_alone(measured: Flags) -> bool:
    """Whether most of the measured rows have no measured neighbour."""
    _, _, runs = _find_runs(measured)
    return bool(len(runs)) and float(np.median(runs)) <= 1.0 and int(runs.sum()) < 2 * len(runs)


def _report(name: str, quantity: str, lacking: Flags, empty: int, notes: Notes) -> None:
    """Reports how many rows of a quantity have no measurement and are left out.

    Args:
        name: Named by the report.
        quantity: `accel` or `gyro`.
        lacking: (N,) rows without a measurement.
        empty: Number of those of them that are empty, as in tables of several sensors.
        notes: Collects the report.

    Raises:
        StrideTwinError: Nearly all rows that are not empty have none, unless lenient.
    """
    count = int(lacking.sum())
    what = _WHAT[quantity]
    if count == len(lacking) or count - empty > _MOST_SHARE * (len(lacking) - empty):
        value = f"zeros, fill values or empty cells in {count} of {len(lacking)} rows"
        valid = f"measured {what} in most rows; is the sensor switched on, and is it the right column?"
        notes.add_error(ConfigError(notes.path, f"{name}, {quantity}", value, valid))
    notes.warn(
        f"{name}: {count} of {len(lacking)} rows have no {what} (zeros, a fill value or empty cells, unlike the rows "
        f"around): left out, and interpolated where measured rows are up to {LONGEST_S:g} s apart"
    )
