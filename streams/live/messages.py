"""ROS 2 messages of live streams: from and to single samples, from and to recordings, byte for byte."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from stridetwin.streams.bounded_images import check_pixels, image_size
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import partial_path
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.recording import ros_images
from stridetwin.streams.recording.cdr import MessageLayout, layout_of
from stridetwin.streams.recording.mcap_contents import Message
from stridetwin.streams.recording.mcap_writer import IMAGE_LANE, McapWriter
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.recording_schema import METADATA_NAME, RIG_NAME, VERSION_RECORD, VERSION_VALUES
from stridetwin.streams.recording.ros_samples import (
    SAMPLE_MAPPINGS,
    SampleMapping,
    block_of,
    fill_rows,
    find_mapping,
    read_stamps,
)
from stridetwin.streams.recording.ros_types import definition, deserialise, typestore
from stridetwin.streams.recording.topic_reader import READABLE
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image, Imu, Sample

MOST_PIXELS = 1920 * 1200
"""Most pixels of an image: bounds the size to which a message of a few kilobytes could unpack."""


def rank_of(kind: type[Sample]) -> int:
    """Rank of a kind of sample among those of one instant: 0 for IMUs, 2 for images, 1 for others.

    So an estimator has the motion up to an image before it gets the image.
    """
    return 0 if kind is Imu else 2 if kind in (Image, Depth) else 1


class MessageEncoder:
    """Converts single samples to the ROS 2 messages that a `Sender` sends, of the types that recordings have.

    Args:
        rig: Its noise and ranges are part of the messages, as in recordings.
        depth_encoding: `16UC1` (mm, as in the RealSense driver) or `32FC1` (m, lossless).
        jpeg_quality: 0 to 100; None sends lossless images.

    Raises:
        ConfigError: An unknown depth encoding.
    """

    def __init__(self, rig: Rig, *, depth_encoding: str = "16UC1", jpeg_quality: int | None = 90) -> None:
        """Checks the depth encoding; `jpeg_quality` None sends lossless images."""
        if depth_encoding not in ros_images.DEPTH_ENCODINGS:
            raise ConfigError("Encoder", "depth_encoding", depth_encoding, " or ".join(ros_images.DEPTH_ENCODINGS))
        self._rig, self._depth_encoding, self._quality = rig, depth_encoding, jpeg_quality
        # by topic: the mapping of its kind, a message whose numbers are 0, and where its numbers are
        self._templates: dict[str, tuple[SampleMapping, bytes, MessageLayout]] = {}

    def encode(self, sample: Sample) -> Message:
        """Converts a sample to its ROS 2 message.

        A colour image becomes a CompressedImage (JPEG), or without a quality an Image with its pixels; depth becomes an
        Image; any other sample fills the numbers of a message of its topic that is built once.
        """
        if isinstance(sample, Image):
            typename = ros_images.RAW if self._quality is None else ros_images.COMPRESSED
            payload = (
                ros_images.encode_raw_image(sample)
                if self._quality is None
                else ros_images.encode_image(sample, self._quality)
            )
        elif isinstance(sample, Depth):
            typename, payload = ros_images.RAW, ros_images.encode_depth(sample, self._depth_encoding)
        else:
            typename, payload = self._encode_small(sample)
        return Message(t_ns=sample.t_ns, topic=sample.topic, typename=typename, payload=payload)

    def _encode_small(self, sample: Sample) -> tuple[str, bytes]:
        """The ROS 2 type and the CDR bytes of a sample that is no image.

        The first sample of a topic builds the topic's template; every sample fills a copy of it with its numbers.
        """
        block = block_of([sample])
        if sample.topic not in self._templates:
            mapping = SAMPLE_MAPPINGS[type(sample)]
            template, layout = mapping.build_template(sample.topic, self._rig, block.constants)
            self._templates[sample.topic] = mapping, template, layout
        mapping, template, layout = self._templates[sample.topic]
        payload = bytearray(template)
        fill_rows(np.frombuffer(payload, layout.dtype), mapping, block)
        return mapping.typename, bytes(payload)


class MessageDecoder:
    """Converts the ROS 2 messages of one topic to samples.

    Args:
        topic: Topic.
        typename: ROS 2 type of its messages.

    Raises:
        ValueError: The type is not supported.
    """

    def __init__(self, topic: str, typename: str) -> None:
        """Checks that the type is one that can be read."""
        if typename not in READABLE:
            expected = ", ".join(sorted(READABLE))
            raise ValueError(f"{topic}: unsupported type {typename[:60]!r}: expected one of {expected}")
        self.topic, self.typename = topic, typename
        # of the last message, and most often of the next one, too: where its numbers are, and the mapping to a sample
        self._previous: tuple[MessageLayout, SampleMapping] | None = None

    def decode(self, message: Message) -> Sample | None:
        """The sample in a message of the topic; None if one of its numbers is not finite.

        The stamp is that of the message's header or, without one, that of the message.

        Raises:
            ValueError: The bytes are not such a message, or the image has more than `MOST_PIXELS`.
        """
        if self.typename in ros_images.IMAGES:
            return self._decode_image(message)
        known = self._previous  # layout and mapping of the message before
        if known is None or not known[0].fits_message(message.payload):
            self._previous = known = self._parse_layout(message.payload)
        layout, mapping = known
        rows = np.frombuffer(message.payload, layout.dtype)  # (1,) the message as a record
        try:
            columns = mapping.read(rows)
        except (IndexError, KeyError) as error:
            raise ValueError(f"{self.topic}: a {self.typename} with an invalid value: {error}") from error
        t_ns = int(read_stamps(rows, np.array([message.t_ns]))[0])
        values = {name: column[0] for name, column in columns.items()}  # the fields of the one sample
        for value in values.values():
            if isinstance(value, np.ndarray | np.floating) and not np.isfinite(value).all():
                return None
        return mapping.kind(topic=self.topic, t_ns=t_ns, **values, **mapping.constants(layout))

    def _parse_layout(self, payload: bytes) -> tuple[MessageLayout, SampleMapping]:
        """Finds where the numbers of a message are, and the kind of sample that they are.

        Returns:
            Layout of the message, and the mapping by which its numbers become a sample.

        Raises:
            ValueError: The bytes are no message of the type, or the kind differs from that of earlier messages.
        """
        layout = layout_of(payload, self.typename, typestore())
        mapping = find_mapping(self.typename, np.frombuffer(payload, layout.dtype))
        if self._previous is not None:
            _, previous_mapping = self._previous
            if mapping.kind is not previous_mapping.kind:
                before = previous_mapping.kind.__name__
                raise ValueError(f"{self.topic}: invalid {mapping.kind.__name__}: expected {before} as before")
        return layout, mapping

    def _decode_image(self, message: Message) -> Image | Depth:
        """Decodes an image or depth after a check of its declared size.

        Raises:
            ValueError: The bytes are no image of the type, or the image has more than `MOST_PIXELS`.
        """
        try:
            decoded = deserialise(typestore(), message.payload, self.typename)
            if self.typename == ros_images.COMPRESSED:
                # before the PNG of a depth image come 12 bytes of parameters: an integer and two floats of 4 bytes
                is_depth = "compressedDepth" in decoded.format
                width, height = image_size(bytes(decoded.data[12:] if is_depth else decoded.data))
            else:
                width, height = decoded.width, decoded.height
            check_pixels(width, height, MOST_PIXELS)
            stamp = decoded.header.stamp
            t_ns = stamp.sec * 1_000_000_000 + stamp.nanosec or message.t_ns  # a stamp of 0 was not set
            return ros_images.read_image_message(message.payload, self.typename, typestore(), self.topic, t_ns)
        except ValueError as error:
            raise ValueError(f"{self.topic}: {error}") from error
        except Exception as error:  # decoders that do not validate their input raise many kinds
            raise ValueError(f"{self.topic}: no {self.typename}: {' '.join(str(error).split())[:120]}") from error


class LiveRecorder:
    """Writes arriving messages into one MCAP file; a context manager.

    The file grows under a hidden name beside `path` and is renamed at the end, also after an error, because the
    messages received so far are complete. After a kill it stays, readable up to its last complete chunk (`--lenient`).

    Args:
        path: Output file, `.mcap`.

    Attributes:
        count: Messages written.
    """

    def __init__(self, path: Path) -> None:
        """Opens the file under a hidden name, with the version of the schema."""
        self.path = path
        self.count = 0
        self._previous: tuple[str, dict[str, str]] | None = None  # YAML of the rig and metadata, as written last
        self._infos = ros_images.CameraInfos(Rig())
        for typename in (ros_images.CAMERA_INFO, *READABLE):
            definition(typename)  # slow: done here so that the first sample does not wait
        self._file = McapWriter(path)
        self._file.append_metadata(VERSION_RECORD, VERSION_VALUES)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the file, also after an error; without a message it is removed."""
        if self.count:
            self._file.finish()
        else:  # without a message there is no recording
            self._file.abandon()
            partial_path(self.path).unlink()

    def set_rig(self, rig: Rig, metadata: Mapping[str, str]) -> None:
        """Writes rig and metadata of the senders into the file, if they differ from those written before.

        Call it before the first message, and again when further senders connect.
        """
        rig_yaml, texts = rig_to_yaml(rig), dict(metadata)
        if (rig_yaml, texts) == self._previous:
            return
        self._previous = rig_yaml, texts
        self._file.append_attachment(RIG_NAME, "application/yaml", rig_yaml.encode())
        self._file.append_metadata(METADATA_NAME, texts)
        self._infos.rig = rig  # the cameras whose intrinsics are written beside their images

    def write(self, message: Message, t_ns: int) -> None:
        """Appends a message, and periodically with images the camera's intrinsics.

        Args:
            message: As received.
            t_ns: Stamp of its sample.
        """
        # images are collected in chunks of the file apart from other messages
        lane = IMAGE_LANE if message.typename in ros_images.IMAGES else 0
        if (camera := self._infos.find_due_camera(message.topic, t_ns)) is not None:
            info = ros_images.encode_camera_info(camera, message.topic, t_ns)
            self._file.append_message(f"{message.topic}/camera_info", ros_images.CAMERA_INFO, info, t_ns, lane)
        self._file.append_message(message.topic, message.typename, message.payload, t_ns, lane)
        self.count += 1


def to_messages(recording: Recording, topics: Sequence[str]) -> Iterator[Message]:
    """Yields the messages of some topics in time order, at equal stamps IMUs first and images last.

    Args:
        recording: The messages of an MCAP file are returned unchanged; for other sources images are lossless, and depth
            is in float metres.
        topics: Topics to return.
    """
    if recording.is_mcap:
        yield from recording.raw_messages(topics, rank_of)
        return
    rig = recording.rig if recording.has_rig else Rig()
    encoder = MessageEncoder(rig, depth_encoding="32FC1", jpeg_quality=None)
    yield from _sort_by_rank(map(encoder.encode, recording.samples(topics)), recording)


def _sort_by_rank(messages: Iterator[Message], recording: Recording) -> Iterator[Message]:
    """Yields messages that come in time order, those of one instant by the rank of their kind, and then by topic.

    Args:
        messages: The messages; those of one stamp are in any order.
        recording: Says the kind of samples of each topic.
    """
    for _, of_one_instant in groupby(messages, key=lambda m: m.t_ns):
        yield from sorted(of_one_instant, key=lambda m: (rank_of(recording.topics[m.topic].kind), m.topic))
