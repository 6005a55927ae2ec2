"""Files of others, taken into memory up to a size that such a file has: a hostile one costs no more than others do."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError

LARGEST_TEXT = 256 << 20
"""Bytes of a table or a list in text: 2 h of an IMU at 200 Hz take a sixth of it."""
MOST_LINES = 2_000_000
"""Of a table or a list in text: 2.7 h at 200 Hz."""
LONGEST_LINE = 2048
"""Characters of such a line."""
LARGEST_SETTING = 1 << 20
"""Bytes of a calibration, scenario or other YAML file."""
LARGEST_PICTURE = 64 << 20
"""Bytes of a picture's file."""
MOST_PIXELS = 1 << 24
"""Of a stored picture, 4096 × 4096: what a message of a few bytes could unpack to is bounded by it."""
MOST_SCANS = 100
"""Of a JPEG; a progressive one has about ten, and each costs a pass over all pixels."""
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_MOST_MARKS = 10_000
"""Of a JPEG before its size; one of metadata alone has a few hundred."""
_JPEG_SCAN = b"\xff\xda"
_JPEG_BARE = frozenset([0x01, *range(0xD0, 0xD9)])


def read_bytes(path: Path, most: int) -> bytes:
    """A whole file, if it is small enough.

    Raises:
        ConfigError: It has more than `most` bytes.
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        data = file.read(most + 1) if size <= most else b""
    if size > most or len(data) > most:
        raise ConfigError(path, "size in bytes", max(size, len(data)), f"up to {most}")
    return data


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """A whole text file with every line end as a line feed, if it is small enough.

    Raises:
        ConfigError: It has more than `most` bytes.
        OSError: It cannot be read.
        UnicodeDecodeError: It is no text.
    """
    text = read_bytes(path, most).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def lines(path: Path, encoding: str = "utf-8") -> Iterator[str]:
    """The lines of a table or a list in text, without their ends, one at a time.

    Raises:
        ConfigError: The file is larger than `LARGEST_TEXT`, or has more than `MOST_LINES`, or one that is longer
            than `LONGEST_LINE`.
        OSError: It cannot be read.
        UnicodeDecodeError: It is no text.
    """
    with path.open(encoding=encoding) as file:
        if (size := path.stat().st_size) > LARGEST_TEXT:
            raise ConfigError(path, "size in bytes", size, f"up to {LARGEST_TEXT}")
        for number in itertools.count(1):
            line = file.readline(LONGEST_LINE + 1)
            if not line:
                return
            if len(line) > LONGEST_LINE:
                raise ConfigError(path, f"line {number}", f"{line[:20]}...", f"up to {LONGEST_LINE} characters")
            if number > MOST_LINES:
                raise ConfigError(path, "lines", f"more than {MOST_LINES}", f"up to {MOST_LINES}")
            yield line.rstrip("\n")


def picture_size(data: bytes) -> tuple[int, int]:
    """Width and height that a JPEG or PNG claims, without unpacking it.

    Raises:
        ValueError: It is neither.
    """
    if data.startswith(_PNG) and data[12:16] == b"IHDR" and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    at = 2
    for _ in range(_MOST_MARKS if data.startswith(b"\xff\xd8") else 0):
        if at + 9 > len(data) or data[at] != 0xFF:
            break
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 if marker in _JPEG_BARE else 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise ValueError("a picture that is neither JPEG nor PNG")


def check_pixels(width: int, height: int, most: int = MOST_PIXELS) -> None:
    """Refuses a picture of a size that none has.

    Raises:
        ValueError: It has.
    """
    if not 0 < width * height <= most:
        raise ValueError(f"a picture of {width} × {height} is not valid; valid: up to {most} pixels")


def decode_picture(data: bytes) -> NDArray[Any] | None:
    """The pixels of a JPEG or PNG as OpenCV decodes them, None where it is damaged.

    Raises:
        ValueError: It is neither, claims more than `MOST_PIXELS`, or has more than `MOST_SCANS`.
    """
    check_pixels(*picture_size(data))
    # A scan's data never holds these two bytes: whatever a decoder makes of the file, it finds no more scans than that.
    if not data.startswith(_PNG) and (scans := data.count(_JPEG_SCAN)) > MOST_SCANS:
        raise ValueError(f"a JPEG of {scans} scans is not valid; valid: up to {MOST_SCANS}")
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
