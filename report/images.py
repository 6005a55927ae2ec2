"""Images of a report: views of a recording's cameras, and the film of the walk (WebM, VP9) with a strip of stills."""

from __future__ import annotations

import io
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.pages.html import data_uri
from stridetwin.sim.rendering.imager import BLANK
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Image

NEAR_M, FAR_M = 0.4, 6.0  # depths at the two ends of the colour scale
_AT_ONCE = 16  # images that are decoded together
_LEAST_GREY = 8  # difference from the grey of pixels that are not rendered; more than JPEG leaves in them
_SEARCHED_S, _SEARCH_STEP_S = 1.4, 0.1  # for the next image with a rendered part: more than a stride
_ASPECT = 4 / 3  # width over height of a cropped part
FPS, WIDTH, HEIGHT = 12, 576, 324  # of a film; pixels
_VP9 = {"flags": "+bitexact", "deadline": "realtime", "cpu-used": "6", "crf": "28", "b": "0", "g": "120"}
"""Of libvpx: constant quality, about 0.3 bit per pixel and 7 ms of CPU time per frame."""


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
    nearness = (FAR_M - np.clip(depth, NEAR_M, FAR_M)) / (FAR_M - NEAR_M)  # 1 at `NEAR_M`, 0 at `FAR_M`
    bgr = cv2.applyColorMap((255 * nearness).astype(np.uint8), cv2.COLORMAP_PLASMA)
    rgb = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    rgb[depth <= 0] = 0
    return rgb


def scale_image(image: Image | Depth, width: int) -> NDArray[np.uint8]:
    """Scales an image to a width in pixels: (H, W) grey or (H, W, 3) RGB; depth becomes colours."""
    pixels = image.pixels if isinstance(image, Image) else colour_of_depth(image.depth)
    height = round(pixels.shape[0] * width / pixels.shape[1])
    # pixels of depth are not averaged: between a near and a far one nothing was measured
    interpolation = cv2.INTER_AREA if isinstance(image, Image) else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=interpolation), dtype=np.uint8)


def camera_topics(recording: Recording) -> list[str]:
    """The topics of the rig's cameras that the recording holds, colour before its depth."""
    topics = [t for c in recording.rig.cameras.values() for t in (c.topic, c.depth_topic)]
    return [t for t in topics if t in recording.topics]


def images_of(recording: Recording, topic: str, rate_hz: float) -> Iterator[Image | Depth]:
    """Yields images of one camera at about the given rate, decoded in groups of `_AT_ONCE`.

    Args:
        recording: The walk.
        topic: Topic of the camera or of its depth.
        rate_hz: Rate of the images; a slower camera gives all of its images.
    """
    times = recording.image_times(topic)
    step = max(1, round(recording.topics[topic].rate_hz / rate_hz))
    for first in range(0, len(times), step * _AT_ONCE):
        yield from recording.images(topic, range(first, min(first + step * _AT_ONCE, len(times)), step))


def camera_views(
    recording: Recording, partly: Container[str] = (), count: int = 6, width: int = 360
) -> list[CameraView]:
    """Collects images of every camera at about the same times, spread over the walk.

    Args:
        recording: The walk.
        partly: Topics of cameras of which only a part of some images is rendered. From each of the times on, they give
            the next image with such a part, cropped to it.
        count: Images of each camera.
        width: Of an image, pixels.
    """
    # name of the camera's model, by the topics of its images and of its depth
    models = {t: c.part for c in recording.rig.cameras.values() for t in (c.topic, c.depth_topic)}
    views = []
    for topic in camera_topics(recording):
        info = recording.topics[topic]
        # `count` times inside the walk, without its ends
        moments = np.linspace(info.first_ns, info.last_ns, count + 2)[1:-1].astype(np.int64).tolist()
        if topic in partly:
            images = _find_rendered_parts(recording, topic, moments, width)
            note = ", cropped to the rendered part"
        else:
            images = [(p.t_ns / 1e9, scale_image(p, width)) for p in recording.images(topic, t_ns=moments)]
            note = f", {NEAR_M:g}-{FAR_M:g} m" if info.kind is Depth else ""
        if images:
            views.append(CameraView(title=f"{topic.strip('/')} ({models[topic]}){note}", images=images))
    return views


def _find_rendered_parts(
    recording: Recording, topic: str, moments: Sequence[int], width: int
) -> list[tuple[float, NDArray[np.uint8]]]:
    """Finds from each moment on the first image with a rendered part, within 1.4 s.

    Args:
        recording: The walk.
        topic: Topic of grey images.
        moments: Times, ns.
        width: Width that the parts are scaled to, pixels.

    Returns:
        Time in s and the part (H, W), 4:3; moments without one are left out.
    """
    crops = []
    for moment in moments:
        times = (moment + 1e9 * np.arange(0.0, _SEARCHED_S, _SEARCH_STEP_S)).astype(np.int64).tolist()
        for image in recording.images(topic, t_ns=times):
            part = crop_to_rendered(image.pixels) if isinstance(image, Image) else None
            if part is not None:
                size = (width, round(width / _ASPECT))
                crops.append((image.t_ns / 1e9, np.asarray(cv2.resize(part, size), np.uint8)))
                break
    return crops


def crop_to_rendered(pixels: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Crops a grey image (H, W) to the smallest part of 4:3 around all that is rendered; None if a border cuts it."""
    image_height, image_width = pixels.shape
    drawn = np.abs(pixels.astype(np.int16) - BLANK) > _LEAST_GREY  # (H, W) pixels that differ from the blank grey
    x, y, width, height = cv2.boundingRect(drawn.astype(np.uint8))  # left, top and size of the rendered part
    # nothing is rendered, or the rendered part touches a border of the image
    if min(width, height, x, y, image_width - x - width, image_height - y - height) == 0:
        return None
    # the smallest 4:3 around it (narrower where the image is), centred on it and then shifted into the image
    crop_height = max(height, round(width / _ASPECT))
    crop_width = min(round(crop_height * _ASPECT), image_width)
    left = min(max(x + (width - crop_width) // 2, 0), image_width - crop_width)
    top = min(max(y + (height - crop_height) // 2, 0), image_height - crop_height)
    return pixels[top : top + crop_height, left : left + crop_width]


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
    """Encodes frames and keeps a strip of stills; equal frames give equal bytes.

    Args:
        frames: Time in s and (H, W, 3) RGB, at `FPS`; height and width are even.
        duration_s: Length of the walk, which spaces the stills.
        count: Number of stills.

    Raises:
        StrideTwinError: There is no frame.
    """
    # times of the stills, in the middle of equal parts of the walk
    wanted = [(i + 0.5) / count * duration_s for i in range(count)]
    stills: list[tuple[float, NDArray[np.uint8]]] = []
    webm = io.BytesIO()
    with av.open(webm, "w", format="webm", options={"fflags": "+bitexact"}) as film:  # no random identifiers
        stream = film.add_stream("libvpx-vp9", rate=FPS, options=_VP9)
        stream.pix_fmt = "yuv420p"
        stream.codec_context.thread_count = 1  # for equal bytes
        for t, rgb in frames:
            if not stream.codec_context.is_open:  # the first frame sets the size
                stream.height, stream.width = rgb.shape[:2]
            film.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
            if len(stills) < count and t >= wanted[len(stills)]:
                stills.append((t, rgb.copy()))
        if not stream.codec_context.is_open:
            raise StrideTwinError("the film has no frames")
        film.mux(stream.encode())  # the frames that the encoder still holds
    return Film(webm=webm.getvalue(), stills=stills)


def jpeg_uri(image: NDArray[np.uint8], quality: int = 80) -> str:
    """A grey (H, W) or RGB (H, W, 3) image as a JPEG in a `data:` URI."""
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data_uri(data.tobytes(), "image/jpeg")
