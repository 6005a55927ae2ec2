"""Unpacked recordings of the iPhone app Record3D (`.r3d` is a ZIP file).

`metadata`, `rgbd/0.jpg`, `rgbd/0.depth` and so on. Depth is float32 in m, compressed with LZFSE. The path is
ARKit's, of a camera that looks along −z in a world with y up.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field

from stridetwin.streams.bounded import LARGEST_TEXT, read_bytes, read_text
from stridetwin.streams.bounded_images import check_pixels
from stridetwin.streams.errors import ConfigError, StrideTwinError, needing
from stridetwin.streams.fields import Count, Number, Positive
from stridetwin.streams.formats.arkit import COLOR, DEPTH, arkit_path, path_topic, scanner_rig
from stridetwin.streams.formats.image_files import image_stream
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Block, Depth
from stridetwin.streams.validation import validated

_METADATA = ("metadata.json", "metadata")
_LZFSE = (b"bvx2", b"bvx1", b"bvxn", b"bvx-")


class _Metadata(BaseModel):
    """What is read of the metadata; poses are x, y, z, w of the rotation and the position, m."""

    w: Count
    h: Count
    dw: Count
    dh: Count
    fps: Positive = 30.0
    K: Annotated[list[Number], Field(min_length=9, max_length=9)]
    poses: list[tuple[Number, Number, Number, Number, Number, Number, Number]]
    frameTimestamps: list[Number] = []


def is_record3d(path: Path) -> bool:
    """Whether a folder has the layout."""
    return (path / "rgbd").is_dir() and any((path / name).is_file() for name in _METADATA)


def read_record3d(path: Path, notes: Notes) -> Source:
    """Reads an unpacked recording of Record3D.

    Args:
        path: The folder.
        notes: Collects problems.

    Raises:
        StrideTwinError: A file cannot be read, a value in it is invalid, or depth is compressed and its package is not
            installed.
    """
    if not is_record3d(path):
        raise ConfigError(path, "", "no metadata and no rgbd/", "an unpacked recording of Record3D")
    file = next(path / name for name in _METADATA if (path / name).is_file())
    try:
        content = json.loads(read_text(file, LARGEST_TEXT))
    except ValueError as error:
        raise StrideTwinError(f"{file}: {error}") from error
    known = validated(_Metadata, content, file)
    count = len(known.poses)
    given = known.frameTimestamps if len(known.frameTimestamps) == count else []
    t = np.array(given) if given else np.arange(count) / known.fps
    if not given:
        notes.warn(f"{file.name}: no stamp for each frame; {known.fps:g} Hz assumed")
    t_ns = np.rint(1e9 * (t - min(0.0, float(t.min(initial=0.0))))).astype(np.int64)
    poses = np.array(known.poses, float).reshape(count, 7)
    images = _images(path / "rgbd", t_ns.tolist(), (known.dh, known.dw), notes)
    topic = path_topic(images)
    blocks: dict[str, Block[Any]] = {
        topic: arkit_path(topic, t_ns, poses[:, 4:], poses[:, [3, 0, 1, 2]], False, notes, file)
    }
    fu, fv, pu, pv = (known.K[i] for i in (0, 4, 6, 7))  # by columns
    rig = scanner_rig(images, (fu, fv, pu, pv), (known.w, known.h), imu=False)
    return Source(kind="record3d", blocks=blocks, images=images, rig=rig)


def _images(folder: Path, t_ns: Sequence[int], shape: tuple[int, int], notes: Notes) -> dict[str, ImageStream]:
    images: dict[str, ImageStream] = {}
    for topic, suffix in ((COLOR, "jpg"), (DEPTH, "depth")):
        listed = [(t, folder / f"{i}.{suffix}") for i, t in enumerate(t_ns)]
        there = [(t, file) for t, file in listed if file.is_file()]
        if len(there) < len(listed):
            words = f"{len(listed) - len(there)} of {len(listed)} images .{suffix} have a pose and are missing"
            notes.warn(f"{folder.name}: {words}; they are left out")
        if there:
            stamps, files = [t for t, _ in there], [file for _, file in there]
            images[topic] = image_stream(stamps, files, None) if topic == COLOR else _depth(stamps, files, shape)
    return images


def _depth(stamps: list[int], files: list[Path], shape: tuple[int, int]) -> ImageStream:
    check_pixels(shape[1], shape[0])
    _depth_of(files[0], shape)  # a missing package is an error now, not in the middle of a walk

    def load(topic: str, i: int) -> Depth:
        raw = _depth_of(files[i], shape)
        return Depth(topic=topic, t_ns=stamps[i], depth=np.where(np.isfinite(raw), raw, 0).astype(np.float32))

    return ImageStream(kind=Depth, t_ns=np.array(stamps, np.int64), load=load)


def _depth_of(file: Path, shape: tuple[int, int]) -> Any:
    """(H, W) m of a file of float32, compressed or not."""
    size = 4 * shape[0] * shape[1]
    data = read_bytes(file, size + 4096)
    if data.startswith(_LZFSE):
        with needing(f"{file}: depth compressed with LZFSE", "record3d"):
            import lzfse
        try:
            data = lzfse.decompress(data)
        except (lzfse.error, ValueError) as error:
            raise ConfigError(file, "", "damaged LZFSE data", "a depth image of Record3D") from error
    if len(data) != size:
        raise ConfigError(file, "size in bytes, unpacked", len(data), f"{size}: float32 of {shape[1]} x {shape[0]}")
    return np.frombuffer(data, "<f4").reshape(shape)
