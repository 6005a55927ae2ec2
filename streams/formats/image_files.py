"""Image files (8-bit colour or grey, depth as 16-bit PNG), their lists with stamps, and the camera of an export."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path, PurePath

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.bounded import read_bytes
from stridetwin.streams.bounded_images import LARGEST_IMAGE, MOST_PIXELS, decode_image
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.text_rows import parse_row_stamp, read_text_rows
from stridetwin.streams.recording.imported import ImageStream
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.ros_images import rgb_from_bgr
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Depth, Image

NONE = (0, 65535)
"""The two numbers of a depth image of 16 bits that mean no depth."""
_ENDINGS = (".png", ".jpg", ".jpeg")
"""Usual endings of images, in lower case."""
_DRIVE = re.compile(r"[A-Za-z]:[\\/]")
"""Begin of an absolute path of Windows, as `C:/`, with a slash of either kind."""
_PNG = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG."""


def read_image(path: Path, topic: str, t_ns: int) -> Image:
    """Reads a colour or grey image; of 16-bit grey the upper byte.

    Raises:
        StrideTwinError: The file is missing or damaged.
    """
    raw = _read_pixels(path)
    if raw.dtype not in (np.uint8, np.uint16):
        raise ConfigError(path, "pixels", str(raw.dtype), "8 or 16 bits")
    # (H, W) grey or (H, W, C) BGR of 8 bits
    pixels = raw.view(np.uint8) if raw.dtype == np.uint8 else (raw.view(np.uint16) >> 8).astype(np.uint8)
    return Image(topic=topic, t_ns=t_ns, pixels=pixels if pixels.ndim == 2 else rgb_from_bgr(pixels))


def read_depth(path: Path, topic: str, t_ns: int, per_metre: float) -> Depth:
    """Reads a depth image of 16 bits; 0 and 65535 both mean no depth.

    Args:
        path: The file.
        topic: Topic of the sample.
        t_ns: Its stamp.
        per_metre: Units of the image per metre.

    Raises:
        StrideTwinError: The file is missing, damaged or does not have 16 bits.
    """
    raw = _read_pixels(path)
    if raw.dtype != np.uint16 or raw.ndim != 2:
        raise ConfigError(path, "pixels", f"{raw.dtype} {raw.shape}", "one channel of 16 bits")
    none = (raw == NONE[0]) | (raw == NONE[1])
    return Depth(topic=topic, t_ns=t_ns, depth=np.where(none, 0, raw).astype(np.float32) / np.float32(per_metre))


def write_image(path: Path, sample: Image) -> None:
    """Writes a colour (RGB) or grey image of 8 bits as a PNG."""
    pixels = sample.pixels if sample.pixels.ndim == 2 else cv2.cvtColor(sample.pixels, cv2.COLOR_RGB2BGR)
    _write_pixels(path, pixels)


def write_depth(path: Path, sample: Depth, per_metre: float) -> None:
    """Writes depth as a PNG of 16 bits with `per_metre` units per metre; depth out of its range becomes 0, none."""
    units = np.rint(sample.depth * np.float32(per_metre))
    is_in_range = (units > 0) & (units < NONE[1])
    _write_pixels(path, np.where(is_in_range, units, 0).astype(np.uint16))


def png_is_sound(data: bytes) -> bool:
    """Whether the CRC of every chunk of a PNG is correct: OpenCV decodes some damaged ones with just a warning.

    A chunk is the length of its contents (4 bytes), its kind (4), the contents, and the CRC of kind and contents (4).
    """
    at = len(_PNG)  # place of the next chunk
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")  # of the contents
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False  # cut off before the last chunk


def _read_pixels(path: Path) -> NDArray[np.generic]:
    """Decodes an image file of up to `MOST_PIXELS`: (H, W) grey or (H, W, C) in OpenCV's order BGR.

    Raises:
        StrideTwinError: The file cannot be read, or is damaged.
    """
    data = read_bytes(path, LARGEST_IMAGE)
    try:
        sound = png_is_sound(data) if data.startswith(_PNG) else len(data) > 0
        pixels = decode_image(data) if sound else None
    except ValueError as error:
        raise ConfigError(
            path, "", f"a damaged image: {error}", f"a PNG or JPEG of up to {MOST_PIXELS} pixels"
        ) from error
    if pixels is None:
        raise ConfigError(path, "", "a damaged image", "one that OpenCV can read")
    return pixels


def _write_pixels(path: Path, pixels: NDArray[np.integer | np.floating]) -> None:
    """Writes pixels in the format that the suffix names, such as `.png`."""
    done, data = cv2.imencode(path.suffix, pixels)
    if not done:
        raise StrideTwinError(f"{path}: cannot be written: OpenCV refuses {pixels.dtype} {pixels.shape}")
    path.write_bytes(data.tobytes())


def read_image_list(
    file: Path,
    folder: Path,
    separator: str | None,
    stamp: Callable[[str], int],
    notes: Notes,
    per_metre: float | None = None,
    first: int | None = None,
) -> ImageStream:
    """Reads rows of a stamp and an image file name; images that are listed and missing are left out and reported.

    Args:
        file: The list.
        folder: Folder that the names are relative to.
        separator: Between stamp and name; None is any white space.
        stamp: Converts a word to nanoseconds.
        notes: Collects invalid rows, which are omitted when lenient, and images that are not there.
        per_metre: Units of depth per metre; None for colour.
        first: Place of the stamp, in rows of several images; None for rows of one.

    Raises:
        StrideTwinError: The list cannot be read, is empty, or a row is invalid, unless lenient.
    """
    _, rows = read_text_rows(file, separator)
    listed: list[tuple[int, Path]] = []
    for row in rows:
        try:
            # a separator in the name has split it into several cells
            cells = row.cells if first is None else [*row.cells, "", ""][first : first + 2]
            path = _to_image_path(file, folder, row.line, (row.separator or " ").join(cells[1:]))
            listed.append((parse_row_stamp(file, row.line, cells[0], stamp), path))
        except ConfigError as error:
            notes.add_error(error)
    if not listed:
        notes.add_error(ConfigError(file, "rows", 0, "at least one that is valid"))
    return open_image_stream(select_existing(file.name, folder, listed, notes), per_metre)


def select_existing(place: str, folder: Path, listed: list[tuple[int, Path]], notes: Notes) -> list[tuple[int, Path]]:
    """The listed images (stamp, path) whose files exist; one warning reports those that are missing from `folder`.

    Args:
        place: Name of the list in the warning.
        folder: Folder of the images.
        listed: Stamp in ns and path of each image.
        notes: Collects the warning.
    """
    existing_files = [(t_ns, actual) for t_ns, path in listed if (actual := _find_image(path)) is not None]
    if len(existing_files) < len(listed):
        first = next(path for _, path in listed if _find_image(path) is None).relative_to(folder)
        count = len(listed) - len(existing_files)
        lacking = f"{count} of {len(listed)} images are listed and missing, the first of them {first}"
        notes.warn(f"{place}: {lacking}; they are left out")
    return existing_files


def list_images(folder: Path, stamp: Callable[[str], int], notes: Notes, per_metre: float | None = None) -> ImageStream:
    """A stream of the images of a folder without a list, whose names are their stamps; other files are left out.

    Args:
        folder: The folder.
        stamp: Converts the name of an image without its ending to nanoseconds; ValueError for another name.
        notes: Collects that there is no list.
        per_metre: Units of depth per metre; None for colour.

    Raises:
        ConfigError: No image has a stamp as its name, unless lenient.
    """
    listed: list[tuple[int, Path]] = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.suffix.lower() in _ENDINGS:
            with suppress(ValueError):
                listed.append((stamp(path.stem), path))
    if listed:
        notes.warn(f"{folder.parent.name}/{folder.name}: no list of images; their names are taken as stamps")
    else:
        notes.add_error(ConfigError(folder, "images", 0, "a list of them, or names that are stamps in ns"))
    return open_image_stream(sorted(listed), per_metre)


def open_image_stream(files: list[tuple[int, Path]], per_metre: float | None = None) -> ImageStream:
    """A stream of image files, which are read one by one on request.

    Args:
        files: Stamp in ns and path of each image.
        per_metre: Units of depth per metre; None for colour or grey.
    """

    def load(topic: str, i: int) -> Image | Depth:
        """Reads image `i` under a topic."""
        t_ns, path = files[i]
        return read_image(path, topic, t_ns) if per_metre is None else read_depth(path, topic, t_ns, per_metre)

    t_ns = np.array([t for t, _ in files], np.int64)
    return ImageStream(kind=Image if per_metre is None else Depth, t_ns=t_ns, load=load)


def _to_image_path(file: Path, folder: Path, line: int, name: str) -> Path:
    """The path of an image that a list names.

    Args:
        file: The list, for errors.
        folder: Folder that the name is relative to.
        line: Number of the line in the list, for errors.
        name: The name.

    Raises:
        ConfigError: The name is empty, absolute, or leads out of the folder.
    """
    where, valid = f"line {line}, filename", f"an image inside {folder.name}/"
    path = PurePath(name.replace("\\", "/"))  # also of Windows
    is_absolute = path.is_absolute() or _DRIVE.match(name) is not None
    if not path.parts or "\0" in name or ".." in path.parts:
        raise ConfigError(file, where, name, valid)
    if not is_absolute:
        return folder / path
    inside = folder.joinpath(*path.parts[-2:])  # as on the machine that wrote the list
    if len(path.parts) < 3 or _find_image(inside) is None:
        raise ConfigError(file, where, name, valid)
    return inside


def _find_image(path: Path) -> Path | None:
    """The image of a path, also with another usual ending; None without one."""
    return next((p for p in (path, *(path.with_suffix(end) for end in _ENDINGS if path.stem)) if _is_file(p)), None)


def _is_file(path: Path) -> bool:
    """Whether there is a file of this name; false for a name that the system refuses."""
    try:
        return path.is_file()
    except OSError:  # a name too long for the file system
        return False


def choose_camera(recording: Recording, topic: str | None) -> CameraCalibration:
    """Chooses the camera of an export: that of the topic, else the first with depth, else the first of all.

    Raises:
        ConfigError: The topic is no recorded camera (the message lists them), or there is none.
    """
    recorded_cameras = [c for t, c in recording.rig.cameras.items() if t in recording.topics]
    names = ", ".join(c.topic for c in recorded_cameras) or "none (a recording with images)"
    if topic is not None:
        camera = recording.rig.cameras.get(topic)
        if camera is None or camera not in recorded_cameras:
            raise ConfigError(recording.path, "--camera", topic, names)
        return camera
    colour = [c for c in recorded_cameras if recording.topics[c.topic].kind is Image]
    if not colour:
        raise ConfigError(recording.path, "cameras", None, "at least one colour or grey camera with a calibration")
    return next((c for c in colour if c.depth_topic in recording.topics), colour[0])
