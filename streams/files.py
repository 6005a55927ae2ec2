"""Atomic file writes, where a file appears complete or not at all, and the text of JSON files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stridetwin.streams.errors import ConfigError

_PARTIAL = ".partial"
"""Ending of the hidden name that an incomplete file has."""


def partial_path(path: Path) -> Path:
    """Hidden name beside `path` for the incomplete file: `.NAME.partial`.

    Raises:
        ConfigError: The name is invalid, or names a folder.
    """
    if not path.name or path.is_dir():
        raise ConfigError("file to write", "", str(path), "the name of a file, where there is no folder")
    return path.with_name(f".{path.name}{_PARTIAL}")


def final_name(name: str) -> str:
    """The requested name of a file, given either that name or its partial name."""
    path = Path(name)
    if path.name.startswith(".") and path.name.endswith(_PARTIAL):
        return str(path.with_name(path.name[1 : -len(_PARTIAL)]))
    return name


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path; on success it replaces `path` in one step, on an error it is removed."""
    target = Path(path)
    temporary = partial_path(target)
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def to_json(value: object) -> str:
    """JSON for a file: sorted keys, so that equal results give equal bytes.

    Raises:
        ValueError: A number is not finite.
    """
    return json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n"
