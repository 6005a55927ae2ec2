"""Which column of a trajectory is what: by the names in its header, else by the number of columns and by unit norms."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stridetwin.streams.samples import QUATERNION_NORM_ERROR, Array

W_FIRST, W_LAST = "wxyz", "xyzw"
"""The two orders of the numbers of a quaternion."""
_UNITS = {
    "s": "s",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "us": "us",
    "µs": "us",
    "μs": "us",
    "usec": "us",
    "ns": "ns",
    "nsec": "ns",
    "nanoseconds": "ns",
}
"""Units of stamps as headers spell them."""
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "in": 0.0254}
"""Units of positions, and how many metres each has."""
_UNIT = re.compile(r"[\[(]([^\])]*)[\])]")
"""A unit in brackets, as in `x [mm]` and `t(s)`."""
_TIME = re.compile(r"t|.*time.*|.*stamp.*|t_(s|ms|us|ns)|secs?|seconds?")
"""Names of stamps, simplified, as `timestamp`, `t_ns` and `seconds`."""
_HEADER_STAMP = re.compile(r".*header_stamp")
"""The stamp in the header of a ROS message, which is that of the measurement; the time beside it is of its arrival."""
_SECONDS = re.compile(r"(.*_)?(?:secs?|seconds)")
"""Names of the whole seconds of a stamp in two columns, as `header_stamp_sec`; the part before it is that of both."""
_NANOSECONDS = re.compile(r"(.*_)?(?:nsecs?|nanosecs?|nanoseconds)")
"""Names of the part of such a stamp below a second, as `header_stamp_nanosec`."""
_QUATERNION = re.compile(
    r"(?:.*_)?(?:q|quat|quaternion|orientation|ori|attitude|att|rotation|rot)_?(?:rs_)?([wxyz])(?:_world_\w+)?"
)
"""Names of a number of a quaternion, as `qx`, `pose_orientation_w` and `q_rs_w`, with its axis."""
_POSITION = re.compile(
    r"(?:.*_)?(?:p|t|pos|position|pose|trans|translation|location|loc)_?(?:rs_r_)?([xyz])(?:_(?:mm|cm|m)|_world_\w+)?"
)
"""Names of a coordinate, as `tx`, `pos_x_mm` and `p_rs_r_x`, with its axis."""
_BARE_POSITION = re.compile(r"([xyz])(?:_(?:mm|cm|m))?")
"""Names of a coordinate that are axes alone, as `x` and `x_mm`."""
_ORTHONORMAL = 0.05
"""How far the entries of a rotation times its transpose may be off."""
_EUROC, _KITTI, _SQUARE = 17, 12, 16
"""Columns of EuRoC's ground truth, and of matrices of three and of four rows."""


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Places of the columns of a trajectory, counted from 0.

    Attributes:
        time: Of the stamp; None for a file without stamps.
        nanoseconds: Of the part of the stamp below a second, ns, where it has a column of its own; else None.
        position: Of x, y, z; of a matrix the last column.
        quaternion: Of x, y, z, w; empty where the attitude is a matrix.
        matrix: Of the nine entries of the rotation by rows; empty where the attitude is a quaternion.
        is_order_known: The header, or the form of the file, fixes the order of the quaternion.
        unit: Unit of the stamps by the header; "" if it does not say it.
        length_unit: Unit of the positions by the header, a key of `METRES`; "" if it does not say it.
    """

    time: int | None
    position: tuple[int, ...]
    quaternion: tuple[int, ...] = ()
    matrix: tuple[int, ...] = ()
    is_order_known: bool = False
    unit: str = ""
    nanoseconds: int | None = None
    length_unit: str = ""


def columns_by_names(names: Sequence[str]) -> Columns | None:
    """The columns by their names, such as `#timestamp [ns]`, `p_RS_R_x [m]`, `q_RS_w []`, or `tx`, `qx`.

    Returns:
        None where position and quaternion are not all named.
    """
    plain = [_simplify(name) for name in names]
    quaternion = _first_places(_QUATERNION, plain)
    position = _first_places(_POSITION, plain)
    position = position if len(position) == 3 else _first_places(_BARE_POSITION, plain)
    if len(position) < 3 or len(quaternion) < 4:
        return None
    taken = {*position.values(), *quaternion.values()}
    time, nanoseconds = _find_time({i: name for i, name in enumerate(plain) if i not in taken})
    unit = "s" if nanoseconds is not None else "" if time is None else _unit_of(names[time])
    return Columns(
        time=time,
        nanoseconds=nanoseconds,
        position=tuple(position[axis] for axis in "xyz"),
        quaternion=tuple(quaternion[axis] for axis in W_LAST),
        is_order_known=True,
        unit=unit,
        length_unit=_length_unit_of(names[position["x"]]),
    )


def find_pose_places(header: Sequence[str]) -> list[tuple[str, int]]:
    """Names and places of `tx ty tz qx qy qz qw` after a stamp, by the header if it names them, else in this order."""
    columns = columns_by_names(header)
    places = range(1, 8) if columns is None else (*columns.position, *columns.quaternion)
    return list(zip(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), places))


def _find_time(names: dict[int, str]) -> tuple[int | None, int | None]:
    """Places of the stamp and of its part in ns, of names by their places; None for what is not there.

    The stamp in a message's header counts before others, and one in two columns before the time of arrival beside it.
    """
    if (stamp := next((i for i, name in names.items() if _HEADER_STAMP.fullmatch(name)), None)) is not None:
        return stamp, None
    parts = {match[1]: i for i, name in names.items() if (match := _NANOSECONDS.fullmatch(name))}
    for i, name in names.items():
        if (match := _SECONDS.fullmatch(name)) and match[1] in parts:
            return i, parts[match[1]]
    return next((i for i, name in names.items() if _TIME.fullmatch(name)), None), None


def columns_of_ros_echo(cells: Sequence[str]) -> Columns | None:
    """The columns of a row of `ros2 topic echo --csv` of poses or odometry: sec, nanosec, frames, position, quaternion.

    Returns:
        None for another row.
    """
    if len(cells) < 10 or not all(cell.isdecimal() for cell in cells[:2]) or int(cells[1]) >= 10**9:
        return None
    start = 2 + sum(not is_number(cell) for cell in cells[2:4])
    if start == 2 or not all(map(is_number, cells[start : start + 7])) or len(cells) < start + 7:
        return None
    return Columns(
        time=0,
        nanoseconds=1,
        position=(start, start + 1, start + 2),
        quaternion=tuple(range(start + 3, start + 7)),
        is_order_known=True,
        unit="s",
    )


def is_number(word: str) -> bool:
    """Whether a word is what `float` takes as a number, also NaN or infinite; commas are none of decimals."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def is_name_of_time(name: str) -> bool:
    """Whether the name of a column is one of stamps."""
    return _TIME.fullmatch(_simplify(name)) is not None


def _simplify(name: str) -> str:
    """A name in lower case, without its unit in brackets, with `_` in place of other signs."""
    return re.sub(r"[^a-z0-9]+", "_", _UNIT.sub("", name).lower()).strip("_")


def _first_places(pattern: re.Pattern[str], names: Sequence[str]) -> dict[str, int]:
    """The first place of each axis (`w`, `x`, `y`, `z`) among names that match a pattern."""
    places: dict[str, int] = {}
    for i, name in enumerate(names):
        if match := pattern.fullmatch(name):
            places.setdefault(match[1], i)
    return places


def _unit_of(name: str) -> str:
    """The unit in the name of the stamps: `timestamp [ns]`, `timestamp(s)` or `time_us`; "" without one."""
    bracket = _UNIT.search(name)
    word = bracket[1] if bracket else name.rpartition("_")[2]
    return _UNITS.get(word.strip().lower(), "")


def _length_unit_of(name: str) -> str:
    """The unit in the name of a position: `x [mm]`, `x(cm)` or `pos_x_mm`; "" without one."""
    bracket = _UNIT.search(name)
    word = (bracket[1] if bracket else name.rpartition("_")[2]).strip().lower()
    return word if word in METRES else ""


def columns_by_numbers(table: Array, *, has_commas: bool) -> Columns | None:
    """The columns of a table without names.

    Args:
        table: (N, K) numbers, NaN where a cell is none.
        has_commas: Commas separate the cells, as in tables of EuRoC and of VINS-Fusion, whose quaternions have w first.

    Returns:
        None where the number of columns fits no form.
    """
    count = table.shape[1]
    for has_time in (False, True):
        rows = 4 if count - has_time == _SQUARE else 3
        if count - has_time in (_KITTI, _SQUARE) and _is_rotation(table[:, has_time:], rows):
            return _matrix_columns(has_time)
    if count < 7:
        return None
    start = int(count > 7)  # seven numbers are a pose without a stamp
    if count > 8 and _counts_rows(table[:, 0]) and _is_unit(table, range(5, 9)) and not _is_unit(table, range(4, 8)):
        start = 2  # the number of the row comes before its stamp
    place = Columns(
        time=start - 1 if start else None,
        position=(start, start + 1, start + 2),
        quaternion=tuple(range(start + 3, start + 7)),
    )
    if not start and not _is_unit(table, place.quaternion):
        return None
    if start and not _is_unit(table, place.quaternion) and _is_unit(table, range(1, 5)):
        # OpenVINS writes its state with the quaternion before the position, and w last
        before = Columns(time=0, position=(5, 6, 7), quaternion=(1, 2, 3, 4))
        return with_order(before, W_FIRST) if _begins_with_identity(table, before.quaternion) else before
    is_first = _begins_with_identity(table, place.quaternion)
    w_first = has_commas and (count == _EUROC or _has_nanoseconds(table)) if is_first is None else is_first
    return with_order(place, W_FIRST) if w_first else place


def with_order(columns: Columns, order: str, *, is_known: bool = False) -> Columns:
    """The columns with the quaternion in another order of the same four places.

    Args:
        columns: The columns, with a quaternion.
        order: `xyzw` or `wxyz`.
        is_known: Whether the user, or the form of the file, fixes this order.
    """
    places = sorted(columns.quaternion)
    by_axis = dict(zip(order, places))
    return replace(columns, quaternion=tuple(by_axis[axis] for axis in W_LAST), is_order_known=is_known)


def order_of(columns: Columns) -> str:
    """The order of the quaternion: `wxyz` if w stands before the others, else `xyzw`."""
    return W_FIRST if columns.quaternion[3] == min(columns.quaternion) else W_LAST


def _matrix_columns(has_time: bool) -> Columns:
    """The columns of a matrix [R | t] by rows, after a stamp or alone."""
    start = int(has_time)
    return Columns(
        time=0 if has_time else None,
        position=tuple(start + i for i in (3, 7, 11)),
        matrix=tuple(start + i for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)),
        is_order_known=True,
    )


def _is_rotation(table: Array, rows: int) -> bool:
    """Whether (N, 12 or 16) numbers are matrices [R | t] with R orthonormal, the last of four rows being 0 0 0 1."""
    matrices = table.reshape(len(table), rows, 4)
    R = matrices[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    is_last_right = rows == 3 or bool((np.abs(matrices[:, 3] - [0, 0, 0, 1]) < _ORTHONORMAL).all())
    return is_last_right and bool(np.mean(error < _ORTHONORMAL) > 0.5)


def _is_unit(table: Array, places: Sequence[int]) -> bool:
    """Whether most rows have a unit quaternion at four places."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(table[:, list(places)], axis=1)
    return bool(np.mean(np.abs(norm - 1.0) < QUATERNION_NORM_ERROR) > 0.5)


def _begins_with_identity(table: Array, places: Sequence[int]) -> bool | None:
    """Whether the first quaternion is 1 0 0 0, an identity with w first; False for 0 0 0 1; None for another one."""
    first = np.abs(table[0, list(places)])
    if np.allclose(first, [1, 0, 0, 0], atol=1e-6):
        return True
    return False if np.allclose(first, [0, 0, 0, 1], atol=1e-6) else None


def _counts_rows(numbers: Array) -> bool:
    """Whether numbers (N,) are 0, 1, 2, ... or begin with another whole number."""
    are_counts = len(numbers) > 1 and np.isfinite(numbers).all() and numbers[0] == np.floor(numbers[0])
    return bool(are_counts and np.all(np.diff(numbers) == 1.0))


def _has_nanoseconds(table: Array) -> bool:
    """Whether the first stamp is a time since 1970 in nanoseconds."""
    return bool(table[0, 0] > 1e17)
