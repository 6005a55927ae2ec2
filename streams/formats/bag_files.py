"""The messages of bags: MCAP files, and ROS 1 and ROS 2 bags read by rosbags, with limits for untrusted files."""

from __future__ import annotations

import bz2
import os
import sqlite3
import struct
import weakref
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import lz4.frame  # type: ignore[import-untyped]
from mcap import records
from mcap.opcode import Opcode
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1.reader import Chunk, Compression, Header, IndexData, decompressors

from stridetwin.streams.errors import RecordingError, StrideTwinError, read_error
from stridetwin.streams.formats.bag import Channel
from stridetwin.streams.formats.ros1_types import Ros1Types, find_definition, to_ros2_name
from stridetwin.streams.recording.index import Notes, Problem
from stridetwin.streams.recording.mcap_scan import (
    LARGEST_CHUNK,
    CutOffError,
    DamagedError,
    Unpacking,
    parse_record,
    read_chunk,
    top_records,
)
from stridetwin.streams.recording.ros_types import definition, typestore

_LOOSE = struct.Struct("<HIqq")
"""What a message's record has before the payload: channel, sequence, log time and publish time."""


class _Unpacker(Protocol):
    """What the decompressors of bz2 and lz4 share."""

    @property
    def eof(self) -> bool:
        """Whether the data have ended."""

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        """Unpacked data, up to a length."""


McapKey = tuple[int, int, int, int]
"""Of a message: number of the file, offset of its chunk (-1: none), first byte and length there."""
RosKey = tuple[Connection, int, int]
"""Of a message: its connection, log time in ns, and number among those of equal time."""


class McapBag:
    """The messages of MCAP files, unpacked with checks of their CRCs.

    Args:
        paths: The files of one bag, in order.
        notes: Collects damage and missing CRCs.

    Attributes:
        channels: Its streams; those of ROS 1 messages have the ROS 2 names and definitions of their types.

    Raises:
        StrideTwinError: A file cannot be read, or is damaged, unless lenient.
    """

    def __init__(self, paths: list[Path], notes: Notes) -> None:
        """Reads through all files for their schemas and channels."""
        self._paths, self._notes = paths, notes
        self._topics: list[dict[int, str]] = [{} for _ in paths]  # of each file, topic by channel id
        self._ros1_types = Ros1Types()
        self._ros1_names: dict[str, str] = {}  # type of each topic with messages of ROS 1
        # the chunk unpacked last: number of the file and offset, and its bytes
        self._cached: tuple[tuple[int, int], bytes] = ((-1, -1), b"")
        channels: dict[str, Channel] = {}
        for i, path in enumerate(paths):
            schemas: dict[int, records.Schema] = {}
            unpacking = Unpacking(path)
            for opcode, _, body in self._read_records(path):
                if opcode in (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL):
                    definitions, _ = self._unpack_record(path, opcode, body, unpacking)
                    for record in definitions:
                        self._register(i, record, schemas, channels)
        self.channels = list(channels.values())

    def read_messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes, McapKey]]:
        """(topic, log time in ns, CDR bytes, key) of every message of the topics, in file order."""
        for topic, log_time, raw, key in self._read_stored_messages(topics):
            try:
                payload = self._to_cdr(topic, raw)
            except ValueError as error:
                self._notes.add_problem(Problem(topic, None, f"cannot be decoded: {error}"))
                continue
            yield topic, log_time, payload, key

    def _read_stored_messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes, McapKey]]:
        """(topic, log time in ns, bytes as stored, key) of every message of the topics, in file order."""
        for i, path in enumerate(self._paths):
            unpacking = Unpacking(path)
            for opcode, offset, body in self._read_records(path):
                if opcode == Opcode.CHUNK:
                    _, by_channel = self._unpack_record(path, opcode, body, unpacking)
                    for channel, messages in by_channel.items():
                        topic = self._topics[i].get(channel, "")
                        if topic in topics:
                            for k in range(len(messages)):
                                key = i, offset, int(messages.starts[k]), int(messages.lengths[k])
                                yield topic, int(messages.log_time[k]), messages.payload(k), key
                elif opcode == Opcode.MESSAGE and len(body) >= _LOOSE.size:  # a message outside chunks
                    channel, _, log_time, _ = _LOOSE.unpack_from(body)
                    topic = self._topics[i].get(channel, "")
                    if topic in topics:
                        # the body begins after 9 bytes of opcode and length, the payload after `_LOOSE`
                        key = i, -1, offset + 9 + _LOOSE.size, len(body) - _LOOSE.size
                        yield topic, log_time, body[_LOOSE.size :], key

    def read_payload(self, topic: str, key: McapKey) -> bytes:
        """The CDR bytes of one message, read again from its file.

        Args:
            topic: Topic of the message, whose type tells whether it is one of ROS 1.
            key: As `read_messages` gave it: number of the file, offset of the chunk (-1 outside one), start and length.
        """
        i, chunk, start, length = key
        if chunk < 0:
            with self._paths[i].open("rb") as file:
                file.seek(start)
                return self._to_cdr(topic, file.read(length))
        cached_chunk, data = self._cached
        if cached_chunk != (i, chunk):
            data = read_chunk(self._paths[i], chunk)
            self._cached = (i, chunk), data
        return self._to_cdr(topic, data[start : start + length])

    def _to_cdr(self, topic: str, payload: bytes) -> bytes:
        """The CDR bytes of a message: converted from those of ROS 1, or the same.

        Raises:
            ValueError: The bytes are no message of the topic's type.
        """
        name = self._ros1_names.get(topic)
        return payload if name is None else self._ros1_types.to_cdr(payload, name)

    def _read_records(self, path: Path) -> Iterator[tuple[int, int, bytes]]:
        """Yields opcode, offset and body of the records of a file, as far as they can be read; damage is reported."""
        try:
            yield from top_records(path)
        except OSError as error:
            raise read_error(path, error) from error
        except DamagedError as error:
            cut = "; the part before can be read" if isinstance(error, CutOffError) else ""
            self._notes.add_problem(Problem("", None, f"{path.name}: {error}{cut}"))

    def _unpack_record(
        self, path: Path, opcode: int, body: bytes, unpacking: Unpacking
    ) -> tuple[list[Any], dict[int, Any]]:
        """The schemas and channels in a record, and the messages of a chunk by channel id.

        Both are empty if the record is damaged, which is reported, as are chunks without a CRC.

        Args:
            path: The file, for reports.
            opcode: Kind of the record: chunk, schema or channel.
            body: Its bytes.
            unpacking: Unpacks the chunks of the file, within limits.
        """
        try:
            if opcode == Opcode.CHUNK and not parse_record(records.Chunk, body).uncompressed_crc:
                self._notes.warn(f"{path.name}: chunks without a CRC, so that corrupted values would not be detected")
            return unpacking.contents(opcode, body)
        except DamagedError as error:
            self._notes.add_problem(Problem("", None, f"{path.name}: {error}"))
            return [], {}

    def _register(self, i: int, record: Any, schemas: dict[int, records.Schema], channels: dict[str, Channel]) -> None:
        """Adds a schema or a channel of a file.

        A topic's second publisher is used only if its message type is the same; otherwise it is reported.

        Args:
            i: Number of the file.
            record: The schema or channel.
            schemas: Schemas of the file by id, extended.
            channels: Streams of all files by topic, extended.
        """
        if isinstance(record, records.Schema):
            schemas[record.id] = record
        elif record.id not in self._topics[i]:
            new = self._to_channel(record, schemas.get(record.schema_id))
            known = channels.setdefault(record.topic, new)
            if replace(known, definition="") == replace(new, definition=""):  # texts of definitions do not matter
                self._topics[i][record.id] = record.topic
            else:
                self._notes.warn(f"{record.topic}: a second publisher of {new.typename}, which is not read")

    def _to_channel(self, record: records.Channel, schema: records.Schema | None) -> Channel:
        """The stream of a channel; its type is named together with its encoding where that is not read.

        Args:
            record: The channel.
            schema: Its schema; None without one.
        """
        name = to_ros2_name(schema.name) if schema is not None else ""
        text = schema.data.decode(errors="replace") if schema is not None else ""
        encoding = schema.encoding if schema is not None else ""
        if record.message_encoding == "ros1" and name:
            text = self._ros1_types.to_ros2_definition(name, find_definition(name, text))
            if text:
                self._ros1_names[record.topic] = name
                return Channel(record.topic, name, "ros2msg", text)
        if record.message_encoding == "cdr" and not text and name in typestore().fielddefs:
            return Channel(record.topic, name, "ros2msg", definition(name))  # a standard type without its definition
        if record.message_encoding != "cdr" or schema is None:
            name = f"{name or 'unknown type'} in {record.message_encoding or 'unknown encoding'}"
        return Channel(record.topic, name, encoding, text)


_LONGEST_HEADER = 1 << 20
"""Most bytes of the header of a record of a ROS 1 bag."""
_MOST_CONNECTIONS = 2000
_BYTES_PER_ENTRY = 12  # of an index
_FREE_BYTES, _BYTES_PER_BYTE = 1 << 30, 200
"""Bytes to which a ROS 1 bag may unpack: this many, and this many for each byte of the file."""
_KINDS = {decompressors[kind.value]: kind for kind in Compression}
"""Kind of compression, by the function of rosbags that unpacks it."""


def check_index(path: Path) -> None:
    """Rejects a ROS 1 bag whose index declares more than the file can hold, before rosbags allocates memory for it.

    Raises:
        ValueError: A header is too long, or there are too many connections or chunks. Unreadable bytes raise any
            exception of rosbags.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        file.readline(100)  # the version of the format; the header of the bag follows
        header = _read_header(file, size)
        connections, chunks = header.get_uint32("conn_count"), header.get_uint32("chunk_count")
        if connections > _MOST_CONNECTIONS or chunks > size // 32:
            raise ValueError(f"{connections} connections and {chunks} chunks are more than the file can hold")
        if not (index := header.get_uint64("index_pos")):  # where the index begins
            return  # a truncated file, which the library reports
        file.seek(index)
        for _ in range(connections):  # each has a header, and data in the form of a header
            _read_header(file, size)
            _read_header(file, size)
        for _ in range(chunks):  # each has a header, and data of a length that is passed over
            if _read_header(file, size).get_uint32("count") > connections:
                raise ValueError("a chunk with more connections than the bag has")
            length = int.from_bytes(file.read(4), "little")
            file.seek(length, os.SEEK_CUR)


class BoundedReader(rosbag1.Reader):
    """Reader of rosbags for ROS 1 bags, with limits against files that unpack to endless data.

    Limited are the size of a chunk, the total of unpacked bytes (1 GiB and 200 times the size of the file), and the
    entries of all indexes (one per 12 bytes of the file).
    """

    def __init__(self, path: Path) -> None:
        """Opens the bag with budgets that follow from the file's size."""
        super().__init__(path)
        self._size = path.stat().st_size
        # budgets that are left: unpacked bytes, and entries of indexes
        self._bytes = _FREE_BYTES + _BYTES_PER_BYTE * self._size
        self._entries = self._size // _BYTES_PER_ENTRY

    def read_chunk(self) -> Chunk:
        """Position of a chunk, and how to unpack it.

        Raises:
            ValueError: The packed chunk is larger than `LARGEST_CHUNK`.
        """
        chunk = super().read_chunk()
        if chunk.datasize > LARGEST_CHUNK:
            raise ValueError(f"a chunk of {chunk.datasize} bytes: expected up to {LARGEST_CHUNK}")
        return chunk._replace(
            decompressor=partial(self._unpack, _KINDS[chunk.decompressor])
        )  # instead of the library's

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:
        """Reads the index of one connection in one chunk, after its entries are counted towards the limit.

        Args:
            pos: Place of the chunk in the file.
            indexes: Entries by connection, extended.

        Raises:
            ValueError: All indexes together are longer than the file.
        """
        assert self.bio is not None  # the file of the open bag
        here = self.bio.tell()
        # the header of an index record has 51 bytes; the 4 after them are the length of its entries
        self._entries -= int.from_bytes(self.bio.read(55)[51:], "little") // _BYTES_PER_ENTRY
        if self._entries < 0:
            raise ValueError("an index longer than the bag")
        self.bio.seek(here)
        super().read_index_data(pos, indexes)

    def _unpack(self, kind: Compression, data: bytes) -> bytes:
        """Unpacks a chunk and counts its bytes towards the limit, again each time that alternating topics need it.

        Args:
            kind: How the chunk is compressed.
            data: Its packed bytes.

        Raises:
            ValueError: The chunk is damaged or too large, or the total exceeds the limit.
        """
        if kind == Compression.NONE:
            return data
        unpacker: _Unpacker = bz2.BZ2Decompressor() if kind == Compression.BZ2 else lz4.frame.LZ4FrameDecompressor()
        unpacked: bytes = unpacker.decompress(data, max_length=LARGEST_CHUNK)
        if not unpacker.eof:
            raise ValueError(f"a chunk that is damaged, or larger than {LARGEST_CHUNK} bytes unpacked")
        self._bytes -= len(unpacked)  # what is left of the limit
        if self._bytes < 0:
            raise ValueError("more bytes unpacked than a bag of this size can hold")
        return unpacked


def _read_header(file: BinaryIO, size: int) -> Header:
    """Reads the header of the record at the file's position, once its declared length is below the limits.

    Args:
        file: The open bag.
        size: Bytes of the bag.

    Raises:
        ValueError: The header is longer than the file or than 1 MiB, which the library would allocate.
    """
    length = int.from_bytes(file.read(4), "little")
    if length > min(size, _LONGEST_HEADER):
        raise ValueError(f"a header of {length} bytes: expected up to {_LONGEST_HEADER}")
    file.seek(-4, os.SEEK_CUR)  # back to the length, which the library reads itself
    return Header.read(file)


PartKey = tuple[int, RosKey]
"""Of a message: number of the part of the bag, and its key there."""


class BagInParts:
    """The messages of several bags that one recorder has written one after the other, without metadata.

    Attributes:
        channels: Streams of all parts; of those of one topic, the first.
    """

    def __init__(self, parts: Sequence[RosBag]) -> None:
        """Joins open bags, in the order of their messages."""
        self._parts = parts
        channels: dict[str, Channel] = {}
        for part in parts:
            for channel in part.channels:
                channels.setdefault(channel.topic, channel)
        self.channels = list(channels.values())

    def read_messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes, PartKey]]:
        """(topic, log time in ns, CDR bytes, key) of every message of the topics, part after part."""
        for number, part in enumerate(self._parts):
            for topic, log_time, payload, key in part.read_messages(topics):
                yield topic, log_time, payload, (number, key)

    def read_payload(self, topic: str, key: PartKey) -> bytes:
        """The CDR bytes of one message, read again from its part; `key` is as `read_messages` gave it."""
        number, key_in_part = key
        return self._parts[number].read_payload(topic, key_in_part)


class RosBag:
    """The messages of a bag that rosbags reads, converted to CDR; it stays open until it is garbage collected.

    Args:
        path: A ROS 1 file, or the folder or file of a ROS 2 bag.
        is_ros1: Whether the messages are those of ROS 1.
        notes: Collects damage.

    Attributes:
        channels: Its streams; of several publishers of a topic, those of the type of the first.

    Raises:
        RecordingError: The bag cannot be opened.
    """

    def __init__(self, path: Path, is_ros1: bool, notes: Notes) -> None:
        """Checks the index of a ROS 1 bag, opens the bag, and converts the definitions of its messages."""
        self.path, self._is_ros1, self._notes = path, is_ros1, notes
        self._ros1_types = Ros1Types()
        with self._convert_errors():
            if is_ros1:
                check_index(path)
            self._reader = BoundedReader(path) if is_ros1 else rosbag2.Reader(path)
            self._reader.open()
            weakref.finalize(self, _close, self._reader)
            channels = [self._to_channel(c) for c in self._reader.connections]
        # backwards, so that the first publisher of a topic replaces the later ones; then in the order of the bag again
        self.channels = list({c.topic: c for c in reversed(channels)}.values())[::-1]
        types = {c.topic: c.typename for c in self.channels}
        self._connections = [c for c in self._reader.connections if types[c.topic] == c.msgtype]  # that are read

    def read_messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes, RosKey]]:
        """(topic, log time in ns, CDR bytes, key) of every message of the topics, in file order."""
        wanted = [c for c in self._connections if c.topic in topics]
        counts: dict[tuple[int, int], int] = {}  # number of the last message, by connection and time
        messages = self._reader.messages(connections=wanted) if wanted else iter(())
        while True:
            try:
                with self._convert_errors():
                    message = next(messages, None)
                    if message is None:
                        return
                    connection, time, raw = message
                    if not (isinstance(time, int) and isinstance(raw, bytes | memoryview)):  # SQLite has no types
                        what = f"a message at {str(time)[:40]!r} of type {type(raw).__name__}"
                        self._notes.add_problem(
                            Problem(connection.topic, None, f"{what}: expected bytes at a time in ns")
                        )
                        continue
                    payload = self._to_cdr(raw, connection.msgtype)
            except RecordingError as error:
                if not self._notes.lenient:
                    raise
                self._notes.add_problem(Problem("", None, f"{error}; the part before can be read"))
                return
            number = counts.get((connection.id, time), -1) + 1
            counts[connection.id, time] = number
            yield connection.topic, time, payload, (connection, time, number)

    def read_payload(self, topic: str, key: RosKey) -> bytes:
        """The CDR bytes of one message, read again from the bag.

        Args:
            topic: Named by the error.
            key: As `read_messages` gave it: connection, log time in ns, and number among its messages of that time.

        Raises:
            StrideTwinError: The bag has no such message any more.
        """
        connection, time, number = key
        with self._convert_errors():
            messages = self._reader.messages(connections=[connection], start=time, stop=time + 1)
            for k, (_, _, raw) in enumerate(messages):
                if k == number:
                    return self._to_cdr(raw, connection.msgtype)
        raise StrideTwinError(f"{self.path}: {topic}: a previously read message is missing; has the file changed?")

    def _to_cdr(self, raw: bytes, typename: str) -> bytes:
        """The CDR bytes of a message: converted from those of ROS 1, or the same."""
        return self._ros1_types.to_cdr(raw, typename) if self._is_ros1 else bytes(raw)

    def _to_channel(self, connection: Connection) -> Channel:
        """The stream of a connection; definitions that older ROS 2 bags lack are those of the standard types."""
        name = connection.msgtype
        text, encoding = connection.msgdef.data, "ros2msg"
        if connection.msgdef.format == MessageDefinitionFormat.IDL:
            encoding = "ros2idl"
        elif not text:  # bags of older ROS 2 releases contain no definitions: the standard types are the same
            text = definition(name) if name in typestore().fielddefs else ""
        if self._is_ros1:
            text = self._ros1_types.to_ros2_definition(name, text)
        return Channel(connection.topic, name, encoding, text)

    @contextmanager
    def _convert_errors(self) -> Iterator[None]:
        """Converts any exception of the library for a damaged file to one error that names the file."""
        try:
            yield
        except StrideTwinError:
            raise
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror or error}") from error
        except Exception as error:  # asserts, index and key errors, MemoryError: unvalidated input
            text = " ".join(str(error).split()) or type(error).__name__
            repair = "`rosbag reindex`" if self._is_ros1 else "`ros2 bag reindex`"
            raise RecordingError(f"{self.path}: a damaged bag: {text[:200]}; {repair} may repair it") from error


def _close(reader: rosbag1.Reader | rosbag2.Reader) -> None:
    """Closes a reader, when its bag is garbage collected."""
    reader.close()


_DAMAGED = (sqlite3.Error, UnicodeDecodeError)
"""Exceptions of Python's module for a damaged SQLite file: it also fails to decode the text of an error."""


def _open_database(path: Path) -> closing[sqlite3.Connection]:
    """Opens an SQLite file that is neither changed nor locked; bytes of texts that are not UTF-8 are replaced."""
    database = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    database.text_factory = lambda data: data.decode(errors="replace")
    return closing(database)


def check_tables(path: Path) -> None:
    """Rejects an SQLite file with more than tables of plain columns: other objects can generate rows without data.

    Raises:
        RecordingError: The file has other objects.
    """
    with suppress(*_DAMAGED), _open_database(path) as database:  # damaged files are reported by `sqlite_is_sound`
        # every table, view and trigger: its name, kind, and the text that creates it
        objects = database.execute("SELECT name, type, sql FROM sqlite_master WHERE type != 'index'").fetchmany(1000)
        for name, kind, text in (map(str, row) for row in objects):  # those of a damaged file may be of any type
            columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)).fetchall()
            is_virtual = kind == "table" and "virtual" in text.lower().split()[:2]  # CREATE VIRTUAL TABLE
            has_hidden_columns = any(hidden for (hidden,) in columns)  # such as computed ones
            if kind != "table" or is_virtual or has_hidden_columns:
                raise RecordingError(f"{path}: invalid {kind} {name[:60]!r}: expected tables of plain columns")


def sqlite_is_sound(path: Path) -> bool:
    """Whether SQLite's own check of the file's structure passes; there is no checksum of the row data."""
    try:
        with _open_database(path) as database:
            return bool(database.execute("PRAGMA quick_check(1)").fetchone() == ("ok",))
    except _DAMAGED:
        return False
