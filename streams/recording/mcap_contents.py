"""The samples of one MCAP file, streamed chunk by chunk: any file with standard ROS 2 messages."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.recording.index import ChunkInfo, ChunkPart, Problem, RecordingIndex
from stridetwin.streams.recording.mcap_scan import Messages, chunk_contents, read_chunk
from stridetwin.streams.recording.topic_reader import TopicReader, concatenate_blocks
from stridetwin.streams.samples import Block, Depth, Image, Sample, Stamps, is_increasing


@dataclass(frozen=True, kw_only=True)
class Message:
    """A ROS 2 message, stored in a recording or in transit between two programs.

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


Item = TypeVar("Item", Sample, Message)
Order = tuple[int, str]
"""Rank of a topic among those of one instant, and its name, which decides between equal ranks; the least is first."""


class McapContents(RecordingIndex):
    """The samples of an MCAP file with standard ROS 2 messages; the `Contents` of a `Recording`.

    Samples are streamed chunk by chunk, so that a file of any length needs the memory of those that overlap in time.
    """

    def __init__(self, path: Path, lenient: bool) -> None:
        """Reads the file once: `RecordingIndex` finds its topics, chunks, problems and calibration."""
        super().__init__(path, lenient)
        # the chunk unpacked last: its offset in the file, and its messages by topic
        self._unpacked: tuple[int, dict[str, Messages]] = (-1, {})
        # by topic: its chunks, and the number of its images up to the end of each
        self._chunks_of: dict[str, tuple[list[ChunkInfo], NDArray[np.int64]]] = {}

    def samples(self, topics: list[str]) -> Iterator[Sample]:
        """Samples of the topics in time order, images last at equal stamps."""
        order = {topic: (int(self.readers[topic].is_image), topic) for topic in topics}
        return self._merge_by_time(order, self._chunk_samples)

    def messages(self, topics: Sequence[str], rank_of: Callable[[type[Sample]], int]) -> Iterator[Message]:
        """Yields the stored messages of the topics in time order.

        Args:
            topics: Topics to return.
            rank_of: Rank of a kind of sample among those of one instant.
        """
        order = {topic: (rank_of(self.topics[topic].kind), topic) for topic in topics}
        return self._merge_by_time(order, self._chunk_messages)

    def _merge_by_time(
        self, order: Mapping[str, Order], read: Callable[[ChunkInfo, list[str]], Iterator[tuple[str, Iterator[Item]]]]
    ) -> Iterator[Item]:
        """Yields the items of the topics in time order, merged over chunks that overlap in time.

        Args:
            order: Rank and name of each topic, by which items of equal stamps are ordered.
            read: Reads some topics of a chunk: pairs of a topic and its items.
        """
        # each chunk with one of the topics: earliest stamp, number of the chunk, its topics, the chunk
        parts: list[tuple[int, int, list[str], ChunkInfo]] = []
        for i, chunk in enumerate(self.chunks):
            if chunk_topics := [topic for topic in order if topic in chunk.parts]:
                parts.append((min(chunk.parts[topic].first for topic in chunk_topics), i, chunk_topics, chunk))
        # the next item of each topic in each chunk that is open, with what decides the order before it: stamp, rank and
        # name of the topic, and number of the chunk
        heap: list[tuple[int, Order, int, Item, Iterator[Item]]] = []
        for start, i, chunk_topics, chunk in sorted(parts, key=lambda part: part[:2]):
            yield from _pop_until(heap, start)  # no later chunk has anything before its start
            for topic, items in read(chunk, chunk_topics):
                if (first := next(items, None)) is not None:
                    heapq.heappush(heap, (first.t_ns, order[topic], i, first, items))
        yield from _pop_until(heap, None)

    def blocks(self, topics: Sequence[str]) -> dict[str, Block[Sample]]:
        """All samples of the topics, as one block each, in one pass over the file; for topics without images.

        Those of IMUs may be in memory from the first pass (`_kept`); the others are read from their chunks.
        """
        parts: dict[str, list[Block[Sample]]] = {topic: list(self._kept.get(topic, ())) for topic in topics}
        to_read = [topic for topic in topics if topic not in self._kept]
        for chunk in self.chunks:
            chunk_topics = [topic for topic in to_read if topic in chunk.parts]
            if not chunk_topics:
                continue
            for topic, messages in self._read_messages(chunk, chunk_topics).items():
                parts[topic].append(self._decode_valid_block(self.readers[topic], messages, chunk.parts[topic]))
        return {topic: concatenate_blocks(blocks) for topic, blocks in parts.items()}

    def images(self, topic: str, indices: Sequence[int]) -> dict[int, Image | Depth]:
        """Reads images of a topic by number; those that do not exist or (when lenient) are damaged are missing."""
        images: dict[int, Image | Depth] = {}
        chunks, ends = self._chunks_with_images(topic)  # `ends`: number of images up to the end of each chunk
        wanted = np.array(sorted({i for i in indices if 0 <= i < ends[-1]}), np.int64)
        chunk_numbers = np.searchsorted(ends, wanted, side="right")  # which of `chunks` has each of them
        for k, numbers in _split_by_group(wanted, chunk_numbers):  # `numbers`: of the wanted images in chunk k
            part = chunks[k].parts[topic]
            stored = self._select_ordered_images(topic, self._read_messages(chunks[k], [topic])[topic], part)
            first_number = ends[k] - part.count  # of the first image in the chunk
            chosen = stored.select(numbers - first_number)
            images |= dict(zip(numbers.tolist(), self._decode_images(topic, chosen)))
        return images

    def _chunks_with_images(self, topic: str) -> tuple[list[ChunkInfo], NDArray[np.int64]]:
        """Chunks with images of a topic, and the number of its images up to the end of each, kept for the next call."""
        if topic not in self._chunks_of:
            chunks = [chunk for chunk in self.chunks if topic in chunk.parts]
            self._chunks_of[topic] = chunks, np.cumsum([chunk.parts[topic].count for chunk in chunks])
        return self._chunks_of[topic]

    def image_times(self, topic: str) -> Stamps | None:
        """Stamps of a topic's images, (N,) ns; None for a topic without images."""
        return self.times(topic) if self.readers[topic].is_image else None

    def times(self, topic: str) -> Stamps:
        """Stamps of a topic's samples, (N,) ns, which are known from the first pass over the file."""
        return self._times[topic]

    def _read_messages(self, chunk: ChunkInfo, topics: list[str]) -> dict[str, Messages]:
        """The messages of some topics in a chunk; the last chunk stays unpacked, as topics are read in turn."""
        offset, by_topic = self._unpacked
        if offset != chunk.offset:
            _, by_channel = chunk_contents(read_chunk(self.path, chunk.offset))
            by_topic = {}
            for channel, messages in by_channel.items():
                # of several publishers the first is read; a channel without a definition has no topic
                by_topic.setdefault(self.channels.get(channel, ""), messages)
            self._unpacked = chunk.offset, by_topic
        return {topic: by_topic[topic] for topic in topics}

    def _chunk_samples(self, chunk: ChunkInfo, topics: list[str]) -> Iterator[tuple[str, Iterator[Sample]]]:
        """Yields each topic of a chunk with its samples; images are decoded one by one on request."""
        for topic, messages in self._read_messages(chunk, topics).items():
            reader = self.readers[topic]
            if reader.is_image:
                ordered = self._select_ordered_images(topic, messages, chunk.parts[topic])
                yield topic, self._decode_images(topic, ordered)
            else:
                yield topic, iter(self._decode_valid_block(reader, messages, chunk.parts[topic]))

    def _chunk_messages(self, chunk: ChunkInfo, topics: list[str]) -> Iterator[tuple[str, Iterator[Message]]]:
        """Yields each topic of a chunk with its messages as stored, without those whose stamps do not increase."""
        for topic, messages in self._read_messages(chunk, topics).items():
            yield topic, self._iterate_messages(self.readers[topic], messages, chunk.parts[topic])

    def _iterate_messages(self, reader: TopicReader, messages: Messages, part: ChunkPart) -> Iterator[Message]:
        """Yields the messages of a topic in a chunk whose stamps increase, with their stamps.

        Args:
            reader: Decoder of the topic, which finds the stamps.
            messages: The messages.
            part: Entry of the index, which has the latest stamp before the chunk.
        """
        times = reader.read_times(messages) if reader.is_image else reader.read_block(messages).t_ns
        for i in np.flatnonzero(is_increasing(times, part.before)).tolist():
            payload = messages.payload(i)
            yield Message(t_ns=int(times[i]), topic=reader.topic, typename=reader.typename, payload=payload)

    def _decode_valid_block(self, reader: TopicReader, messages: Messages, part: ChunkPart) -> Block[Sample]:
        """The samples of a topic in a chunk with increasing stamps and finite numbers (ground truth may have NaN).

        Args:
            reader: Decoder of the topic.
            messages: Its messages in the chunk.
            part: Entry of the index, which has the latest stamp before the chunk.
        """
        block = reader.read_block(messages)
        rising = is_increasing(block.t_ns, part.before)
        return block[rising if reader.topic.startswith("/truth/") else rising & block.finite]

    def _select_ordered_images(self, topic: str, messages: Messages, part: ChunkPart) -> Messages:
        """The messages of an image topic in a chunk whose stamps increase, with the stamps in place of log times."""
        stamps = self.readers[topic].read_times(messages)
        rising = is_increasing(stamps, part.before)  # `before`: the latest stamp before the chunk
        return replace(messages, log_time=stamps).select(np.flatnonzero(rising))

    def _decode_images(self, topic: str, messages: Messages) -> Iterator[Image | Depth]:
        """Yields the images of a topic one by one; a damaged one is reported, and (when lenient) left out.

        Args:
            topic: The topic.
            messages: Its messages as `_select_ordered_images` returns them, with their stamps in place of log times.
        """
        for i, t_ns in enumerate(messages.log_time.tolist()):
            try:
                yield self.readers[topic].read_image(messages.payload(i), t_ns)
            except ValueError as error:
                self.notes.add_problem(Problem(topic, t_ns, str(error)))


def _split_by_group(values: NDArray[np.int64], groups: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yields each group's number with its values.

    Args:
        values: (N,) values.
        groups: (N,) number of the group of each value, sorted.
    """
    edges = np.flatnonzero(np.diff(groups)) + 1  # index of the first value of each group but the first one
    for first, part in zip(np.concatenate(([0], edges)), np.split(values, edges)):
        if len(part):  # there is one empty part if there are no values
            yield int(groups[first]), part


def _pop_until(heap: list[tuple[int, Order, int, Item, Iterator[Item]]], end_ns: int | None) -> Iterator[Item]:
    """Yields the items with stamps before `end_ns` (all of them for None) in time order, and removes them from a heap.

    An entry of the heap is the next item of one topic in one chunk: (stamp, order, number of the chunk, item, following
    items). When it is yielded, the first of the following items takes its place.
    """
    while heap and (end_ns is None or heap[0][0] < end_ns):
        _, order, chunk, item, following = heap[0]
        yield item
        after = next(following, None)
        if after is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (after.t_ns, order, chunk, after, following))
