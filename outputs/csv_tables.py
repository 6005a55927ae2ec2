"""Tables of text as CSV files and as single rows."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from stridetwin.streams.files import whole_file


def write_table(columns: Sequence[str], rows: Iterable[Sequence[str]], path: Path) -> None:
    """Writes a CSV file with a header."""
    with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def csv_row(cells: Sequence[str]) -> str:
    """One row of a CSV file, without the line's end."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()
