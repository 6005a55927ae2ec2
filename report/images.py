"""Images of a report: views of a recording's cameras, and the film of the walk (WebM, VP8) with a strip of stills."""

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
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Image

NEAR_M, FAR_M = 0.4, 6.0
_AT_ONCE = 16
FPS, WIDTH, HEIGHT = 12, 576, 324


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraView:
    """Images of one camera.

    Attributes:
        title: Topic and content.
        images: (time in s, grey (H, W) or RGB (H, W, 3)).
    """

    title: str
    images: list[tuple[float, NDArray[np.uint8]]]


def colour_of_depth(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of a depth image in m; near is yellow, far violet, invalid black."""
    share = (FAR_M - np.clip(depth, NEAR_M, FAR_M)) / (FAR_M - NEAR_M)
    bgr = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_PLASMA)
    rgb = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    rgb[depth <= 0] = 0
    return rgb


def scaled(image: Image | Depth, width: int) -> NDArray[np.uint8]:
    """The image scaled to a width; depth as colours."""
    pixels = image.pixels if isinstance(image, Image) else colour_of_depth(image.depth)
    height = round(pixels.shape[0] * width / pixels.shape[1])
    kind = cv2.INTER_AREA if isinstance(image, Image) else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=kind), dtype=np.uint8)


def camera_topics(recording: Recording) -> list[str]:
    """The topics of the rig's cameras that the recording holds, colour before its depth."""
    topics = [t for c in recording.rig.cameras.values() for t in (c.topic, c.depth_topic)]
    return [t for t in topics if t in recording.topics]


def images_of(recording: Recording, topic: str, rate_hz: float) -> Iterator[Image | Depth]:
    """Images of one camera at about a given rate, decoded one at a time."""
    times = recording.image_times(topic)
    step = max(1, round(recording.topics[topic].rate_hz / rate_hz))
    for first in range(0, len(times), step * _AT_ONCE):
        yield from recording.images(topic, range(first, min(first + step * _AT_ONCE, len(times)), step))


def camera_views(recording: Recording, count: int = 6, width: int = 360) -> list[CameraView]:
    """Images of every camera at the same times, spread over the walk."""
    parts = {t: c.part for c in recording.rig.cameras.values() for t in (c.topic, c.depth_topic)}
    views = []
    for topic in camera_topics(recording):
        info = recording.topics[topic]
        moments = np.linspace(info.first_ns, info.last_ns, count + 2)[1:-1].astype(np.int64).tolist()
        images = [(p.t_ns / 1e9, scaled(p, width)) for p in recording.images(topic, t_ns=moments)]
        scale = f", {NEAR_M:g}-{FAR_M:g} m" if info.kind is Depth else ""
        views.append(CameraView(title=f"{topic.strip('/')} ({parts[topic]}){scale}", images=images))
    return views


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
        raise StrideTwinError("OpenCV cannot write WebM films here; expected a build with FFmpeg and VP8")
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
