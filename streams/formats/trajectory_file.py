"""Trajectories as tools write them: TUM, EuRoC, ORB-SLAM, OpenVINS, VINS-Fusion, KITTI, evo, and tables with names.

A header says which column is what. Without one the number of columns and unit norms do, and the size of the stamps
beside the span of the recording gives their unit. What remains open, such as the order of a quaternion, is an option.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.bounded import read_lines
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.text_encoding import detect_encoding
from stridetwin.streams.formats.trajectory_columns import (
    METRES,
    W_FIRST,
    W_LAST,
    Columns,
    columns_by_numbers,
    is_number,
    order_of,
    with_order,
)
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS, TrajectoryOptions
from stridetwin.streams.formats.trajectory_rows import TUM, TrajectoryRows, read_rows, split_cells, to_number
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Units of stamps, and how many nanoseconds each has."""
_LATEST_S = 9e9
"""Latest stamp, s: the range of nanoseconds in 64 bits ends at 9.2e9."""
_FARTHEST_M = 1e9
"""Farthest position, m: the earth is a hundredth of that, and squares of larger errors tell nothing."""
_FORMS = f"8 numbers: {TUM}, more columns with a header that names them, or the 12 numbers of KITTI with --times"
"""What an error says of rows of another form."""
_ANGLES = "a quaternion; angles are not read (scipy's Rotation.from_euler converts them, in the order of the tool)"
"""What an error says of angles in place of a quaternion."""
_EULER = re.compile(r"roll|pitch|yaw|euler", re.IGNORECASE)
"""Names of columns with angles."""
_UNIT = "a unit quaternion; a header that names the columns says where it is, such as # t id x y z qw qx qy qz"
_LARGEST = {"s": 1e11, "ms": 1e14, "us": 1e17}
"""Larger stamps, which would be times after the year 5000, have a smaller unit."""
_MOST_INSIDE, _LEAST_SPAN, _STEPS_S = 0.9, 0.3, (0.002, 1.0)
"""Stamps have another unit than their size says if with it this share of them lies within the recording, and they span
this share of it or have usual steps."""
_FASTEST_MPS, _SPEED_STEP_S = 15.0, 0.5
"""Half of the speeds over such a time are above this one: no wearer is so fast, and positions are in another unit."""
_EQUAL, _MOVING_M, _FEWEST_POSES = 1e-6, 1.0, 10
"""Attitudes that differ by less are the same; it is said of so many poses that move by this distance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryFile:
    """A trajectory as it was read.

    Attributes:
        path: The poses.
        order: Order of the quaternion that was assumed, `xyzw` or `wxyz`.
        is_order_known: The user, a header or the form of the file fixes the order.
    """

    path: Trajectory
    order: str = W_LAST
    is_order_known: bool = True

    def with_other_order(self) -> TrajectoryFile:
        """This trajectory with each quaternion read in the other order: w first in place of w last, or the reverse."""
        # (w, x, y, z) read from `a b c d`: (d, a, b, c) with w last, and (a, b, c, d) with w first
        steps, order = (-1, W_FIRST) if self.order == W_LAST else (1, W_LAST)
        q = np.roll(self.path.q_world_frame, steps, axis=1)
        return replace(self, path=replace(self.path, q_world_frame=q), order=order)


def read_trajectory(
    path: str | Path,
    options: TrajectoryOptions = NO_OPTIONS,
    *,
    span_ns: tuple[int, int] | None = None,
    notes: Notes | None = None,
) -> TrajectoryFile:
    """Reads a trajectory of any of the usual forms; `#` begins a comment, and quaternions are normalised.

    Args:
        path: The file.
        options: What the user says about it.
        span_ns: First and last stamp of the recording that it belongs to, ns; helps to recognise the unit of stamps.
        notes: Collects assumptions.

    Returns:
        Poses in metres with stamps in ns, increasing, and the order of the quaternion.

    Raises:
        StrideTwinError: The file cannot be read, a row is invalid, or its form is unknown; the message names the line
            and column, or the option that says what is missing.
    """
    notes = notes or Notes(Path(path), lenient=False)
    rows = read_rows(path)
    columns = _choose_columns(rows, notes)
    if rows.columns is None and columns.time:  # the words of stamps that are not in the first column
        rows = read_rows(path, columns)
    if options.quaternion and columns.quaternion:
        columns = with_order(columns, options.quaternion, is_known=True)
    _leave_out_rows(rows, columns, notes)
    p, q = _read_poses(rows, columns)
    p = p * METRES[options.length_unit or columns.length_unit or "m"]
    t_ns = _read_times(rows, columns, options, span_ns, notes)
    trajectory = Trajectory(t_ns=t_ns, p_frame_in_world=p, q_world_frame=q)
    _report_implausible(trajectory, notes)
    if not columns.quaternion:
        return TrajectoryFile(path=trajectory)
    return TrajectoryFile(path=trajectory, order=order_of(columns), is_order_known=columns.is_order_known)


def _choose_columns(rows: TrajectoryRows, notes: Notes) -> Columns:
    """The columns of the header, or those that the numbers tell; a header that is not understood is reported.

    Raises:
        ConfigError: The rows have no known form.
    """
    header = rows.header
    columns = rows.columns or columns_by_numbers(rows.table, has_commas=rows.has_commas)
    if rows.columns is None and _EULER.search(header):
        raise ConfigError(rows.path, "header", header[:120], _ANGLES)
    if columns is None:
        text = " ".join(f"{value:g}" for value in rows.table[0])
        raise ConfigError(rows.path, f"line {rows.lines[0]}", text, _FORMS)
    if header:
        notes.warn(
            f"names of its columns that are not known, {header[:120]}: its columns are read as {_describe(columns)}"
        )
    return columns


def _describe(columns: Columns) -> str:
    """The columns in the order of the file, such as `t x y z qx qy qz qw`; `R` is a matrix with its position."""
    if columns.matrix:
        return "a matrix [R | t]"
    names = {} if columns.time is None else {columns.time: "t"}
    names |= dict(zip((*columns.position, *columns.quaternion), ("x", "y", "z", "qx", "qy", "qz", "qw")))
    return " ".join(names[place] for place in sorted(names))


def _leave_out_rows(rows: TrajectoryRows, columns: Columns, notes: Notes) -> None:
    """Leaves out the rows whose pose is no number in any cell, and reports these and the rows that came twice.

    Tools write them where the tracking was lost, and where messages of other topics have rows of their own.
    """
    if rows.repeated:
        notes.warn(f"rows that repeat the one before are left out: {rows.repeated}")
    pose = rows.table[:, [*columns.position, *(columns.matrix or columns.quaternion)]]
    is_empty = np.asarray(np.isnan(pose).all(axis=1))
    if is_empty.any() and not is_empty.all():
        notes.warn(f"{int(is_empty.sum())} of its {len(pose)} rows have no pose, and are left out")
        rows.keep(~is_empty)


def _report_implausible(path: Trajectory, notes: Notes) -> None:
    """Reports positions that no wearer could follow in their unit, and attitudes that are none."""
    p, t_ns = path.p_frame_in_world, path.t_ns
    later = np.searchsorted(t_ns, t_ns + int(_SPEED_STEP_S * 1e9))
    now = np.flatnonzero(later < len(t_ns))
    if len(now):
        with np.errstate(over="ignore"):  # of absurd positions
            step_m = np.linalg.norm(p[later[now]] - p[now], axis=1)
        speed_mps = float(np.median(step_m / (1e-9 * (t_ns[later[now]] - t_ns[now]))))
        if speed_mps > _FASTEST_MPS:
            causes = "are they in cm or mm (--length-unit), or are its stamps in another unit (--time-unit)?"
            notes.warn(f"its positions move at {speed_mps:.3g} m/s: {causes}")
    if len(p) < _FEWEST_POSES or np.ptp(p, axis=0).max() < _MOVING_M:
        return
    if np.abs(path.q_world_frame - path.q_world_frame[0]).max() < _EQUAL:
        notes.warn("all its attitudes are the same, as of positions alone: what depends on the attitude is not valid")


def _read_poses(rows: TrajectoryRows, columns: Columns) -> tuple[Array, Array]:
    """Positions (N, 3) m, and unit quaternions (N, 4), (w, x, y, z), of all rows.

    Raises:
        ConfigError: A number is not finite or too large, or an attitude is no rotation.
    """
    table = rows.table
    p = table[:, list(columns.position)]
    rotation = table[:, list(columns.matrix or columns.quaternion)]
    names = ["r" + str(i) for i in range(9)] if columns.matrix else ["qx", "qy", "qz", "qw"]
    for values, of_values, places in (
        (p, ["x", "y", "z"], columns.position),
        (rotation, names, columns.matrix or columns.quaternion),
    ):
        _check_finite(rows, values, of_values, places)
    return p, _to_rotations(rows, rotation)


def _to_rotations(rows: TrajectoryRows, rotation: Array) -> Array:
    """Unit quaternions (N, 4), (w, x, y, z), from quaternions (N, 4), (x, y, z, w), or matrices (N, 9).

    Raises:
        ConfigError: One is no rotation.
    """
    if rotation.shape[1] == 4:
        norm = np.linalg.norm(rotation, axis=1)
        valid = _UNIT if rotation.any() else "a unit quaternion; the tool has written no attitudes, 0 0 0 0 in all rows"
        _check_rows(rows, (norm > 0.9) & (norm < 1.1), rotation, "qx qy qz qw", valid)
        return np.asarray(rotation[:, [3, 0, 1, 2]] / norm[:, None])
    from scipy.spatial.transform import Rotation  # here, as its import would double the start time of the command line

    R = rotation.reshape(-1, 3, 3)
    error = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    is_right = (error < 0.1) & (np.linalg.det(R) > 0)
    _check_rows(rows, is_right, rotation, "rotation", "a rotation matrix of determinant 1")
    return np.asarray(Rotation.from_matrix(R).as_quat(scalar_first=True))


def _check_rows(rows: TrajectoryRows, fits: NDArray[np.bool_], values: Array, field_name: str, valid: str) -> None:
    """Raises ConfigError for the first row that does not fit."""
    if not fits.all():
        first = int(np.argmin(fits))
        raise ConfigError(rows.path, f"line {rows.lines[first]}, {field_name}", values[first].tolist(), valid)


def _check_finite(rows: TrajectoryRows, values: Array, names: Sequence[str], places: Sequence[int]) -> None:
    """Raises ConfigError for the first number that is not finite or too large; it shows the cell as it stands.

    Args:
        rows: The rows.
        values: (N, K) their numbers.
        names: K names.
        places: Their K places in a row.
    """
    fits = np.abs(values) < _FARTHEST_M  # False for NaN
    if fits.all():
        return
    row, at = (int(i) for i in np.argwhere(~fits)[0])
    line = rows.lines[row]
    texts = enumerate(read_lines(Path(rows.path), detect_encoding(Path(rows.path))), 1)
    text = next(text for number, text in texts if number == line)
    cells = split_cells(text.partition("#")[0], keeps_empty=True)
    cell = cells[places[at]] if places[at] < len(cells) else ""
    valid = f"a finite number, {-_FARTHEST_M:g} to {_FARTHEST_M:g}"
    raise ConfigError(rows.path, f"line {line}, {names[at]}", cell, valid)


def _read_times(
    rows: TrajectoryRows, columns: Columns, options: TrajectoryOptions, span_ns: tuple[int, int] | None, notes: Notes
) -> NDArray[np.int64]:
    """Stamps (N,) ns of all rows, increasing.

    Raises:
        ConfigError: A stamp is invalid, or there is none and no `--times`; or they are not those of the recording.
    """
    path: str | Path = rows.path
    stamps, lines = rows.stamps, list(rows.lines)
    if options.times is not None:
        path = options.times
        stamps, lines = _read_times_file(rows, columns, options.times)
    elif columns.time is None:
        valid = "a stamp in each row, or --times FILE with one stamp per row (times.txt of KITTI)"
        raise ConfigError(path, "time stamps", None, valid)
    unit = _choose_unit(path, lines, stamps, columns, options, span_ns, notes)
    t_ns = _to_nanoseconds(path, lines, stamps, unit, round(options.time_offset_s * 1e9))
    if span_ns is not None:
        _check_span(rows.path, t_ns, unit, span_ns, notes)
    return t_ns


def _read_times_file(rows: TrajectoryRows, columns: Columns, file: Path) -> tuple[list[str], list[int]]:
    """The stamps of a file with one per row, and the numbers of their lines.

    Where the trajectory has whole numbers in place of stamps, such as those of frames, they select the rows.

    Raises:
        ConfigError: The file has another number of rows, or the trajectory has stamps.
    """
    times = [
        (cells[0], number)
        for number, line in enumerate(read_lines(file, detect_encoding(file)), 1)
        if (cells := split_cells(line.partition("#")[0])) and is_number(cells[0])
    ]
    if columns.time is not None:
        frames = rows.table[:, columns.time]
        if not (np.all(frames == np.floor(frames)) and frames.min() >= 0 and frames.max() < len(times)):
            valid = f"no --times for rows with stamps, or numbers of its {len(times)} rows, from 0 on, in their place"
            raise ConfigError(rows.path, "time stamps", rows.stamps[0], valid)
        times = [times[int(i)] for i in frames]
    elif len(times) != len(rows.stamps):
        raise ConfigError(file, "rows", len(times), f"{len(rows.stamps)}, one stamp for each pose of {rows.path}")
    return [stamp for stamp, _ in times], [number for _, number in times]


def _choose_unit(
    path: str | Path,
    lines: Sequence[int],
    stamps: Sequence[str],
    columns: Columns,
    options: TrajectoryOptions,
    span_ns: tuple[int, int] | None,
    notes: Notes,
) -> str:
    """The unit of the stamps: the user's, the header's, or the one with which they fit the recording, or their size.

    Args:
        path: File of the stamps, for errors.
        lines: Numbers of their lines.
        stamps: (N,) words.
        columns: With the unit of a header.
        options: Of the user.
        span_ns: First and last stamp of the recording, ns; None if not known.
        notes: Collects a unit that was assumed.

    Raises:
        ConfigError: A stamp is no finite number.
    """
    values = np.array([to_number(word) for word in stamps])
    fits = np.isfinite(values)
    if not fits.all():
        first = int(np.argmin(fits))
        raise ConfigError(path, f"line {lines[first]}, t", stamps[first], "a finite number")
    if unit := options.time_unit or (columns.unit if options.times is None else ""):
        return unit
    largest = float(np.abs(values).max())
    by_size = next((unit for unit, most in _LARGEST.items() if largest < most), "ns")
    if span_ns is None:
        return by_size
    with np.errstate(over="ignore", invalid="ignore"):  # of absurd stamps, which an error names below
        by_span = [unit for unit in UNITS if _fits_span(values * UNITS[unit], span_ns, options.time_offset_s)]
    if by_size in by_span or len(by_span) != 1:
        return by_size
    notes.warn(f"its stamps are read as {by_span[0]}, with which they fit the recording; --time-unit says another unit")
    return by_span[0]


def _fits_span(t_ns: Array, span_ns: tuple[int, int], offset_s: float) -> bool:
    """Whether stamps (N,) in ns lie within a recording, and span a good part of it or have usual steps."""
    t_ns = t_ns + 1e9 * offset_s
    first, last = span_ns
    margin = 0.01 * (last - first)
    inside = np.mean((t_ns >= first - margin) & (t_ns <= last + margin))
    step_s = float(np.median(np.diff(t_ns))) * 1e-9 if len(t_ns) > 1 else 0.0
    is_long = t_ns[-1] - t_ns[0] > _LEAST_SPAN * (last - first)
    return bool(inside >= _MOST_INSIDE and (is_long or _STEPS_S[0] <= step_s <= _STEPS_S[1]))


def _to_nanoseconds(
    path: str | Path, lines: Sequence[int], stamps: Sequence[str], unit: str, offset_ns: int
) -> NDArray[np.int64]:
    """Stamps (N,) ns from words, exact; digits below a nanosecond are cut off.

    Raises:
        ConfigError: One is negative or beyond the range of 64-bit nanoseconds, or not after the one before it.
    """
    t_ns = np.empty(len(stamps), np.int64)
    before = -1
    for i, word in enumerate(stamps):
        try:
            value = int(Decimal(word) * UNITS[unit]) + offset_ns
        except (ArithmeticError, ValueError):
            value = -1
        if not 0 <= value < _LATEST_S * 1e9:
            valid = f"a time in {unit} from 0 to {_LATEST_S * 1e9 / UNITS[unit]:g}; --time-unit says another unit"
            raise ConfigError(path, f"line {lines[i]}, t", word, valid)
        if value <= before:
            hint = "" if unit == "s" else f" (in {unit}; --time-unit says another unit)"
            cause = (
                "have the stamps lost digits?" if value == before else "are these two runs in one file, or unsorted?"
            )
            valid = f"a time after that of the previous row{hint}; {cause}"
            raise ConfigError(path, f"line {lines[i]}, t", word, valid)
        t_ns[i] = before = value
    return t_ns


def _check_span(path: str | Path, t_ns: NDArray[np.int64], unit: str, span_ns: tuple[int, int], notes: Notes) -> None:
    """Refuses stamps of another clock than the recording's, and warns if most lie outside of it.

    Raises:
        ConfigError: Fewer than two stamps lie within the recording; the message has the option that shifts them.
    """
    inside = int(((t_ns >= span_ns[0]) & (t_ns <= span_ns[1])).sum())
    span = f"the recording's {_span_text(*span_ns)}"
    if len(t_ns) == 1:
        raise ConfigError(path, "rows", 1, "at least 2 poses")
    if inside < 2:
        likely_unit = _unit_by_duration(t_ns, unit, span_ns)
        shift = (span_ns[0] - int(t_ns[0]) * UNITS[likely_unit] / UNITS[unit]) * 1e-9
        advice = "" if likely_unit == unit else f"--time-unit {likely_unit}, with which they last as long, and "
        cause = f"in {unit}: is it another clock? {advice}--time-offset {shift:.3f} begins with the recording"
        cause += "; or --time-unit" if likely_unit == unit else ""
        stamps = f"{_span_text(int(t_ns[0]), int(t_ns[-1]))}"
        raise ConfigError(path, "time stamps", stamps, f"at least 2 of {len(t_ns)} within {span}, {cause}")
    if inside < 0.5 * len(t_ns):
        cause = "--time-unit or --time-offset mends stamps, --times those that are numbers of frames"
        notes.warn(f"only {inside} of its {len(t_ns)} poses lie within {span}: {cause}")


def _unit_by_duration(t_ns: NDArray[np.int64], unit: str, span_ns: tuple[int, int]) -> str:
    """The unit with which stamps last about as long as the recording; the given one if it does so, or none does."""
    durations_ns = {each: float(t_ns[-1] - t_ns[0]) * UNITS[each] / UNITS[unit] for each in (unit, *UNITS)}
    recorded_ns = span_ns[1] - span_ns[0]
    return next((u for u, lasts in durations_ns.items() if 0.5 * recorded_ns < lasts < 1.5 * recorded_ns), unit)


def _span_text(first_ns: int, last_ns: int) -> str:
    """Two times as text: `0.000-22.150 s`."""
    return f"{first_ns / 1e9:.3f}-{last_ns / 1e9:.3f} s"
