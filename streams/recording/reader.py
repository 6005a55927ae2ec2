"""Reader of recordings: their contents, samples in time order, and problems that would corrupt an estimate.

Opening a recording reads it once and rejects problems that would silently corrupt an estimate; after that, samples are
streamed from it. `Recording` opens MCAP files; `streams.formats.opening.open_any` opens other tools' files as one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.streams.errors import RecordingError, explain_import_error
from stridetwin.streams.recording.imported import ImportedContents
from stridetwin.streams.recording.index import Problem, TopicInfo
from stridetwin.streams.recording.mcap_contents import McapContents, Message
from stridetwin.streams.recording.recording_schema import RIG_NAME
from stridetwin.streams.recording.writer import RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Accelerometer, Block, Depth, Image, Imu, Sample, Stamps
from stridetwin.streams.segments import segment_of, side_of

if TYPE_CHECKING:
    import pandas

__all__ = ["Contents", "Problem", "Recording", "RecordingWriter", "TopicInfo"]


_MOST_UNREAD = 8
"""Most topics that are not read which an error lists."""
_KIND_OF: dict[str, type[Sample]] = {
    "imu": Imu,
    "accelerometer": Accelerometer,
    "color": Image,
    "camera": Image,
    "depth": Depth,
}
"""Kind of the samples of a sensor, by the end of its topic."""
Contents = McapContents | ImportedContents
"""Source of a recording's samples: an MCAP file, or the files of another tool."""


class Recording:
    """One recording, opened and checked.

    Args:
        path: MCAP file (or the source of `contents`).
        lenient: Read everything that is readable: a truncated file up to its last complete chunk, without invalid
            samples and damaged chunks. The problems are listed in `problems`.
        contents: Contents, if `path` is not an MCAP file.

    Attributes:
        topics: Summary of each topic: kind, number and first and last stamp of its samples.
        metadata: Texts stored with it, by name.
        problems: Problems that would corrupt an estimate; empty unless `lenient`.
        warnings: Assumptions of an import; empty for our own recordings.
        unread: Type of the messages of every topic that is not read.

    Raises:
        RecordingError: The file cannot be read, or (unless `lenient`) would corrupt an estimate.
    """

    def __init__(self, path: str | Path, lenient: bool = False, contents: Contents | None = None) -> None:
        """Opens the MCAP file, unless other `contents` are given, and takes over what they hold."""
        self.path = Path(path)
        self.lenient = lenient
        self._contents: Contents = contents if contents is not None else McapContents(self.path, lenient)
        self.topics = self._contents.topics
        self.metadata = self._contents.metadata
        self.problems = self._contents.problems
        self.warnings = self._contents.warnings
        self.unread = self._contents.unread

    @property
    def is_mcap(self) -> bool:
        """Whether `path` itself is the MCAP file whose messages these are."""
        return isinstance(self._contents, McapContents)

    @property
    def schema_version(self) -> str:
        """Schema version of an MCAP recording, `0.0` for one without a version; "" for files of other formats."""
        return self._contents.schema_version if isinstance(self._contents, McapContents) else ""

    @property
    def rig(self) -> Rig:
        """The calibration of the sensors, as stored with the recording.

        Raises:
            RecordingError: The recording has none.
        """
        if self._contents.rig is None:
            raise RecordingError(f"{self.path}: no calibration inside: expected an attachment {RIG_NAME} (Kalibr YAML)")
        return self._contents.rig

    @property
    def has_rig(self) -> bool:
        """Whether a calibration is stored with the recording."""
        return self._contents.rig is not None

    @property
    def duration(self) -> float:
        """Seconds from the first sample of any topic to the last."""
        if not self.topics:
            return 0.0
        last_ns = max(t.last_ns for t in self.topics.values())
        return (last_ns - min(t.first_ns for t in self.topics.values())) * 1e-9

    def samples(self, topics: Iterable[str] | None = None) -> Iterator[Sample]:
        """The samples of some topics (all by default) in time order, streamed.

        At equal stamps images come last, so that an IMU sample at the end of an interval precedes the image taken then;
        otherwise topics are sorted by name.

        Raises:
            RecordingError: Unknown topic; the message lists the known ones. Or an image is damaged.
        """
        wanted = list(self.topics) if topics is None else list(dict.fromkeys(topics))
        for topic in wanted:
            self._check_topic(topic)
        return self._contents.samples(wanted)

    def raw_messages(self, topics: Sequence[str], rank_of: Callable[[type[Sample]], int]) -> Iterator[Message]:
        """The stored messages of some topics of an MCAP file (`is_mcap`) in time order, byte for byte.

        Args:
            topics: Topics to return.
            rank_of: Rank of a kind of sample among those of one instant; the lowest rank comes first.
        """
        assert isinstance(self._contents, McapContents)
        return self._contents.messages(topics, rank_of)

    def block(self, topic: str) -> Block[Sample]:
        """All samples of a topic as one block; not for images.

        Raises:
            RecordingError: Unknown topic, or it carries images.
        """
        return self.blocks([topic])[topic]

    def blocks(self, topics: Iterable[str]) -> dict[str, Block[Sample]]:
        """All samples of some topics as one block each, read in one pass; not for images.

        Raises:
            RecordingError: Unknown topic, or it carries images.
        """
        wanted = list(dict.fromkeys(topics))
        for topic in wanted:
            self._check_topic(topic)
            if self._contents.image_times(topic) is not None:
                raise RecordingError(f"{self.path}: {topic} carries images: expected samples() or images()")
        return self._contents.blocks(wanted)

    def times(self, topic: str) -> Stamps:
        """Stamps of a topic's samples, (N,) ns; the samples are not decoded for that.

        Raises:
            RecordingError: Unknown topic.
        """
        self._check_topic(topic)
        return self._contents.times(topic)

    def frame(self, topic: str) -> pandas.DataFrame:
        """All samples of a topic without images as a table, indexed by time in s (`t_s`).

        A vector becomes one column per component, named as in `Block.split_columns`: `angular_rate_x`, `force_heel`,
        `position_hip_l`.

        Raises:
            RecordingError: Unknown topic, or it carries images.
            StrideTwinError: pandas is not installed.
        """
        with explain_import_error("tables of samples need it", "frames"):
            import pandas
        block = self.block(topic)
        return pandas.DataFrame(block.split_columns(), index=pandas.Index(block.t_ns * 1e-9, name="t_s"))

    def images(
        self, topic: str, indices: Sequence[int] | None = None, t_ns: Sequence[int] | None = None
    ) -> list[Image | Depth]:
        """Reads some images of a topic: by number, or those nearest to given times, or all.

        Args:
            topic: Topic of colour, grey or depth images.
            indices: Numbers of the images, from 0.
            t_ns: Times, ns; used in place of `indices`.

        Returns:
            One image per number or time, in their order.

        Raises:
            RecordingError: Unknown topic or image, or the topic carries no images.
        """
        times = self.image_times(topic)
        if t_ns is not None:
            indices = [int(np.argmin(np.abs(times - t))) for t in t_ns]  # the nearest image of each time
        wanted = range(len(times)) if indices is None else indices
        images = self._contents.images(topic, wanted)  # by number, without those that do not exist or are damaged
        missing = [i for i in wanted if i not in images]
        if missing:
            raise RecordingError(f"{self.path}: {topic} has no image {missing[0]}: expected 0 to {len(times) - 1}")
        return [images[i] for i in wanted]

    def image_times(self, topic: str) -> Stamps:
        """Stamps of a topic's images, (N,) ns.

        Raises:
            RecordingError: Unknown topic, or it carries no images.
        """
        self._check_topic(topic)
        times = self._contents.image_times(topic)
        if times is None:
            raise RecordingError(f"{self.path}: {topic} carries no images: expected block()")
        return times

    def _check_topic(self, topic: str) -> None:
        """Refuses a topic that the recording lacks.

        Raises:
            RecordingError: There is none of this name; the message lists the topics.
        """
        if topic not in self.topics:
            if f"/{topic}" in self.topics:
                raise RecordingError(f"{self.path}: no topic {topic!r}: expected {f'/{topic}'!r}, with a slash")
            raise RecordingError(f"{self.path}: no topic {topic!r}; {self.describe_topics()}{self.map_hint(topic)}")

    def describe_topics(self) -> str:
        """The topics, and those that are not read with their types, as in `it has /head/imu; not read: /tf (...)`."""
        unread = [f"{topic} ({kind})" for topic, kind in sorted(self.unread.items()) if kind]
        more = [f"and {len(unread) - _MOST_UNREAD} more"] if len(unread) > _MOST_UNREAD else []
        not_read = f"; not read: {', '.join([*unread[:_MOST_UNREAD], *more])}" if unread else ""
        return f"it has {', '.join(sorted(self.topics)) or 'none'}{not_read}"

    def map_hint(self, topic: str) -> str:
        """How `--map` gives a stream of another tool's recording the name of a missing topic, to append to an error.

        Args:
            topic: The missing topic, such as `/foot_l/imu`.

        Returns:
            Text such as `; if /head/imu is that sensor: --map /head/imu=/foot_l/imu`, with a stream of the same kind
            that has the same side, if there is one; "" if there is no such stream, or for our own recordings, whose
            topics say where the sensors are.
        """
        kind = _KIND_OF.get(topic.rpartition("/")[2])  # by what the sensor is, such as `imu`
        alike = [t for t, info in sorted(self.topics.items()) if info.kind is kind and not t.startswith("/truth/")]
        # a sensor that is named as that of another part of the body, such as the pelvis, is none of a foot
        side, segment = side_of(topic), segment_of(topic)
        alike = [t for t in alike if not side or segment_of(t) in ("", "head", "foot", segment)]
        if self.schema_version or not alike:
            return ""
        alike.sort(key=lambda name: side_of(name.lower()) != side)
        wanted = f"/{topic.lstrip('/')}"
        return f"; if {alike[0]} is that sensor: --map {alike[0]}={wanted}"
