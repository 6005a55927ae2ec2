"""Output files and folders that appear complete or not at all."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stridetwin.batch.folder import lock_folder
from stridetwin.streams.errors import StrideTwinError

_PREFIX = ".unfinished-"


@contextmanager
def stage_files(folder: Path) -> Iterator[Path]:
    """Yields an empty folder, whose contents move into `folder` at the end; after an error nothing moves.

    Raises:
        StrideTwinError: The place cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_unfinished(folder)
        # the lock shows other processes that the temporary folder is in use
        with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=folder) as temporary, lock_folder(Path(temporary)):
            yield Path(temporary)
            for path in sorted(Path(temporary).iterdir()):
                os.replace(path, folder / path.name)
    except OSError as error:
        raise StrideTwinError(f"{folder}: cannot be written: {error.strerror or error}") from error


def _remove_unfinished(folder: Path) -> None:
    """Removes the temporary folders of killed processes; those of running processes are locked and stay."""
    for temporary in folder.glob(f"{_PREFIX}*"):
        try:
            with lock_folder(temporary):
                shutil.rmtree(temporary)
        except BlockingIOError:  # locked: in use
            continue


def sha256(path: Path) -> str:
    """SHA-256 checksum of a file as hexadecimal text."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
