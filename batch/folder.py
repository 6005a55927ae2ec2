"""The output folder of a batch: its lock, its unfinished files, and the request that it belongs to."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import atomic_file, to_json

REQUEST = "request.json"
UNFINISHED = ".unfinished"
"""Folder of files that are being written, within the output folder."""


@contextmanager
def hold_folder(
    folder: Path, has_rows: Callable[[], bool], refusal: str = "another process uses it: expected another folder"
) -> Iterator[Path]:
    """Creates and locks the folder of a batch, and removes the unfinished files of killed runs.

    A folder that is new is removed again if the run is refused before it has a row.

    Args:
        folder: The output folder.
        has_rows: Tells, when it is called, whether the folder has a row.
        refusal: Message if another process uses the folder.

    Yields:
        The folder for unfinished files, `UNFINISHED`; it is removed at the end.

    Raises:
        StrideTwinError: Another process uses the folder.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            stack.enter_context(lock_folder(folder))
        except BlockingIOError:
            raise StrideTwinError(f"{folder}: {refusal}") from None
        _remove_unfinished(folder)
        (folder / UNFINISHED).mkdir(exist_ok=True)
        try:
            yield folder / UNFINISHED
        except StrideTwinError:  # a refused request leaves no trace; finished rows always stay
            if is_new and not has_rows():
                shutil.rmtree(folder)
            raise
        finally:
            _remove_unfinished(folder)


def _remove_unfinished(folder: Path) -> None:
    """Removes the folder `UNFINISHED` in an output folder, and any other whose name begins like it."""
    for path in folder.glob(f"{UNFINISHED}*"):
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Locks a folder against other processes; the lock ends with this process in every case.

    Raises:
        BlockingIOError: Another process holds the lock.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refuses at once, instead of waiting for another process
        yield
    finally:
        os.close(handle)  # also releases the lock


def read_request(folder: Path) -> object:
    """Reads the request that a folder belongs to; None if it belongs to none, or if the file is damaged."""
    try:
        return json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None


def write_request(folder: Path, request: Mapping[str, object]) -> None:
    """Writes the request that a folder belongs to from now on, atomically."""
    with atomic_file(folder / REQUEST) as file:
        file.write_text(to_json(request), encoding="utf-8")


def differing_keys(request: Mapping[str, object], previous: Mapping[str, object]) -> list[str]:
    """Keys of a request whose values differ from those of a previous one, which was read from its file."""
    # the request is written as JSON and read back, because JSON turns tuples into lists
    return [key for key, value in json.loads(to_json(request)).items() if previous.get(key) != value]
