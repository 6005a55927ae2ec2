"""The samples of one MCAP file, streamed chunk by chunk: any file with standard ROS 2 messages."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.recording.index import ChunkInfo, Part, Problem, RecordingIndex
from stridetwin.streams.recording.mcap_scan import Messages, chunk_contents, read_chunk
from stridetwin.streams.recording.topic_reader import TopicReader, concatenated, finite, increasing, selected
from stridetwin.streams.samples import Block, Depth, Image, Sample


class McapContents(RecordingIndex):
    """Contents of a `Recording` from an MCAP file."""

    def samples(self, topics: list[str]) -> Iterator[Sample]:
        """Samples of the topics in time order, images last at equal stamps."""
        order = {t: i for i, t in enumerate(sorted(topics, key=lambda t: (self.readers[t].is_image, t)))}
        parts = [
            (min(c.parts[t].first for t in here), i, here, c)
            for i, c in enumerate(self.chunks)
            if (here := [t for t in topics if t in c.parts])
        ]
        heap: list[tuple[int, int, int, Sample, Iterator[Sample]]] = []
        for start, i, here, chunk in sorted(parts, key=lambda p: p[:2]):
            yield from _until(heap, start)
            for topic, samples in self._chunk_samples(chunk, here):
                if (first := next(samples, None)) is not None:
                    heapq.heappush(heap, (first.t_ns, order[topic], i, first, samples))
        yield from _until(heap, None)

    def block(self, topic: str) -> Block[Any]:
        """All samples of a topic without images."""
        reader = self.readers[topic]
        blocks = [
            self._kept_block(reader, messages, chunk.parts[topic])
            for chunk in self.chunks
            if topic in chunk.parts
            for messages in self._messages(chunk, [topic]).values()
        ]
        return concatenated(blocks)

    def images(self, topic: str, indices: Sequence[int]) -> dict[int, Image | Depth]:
        """The requested images that exist, by number."""
        found: dict[int, Image | Depth] = {}
        start = 0
        for chunk in self.chunks:
            count = chunk.parts[topic].count if topic in chunk.parts else 0
            here = sorted({i for i in indices if start <= i < start + count})
            if here:
                kept = self._kept_images(topic, self._messages(chunk, [topic])[topic], chunk.parts[topic])
                chosen = kept.some(np.array(here) - start)
                found |= dict(zip(here, self._images(topic, chosen)))
            start += count
        return found

    def image_times(self, topic: str) -> NDArray[np.int64] | None:
        """(N,) ns, None for a topic without images."""
        return np.concatenate(self._image_times[topic]) if self.readers[topic].is_image else None

    def _messages(self, chunk: ChunkInfo, topics: list[str]) -> dict[str, Messages]:
        _, by_channel = chunk_contents(read_chunk(self.path, chunk.offset))
        named: dict[str, Messages] = {}
        for channel, messages in by_channel.items():
            named.setdefault(self.channels[channel], messages)
        return {topic: named[topic] for topic in topics}

    def _chunk_samples(self, chunk: ChunkInfo, topics: list[str]) -> Iterator[tuple[str, Iterator[Sample]]]:
        for topic, messages in self._messages(chunk, topics).items():
            reader = self.readers[topic]
            if reader.is_image:
                yield topic, self._images(topic, self._kept_images(topic, messages, chunk.parts[topic]))
            else:
                yield topic, iter(self._kept_block(reader, messages, chunk.parts[topic]))

    def _kept_block(self, reader: TopicReader, messages: Messages, part: Part) -> Block[Any]:
        block = reader.block(messages)
        keep = increasing(block.t_ns, part.before)
        return selected(block, keep if reader.topic.startswith("/truth/") else keep & finite(block))

    def _kept_images(self, topic: str, messages: Messages, part: Part) -> Messages:
        t = self.readers[topic].times(messages)
        keep = increasing(t, part.before)
        return replace(messages, log_time=t).some(np.flatnonzero(keep))

    def _images(self, topic: str, kept: Messages) -> Iterator[Image | Depth]:
        """Decodes images one at a time, on request."""
        for i, t in enumerate(kept.log_time.tolist()):
            try:
                yield self.readers[topic].image(kept.payload(i), t)
            except ValueError as error:
                self.notes.problem(Problem(topic, t, str(error)))


def _until(heap: list[tuple[int, int, int, Sample, Iterator[Sample]]], end_ns: int | None) -> Iterator[Sample]:
    """Pops the samples before `end_ns` off a heap of (stamp, order, chunk, sample, following samples)."""
    while heap and (end_ns is None or heap[0][0] < end_ns):
        _, order, chunk, sample, following = heap[0]
        yield sample
        after = next(following, None)
        if after is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (after.t_ns, order, chunk, after, following))
