"""The folder of a placement: its lock, the request that it belongs to, and the rows measured so far."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stridetwin.scenarios.files import locked
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import json_text, whole_file

ROWS, REQUEST = "rows.jsonl", "request.json"
HIDDEN = ".unfinished-"
"""Name prefix of the folders of walks that are being recorded."""


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Creates and locks a folder; removes the unfinished files of killed runs.

    A folder that is new is removed if the run is refused before anything is measured.

    Raises:
        StrideTwinError: Another process uses the folder.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with locked(folder):
            for left in folder.glob(f"{HIDDEN}*"):
                shutil.rmtree(left, ignore_errors=True)
            yield
    except BlockingIOError:
        raise StrideTwinError(f"{folder}: another placement uses it: expected a folder of its own") from None
    except StrideTwinError:
        if is_new and not (folder / ROWS).exists():
            shutil.rmtree(folder)
        raise


def check_request(folder: Path, request: Mapping[str, Any], resume: bool) -> None:
    """Checks that a folder is unused, or belongs to the same request, which is to be continued.

    Args:
        folder: The output folder.
        request: What identifies the placement; it has the key `placement`, its description.
        resume: Whether an earlier run is to be continued.

    Raises:
        StrideTwinError: It holds a placement that is not to be continued, another one, or results of another command.
    """
    try:
        before = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        before = None
    if before is not None and not (isinstance(before, dict) and "placement" in before):
        raise StrideTwinError(f"{folder}: holds results of another command: expected another folder")
    if not resume and any((folder / name).exists() for name in (ROWS, REQUEST)):
        raise StrideTwinError(f"{folder}: holds a placement: expected --resume to continue it, or another folder")
    if before is not None and before != (asked := json.loads(json_text(request))):
        name = before["placement"]
        differing = ", ".join(key for key, value in asked.items() if before.get(key) != value)
        raise StrideTwinError(
            f"{folder}: holds another placement, {name!r} (other {differing}): expected another folder"
        )


def keep_request(folder: Path, request: Mapping[str, Any]) -> None:
    """Writes the request that a folder belongs to from now on."""
    with whole_file(folder / REQUEST) as file:
        file.write_text(json_text(request), encoding="utf-8")


class Rows:
    """Rows by key, in a file of JSON lines, which is created if it does not exist.

    Attributes:
        found: Number of rows of an earlier run.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._rows = dict(_read(file)) if file.exists() else {}
        self.found = len(self._rows)
        self._begun = False

    def get(self, key: str) -> dict[str, Any] | None:
        """The row of a key, None where there is none."""
        return self._rows.get(key)

    def add(self, rows: Iterable[tuple[str, dict[str, Any]]]) -> None:
        """Appends rows to the file.

        The first call rewrites the file, without an incomplete last line.
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


def _line(key: str, row: dict[str, Any]) -> str:
    return json.dumps({"key": key, **row}, sort_keys=True, allow_nan=False) + "\n"


def _read(file: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for text in file.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            row = json.loads(text)
            yield row.pop("key"), row
        except (ValueError, KeyError, AttributeError):
            continue  # the last line of a killed run
