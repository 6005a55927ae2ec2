"""Recordings of Project Aria glasses (`.vrs`), read by Meta's own package, an optional extra.

Images and IMUs with the stamps of the device's clock. Aria's lens model has more terms than ours: its cameras need
`--rig`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.streams.errors import StrideTwinError, explain_import_error
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Image, Imu, Sample, Stamps

EXTRA = "aria"
IMUS = {"imu-right": "/head/imu", "imu-left": "/head/imu_left"}
CAMERAS = {"camera-rgb": "/head/color", "camera-slam-left": "/head/slam_left", "camera-slam-right": "/head/slam_right"}


def read_aria_vrs(path: Path, notes: Notes) -> Source:
    """Reads the IMUs and cameras of Aria glasses, without their calibrations.

    Args:
        path: The `.vrs` file.
        notes: Collects what is assumed.

    Returns:
        Streams under the topics of `IMUS` and `CAMERAS`, stamped by the device's clock; other streams are listed as
        unread. The rig is empty, so that poses and lenses must be given with `--rig`.

    Raises:
        StrideTwinError: The package `projectaria_tools` is not installed, or cannot read the file.
    """
    with explain_import_error(f"{path}: recordings of Aria glasses need their own reader", EXTRA):
        from projectaria_tools.core import data_provider
        from projectaria_tools.core.sensor_data import TimeDomain
    try:
        provider: Any = data_provider.create_vrs_data_provider(str(path))
    except (RuntimeError, ValueError) as error:
        raise StrideTwinError(f"{path}: cannot be read: {' '.join(str(error).split())[:200]}") from error
    if provider is None:
        raise StrideTwinError(f"{path}: cannot be read: projectaria_tools finds no recording of Aria glasses in it")
    blocks: dict[str, Block[Sample]] = {}
    images: dict[str, ImageStream] = {}
    for label, topic in IMUS.items():  # those that the file lacks, or that have no data, are passed over
        if (stream := provider.get_stream_id_from_label(label)) is not None and provider.get_num_data(stream):
            blocks[topic] = _read_imu(provider, stream, topic)
    for label, topic in CAMERAS.items():
        if (stream := provider.get_stream_id_from_label(label)) is not None and provider.get_num_data(stream):
            t_ns = np.array(provider.get_timestamps_ns(stream, TimeDomain.DEVICE_TIME), np.int64)
            images[topic] = _to_image_stream(provider, stream, t_ns)
    names = [provider.get_label_from_stream_id(stream) for stream in provider.get_all_streams()]
    unread = {f"/{name}": "stream" for name in names if name and name not in IMUS.keys() | CAMERAS.keys()}
    notes.warn("poses of the sensors on the glasses are not read; give them with --rig FILE (Kalibr YAML)")
    return Source(kind="vrs", blocks=blocks, images=images, rig=Rig(), unread=unread)


def _read_imu(provider: Any, stream: Any, topic: str) -> Block[Imu]:
    """Reads all samples of an IMU stream: rates in rad/s, specific forces in m/s², both in the sensor's frame.

    Args:
        provider: The file, opened by Meta's package.
        stream: Its ID of the stream.
        topic: Topic of the samples.
    """
    samples = [provider.get_imu_data_by_index(stream, i) for i in range(provider.get_num_data(stream))]
    t_ns = np.array([sample.capture_timestamp_ns for sample in samples], np.int64)
    columns = {
        "angular_rate": np.array([sample.gyro_radsec for sample in samples], float).reshape(-1, 3),
        "specific_force": np.array([sample.accel_msec2 for sample in samples], float).reshape(-1, 3),
    }
    return Block(topic=topic, kind=Imu, t_ns=t_ns, columns=columns)


def _to_image_stream(provider: Any, stream: Any, t_ns: Stamps) -> ImageStream:
    """A stream of 8-bit images, which Meta's package decodes one by one on request.

    Args:
        provider: The file, opened by Meta's package.
        stream: Its ID of the stream.
        t_ns: (N,) stamps.
    """

    def load(topic: str, i: int) -> Image:
        """Decodes image `i` under a topic; what Meta's package returns beside it, its metadata, is not needed."""
        image, _ = provider.get_image_data_by_index(stream, i)
        return Image(topic=topic, t_ns=int(t_ns[i]), pixels=np.ascontiguousarray(image.to_numpy_array(), np.uint8))

    return ImageStream(kind=Image, t_ns=t_ns, load=load)
