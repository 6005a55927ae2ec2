"""The film of a walk: WebM (VP8) and a strip of stills, as data for the report."""

from __future__ import annotations

import base64
import os
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import StrideTwinError

FPS, WIDTH, HEIGHT = 12, 576, 324


@dataclass(frozen=True, kw_only=True, eq=False)
class Film:
    """A film and stills from it.

    Attributes:
        webm: The file's bytes.
        stills: (time in s, (H, W, 3) RGB) at equal steps over the film.
    """

    webm: bytes
    stills: list[tuple[float, NDArray[np.uint8]]]


def make_film(frames: Iterable[tuple[float, NDArray[np.uint8]]], duration_s: float, count: int = 8) -> Film:
    """Encodes frames and keeps a strip of stills.

    Args:
        frames: Time in s and (H, W, 3) RGB, at `FPS`.
        duration_s: Length of the walk, which spaces the stills.
        count: Number of stills.

    Raises:
        StrideTwinError: The installed OpenCV cannot write WebM, or there is no frame.
    """
    wanted = [(i + 0.5) / count * duration_s for i in range(count)]
    stills: list[tuple[float, NDArray[np.uint8]]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.webm"
        writer: cv2.VideoWriter | None = None
        with ThreadPoolExecutor(1) as encoder:  # the next frame is rendered meanwhile
            written: Future[None] | None = None
            for t, rgb in frames:
                if writer is None:
                    writer = _open(path, (rgb.shape[1], rgb.shape[0]))
                if written is not None:
                    written.result()
                written = encoder.submit(_add, writer, rgb)
                if len(stills) < count and t >= wanted[len(stills)]:
                    stills.append((t, rgb.copy()))
        if writer is None:
            raise StrideTwinError("the film has no frames")
        writer.release()
        return Film(webm=path.read_bytes(), stills=stills)


def _open(path: Path, size: tuple[int, int]) -> cv2.VideoWriter:
    with _silent_stderr():
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"VP80"), FPS, size)
    if not writer.isOpened():
        raise StrideTwinError("OpenCV cannot write WebM films here; valid: a build with FFmpeg and VP8")
    return writer


def _add(writer: cv2.VideoWriter, rgb: NDArray[np.uint8]) -> None:
    writer.write(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Hides FFmpeg's message about a tag that WebM does not use; it bypasses Python's streams."""
    with open(os.devnull, "wb") as nothing:
        kept = os.dup(2)
        os.dup2(nothing.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def data_uri(data: bytes, media_type: str) -> str:
    """The data as a `data:` URI."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"


def jpeg_uri(image: NDArray[np.uint8], quality: int = 80) -> str:
    """A grey (H, W) or RGB (H, W, 3) image as a JPEG in a `data:` URI."""
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data_uri(data.tobytes(), "image/jpeg")
