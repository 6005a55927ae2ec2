"""Size limits of ROS 1 bags for the rosbags library, which does not validate a bag's index and chunks.

The format is that of http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import os
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
from rosbags import rosbag1
from rosbags.rosbag1.reader import Compression, Header, decompressors

from stridetwin.streams.mcap_scan import LARGEST_CHUNK

_LONGEST_HEADER = 1 << 20
_MOST_CONNECTIONS = 2000
_BYTES_PER_ENTRY = 12  # of an index
_FREE_BYTES, _BYTES_PER_BYTE = 1 << 30, 200
_KINDS = {decompressors[kind.value]: kind for kind in Compression}


def check_index(path: Path) -> None:
    """Rejects an index whose headers, or their numbers, exceed the size of the file.

    Raises:
        ValueError: They do; or any exception of rosbags if the index cannot be read.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        file.readline(100)
        header = _header(file, size)
        connections, chunks = header.get_uint32("conn_count"), header.get_uint32("chunk_count")
        if connections > _MOST_CONNECTIONS or chunks > size // 32:
            raise ValueError(f"{connections} connections and {chunks} chunks are more than the file can hold")
        if not (index := header.get_uint64("index_pos")):
            return  # a truncated file, which the library reports
        file.seek(index)
        for _ in range(connections):
            _header(file, size)
            _header(file, size)
        for _ in range(chunks):
            if _header(file, size).get_uint32("count") > connections:
                raise ValueError("a chunk with more connections than the bag has")
            length = int.from_bytes(file.read(4), "little")
            file.seek(length, os.SEEK_CUR)


class BoundedReader(rosbag1.Reader):
    """The library's reader with limits: on the size of a chunk, on the total unpacked, and on repeated indexes."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._size = path.stat().st_size
        self._bytes = _FREE_BYTES + _BYTES_PER_BYTE * self._size
        self._entries = self._size // _BYTES_PER_ENTRY

    def read_chunk(self) -> Any:
        """Position of a chunk, and how to unpack it.

        Raises:
            ValueError: The packed chunk is larger than `LARGEST_CHUNK`.
        """
        chunk = super().read_chunk()
        if chunk.datasize > LARGEST_CHUNK:
            raise ValueError(f"a chunk of {chunk.datasize} bytes; valid: up to {LARGEST_CHUNK}")
        return chunk._replace(decompressor=partial(self._unpacked, _KINDS[chunk.decompressor]))

    def read_index_data(self, pos: int, indexes: Any) -> None:
        """Reads the index of one connection in one chunk.

        Raises:
            ValueError: All indexes together are longer than the file.
        """
        assert self.bio is not None
        here = self.bio.tell()
        self._entries -= int.from_bytes(self.bio.read(55)[51:], "little") // _BYTES_PER_ENTRY
        if self._entries < 0:
            raise ValueError("an index longer than the bag")
        self.bio.seek(here)
        super().read_index_data(pos, indexes)

    def _unpacked(self, kind: Compression, data: bytes) -> bytes:
        """An unpacked chunk; it may be requested repeatedly if its messages alternate with another's."""
        if kind == Compression.NONE:
            return data
        unpacker: Any = bz2.BZ2Decompressor() if kind == Compression.BZ2 else lz4.frame.LZ4FrameDecompressor()
        whole: bytes = unpacker.decompress(data, max_length=LARGEST_CHUNK)
        if not unpacker.eof:
            raise ValueError(f"a chunk that is damaged, or larger than {LARGEST_CHUNK} bytes unpacked")
        self._bytes -= len(whole)
        if self._bytes < 0:
            raise ValueError("more bytes unpacked than a bag of this size can hold")
        return whole


def _header(file: BinaryIO, size: int) -> Header:
    """The header of the record at this position, checked, because the library allocates any declared length."""
    length = int.from_bytes(file.read(4), "little")
    if length > min(size, _LONGEST_HEADER):
        raise ValueError(f"a header of {length} bytes; valid: up to {_LONGEST_HEADER}")
    file.seek(-4, os.SEEK_CUR)
    return Header.read(file)
