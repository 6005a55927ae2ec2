"""Index of a recording's contents, problems and schema version, from one pass over the file.

The summary that the mcap library reads at the end of a file would give topics and counts in 2 ms where the pass takes
240 ms for a walk of 10 MB, but a truncated file has none, and it says nothing of stamps, NaN and damage.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap import records
from mcap.opcode import Opcode

from stridetwin.streams.errors import RecordingError, StrideTwinError, to_line, to_lines
from stridetwin.streams.kalibr import rig_from_yaml
from stridetwin.streams.recording.mcap_scan import (
    CutOffError,
    DamagedError,
    Messages,
    Unpacking,
    parse_record,
    top_records,
)
from stridetwin.streams.recording.recording_schema import (
    METADATA_NAME,
    NO_VERSION,
    RIG_NAME,
    VERSION_RECORD,
    read_version,
)
from stridetwin.streams.recording.ros_types import Definitions
from stridetwin.streams.recording.topic_reader import READABLE, TopicReader
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu, Sample, Stamps, is_increasing

KEPT_BYTES = 32 << 20
"""IMU samples of a file that stay in memory after the first pass: an hour of one IMU."""
RATE_TOLERANCE = 0.2
"""Share by which a topic's mean rate may differ from the declared one."""
_RATE_SAMPLES = 10
"""Fewest samples of a topic whose rate is checked."""
LENIENT = "; to read it anyway: Recording(..., lenient=True), on the command line --lenient"


@dataclass(frozen=True)
class TopicInfo:
    """Summary of a topic.

    Attributes:
        kind: Type of its samples.
        count: Samples.
        first_ns: Stamp of the first.
        last_ns: Stamp of the last.
    """

    kind: type[Sample]
    count: int
    first_ns: int
    last_ns: int

    @property
    def rate_hz(self) -> float:
        """Mean rate; 0 for fewer than two samples."""
        return (self.count - 1) * 1e9 / (self.last_ns - self.first_ns) if self.count > 1 else 0.0


@dataclass(frozen=True)
class Problem:
    """A problem that would corrupt an estimate.

    Attributes:
        topic: Topic, or "" for the file as a whole.
        t_ns: Time of its first occurrence, None for the file as a whole.
        what: Description.
        count: Number of affected samples.
    """

    topic: str
    t_ns: int | None
    what: str
    count: int = 1

    def __post_init__(self) -> None:
        """Writes the topic as recordings call it, with marks as escapes."""
        object.__setattr__(self, "topic", to_line(self.topic))

    def __str__(self) -> str:
        """The problem as one line: topic, time in s, description, and the number of samples if there are several."""
        more = f" ({self.count} samples)" if self.count > 1 else ""
        if not self.topic:  # a problem of the file as a whole
            return to_lines(f"{self.what}{more}")  # it may be an error of several lines
        at = f" at {self.t_ns * 1e-9:.6f} s" if self.t_ns is not None else ""
        return to_line(f"{self.topic}{at}: {self.what}{more}")


class Notes:
    """Problems of a source, and assumptions about it.

    Attributes:
        problems: Problems that would corrupt an estimate, when lenient.
        warnings: Assumptions and unusual values.
    """

    def __init__(self, path: Path, lenient: bool) -> None:
        """Begins without notes on the source at `path`, which errors name; if not `lenient`, a problem is an error."""
        self.path, self.lenient = path, lenient
        self.problems: list[Problem] = []
        self.warnings: list[str] = []

    def add_problem(self, problem: Problem) -> None:
        """Rejects the source, or (when lenient) records the problem, once.

        Raises:
            RecordingError: Not lenient.
        """
        if not self.lenient:
            raise RecordingError(f"{self.path}: {problem}{LENIENT}")
        if problem not in self.problems:
            self.problems.append(problem)

    def add_error(self, error: StrideTwinError) -> None:
        """Raises an error about an invalid value in a file, or (when lenient) records it as a problem, once."""
        if not self.lenient:
            raise error
        self.add_problem(Problem("", None, str(error)))

    def warn(self, text: str) -> None:
        """Records an assumption, once; marks in it that come from a file are escaped."""
        text = to_line(text)
        if text not in self.warnings:
            self.warnings.append(text)


@dataclass(frozen=True)
class ChunkPart:
    """The samples of one topic in one chunk.

    Attributes:
        count: Number of valid samples.
        first: Stamp of the first valid one, ns.
        last: Stamp of the last valid one, ns.
        before: Latest stamp of the topic before the chunk, ns; -1 without one.
    """

    count: int
    first: int
    last: int
    before: int


@dataclass(frozen=True)
class ChunkInfo:
    """Byte offset of a chunk in the file, and the part of each topic that has valid samples in it."""

    offset: int
    parts: dict[str, ChunkPart]


def rate_problems(rig: Rig | None, topics: Mapping[str, TopicInfo]) -> Iterator[Problem]:
    """Yields a problem for each topic whose mean rate differs by more than 20 % from the one that the rig declares.

    Topics of fewer than `_RATE_SAMPLES` samples are not checked.
    """
    if rig is None:
        return
    # rate in Hz by topic; 0 if it is not declared
    declared = {t: imu.rate_hz for t, imu in rig.imus.items()}
    declared |= {t: sensor.rate_hz for t, sensor in rig.others.items()}
    for camera in rig.cameras.values():
        declared |= {camera.topic: camera.rate_hz, camera.depth_topic: camera.rate_hz}
    for topic, rate in declared.items():
        info = topics.get(topic)
        if info is None or rate <= 0 or info.count < _RATE_SAMPLES:
            continue  # not recorded, no declared rate, or too few samples
        if abs(info.rate_hz / rate - 1) > RATE_TOLERANCE:
            what = f"{info.rate_hz:.1f} Hz where the rig declares {rate:g} Hz: expected ±{RATE_TOLERANCE:.0%}"
            yield Problem(topic, info.first_ns, what)


class RecordingIndex:
    """The contents of one MCAP file.

    Args:
        path: The file.
        lenient: Whether a problem is noted instead of raised.

    Attributes:
        notes: Collects problems.
        topics: Summary of each topic that is read.
        metadata: Texts stored in the file, by name.
        problems: Problems that would corrupt an estimate.
        warnings: Always empty, as only imports make assumptions.
        unread: Message type of every topic that is not read.
        schema_version: Schema version of the file.
        rig: The calibration, if the file has one.
        channels: Topic of every channel, by the channel's id.
        readers: Decoder of every topic that is read.
        chunks: Every chunk with valid samples, in the file's order.

    Raises:
        RecordingError: The file cannot be read, or (unless `lenient`) would corrupt an estimate.
    """

    def __init__(self, path: Path, lenient: bool) -> None:
        """Reads the whole file once, and raises or notes its problems."""
        self.path, self.notes = path, Notes(path, lenient)
        self.problems, self.warnings = self.notes.problems, self.notes.warnings
        self.topics: dict[str, TopicInfo] = {}
        self.metadata: dict[str, str] = {}
        self.unread: dict[str, str] = {}
        self.schema_version = NO_VERSION
        self.rig: Rig | None = None
        self.channels: dict[int, str] = {}
        self.readers: dict[str, TopicReader] = {}
        self.chunks: list[ChunkInfo] = []
        self._kept: dict[str, list[Block[Any]]] = {}  # samples of IMUs in memory, by topic
        self._free_bytes = KEPT_BYTES  # left for these; negative once they have become too many
        self._parts_of_times: dict[str, list[Stamps]] = {}  # stamps of the valid samples, by topic, chunk by chunk
        self._schemas: dict[int, records.Schema] = {}  # by the file's id
        self._definitions = Definitions()  # limits the texts of the schemas
        self._scan()
        self._times = {topic: np.concatenate(parts) for topic, parts in self._parts_of_times.items()}
        del self._parts_of_times
        for problem in rate_problems(self.rig, self.topics):
            self.notes.add_problem(problem)

    def _scan(self) -> None:
        """Reads the file once from front to back and indexes its records; damage becomes a problem.

        Raises:
            RecordingError: The file cannot be read or, unless lenient, is damaged.
        """
        try:
            self._unpacking = Unpacking(self.path)
            for opcode, offset, body in top_records(self.path):
                try:
                    self._index_record(opcode, offset, body)
                except DamagedError as error:
                    self.notes.add_problem(
                        Problem("", None, f"{error} (at byte {offset}, {self._readable_range_text()})")
                    )
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from error
        except CutOffError as error:
            self.notes.add_problem(Problem("", None, f"{error}; {self._readable_range_text()}"))
        except DamagedError as error:  # a wrong CRC of the whole data or summary, which is raised after the last record
            self.notes.add_problem(Problem("", None, str(error)))

    def _readable_range_text(self) -> str:
        """Up to which time the part of the file read so far reaches, in words for a message."""
        last = max((t.last_ns for t in self.topics.values()), default=None)
        return "there is no sample before" if last is None else f"it can be read up to {last * 1e-9:.6f} s"

    def _index_record(self, opcode: int, offset: int, body: bytes) -> None:
        """Takes one top-level record into the index; kinds of records that are not needed are ignored.

        Args:
            opcode: Kind of the record.
            offset: Its place in the file, bytes.
            body: Its bytes without opcode and length.

        Raises:
            DamagedError: The bytes contradict their description.
            RecordingError: Messages are outside chunks, a newer release made the file, or it is a decompression bomb.
        """
        if opcode in (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL):
            definitions, messages = self._unpacking.contents(opcode, body)
            for record in definitions:
                self._register_definition(record)
            self._index_chunk(offset, messages)  # of a schema or channel by itself there are none
        elif opcode == Opcode.ATTACHMENT:
            self.rig = parse_rig_attachment(body) or self.rig  # the last calibration of several counts
        elif opcode == Opcode.METADATA:
            metadata = parse_record(records.Metadata, body)
            if metadata.name == VERSION_RECORD:
                self.schema_version = read_version(metadata.metadata, self.path)
            elif metadata.name == METADATA_NAME:
                self.metadata.update(metadata.metadata)
        elif opcode == Opcode.MESSAGE:
            raise RecordingError(f"{self.path}: messages outside chunks are not read: expected chunked MCAP")

    def _register_definition(self, record: Any) -> None:
        """Registers a schema or a channel.

        The first channel of a topic gets a decoder if its message type is one that is read; otherwise the topic is
        listed as unread. Further channels of the topic are reported and not read.

        Args:
            record: A `Schema` (definition of a message type) or a `Channel` (topic of messages of a schema). Files
                repeat them, and only the first of one id counts for channels.
        """
        if isinstance(record, records.Schema):
            self._schemas[record.id] = record
        elif record.id not in self.channels:
            schema = self._schemas.get(record.schema_id)
            name = schema.name if schema else ""  # ROS type of the messages
            topic = to_line(record.topic)
            self.channels[record.id] = topic
            if schema is None or record.message_encoding != "cdr":
                encoding = record.message_encoding or "no encoding"
                self.unread[topic] = to_line(f"{name or 'unknown type'} in {encoding}")
            elif name not in READABLE:
                self.unread[topic] = to_line(name)
            elif topic in self.readers:
                self.notes.add_problem(Problem(topic, None, "a second publisher, which is not read"))
            else:
                text = schema.data.decode(errors="replace")
                try:
                    self._definitions.add(text)
                    self.readers[topic] = TopicReader(topic, name, schema.encoding, text)
                except ValueError as error:
                    self.unread[topic] = name
                    self.notes.add_problem(Problem(topic, None, str(error)))

    def _index_chunk(self, offset: int, by_channel: dict[int, Messages]) -> None:
        """Indexes the messages of a chunk, and notes the chunk if it has valid samples.

        Of a topic with several channels (publishers) only the first in the chunk is read.

        Args:
            offset: Place of the chunk in the file, bytes.
            by_channel: Its messages by channel id.
        """
        parts: dict[str, ChunkPart] = {}
        for channel, messages in by_channel.items():
            topic = self.channels.get(channel, "")
            if topic in self.readers and topic not in parts:
                part = self._index_topic(topic, messages)
                if part is not None and part.count:
                    parts[topic] = part
        if parts:
            self.chunks.append(ChunkInfo(offset, parts))

    def _keep_in_memory(self, block: Block[Any]) -> None:
        """Keeps the samples of an IMU in memory (`_kept`), so that they need not be read again.

        If those of the file become too many, none is kept any more, and they are read again on request. `_free_bytes`,
        the memory that is left for them, is then negative and stays so.
        """
        self._free_bytes -= block.t_ns.nbytes + sum(values.nbytes for values in block.columns.values())
        if self._free_bytes < 0:
            self._kept = {}
        elif len(block):
            self._kept.setdefault(block.topic, []).append(block)

    def _index_topic(self, topic: str, messages: Messages) -> ChunkPart | None:
        """Checks the messages of a topic in a chunk, and adds the valid samples to the topic's summary.

        Stamps that do not increase, and numbers that are not finite (except in ground truth), are reported as
        problems; such samples are invalid. Samples of IMUs are kept in memory. Images are not decoded.

        Args:
            topic: The topic.
            messages: Its messages in the chunk.

        Returns:
            The valid samples' number and stamps; None if there are none or they cannot be decoded.
        """
        reader = self.readers[topic]
        known = self.topics.get(topic)
        before = known.last_ns if known else -1
        try:
            block = None if reader.is_image else reader.read_block(messages)
            t = reader.read_times(messages) if block is None else block.t_ns
        except ValueError as error:
            self.notes.add_problem(
                Problem(topic, int(messages.log_time[0]), f"cannot be decoded: {error}", len(messages))
            )
            return None
        rising = is_increasing(t, before)
        if not rising.all():
            i = int(np.argmin(rising))  # the first sample that is too early
            earlier = max(before, int(t[:i].max(initial=before)))
            what = f"the stamp is not after the previous one, {earlier * 1e-9:.6f} s"
            self.notes.add_problem(Problem(topic, int(t[i]), what, int((~rising).sum())))
        keep = rising
        if block is not None and not topic.startswith("/truth/"):
            sound = block.finite
            if not sound.all():
                self.notes.add_problem(
                    Problem(topic, int(t[np.argmin(sound)]), block.describe_invalid(), int((~sound).sum()))
                )
            keep = rising & sound
        kept = t[keep]
        if block is not None and block.kind is Imu:
            self._keep_in_memory(block[keep])
        if not len(kept) or reader.kind is None:  # reading a message has set the kind
            return None
        self._parts_of_times.setdefault(topic, []).append(kept)
        part = ChunkPart(len(kept), int(kept[0]), int(kept[-1]), before)
        count, first = (known.count, known.first_ns) if known else (0, part.first)
        self.topics[topic] = TopicInfo(reader.kind, count + part.count, first, part.last)
        return part


def is_stridetwin_recording(path: Path, if_damaged: bool) -> bool:
    """Whether an MCAP file begins like our recordings: with our calibration, metadata or schema version.

    The recorder writes these before all other records but the header.

    Args:
        path: The file.
        if_damaged: The answer for a file that cannot be read that far.
    """
    try:
        for opcode, _, body in top_records(path):
            if opcode == Opcode.ATTACHMENT and parse_record(records.Attachment, body).name == RIG_NAME:
                return True
            if opcode == Opcode.METADATA and parse_record(records.Metadata, body).name in (
                METADATA_NAME,
                VERSION_RECORD,
            ):
                return True
            if opcode not in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
                return False  # other contents begin
    except (DamagedError, RecordingError, OSError):
        return if_damaged
    return False


def parse_rig_attachment(body: bytes) -> Rig | None:
    """The calibration in an attachment; None for another attachment.

    Raises:
        DamagedError: The attachment's CRC is wrong, or the calibration is invalid.
    """
    attachment = parse_record(records.Attachment, body)
    # the last 4 bytes are the CRC of the others; 0 means that there is none
    if int.from_bytes(body[-4:], "little") not in (0, zlib.crc32(body[:-4])):
        raise DamagedError(f"CRC mismatch of the attachment {attachment.name}")
    if attachment.name != RIG_NAME:
        return None
    try:
        return rig_from_yaml(attachment.data.decode(), RIG_NAME)
    except (UnicodeDecodeError, StrideTwinError) as error:
        # each invalid value has a line in the error
        raise DamagedError(f"invalid calibration: {'; '.join(str(error).splitlines())}") from error


def read_calibration(path: Path, notes: Notes) -> tuple[Rig, dict[str, str]]:
    """The calibration and the metadata at the beginning of one of our recordings, when it is read as a bag.

    Args:
        path: The MCAP file.
        notes: Collects a damaged calibration.

    Returns:
        The rig, without sensors if there is no calibration, and the texts of the metadata by name.

    Raises:
        StrideTwinError: A newer release made the file, or (unless lenient) one of them is damaged.
    """
    rig, metadata = Rig(), dict[str, str]()
    try:
        for opcode, _, body in top_records(path):
            if opcode == Opcode.ATTACHMENT:
                try:
                    rig = parse_rig_attachment(body) or rig
                except DamagedError as error:
                    notes.add_problem(Problem("", None, str(error)))
            elif opcode == Opcode.METADATA:
                record = parse_record(records.Metadata, body)
                if record.name == VERSION_RECORD:
                    read_version(record.metadata, path)
                elif record.name == METADATA_NAME:
                    metadata.update(record.metadata)
            elif opcode != Opcode.HEADER:
                break  # the recorder writes them before all messages
    except DamagedError:
        pass  # reported when the messages are read
    return rig, metadata
