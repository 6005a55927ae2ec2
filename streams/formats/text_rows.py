"""Rows of words in a text file, converted to numbers; errors name the line."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stridetwin.streams.bounded import read_lines
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import LARGEST_NUMBER, Array, Stamps

_HOMOGENEOUS = 4
"""Rows of a camera matrix with a row and column more, as ScanNet has it."""
LONGEST_STAMP = 19
"""Most digits of a stamp in ns: those of 2⁶³."""
VALID_NUMBER = f"a finite number up to {LARGEST_NUMBER:g}"
"""What errors expect of a measurement."""


class TextRow(NamedTuple):
    """A line of a text table, split into cells on request.

    Attributes:
        line: Its number in the file.
        text: Its text, without comments.
        separator: Between words; None is any white space.
    """

    line: int
    text: str
    separator: str | None

    @property
    def cells(self) -> list[str]:
        """The cells of the line, without white space around them."""
        return [*map(str.strip, self.text.split(self.separator))]


def read_text_rows(path: Path, separator: str | None) -> tuple[list[str], list[TextRow]]:
    """Reads the rows of a text file, and the cells of the last comment (`#`) above them, which is their header.

    Args:
        path: The file.
        separator: Between cells; None is any white space. Lines without it are divided at another one that they have.

    Raises:
        StrideTwinError: The file cannot be read.
    """
    header: list[str] = []
    rows: list[TextRow] = []
    for number, line in enumerate(read_lines(path, "utf-8-sig"), 1):
        content, mark, comment = line.partition("#")  # `mark` is "" without a comment
        if content := content.strip():
            rows.append(TextRow(number, content, _choose_separator(content, separator)))
        elif mark and not rows:  # a comment above all rows
            comment = comment.strip()
            header = TextRow(number, comment, _choose_separator(comment, separator)).cells
    return header, rows


def _choose_separator(line: str, usual: str | None) -> str | None:
    """The separator of a line: the usual one of its format, or one in place of it; None is white space."""
    if usual is None:
        return "," if len(line.split()) == 1 and "," in line else None
    if usual in line or len(line.split()) == 1:
        return usual
    return next((mark for mark in (";", "\t") if mark in line), None)


def read_numbers(
    path: Path, rows: list[TextRow], columns: Sequence[tuple[str, int]], stamp: Callable[[str], int], notes: Notes
) -> tuple[Stamps, Array]:
    """Reads a stamp and some numbers of each row.

    Args:
        path: What errors call the file.
        rows: The rows.
        columns: Name and index of each column.
        stamp: Converts a word to nanoseconds; ValueError for an invalid one.
        notes: Collects invalid rows, which are omitted when lenient.

    Returns:
        Stamps (N,) ns from the first cell of each row, and the columns (N, K).

    Raises:
        ConfigError: A word is not a number, or there is no row, unless lenient.
    """
    stamps, table = array("q"), array("d")
    for row in rows:
        cells = row.cells
        try:
            values = [float(cells[at]) for _, at in columns]
        except (ValueError, IndexError):
            values = [math.nan]  # a cell is no number or is missing: an error below
        try:
            if not all(map(_is_valid, values)):
                raise _invalid_number_error(path, row, columns)
            stamps.append(parse_row_stamp(path, row.line, cells[0], stamp))
            table.extend(values)
        except ConfigError as error:
            notes.add_error(error)
    if not table:
        notes.add_error(ConfigError(path, "rows", 0, "at least one that is valid"))
    return np.array(stamps), np.array(table).reshape(len(stamps), len(columns))


def write_text_rows(path: Path, header: str, separator: str, stamps: Iterable[object], table: Array) -> None:
    """Writes a line of header, and a row of a stamp and K exact numbers for each of the N stamps and rows (N, K)."""
    with path.open("w", encoding="ascii") as file:
        file.write(f"{header}\n")
        for t, row in zip(stamps, table.tolist()):
            file.write(separator.join([str(t), *map(repr, row)]) + "\n")


def parse_row_stamp(path: str | Path, line: int, word: str, stamp: Callable[[str], int]) -> int:
    """Stamp of a row, ns, from its first word.

    Raises:
        ConfigError: The word is not a stamp.
    """
    try:
        return stamp(word)
    except ValueError as error:
        raise ConfigError(path, f"line {line}, time stamp", word, str(error)) from None


def read_matrix(path: Path, separator: str | None, size: int, valid: str = "") -> Array:
    """The square matrix of numbers that a file consists of.

    Args:
        path: The file.
        separator: Between numbers; None is any white space.
        size: Number of rows and of columns.
        valid: What is valid, for the message; "" for any finite numbers.

    Raises:
        StrideTwinError: The file cannot be read, or is no such matrix; the message says what is `valid`.
    """
    _, rows = read_text_rows(path, separator)
    try:
        matrix = np.array([[float(word) for word in row.cells] for row in rows])
    except ValueError:  # a word is no number, or the rows differ in length
        matrix = np.zeros(0)  # of the wrong shape: an error below
    if matrix.shape != (size, size) or not (np.abs(matrix) <= LARGEST_NUMBER).all():
        raise ConfigError(
            path, "matrix", [row.text for row in rows[:size]], valid or f"{size} rows of {size} finite numbers"
        )
    return matrix


def read_camera_matrix(path: Path, separator: str | None) -> tuple[float, float, float, float]:
    """Reads the intrinsics (fu, fv, pu, pv) in pixels from a file with a camera matrix.

    Raises:
        StrideTwinError: The file cannot be read, or is no camera matrix.
    """
    valid = "fx 0 cx / 0 fy cy / 0 0 1 in pixels, focal lengths above 0"
    _, rows = read_text_rows(path, separator)
    K = read_matrix(path, separator, 4 if len(rows) == _HOMOGENEOUS else 3, valid)
    if min(K[0, 0], K[1, 1]) <= 0:
        raise ConfigError(path, "matrix", K.tolist(), valid)
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def parse_nanoseconds(word: str) -> int:
    """A stamp in whole nanoseconds, from decimal digits.

    Raises:
        ValueError: The word has other characters or is 2⁶³ or more; the message says what is valid.
    """
    value = int(word) if word.isascii() and word.isdecimal() and len(word) <= LONGEST_STAMP else -1
    if not 0 <= value < 2**63:
        raise ValueError("whole nanoseconds; is it in s?" if "." in word else "whole nanoseconds")
    return value


def _invalid_number_error(path: Path, row: TextRow, columns: Sequence[tuple[str, int]]) -> ConfigError:
    """The error to raise about the first cell of a row that is not a finite number.

    Args:
        path: What the error calls the file.
        row: The row.
        columns: Name and index of each column that is read; one of them has such a cell.
    """
    cells = dict(enumerate(row.cells))  # by index, as a short row lacks some
    name, at = next((name, at) for name, at in columns if not _is_valid_word(cells.get(at, "")))
    return ConfigError(path, f"line {row.line}, {name}", cells.get(at), VALID_NUMBER)


def _is_valid(value: float) -> bool:
    """Whether a number is finite and no larger than any measurement."""
    return abs(value) <= LARGEST_NUMBER  # False for NaN


def _is_valid_word(word: str) -> bool:
    """Whether a word is a valid number."""
    try:
        return _is_valid(float(word))
    except ValueError:
        return False
