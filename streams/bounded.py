"""Size limits for untrusted files: a malicious file costs no more time and memory than a valid one."""

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
"""Largest text table or list, bytes: 2 h of an IMU at 200 Hz take a sixth of it."""
MOST_LINES = 2_000_000
"""Most lines of a text table or list: 2.7 h at 200 Hz."""
LONGEST_LINE = 2048
"""Longest line of a text table or list, characters."""
LARGEST_SETTING = 1 << 20
"""Largest calibration, scenario or other YAML file, bytes."""
LARGEST_IMAGE = 64 << 20
"""Largest image file, bytes."""
MOST_PIXELS = 1 << 24
"""Most pixels of a stored image, 4096 × 4096: bounds the size to which a message of a few bytes could unpack."""
MOST_SCANS = 100
"""Most scans of a JPEG; a progressive one has about ten, and each costs a pass over all pixels."""
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_MOST_MARKS = 10_000
"""Most segments of a JPEG before its size; one with metadata alone has a few hundred."""
_JPEG_SCAN = b"\xff\xda"
_JPEG_BARE = frozenset([0x01, *range(0xD0, 0xD9)])


def read_bytes(path: Path, most: int) -> bytes:
    """Reads a whole file of limited size.

    Raises:
        ConfigError: The file has more than `most` bytes.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        data = file.read(most + 1) if size <= most else b""
    if size > most or len(data) > most:
        raise ConfigError(path, "size in bytes", max(size, len(data)), f"up to {most}")
    return data


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """Reads a whole text file of limited size; every line end becomes a line feed.

    Raises:
        ConfigError: The file has more than `most` bytes.
        OSError: The file cannot be read.
        UnicodeDecodeError: The file is not text.
    """
    text = read_bytes(path, most).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def lines(path: Path, encoding: str = "utf-8") -> Iterator[str]:
    """The lines of a text table or list, without line ends, one at a time.

    Raises:
        ConfigError: The file is larger than `LARGEST_TEXT`, has more than `MOST_LINES`, or has a line longer than
            `LONGEST_LINE`.
        OSError: The file cannot be read.
        UnicodeDecodeError: The file is not text.
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


def image_size(data: bytes) -> tuple[int, int]:
    """Width and height in the header of a JPEG or PNG, without unpacking it.

    Raises:
        ValueError: The data is neither.
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
    raise ValueError("an image that is neither JPEG nor PNG")


def check_pixels(width: int, height: int, most: int = MOST_PIXELS) -> None:
    """Rejects images that are too large.

    Raises:
        ValueError: The image has more than `most` pixels.
    """
    if not 0 < width * height <= most:
        raise ValueError(f"invalid image of {width} × {height}: expected up to {most} pixels")


def decode_image(data: bytes) -> NDArray[Any] | None:
    """Decodes a JPEG or PNG with OpenCV; None for damaged data.

    Raises:
        ValueError: The data is neither, declares more than `MOST_PIXELS`, or has more than `MOST_SCANS` scans.
    """
    check_pixels(*image_size(data))
    # The data of a scan never contains these two bytes, so no decoder finds more scans than this.
    if not data.startswith(_PNG) and (scans := data.count(_JPEG_SCAN)) > MOST_SCANS:
        raise ValueError(f"invalid JPEG of {scans} scans: expected up to {MOST_SCANS}")
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
