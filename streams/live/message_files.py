"""Messages to and from recordings: an MCAP file holds the messages of the bridge unchanged, byte for byte."""

from __future__ import annotations

import heapq
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.files import partial_path
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.messages import Encoder, Message, rank_of
from stridetwin.streams.recording import index
from stridetwin.streams.recording.index import RecordingIndex
from stridetwin.streams.recording.mcap_scan import chunk_contents, read_chunk
from stridetwin.streams.recording.mcap_writer import McapWriter, message_rows
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.ros_images import CAMERA_INFO, IMAGES, camera_info_message
from stridetwin.streams.recording.ros_types import definition
from stridetwin.streams.recording.topic_reader import READABLE, increasing
from stridetwin.streams.recording.writer import METADATA_NAME, RIG_NAME
from stridetwin.streams.rig import CameraCalibration, Rig

_INFO_PERIOD_NS = 1_000_000_000
_IMAGE_LANE = 1


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
        self.path = path
        self.count = 0
        self._known: tuple[str, dict[str, str]] | None = None
        self._channels: dict[str, int] = {}
        self._cameras: dict[str, CameraCalibration] = {}
        self._next_info: dict[str, int] = {}
        for typename in (CAMERA_INFO, *READABLE):
            definition(typename)  # slow: done here so that the first sample does not wait
        try:
            self._file = McapWriter(partial_path(path), "stridetwin")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
        self._file.metadata(index.RECORD, index.written())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.finish()
        if self.count:
            os.replace(partial_path(self.path), self.path)
        else:
            partial_path(self.path).unlink()

    def know(self, rig: Rig, metadata: Mapping[str, str]) -> None:
        """Sets rig and metadata of the senders: before their first message, and when further senders connect."""
        known = rig_to_yaml(rig), dict(metadata)
        if known == self._known:
            return
        self._known = known
        self._file.attachment(RIG_NAME, "application/yaml", known[0].encode())
        self._file.metadata(METADATA_NAME, known[1])
        self._cameras = dict(rig.cameras) | {c.depth_topic: c for c in rig.cameras.values() if c.depth_topic}

    def write(self, message: Message, t_ns: int) -> None:
        """Appends a message, and periodically with images the camera's intrinsics.

        Args:
            message: As received.
            t_ns: Stamp of its sample.
        """
        camera = self._cameras.get(message.topic)
        lane = _IMAGE_LANE if message.typename in IMAGES else 0
        if camera and t_ns >= self._next_info.get(message.topic, 0):
            self._next_info[message.topic] = t_ns + _INFO_PERIOD_NS
            info = camera_info_message(camera, message.topic, t_ns)
            self._append(f"{message.topic}/camera_info", CAMERA_INFO, info, t_ns, lane)
        self._append(message.topic, message.typename, message.payload, t_ns, lane)
        self.count += 1

    def _append(self, topic: str, typename: str, payload: bytes, t_ns: int, lane: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._file.channel(topic, typename, definition(typename))
        layout = np.dtype(f"V{len(payload)}")
        rows, _ = message_rows(self._channels[topic], payload, layout, np.array([t_ns], np.int64))
        self._file.messages(rows, lane)


def stored_messages(recording: Recording, topics: Sequence[str]) -> Iterator[Message]:
    """Messages of some topics in time order, at equal stamps IMUs first and images last.

    Args:
        recording: The messages of an MCAP file are returned unchanged; for other sources images are lossless, and depth
            is in float metres.
        topics: Topics to return.
    """
    if not recording.is_mcap:
        rig = recording.rig if recording.has_rig else Rig()
        encoder = Encoder(rig, depth_encoding="32FC1", jpeg_quality=None)
        yield from _sorted(map(encoder.message, recording.samples(topics)), recording)
        return
    scan = RecordingIndex(recording.path, recording.lenient)
    last: dict[str, int] = {}
    heap: list[tuple[tuple[int, int, str], int, Message]] = []
    chunks = [
        (min(c.parts[t].first for t in here), c, here) for c in scan.chunks if (here := c.parts.keys() & set(topics))
    ]
    count = 0
    for start, chunk, here in sorted(chunks, key=lambda c: (c[0], c[1].offset)):
        while heap and heap[0][0][0] < start:
            yield heapq.heappop(heap)[2]
        _, by_channel = chunk_contents(read_chunk(scan.path, chunk.offset))
        for channel, messages in by_channel.items():
            topic = scan.channels.get(channel, "")
            if topic not in here:
                continue
            reader = scan.readers[topic]
            times = reader.times(messages) if reader.is_image else reader.block(messages).t_ns
            before = chunk.parts[topic].before
            for i in increasing(times, before).nonzero()[0].tolist():
                t_ns = int(times[i])
                if t_ns > last.get(topic, -1):
                    last[topic] = t_ns
                    message = Message(t_ns=t_ns, topic=topic, typename=reader.typename, payload=messages.payload(i))
                    rank = rank_of(recording.topics[topic].kind)
                    count += 1
                    heapq.heappush(heap, ((t_ns, rank, topic), count, message))
    while heap:
        yield heapq.heappop(heap)[2]


def _sorted(messages: Iterator[Message], recording: Recording) -> Iterator[Message]:
    """Messages in time order; those of one instant in our order."""
    group: list[Message] = []
    for message in messages:
        if group and message.t_ns != group[0].t_ns:
            yield from sorted(group, key=lambda m: (rank_of(recording.topics[m.topic].kind), m.topic))
            group = []
        group.append(message)
    yield from sorted(group, key=lambda m: (rank_of(recording.topics[m.topic].kind), m.topic))
