"""Bags of ROS messages: any MCAP files, ROS 2 bags and ROS 1 bags, read into streams.

A `Bag` returns CDR messages, which are decoded like those of our own recordings (`streams.recording.topic_reader`).
Streams are mapped to our topics by type and topic name. Calibrations come from CameraInfo, mounts from /tf_static,
ground truth from poses named as truth (PoseStamped, PoseWithCovarianceStamped, TransformStamped).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Generic, Protocol, TypeVar

import numpy as np

from stridetwin.streams.errors import RecordingError, to_line
from stridetwin.streams.formats.bag_calibration import CALIBRATIONS, TRANSFORMS, BagCalibration
from stridetwin.streams.formats.derived import imu_name, join_gyro_and_accel, to_odometry
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes, Problem
from stridetwin.streams.recording.mcap_scan import Messages
from stridetwin.streams.recording.ros_types import Definitions, RosMessage, deserialise, typestore_for
from stridetwin.streams.recording.topic_reader import READABLE, SHORTEST_HEADER, TopicReader, read_header_stamp
from stridetwin.streams.samples import Accelerometer, Block, Depth, Image, Imu, Odometry, Sample, Stamps
from stridetwin.streams.segments import segment_of, side_of

OURS = re.compile(r"/(head|chest|foot_[lr]|exo|truth)/.+")
"""Topics of our own, as `/foot_l/imu`."""
_TRUE = re.compile(r"ground_?truth|(?<![a-z])gt(?![a-z])|vicon|mocap|optitrack|qualisys|truth")
"""What topics of ground truth contain, in lower case, as `/vicon/head` and `/gt/pose`."""
# names of the topics that are preferred as the head's camera, in order; the empty pattern at the end matches any
_COLOUR = (re.compile(r"color|colour|rgb"), re.compile(r"cam_?0|left"), re.compile(r""))
_DEPTH = (re.compile(r"aligned|registered"), re.compile(r""))
_ANY = (re.compile(r""),)
_FOOT_SENSORS: Mapping[type[Sample], str] = {Imu: "imu", Image: "camera"}
"""Our name of a foot's sensor, by the kind of its samples."""
_PLACE_SENSORS: Mapping[type[Sample], tuple[str, tuple[re.Pattern[str], ...]]] = {
    Imu: ("imu", _ANY),
    Accelerometer: ("accelerometer", _ANY),
    Image: ("color", _COLOUR),
    Depth: ("depth", _DEPTH),
}
"""Our name of a sensor of the head or chest, and the names of topics that are preferred as it, by kind."""
_NO_FRAMES: Mapping[str, str] = MappingProxyType({})
"""Frames of topics where none are known."""
_DEPTH_UNITS = re.compile(r"(.*)/option/Depth_Units/value")
"""Topic with the metres per unit of the depth images of a sensor, in RealSense's own files."""
_INFRARED = re.compile(r"infra|(?<![a-z])ir(?![a-z])")
"""What the topics of infrared cameras contain, which are no colour cameras."""


def assign_bag_topics(kinds: Mapping[str, type[Sample]], frames: Mapping[str, str] = _NO_FRAMES) -> dict[str, str]:
    """Our topic for each of a bag's topics that has one.

    Args:
        kinds: Kind of samples by topic, in the order of the bag.
        frames: Coordinate frame of each topic's messages, which tells the part of the body where the topic does not.

    Returns:
        IMUs and cameras whose names tell a foot with its side, the chest or the head (`segment_of`) become those of
        that part. The first IMU, colour camera and depth camera whose name tells no part of the body become those of
        the head, unless one is named so; a pose named as truth becomes the head's. Topics that already have our names,
        or have no counterpart, such as the IMU of a pelvis, are omitted and keep their names.
    """
    taken = {t for t in kinds if OURS.fullmatch(t)}  # our topics that a stream has or is given
    names: dict[str, str] = {}

    def assign(topic: str, ours: str) -> None:
        """Gives a topic of the bag one of ours, unless another topic has that already."""
        if ours not in taken:
            names[topic] = ours
            taken.add(ours)

    foreign_topics = {
        t: segment_of(t) or segment_of(frames.get(t, "")) for t in kinds if t not in taken
    }  # with the part of the body that each tells
    for topic, segment in foreign_topics.items():
        sensor = _FOOT_SENSORS.get(kinds[topic])
        if segment in ("foot_l", "foot_r") and sensor:
            assign(topic, f"/{segment}/{sensor}")
    for place, segments in (("chest", ("chest",)), ("head", ("head", ""))):  # the preferred segment first
        for kind, (sensor, patterns) in _PLACE_SENSORS.items():
            candidates = [
                t
                for segment in segments
                for t in foreign_topics
                if foreign_topics[t] == segment and kinds[t] is kind and not _is_no_candidate(t, kind)
            ]
            first = next((t for p in patterns for t in candidates if p.search(t.lower())), None)
            if first is not None:
                assign(first, f"/{place}/{sensor}")
    true = next((t for t, segment in foreign_topics.items() if kinds[t] is Odometry and _is_truth(t, segment)), None)
    if true is not None:
        assign(true, "/truth/head/odometry")
    return names


def _is_no_candidate(topic: str, kind: type[Sample]) -> bool:
    """Whether a topic names an infrared camera, or an IMU of one side, which is neither the head's nor the chest's."""
    return bool(_INFRARED.search(topic.lower())) or (kind is Imu and side_of(topic.lower()) != "")


def _is_truth(topic: str, segment: str) -> bool:
    """Whether a topic of poses is named as a true path, and not as that of another part of the body than the head.

    Args:
        topic: The topic.
        segment: Part of the body that it tells.
    """
    return bool(_TRUE.search(topic.lower())) and segment in ("", "head")


POSES = frozenset(
    f"geometry_msgs/msg/{name}" for name in ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped")
)


def pose_of(message: RosMessage) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Reads one message of a type in `POSES`, as they give the ground truth in bags.

    Returns:
        Stamp in ns (0 if the header has none), position (x, y, z) in m and quaternion (w, x, y, z) of the message's
        frame in its parent frame.
    """
    if hasattr(message, "transform"):  # a TransformStamped
        p, q = message.transform.translation, message.transform.rotation
    else:
        pose = getattr(message.pose, "pose", message.pose)  # with a covariance, the pose is one level below
        p, q = pose.position, pose.orientation
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec, (p.x, p.y, p.z), (q.w, q.x, q.y, q.z)


@dataclass(frozen=True)
class Channel:
    """A stream of a bag.

    Attributes:
        topic: Name of the stream.
        typename: ROS 2 name of its message type, such as `sensor_msgs/msg/Imu`.
        encoding: Language of `definition`: `ros2msg` or `ros2idl`.
        definition: Definition of the message type; "" if the bag has none.
    """

    topic: str
    typename: str
    encoding: str
    definition: str


KeyT = TypeVar("KeyT")


class Bag(Protocol[KeyT]):
    """An open bag of ROS messages; `McapBag` and `RosBag` in `bag_files` are the two kinds.

    A `KeyT` names one of its messages, so that this can be read again.

    Attributes:
        channels: Its streams.
    """

    channels: list[Channel]

    def read_messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes, KeyT]]:
        """(topic, log time in ns, CDR bytes, key) of every message of the topics, in file order."""

    def read_payload(self, topic: str, key: KeyT) -> bytes:
        """CDR bytes of one message, read again."""


_AFTER_STAMP = 12
"""Bytes of a message with a header before the name of its frame: those of its encapsulation and stamp."""
_MOST_CALIBRATIONS = 1000
"""Most messages with a camera's intrinsics that are compared."""
_MOST_LISTED = 12
"""Most topics that an error lists."""
_WANTED = "sensor_msgs/msg/Imu, Image, CompressedImage or JointState, nav_msgs/msg/Odometry or poses"
"""What an error about a bag without samples expects."""
_CONVERT = "convert it to ROS 2 messages first (such as rosbags-convert, or `ros2 bag convert`)"
"""What to do with messages of another encoding."""
_FLOAT_DEPTH, _HEAD_BYTES = b"32FC1", 512
"""Encoding of depth as floats, and in how many bytes of a message it is named."""
_IMU, _MOST_FRAMES = "sensor_msgs/msg/Imu", 16
"""Type of the messages that are divided by their frames, and most frames of one topic."""
_FLOAT, _MILLIMETRE = "std_msgs/msg/Float32", 0.001
"""Type of the messages with RealSense's depth units, and the unit of depth images in m, unless another one is given."""


class _Stream(Generic[KeyT]):
    """The messages of one topic while a bag is read.

    Of images, only the first payload is kept, to detect their kind, and the key by which each can be read again; of
    other types, every payload.

    Attributes:
        times: Stamp of each message in ns, from its header or else the log time.
        log_times: Log time of each message, ns.

    Raises:
        ValueError: The message definition cannot be parsed.
    """

    def __init__(self, channel: Channel) -> None:
        """Begins without messages of the topic of `channel`; only types that become samples have a reader.

        The other types, which are read later, are calibrations, transforms and poses.
        """
        self.channel = channel
        self.reader = (
            TopicReader(channel.topic, channel.typename, channel.encoding, channel.definition)
            if channel.typename in READABLE
            else None
        )
        self.is_image = self.reader is not None and self.reader.is_image
        self.times: list[int] = []
        self.log_times: list[int] = []
        self.payloads: list[bytes] = []  # CDR bytes: of the first image, or of every other message
        self.keys: list[KeyT] = []  # by which the bag finds each message again

    def add(self, log_time: int, payload: bytes, key: KeyT) -> None:
        """Keeps what is needed of a message: its stamp, its key, and the payload unless it is a later image.

        Args:
            log_time: Log time, ns, which is the stamp of a message without header.
            payload: CDR bytes.
            key: By which the bag finds the message again.
        """
        if not self.is_image or not self.payloads:
            self.payloads.append(payload)
        has_stamp = self.is_image and len(payload) >= SHORTEST_HEADER  # others are decoded later, with their stamps
        stamp = read_header_stamp(payload) if has_stamp else 0  # 0: none, or not set
        self.times.append(stamp or log_time)
        self.log_times.append(log_time)
        self.keys.append(key)


def read_bag(bag: Bag[KeyT], kind: str, notes: Notes, per_metre: float | None = None) -> Source:
    """Reads the streams of a bag: small ones into memory, images as streams that are read on request.

    Args:
        bag: The open bag.
        kind: Name of its format, one of `FILE_FORMATS`.
        notes: Collects problems.
        per_metre: Units of depth images per metre; None for mm in 16 bits and m in floats, or RealSense's units.

    Returns:
        Streams by the bag's topics, with our topic of each (`assign_bag_topics`), and the calibrations of its cameras.

    Raises:
        StrideTwinError: The bag cannot be read, or a topic cannot be decoded, unless lenient.
    """
    streams, unread = _open_streams(bag, notes)
    for topic, log_time, payload, key in bag.read_messages(set(streams)):
        streams[topic].add(log_time, payload, key)
    streams = _divide_by_frames(streams, notes)
    images: dict[str, ImageStream] = {}
    blocks: dict[str, Block[Sample]] = {}
    calibration = BagCalibration(notes)
    depth_units = _read_depth_units(streams)
    for topic, stream in streams.items():
        if not stream.times or _DEPTH_UNITS.fullmatch(topic):  # without messages, or read already
            continue
        try:
            if stream.reader is None:
                _read_calibration_or_poses(stream, calibration, blocks, notes)
            elif stream.is_image:
                units_m = _choose_depth_unit(stream, depth_units, per_metre)
                images[topic] = _to_image_stream(bag, stream, stream.reader, units_m, notes)
            else:
                block = stream.reader.read_block(_to_messages(stream))
                blocks[topic] = replace(block, t_ns=_replace_constant(topic, block.t_ns, stream.log_times, notes))
        except ValueError as error:
            notes.add_problem(Problem(topic, stream.times[0], f"cannot be decoded: {error}", len(stream.times)))
    blocks = join_gyro_and_accel(blocks, notes)
    frames = _read_frames(streams, blocks)
    kinds: dict[str, type[Sample]] = {topic: block.kind for topic, block in blocks.items()}
    kinds |= {topic: stream.kind for topic, stream in images.items()}
    if not any(map(len, blocks.values())) and not images and not notes.problems:
        raise _no_sample_error(bag.channels, streams, notes)
    names = assign_bag_topics(kinds, frames)
    names |= {topic: to_line(topic) for topic in kinds if topic not in names and to_line(topic) != topic}
    _report_choice_of_imu(kinds, names, notes)
    return Source(
        kind=kind,
        blocks=blocks,
        images=images,
        rig=calibration.build_rig(blocks, images, frames),
        unread={to_line(topic): to_line(typename) for topic, typename in unread.items()},
        names=names,
        assumed=calibration.assumed,
    )


def _choose_depth_unit(stream: _Stream[KeyT], depth_units: Mapping[str, float], per_metre: float | None) -> float:
    """Metres per unit of the depth images of a stream, by which numbers that are decoded as mm are corrected.

    Args:
        stream: Images, with the bytes of the first one.
        depth_units: Metres per unit of depth, by the sensor whose name a topic begins with.
        per_metre: Units per metre that the user gives; None: those of the sensor, or mm.
    """
    if per_metre is not None:  # depth of floats is taken as m when it is decoded
        is_float = _FLOAT_DEPTH in stream.payloads[0][:_HEAD_BYTES]
        return (_MILLIMETRE if is_float else 1.0) / per_metre
    topic = stream.channel.topic
    return next((unit_m for sensor, unit_m in depth_units.items() if topic.startswith(f"{sensor}/")), _MILLIMETRE)


def _read_frames(streams: Mapping[str, _Stream[KeyT]], blocks: Mapping[str, Block[Sample]]) -> dict[str, str]:
    """Name of the coordinate frame of each topic's messages, for the mounts in /tf_static.

    Args:
        streams: The streams of the bag.
        blocks: Those of them that are in memory; a joined IMU has replaced the two that it is of.

    Returns:
        The frame by topic, also of joined IMUs, which have that of their gyroscope.
    """
    frames = {topic: _read_header_frame(s.payloads[0]) for topic, s in streams.items() if s.payloads}
    joined = {imu_name(topic): frame for topic, frame in frames.items() if topic not in blocks}
    return frames | {topic: frame for topic, frame in joined.items() if topic in blocks}


def _divide_by_frames(streams: dict[str, _Stream[KeyT]], notes: Notes) -> dict[str, _Stream[KeyT]]:
    """The streams, where each IMU of a topic with messages of several frames has one of its own, such as `/imu/left`.

    Several sensors publish on one topic where the driver tells them apart by the frame in the header alone.
    """
    result: dict[str, _Stream[KeyT]] = {}
    for topic, stream in streams.items():
        frames = _list_frames(stream.payloads) if stream.channel.typename == _IMU else []
        if not 1 < len(frames) <= _MOST_FRAMES:
            result[topic] = stream
            continue
        named = ", ".join(frames)
        notes.warn(f"{topic}: its messages are those of several sensors, by their frames {named}: each is a stream")
        for payload, log_time, key in zip(stream.payloads, stream.log_times, stream.keys, strict=True):
            frame = re.sub(r"[^A-Za-z0-9_]+", "_", _read_header_frame(payload)).strip("_") or "unnamed"
            name = f"{topic}/{frame}"
            part = result.setdefault(name, _Stream(replace(stream.channel, topic=name)))
            part.add(log_time, payload, key)
    return result


def _list_frames(payloads: Sequence[bytes]) -> list[str]:
    """The frames in the headers of messages, each once."""
    if not payloads:
        return []
    end = _AFTER_STAMP + 4 + len(_read_header_frame(payloads[0])) + 1  # of the frame's length and name, with its zero
    begin = payloads[0][_AFTER_STAMP:end]
    if all(payload[_AFTER_STAMP:end] == begin for payload in payloads):
        return [_read_header_frame(payloads[0])]
    return list(dict.fromkeys(map(_read_header_frame, payloads)))


def _replace_constant(topic: str, t_ns: Stamps, log_times: Sequence[int], notes: Notes) -> Stamps:
    """Stamps (N,) ns, or the log times if a driver has given all messages the same stamp, which is reported.

    Args:
        topic: Named by the report.
        t_ns: (N,) stamps of the headers.
        log_times: N times of arrival, ns.
        notes: Collects the report.
    """
    if len(t_ns) > 2 and len(t_ns) == len(log_times) and (t_ns == t_ns[0]).all() and log_times[0] < log_times[-1]:
        notes.warn(f"{topic}: all stamps are {t_ns[0] * 1e-9:.3f} s: the times at which the messages arrived are taken")
        return np.array(log_times, np.int64)
    return t_ns


def _no_sample_error(channels: Sequence[Channel], streams: Mapping[str, _Stream[KeyT]], notes: Notes) -> RecordingError:
    """The error to raise about a bag without a sample: what it has, what is missing, and what to do.

    Args:
        channels: All streams of the bag.
        streams: Those of types that are read, with their messages.
        notes: Has the path of the bag.
    """
    texts = []
    for channel in sorted(channels, key=lambda c: c.topic):
        stream = streams.get(channel.topic)
        count = "" if stream is None else f", {len(stream.times) or 'no'} messages"
        texts.append(f"{channel.topic} ({channel.typename}{count})")
    more = [f"and {len(texts) - _MOST_LISTED} more"] if len(texts) > _MOST_LISTED else []
    contents = ", ".join([*texts[:_MOST_LISTED], *more]) or "no topic"
    is_encoding_read = all(" in " not in channel.typename for channel in channels)
    advice = "record the topics of the sensors as well" if is_encoding_read else _CONVERT
    return RecordingError(
        f"{notes.path}: no readable sample: expected messages of {_WANTED} in CDR or ROS 1; it has {contents}; {advice}"
    )


def _report_choice_of_imu(kinds: Mapping[str, type[Sample]], names: Mapping[str, str], notes: Notes) -> None:
    """Warns if the IMU that becomes the head's is the first of several whose names tell no part of the body.

    Args:
        kinds: Kind of samples by topic.
        names: Our topic of each topic that has one.
        notes: Collects the warning.
    """
    foreign_imus = [t for t, kind in kinds.items() if kind is Imu and not OURS.fullmatch(t)]
    unknown = [t for t in foreign_imus if not segment_of(t) and not _is_no_candidate(t, Imu)]
    first = next((t for t in unknown if names.get(t) == "/head/imu"), None)
    if first is not None and len(unknown) > 1:
        notes.warn(
            f"{first} is taken as /head/imu, of {', '.join(unknown)}; to choose another one: --map TOPIC=/head/imu"
        )


def _open_streams(bag: Bag[KeyT], notes: Notes) -> tuple[dict[str, _Stream[KeyT]], dict[str, str]]:
    """The streams of a bag that can be read, still without messages, and the types of the others.

    Args:
        bag: The open bag.
        notes: Collects streams whose message definition cannot be parsed.

    Returns:
        Streams by topic; type of the messages of each other topic.
    """
    streams: dict[str, _Stream[KeyT]] = {}
    unread: dict[str, str] = {}
    definitions = Definitions()
    for channel in bag.channels:
        is_read = channel.typename in READABLE | CALIBRATIONS | TRANSFORMS | POSES
        if not is_read and not (channel.typename == _FLOAT and _DEPTH_UNITS.fullmatch(channel.topic)):
            unread[channel.topic] = channel.typename
            continue
        try:
            definitions.add(channel.definition)
            streams[channel.topic] = _Stream(channel)
        except ValueError as error:
            unread[channel.topic] = channel.typename
            notes.add_problem(Problem(channel.topic, None, str(error)))
    return streams, unread


def _to_messages(stream: _Stream[KeyT]) -> Messages:
    """The collected payloads of a topic as `Messages`: one buffer with the offset, length and stamp of each."""
    lengths = np.array([len(p) for p in stream.payloads], np.int64)
    starts = np.concatenate(([0], np.cumsum(lengths)[:-1]))
    return Messages(b"".join(stream.payloads), starts, lengths, np.array(stream.times, np.int64))


def _read_depth_units(streams: Mapping[str, _Stream[KeyT]]) -> dict[str, float]:
    """Reads the depth units that RealSense's own files contain.

    Returns:
        Metres per unit by the name of a sensor, such as `/device_0/sensor_0`; 0.001 in place of a value that is not
        between 0 and 1.
    """
    units = {}
    for topic, stream in streams.items():
        if stream.payloads and (matched := _DEPTH_UNITS.fullmatch(topic)):
            c = stream.channel
            store = typestore_for(c.typename, c.encoding, c.definition)
            value = float(deserialise(store, stream.payloads[-1], c.typename).data)
            sensor = matched[1]
            units[sensor] = value if 0 < value < 1 else _MILLIMETRE
    return units


def _to_image_stream(
    bag: Bag[KeyT], stream: _Stream[KeyT], reader: TopicReader, units_m: float, notes: Notes
) -> ImageStream:
    """A stream of images that are read from the bag again on request.

    Args:
        bag: The open bag.
        stream: Stamps and keys of the images, and the first image's bytes, which tell their kind.
        reader: Decoder of the topic.
        units_m: Metres per unit of depth images.
        notes: Collects a stamp that all images have.
    """
    kind = reader.detect_image_kind(stream.payloads[0])
    keys, source = stream.keys, stream.channel.topic
    times = _replace_constant(source, np.array(stream.times, np.int64), stream.log_times, notes)

    def load(topic: str, i: int) -> Image | Depth:
        """Reads image `i` again, under a topic; depth, which is decoded as mm, gets its own unit."""
        image = reader.read_image(bag.read_payload(source, keys[i]), int(times[i]), topic)
        if isinstance(image, Depth) and units_m != _MILLIMETRE:
            return replace(image, depth=image.depth * np.float32(units_m / _MILLIMETRE))
        return image

    return ImageStream(kind=kind, t_ns=times, load=load)


def _read_calibration_or_poses(
    stream: _Stream[KeyT], calibration: BagCalibration, blocks: dict[str, Block[Sample]], notes: Notes
) -> None:
    """Reads messages that are not samples themselves.

    CameraInfo and /tf_static go into `calibration`; poses become a block of odometry in `blocks`.

    Args:
        stream: The messages of one topic.
        calibration: Collects calibrations and transforms.
        blocks: Small streams by topic, to which a path is added.
        notes: Collects problems.

    Raises:
        ValueError: A message lacks fields of its type.
    """
    c = stream.channel
    store = typestore_for(c.typename, c.encoding, c.definition)
    try:
        if c.typename in CALIBRATIONS:
            # those that differ in more than the stamp, which is in the bytes before `_AFTER_STAMP`
            distinct = list({payload[_AFTER_STAMP:]: payload for payload in reversed(stream.payloads)}.values())[::-1]
            step = 1 + len(distinct) // _MOST_CALIBRATIONS
            calibration.add_camera_info(c.topic, *(deserialise(store, p, c.typename) for p in distinct[::step]))
        elif c.typename in TRANSFORMS:
            if c.topic.endswith("tf_static"):  # transforms that change are no mounts
                for payload in stream.payloads:
                    calibration.add_transforms(deserialise(store, payload, c.typename))
        else:
            poses = [pose_of(deserialise(store, payload, c.typename)) for payload in stream.payloads]
            stamps, positions, quaternions = zip(*poses)
            # messages without a stamp have their log time
            t_ns = np.array([stamp or log_time for stamp, log_time in zip(stamps, stream.times)], np.int64)
            p, q = np.array(positions), np.array(quaternions)
            blocks[c.topic] = to_odometry(c.topic, t_ns, p, q, None, notes, f"{notes.path}: {c.topic}")
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"not a {c.typename}: {error}") from error


def _read_header_frame(payload: bytes) -> str:
    """The frame in a message's header, "" without a header.

    The header is at the beginning: 4 bytes of encapsulation, 8 of the stamp, 4 with the length of the frame's name, and
    the name. Messages of types without a header have other bytes there, whose text is then no frame.
    """
    order = "little" if len(payload) > 1 and payload[1] else "big"
    length = int.from_bytes(payload[12:16], order) if len(payload) >= 16 else 0  # type: ignore[arg-type]
    try:
        # a longer name is none: the type has no header
        return payload[16 : 16 + length].rstrip(b"\0").decode() if length < 256 else ""
    except UnicodeDecodeError:
        return ""
