"""Reads the numbers in some columns of a text table, by the texts in others."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.table_head import TableHead
from stridetwin.streams.samples import Array

_EMPTY = frozenset(("", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "#nan"))
"""Texts, in lower case, of cells without a measurement."""
_MOST_GROUPS = 256


@dataclass
class _Group:
    """The rows of one key: numbers row after row, their count, and the stamps as text."""

    numbers: array[float] = field(default_factory=lambda: array("d"))
    count: int = 0
    texts: list[str] = field(default_factory=list)


def read_groups(
    path: Path,
    head: TableHead,
    wanted: Sequence[int],
    key_at: Sequence[int] = (),
    times: int = 1,
    texts_at: int | None = None,
    unused_at: int | None = None,
    is_used: Callable[[tuple[str, ...]], bool] = lambda key: True,
) -> dict[tuple[str, ...], tuple[Array, list[str]]]:
    """Reads some columns of the rows that are not empty as numbers.

    Args:
        path: Named by errors.
        head: Head of the table.
        wanted: (K,) indices of the columns.
        key_at: Columns whose texts tell the groups apart.
        times: How many of the first ones have times, which no row may lack.
        texts_at: Column of stamps that are text; its number is then 0.
        unused_at: Column whose cells may hold anything; not a number where they are no numbers.
        is_used: Whether the rows of a key are read.

    Returns:
        (N, K) numbers, and N stamps as text if they are any, by the key; not a number where a cell is empty. Without
        `key_at` there is one group, of an empty key.

    Raises:
        ConfigError: A cell of a time is empty, any is missing or no number, or there are too many keys.
    """
    groups: dict[tuple[str, ...], _Group] = {} if key_at else {(): _Group()}
    may_be_empty = set(wanted[times:])
    row = 0  # rows so far that are not empty
    for cells in head.rows:
        if not any(cells):
            continue
        row += 1
        key = tuple(cells[at].strip() if at < len(cells) else "" for at in key_at)
        if key_at and not is_used(key):
            continue
        group = groups.setdefault(key, _Group())
        if len(groups) > _MOST_GROUPS:
            names = ", ".join(head.names[at] for at in key_at)
            raise ConfigError(path, names, f"more than {_MOST_GROUPS} texts", "the names of a few sensors")
        group.count += 1
        for at in wanted:
            try:
                if at == texts_at:
                    group.texts.append(cells[at])
                    group.numbers.append(0.0)
                else:
                    group.numbers.append(float(cells[at].replace(",", ".") if head.decimal else cells[at]))
            except (ValueError, IndexError):
                is_empty = at < len(cells) and cells[at].strip().lower() in _EMPTY and at in may_be_empty
                if is_empty or at == unused_at:
                    group.numbers.append(math.nan)
                    continue
                value = cells[at] if at < len(cells) else None
                raise ConfigError(path, f"{head.names[at]}, row {row}", value, "a number") from None
    return {
        key: (np.array(group.numbers).reshape(group.count, len(wanted)), group.texts) for key, group in groups.items()
    }
