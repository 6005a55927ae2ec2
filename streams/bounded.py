"""Size limits for untrusted files: a malicious file costs no more time and memory than a valid one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stridetwin.streams.errors import ConfigError, StrideTwinError, read_error

LARGEST_TEXT = 256 << 20
"""Largest text table or list, bytes: 2 h of an IMU at 200 Hz take a sixth of it."""
MOST_LINES = 2_000_000
"""Most lines of a text table or list: 2.7 h at 200 Hz."""
MOST_ZEROS = 2**24
"""Most zero bytes in a row, with which a logger may fill up a block of its file."""
LONGEST_LINE = 2048
"""Longest line of a text table or list, characters."""
LONGEST_ROW = 16384
"""Longest line of a table of many sensors, characters: some 1000 cells."""
LARGEST_SETTING = 1 << 20
"""Largest calibration, scenario or other YAML file, bytes."""


def read_bytes(path: Path, most: int) -> bytes:
    """Reads a whole file of limited size.

    Raises:
        ConfigError: The file has more than `most` bytes.
        StrideTwinError: The file cannot be read.
    """
    with _convert_errors(path), path.open("rb") as file:
        size = path.stat().st_size
        data = file.read(most + 1) if size <= most else b""  # one byte more shows whether the file has grown since
    if size > most or len(data) > most:
        raise ConfigError(path, "size in bytes", max(size, len(data)), f"up to {most}")
    return data


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """Reads a whole text file of limited size; every line end becomes a line feed.

    Raises:
        ConfigError: The file has more than `most` bytes.
        StrideTwinError: The file cannot be read, or is not text.
    """
    with _convert_errors(path):
        text = read_bytes(path, most).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def read_lines(path: Path, encoding: str = "utf-8", longest: int = LONGEST_LINE) -> Iterator[str]:
    """The lines of a text table or list, without line ends and without zero bytes around them, one at a time.

    Args:
        path: The file.
        encoding: Name of its codec.
        longest: Most characters of a line.

    Raises:
        ConfigError: The file is larger than `LARGEST_TEXT`, has more than `MOST_LINES`, or has a line longer than
            `longest`.
        StrideTwinError: The file cannot be read, or is not text.
    """
    with _convert_errors(path), path.open(encoding=encoding) as file:
        if (size := path.stat().st_size) > LARGEST_TEXT:
            raise ConfigError(path, "size in bytes", size, f"up to {LARGEST_TEXT}")
        for number in itertools.count(1):
            line, zeros = file.readline(longest + 1), 0
            while line and not line.strip("\0"):  # zeros, with which loggers fill up their files
                if (zeros := zeros + len(line)) > MOST_ZEROS:
                    raise ConfigError(path, f"line {number}", "zero bytes", f"up to {MOST_ZEROS} of them in a row")
                line = file.readline(longest + 1)
            if not line:
                return
            if len(line) > longest:
                raise ConfigError(path, f"line {number}", f"{line[:20]}...", f"up to {longest} characters")
            if number > MOST_LINES:
                raise ConfigError(path, "lines", f"more than {MOST_LINES}", f"up to {MOST_LINES}")
            yield line.rstrip("\n").strip("\0")


@contextmanager
def _convert_errors(path: Path) -> Iterator[None]:
    """Converts errors of the system, and bytes that are not UTF-8, to an error that names the file."""
    try:
        yield
    except OSError as error:
        raise read_error(path, error) from error
    except UnicodeDecodeError as error:
        raise StrideTwinError(f"{path}: is not text in UTF-8") from error
