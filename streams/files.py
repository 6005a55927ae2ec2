"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def partial_path(path: Path) -> Path:
    """Hidden name beside `path` under which it is written until it is whole."""
    return path.with_name(f".{path.name}.partial")


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path; on success it replaces `path` in one step, on an error it is removed."""
    target = Path(path)
    temporary = partial_path(target)
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)
