"""Which column of a trajectory is what: by the names in its header, else by the number of columns and by unit norms."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.samples import Array

W_FIRST, W_LAST = "wxyz", "xyzw"
ORDERS = (W_LAST, W_FIRST)
"""Orders of the four numbers of a quaternion in a file."""
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
_UNIT = re.compile(r"[\[(]([^\])]*)[\])]")
_TIME = re.compile(r"t|.*time.*|.*stamp.*|t_(s|ms|us|ns)|secs?|seconds?")
_QUATERNION = re.compile(r"(?:.*_)?(?:q|quat|quaternion|orientation|rotation|rot)_?(?:rs_)?([wxyz])(?:_world_\w+)?")
_POSITION = re.compile(r"(?:.*_)?(?:p|t|pos|position|trans|translation|location)_?(?:rs_r_)?([xyz])(?:_m|_world_\w+)?")
_BARE_POSITION = re.compile(r"([xyz])(?:_m)?")
_QUATERNION_NORM, _ORTHONORMAL = 0.1, 0.05
"""How far the norm of a quaternion, and the entries of a rotation times its transpose, may be off."""
_EUROC, _KITTI, _SQUARE = 17, 12, 16
"""Columns of EuRoC's ground truth, and of matrices of three and of four rows."""


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Places of the columns of a trajectory, counted from 0.

    Attributes:
        time: Of the stamp; None for a file without stamps.
        position: Of x, y, z; of a matrix the last column.
        quaternion: Of x, y, z, w; empty where the attitude is a matrix.
        matrix: Of the nine entries of the rotation by rows; empty where the attitude is a quaternion.
        is_order_known: The header, or the form of the file, fixes the order of the quaternion.
        unit: Unit of the stamps by the header; "" if it does not say it.
    """

    time: int | None
    position: tuple[int, ...]
    quaternion: tuple[int, ...] = ()
    matrix: tuple[int, ...] = ()
    is_order_known: bool = False
    unit: str = ""


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
    time = next((i for i, name in enumerate(plain) if _TIME.fullmatch(name) and i not in taken), None)
    return Columns(
        time=time,
        position=tuple(position[axis] for axis in "xyz"),
        quaternion=tuple(quaternion[axis] for axis in W_LAST),
        is_order_known=True,
        unit="" if time is None else _unit_of(names[time]),
    )


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
    place = Columns(
        time=0 if start else None,
        position=(start, start + 1, start + 2),
        quaternion=tuple(range(start + 3, start + 7)),
    )
    if not start and not _is_unit(table, place.quaternion):
        return None
    if start and not _is_unit(table, place.quaternion) and _is_unit(table, range(1, 5)):
        # OpenVINS writes its state with the quaternion before the position
        return Columns(time=0, position=(5, 6, 7), quaternion=(1, 2, 3, 4), is_order_known=True)
    is_first = _begins_with_identity(table, place.quaternion)
    w_first = has_commas and (count == _EUROC or _has_nanoseconds(table)) if is_first is None else is_first
    return with_order(place, W_FIRST) if w_first else place


def with_order(columns: Columns, order: str, *, is_known: bool = False) -> Columns:
    """The columns with the quaternion in another order of the same four places: `xyzw` or `wxyz`."""
    places = sorted(columns.quaternion)
    by_axis = dict(zip(order, places))
    return Columns(
        time=columns.time,
        position=columns.position,
        quaternion=tuple(by_axis[axis] for axis in W_LAST),
        matrix=columns.matrix,
        is_order_known=is_known,
        unit=columns.unit,
    )


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
    return bool(np.mean(np.abs(norm - 1.0) < _QUATERNION_NORM) > 0.5)


def _begins_with_identity(table: Array, places: Sequence[int]) -> bool | None:
    """Whether the first quaternion is 1 0 0 0, an identity with w first; False for 0 0 0 1; None for another one."""
    first = np.abs(table[0, list(places)])
    if np.allclose(first, [1, 0, 0, 0], atol=1e-6):
        return True
    return False if np.allclose(first, [0, 0, 0, 1], atol=1e-6) else None


def _has_nanoseconds(table: Array) -> bool:
    """Whether the first stamp is a time since 1970 in nanoseconds."""
    return bool(table[0, 0] > 1e17)
