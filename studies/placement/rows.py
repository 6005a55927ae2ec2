"""Measured rows, written one line at a time: a killed run loses at most the line that it was writing."""

from __future__ import annotations

import fcntl
import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import whole_file

NAME = "rows.jsonl"
HIDDEN = ".unfinished-"
"""Name prefix of the folders of walks that are being recorded."""


class Rows:
    """Rows by key, in a file of JSON lines.

    Args:
        file: Is created if it does not exist.
        resume: Keeps the rows of an earlier run; else the file starts empty.

    Attributes:
        found: Number of rows of an earlier run.
    """

    def __init__(self, file: Path, resume: bool) -> None:
        self._file = file
        self._rows = dict(_read(file)) if resume and file.exists() else {}
        self.found = len(self._rows)
        self._begun = False

    def get(self, key: str) -> dict[str, Any] | None:
        """The row of a key, None where there is none."""
        return self._rows.get(key)

    def add(self, rows: Iterable[tuple[str, dict[str, Any]]]) -> None:
        """Appends rows to the file.

        The first call rewrites the file, without rows that are not reused and without an incomplete last line.
        """
        if not self._begun:
            with whole_file(self._file) as new:
                new.write_text("".join(_line(key, row) for key, row in self._rows.items()), encoding="utf-8")
            self._begun = True
        with self._file.open("a", encoding="utf-8") as out:
            for key, row in rows:
                self._rows[key] = row
                out.write(_line(key, row))


def key_of(*what: Any) -> str:
    """Digest of everything that determines a row."""
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:16]


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Locks and creates a folder; removes the unfinished files of killed runs.

    Raises:
        StrideTwinError: Another placement uses the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StrideTwinError(f"{folder}: another placement works there: expected a folder of its own") from None
        for left in folder.glob(f"{HIDDEN}*"):
            shutil.rmtree(left, ignore_errors=True)
        yield


def _line(key: str, row: dict[str, Any]) -> str:
    return json.dumps({"key": key, **row}, sort_keys=True, allow_nan=False) + "\n"


def _read(file: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for text in file.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            row = json.loads(text)
            yield row.pop("key"), row
        except (ValueError, KeyError, AttributeError):
            continue  # the last line of a killed run
