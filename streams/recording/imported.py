"""Another tool's files as a recording: small streams in memory, images read on request."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from stridetwin.streams.errors import RecordingError, StrideTwinError
from stridetwin.streams.recording.index import Notes, Problem, TopicInfo, rate_problems
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import LATEST_NS, Block, Depth, Image, Mask, Sample, Stamps, is_increasing

IMPORTED_FROM = "imported_from"
"""Key of the kind of the source (`FILE_FORMATS`) in the metadata of another tool's recording, also after `import`."""
_MOST_LISTED = 12
"""Most streams that an error lists."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageStream:
    """A stream of images that are read on request.

    Attributes:
        kind: Image or Depth.
        t_ns: (N,) stamps.
        load: Loads image i under a topic's name; raises a StrideTwinError or a ValueError if it is damaged.
    """

    kind: type[Image] | type[Depth]
    t_ns: Stamps
    load: Callable[[str, int], Image | Depth]


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """Result of an importer: streams under the source's own names.

    Attributes:
        kind: Kind of the source, such as `euroc`.
        blocks: Small streams by name, with the source's stamps.
        images: Image streams by name.
        rig: The source's calibration, by the same names.
        unread: Type of every stream that is not read.
        names: Our topic for each foreign name.
        assumed: Assumptions in a stream's calibration, in words; reported unless a better calibration replaces it.
    """

    kind: str
    blocks: dict[str, Block[Sample]]
    images: dict[str, ImageStream]
    rig: Rig
    unread: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)


class ImportedContents:
    """The streams of an imported source, checked like those of a recording; the `Contents` of a `Recording`.

    Args:
        blocks: Small streams by topic.
        images: Image streams by topic.
        rig: Calibration of the streams.
        metadata: Texts about the source.
        unread: Type of every stream that is not read.
        notes: Collects problems.

    Raises:
        RecordingError: There is no sample; or stamps do not increase or numbers are not finite, unless lenient.
    """

    def __init__(
        self,
        blocks: dict[str, Block[Sample]],
        images: dict[str, ImageStream],
        rig: Rig,
        metadata: dict[str, str],
        unread: dict[str, str],
        notes: Notes,
    ) -> None:
        """Checks all streams, reports problems to `notes`, and keeps what is valid."""
        self.rig: Rig | None = rig
        self.metadata, self.unread = metadata, unread
        self.problems, self.warnings = notes.problems, notes.warnings
        self._notes = notes
        valid_blocks = {topic: self._drop_invalid_samples(topic, block) for topic, block in blocks.items()}
        valid_images = {topic: self._drop_late_images(topic, stream) for topic, stream in images.items()}
        # streams of which nothing is left are no topics
        self._blocks = {topic: block for topic, block in valid_blocks.items() if len(block)}
        self._images = {topic: stream for topic, stream in valid_images.items() if len(stream.t_ns)}
        self.topics = {topic: _to_topic_info(block.kind, block.t_ns) for topic, block in self._blocks.items()}
        self.topics |= {topic: _to_topic_info(stream.kind, stream.t_ns) for topic, stream in self._images.items()}
        if not self.topics:
            contents = [*blocks, *images, *(f"{topic} ({kind})" for topic, kind in sorted(unread.items()))]
            cause = f"; {notes.problems[0]}" if notes.problems else ""
            listed = ", ".join(contents[:_MOST_LISTED]) or "no stream"
            raise RecordingError(f"{notes.path}: no readable sample; it has {listed}{cause}")
        for problem in rate_problems(rig, self.topics):
            notes.add_problem(problem)

    def samples(self, topics: list[str]) -> Iterator[Sample]:
        """Samples of the topics in time order, images last at equal stamps."""
        ordered = sorted(topics, key=lambda t: (t in self._images, t))  # images last, else by name
        streams = [self._iterate_topic(topic, order) for order, topic in enumerate(ordered)]
        # merged by stamp, and at equal stamps by the order of the topics
        return (sample for _, _, sample in heapq.merge(*streams, key=itemgetter(0, 1)))

    def blocks(self, topics: Sequence[str]) -> dict[str, Block[Sample]]:
        """All samples of the topics, as one block each; for topics without images."""
        return {topic: self._blocks[topic] for topic in topics}

    def times(self, topic: str) -> Stamps:
        """Stamps of a topic's samples or images, (N,) ns."""
        return self._blocks[topic].t_ns if topic in self._blocks else self._images[topic].t_ns

    def images(self, topic: str, indices: Sequence[int]) -> dict[int, Image | Depth]:
        """Loads images of a topic by number; those that do not exist or (when lenient) are damaged are missing."""
        count = len(self._images[topic].t_ns)
        loaded = {i: self._load_image(topic, i) for i in sorted(set(indices)) if 0 <= i < count}
        return {i: image for i, image in loaded.items() if image is not None}

    def image_times(self, topic: str) -> Stamps | None:
        """Stamps of a topic's images, (N,) ns; None for a topic without images."""
        return self._images[topic].t_ns if topic in self._images else None

    def _iterate_topic(self, topic: str, order: int) -> Iterator[tuple[int, int, Sample]]:
        """Yields a topic's samples, each as (stamp in ns, `order`, sample); `order` is the rank at equal stamps."""
        if topic in self._blocks:
            for sample in self._blocks[topic]:
                yield sample.t_ns, order, sample
        else:
            for i in range(len(self._images[topic].t_ns)):
                if (image := self._load_image(topic, i)) is not None:
                    yield image.t_ns, order, image

    def _load_image(self, topic: str, i: int) -> Image | Depth | None:
        """Loads image i of a topic; None if it is damaged, when lenient."""
        images = self._images[topic]
        try:
            return images.load(topic, i)
        except StrideTwinError as error:
            self._notes.add_error(error)
        except ValueError as error:
            self._notes.add_problem(Problem(topic, int(images.t_ns[i]), str(error)))
        return None

    def _drop_invalid_samples(self, topic: str, block: Block[Sample]) -> Block[Sample]:
        """The samples of a block with finite numbers and increasing stamps; others are reported as problems."""
        rising = self._check_stamps(topic, block.t_ns)
        sound = block.finite
        if not sound.all():
            at = int(np.argmin(sound))  # the first one that is not finite
            self._notes.add_problem(Problem(topic, int(block.t_ns[at]), block.describe_invalid(), int((~sound).sum())))
        return block[rising & sound]

    def _drop_late_images(self, topic: str, images: ImageStream) -> ImageStream:
        """The images with increasing stamps; others are reported as problems."""
        keep = self._check_stamps(topic, images.t_ns)
        if keep.all():
            return images
        at = np.flatnonzero(keep)  # numbers of the images that are kept
        load = images.load
        # image i of the result is image `at[i]` of the given stream
        return ImageStream(kind=images.kind, t_ns=images.t_ns[at], load=lambda name, i: load(name, int(at[i])))

    def _check_stamps(self, topic: str, t_ns: Stamps) -> Mask:
        """Reports stamps out of range or not after the previous one as problems.

        Args:
            topic: Named by the reports.
            t_ns: (N,) stamps.

        Returns:
            (N,) whether each sample is valid.
        """
        in_range = (t_ns >= 0) & (t_ns < LATEST_NS)
        if not in_range.all():
            at = int(np.argmin(in_range))  # the first one out of range
            what = f"invalid stamp of row {at + 1}: expected 0 to {LATEST_NS // 10**9} s"
            self._notes.add_problem(Problem(topic, int(t_ns[at]), what, int((~in_range).sum())))
        rising = is_increasing(np.where(in_range, t_ns, -1))  # stamps out of range do not count as previous ones
        late = in_range & ~rising  # samples whose stamp an earlier row has passed already
        if late.any():
            at = int(np.argmax(late))  # the first of them
            before = int(t_ns[:at][in_range[:at]].max())
            what = f"the stamp of row {at + 1} is not after the previous one, {before * 1e-9:.6f} s"
            self._notes.add_problem(Problem(topic, int(t_ns[at]), what, int(late.sum())))
        return np.asarray(in_range & rising)


def _to_topic_info(kind: type[Sample], t_ns: Stamps) -> TopicInfo:
    """Summary of a topic from the stamps (N,) ns of its samples."""
    return TopicInfo(kind, len(t_ns), int(t_ns[0]), int(t_ns[-1]))
