"""Rows of an inertial stream that are no measurements of their own: zeros, fill values, repeated and lost rows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from stridetwin.streams.samples import Array, Stamps

QUANTITIES: Mapping[str, str] = {"specific_force": "accel", "angular_rate": "gyro"}
"""Quantity of each column of an `Imu`."""
Flags = npt.NDArray[np.bool_]
"""(N,) whether each row is of a kind."""
_LONGEST_SHORT_RUN = 3
"""Rows of the longest run of equal rows that counts as no measurement beside any numbers that are clearly others."""
_CLEAR = 8.0
"""Steps of the numbers' resolution by which the rows around are others."""
_FAST: Mapping[str, float] = {"accel": 2.0, "gyro": 0.5}
"""By how much the rows at both ends of a longer run must be others, m/s² or rad/s."""
_CHANCE_ROWS, _CHANCE_SHARE = 2, 0.001
"""Number of rows, and share of the rows beyond it, in which a coarse sensor has three equal numbers by chance: 2 of
9300 rows of a gyroscope did, and 2 of 1859 of an accelerometer."""
_FEWEST_FILLS = 2
"""Rows with three equal numbers from which on the number may be a fill value."""
_FEWEST_READINGS, _LEAST_HELD = 10, 0.02
"""Readings in motion that must be held for several rows, and their share among all readings in motion."""
_LEAST_ZEROS, _CLEARLY = 0.05, 3.0
"""Share of rows with a zero on one axis that count as no measurement, and by how many usual steps the rows around are
others."""
_STUCK_ROWS, _MOST_STUCK = 5, 3
"""Fewest equal rows that count as those of a sensor that stood still, if a jump is at one of their ends; and most runs
of them without a jump, of a sensor whose noise lets no other row repeat."""
_MOST_FILLS = 16
"""Most values that are tried, the most frequent ones first."""
_FEWEST_FROZEN = 3
"""Repeated rows in motion that are needed to be noticed."""
_MOVES: Mapping[str, float] = {"accel": 0.1, "gyro": 0.01}
"""Least step of the row before a repeated one, m/s² or rad/s, in motion."""
_JUMPS = 3.0
"""Multiple of `_MOVES` by which the numbers go on after a longer run."""
_ALIGNED, _ASIDE, _ABOVE_NOISE = 0.8, 0.4, 3.0
"""Cosine of the slopes on both sides of a jump, share of it that may point elsewhere, and multiple of the noise
that the slopes have, for a jump that is told from a strike."""
_JUMP, _WIDE_JUMP = 1.8, 2.5
"""Steps in one, from which on one row is missing, and from which on several are."""
_FEWEST_JUMPS, _JUMP_SHARE = (4, 3), (0.001, 0.0005)
"""Jumps of each kind that are needed, and share of the moving rows that jump by chance. None of 90 sound streams of
real and simulated feet, legs, trunks and heads at 100 to 400 Hz has two of the first kind, or one of the second."""
LOST_ROW_PERIODS = 1.6
"""Periods between two stamps from which on the stamps show that rows are missing: jitter is less."""
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

    Returns:
        (N,) whether a row has no measurement.
    """
    empty = np.asarray(np.isnan(values).all(axis=1), bool)
    for axis in range(values.shape[1]):
        empty |= _find_zeros(values[:, axis])
    finite = np.asarray(np.isfinite(values).all(axis=1), bool)
    equal = finite & (values[:, 0] == values[:, 1]) & (values[:, 1] == values[:, 2])
    if not equal.any() or len(values) < _LONGEST_SHORT_RUN:
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
    flags: Flags = np.zeros(len(values), bool)
    is_zero = values == 0.0
    at = np.flatnonzero(~is_zero & np.isfinite(values))
    if len(at) < 2 or np.count_nonzero(is_zero) < _LEAST_ZEROS * len(values):
        return flags
    around = np.abs(np.interp(np.arange(len(values)), at, values[at]))
    resolution = float(np.abs(values[at]).min())
    typical = float(np.median(np.abs(np.diff(values[at]))))  # step between measured rows
    for begin, end, length in zip(*_find_runs(is_zero)):
        clear = around[begin:end].min()
        flags[begin:end] = length <= _LONGEST_SHORT_RUN and clear > _CLEAR * resolution and clear > _CLEARLY * typical
    return flags if np.count_nonzero(flags) >= _LEAST_ZEROS * len(values) else np.zeros(len(values), bool)


def find_held(values: Array) -> Flags:
    """Finds the rows that only repeat the row before, as where a slower sensor is published as fast as another one.

    Rows that repeat by chance, as of a coarse sensor at rest, are none: many rows must repeat in motion, where the
    numbers change by far more than their resolution from one reading to the next.

    Args:
        values: (N, 3) m/s² or rad/s.

    Returns:
        (N,) whether a row repeats the one before; longer runs than twice the usual one are left to `find_stuck`.
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


def find_stuck(quantity: str, values: Array) -> Flags:
    """Finds the rows that repeat the row before for long, up to a jump, as where a sensor or its driver stood still.

    Args:
        quantity: `accel` or `gyro`.
        values: (N, 3) m/s² or rad/s.

    Returns:
        (N,) whether a row is in such a run of five rows or more.
    """
    steps = np.abs(np.diff(values, axis=0)).max(axis=1, initial=0.0)  # (N - 1,)
    stuck: Flags = np.zeros(len(values), bool)
    begins, ends, runs = _find_runs(np.concatenate(([False], steps == 0.0)))
    is_rare = len(runs) <= _MOST_STUCK and bool(np.all(runs >= _STUCK_ROWS))  # noise lets no other row repeat
    for begin, end, length in zip(begins, ends, runs):
        before = steps[begin - 2] if begin > 1 else 0.0
        after = steps[end - 1] if end - 1 < len(steps) else 0.0
        is_inside = begin > 1 and end - 1 < len(steps) and bool(values[begin].any())
        is_sudden = max(before, after) > _FAST[quantity] or (is_rare and is_inside)
        stuck[begin:end] = length >= _STUCK_ROWS and is_sudden
    return stuck


def find_lacking(columns: Mapping[str, Array]) -> dict[str, Flags]:
    """Rows (N,) in which a quantity was not measured, by its column; without the columns that are whole.

    A row whose other quantity was not measured lacks one of three equal numbers, too, however slow the movement.

    Args:
        columns: (N, 3) m/s² of `specific_force`, rad/s of `angular_rate`, or one of them.
    """
    inertial = {name: values for name, values in columns.items() if name in QUANTITIES}
    lacking = {name: find_unmeasured(QUANTITIES[name], values) for name, values in inertial.items()}
    fills = [np.asarray((np.diff(values, axis=1) == 0.0).all(axis=1), bool) for values in inertial.values()]
    is_empty = np.zeros(len(next(iter(inertial.values()), [])), bool)
    if len(inertial) > 1:
        is_empty = np.any(list(lacking.values()), axis=0) & np.all(fills, axis=0)
        lacking = {name: flags | is_empty for name, flags in lacking.items()}
    return {name: flags for name, flags in lacking.items() if _are_no_chance(flags, is_empty)}


def _are_no_chance(lacking: Flags, is_empty: Flags) -> bool:
    """Whether rows (N,) that lack one quantity, or both, are more than equal numbers of a coarse sensor."""
    _, _, sizes = _find_runs(lacking)
    is_certain = bool(is_empty.any()) or sizes.max(initial=0) >= _LONGEST_SHORT_RUN
    return bool(lacking.any()) and (is_certain or int(lacking.sum()) > _CHANCE_ROWS + _CHANCE_SHARE * len(lacking))


def find_frozen(columns: Mapping[str, Array]) -> Flags:
    """Finds the rows that repeat all numbers of the row before in motion, as where a driver had no new ones.

    Noise never repeats; a coarse or noiseless sensor does so at rest, but neither moves before nor jumps afterwards.

    Args:
        columns: (N, 3) m/s² of `specific_force`, rad/s of `angular_rate`, or one of them.

    Returns:
        (N,) whether a row repeats the one before; none is flagged if only one or two do.
    """
    inertial = {QUANTITIES[name]: values for name, values in columns.items() if name in QUANTITIES}
    steps = {
        name: np.abs(np.diff(values, axis=0)).max(axis=1, initial=0.0) for name, values in inertial.items()
    }  # (N - 1,)
    count = len(next(iter(inertial.values()))) if inertial else 0
    flags: Flags = np.zeros(count, bool)
    repeats = np.concatenate(([False], np.all([step == 0.0 for step in steps.values()], axis=0))) if inertial else flags
    if not repeats.any():
        return flags
    begins, ends, sizes = _find_runs(repeats)
    is_frozen = np.zeros(len(begins), bool)
    for name, step in steps.items():
        clear = np.maximum(_CLEAR * float(step[step > 0].min(initial=np.inf)), _MOVES[name])
        before = np.where(begins >= 2, step[np.maximum(begins - 2, 0)], 0.0)
        after = np.where(ends < count, step[np.minimum(ends, count - 1) - 1], 0.0)
        jumps = np.where(sizes <= _LONGEST_SHORT_RUN, clear, np.maximum(clear, _JUMPS * _MOVES[name]))
        is_frozen |= (before > clear) & (after > jumps)
    if sizes[is_frozen].sum() < _FEWEST_FROZEN:
        return flags
    for begin, end in zip(begins[is_frozen], ends[is_frozen]):
        flags[begin:end] = True
    return flags


def count_jumps(t_ns: Stamps, specific_force: Array, angular_rate: Array) -> int:
    """Number of steps without a gap in the stamps in which rates and forces both move on as if rows were missing.

    Such a step points where the slopes on both sides of it point, and is longer than they are; a strike, which is also
    a long step, points anywhere.

    Args:
        t_ns: (N,) increasing stamps.
        specific_force: (N, 3) m/s².
        angular_rate: (N, 3) rad/s.

    Returns:
        Their number; 0 if there are no more than by chance.
    """
    steps = np.diff(t_ns)
    if len(steps) < 6:
        return 0
    lengths, moves = zip(_measure_jumps(specific_force), _measure_jumps(angular_rate))
    both = np.all(moves, axis=0) & (steps[2:-2] < LOST_ROW_PERIODS * np.median(steps))
    length = np.minimum(*lengths)[both]
    counts = [int(np.sum(length > least)) for least in (_JUMP, _WIDE_JUMP)]
    chance = [fewest + share * len(length) for fewest, share in zip(_FEWEST_JUMPS, _JUMP_SHARE)]
    return counts[0] if any(count >= most for count, most in zip(counts, chance)) else 0


def _measure_jumps(values: Array) -> tuple[Array, Flags]:
    """How much longer the inner steps of values (N, 3) are than those around.

    Returns:
        (N - 5,) length of each step as a multiple of the mean slope on both sides of it, and (N - 5,) whether it points
        where the slopes do, and these are above the noise.
    """
    before, after = (values[2:-3] - values[:-5]) / 2, (values[5:] - values[3:-2]) / 2  # slopes per row
    step, slope = values[3:-2] - values[2:-3], (before + after) / 2
    noise = float(np.median(np.abs(np.diff(values, n=3, axis=0)))) / 2  # of third differences, which motion hardly has
    size = np.linalg.norm(slope, axis=1)
    tiny = np.finfo(float).tiny
    cosine = (before * after).sum(axis=1) / (np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1) + tiny)
    length = (step * slope).sum(axis=1) / (size**2 + tiny)
    aside = np.linalg.norm(step - length[:, None] * slope, axis=1) / (np.linalg.norm(step, axis=1) + tiny)
    return length, np.asarray((cosine > _ALIGNED) & (size > _ABOVE_NOISE * noise) & (aside < _ASIDE), bool)


def _find_fills(quantity: str, values: Array, filled: Flags, fill: float, measured: Flags) -> Flags:
    """The rows of a fill value whose neighbours are clearly others.

    Args:
        quantity: `accel` or `gyro`.
        values: (N, 3) m/s² or rad/s.
        filled: (N,) rows of the fill value.
        fill: The value.
        measured: (N,) rows that are surely measured, if any are.
    """
    flags: Flags = np.zeros(len(values), bool)
    at = np.flatnonzero(measured)
    if len(at) < 2:
        return flags
    places = np.arange(len(values))
    # the deviation of each row from the value, interpolated between the measured rows around
    around = np.stack([np.interp(places, at, values[at, axis] - fill) for axis in range(3)])
    deviation = np.abs(around).max(axis=0)
    sizes = np.abs(values[at])
    resolution = float(sizes[sizes > 0].min(initial=np.inf))  # the least number that the sensor gives
    begins, ends, runs = _find_runs(filled)
    clear = np.array([deviation[b:e].min() if e > b else 0.0 for b, e in zip(begins, ends)])
    is_short = runs <= _LONGEST_SHORT_RUN
    if _stands_alone(measured) and len(begins) > 0:  # as a slower sensor in the rows of a faster one
        is_short |= True
    threshold = np.where(is_short, _CLEAR * resolution, _FAST[quantity])
    for begin, end, counts in zip(begins, ends, clear > threshold):
        flags[begin:end] = counts
    return flags


def _find_runs(filled: Flags) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """First row, row after the last one, and number of rows of each run of rows (N,) that are true."""
    edges = np.diff(np.concatenate(([0], filled.astype(np.int8), [0])))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return begins, ends, ends - begins


def _stands_alone(measured: Flags) -> bool:
    """Whether most of the measured rows have no measured neighbour."""
    _, _, runs = _find_runs(measured)
    return bool(len(runs)) and float(np.median(runs)) <= 1.0 and int(runs.sum()) < 2 * len(runs)
