"""Conversion of single samples to ROS 2 messages and back, for live streams."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stridetwin.streams.bounded import check_pixels, image_size
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.cdr import Layout, layout_of
from stridetwin.streams.recording.ros_images import (
    COMPRESSED,
    DEPTH_ENCODINGS,
    IMAGES,
    RAW,
    depth_message,
    image_message,
    read_image_message,
)
from stridetwin.streams.recording.ros_samples import SMALL, Small, block_of, fill, frame_id, small_for, stamps
from stridetwin.streams.recording.ros_types import deserialise, serialise, typestore
from stridetwin.streams.recording.topic_reader import READABLE
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image, Imu, Sample

MOST_PIXELS = 1920 * 1200
"""Most pixels of an image: bounds the size to which a message of a few kilobytes could unpack."""


@dataclass(frozen=True, kw_only=True)
class Message:
    """One message in transit.

    Attributes:
        t_ns: Its stamp.
        topic: Name of the stream.
        typename: ROS 2 type, such as `sensor_msgs/msg/Imu`.
        payload: CDR bytes.
    """

    t_ns: int
    topic: str
    typename: str
    payload: bytes


def rank_of(kind: type[Sample]) -> int:
    """Rank among samples of one instant: IMUs, which close an interval, then other small samples, then images."""
    return 0 if kind is Imu else 2 if kind in (Image, Depth) else 1


class Encoder:
    """Samples to messages.

    Args:
        rig: Its noise and ranges are part of the messages, as in recordings.
        depth_encoding: `16UC1` (mm, as in the RealSense driver) or `32FC1` (m, lossless).
        jpeg_quality: 0 to 100; None sends lossless images.
    """

    def __init__(self, rig: Rig, *, depth_encoding: str = "16UC1", jpeg_quality: int | None = 90) -> None:
        if depth_encoding not in DEPTH_ENCODINGS:
            raise ConfigError("Encoder", "depth_encoding", depth_encoding, " or ".join(DEPTH_ENCODINGS))
        self._rig, self._depth_encoding, self._quality = rig, depth_encoding, jpeg_quality
        self._templates: dict[str, tuple[Small, bytes, Layout]] = {}

    def message(self, sample: Sample) -> Message:
        """The message of a sample."""
        if isinstance(sample, Image):
            typename = RAW if self._quality is None else COMPRESSED
            payload = _raw_image(sample) if self._quality is None else image_message(sample, self._quality)
        elif isinstance(sample, Depth):
            typename, payload = RAW, depth_message(sample, self._depth_encoding)
        else:
            typename, payload = self._small(sample)
        return Message(t_ns=sample.t_ns, topic=sample.topic, typename=typename, payload=payload)

    def _small(self, sample: Sample) -> tuple[str, bytes]:
        block = block_of([sample])
        if sample.topic not in self._templates:
            small = SMALL[type(sample)]
            self._templates[sample.topic] = small, *small.template(sample.topic, self._rig, block.constants)
        small, template, layout = self._templates[sample.topic]
        payload = bytearray(template)
        fill(np.frombuffer(payload, layout.dtype), small, block)
        return small.typename, bytes(payload)


@dataclass(frozen=True, eq=False)
class _Known:
    """Properties of a topic, from its first message.

    Attributes:
        layout: Layout of its numbers; messages with equal `marks` share it.
        marks: Offset and bytes of the values that determine the layout.
        small: Conversion to a sample.
    """

    layout: Layout
    marks: tuple[tuple[int, bytes], ...]
    small: Small

    def fits(self, payload: bytes) -> bool:
        """Whether a message has this layout."""
        same_size = len(payload) == self.layout.dtype.itemsize
        return same_size and all(payload.startswith(word, at) for at, word in self.marks)


class Decoder:
    """Messages of one topic to samples.

    Args:
        topic: Topic.
        typename: ROS 2 type of its messages.

    Raises:
        ValueError: The type is not supported.
    """

    def __init__(self, topic: str, typename: str) -> None:
        if typename not in READABLE:
            raise ValueError(f"{topic}: type {typename[:60]!r} is not read; valid: {', '.join(sorted(READABLE))}")
        self.topic, self.typename = topic, typename
        self._known: _Known | None = None

    def sample(self, message: Message) -> Sample | None:
        """The sample in a message of the topic; None if one of its numbers is not finite.

        Raises:
            ValueError: The bytes are not such a message, or the image has more than `MOST_PIXELS`.
        """
        if self.typename in IMAGES:
            return self._image(message)
        known = self._known
        if known is None or not known.fits(message.payload):
            self._known = known = self._learn(message.payload)
        rows = np.frombuffer(message.payload, known.layout.dtype)
        try:
            columns = known.small.read(rows)
        except (IndexError, KeyError) as error:
            raise ValueError(f"{self.topic}: a {self.typename} with an invalid value: {error}") from error
        t_ns = int(stamps(rows, np.array([message.t_ns]))[0])
        values = {name: column[0] for name, column in columns.items()}
        for value in values.values():
            if isinstance(value, np.ndarray | np.floating) and not np.isfinite(value).all():
                return None
        return known.small.kind(topic=self.topic, t_ns=t_ns, **values, **known.small.constants(known.layout))

    def _learn(self, payload: bytes) -> _Known:
        layout = layout_of(payload, self.typename, typestore())
        small = small_for(self.typename, np.frombuffer(payload, layout.dtype))
        if self._known is not None and small.kind is not self._known.small.kind:
            raise ValueError(
                f"{self.topic}: carried {self._known.small.kind.__name__}; a {small.kind.__name__} is not valid"
            )
        word = "<I" if layout.head[1] else ">I"
        marks = ((0, layout.head), *((at, struct.pack(word, value)) for at, value in layout.lengths))
        return _Known(layout, marks, small)

    def _image(self, message: Message) -> Image | Depth:
        try:
            decoded = deserialise(typestore(), message.payload, self.typename)
            if self.typename == COMPRESSED:
                is_depth = "compressedDepth" in decoded.format
                width, height = image_size(bytes(decoded.data[12:] if is_depth else decoded.data))
            else:
                width, height = decoded.width, decoded.height
            check_pixels(width, height, MOST_PIXELS)
            stamp = decoded.header.stamp
            t_ns = stamp.sec * 1_000_000_000 + stamp.nanosec or message.t_ns
            return read_image_message(message.payload, self.typename, typestore(), self.topic, t_ns)
        except ValueError as error:
            raise ValueError(f"{self.topic}: {error}") from error
        except Exception as error:  # decoders that do not validate their input raise many kinds
            raise ValueError(f"{self.topic}: no {self.typename}: {' '.join(str(error).split())[:120]}") from error


def _raw_image(sample: Image) -> bytes:
    pixels = np.ascontiguousarray(sample.pixels)
    height, width = pixels.shape[:2]
    sec, nanosec = divmod(sample.t_ns, 1_000_000_000)
    values: Mapping[str, Any] = {
        "header.stamp.sec": sec,
        "header.stamp.nanosec": nanosec,
        "header.frame_id": frame_id(sample.topic),
        "height": height,
        "width": width,
        "encoding": "mono8" if pixels.ndim == 2 else "rgb8",
        "step": pixels.nbytes // height,
        "data": pixels.reshape(-1),
    }
    return serialise(RAW, values)
