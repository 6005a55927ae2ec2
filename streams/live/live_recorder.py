"""Records the messages from the bridge unchanged, byte for byte."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.files import partial_path
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.wire import Message
from stridetwin.streams.recording import index
from stridetwin.streams.recording.mcap_writer import McapWriter, message_rows
from stridetwin.streams.recording.ros_images import CAMERA_INFO, IMAGES, camera_info_message
from stridetwin.streams.recording.ros_types import definition
from stridetwin.streams.recording.topic_reader import READABLE
from stridetwin.streams.recording.writer import METADATA_NAME, RIG_NAME
from stridetwin.streams.rig import CameraCalibration, Rig

_INFO_PERIOD_NS = 1_000_000_000
_PICTURE_LANE = 1


class LiveRecorder:
    """Writes arriving messages into one MCAP file; a context manager.

    The file grows under a hidden name beside `path` and is renamed at the end, also after an error, because the
    messages received so far are complete. After a kill it stays, readable up to its last complete chunk (`--lenient`).

    Args:
        path: Output file, `.mcap`.

    Attributes:
        count: Messages written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        self._told: tuple[str, dict[str, str]] | None = None
        self._channels: dict[str, int] = {}
        self._cameras: dict[str, CameraCalibration] = {}
        self._next_info: dict[str, int] = {}
        for typename in (CAMERA_INFO, *READABLE):
            definition(typename)  # slow: done here so that the first sample does not wait
        try:
            self._file = McapWriter(partial_path(path), "stridetwin")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
        self._file.metadata(index.RECORD, index.written())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.finish()
        if self.count:
            os.replace(partial_path(self.path), self.path)
        else:
            partial_path(self.path).unlink()

    def know(self, rig: Rig, metadata: Mapping[str, str]) -> None:
        """Sets rig and metadata of the senders: before their first message, and when further senders connect."""
        told = rig_to_yaml(rig), dict(metadata)
        if told == self._told:
            return
        self._told = told
        self._file.attachment(RIG_NAME, "application/yaml", told[0].encode())
        self._file.metadata(METADATA_NAME, told[1])
        self._cameras = dict(rig.cameras) | {c.depth_topic: c for c in rig.cameras.values() if c.depth_topic}

    def write(self, message: Message, t_ns: int) -> None:
        """Appends a message, and periodically with images the camera's intrinsics.

        Args:
            message: As received.
            t_ns: Stamp of its sample.
        """
        camera = self._cameras.get(message.topic)
        lane = _PICTURE_LANE if message.typename in IMAGES else 0
        if camera and t_ns >= self._next_info.get(message.topic, 0):
            self._next_info[message.topic] = t_ns + _INFO_PERIOD_NS
            info = camera_info_message(camera, message.topic, t_ns)
            self._append(f"{message.topic}/camera_info", CAMERA_INFO, info, t_ns, lane)
        self._append(message.topic, message.typename, message.payload, t_ns, lane)
        self.count += 1

    def _append(self, topic: str, typename: str, payload: bytes, t_ns: int, lane: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._file.channel(topic, typename, definition(typename))
        layout = np.dtype(f"V{len(payload)}")
        rows, _ = message_rows(self._channels[topic], payload, layout, np.array([t_ns], np.int64))
        self._file.messages(rows, lane)
