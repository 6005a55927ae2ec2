"""Stores of rows, which a later run reads to run only the jobs whose rows are missing or of another version."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Generic

from stridetwin.batch.jobs import Job, RowT, Task

_INVALID = (ValueError, KeyError, AttributeError, TypeError)
"""What reading a damaged row raises: no JSON or UTF-8, no mapping, or no key."""


class RowFiles(Generic[RowT]):
    """One JSON file per job, which people and other tools may read.

    Args:
        folder: Folder of the files.
        unfinished: Folder for files that are being written, see `folder.hold_folder`.
        is_sorted: Sorts the keys of each row; otherwise they keep their order.
    """

    def __init__(self, folder: Path, unfinished: Path, *, is_sorted: bool) -> None:
        self._folder, self._unfinished, self._is_sorted = folder, unfinished, is_sorted

    def path(self, job: Job[Task]) -> Path:
        """The file of a job's row."""
        return self._folder / f"{job.name}.json"

    def read(self, job: Job[Task]) -> RowT | None:
        """The row of a job; None if there is none, or only a damaged one or one with another key."""
        try:
            row = json.loads(self.path(job).read_text(encoding="utf-8"))
            key = row.pop("key")  # the file has the key in the row
            return row if key == job.key else None
        except (FileNotFoundError, *_INVALID):
            return None

    def has_any(self, job: Job[Task]) -> bool:
        """Whether there is a row of the job's name, even if `read` refuses it."""
        return self.path(job).exists()

    def write(self, job: Job[Task], row: RowT) -> None:
        """Stores the row of a job atomically."""
        unfinished = self._unfinished / f"{job.name}.json"
        unfinished.write_text(json.dumps({"key": job.key, **row}, sort_keys=self._is_sorted), encoding="utf-8")
        os.replace(unfinished, self.path(job))


class RowLines(Generic[RowT]):
    """One file of JSON lines, for many small rows, whose keys keep their order. Jobs with the same key share a row.

    Args:
        file: The file; it is created with the first row.
        unfinished: Folder for files that are being written, see `folder.hold_folder`.
    """

    def __init__(self, file: Path, unfinished: Path) -> None:
        self._file, self._unfinished = file, unfinished
        text = file.read_text(encoding="utf-8", errors="replace") if file.exists() else ""
        self._rows: dict[str, RowT] = dict(_read_lines(text))
        # whether the file holds exactly its valid rows; if it also has, for example, the half line of a killed run, the
        # next `write` first writes the whole file anew
        self._is_whole = text == self._text(list(self._rows))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._rows)

    def read(self, job: Job[Task]) -> RowT | None:
        """The row of a job; None if there is none with its key."""
        return self._rows.get(job.key)

    def has_any(self, job: Job[Task]) -> bool:
        """Whether there is a row with the job's key; rows have no names here, so the key tells whose row it is."""
        return job.key in self._rows

    def write(self, job: Job[Task], row: RowT) -> None:
        """Appends the row of a job."""
        if not self._is_whole:
            self._rewrite()
        self._rows[job.key] = row
        with self._file.open("a", encoding="utf-8") as file:
            file.write(self._text([job.key]))

    def sort(self, keys: Sequence[str]) -> None:
        """Puts the rows of these keys first, in this order, whatever the order in which they were written."""
        # `dict.fromkeys` drops repeated keys and keeps the order; the other rows follow in theirs
        first = [key for key in dict.fromkeys(keys) if key in self._rows]
        ordered = {key: self._rows[key] for key in dict.fromkeys([*first, *self._rows])}
        if list(ordered) != list(self._rows):
            self._rows = ordered
            self._rewrite()

    def _rewrite(self) -> None:
        """Writes the whole file again, atomically."""
        unfinished = self._unfinished / self._file.name
        unfinished.write_text(self._text(list(self._rows)), encoding="utf-8")
        os.replace(unfinished, self._file)
        self._is_whole = True

    def _text(self, keys: Sequence[str]) -> str:
        """The lines of the rows with these keys."""
        rows = ({"key": key, **self._rows[key]} for key in keys)
        return "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows)


def _read_lines(text: str) -> Iterator[tuple[str, RowT]]:
    """Key and row of each valid line; invalid lines, such as the half line of a killed run, are skipped."""
    for line in text.splitlines():
        try:
            row = json.loads(line)
            key = row.pop("key")  # the line has the key in the row
            yield key, row
        except _INVALID:
            continue


RowStore = RowFiles[RowT] | RowLines[RowT]
