"""Recordings as MCAP files of ours, second by second and lossless, and as ROS 2 bags of MCAP or SQLite storage."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer

from stridetwin.streams.errors import ConfigError, RecordingError, StrideTwinError
from stridetwin.streams.files import partial_path
from stridetwin.streams.formats.bag_files import McapBag
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.recording.recording_schema import RIG_NAME
from stridetwin.streams.recording.ros_types import typestore
from stridetwin.streams.samples import Depth, Image

_SECOND_NS = 1_000_000_000


def write_recording(recording: Recording, path: Path, progress: Callable[[float], None] = lambda _: None) -> None:
    """Writes every sample of a recording as an MCAP file, atomically: images as PNG, depth as float metres.

    Raises:
        StrideTwinError: There is nothing to write, an image is damaged (unless lenient), or the path is not writable.
    """
    if not recording.topics:
        raise RecordingError(f"{recording.path}: no stream that can be read")
    try:
        _write_samples(recording, path, progress)
    except StrideTwinError:
        partial_path(path).unlink(missing_ok=True)
        raise


def _write_samples(recording: Recording, path: Path, progress: Callable[[float], None]) -> None:
    """Writes the samples second by second, so that a recording of any length needs the memory of its small streams.

    Args:
        recording: The recording, with at least one topic.
        path: The MCAP file.
        progress: Called after each second with the share of the recording that is written.
    """
    blocks = [recording.block(topic) for topic, info in recording.topics.items() if info.kind not in (Image, Depth)]
    image_topics = [topic for topic, info in recording.topics.items() if info.kind in (Image, Depth)]
    times = np.concatenate([*(b.t_ns for b in blocks), *map(recording.image_times, image_topics)])  # of all samples, ns
    images = recording.samples(image_topics)
    image = next(images, None)  # the next image that is not written yet
    with RecordingWriter(path, recording.rig, recording.metadata, depth_encoding="32FC1", jpeg_quality=None) as writer:
        for second in np.unique(times // _SECOND_NS).tolist():  # every second that has samples
            since, until = second * _SECOND_NS, (second + 1) * _SECOND_NS
            for block in blocks:
                first, end = np.searchsorted(block.t_ns, (since, until))  # rows of this second
                if first < end:
                    writer.write(block[first:end])
            while image is not None and image.t_ns < until:
                writer.write(image)
                image = next(images, None)
            progress((until - times.min()) / max(1, times.max() - times.min()))


STORAGES = ("mcap", "sqlite3")
"""ROS 2's names of the formats of a bag's files."""
_VERSION: Literal[9] = 9  # of the bag's metadata, as ROS 2 Jazzy writes it


def write_rosbag2(recording: Recording, folder: Path, name: str, storage: str = "mcap") -> dict[str, int]:
    """Writes a bag: `NAME.mcap` or `NAME.db3`, `metadata.yaml`, and the calibration as `rig.yaml`.

    MCAP storage keeps the recording's CRCs; SQLite storage has no checksum.

    Args:
        recording: Any recording; the messages of an MCAP file are copied byte for byte.
        folder: An empty folder.
        name: Name of the file inside, without suffix.
        storage: `mcap` or `sqlite3`.

    Returns:
        Messages written, by topic.

    Raises:
        StrideTwinError: The recording cannot be read again, or the storage is unknown.
    """
    if storage not in STORAGES:
        raise ConfigError("export", "--storage", storage, " or ".join(STORAGES))
    with TemporaryDirectory(dir=folder) as temporary:
        source = recording.path
        if not recording.is_mcap:  # another tool's files, or streams under other topics: first as one MCAP file
            source = Path(temporary) / "whole.mcap"
            write_recording(recording, source)
        bag = McapBag([source], Notes(source, recording.lenient))
        counts = _write_mcap(bag, source, folder, name) if storage == "mcap" else _write_sqlite(bag, folder, name)
    if recording.has_rig:
        write_rig(recording.rig, folder / RIG_NAME)
    return counts


def _write_mcap(bag: McapBag, source: Path, folder: Path, name: str) -> dict[str, int]:
    """Copies an MCAP file into a bag's folder, and describes it in `metadata.yaml` as ROS 2 does.

    Args:
        bag: The messages of the file, which are counted.
        source: The file.
        folder: Folder of the bag.
        name: Name of the copy, without suffix.

    Returns:
        Number of messages by topic.
    """
    file = f"{name}.mcap"
    shutil.copyfile(source, folder / file)
    counts = {c.topic: 0 for c in bag.channels}
    first, last = 2**63 - 1, 0  # log times, ns
    for topic, t_ns, _, _ in bag.read_messages(set(counts)):
        counts[topic] += 1
        first, last = min(first, t_ns), max(last, t_ns)
    # entries of `metadata.yaml` that the whole bag and its only file share
    span = {"duration": {"nanoseconds": max(0, last - first)}, "message_count": sum(counts.values())}
    start = {"starting_time": {"nanoseconds_since_epoch": first if span["message_count"] else 0}}
    information = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        **span,
        **start,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": c.topic,
                    "type": c.typename,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": "",
                },
                "message_count": counts[c.topic],
            }
            for c in bag.channels
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **start, **span}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
    (folder / "metadata.yaml").write_text(text, encoding="utf-8")
    return counts


def _write_sqlite(bag: McapBag, folder: Path, name: str) -> dict[str, int]:
    """Writes all messages of a bag into `NAME.db3` with `metadata.yaml`; returns the messages by topic."""
    counts = {c.topic: 0 for c in bag.channels}
    with TemporaryDirectory(dir=folder) as temporary:
        inner = Path(temporary) / name  # the library creates the folder itself, and names the file after it
        with Writer(inner, version=_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
            connections = {
                c.topic: writer.add_connection(c.topic, c.typename, typestore=typestore()) for c in bag.channels
            }
            for topic, t_ns, payload, _ in bag.read_messages(set(counts)):
                writer.write(connections[topic], t_ns, payload)
                counts[topic] += 1
        for file in inner.iterdir():
            shutil.move(file, folder / file.name)
    return counts
