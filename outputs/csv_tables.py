"""Tables of text as CSV files, as single rows, and as what `live` writes."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from stridetwin.estimators.base import AnyEstimator
from stridetwin.outputs.base import LiveOutput, Written
from stridetwin.streams.files import atomic_file


def write_table(columns: Sequence[str], rows: Iterable[Sequence[str]], path: Path) -> None:
    """Writes a CSV file with a header."""
    with atomic_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def write_output_table(columns: Sequence[str], rows: Sequence[Sequence[str]], file: Path, row_name: str) -> Written:
    """Writes a CSV file as the file of an output, and says what was written.

    Args:
        columns: Titles of the columns.
        rows: Cells of each row.
        file: The file.
        row_name: What a message calls the rows, such as `steps`.
    """
    write_table(columns, rows, file)
    return Written(files=[file], rows=len(rows), lines=[f"{file}: {len(rows)} {row_name}"])


def csv_row(cells: Sequence[str]) -> str:
    """One row of a CSV file, without the line's end."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()


class LiveTable(LiveOutput):
    """Rows in `live`, some of which become a table at the end.

    Args:
        columns: Titles of the columns.
        file: File to write; None only gives rows.
    """

    def __init__(self, columns: Sequence[str], file: Path | None) -> None:
        self._columns, self._file = columns, file
        self._kept: dict[int, Sequence[str]] = {}  # cells of each row of the table, by the row's number

    def keep(self, number: int, cells: Sequence[str]) -> None:
        """Keeps a row for the table; it replaces an earlier one of the same number."""
        if self._file is not None:
            self._kept[number] = cells

    def finish(self, estimator: AnyEstimator) -> dict[Path, int]:
        """Writes the kept rows in the order of their numbers, whatever the estimator's state is.

        Returns:
            The file with its number of rows; empty if no file was requested.
        """
        if self._file is None:
            return {}
        write_table(self._columns, [self._kept[number] for number in sorted(self._kept)], self._file)
        return {self._file: len(self._kept)}
