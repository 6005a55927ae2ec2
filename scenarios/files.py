"""Output files that appear whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stridetwin.streams.errors import StrideTwinError


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yields an empty folder; what it holds at the end moves into `folder`, after an error nothing does.

    Raises:
        StrideTwinError: The place cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=folder) as temporary:
            yield Path(temporary)
            for path in sorted(Path(temporary).iterdir()):
                os.replace(path, folder / path.name)
    except OSError as error:
        raise StrideTwinError(f"{folder}: cannot be written: {error.strerror or error}") from error


def json_text(value: object) -> str:
    """JSON for a file: sorted keys, so that equal results are equal bytes.

    Raises:
        ValueError: A number that is not finite.
    """
    return json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n"
