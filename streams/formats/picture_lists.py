"""Lists of image files with stamps, as in the EuRoC and TUM layouts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePath

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.picture_files import read_depth, read_image
from stridetwin.streams.formats.text_rows import read_text_rows, row_stamp
from stridetwin.streams.imported import ImageStream, Notes
from stridetwin.streams.samples import Depth, Image


def read_image_list(
    file: Path,
    folder: Path,
    separator: str | None,
    stamp: Callable[[str], int],
    notes: Notes,
    per_metre: float | None = None,
) -> ImageStream:
    """Reads rows of a stamp and an image file name.

    Args:
        file: The list.
        folder: Folder that the names are relative to.
        separator: Between stamp and name; None is any white space.
        stamp: Converts a word to nanoseconds.
        notes: Collects invalid rows, which are omitted when lenient.
        per_metre: Units of depth per metre; None for colour.

    Raises:
        StrideTwinError: The list cannot be read, is empty, or a row is invalid, unless lenient.
    """
    _, rows = read_text_rows(file, separator)
    stamps: list[int] = []
    files: list[Path] = []
    for row in rows:
        try:
            path = _listed(file, folder, row.line, (separator or " ").join(row.words[1:]))
            stamps.append(row_stamp(file, row, stamp))
            files.append(path)
        except ConfigError as error:
            notes.invalid(error)
    if not files:
        notes.invalid(ConfigError(file, "rows", 0, "at least one that is valid"))
    return image_stream(stamps, files, per_metre)


def image_stream(stamps: list[int], files: list[Path], per_metre: float | None) -> ImageStream:
    """Image files with stamps as a stream: of depth with `per_metre` units per metre, otherwise of colour."""

    def load(topic: str, i: int) -> Image | Depth:
        if per_metre is None:
            return read_image(files[i], topic, stamps[i])
        return read_depth(files[i], topic, stamps[i], per_metre)

    return ImageStream(kind=Image if per_metre is None else Depth, t_ns=np.array(stamps, np.int64), load=load)


def _listed(file: Path, folder: Path, line: int, name: str) -> Path:
    where, valid = f"line {line}, filename", f"an image inside {folder.name}/"
    parts = PurePath(name).parts
    if not parts or "\0" in name or ".." in parts or PurePath(name).is_absolute():
        raise ConfigError(file, where, name, valid)
    path = folder / name
    try:
        there = path.is_file()
    except OSError:  # a name too long for the file system
        there = False
    if not there:
        raise ConfigError(file, where, name, f"{valid}; there is no such file")
    return path
