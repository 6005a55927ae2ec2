"""Calibrations under our topics: renaming the sensors of a rig, and matching a given rig to a source.

A given rig may name its sensors like the source (`rostopic`), by our topics, or by Kalibr's numbers (`cam0`,
`imu0`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.assumed_calibration import body_of
from stridetwin.streams.formats.euroc import NAMES
from stridetwin.streams.kalibr import PLAIN_BODY, UnplacedMount
from stridetwin.streams.recording.imported import Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Array, Image, Imu

_TRANSPORT = re.compile(r"/(compressed|compressedDepth|image/data|imu/data)$")
"""What drivers add to the topic of a sensor for one form of its messages."""
_BARE_NUMBER = re.compile(r"/(cam|imu)\d+")
"""Topic of a sensor whose calibration names none, as in the files of ORB-SLAM3 and Basalt."""
Calibration = ImuCalibration | CameraCalibration | OtherSensor
CalibrationT = TypeVar("CalibrationT", ImuCalibration, CameraCalibration, OtherSensor)


@dataclass(frozen=True, kw_only=True)
class Streams:
    """Mapping of a source's streams to ours.

    Attributes:
        topics: Our topic by the source's name.
        names: Default topic of each of the source's names.
        imus: Our topics of its IMUs.
        cameras: Our topics of its colour cameras.
        numbered: Whether the source has sensors without topics; Kalibr's `cam0` is then its first camera.
    """

    topics: Mapping[str, str]
    names: Mapping[str, str] = field(default_factory=dict)
    imus: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    numbered: bool = False

    def find(self, rostopic: str, as_read: bool, number: str = "") -> str | None:
        """Our topic of the stream that a calibration describes, None without such a stream.

        Tried in turn are: the source's names and their defaults, and our topics; the names without the endings that ROS
        drivers add; for sources without topics, and for calibrations without them, the names of
        Kalibr's sections.

        Args:
            rostopic: Topic in the calibration.
            as_read: Whether our topics take precedence over the source's names when a name is both.
            number: Kalibr's name of the section, such as `cam0`, if it may be used.
        """
        name = "/" + rostopic.strip("/")
        # tables of our topic: by itself; by the source's name or its default topic; by the name without endings
        by_ours = {t: t for t in self.topics.values()}
        by_default = {default: self.topics[n] for n, default in self.names.items()}
        by_source = by_default | dict(self.topics)
        for table in (by_ours, by_source) if as_read else (by_source, by_ours):
            if name in table:
                return table[name]
        by_bare_name = {_TRANSPORT.sub("", n): t for n, t in self.topics.items()}
        if (topic := by_bare_name.get(_TRANSPORT.sub("", name))) is not None:
            return topic
        if not self.numbered and not _BARE_NUMBER.fullmatch(name):
            return None
        # Kalibr's number, which may also be the first part of the topic: the sensor that EuRoC's layout calls so, or
        # the only IMU or colour camera of the source
        for section in (name.split("/")[1], number):
            if (target := NAMES.get(section, f"/{section}")) in by_source:
                return by_source[target]
            candidates = {"imu0": self.imus, "cam0": self.cameras}.get(section, ())
            if len(candidates) == 1:
                return candidates[0]
        return None


def streams_of(source: Source, topics: Mapping[str, str], numbered: bool) -> Streams:
    """The mapping of a source's streams to our topics, by which `match_rig` finds the stream of a calibration.

    Args:
        source: The imported source.
        topics: Our topic of each of the source's names.
        numbered: Whether the source has sensors without topics.
    """
    return Streams(
        topics=topics,
        names={name: source.names.get(name, name) for name in topics},
        imus=tuple(topics[name] for name, block in source.blocks.items() if block.kind is Imu),
        cameras=tuple(topics[name] for name, stream in source.images.items() if stream.kind is Image),
        numbered=numbered,
    )


def rename_rig(rig: Rig, topic_of: Callable[[str], str], bodies_are_known: bool) -> Rig:
    """Renames the sensors of a rig, and moves each to the body that its new topic implies.

    Args:
        rig: The rig.
        topic_of: New topic by the old one.
        bodies_are_known: Whether the rig knows the body of each sensor; then a body only changes if the new topic
            implies another one than the old topic.
    """

    def rename(item: CalibrationT) -> CalibrationT:
        """One sensor under its new topic, on the body that this implies, with its references renamed as well."""
        topic, body = topic_of(item.topic), item.mount.body
        if not bodies_are_known or body_of(topic) != body_of(item.topic):
            body = body_of(topic)
        changes: dict[str, Any] = {"topic": topic, "mount": replace(item.mount, body=body)}
        for link in ("depth_topic", "imu_topic"):  # attributes of cameras that refer to other streams
            if getattr(item, link, ""):
                changes[link] = topic_of(getattr(item, link))
        return replace(item, **changes)

    def rename_all(items: Mapping[str, CalibrationT]) -> dict[str, CalibrationT]:
        """Several sensors of one kind, by their new topics."""
        return {new.topic: new for new in map(rename, items.values())}

    return Rig(
        imus=rename_all(rig.imus), cameras=rename_all(rig.cameras), boards=rig.boards, others=rename_all(rig.others)
    )


def match_rig(rig: Rig, known: Rig, streams: Streams, as_read: bool = True) -> tuple[Rig, list[str]]:
    """Assigns the sensors of a given rig to a source's streams, and renames them to our topics.

    Values that a plain Kalibr file does not contain (the IMU's pose on the body, rates, the depth stream of a camera)
    keep their known values.

    Args:
        rig: Rig from the file.
        known: Known calibrations of the source's sensors, under our topics.
        streams: Mapping of the source's streams.
        as_read: Whether our topics take precedence over the source's names.

    Returns:
        The rig, and the file's names of sensors that match no stream; these are omitted.
    """
    # sensors of the file, by what Kalibr calls their sections; "" for those that it has no sections for
    sensors: dict[str, Mapping[str, Calibration]] = {"cam": rig.cameras, "imu": rig.imus, "": rig.others}
    topic_of: dict[str, str] = {}  # our topic of each sensor of the file that matches a stream
    for stem in ("imu", "cam", ""):
        for i, item in enumerate(sensors[stem].values()):
            number = f"{stem}{i}" if item.mount.body == PLAIN_BODY else ""  # only a plain Kalibr file goes by numbers
            target = streams.find(item.topic, as_read, number)
            depth = getattr(item, "depth_topic", "")
            if target is None and depth and streams.find(depth, as_read) is not None:
                target = item.topic  # a camera that has depth alone
            if target is not None and target not in topic_of.values():  # of two for one stream the first counts
                topic_of[item.topic] = target
    # depth streams that only a camera refers to, and our topics of them
    links = {c.depth_topic for c in rig.cameras.values()} - {""} - topic_of.keys()
    linked = {link: streams.find(link, as_read) or link for link in links}
    matched = Rig(
        imus={name: imu for name, imu in rig.imus.items() if name in topic_of},
        cameras={name: camera for name, camera in rig.cameras.items() if name in topic_of},
        boards=rig.boards,
        others={name: sensor for name, sensor in rig.others.items() if name in topic_of},
    )
    renamed = rename_rig(matched, lambda name: topic_of.get(name) or linked.get(name, name), bodies_are_known=True)
    # our topics of the sensors of a plain Kalibr file, whose body is the IMU itself: they go onto the known body
    plain = {topic_of[name] for name, imu in matched.imus.items() if imu.mount.body == PLAIN_BODY}
    plain |= {topic_of[name] for name, camera in matched.cameras.items() if camera.mount.body == PLAIN_BODY}
    first = next((topic for topic in renamed.imus if topic in plain), "")  # to which a plain file refers the others
    base = known.imus[first].mount if first in known.imus else Mount(body=body_of(first))
    imus = {
        topic: _mount_imu(imu, known.imus.get(topic), base) if topic in plain else imu
        for topic, imu in renamed.imus.items()
    }
    # of all IMUs; the file's take precedence
    mounts = {topic: imu.mount for topic, imu in {**known.imus, **imus}.items()}
    cameras = {
        topic: _mount_camera(camera, known.cameras.get(topic), mounts, streams.imus) if topic in plain else camera
        for topic, camera in renamed.cameras.items()
    }
    unmatched = [item.topic for table in sensors.values() for item in table.values() if item.topic not in topic_of]
    return Rig(imus=imus, cameras=cameras, boards=renamed.boards, others=renamed.others), unmatched


def report_unmatched(file: Path, rig: Rig, unmatched: Iterable[str], streams: Streams, notes: Notes) -> None:
    """Reports the calibrations of a file that match no stream; a file without any match is rejected.

    Args:
        file: The file.
        rig: Its contents.
        unmatched: Names of its sensors that match no stream.
        streams: Mapping of the source's streams, for the names in the message.
        notes: Collects the report.

    Raises:
        ConfigError: No calibration matches a stream, unless lenient.
    """
    unmatched = list(unmatched)
    names = sorted({*streams.topics, *streams.names.values(), *streams.topics.values()})
    if streams.numbered:
        names += ["/cam0, /imu0, ..."]
    valid = f"an existing stream: {', '.join(names)}"
    if unmatched and len(unmatched) == len(rig.imus) + len(rig.cameras) + len(rig.others):  # all of them
        notes.add_error(ConfigError(file, "rostopic", ", ".join(unmatched), valid))
    elif unmatched:
        notes.warn(f"{file}: {', '.join(unmatched)}: no stream of this name; its calibration is not used")


def _mount_imu(imu: ImuCalibration, known: ImuCalibration | None, base: Mount) -> ImuCalibration:
    """An IMU of a plain calibration, whose body is its first IMU, on the body that carries it.

    Args:
        imu: The given calibration. If it gives the pose in the first IMU's frame, the mount follows from `base`.
        known: Known calibration of the IMU, whose mount, and rate if the file has none, are kept; None without one.
        base: Mount of the file's first IMU.
    """
    T_first_imu: Array = imu.mount.T_body_sensor
    if not np.array_equal(T_first_imu, np.eye(4)):
        mount = Mount(body=base.body, T_body_sensor=base.T_body_sensor @ T_first_imu)
    else:
        mount = Mount(body=body_of(imu.topic)) if known is None else known.mount
    if known is None:
        return replace(imu, mount=mount)
    return replace(imu, mount=mount, part=imu.part or known.part, rate_hz=imu.rate_hz or known.rate_hz)


def _mount_camera(
    camera: CameraCalibration, known: CameraCalibration | None, mounts: Mapping[str, Mount], imus: tuple[str, ...]
) -> CameraCalibration:
    """A camera of a plain calibration, which gives its pose in the IMU's frame, as mounted on the body.

    The IMU is the one that the file names, else the camera's known one, else the first one of the source on its body.

    Args:
        camera: The given calibration.
        known: Known calibration of the camera, whose rate, depth stream and read-out time are kept.
        mounts: Known mount of each IMU, by topic.
        imus: Topics of the source's IMUs, for a camera that names none.
    """
    candidates = [
        camera.imu_topic,
        known.imu_topic if known else "",
        *(t for t in imus if body_of(t) == camera.mount.body),
    ]
    imu = next((t for t in candidates if t in imus or t in mounts), "")
    T_imu_cam: Array = camera.mount.T_body_sensor  # the body of a plain file is the IMU
    imu_mount = mounts.get(imu, Mount(body=body_of(camera.topic)))
    mount = Mount(body=imu_mount.body, T_body_sensor=imu_mount.T_body_sensor @ T_imu_cam)
    shift = camera.timeshift_cam_imu_s
    if known is None:
        return replace(camera, imu_topic=imu, mount=mount)
    if isinstance(camera.mount, UnplacedMount):  # a file without T_cam_imu: intrinsics alone
        mount, shift = known.mount, shift or known.timeshift_cam_imu_s
    return replace(
        camera,
        imu_topic=imu,
        mount=mount,
        timeshift_cam_imu_s=shift,
        part=camera.part or known.part,
        rate_hz=camera.rate_hz or known.rate_hz,
        depth_topic=camera.depth_topic or known.depth_topic,
        readout_s=camera.readout_s or known.readout_s,
    )
