"""Conversion of any source to a recording, second by second and lossless."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import RecordingError, StrideTwinError
from stridetwin.streams.files import partial_path
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.recording.topic_reader import selected
from stridetwin.streams.samples import Depth, Image

_SECOND_NS = 1_000_000_000


def write_recording(recording: Recording, path: Path, progress: Callable[[float], None] = lambda _: None) -> None:
    """Writes every sample of a recording as an MCAP file, atomically: images as PNG, depth as float metres.

    Args:
        recording: The source.
        path: Output file.
        progress: Called with the completed share (0-1).

    Raises:
        StrideTwinError: There is nothing to write, an image is damaged (unless lenient), or the path is not writable.
    """
    if not recording.topics:
        raise RecordingError(f"{recording.path}: no stream that can be read")
    try:
        _write(recording, path, progress)
    except StrideTwinError:
        partial_path(path).unlink(missing_ok=True)
        raise


def _write(recording: Recording, path: Path, progress: Callable[[float], None]) -> None:
    blocks = [recording.block(t) for t, i in recording.topics.items() if i.kind not in (Image, Depth)]
    topics = [t for t, i in recording.topics.items() if i.kind in (Image, Depth)]
    times = np.concatenate([*(b.t_ns for b in blocks), *map(recording.image_times, topics)])
    images = recording.samples(topics)
    image = next(images, None)
    with RecordingWriter(path, recording.rig, recording.metadata, depth_encoding="32FC1", jpeg_quality=None) as writer:
        for second in np.unique(times // _SECOND_NS).tolist():
            since, until = second * _SECOND_NS, (second + 1) * _SECOND_NS
            for block in blocks:
                first, last = np.searchsorted(block.t_ns, (since, until))
                if first < last:
                    here = np.zeros(len(block), bool)
                    here[first:last] = True
                    writer.write(selected(block, here))
            while image is not None and image.t_ns < until:
                writer.write(image)
                image = next(images, None)
            progress((until - times.min()) / max(1, times.max() - times.min()))
