"""Reading a recording: what it holds, its samples in time order, and what would spoil an estimate.

Opening a recording reads it once and refuses whatever would silently spoil an estimate; after that, samples
stream from it chunk by chunk. Any MCAP file with standard ROS 2 messages will do, not only ours.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.mcap_scan import Messages, chunk_contents, read_chunk
from stridetwin.streams.recorder import RIG_NAME, RecordingWriter
from stridetwin.streams.recording_index import ChunkInfo, Part, Problem, RecordingIndex, TopicInfo
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Depth, Image, Sample
from stridetwin.streams.topic_reader import TopicReader, concatenated, finite, increasing, selected

__all__ = ["Problem", "Recording", "RecordingWriter", "TopicInfo"]


class Recording:
    """One recording, opened and checked.

    Args:
        path: MCAP file.
        lenient: Read what can be read: a cut-off file up to its last whole chunk, without the bad samples and
            the damaged chunks. What was wrong stands in `problems`.

    Attributes:
        topics: What the recording holds, by topic.
        metadata: Texts stored with it.
        problems: What would spoil an estimate; empty unless `lenient`.
        unread: Type of the messages of every topic that is not read.

    Raises:
        RecordingError: It cannot be read, or (unless `lenient`) something in it would spoil an estimate.
    """

    def __init__(self, path: str | Path, lenient: bool = False) -> None:
        self.path = Path(path)
        self.lenient = lenient
        self._index = RecordingIndex(self.path, lenient)
        self.topics = self._index.topics
        self.metadata = self._index.metadata
        self.problems = self._index.problems
        self.unread = self._index.unread

    @property
    def rig(self) -> Rig:
        """The calibration stored with it.

        Raises:
            RecordingError: There is none.
        """
        if self._index.rig is None:
            raise RecordingError(f"{self.path}: no calibration inside; valid: an attachment {RIG_NAME} (Kalibr YAML)")
        return self._index.rig

    @property
    def has_rig(self) -> bool:
        """Whether a calibration is stored with it."""
        return self._index.rig is not None

    @property
    def duration(self) -> float:
        """Seconds from the first sample of any topic to the last."""
        if not self.topics:
            return 0.0
        return (max(t.last_ns for t in self.topics.values()) - min(t.first_ns for t in self.topics.values())) * 1e-9

    def samples(self, topics: Iterable[str] | None = None) -> Iterator[Sample]:
        """The samples of some topics (all by default) in time order, read chunk by chunk.

        At equal stamps pictures come last, so that an IMU sample that closes an interval precedes the picture
        taken then; otherwise topics follow each other by name.

        Raises:
            RecordingError: There is no such topic; the message lists those there are. Or a picture is
                damaged.
        """
        wanted = list(self.topics) if topics is None else list(dict.fromkeys(topics))
        for topic in wanted:
            self._reader(topic)
        order = {t: i for i, t in enumerate(sorted(wanted, key=lambda t: (self._index.readers[t].is_picture, t)))}
        parts = [
            (min(c.parts[t].first for t in here), i, here, c)
            for i, c in enumerate(self._index.chunks)
            if (here := [t for t in wanted if t in c.parts])
        ]
        heap: list[tuple[int, int, int, Sample, Iterator[Sample]]] = []
        for start, i, here, chunk in sorted(parts, key=lambda p: p[:2]):
            yield from _until(heap, start)
            for topic, samples in self._chunk_samples(chunk, here):
                if (first := next(samples, None)) is not None:
                    heapq.heappush(heap, (first.t_ns, order[topic], i, first, samples))
        yield from _until(heap, None)

    def block(self, topic: str) -> Block[Any]:
        """All samples of a topic as one block; not for pictures.

        Raises:
            RecordingError: There is no such topic, or it carries pictures.
        """
        reader = self._reader(topic)
        if reader.is_picture:
            raise RecordingError(f"{self.path}: {topic} carries pictures; valid: samples() or images()")
        blocks = [
            self._kept_block(reader, messages, chunk.parts[topic])
            for chunk in self._index.chunks
            if topic in chunk.parts
            for messages in self._messages(chunk, [topic]).values()
        ]
        return concatenated(blocks)

    def images(
        self, topic: str, indices: Sequence[int] | None = None, t_ns: Sequence[int] | None = None
    ) -> list[Image | Depth]:
        """A few pictures of a topic, by their number or as the nearest to the given times (all by default).

        Raises:
            RecordingError: There is no such topic or picture, or it carries no pictures.
        """
        times = self.picture_times(topic)
        if t_ns is not None:
            indices = [int(np.argmin(np.abs(times - t))) for t in t_ns]
        wanted = range(len(times)) if indices is None else indices
        found: dict[int, Image | Depth] = {}
        start = 0
        for chunk in self._index.chunks:
            count = chunk.parts[topic].count if topic in chunk.parts else 0
            here = sorted({i for i in wanted if start <= i < start + count})
            if here:
                kept = self._kept_pictures(topic, self._messages(chunk, [topic])[topic], chunk.parts[topic])
                chosen = kept.some(np.array(here) - start)
                found |= dict(zip(here, self._pictures(topic, chosen)))
            start += count
        missing = [i for i in wanted if i not in found]
        if missing:
            raise RecordingError(f"{self.path}: {topic} has no picture {missing[0]}; valid: 0 to {len(times) - 1}")
        return [found[i] for i in wanted]

    def picture_times(self, topic: str) -> NDArray[np.int64]:
        """(N,) ns, stamps of a topic's pictures.

        Raises:
            RecordingError: There is no such topic, or it carries no pictures.
        """
        if not self._reader(topic).is_picture:
            raise RecordingError(f"{self.path}: {topic} carries no pictures; valid: block()")
        return np.concatenate(self._index.picture_times[topic])

    def _reader(self, topic: str) -> TopicReader:
        if topic not in self.topics:
            there = ", ".join(sorted(self.topics)) or "none"
            raise RecordingError(f"{self.path}: no topic {topic!r}; it has {there}")
        return self._index.readers[topic]

    def _messages(self, chunk: ChunkInfo, topics: list[str]) -> dict[str, Messages]:
        _, by_channel = chunk_contents(read_chunk(self.path, chunk.offset))
        named: dict[str, Messages] = {}
        for channel, messages in by_channel.items():
            named.setdefault(self._index.channels[channel], messages)
        return {topic: named[topic] for topic in topics}

    def _chunk_samples(self, chunk: ChunkInfo, topics: list[str]) -> Iterator[tuple[str, Iterator[Sample]]]:
        for topic, messages in self._messages(chunk, topics).items():
            reader = self._index.readers[topic]
            if reader.is_picture:
                yield topic, self._pictures(topic, self._kept_pictures(topic, messages, chunk.parts[topic]))
            else:
                yield topic, iter(self._kept_block(reader, messages, chunk.parts[topic]))

    def _kept_block(self, reader: TopicReader, messages: Messages, part: Part) -> Block[Any]:
        block = reader.block(messages)
        keep = increasing(block.t_ns, part.before)
        return selected(block, keep if reader.topic.startswith("/truth/") else keep & finite(block))

    def _kept_pictures(self, topic: str, messages: Messages, part: Part) -> Messages:
        t = self._index.readers[topic].times(messages)
        keep = increasing(t, part.before)
        return replace(messages, log_time=t).some(np.flatnonzero(keep))

    def _pictures(self, topic: str, kept: Messages) -> Iterator[Image | Depth]:
        """Decodes pictures one at a time, when they are asked for."""
        for i, t in enumerate(kept.log_time.tolist()):
            try:
                yield self._index.readers[topic].picture(kept.payload(i), t)
            except ValueError as error:
                self._index.note(Problem(topic, t, str(error)))


def _until(heap: list[tuple[int, int, int, Sample, Iterator[Sample]]], end_ns: int | None) -> Iterator[Sample]:
    """Takes the samples before `end_ns` off a heap of (stamp, order, chunk, sample, samples that follow)."""
    while heap and (end_ns is None or heap[0][0] < end_ns):
        _, order, chunk, sample, following = heap[0]
        yield sample
        after = next(following, None)
        if after is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (after.t_ns, order, chunk, after, following))
