"""MCAP files read front to back without their summary, so that a cut-off file reads like a whole one.

The stock reader needs the summary at the end, which a killed writer never wrote; here the records are walked
as they lie, and every CRC that the file carries is checked on the way.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from numpy.typing import NDArray

from stridetwin.streams.mcap_writer import MAGIC

MESSAGE_HEAD = 31
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQH")
_LARGEST_CHUNK = 1 << 31
R = TypeVar("R")


class DamagedError(ValueError):
    """Bytes that are not what the file says they are."""


class CutOffError(DamagedError):
    """The file ends, or stops making sense, before its footer."""


@dataclass(frozen=True, eq=False)
class Messages:
    """Messages of one channel inside a chunk.

    Attributes:
        data: The chunk's uncompressed bytes.
        starts: (N,) offset of each payload in `data`.
        lengths: (N,) bytes of each payload.
        log_time: (N,) ns.
    """

    data: bytes
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    log_time: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.starts)

    def payload(self, i: int) -> bytes:
        """Bytes of one message."""
        return self.data[self.starts[i] : self.starts[i] + self.lengths[i]]

    def some(self, chosen: NDArray[np.int64]) -> Messages:
        """The messages with the given numbers (K,)."""
        return Messages(self.data, self.starts[chosen], self.lengths[chosen], self.log_time[chosen])

    def rows(self) -> NDArray[np.void]:
        """(N,) raw items, for messages of one common length."""
        return _gather(self.data, np.dtype(f"V{self.lengths[0]}"), self.starts)


def top_records(path: Path) -> Iterator[tuple[Opcode | int, int, bytes]]:
    """Yields (opcode, offset of the record, body) of every top-level record up to the footer.

    Raises:
        CutOffError: The file ends too early, or a record cannot be one.
        DamagedError: No MCAP file, or the CRC of the data section or the summary is wrong (after the last
            record).
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise DamagedError("this is no MCAP file")
        crc, problem = zlib.crc32(MAGIC), ""
        while True:
            offset = file.tell()
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                raise CutOffError(f"the file is cut off at byte {offset}")
            opcode, length = _HEAD.unpack(head)
            if opcode == 0 or length > size - file.tell():
                raise CutOffError(f"the file is cut off or damaged at byte {offset}")
            body = file.read(length)
            if opcode == Opcode.DATA_END:
                (told,) = struct.unpack("<I", body)
                problem = "CRC mismatch of the data section" if told not in (0, crc) else ""
                crc = 0
            elif opcode == Opcode.FOOTER:
                told = struct.unpack("<I", body[-4:])[0] if len(body) == 20 else -1
                if told not in (0, zlib.crc32(head + body[:-4], crc)):
                    problem = problem or "CRC mismatch of the summary"
                if file.read() != MAGIC:
                    raise CutOffError(f"the file is cut off at byte {offset}")
                if problem:
                    raise DamagedError(problem)
                return
            else:
                crc = zlib.crc32(body, zlib.crc32(head, crc))
            yield opcode, offset, body


def parse(record: type[R], body: bytes) -> R:
    """A record of the mcap library from its body.

    Raises:
        DamagedError: The body is no such record.
    """
    try:
        return record.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    except (struct.error, EndOfFile, UnicodeDecodeError) as error:
        raise DamagedError(f"a damaged {record.__name__} record") from error


def read_chunk(path: Path, offset: int) -> bytes:
    """Uncompressed bytes of the chunk whose record starts at `offset`."""
    with path.open("rb") as file:
        file.seek(offset)
        _, length = _HEAD.unpack(file.read(_HEAD.size))
        return decompress(parse(records.Chunk, file.read(length)))


def decompress(chunk: records.Chunk) -> bytes:
    """Uncompressed bytes of a chunk.

    Raises:
        DamagedError: They do not come out as the chunk's size and CRC say.
    """
    size = chunk.uncompressed_size
    try:
        if chunk.compression == "zstd":
            frame = zstandard.frame_content_size(chunk.data)
            if size > _LARGEST_CHUNK or frame not in (-1, size):
                raise DamagedError("a damaged chunk")
            data = zstandard.decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "lz4":
            data = lz4.frame.decompress(chunk.data)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise DamagedError(f"compression {chunk.compression!r} is not known")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise DamagedError(f"a damaged chunk ({error})") from error
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise DamagedError("CRC mismatch of a chunk")
    return data


def chunk_contents(data: bytes) -> tuple[list[records.McapRecord], dict[int, Messages]]:
    """Schemas and channels of a chunk, and its messages by channel id.

    Raises:
        DamagedError: The bytes are no sequence of records.
    """
    found: list[records.McapRecord] = []
    offsets: dict[int, list[int]] = {}
    at, end = 0, len(data)
    unpack, message = _MESSAGE.unpack_from, int(Opcode.MESSAGE)
    try:
        while at < end:
            opcode, length, channel = unpack(data, at)
            if opcode == message:
                offsets.setdefault(channel, []).append(at)
            elif opcode == Opcode.SCHEMA:
                found.append(parse(records.Schema, data[at + 9 : at + 9 + length]))
            elif opcode == Opcode.CHANNEL:
                found.append(parse(records.Channel, data[at + 9 : at + 9 + length]))
            at += 9 + length
    except struct.error as error:
        raise DamagedError("a damaged chunk") from error
    if at != end:
        raise DamagedError("a damaged chunk")
    return found, {channel: messages_at(data, np.array(at_, np.int64)) for channel, at_ in offsets.items()}


def messages_at(data: bytes, offsets: NDArray[np.int64]) -> Messages:
    """The messages whose records start at `offsets` (N,)."""
    head = np.dtype({"names": ["n", "log"], "formats": ["<u8", "<u8"], "offsets": [1, 15], "itemsize": MESSAGE_HEAD})
    heads = _gather(data, head, offsets)
    lengths = heads["n"].astype(np.int64) - (MESSAGE_HEAD - 9)
    return Messages(data, offsets + MESSAGE_HEAD, lengths, heads["log"].astype(np.int64))


def _gather(data: bytes, item: np.dtype[Any], starts: NDArray[np.int64]) -> NDArray[np.void]:
    windows = np.ndarray((max(0, len(data) - item.itemsize + 1),), f"V{item.itemsize}", data, strides=(1,))
    return windows[starts].view(item)
