"""Bulk writer of MCAP files: equal-sized messages become a chunk's records without a Python loop.

The format is that of https://mcap.dev/spec; the record classes of the `mcap` library write everything but the messages
and their indexes.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.files import partial_path
from stridetwin.streams.recording.ros_types import definition

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""
CHUNK_BYTES = 2 << 20
"""Size, without compression, from which on a chunk is finished."""
CHUNK_NS = 2_000_000_000
"""Time from the first message of a chunk from which on a message belongs to the next chunk, ns."""
IMAGE_LANE = 1
"""Number of the lane of images; the other messages are in lane 0."""
# what comes before the payload in the record of a message; `length` is that of the record without opcode and length
_RECORD_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<u8"),
        ("publish", "<u8"),
    ]
)


def build_message_rows(
    channel: int, payload: bytes, layout: np.dtype[np.void], t_ns: NDArray[np.int64]
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Builds N message records that are copies of one serialised message, to be filled with numbers column by column.

    Args:
        channel: Channel they belong to.
        payload: Serialised message, used as template.
        layout: Structured type of the payload.
        t_ns: (N,) log and publish times.

    Returns:
        (N,) records of one contiguous buffer, and a view of the (N,) payloads inside them, to be filled in.
    """
    record = np.dtype(
        {
            "names": ["head", "payload"],
            "formats": [_RECORD_HEAD, layout],
            "offsets": [0, _RECORD_HEAD.itemsize],
            "itemsize": _RECORD_HEAD.itemsize + len(payload),
        }
    )
    head = np.zeros((), _RECORD_HEAD)
    # opcode and length themselves have 9 bytes, which the length does not count
    head["opcode"], head["length"], head["channel"] = Opcode.MESSAGE, record.itemsize - 9, channel
    template = np.frombuffer(head.tobytes() + payload, np.uint8)
    rows = np.tile(template, (len(t_ns), 1)).reshape(-1).view(record)
    rows["head"]["log"] = rows["head"]["publish"] = t_ns
    return rows, rows["payload"]


class _OpenChunk:
    """A chunk that still accepts messages.

    Attributes:
        parts: Bytes of the records, in order; each call of `add` adds one item.
        size: Number of bytes of all records.
        entries: By channel, arrays (N, 2) with the log time in ns and the offset in the chunk of each message.
        times: Log time of the earliest and of the latest message, ns; both 0 without messages.
    """

    def __init__(self) -> None:
        """Begins without messages."""
        self.parts: list[memoryview] = []
        self.size = 0
        self.entries: dict[int, list[NDArray[np.uint64]]] = {}
        self.times = (0, 0)

    def add(self, channel: int, times: NDArray[np.uint64], data: memoryview) -> None:
        """Appends equal-sized message records of one channel.

        Args:
            channel: The channel.
            times: (N,) log times, ns, in order.
            data: The N records.
        """
        first, last = int(times[0]), int(times[-1])
        if self.entries:  # messages of other channels may be earlier or later
            first, last = min(first, self.times[0]), max(last, self.times[1])
        self.times = first, last
        record_size = len(data) // len(times)
        offsets = self.size + record_size * np.arange(len(times), dtype=np.uint64)  # of the records in the chunk
        self.entries.setdefault(channel, []).append(np.column_stack((times, offsets)))
        self.parts.append(data)
        self.size += len(data)


class McapWriter:
    """Appends channels, messages, attachments and metadata to one MCAP file, chunk by chunk.

    Messages go into lanes (images into one, the rest into another). A chunk has messages of one lane only, so that a
    reader of the small streams does not read the bulk. Chunks are compressed (zstd) and have a CRC, and so have the
    whole data section and the summary. Every finished chunk is passed to the operating system at once, so that a killed
    process loses only the open chunks; so are attachments and metadata. The file grows under a hidden name beside
    `path`, and is renamed when it is finished.

    Raises:
        RecordingError: The file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        """Opens the hidden file and writes magic bytes and header."""
        self._path = path
        try:
            self._file = partial_path(path).open("wb")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
        self._crc = 0  # of the data section so far
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._schemas: list[records.Schema] = []
        self._channels: dict[str, records.Channel] = {}  # by topic
        self._chunk_indexes: list[records.ChunkIndex] = []
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []
        self._counts: dict[int, int] = {}  # number of messages, by channel
        self._times: tuple[int, int] | None = None  # earliest and latest log time, ns
        self._lanes: dict[int, _OpenChunk] = {}  # the open chunk of each lane
        self._append(MAGIC)
        self._append(_encode(records.Header(profile="ros2", library="stridetwin")))

    def register_channel(self, topic: str, typename: str) -> int:
        """The id of a topic's channel of CDR messages, which is registered on the first call for the topic.

        A schema with the definition of the message type comes before its first channel. Ids count from 1.
        """
        if topic not in self._channels:
            schema = next((s for s in self._schemas if s.name == typename), None)
            if schema is None:
                schema = records.Schema(len(self._schemas) + 1, definition(typename).encode(), "ros2msg", typename)
                self._schemas.append(schema)
                self._append(_encode(schema))
            channel = records.Channel(len(self._channels) + 1, topic, "cdr", {}, schema.id)
            self._channels[topic] = channel
            self._append(_encode(channel))
        return self._channels[topic].id

    def append_message(self, topic: str, typename: str, payload: bytes, t_ns: int, lane: int) -> None:
        """Appends one message to a lane.

        Args:
            topic: Topic of the message, whose channel is registered if it is the first one.
            typename: Its ROS 2 type.
            payload: Its CDR bytes.
            t_ns: Its log and publish time.
            lane: 0, or `IMAGE_LANE`.
        """
        layout = np.dtype(f"V{len(payload)}")  # raw bytes: the payload stays as it is
        channel = self.register_channel(topic, typename)
        rows, _ = build_message_rows(channel, payload, layout, np.array([t_ns], np.int64))
        self.append_messages(rows, lane)

    def append_messages(self, rows: NDArray[np.void], lane: int = 0) -> None:
        """Appends messages of one channel to a lane, and splits them over chunks as they fill up.

        Args:
            rows: (N,) records that `build_message_rows` has made, N ≥ 1, log times in order.
            lane: 0, or `IMAGE_LANE`.
        """
        channel = int(rows["head"]["channel"][0])
        data = memoryview(rows.view(np.uint8).data)
        times = rows["head"]["log"]
        size = rows.itemsize  # bytes of a record
        self._counts[channel] = self._counts.get(channel, 0) + len(rows)
        start = 0  # number of the next record to append
        while start < len(rows):
            chunk = self._lanes.setdefault(lane, _OpenChunk())
            if chunk.entries and int(times[start]) - chunk.times[0] >= CHUNK_NS:
                self._finish_chunk(lane)
                chunk = self._lanes[lane] = _OpenChunk()
            # as many messages as fit into the chunk by size and come within `CHUNK_NS` of the next one, at least one
            count = max(1, (CHUNK_BYTES - chunk.size) // size)
            count = min(count, len(rows) - start, int(np.searchsorted(times, times[start] + CHUNK_NS)) - start)
            chunk.add(channel, times[start : start + count], data[start * size : (start + count) * size])
            start += count
            if chunk.size >= CHUNK_BYTES - size:  # full, or with no room for another one of these
                self._finish_chunk(lane)

    def append_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Appends an attachment, such as the calibration, and lists it in the summary."""
        body = _encode(records.Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachment_indexes.append(
            records.AttachmentIndex(
                offset=self._file.tell(),
                length=len(body),
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._append(body)
        self._file.flush()

    def append_metadata(self, name: str, values: dict[str, str]) -> None:
        """Appends a metadata record of texts by name, and lists it in the summary."""
        body = _encode(records.Metadata(name=name, metadata=values))
        self._metadata_indexes.append(records.MetadataIndex(offset=self._file.tell(), length=len(body), name=name))
        self._append(body)
        self._file.flush()

    def finish(self) -> None:
        """Completes the file: writes open chunks, summary and footer, closes it and gives it its name.

        The summary repeats schemas and channels and lists chunks, attachments and metadata, so that readers need not
        scan the file. After it come the places of its groups of records, and the footer with its CRC.
        """
        self._finish_chunks()
        self._append(_encode(records.DataEnd(self._crc)))
        start = self._file.tell()  # where the summary begins
        first, last = self._times or (0, 0)  # without messages both are 0
        statistics = records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Sequence[records.McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, self._attachment_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        ]
        summary, offsets = b"", b""  # records of the groups, and the places of the groups
        for opcode, items in groups:
            body = b"".join(_encode(item) for item in items)
            if body:
                offsets += _encode(records.SummaryOffset(opcode, start + len(summary), len(body)))
            summary += body
        # the footer says where the summary and the places begin; its last 4 bytes are the CRC of all of these
        footer = _encode(records.Footer(start, start + len(summary), 0))[:-4]
        tail = summary + offsets + footer
        self._file.write(tail + zlib.crc32(tail).to_bytes(4, "little") + MAGIC)
        self._file.close()
        os.replace(partial_path(self._path), self._path)

    def abandon(self) -> None:
        """Gives the file up: writes open chunks and closes the hidden file, which stays readable without a summary."""
        self._finish_chunks()
        self._file.close()

    def _finish_chunks(self) -> None:
        """Writes the open chunks of all lanes."""
        for lane in sorted(self._lanes):
            self._finish_chunk(lane)

    def _finish_chunk(self, lane: int) -> None:
        """Compresses the open chunk of a lane, and appends it to the file with the index of its messages.

        After the chunk comes one index record per channel, with log time and offset of each message. Where the chunk
        and these records are is noted for the summary at the end of the file.

        Args:
            lane: Number of the lane, which then has no open chunk.
        """
        open_chunk = self._lanes.pop(lane)
        data = b"".join(open_chunk.parts)
        first, last = open_chunk.times
        compressed = self._compressor.compress(data)
        chunk = _encode(
            records.Chunk(
                compression="zstd",
                data=compressed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        start = self._file.tell()
        index_start = start + len(chunk)
        indexes: bytes = b""  # the index records of all channels
        offsets: dict[int, int] = {}  # place of each channel's index record in the file
        for channel, entries in open_chunk.entries.items():
            offsets[channel] = index_start + len(indexes)
            body = np.concatenate(entries).astype("<u8").tobytes()  # log time and offset of each message in turn
            builder = RecordBuilder()
            builder.start_record(Opcode.MESSAGE_INDEX)
            builder.write2(channel)
            builder.write4(len(body))
            builder.write(body)
            builder.finish_record()
            indexes += builder.end()
        self._append(chunk + indexes)
        self._file.flush()
        self._chunk_indexes.append(
            records.ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=last,
                message_index_length=len(indexes),
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(data),
            )
        )
        earliest, latest = self._times or (first, last)
        self._times = min(earliest, first), max(latest, last)

    def _append(self, data: bytes) -> None:
        """Appends bytes to the data section, and to its CRC."""
        self._crc = zlib.crc32(data, self._crc)
        self._file.write(data)


def _encode(record: records.McapRecord) -> bytes:
    """The bytes of a record of the `mcap` library."""
    builder = RecordBuilder()
    record.write(builder)
    encoded: bytes = builder.end()
    return encoded
