"""Finds what a text table consists of: separator, decimal mark, preamble, names, units, and where the numbers begin.

The rows of numbers are recognised first, as they are alike; the names of the columns are then looked for above them,
among titles, properties, comments and a row of units.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice, pairwise
from pathlib import Path

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.column_names import is_time_name, parse_column, sensor_of_text
from stridetwin.streams.formats.imu_units import is_unit_like, unit_of

_SPACES = " "
"""Separator of tables whose cells any number of blanks separate."""
_SEPARATORS = ("\t", ";", ",", "|", _SPACES)
"""Separators of cells; of two with equally many numbers the first counts."""
_COMMENT = re.compile(r"\s*\"?(?:#|//|%|;)+\s*")
"""The mark at the begin of a comment, as `# ` and `// `."""
_GIVEN_SEPARATOR = re.compile(r"\"?sep=(.)\"?\s*", re.IGNORECASE)
"""The first line by which spreadsheets are told the separator."""
_NUMBER = re.compile(r"\s*[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?\s*", re.IGNORECASE)
"""A number with a decimal point, as `-1.5e-3`."""
_COMMA_NUMBER = re.compile(r"\s*[+-]?(?:\d+,\d*|,\d+)(?:e[+-]?\d+)?\s*", re.IGNORECASE)
"""A number with a decimal comma, as `-1,5`."""
_THOUSANDS = {
    mark: re.compile(rf"\s*[+-]?\d{{1,3}}(?:[{gap}]\d{{3}})+(?:[{mark}]\d*)?\s*")
    for mark, gap in ((".", ", '"), (",", ". '"))
}
"""Numbers whose thousands are marked, as `1,234.5` and `1.234,5`, by the decimal mark."""
_COMMENT_AT_END = re.compile(r"(?<=\S)\s+(?:#|//).*$")
"""A comment behind the cells of a row, as ` # stop`."""
_BLANK_CELL = re.compile(r'"([^"]*)"|(\S+)')
"""A cell between blanks, in quotes if it has blanks itself."""
_SIGNS = str.maketrans(
    {"\u2212": "-", "\u2010": "-", "\u2011": "-", "\u00a0": " ", "\u202f": " ", "\u2009": " ", "\ufeff": ""}
)
"""Signs of spreadsheets and their ASCII: minus signs, blanks that do not break lines, marks in joined files."""
_CALIBRATION_WORDS = {"raw", "cal", "uncal", "calibrated", "uncalibrated"}
"""Cells of a row below the names that tells raw numbers and calibrated ones apart, as Shimmer's."""
_COUNT = re.compile(r"\s*[0-9]{1,18}\s*")
"""A whole number that fits into 64 bits."""
_MOST_PREAMBLE = 50_000
"""Lines within which the numbers begin."""
_BUFFER, _SAMPLE = 2000, 50
"""Lines that are read at once until rows of numbers appear, and rows of numbers that are looked at."""
_HEADER_REACH = 40
"""Lines above the numbers among which the names are."""
_FEW_CELLS = 5
"""Rows of up to so many cells must have exactly as many as the others, for a property has as few."""
_REALSENSE = re.compile(r"stream type,index,f#,", re.IGNORECASE)
_REALSENSE_NAMES = ("Stream Type", "Index", "F#", "HW Timestamp (ms)", "Host Timestamp(ms)", "x", "y", "z")
"""The sections of rs-data-collect: how each begins, and the names of those of forces and rates."""


@dataclass(frozen=True, kw_only=True)
class TableHead:
    """What stands above the rows of a text table, and the rows.

    Attributes:
        preamble: Lines above the numbers other than the names and units of columns.
        names: Name of each column, as in the file; their numbers `1`, `2` ... in a table without.
        units: Unit of each column in a row of its own; "" without one.
        sensors: Sensor of each column in a row of its own; empty without such a row.
        has_names: Whether the table has names of columns.
        decimal: Decimal mark in place of the point; "" for the point.
        sample: Cells of the first rows.
        rows: Cells of all rows that are no comments, once.
        skipped: Lines between the names and the numbers that are neither.
    """

    preamble: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    sensors: tuple[str, ...]
    has_names: bool
    decimal: str
    sample: tuple[tuple[str, ...], ...]
    rows: Iterator[list[str]]
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _Shape:
    """The rows of numbers: separator, decimal mark, number of cells, and how many of them are usually numbers."""

    separator: str
    decimal: str
    cells: int
    numbers: int


def read_table_head(lines: Iterator[str], wanted: Iterable[str] = ()) -> TableHead:
    """Reads the lines of a table until its numbers begin.

    Args:
        lines: Lines of the file without line ends.
        wanted: Names of columns that the user gives, by which a row of names is recognised.

    Returns:
        The head; `rows` reads the rest of the lines.

    Raises:
        csv.Error: The text is no table.
    """
    lines = (line if line.isascii() else line.translate(_SIGNS) for line in lines)
    buffer, shape = _read_until_numbers(lines)
    if (at := next((k for k, line in enumerate(buffer) if _REALSENSE.match(line)), None)) is not None:
        return _head_of_realsense(buffer, at, lines)
    begin = _find_begin(buffer, shape, set(wanted))
    above = [(k, line) for k, line in enumerate(buffer[:begin]) if line.strip()]
    names_at, names = _find_names(above, shape, set(wanted))
    if names_at is None and begin == len(buffer) and above:  # no numbers at all: the last line may be the names
        names_at, names = above[0][0], _split_names(above[0][1], shape)
    between = [(k, line) for k, line in above if names_at is not None and k > names_at]
    units_at, units = _find_units(between, shape, len(names))
    kinds_at, names = _add_kinds(between, names, shape)
    if units_at is None:  # or just above the names
        units_at, units = _find_units([(k, x) for k, x in above if k < (names_at or 0)][-1:], shape, len(names))
    sensors_at, sensors, names = _find_sensors([(k, x) for k, x in above if k < (names_at or 0)], names, shape)
    index_at, names = _name_index(between, names, shape)
    used = {names_at, units_at, sensors_at, kinds_at, index_at}
    body = chain(buffer[begin:], lines)
    rows = _split_rows(body, shape.separator)
    sample = tuple(map(tuple, islice(_split_rows(iter(buffer[begin : begin + 4 * _SAMPLE]), shape.separator), _SAMPLE)))
    names = _align_names(names, sample, shape)
    return TableHead(
        preamble=tuple(line for k, line in above if k not in used),
        names=tuple(names) if names_at is not None else tuple(str(k + 1) for k in range(shape.cells)),
        units=tuple(_pad(units, len(names))),
        sensors=tuple(sensors),
        has_names=names_at is not None,
        decimal=shape.decimal,
        sample=sample,
        rows=rows,
        skipped=tuple(x for k, x in between if k not in used and not _is_comment(x, shape.separator)),
    )


def _find_begin(buffer: Sequence[str], shape: _Shape, wanted: set[str]) -> int:
    """Place of the first row of numbers; of the first one below the names if numbers such as a matrix stand above them.

    Args:
        buffer: Lines until the numbers.
        shape: Shape of the rows of numbers.
        wanted: Names that the user gives.
    """
    begin = next((k for k, line in enumerate(buffer) if _is_row(line, shape)), len(buffer))
    above = [(k, line) for k, line in enumerate(buffer[:begin]) if line.strip()]
    if _find_names(above, shape, wanted)[0] is not None:
        return begin
    below = [(k, x) for k, x in enumerate(buffer[begin : begin + _HEADER_REACH], begin) if x.strip()]
    named_at, names = _find_names([(k, x) for k, x in below if not _is_row(x, shape)], shape, wanted)
    if named_at is None or _score_names(names, wanted) < _FEW_CELLS:
        return begin
    return next((k for k in range(named_at, len(buffer)) if _is_row(buffer[k], shape)), begin)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma, and perhaps marks between its thousands."""
    return is_plain_number(cell) or any(pattern.fullmatch(cell) for pattern in _THOUSANDS.values())


def is_plain_number(cell: str) -> bool:
    """Whether a cell is a number without marks between its thousands."""
    return bool(_NUMBER.fullmatch(cell) or _COMMA_NUMBER.fullmatch(cell))


def parse_number(cell: str, decimal: str) -> float:
    """The number in a cell.

    Args:
        cell: Its text.
        decimal: Decimal mark in place of the point; "" for the point.

    Raises:
        ValueError: The text is no number.
    """
    try:
        return float(cell.replace(",", ".") if decimal else cell)
    except ValueError:
        if not _THOUSANDS[decimal or "."].fullmatch(cell):
            raise
    digits = re.sub(r"[.\s']" if decimal else r"[,\s']", "", cell)
    return float(digits.replace(",", "."))


def is_count(cell: str) -> bool:
    """Whether a cell is a whole number of at most 18 digits, which `int` takes: `str.isdigit` also holds for `²`."""
    return _COUNT.fullmatch(cell) is not None


def no_names_error(path: Path, head: TableHead, option: str, example: str) -> ConfigError:
    """The error to raise about a table without names of columns; it says how to number them.

    Args:
        path: The table.
        head: Its head.
        option: Option of the command line that names columns.
        example: Its text with numbers of columns.
    """
    first = ", ".join(cell.strip() for cell in (head.sample[0] if head.sample else ()))
    count = len(head.names)
    valid = (
        f"names of the columns; the header is missing and the file has {count} columns: give their numbers and units, "
        f"{option} {example}, or write such a row of names above the numbers"
    )
    return ConfigError(path, "first row", first[:80], valid)


def _read_until_numbers(lines: Iterator[str]) -> tuple[list[str], _Shape]:
    """Reads lines until the last of them are rows of numbers or the file ends: the lines, and the rows' shape."""
    buffer: list[str] = []
    while len(buffer) < _MOST_PREAMBLE and (chunk := list(islice(lines, _BUFFER))):
        buffer += chunk
        tail = [line for line in buffer[-4 * _SAMPLE :] if line.strip() and not _is_comment(line, _SPACES)][-_SAMPLE:]
        shape = _find_shape(tail, _read_separator(buffer))
        if shape.numbers > 1:
            return buffer, shape
    return buffer, _find_shape([line for line in buffer[:_BUFFER] if line.strip()], _read_separator(buffer))


def _read_separator(buffer: Sequence[str]) -> str:
    """The separator that the first line gives, as `sep=;`; "" without such a line."""
    matched = _GIVEN_SEPARATOR.fullmatch(buffer[0]) if buffer else None
    return matched[1] if matched else ""


def _find_shape(lines: Sequence[str], separator: str) -> _Shape:
    """The shape of rows of numbers among some lines: of the separator with which most cells are numbers."""
    best = _Shape(separator=separator or ",", decimal="", cells=1, numbers=0)
    for candidate in (separator,) if separator else _SEPARATORS:
        rows = [_split(line, candidate) for line in lines]
        rows = [row[:-1] if row and not row[-1].strip() else row for row in rows]
        rows = [row for row in rows if any(map(is_number, row))]
        if not rows:
            continue
        numbers = Counter(sum(map(is_number, row)) for row in rows).most_common(1)[0][0]
        cells = Counter(map(len, rows)).most_common(1)[0][0]
        if numbers > best.numbers:
            best = _Shape(separator=candidate, decimal=_find_decimal(rows), cells=cells, numbers=numbers)
    if not best.numbers and not separator:  # no numbers: the separator that most lines have
        counts = {s: max((line.count(s) for line in lines), default=0) for s in _SEPARATORS[:-1]}
        separator = max(counts, key=lambda s: counts[s]) if any(counts.values()) else ","
        best = _Shape(separator=separator, decimal="", cells=counts[separator] + 1, numbers=0)
    return best


def _find_decimal(rows: Sequence[Sequence[str]]) -> str:
    """Decimal mark in place of the point among cells of some rows; "" for the point."""
    cells = [cell for row in rows for cell in row]
    for mark, pattern in _THOUSANDS.items():  # with both marks in one number, the last one is the decimal mark
        opposite = "," if mark == "." else "."
        if any(mark in cell and opposite in cell and pattern.fullmatch(cell) for cell in cells):
            return "" if mark == "." else mark
    return "," if any(map(_COMMA_NUMBER.fullmatch, cells)) else ""


def _split(line: str, separator: str) -> list[str]:
    """Cells of a line between separators, or between blanks; quotes around them are left out."""
    return _split_blanks(line) if separator == _SPACES else next(csv.reader([line], delimiter=separator), [])


def _split_blanks(line: str) -> list[str]:
    """Cells that blanks separate; those in quotes may have blanks."""
    if '"' not in line:
        return line.split()
    return [matched[1] if matched[2] is None else matched[2] for matched in _BLANK_CELL.finditer(line)]


def _split_rows(lines: Iterator[str], separator: str) -> Iterator[list[str]]:
    """Cells of the lines that are no comments."""
    kept = (_clean_row(line) for line in lines if not _is_comment(line, separator))
    return map(_split_blanks, kept) if separator == _SPACES else csv.reader(kept, delimiter=separator)


def _clean_row(line: str) -> str:
    """A row without a comment at its end, and without quotes if one has no partner, as it would take other lines."""
    if "#" in line or "//" in line:
        line = _COMMENT_AT_END.sub("", line)
    return line.replace('"', "") if line.count('"') % 2 else line


def _is_comment(line: str, separator: str) -> bool:
    """Whether a line begins with one of the marks of comments; `;` may also be the separator after an empty cell."""
    start = line.lstrip(' "')[:2]
    return start[:1] in ("#", "%") or start == "//" or (start[:1] == ";" and separator != ";")


def _is_row(line: str, shape: _Shape) -> bool:
    """Whether a line is a row of numbers: as many cells, and at least half as many numbers."""
    if not line.strip() or not shape.numbers or _is_comment(line, shape.separator):
        return False
    cells = _split(line, shape.separator)
    cells = cells[:-1] if len(cells) > shape.cells and not cells[-1].strip() else cells
    lacks = abs(len(cells) - shape.cells)  # rows of few cells are easily taken for a property and its value
    return lacks <= (1 if shape.cells > _FEW_CELLS else 0) and 2 * sum(map(is_number, cells)) >= shape.numbers


def _split_names(line: str, shape: _Shape) -> list[str]:
    """Cells of a row of names, which may be a comment, and may have blanks within names."""
    text = _COMMENT.sub("", line, count=1) if _is_comment(line, shape.separator) else line
    separators = [shape.separator]
    separators += [s for s in _SEPARATORS if s != shape.separator]
    for separator in separators:
        cells = [cell.strip() for cell in _split(text, separator)]
        while cells and not cells[-1]:
            cells.pop()
        if abs(len(cells) - shape.cells) <= 1:
            return cells
    if shape.separator == _SPACES:
        cells = re.split(r"\s{2,}|\t", text.strip())
        if len(cells) == shape.cells:
            return cells
    return [cell.strip() for cell in _split(text, shape.separator)]


def _find_names(above: Sequence[tuple[int, str]], shape: _Shape, wanted: set[str]) -> tuple[int | None, list[str]]:
    """The line of the names of columns among those above the numbers.

    Args:
        above: Place and text of each line that is not empty.
        shape: Shape of the rows of numbers.
        wanted: Names that the user gives.

    Returns:
        Its place and its cells; None and an empty list without one.
    """
    best_score, best = 0, None
    for place, line in above[-_HEADER_REACH:]:
        cells = _split_names(line, shape)
        if 2 * len(cells) < shape.cells or any(map(is_number, cells)):
            continue
        if _count_units(cells) * 2 > len([c for c in cells if c]):
            continue
        score = _score_names(cells, wanted) + (2 if abs(len(cells) - shape.cells) <= 1 else 0)
        is_as_wide = abs(len(_split(line, shape.separator)) - shape.cells) <= 1
        is_likely = score > 2 or (not _is_comment(line, shape.separator) and is_as_wide)
        if is_likely and score >= best_score:
            best_score, best = score, (place, cells)
    return best if best is not None else (None, [])


def _score_names(cells: Sequence[str], wanted: set[str]) -> int:
    """How many cells are names of columns that we know, or that the user gives."""
    parsed = [parse_column(cell, with_linear=True) for cell in cells]
    count = sum(bool((c.quantity and c.axis) or c.axis or is_time_name(c.name)) for c in parsed)
    return count + 10 * len(wanted & set(cells))


def _count_units(cells: Sequence[str]) -> int:
    """How many cells are units of ours, in brackets or without."""
    return sum(unit_of(cell) is not None for cell in cells)


def _find_units(between: Sequence[tuple[int, str]], shape: _Shape, count: int) -> tuple[int | None, list[str]]:
    """The row of units between the names and the numbers: its place and its cells, None and an empty list without."""
    for place, line in between:
        cells = _split_names(line, shape)
        filled = [cell for cell in cells if cell]
        if abs(len(cells) - count) > 1 and len(filled) < count - 1:
            continue
        if _count_units(cells) >= 2 and 2 * sum(map(is_unit_like, filled)) >= len(filled):
            return place, [re.sub(r"^[\[(](.*)[\])]$", r"\1", cell) for cell in cells]
    return None, []


def _add_kinds(between: Sequence[tuple[int, str]], names: list[str], shape: _Shape) -> tuple[int | None, list[str]]:
    """The row below the names that tells raw and calibrated columns apart: its place, and the names with its words."""
    for place, line in between:
        cells = _split_names(line, shape)
        if cells and len(cells) <= len(names) and {cell.lower() for cell in cells if cell} <= _CALIBRATION_WORDS:
            return place, [f"{name} {kind}".strip() for name, kind in zip(names, _pad(cells, len(names)))]
    return None, names


def _name_index(between: Sequence[tuple[int, str]], names: list[str], shape: _Shape) -> tuple[int | None, list[str]]:
    """The row below the names that has that of the first column alone, as of a pandas index: place, and the names."""
    for place, line in between:
        cells = [cell.strip() for cell in _split(line, shape.separator)]
        if len(cells) >= len(names) > 1 and cells[0] and not any(cells[1:]):
            return place, [cells[0], *names[1:]]
    return None, names


def _find_sensors(
    above: Sequence[tuple[int, str]], names: list[str], shape: _Shape
) -> tuple[int | None, list[str], list[str]]:
    """The row above the names that tells the sensor or the quantity of each column.

    Args:
        above: Place and text of each line above the names.
        names: Names of the columns.
        shape: Shape of the rows of numbers.

    Returns:
        Place of the row, None without one; the sensors of the columns; and the names, to which the row's quantities are
        added where they are axes alone.
    """
    if not above or not names:
        return None, [], names
    place, line = above[-1]
    cells = [cell.strip() for cell in _split(line, shape.separator)]
    repeated = max(Counter(name for name in names if name).values(), default=0) > 1
    if not repeated or abs(len(cells) - len(names)) > 1 or sum(map(bool, cells)) < 2 or any(map(is_number, cells)):
        return None, [], names
    cells = _fill_right(_pad(cells, len(names)))
    if any(parse_column(name).quantity for name in names):
        return place, [_trim_quantity(cell) for cell in cells], names
    joined = [f"{cell} {name}".strip() for cell, name in zip(cells, names)]
    _, sensors, joined = _find_sensors(above[:-1], joined, shape)
    return place, sensors, joined


def _fill_right(cells: Sequence[str]) -> list[str]:
    """Cells with each empty one taking the text of that to its left, as merged cells are written."""
    filled: list[str] = []
    for cell in cells:
        filled.append(cell or (filled[-1] if filled else ""))
    return filled


def _trim_quantity(text: str) -> str:
    """A sensor's name without words for a quantity, as of `IMU 1 - Accelerometer`; as it is without such words."""
    return sensor_of_text(text) if parse_column(text).quantity else text


def _pad(cells: Sequence[str], count: int) -> list[str]:
    """The cells, with empty ones behind them up to a number of cells."""
    return [*cells[:count], *[""] * (count - len(cells))]


def _align_names(names: list[str], sample: Sequence[Sequence[str]], shape: _Shape) -> list[str]:
    """The names, with an empty one first where the first column is the number of a row that has no name."""
    if len(names) == shape.cells - 1 and len(sample) > 1:
        first = [row[0].strip().strip('"') for row in sample if row]
        if all(map(is_count, first)) and {int(b) - int(a) for a, b in pairwise(first)} == {1}:
            return ["", *names]
    return names


def _head_of_realsense(buffer: Sequence[str], at: int, lines: Iterator[str]) -> TableHead:
    """The head of a file of rs-data-collect, whose sections of streams have headers of their own."""
    rows = _split_rows(chain(buffer[at:], lines), ",")
    return TableHead(
        preamble=tuple(buffer[:at]),
        names=_REALSENSE_NAMES,
        units=("",) * len(_REALSENSE_NAMES),
        sensors=(),
        has_names=True,
        decimal="",
        sample=(),
        rows=rows,
    )
