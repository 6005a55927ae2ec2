"""Reading a recording: what it holds, its samples in time order, and what would spoil an estimate.

Opening a recording reads it once and refuses whatever would silently spoil an estimate; after that, samples
stream from it. `Recording` opens MCAP files; `streams.opening.open_any` opens other tools' files as one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.mcap_contents import McapContents
from stridetwin.streams.recorder import RIG_NAME, RecordingWriter
from stridetwin.streams.recording_index import Problem, TopicInfo
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Depth, Image, Sample

__all__ = ["Contents", "Problem", "Recording", "RecordingWriter", "TopicInfo"]


class Contents(Protocol):
    """Where a recording's samples come from: an MCAP file, or the files of another tool.

    Attributes:
        topics: What is held, by topic.
        metadata: Texts stored with it.
        problems: What would spoil an estimate.
        warnings: What had to be assumed.
        unread: Type of the messages of every topic that is not read.
        rig: The calibration, None if there is none.
    """

    topics: dict[str, TopicInfo]
    metadata: dict[str, str]
    problems: list[Problem]
    warnings: list[str]
    unread: dict[str, str]
    rig: Rig | None

    def samples(self, topics: list[str]) -> Iterator[Sample]:
        """Samples of the topics in time order, pictures last at equal stamps."""

    def block(self, topic: str) -> Block[Any]:
        """All samples of a topic that carries no pictures."""

    def images(self, topic: str, indices: Sequence[int]) -> dict[int, Image | Depth]:
        """Those of the asked pictures that there are, by number."""

    def picture_times(self, topic: str) -> NDArray[np.int64] | None:
        """(N,) ns, None where a topic carries no pictures."""


class Recording:
    """One recording, opened and checked.

    Args:
        path: MCAP file (or what `contents` was read from).
        lenient: Read what can be read: a cut-off file up to its last whole chunk, without the bad samples and
            the damaged chunks. What was wrong stands in `problems`.
        contents: What it holds, if `path` is no MCAP file.

    Attributes:
        topics: What the recording holds, by topic.
        metadata: Texts stored with it.
        problems: What would spoil an estimate; empty unless `lenient`.
        warnings: What an import had to assume; empty for our own recordings.
        unread: Type of the messages of every topic that is not read.

    Raises:
        RecordingError: It cannot be read, or (unless `lenient`) something in it would spoil an estimate.
    """

    def __init__(self, path: str | Path, lenient: bool = False, contents: Contents | None = None) -> None:
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
        """Version of what an MCAP recording of ours holds (`streams.schema_version`); "" of other tools' files."""
        return self._contents.schema_version if isinstance(self._contents, McapContents) else ""

    @property
    def rig(self) -> Rig:
        """The calibration stored with it.

        Raises:
            RecordingError: There is none.
        """
        if self._contents.rig is None:
            raise RecordingError(f"{self.path}: no calibration inside; valid: an attachment {RIG_NAME} (Kalibr YAML)")
        return self._contents.rig

    @property
    def has_rig(self) -> bool:
        """Whether a calibration is stored with it."""
        return self._contents.rig is not None

    @property
    def duration(self) -> float:
        """Seconds from the first sample of any topic to the last."""
        if not self.topics:
            return 0.0
        return (max(t.last_ns for t in self.topics.values()) - min(t.first_ns for t in self.topics.values())) * 1e-9

    def samples(self, topics: Iterable[str] | None = None) -> Iterator[Sample]:
        """The samples of some topics (all by default) in time order, read bit by bit.

        At equal stamps pictures come last, so that an IMU sample that closes an interval precedes the picture
        taken then; otherwise topics follow each other by name.

        Raises:
            RecordingError: There is no such topic; the message lists those there are. Or a picture is
                damaged.
        """
        wanted = list(self.topics) if topics is None else list(dict.fromkeys(topics))
        for topic in wanted:
            self._require(topic)
        return self._contents.samples(wanted)

    def block(self, topic: str) -> Block[Any]:
        """All samples of a topic as one block; not for pictures.

        Raises:
            RecordingError: There is no such topic, or it carries pictures.
        """
        self._require(topic)
        if self._contents.picture_times(topic) is not None:
            raise RecordingError(f"{self.path}: {topic} carries pictures; valid: samples() or images()")
        return self._contents.block(topic)

    def images(
        self, topic: str, indices: Sequence[int] | None = None, t_ns: Sequence[int] | None = None
    ) -> list[Image | Depth]:
        """A few pictures of a topic, by their number or as the nearest to the given times (all by default).

        Raises:
            RecordingError: There is no such topic or picture, or it carries no pictures.
        """
        times = self.picture_times(topic)
        if t_ns is not None:
            indices = [int(np.argmin(np.abs(times - t))) for t in t_ns]
        wanted = range(len(times)) if indices is None else indices
        found = self._contents.images(topic, wanted)
        missing = [i for i in wanted if i not in found]
        if missing:
            raise RecordingError(f"{self.path}: {topic} has no picture {missing[0]}; valid: 0 to {len(times) - 1}")
        return [found[i] for i in wanted]

    def picture_times(self, topic: str) -> NDArray[np.int64]:
        """(N,) ns, stamps of a topic's pictures.

        Raises:
            RecordingError: There is no such topic, or it carries no pictures.
        """
        self._require(topic)
        times = self._contents.picture_times(topic)
        if times is None:
            raise RecordingError(f"{self.path}: {topic} carries no pictures; valid: block()")
        return times

    def _require(self, topic: str) -> None:
        if topic not in self.topics:
            there = ", ".join(sorted(self.topics)) or "none"
            raise RecordingError(f"{self.path}: no topic {topic!r}; it has {there}")
