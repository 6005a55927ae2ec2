"""Rows of words in a text file, converted to numbers; errors name the line."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.bounded import lines
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.index import Notes, unreadable
from stridetwin.streams.samples import Array

LONGEST_STAMP = 19


@dataclass(frozen=True, slots=True)
class Row:
    """One line.

    Attributes:
        line: Its number in the file.
        text: Its text, without comments.
        separator: Between words; None is any white space.
    """

    line: int
    text: str
    separator: str | None

    @property
    def words(self) -> list[str]:
        """Its words."""
        return [w.strip() for w in self.text.split(self.separator)]


def read_text_rows(path: Path, separator: str | None) -> tuple[list[str], list[Row]]:
    """The words of the last comment (`#`) above the data, and the rows; without a separator words end at blanks.

    Raises:
        StrideTwinError: The file cannot be read.
    """
    header: list[str] = []
    rows: list[Row] = []
    try:
        for number, line in enumerate(lines(path, "utf-8-sig"), 1):
            content, mark, comment = line.partition("#")
            if content := content.strip():
                rows.append(Row(number, content, separator))
            elif mark and not rows:
                header = [w.strip() for w in comment.strip().split(separator)]
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(path, error) from error
    return header, rows


def numbers(
    path: Path, rows: list[Row], columns: Sequence[tuple[str, int]], stamp: Callable[[str], int], notes: Notes
) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,) ns from the first word of each row, and the columns (N, K).

    Args:
        path: What errors call the file.
        rows: The rows.
        columns: Name and index of each column.
        stamp: Converts a word to nanoseconds; ValueError for an invalid one.
        notes: Collects invalid rows, which are omitted when lenient.

    Raises:
        ConfigError: A word is not a number, or there is no row, unless lenient.
    """
    stamps, table = array("q"), array("d")
    for row in rows:
        words = row.words
        try:
            values = [_number(path, row, name, words[at] if at < len(words) else None) for name, at in columns]
            stamps.append(row_stamp(path, row, stamp))
            table.extend(values)
        except ConfigError as error:
            notes.invalid(error)
    if not table:
        notes.invalid(ConfigError(path, "rows", 0, "at least one that is valid"))
    return np.array(stamps), np.array(table).reshape(len(stamps), len(columns))


def row_stamp(path: Path, row: Row, stamp: Callable[[str], int]) -> int:
    """Stamp of a row, ns.

    Raises:
        ConfigError: Its first word is not a stamp.
    """
    try:
        return stamp(row.words[0])
    except ValueError as error:
        raise ConfigError(path, f"line {row.line}, time stamp", row.words[0], str(error)) from None


def integer_nanoseconds(word: str) -> int:
    """A stamp in whole nanoseconds."""
    value = int(word) if word.isascii() and word.isdecimal() and len(word) <= LONGEST_STAMP else -1
    if not 0 <= value < 2**63:
        raise ValueError("whole nanoseconds")
    return value


def _number(path: Path, row: Row, name: str, word: str | None) -> float:
    try:
        value = float(word or "nan")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(path, f"line {row.line}, {name}", word, "a finite number")
    return value
