"""Which encoding a text file has: UTF-8 or UTF-16, with a byte order mark or without, else a legacy one."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from charset_normalizer import from_bytes

from stridetwin.streams.bounded import LARGEST_TEXT
from stridetwin.streams.errors import ConfigError, StrideTwinError, read_error

UTF_8 = "utf-8-sig"
"""UTF-8; a byte order mark is left out."""
FALLBACK = "cp1252"
"""Encoding of the texts that are not Unicode, such as those that Windows programs write in western countries."""
_LEGACY = ("gb18030", "cp932", "cp949", "big5", "cp1251", "cp1253", FALLBACK)
"""Other encodings of texts that are not Unicode, which `charset_normalizer` tells apart."""
_UNDEFINED = bytes((0x81, 0x8D, 0x8F, 0x90, 0x9D))
"""Bytes that are no sign in `FALLBACK`."""
_RUNS = re.compile(rb"[\x80-\xff]+(?:[\x40-\x7e][\x80-\xff]+)*")
"""Bytes beyond ASCII in a row, between which second bytes of a sign may be ASCII, as in GB 18030."""
_FEWEST_IN_RUNS, _LOOKED_AT = 2.0, 1 << 16
"""Bytes beyond ASCII in a row from which on a text has whole words of other alphabets, and bytes that are looked at."""
_MARKS = (
    (codecs.BOM_UTF8, UTF_8),
    (codecs.BOM_UTF32_LE, "utf-32"),  # before that of UTF-16, with which it begins
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks, and the codec that each of them tells."""
_HEAD, _CHUNK = 4096, 1 << 20
"""Bytes at the begin of a file in which zeros are looked for, and bytes that are decoded at once."""
_FEWEST_ZEROS = 0.3
"""Share of zero bytes among those of even or odd place from which on a text without a mark is UTF-16."""


def detect_encoding(path: Path) -> str:
    """Name of the codec that reads a text file: UTF-8 or UTF-16 if the bytes are valid, else a legacy one.

    Zeros at the end, with which loggers fill up their files, are no part of the text.

    Raises:
        ConfigError: The file has more than `LARGEST_TEXT` bytes.
        StrideTwinError: The file cannot be read, or has zero bytes and is not UTF-16.
    """
    try:
        if (size := path.stat().st_size) > LARGEST_TEXT:
            raise ConfigError(path, "size in bytes", size, f"up to {LARGEST_TEXT}")
        with path.open("rb") as file:
            head = file.read(_HEAD)
            for mark, encoding in _MARKS:
                if head.startswith(mark):
                    return encoding
            if b"\0" in head.rstrip(b"\0"):
                return _detect_utf_16(path, head)
            file.seek(0)
            decoder = codecs.getincrementaldecoder("utf-8")()
            while chunk := file.read(_CHUNK):
                decoder.decode(chunk)
            decoder.decode(b"", final=True)
    except OSError as error:
        raise read_error(path, error) from error
    except UnicodeDecodeError:
        return _detect_legacy(path)
    return UTF_8


def _detect_legacy(path: Path) -> str:
    """Name of the codec of a text that is not Unicode: by its words of other alphabets, or `FALLBACK` without any.

    Single bytes beyond ASCII, as of `°` and `é`, are western; only words of such bytes tell other alphabets apart.
    """
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
    runs = [matched[0] for matched in _RUNS.finditer(head)]
    if runs and sum(map(len, runs)) >= _FEWEST_IN_RUNS * len(runs):
        best = from_bytes(head, cp_isolation=list(_LEGACY)).best()
        if best is not None and best.encoding in _LEGACY:
            return best.encoding
    return "latin-1" if any(byte in _UNDEFINED for byte in head) else FALLBACK


def _detect_utf_16(path: Path, head: bytes) -> str:
    """The order of the bytes of UTF-16 without a mark, by where the zero bytes of its Latin letters are.

    Raises:
        StrideTwinError: The zero bytes are elsewhere, so that the file is no text.
    """
    half = max(1, len(head) // 2)
    even, odd = head[::2].count(0) / half, head[1::2].count(0) / half
    if odd > _FEWEST_ZEROS and even == 0.0:
        return "utf-16-le"
    if even > _FEWEST_ZEROS and odd == 0.0:
        return "utf-16-be"
    raise StrideTwinError(f"{path}: is not text: it has zero bytes; save it as text in UTF-8")
