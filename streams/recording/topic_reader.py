"""Decoder of one topic's messages to samples, for any writer."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.recording.cdr import MessageLayout, layout_of
from stridetwin.streams.recording.mcap_scan import DamagedError, Messages
from stridetwin.streams.recording.ros_images import IMAGES, detect_image_kind, read_image_message
from stridetwin.streams.recording.ros_samples import SAMPLE_MAPPINGS, SampleMapping, find_mapping, read_stamps
from stridetwin.streams.recording.ros_types import typestore_for
from stridetwin.streams.samples import Block, Depth, Image, Sample, Stamps

READABLE = frozenset([*IMAGES, *(small.typename for small in SAMPLE_MAPPINGS.values())])
"""ROS 2 message types that are decoded to samples."""

SHORTEST_HEADER = 12
"""Bytes of the encapsulation (4) and of the stamp (8) with which a message with a header begins."""
_MOST_UNEQUAL = 20_000
"""Most messages of unequal layout that are decoded one by one, which is slow."""


class TopicReader:
    """Decodes one topic, and remembers the layout of its messages, by which thousands are decoded at once.

    Args:
        topic: Topic.
        typename: ROS 2 message type, one of `READABLE`.
        encoding: Encoding of the schema, `ros2msg` or `ros2idl`.
        definition: Text of the schema.

    Attributes:
        kind: Kind of the samples; None until the first message is read.

    Raises:
        ValueError: The schema cannot be parsed.
    """

    def __init__(self, topic: str, typename: str, encoding: str, definition: str) -> None:
        """Parses the definition of the topic's message type; layout and kind follow from the first message."""
        self.topic, self.typename = topic, typename
        self._store = typestore_for(typename, encoding, definition)
        self._layout: MessageLayout | None = None  # of the messages read last
        self._mapping: SampleMapping | None = None  # to the kind of sample, found with the first message
        self.kind: type[Sample] | None = None

    @property
    def is_image(self) -> bool:
        """Whether the topic carries images, which are decoded one at a time."""
        return self.typename in IMAGES

    def read_times(self, messages: Messages) -> Stamps:
        """Stamps of image messages, (N,) ns, from their headers, or log times if those are empty; decodes no image."""
        if self.kind is None:  # the first messages of the topic
            self.kind = self.detect_image_kind(messages.payload(0))
        t = np.array([read_header_stamp(messages.payload(i)) for i in range(len(messages))], np.int64)
        return t if t.any() else messages.log_time  # stamps that are all 0 were not set

    def detect_image_kind(self, payload: bytes) -> type[Image] | type[Depth]:
        """Whether a message carries colour (or grey) or depth.

        Raises:
            ValueError: The message cannot be decoded.
        """
        return detect_image_kind(payload, self.typename, self._store)

    def read_image(self, payload: bytes, t_ns: int, topic: str | None = None) -> Image | Depth:
        """Decodes one image.

        Args:
            payload: CDR bytes.
            t_ns: Stamp of the sample.
            topic: Topic of the sample, if an import renames it; by default this one.

        Raises:
            ValueError: The message cannot be decoded.
        """
        return read_image_message(payload, self.typename, self._store, topic or self.topic, t_ns)

    def read_block(self, messages: Messages) -> Block[Sample]:
        """Decodes all messages to one block; their stamps are not checked.

        Messages of one layout are decoded all at once. If their layouts differ, as texts or sequences of other lengths
        cause, each is decoded by itself, which is much slower.

        Raises:
            ValueError: A message does not have the topic's type, or too many have unequal lengths.
        """
        if np.all(messages.lengths == messages.lengths[0]):
            rows = messages.rows()  # (N,) items of raw bytes
            layout = self._layout  # that of the messages before, which is most often that of these, too
            if layout is None or layout.dtype.itemsize != rows.itemsize or not layout.fits(rows):
                layout = layout_of(messages.payload(0), self.typename, self._store)
            if layout.fits(rows):
                self._layout = layout
                return self._decode(layout, rows.view(layout.dtype), messages.log_time)
        if len(messages) > _MOST_UNEQUAL:
            raise ValueError(f"{len(messages)} messages of unequal layout together: expected up to {_MOST_UNEQUAL}")
        return concatenate_blocks([self._decode_single(messages, i) for i in range(len(messages))])

    def _decode_single(self, messages: Messages, i: int) -> Block[Sample]:
        """Decodes message `i`, whose layout may differ from that of the others, to a block of one sample."""
        payload = messages.payload(i)
        layout = layout_of(payload, self.typename, self._store)
        return self._decode(layout, np.frombuffer(payload, layout.dtype), messages.log_time[i : i + 1])

    def _decode(self, layout: MessageLayout, rows: NDArray[np.void], log_time: Stamps) -> Block[Sample]:
        """Decodes messages of one layout to a block.

        Args:
            layout: Where the messages have their numbers and texts.
            rows: (N,) messages as records of that layout.
            log_time: (N,) ns, the stamps of messages without stamps of their own.

        Raises:
            ValueError: A row has an invalid value, such as an unknown terrain.
        """
        if self._mapping is None:
            self._mapping = find_mapping(self.typename, rows[:1])  # by the topic's first message
        mapping = self._mapping
        self.kind = mapping.kind
        try:
            columns = mapping.read(rows)
        except (IndexError, KeyError) as error:
            raise ValueError(f"{self.typename} with an invalid value: {error}") from error
        return Block(
            topic=self.topic,
            kind=mapping.kind,
            t_ns=read_stamps(rows, log_time),
            columns=columns,
            constants=mapping.constants(layout),
        )


def concatenate_blocks(blocks: list[Block[Sample]]) -> Block[Sample]:
    """Joins blocks of one topic, one after the other.

    Raises:
        ValueError: Their constants or their columns' shapes differ.
    """
    first = blocks[0]
    for block in blocks:
        if block.constants != first.constants:
            raise ValueError(f"{dict(block.constants)} where the topic had {dict(first.constants)}")
    return Block(
        topic=first.topic,
        kind=first.kind,
        t_ns=np.concatenate([b.t_ns for b in blocks]),
        columns={name: np.concatenate([b.columns[name] for b in blocks]) for name in first.columns},
        constants=first.constants,
    )


def read_header_stamp(payload: bytes) -> int:
    """Reads the stamp in the header at the beginning of a CDR message, ns.

    Raises:
        DamagedError: The message is too short.
    """
    if len(payload) < SHORTEST_HEADER:
        raise DamagedError("a message too short for its header")
    # after 4 bytes of encapsulation, the second of which says the byte order
    sec, nanosec = struct.unpack_from("<iI" if payload[1] else ">iI", payload, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)
