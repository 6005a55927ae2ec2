"""Repeated stamps and short gaps of an inertial stream: bridged and reported, as a lost packet ruins no estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.row_patterns import LOST_ROW_PERIODS
from stridetwin.streams.samples import Array, Block, Sample, Stamps

LONGEST_S = 0.1
"""Longest gap that is bridged, s: a foot in swing moves by 0.4 m, and its rates are still those of one movement."""
LONGEST_PACKET_S = 0.3
"""Longest time that the rows of one stamp may fill, s: packets by radio have up to 25 samples at 100 Hz."""
_LATE = 1.2
"""Usual times from which on a group of rows with one stamp comes late."""
_EVEN, _DELAY = 0.95, 0.3
"""Share of packets of one size, and most delay as a share of their time, of packets that come at an even rate."""
FEWEST = 10
"""Samples needed to know a period."""
SampleT = TypeVar("SampleT", bound=Sample)


def bridge_gaps(name: str, block: Block[SampleT], notes: Notes) -> Block[SampleT]:
    """Makes a stream of samples even: without repeated stamps, and with samples in its short gaps.

    Repeated rows are left out. Other rows with the stamp of the row before, such as the samples of one packet, are
    spread evenly over the time until the next stamp. Gaps of up to `LONGEST_S` are filled with linear interpolation;
    longer ones stay, and are reported.

    Args:
        name: Named by reports.
        block: Columns of numbers (N, ...), stamps that do not decrease.
        notes: Collects a warning for each of these.

    Returns:
        The stream; the same one if nothing was bridged. Stamps that decrease are left as they are.

    Raises:
        StrideTwinError: Rows of one stamp would fill more than `LONGEST_PACKET_S`, unless lenient.
    """
    t_ns = block.t_ns
    if len(t_ns) < FEWEST or np.any(np.diff(t_ns) < 0) or t_ns[0] == t_ns[-1]:
        return block
    block = _spread_repeated_stamps(name, drop_repeated_rows(name, block, notes), notes)
    return _fill_gaps(name, block, notes)


def drop_repeated_rows(name: str, block: Block[SampleT], notes: Notes) -> Block[SampleT]:
    """Leaves out each row that equals the row before it in its stamp and in every column."""
    same = np.diff(block.t_ns) == 0  # (N - 1,) whether each row but the first repeats the row before it
    for column in block.columns.values():
        same &= np.all(np.diff(column, axis=0).reshape(len(same), -1) == 0, axis=1)
    if not same.any():
        return block
    notes.warn(f"{name}: {int(same.sum())} repeated rows are left out")
    return block[np.concatenate(([True], ~same))]


def _spread_repeated_stamps(name: str, block: Block[SampleT], notes: Notes) -> Block[SampleT]:
    """Spreads the rows of one stamp evenly over the time until the next stamp; the last ones by the median period.

    Rows before a gap are spread by the median period as well. Rows of one stamp that would fill more than
    `LONGEST_PACKET_S` are refused: such stamps have lost digits, or stood still.

    Args:
        name: Named by the report.
        block: Samples whose stamps do not decrease.
        notes: Collects the report.

    Raises:
        StrideTwinError: Too many rows have one stamp, unless lenient.
    """
    t_ns = block.t_ns
    first = np.flatnonzero(np.concatenate(([True], np.diff(t_ns) > 0)))  # first row of each group of one stamp
    if len(first) == len(t_ns):  # no stamp is repeated
        return block
    edges = np.append(first, len(t_ns))  # these, and the row after the last one
    counts = np.diff(edges)  # rows of each group
    spans = np.diff(t_ns[first])  # ns from each group to the next one
    period = float(np.median(spans / counts[:-1]))
    longest = int(np.argmax(counts))
    if counts[longest] > 1 and counts[longest] * period > LONGEST_PACKET_S * 1e9:
        _refuse_stamps(name, block, len(first), int(counts[longest]), int(t_ns[first[longest]]), notes)
    usual = np.maximum(counts[:-1] * period, np.median(spans))  # ns from each group to the next one, as a rule
    starts = (t_ns[first] - t_ns[0]).astype(np.float64)
    if 2 * len(first) <= len(t_ns):  # packets, not single stamps that came together
        starts = _fit_groups(starts, first) if _is_even(starts, first, counts) else _move_late_groups(starts, usual)
    spans = np.diff(starts)
    # ns that each group fills: until the next one, or less if rows are missing before that
    around = np.convolve(np.pad(spans, 1, constant_values=float(np.median(spans))), np.ones(3), "valid")
    is_gap = (spans > LOST_ROW_PERIODS * usual) & (around > LOST_ROW_PERIODS * usual + 2 * np.median(spans))
    fills = np.append(np.where(is_gap, counts[:-1] * period, spans), period * counts[-1])
    begins = np.repeat(starts, counts)
    within = np.arange(len(t_ns)) - np.repeat(first, counts)  # row in its group
    spread = begins + within * np.repeat(fills / counts, counts)
    notes.warn(f"{name}: {len(t_ns) - len(first)} repeated stamps are spread over the time until the next one")
    return replace(block, t_ns=t_ns[0] + np.rint(spread).astype(np.int64))


def _is_even(starts: Array, first: NDArray[np.int64], counts: NDArray[np.int64]) -> bool:
    """Whether groups of one size come at an even rate but for the delay of their transport, without any missing.

    Args:
        starts: (K,) times of the groups, ns.
        first: (K,) their first rows.
        counts: (K,) numbers of their rows.
    """
    if len(starts) < FEWEST or np.mean(counts[:-1] == np.median(counts)) < _EVEN:
        return False
    spans = np.diff(starts)
    deviation = np.abs(starts - _fit_groups(starts, first)).max()
    return bool(deviation < _DELAY * np.median(spans) and spans.max() < LOST_ROW_PERIODS * np.median(spans))


def _fit_groups(starts: Array, first: NDArray[np.int64]) -> Array:
    """Times (K,) ns of groups on the straight line through them over the numbers of their first rows."""
    slope, offset = np.polyfit(first.astype(np.float64), starts, 1)
    return np.asarray(offset + slope * first)


def _move_late_groups(starts: Array, usual: Array) -> Array:
    """Times (K,) ns of groups of rows, with those that came late moved to where the groups around them leave room.

    Args:
        starts: (K,) times, ns.
        usual: (K - 1,) usual time from each group to the next one, ns.
    """
    spans = np.diff(starts)
    before, after = spans[:-1], spans[1:]
    both, usual_both = before + after, usual[:-1] + usual[1:]
    is_late = (before > _LATE * usual[:-1]) & (after < usual[1:]) & (both < _LATE * usual_both)
    result = np.array(starts)
    result[1:-1] = np.where(is_late, starts[:-2] + both * usual[:-1] / usual_both, starts[1:-1])
    return result


def _refuse_stamps(name: str, block: Block[SampleT], distinct: int, most: int, t_ns: int, notes: Notes) -> None:
    """Refuses stamps of which too many are equal, or records that as a problem when lenient.

    Args:
        name: Named by the error.
        block: The samples.
        distinct: Number of different stamps.
        most: Most rows of one stamp.
        t_ns: That stamp.
        notes: Collects the problem.
    """
    value = f"{distinct} different stamps in {len(block)} rows, up to {most} rows with one ({t_ns * 1e-9:.6f} s)"
    valid = (
        f"a stamp per row, or packets of up to {LONGEST_PACKET_S:g} s; were digits of the stamps lost (whole seconds, "
        "32-bit floats)? Write them in full, or give the rate of the rows of a table: --rate HZ"
    )
    notes.add_error(ConfigError(notes.path, f"{name}, t", value, valid))


def _fill_gaps(name: str, block: Block[SampleT], notes: Notes) -> Block[SampleT]:
    """Inserts samples where a step is more than 1.6 median periods long and up to `LONGEST_S`, by linear interpolation.

    A long step next to a step that is as much shorter is a late stamp, not a gap. Longer gaps are reported.

    Args:
        name: Named by the reports.
        block: Samples whose stamps increase.
        notes: Collects a report of the gaps that are filled, and of those that are too long.
    """
    t_ns = block.t_ns
    steps = np.diff(t_ns)
    period = float(np.median(steps))
    # each step together with those before and after it, ns
    around = np.convolve(np.pad(steps, 1, constant_values=round(period)), np.ones(3), "valid")
    # a gap is still long together with the two steps around it; after a late stamp, the next step is short
    is_gap = (steps > LOST_ROW_PERIODS * period) & (around > (LOST_ROW_PERIODS + 2) * period)
    short = is_gap & (steps <= LONGEST_S * 1e9)  # the gaps that are filled
    if (long := is_gap & ~short).any():
        at = int(np.argmax(long))  # the first of them
        report = f"{int(long.sum())} gaps of more than {LONGEST_S:g} s are not bridged"
        notes.warn(f"{name}: {report}, the first of them {steps[at] * 1e-9:.3g} s at {t_ns[at] * 1e-9:.6f} s")
    if not short.any():
        return block
    missing = np.where(short, np.rint(steps / period).astype(np.int64) - 1, 0)  # samples to insert after each
    stamps = _insert_stamps(t_ns, missing)
    longest = float(steps[short].max()) * 1e-6
    report = f"{int(short.sum())} gaps of up to {longest:.3g} ms are bridged by {int(missing.sum())} samples"
    notes.warn(f"{name}: {report}, interpolated linearly")
    columns = {n: _interpolate(stamps, t_ns, column) for n, column in block.columns.items()}
    return replace(block, t_ns=stamps, columns=columns)


def _insert_stamps(t_ns: Stamps, missing: Stamps) -> Stamps:
    """The stamps (N,) with `missing` (N - 1,) evenly spaced ones inserted after each but the last, ns."""
    places = np.concatenate(([0], np.cumsum(missing + 1)))  # row of each known stamp in the result
    since = np.interp(np.arange(places[-1] + 1), places, (t_ns - t_ns[0]).astype(np.float64))  # ns since the first row
    stamps = t_ns[0] + np.rint(since).astype(np.int64)
    stamps[places] = t_ns  # exactly
    return np.asarray(stamps, np.int64)


def _interpolate(stamps: Stamps, t_ns: Stamps, column: Array) -> Array:
    """Values of a column (N, ...) at the given stamps (M,) ns, linear between those at `t_ns` (N,): (M, ...)."""
    # both kinds of stamps, ns since the first row
    since, known = (stamps - t_ns[0]).astype(np.float64), (t_ns - t_ns[0]).astype(np.float64)
    flat = column.reshape(len(t_ns), -1)
    values = np.column_stack([np.interp(since, known, flat[:, k]) for k in range(flat.shape[1])])
    return np.asarray(values.reshape(len(stamps), *column.shape[1:]))
