"""MCAP files as bags: one file, or the parts of a split ROS 2 bag."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcap import records
from mcap.opcode import Opcode

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.bag import Channel
from stridetwin.streams.recording.imported import Notes, unreadable
from stridetwin.streams.recording.index import Problem
from stridetwin.streams.recording.mcap_scan import CutOffError, DamagedError, Unpacking, parse, read_chunk, top_records

_LOOSE = struct.Struct("<HIqq")


class McapBag:
    """The messages of MCAP files, with CRC checks.

    Args:
        paths: The files, in time order.
        notes: Collects damage; when lenient, everything readable is read.

    Attributes:
        channels: Streams of CDR messages.
    """

    def __init__(self, paths: list[Path], notes: Notes) -> None:
        self._paths, self._notes = paths, notes
        self._topics: list[dict[int, str]] = [{} for _ in paths]
        self._cached: tuple[tuple[int, int], bytes] = ((-1, -1), b"")
        channels: dict[str, Channel] = {}
        for i, path in enumerate(paths):
            schemas: dict[int, records.Schema] = {}
            unpacking = Unpacking(path)
            for opcode, _, body in self._records(path):
                found: list[Any] = []
                if opcode == Opcode.CHUNK:
                    found, _ = self._chunk(path, body, unpacking)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    unpacking.took(0, 1)
                    found = [parse(records.Schema if opcode == Opcode.SCHEMA else records.Channel, body)]
                for record in found:
                    self._register(i, record, schemas, channels)
        self.channels = list(channels.values())

    def messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes, Any]]:
        """(topic, log time in ns, CDR bytes, key) of every message of the topics, in file order."""
        for i, path in enumerate(self._paths):
            unpacking = Unpacking(path)
            for opcode, offset, body in self._records(path):
                if opcode == Opcode.CHUNK:
                    _, by_channel = self._chunk(path, body, unpacking)
                    for channel, found in by_channel.items():
                        topic = self._topics[i].get(channel, "")
                        if topic in topics:
                            for k in range(len(found)):
                                at = int(found.starts[k]), int(found.lengths[k])
                                yield topic, int(found.log_time[k]), found.payload(k), (i, offset, *at)
                elif opcode == Opcode.MESSAGE and len(body) >= _LOOSE.size:
                    channel, _, log_time, _ = _LOOSE.unpack_from(body)
                    topic = self._topics[i].get(channel, "")
                    if topic in topics:
                        at = offset + 9 + _LOOSE.size, len(body) - _LOOSE.size
                        yield topic, log_time, body[_LOOSE.size :], (i, -1, *at)

    def payload(self, topic: str, key: Any) -> bytes:
        """CDR bytes of one message, read again."""
        i, chunk, start, length = key
        if chunk < 0:
            with self._paths[i].open("rb") as file:
                file.seek(start)
                return file.read(length)
        if self._cached[0] != (i, chunk):
            self._cached = (i, chunk), read_chunk(self._paths[i], chunk)
        return self._cached[1][start : start + length]

    def _records(self, path: Path) -> Iterator[tuple[int, int, bytes]]:
        """The records of a file, as far as they can be read."""
        try:
            yield from top_records(path)
        except OSError as error:
            raise unreadable(path, error) from error
        except DamagedError as error:
            if "no MCAP" in str(error):
                raise RecordingError(f"{path}: {error}") from error
            cut = "; the part before can be read" if isinstance(error, CutOffError) else ""
            self._notes.problem(Problem("", None, f"{path.name}: {error}{cut}"))

    def _chunk(self, path: Path, body: bytes, unpacking: Unpacking) -> tuple[list[Any], dict[int, Any]]:
        try:
            chunk = parse(records.Chunk, body)
            if not chunk.uncompressed_crc:
                self._notes.warn(f"{path.name}: chunks without a CRC, so that corrupted values would not be detected")
            return unpacking.contents(chunk)
        except DamagedError as error:
            self._notes.problem(Problem("", None, f"{path.name}: {error}"))
            return [], {}

    def _register(self, i: int, record: Any, schemas: dict[int, records.Schema], channels: dict[str, Channel]) -> None:
        if isinstance(record, records.Schema):
            schemas[record.id] = record
        elif record.id not in self._topics[i]:
            schema = schemas.get(record.schema_id)
            is_cdr = schema is not None and record.message_encoding == "cdr"
            name = schema.name if schema is not None and is_cdr else f"{record.message_encoding} messages"
            text = schema.data.decode(errors="replace") if schema is not None else ""
            new = Channel(record.topic, name, schema.encoding if schema is not None else "", text)
            known = channels.setdefault(record.topic, new)
            if replace(known, definition="") == replace(new, definition=""):
                self._topics[i][record.id] = record.topic
            else:
                self._notes.warn(f"{record.topic}: a second publisher of {name}, which is not read")
