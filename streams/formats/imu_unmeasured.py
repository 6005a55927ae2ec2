"""Rows without a measurement in an inertial stream: zeros, fill values and empty cells among other numbers.

Drivers that publish every packet, or merge sensors of different rates in one table, write such rows. They are left out
of the quantity that they lack, and the other quantity of the row is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.imu_bridging import FEWEST, LONGEST_S, SampleT, drop_repeated_rows
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.row_patterns import QUANTITIES, Flags, find_frozen, find_held, find_lacking, find_stuck
from stridetwin.streams.samples import Array, Block, Stamps

_WHAT: Mapping[str, str] = {"accel": "forces", "gyro": "rates"}
"""What messages call a quantity."""
_MOST_SHARE = 0.9
"""Share of rows without a measurement from which on the stream is refused."""


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
    lacking = find_lacking(block.columns)
    for column, quantity in QUANTITIES.items():
        if column in lacking:
            is_empty = np.isnan(block.columns[column]).all(axis=1)
            _report(name, quantity, lacking[column], int(np.sum(is_empty)), notes)
            flags[column] = lacking[column]
        elif column in block.columns and (held := find_held(block.columns[column])).any():
            notes.warn(
                f"{name}: {int(held.sum())} of {len(held)} rows repeat the {_WHAT[quantity]} of the row before, as of "
                "a slower sensor: left out, and interpolated"
            )
            flags[column] = held
        elif column in block.columns and (stuck := find_stuck(quantity, block.columns[column])).any():
            notes.warn(
                f"{name}: {int(stuck.sum())} of {len(stuck)} rows repeat the same {_WHAT[quantity]} for long, as of "
                f"a sensor that stood still: left out, and interpolated over up to {LONGEST_S:g} s"
            )
            flags[column] = stuck
    if not flags and (frozen := find_frozen(block.columns)).any():
        notes.warn(
            f"{name}: {int(frozen.sum())} of {len(frozen)} rows repeat all numbers of the row before in motion, as of "
            "a driver without new ones: left out"
        )
        return block[~frozen]
    if not flags:
        return block
    columns = dict(block.columns)
    kept: Flags = np.ones(len(block), bool)
    if all(column in flags for column in columns if column in QUANTITIES):
        kept = ~np.all(list(flags.values()), axis=0)
    for column, unmeasured in flags.items():
        columns[column], is_near = _interpolate(block.t_ns, columns[column], unmeasured)
        kept &= is_near
    return replace(block, columns=columns)[kept]


def _interpolate(t_ns: Stamps, values: Array, lacking: Flags) -> tuple[Array, Flags]:
    """Interpolates the rows without a measurement linearly between those that are measured.

    Args:
        t_ns: (N,) stamps.
        values: (N, 3) numbers.
        lacking: (N,) rows without a measurement.

    Returns:
        Values (N, 3); and (N,) whether a row is measured, or between measured rows that are up to `LONGEST_S` apart.
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
