"""Writer of recordings: blocks and samples in, one MCAP file with ROS 2 messages out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.streams.errors import ConfigError, RecordingError
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.recording.cdr import MessageLayout
from stridetwin.streams.recording.mcap_writer import IMAGE_LANE, McapWriter, build_message_rows
from stridetwin.streams.recording.recording_schema import METADATA_NAME, RIG_NAME, VERSION_RECORD, VERSION_VALUES
from stridetwin.streams.recording.ros_images import (
    CAMERA_INFO,
    COMPRESSED,
    DEPTH_ENCODINGS,
    RAW,
    CameraInfos,
    encode_camera_info,
    encode_depth,
    encode_image,
    encode_pixels,
)
from stridetwin.streams.recording.ros_samples import SAMPLE_MAPPINGS, block_of, fill_rows
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import LATEST_NS, Block, Depth, Image, Sample

_ENCODERS = 2
"""Threads that encode images."""
_IMAGES_IN_FLIGHT = 8
"""Most messages with images that are encoded or wait for it; then `write` waits."""


class RecordingWriter:
    """Writes one recording; a context manager.

    The file grows under a hidden name beside `path`, and is renamed only when it is complete. After an error or a kill
    the hidden file remains, readable up to its last complete chunk. The same input gives the same bytes.

    Args:
        path: Output file, `.mcap`.
        rig: Rig of the wearer; stored inside as Kalibr YAML.
        metadata: Stored inside as text (seed, versions, ...).
        depth_encoding: `16UC1` (mm, as in the RealSense driver) or `32FC1` (m, lossless).
        jpeg_quality: 0 to 100; None keeps every pixel (PNG, larger and slower).

    Raises:
        ConfigError: An unknown depth encoding.
        RecordingError: The file cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        rig: Rig,
        metadata: Mapping[str, str] | None = None,
        *,
        depth_encoding: str = "16UC1",
        jpeg_quality: int | None = 90,
    ) -> None:
        """Opens the hidden file and writes version, calibration and metadata, before all samples."""
        if depth_encoding not in DEPTH_ENCODINGS:
            raise ConfigError("RecordingWriter", "depth_encoding", depth_encoding, " or ".join(DEPTH_ENCODINGS))
        self.path = Path(path)
        self._rig = rig
        self._depth_encoding, self._quality = depth_encoding, jpeg_quality
        self._last: dict[str, int] = {}  # last stamp or arrival, ns, by topic
        self._kinds: dict[str, type[Sample]] = {}  # by topic
        # by topic: a message with zeros for its numbers, where these are, and the constants of its blocks
        self._templates: dict[str, tuple[bytes, MessageLayout, Mapping[str, object]]] = {}
        self._infos = CameraInfos(rig)
        # images in the pool, in order: topic, type of the message, its future bytes, log time in ns
        self._queue: deque[tuple[str, str, Future[bytes], int]] = deque()
        # by topic: the last read-only pixels and their encoded bytes, see `_shared_image_data`
        self._shared: dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8]]] = {}
        self._pool = ThreadPoolExecutor(_ENCODERS)
        rig_yaml = rig_to_yaml(rig).encode()
        self._file = McapWriter(self.path)
        self._file.append_metadata(VERSION_RECORD, VERSION_VALUES)
        self._file.append_attachment(RIG_NAME, "application/yaml", rig_yaml)
        self._file.append_metadata(METADATA_NAME, dict(metadata or {}))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Completes the file and gives it its name; after an error it stays under the hidden name."""
        try:
            self._append_encoded(0)  # the images that are still in the queue
            if error is None:
                self._file.finish()
            else:
                self._file.abandon()
        finally:
            self._pool.shutdown(cancel_futures=True)

    def write(self, item: Block[Sample] | Sample, log_ns: ArrayLike | None = None) -> None:
        """Appends a sample, or a block of samples of one topic.

        Args:
            item: Item to append.
            log_ns: Arrival time of each sample, (N,) ns. Stamps may then be arbitrary, as those of faulty sensors; by
                default samples arrive at their stamps.

        Raises:
            RecordingError: A stamp of the topic is not after the previous one, an arrival is before it, one of them is
                out of range, or the topic changes its kind.
        """
        if isinstance(item, (Image, Depth)):
            stamps = np.array([item.t_ns], np.int64)
            (arrival_ns,) = self._check_stamps(item.topic, type(item), stamps, log_ns)
            self._write_image(item, int(arrival_ns))
        elif isinstance(item, Sample):
            self.write(block_of([item]), log_ns)
        elif item.kind in (Image, Depth):  # a block of images, which are written one by one
            arrivals = [None] * len(item) if log_ns is None else np.atleast_1d(np.asarray(log_ns)).tolist()
            for image, arrival in zip(item, arrivals, strict=True):
                self.write(image, arrival)
        elif len(item):  # nothing is written of an empty block
            logged = self._check_stamps(item.topic, item.kind, item.t_ns, log_ns)
            self._append_encoded(0)  # images written before come first in the file
            self._write_block(item, logged)

    def _check_stamps(
        self, topic: str, kind: type[Sample], stamps: NDArray[np.int64], log_ns: ArrayLike | None
    ) -> NDArray[np.int64]:
        """Arrival times of the samples, (N,) ns: `log_ns`, or the stamps by default.

        Stamps must increase strictly. If arrivals are given, these must not decrease, and stamps may be arbitrary.

        Args:
            topic: Topic of the samples.
            kind: Their type.
            stamps: (N,) ns.
            log_ns: Arrival time of each, (N,) ns; None: the stamps.

        Raises:
            RecordingError: A stamp is not after the previous one, an arrival is before it, one of them is out of range,
                or the topic changes its kind.
        """
        known = self._kinds.setdefault(topic, kind)
        if known is not kind:
            raise RecordingError(f"{self.path}: {topic}: invalid {kind.__name__}: expected {known.__name__}, as before")
        t_ns = stamps if log_ns is None else np.broadcast_to(np.asarray(log_ns, np.int64), stamps.shape)
        before = np.concatenate(([self._last.get(topic, -1)], t_ns[:-1]))  # (N,) the one before each; -1 before all
        # stamps must increase; arrivals may be equal, but none may be before 0
        early = t_ns <= before if log_ns is None else t_ns < np.maximum(before, 0)
        # beyond what a ROS message can hold; the stamps of faulty sensors may also be negative
        is_out_of_range = np.maximum(t_ns, abs(stamps)) >= LATEST_NS
        bad = np.flatnonzero(early | is_out_of_range)
        if bad.size:
            i = int(bad[0])
            valid = "stamps from 0 on that increase strictly" if log_ns is None else "arrivals from 0 on in order"
            raise RecordingError(
                f"{self.path}: {topic}: invalid {'stamp' if log_ns is None else 'arrival'} {t_ns[i] * 1e-9:.9f} s "
                f"after {before[i] * 1e-9:.9f} s: expected {valid}"
            )
        self._last[topic] = int(t_ns[-1])
        return t_ns

    def _write_block(self, block: Block[Sample], log_ns: NDArray[np.int64]) -> None:
        """Appends a block as message records made from its topic's template, a message with zeros for its numbers.

        Args:
            block: The samples.
            log_ns: (N,) arrival time of each, ns.

        Raises:
            RecordingError: The block's constants differ from those of earlier blocks of the topic.
        """
        mapping = SAMPLE_MAPPINGS[block.kind]
        if block.topic not in self._templates:
            payload, layout = mapping.build_template(block.topic, self._rig, block.constants)
            self._templates[block.topic] = payload, layout, dict(block.constants)
        payload, layout, constants = self._templates[block.topic]
        if constants != dict(block.constants):
            raise RecordingError(f"{self.path}: {block.topic}: {dict(block.constants)} changed from {constants}")
        channel = self._file.register_channel(block.topic, mapping.typename)
        rows, payloads = build_message_rows(channel, payload, layout.dtype, log_ns)
        fill_rows(payloads, mapping, block)
        self._file.append_messages(rows)

    def _write_image(self, sample: Image | Depth, log_ns: int) -> None:
        """Queues an image for encoding, and before it the camera's intrinsics if they are due.

        If too many images are in the queue, it waits until the oldest ones are encoded and appends these to the file.
        """
        if (camera := self._infos.find_due_camera(sample.topic, sample.t_ns)) is not None:
            info = partial(encode_camera_info, camera, sample.topic, sample.t_ns)
            self._submit(f"{sample.topic}/camera_info", CAMERA_INFO, info, log_ns)
        if isinstance(sample, Image):
            encode = partial(encode_image, sample, self._quality, self._shared_image_data(sample))
            self._submit(sample.topic, COMPRESSED, encode, log_ns)
        else:
            self._submit(sample.topic, RAW, partial(encode_depth, sample, self._depth_encoding), log_ns)
        self._append_encoded(_IMAGES_IN_FLIGHT)

    def _shared_image_data(self, sample: Image) -> NDArray[np.uint8] | None:
        """The encoded pixels of a read-only array, which many images of a topic share; None for a writeable one.

        Such pixels are encoded once, and again only when an image of the topic has another array.
        """
        if sample.pixels.flags.writeable:
            return None
        pixels, data = self._shared.get(sample.topic, (None, None))
        if pixels is not sample.pixels or data is None:
            data = encode_pixels(sample.pixels, self._quality)
            self._shared[sample.topic] = sample.pixels, data
        return data

    def _submit(self, topic: str, typename: str, encode: partial[bytes], log_ns: int) -> None:
        """Encodes a message in the pool; `_append_encoded` appends it later, in the order of submission.

        Args:
            topic: Topic of the message.
            typename: Its ROS 2 type.
            encode: Makes its CDR bytes, in a thread of the pool.
            log_ns: Its log time.
        """
        # now and not in the pool's threads, so that channels are numbered in the order of their first messages
        self._file.register_channel(topic, typename)
        self._queue.append((topic, typename, self._pool.submit(encode), log_ns))

    def _append_encoded(self, max_left: int) -> None:
        """Appends encoded images in order, until `max_left` are left in the queue."""
        while len(self._queue) > max_left:
            topic, typename, encoded, log_ns = self._queue.popleft()
            self._file.append_message(topic, typename, encoded.result(), log_ns, lane=IMAGE_LANE)
