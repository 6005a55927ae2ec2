"""A recording's messages in time order: stored ones, or encoded from the samples of another tool's files."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence

from stridetwin.streams.live.messages import Encoder
from stridetwin.streams.live.reorder import rank_of
from stridetwin.streams.live.wire import Message
from stridetwin.streams.recording.index import RecordingIndex
from stridetwin.streams.recording.mcap_scan import chunk_contents, read_chunk
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.topic_reader import increasing
from stridetwin.streams.rig import Rig

_Entry = tuple[int, int, str]


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
    index = RecordingIndex(recording.path, recording.lenient)
    last: dict[str, int] = {}
    heap: list[tuple[_Entry, int, Message]] = []
    chunks = [
        (min(c.parts[t].first for t in here), c, here) for c in index.chunks if (here := c.parts.keys() & set(topics))
    ]
    count = 0
    for start, chunk, here in sorted(chunks, key=lambda c: (c[0], c[1].offset)):
        while heap and heap[0][0][0] < start:
            yield heapq.heappop(heap)[2]
        _, by_channel = chunk_contents(read_chunk(index.path, chunk.offset))
        for channel, messages in by_channel.items():
            topic = index.channels.get(channel, "")
            if topic not in here:
                continue
            reader = index.readers[topic]
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
