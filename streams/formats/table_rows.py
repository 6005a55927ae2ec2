"""Reads the numbers in some columns of a text table, by the texts in others."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.table_head import TableHead, is_number, parse_number
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

_EMPTY = frozenset(
    (
        "",
        "nan",
        "na",
        "n/a",
        "null",
        "none",
        "-",
        "--",
        "#n/a",
        "#nan",
        "#num!",
        "#value!",
        "#div/0!",
        "#ref!",
        "#null!",
    )
    + ("#name?", "nat", "undefined", "missing", "?", "1.#qnan", "-1.#ind", "nan(ind)", "-nan(ind)", "-nan")
)
"""Texts, in lower case, of cells without a measurement."""
_WORDS = re.compile(r".*[A-Za-z*=_]{2}|\s*[-*=#_]{3,}")
"""A text that is no damaged number, at the begin of a line that is no sample, such as `End of file` and `-----`."""
_MOST_OTHER_LINES, _FEW_OTHER_LINES = 0.02, 20
"""Lines that are no samples, as a share of the rows, up to which they are left out; so many are in any case."""
_MOST_GROUPS = 256
"""Most texts that tell rows apart; more are no names of sensors."""


@dataclass(frozen=True, kw_only=True)
class RowReader:
    """Which cells of a row are read, and what they may hold.

    Attributes:
        wanted: (K,) indices of the columns.
        times: How many of the first ones have times, which no row may lack.
        texts_at: Column of stamps that are text; its number is then 0.
        unused_at: Column whose cells may hold anything; not a number where they are no numbers.
    """

    wanted: Sequence[int]
    times: int = 1
    texts_at: int | None = None
    unused_at: int | None = None

    def read(self, cells: Sequence[str], decimal: str) -> list[float]:
        """The K numbers of a row; not a number where a cell without a measurement is allowed.

        Args:
            cells: Its cells.
            decimal: Decimal mark in place of the point; "" for the point.

        Raises:
            _CellError: A cell is missing or has something else.
        """
        if self.texts_at is None and not decimal:
            try:
                return [float(cells[at]) for at in self.wanted]
            except (ValueError, IndexError):
                pass  # a cell is empty, or no plain number
        return [self._read_cell(cells, k, decimal) for k in range(len(self.wanted))]

    def _read_cell(self, cells: Sequence[str], place: int, decimal: str) -> float:
        """The number in the cell at a place of `wanted`, as `read` gives it.

        Raises:
            _CellError: It is missing, or has something else.
        """
        at = self.wanted[place]
        text = cells[at].strip() if at < len(cells) else None
        try:
            if text is None or (at == self.texts_at and ":" not in text):
                raise ValueError(text)
            return 0.0 if at == self.texts_at else parse_number(text, decimal)
        except ValueError:
            is_empty = text is not None and place >= self.times and text.lower() in _EMPTY
            if is_empty or at == self.unused_at:
                return math.nan
            raise _CellError(at) from None

    def is_other_line(self, cells: Sequence[str]) -> bool:
        """Whether a line is no sample: a title, a repeated header, a mark of the operator, a footer."""
        if not any(is_number(cells[at]) for at in self.wanted if at < len(cells)):
            return bool(_WORDS.match(" ".join(cells)))
        first = cells[self.wanted[0]].strip() if self.times and self.wanted[0] < len(cells) else ""
        return bool(_WORDS.match(first)) and first.lower() not in _EMPTY and ":" not in first


class _CellError(Exception):
    """A cell that cannot be read; `at` is the index of its column."""

    def __init__(self, at: int) -> None:
        super().__init__(at)
        self.at = at


@dataclass
class _Group:
    """The rows of one key: numbers row after row, their count, and the stamps as text."""

    numbers: array[float] = field(default_factory=lambda: array("d"))
    count: int = 0
    texts: list[str] = field(default_factory=list)

    def add(self, numbers: Sequence[float], text: str | None) -> None:
        """Adds the numbers of a row, and its stamp as text if there is one."""
        self.numbers.extend(numbers)
        self.count += 1
        if text is not None:
            self.texts.append(text)


def read_groups(
    path: Path,
    head: TableHead,
    reader: RowReader,
    notes: Notes,
    key_at: Sequence[int] = (),
    is_used: Callable[[tuple[str, ...]], bool] = lambda key: True,
) -> dict[tuple[str, ...], tuple[Array, list[str]]]:
    """Reads some columns of the rows that are not empty as numbers.

    Lines that are no samples, such as a repeated header or a footer, and a last row that is cut off are left out.

    Args:
        path: Named by errors.
        head: Head of the table.
        reader: Which columns are read.
        notes: Collects what is left out.
        key_at: Columns whose texts tell the groups apart.
        is_used: Whether the rows of a key are read.

    Returns:
        (N, K) numbers, and N stamps as text if they are any, by the key; not a number where a cell is empty. Without
        `key_at` there is one group, of an empty key.

    Raises:
        ConfigError: A cell of a time is empty, any is missing or no number, or there are too many keys or other lines.
    """
    groups: dict[tuple[str, ...], _Group] = {} if key_at else {(): _Group()}
    row = 0  # rows so far that are not empty
    other_lines: list[str] = []  # those that are no samples
    cut: ConfigError | None = None  # the error of a short row, which is none if the row is the last one
    for cells in head.rows:
        if not any(cells):
            continue
        if cut is not None:
            raise cut
        row += 1
        key = tuple(cells[at].strip() if at < len(cells) else "" for at in key_at)
        if key_at and not is_used(key):
            continue
        try:
            numbers = reader.read(cells, head.decimal)
        except _CellError as error:
            if reader.is_other_line(cells):
                other_lines.append(", ".join(filter(None, cells)))
                continue
            value = cells[error.at] if error.at < len(cells) else None
            cut = ConfigError(path, f"{head.names[error.at]}, row {row}", value, "a number")
            if len(cells) >= len(head.names):
                raise cut from None
            continue
        group = groups.setdefault(key, _Group())
        if len(groups) > _MOST_GROUPS:
            names = ", ".join(head.names[at] for at in key_at)
            raise ConfigError(path, names, f"more than {_MOST_GROUPS} texts", "the names of a few sensors")
        group.add(numbers, None if reader.texts_at is None else cells[reader.texts_at])
    if cut is not None:
        notes.warn(f"{path.name}: the last row is cut off, and left out")
    _report_other_lines(path, other_lines, row, notes)
    width = len(reader.wanted)
    return {key: (np.array(group.numbers).reshape(group.count, width), group.texts) for key, group in groups.items()}


def _report_other_lines(path: Path, lines: Sequence[str], rows: int, notes: Notes) -> None:
    """Reports the lines that are no samples, of which the first is shown.

    Args:
        path: Named by the report.
        lines: Their cells, joined.
        rows: Number of all lines with cells.
        notes: Collects the report.

    Raises:
        ConfigError: They are too many.
    """
    if not lines:
        return
    if len(lines) > max(_FEW_OTHER_LINES, _MOST_OTHER_LINES * rows):
        value = f"{len(lines)} such as {lines[0][:60]}"
        raise ConfigError(path, "lines that are no samples", value, "rows of numbers")
    notes.warn(f"{path.name}: {len(lines)} lines among the numbers are no samples and left out: {lines[0][:60]}")
