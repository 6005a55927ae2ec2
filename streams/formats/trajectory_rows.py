"""The rows of a trajectory as a tool writes them: cells between any separators, and the names of their columns."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.bounded import read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.text_encoding import detect_encoding
from stridetwin.streams.formats.trajectory_columns import (
    Columns,
    columns_by_names,
    columns_of_ros_echo,
    is_name_of_time,
    is_number,
)
from stridetwin.streams.samples import Array

TUM = "t x y z qx qy qz qw"
"""Columns of the most common form."""
_FEWEST_NAMES = 7
"""Names that a header of poses has at least."""
_CELLS_OF_A_MATRIX = (12, 16)
"""Cells of a row that is a matrix [R | t], of three rows as in KITTI or of four."""
_NANOSECOND_DIGITS = 9
"""Digits of the nanoseconds within a second."""
_DECIMAL_COMMA = re.compile(r"\d,\d")
"""A comma between digits, as in `1,5`."""
_OTHER_FILES = (
    (
        re.compile(r"POINTS2D\[\]|IMAGE_ID,\s*QW"),
        "COLMAP's images.txt has poses of the world in the camera, without stamps and in a unit of its own",
        f"poses of the camera in the world (its place is -Rᵀ t) in metres, with stamps: {TUM}",
    ),
    (
        re.compile(r"^Format Version,.*Take Name"),
        "an export of Motive has several bodies, each with its rotation first, and mostly y up",
        f"one body with z up as {TUM}",
    ),
    (re.compile(r"^\s*[\[{][\s\"{\[]"), "JSON", f"rows of text: {TUM}"),
)
"""Files that look like a trajectory or are called one: how a line of them begins, what they are, what to give."""


@dataclass
class TrajectoryRows:
    """The cells of a trajectory.

    Attributes:
        path: What errors call the file.
        columns: Columns by their names in a header, or by the words in a row; None where neither tells them.
        header: A line above the rows with as many words as a header whose names are not known; "" without one.
        lines: Number of each row's line.
        stamps: First cell of each row, or the one that the header names as the time.
        numbers: All cells as numbers by rows, NaN where one is no number.
        count: Cells of each row.
        has_commas: Commas separate the cells.
        repeated: Rows that were left out because they are the same as the one before.
    """

    path: str | Path
    columns: Columns | None = None
    header: str = ""
    lines: array[int] = field(default_factory=lambda: array("q"))
    stamps: list[str] = field(default_factory=list)
    numbers: array[float] = field(default_factory=lambda: array("d"))
    count: int = 0
    has_commas: bool = False
    repeated: int = 0
    _names: int = 0  # of the columns in the header
    _before: list[str] = field(default_factory=list)

    @property
    def table(self) -> Array:
        """(N, K) numbers of the cells."""
        return np.frombuffer(self.numbers, float).reshape(len(self.stamps), self.count)

    def add(self, number: int, line: str) -> None:
        """Takes the cells of a line.

        Raises:
            ConfigError: It has another number of cells than the first row.
        """
        cells = split_cells(line)
        if len(cells) != (self.count or self._names) and self.columns is not None:
            padded = split_cells(line, keeps_empty=True)  # the last cells may be empty
            cells = padded if len(padded) == (self.count or self._names) else cells
        if not self.stamps:
            self._begin(cells, line)
        elif len(cells) != self.count:
            raise ConfigError(self.path, f"line {number}", line[:80], f"{self.count} cells, as in the rows above it")
        if cells == self._before and self.count not in _CELLS_OF_A_MATRIX:  # such rows have no stamp: the pose may rest
            self.repeated += 1
            return
        self._before = cells
        self.lines.append(number)
        self.stamps.append(self._read_stamp(cells))
        self.numbers.extend(map(to_number, cells))

    def take_names(self, text: str) -> None:
        """Takes the names of the columns from a line if they name a pose; else the line, if it may be a header.

        Raises:
            ConfigError: The line is that of a file of another kind.
        """
        for pattern, what, valid in _OTHER_FILES:
            if pattern.search(text):
                raise ConfigError(self.path, "", what, valid)
        separator = next((mark for mark in ";," if mark in text), None)  # else white space
        names = [name.strip(' "') for name in text.replace(" [", "[").split(separator)]
        columns = columns_by_names(names)
        if columns is not None:
            self.columns, self._names, self.header = columns, len(names), ""
        elif self.columns is None and len(names) >= _FEWEST_NAMES and any(map(is_name_of_time, names)):
            self.header, self._names = text.strip(), len(names)

    def keep(self, is_kept: NDArray[np.bool_]) -> None:
        """Leaves out all rows but those that are kept, (N,) bool."""
        table = self.table[is_kept]
        self.lines = array("q", [line for line, kept in zip(self.lines, is_kept, strict=True) if kept])
        self.stamps = [stamp for stamp, kept in zip(self.stamps, is_kept, strict=True) if kept]
        self.numbers = array("d", table.ravel().tolist())

    def _begin(self, cells: list[str], line: str) -> None:
        """Takes what the first row says: the number of cells, and whether the names above are those of the rows."""
        self.count, self.has_commas = len(cells), "," in line
        if self.columns is not None and _last_place(self.columns) >= self.count:
            self.columns = None  # a header of other rows
        if self.columns is None:
            self.columns = columns_of_ros_echo(cells)
        if self.columns is not None or self._names != self.count:
            self.header = ""

    def _read_stamp(self, cells: list[str]) -> str:
        """The stamp of a row; seconds and nanoseconds in two cells become one number."""
        columns = self.columns
        stamp = cells[0 if columns is None else columns.time or 0]
        if columns is None or columns.nanoseconds is None:
            return stamp
        return f"{stamp}.{cells[columns.nanoseconds].rjust(_NANOSECOND_DIGITS, '0')}"


def read_rows(path: str | Path, columns: Columns | None = None) -> TrajectoryRows:
    """The cells of a file in any usual encoding, with the columns that the last line above them names.

    Args:
        path: The file.
        columns: Its columns, for a file without names, if they are known.

    Raises:
        StrideTwinError: The file cannot be read, has no row, or is of another kind.
    """
    rows = TrajectoryRows(path=path, columns=columns)
    first = ""
    for number, line in enumerate(read_lines(Path(path), detect_encoding(Path(path))), 1):
        first = first or line.strip()
        content, mark, comment = line.partition("#")
        if not rows.stamps and (mark or line[:1] in "%/"):
            rows.take_names(comment if mark else line.lstrip("%/"))
        if not content.strip(" \t,;") or not split_cells(content) or line[:1] in "%/":
            continue
        if not rows.stamps and rows.columns is None and not is_number(split_cells(content)[0]):
            rows.take_names(content)  # a header without a mark
            continue
        rows.add(number, content.strip(" \t"))
    if not rows.stamps:
        begin = f"; the file begins with {first[:80]!r}" if first else "; the file is empty"
        raise StrideTwinError(f"{path}: no pose: expected rows of {TUM}{begin}")
    return rows


def split_cells(line: str, *, keeps_empty: bool = False) -> list[str]:
    """The cells of a line between semicolons, commas, tabs or blanks, without white space and quotation marks.

    Args:
        line: The line.
        keeps_empty: Empty cells at the end of the line count; otherwise a separator there has no cell after it.
    """
    line = line.strip() if keeps_empty else line.strip().rstrip(",;").strip()
    if ";" in line:
        separator = ";"
    elif "," not in line:
        return line.split()
    else:
        separator = "\t" if "\t" in line and _DECIMAL_COMMA.search(line) else ","
    cells = [cell.strip().strip('"') for cell in line.split(separator)]
    if separator != ",":  # then commas are those of decimals
        cells = [cell.replace(",", ".") for cell in cells]
    if any(" " in cell for cell in cells):  # commas and spaces mixed
        return line.replace(separator, " ").split()
    return cells


def to_number(word: str) -> float:
    """The number in a word; NaN without one."""
    try:
        return float(word)
    except ValueError:
        return float("nan")


def _last_place(columns: Columns) -> int:
    """The last place that columns have."""
    return max(*columns.position, *columns.quaternion, columns.time or 0, columns.nanoseconds or 0)
