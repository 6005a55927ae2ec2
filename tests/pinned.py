"""Numbers of a replay as a table, for comparison with the stored ones of the last version.

A pinned test fails where any number of an estimator or a score changes, also where it is still accurate enough. After
an intended change, `pytest FILE --force-regen` writes the new table, and the difference belongs to the commit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

SAME = {"rtol": 1e-6, "atol": 1e-9}
"""Tolerance between processors, whose libraries of linear algebra differ in the last digits."""
SAME_POINTS = {"rtol": 1e-4, "atol": 5e-5}
"""The same where points are selected: one on a limit is kept or not, as it is rounded."""
SAME_WALK = {"rtol": 1e-4, "atol": 1e-6}
"""The same where the twin walks: the fit of its postures iterates until a threshold."""
SAME_RATES = {"rtol": 1e-4, "atol": 5e-5}
"""The same for rates of fitted postures, rad/s: with OpenBLAS's code for SkylakeX and for Haswell (`OPENBLAS_CORETYPE`)
they differ by 3e-5."""
SAME_IMAGES = {"rtol": 1e-3, "atol": 5e-4}
"""The same where images are drawn: a few pixels round differently."""


def assert_pinned(num_regression: Any, table: dict[str, np.ndarray], tolerance: dict[str, float] = SAME) -> None:
    """Compares a table, and its number of columns, with the stored one: a column that is gone would pass otherwise."""
    assert any(len(values) for values in table.values())
    num_regression.check(table | {"columns": np.array([float(len(table))])}, default_tolerance=tolerance)


def columns(rows: Iterable[Any]) -> dict[str, np.ndarray]:
    """Column name to (N,) values of N estimates or other values; NaN where a row has no such number.

    A word counts 1 in a column of its own.
    """
    numbers = [dict(_numbers(row, "")) for row in rows]
    names = dict.fromkeys(name for row in numbers for name in row)
    return {name: np.array([row.get(name, np.nan) for row in numbers]) for name in names}


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """Every number within a value, with its path."""
    if value is None:
        return
    if isinstance(value, str):
        yield f"{name}={value}", 1.0
    elif isinstance(value, bool | int | float | np.number | np.bool_):
        yield name or "value", float(value)
    else:
        for key, inner in _parts(value):
            yield from _numbers(inner, f"{name}.{key}".lstrip("."))


def _parts(value: Any) -> Iterable[tuple[Any, Any]]:
    if is_dataclass(value):
        return ((f.name, getattr(value, f.name)) for f in fields(value))
    if isinstance(value, Mapping):
        return value.items()
    return enumerate(value)
