"""Size limits for untrusted images: a malicious image costs no more time and memory than a valid one."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST_IMAGE = 64 << 20
"""Largest image file, bytes."""
MOST_PIXELS = 1 << 24
"""Most pixels of a stored image, 4096 × 4096: bounds the size to which a message of a few bytes could unpack."""
MOST_SCANS = 100
"""Most scans of a JPEG; a progressive one has about ten, and each costs a pass over all pixels."""
_PNG = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG."""
_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of a JPEG's frame headers, which hold the size of the image."""
_MOST_MARKS = 10_000
"""Most segments of a JPEG before its size; one with metadata alone has a few hundred."""
_JPEG_SCAN = b"\xff\xda"
"""The two bytes with which a scan of a JPEG begins."""
_JPEG_BARE = frozenset([0x01, *range(0xD0, 0xD9)])
"""Markers of a JPEG that no length and no contents follow."""


def image_size(data: bytes) -> tuple[int, int]:
    """Width and height in pixels, from the header of a JPEG or PNG, without unpacking it.

    A PNG begins with 8 fixed bytes, and then a length of 4, the name IHDR, and width and height of 4 bytes each: 24 in
    all. A JPEG (first bytes ff d8) is a sequence of segments, each of 0xFF, a marker of one byte and mostly its length
    and contents; the segments are passed over up to the frame header. The first 9 bytes of that are 0xFF, the marker,
    its length (2 bytes), the number of bits of a value (1), and height and width (2 each).

    Raises:
        ValueError: The data is neither.
    """
    if data.startswith(_PNG) and data[12:16] == b"IHDR" and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    at = 2  # place of the next segment
    for _ in range(_MOST_MARKS if data.startswith(b"\xff\xd8") else 0):
        if at + 9 > len(data) or data[at] != 0xFF:
            break
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        if marker in _JPEG_BARE:
            at += 2
        elif marker == 0xFF:  # a byte that fills up; the marker comes later
            at += 1
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")  # the length counts itself, but not the marker
    raise ValueError("an image that is neither JPEG nor PNG")


def check_pixels(width: int, height: int, most: int = MOST_PIXELS) -> None:
    """Rejects images that are too large.

    Raises:
        ValueError: The image has more than `most` pixels.
    """
    if not 0 < width * height <= most:
        raise ValueError(f"invalid image of {width} × {height}: expected up to {most} pixels")


def decode_image(data: bytes) -> NDArray[np.generic] | None:
    """Decodes a JPEG or PNG with OpenCV: (H, W) grey or (H, W, C) in OpenCV's order BGR; None for damaged data.

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
