"""Frames of a video file as a stream of images, decoded in order and, where asked for again, from the start."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.bounded_images import check_pixels
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.recording.imported import ImageStream
from stridetwin.streams.samples import Image


def video_stream(path: Path, t_ns: NDArray[np.int64]) -> ImageStream:
    """The first frames of a video with stamps (N,) ns.

    Raises:
        StrideTwinError: When an image is loaded: the video cannot be decoded, or has fewer frames.
    """
    frames = _Frames(path)

    def load(topic: str, i: int) -> Image:
        return Image(topic=topic, t_ns=int(t_ns[i]), pixels=frames.at(i))

    return ImageStream(kind=Image, t_ns=t_ns, load=load)


class _Frames:
    """RGB frames of a video by number."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frames: Iterator[Any] = iter(())
        self._next, self._last = -1, np.zeros((0, 0, 3), np.uint8)

    def at(self, number: int) -> NDArray[np.uint8]:
        """(H, W, 3) RGB."""
        if number == self._next - 1:
            return self._last
        if self._next < 0 or number < self._next:
            self._frames, self._next = self._decoded(), 0
        try:
            while self._next <= number:
                frame = next(self._frames)
                self._next += 1
            check_pixels(frame.width, frame.height)
            self._last = frame.to_ndarray(format="rgb24")
        except StopIteration:
            count, self._next = self._next, -1
            raise ConfigError(self._path, "frames", count, f"at least {number + 1}, as listed") from None
        except (OSError, ValueError) as error:
            self._next = -1
            raise StrideTwinError(f"{self._path}: cannot be decoded: {error}") from error
        return self._last

    def _decoded(self) -> Iterator[Any]:
        import av  # takes long to import: only where it is needed

        with av.open(str(self._path)) as container:
            yield from container.decode(video=0)
