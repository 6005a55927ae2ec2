"""Bags as recorders of robots and converters leave them."""

from __future__ import annotations

import numpy as np
from mcap.writer import Writer
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMU_TYPE, INFO_TYPE, IMAGE_TYPE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
START_NS = 1_700_000_000 * 10**9
PERIOD_NS = 10_000_000


def header(t_ns):
    stamp = STORE.types["builtin_interfaces/msg/Time"](*divmod(int(t_ns), 10**9))
    return STORE.types["std_msgs/msg/Header"](stamp, "imu")


def imu_message(t_ns, rate, force):
    vector, quaternion = STORE.types["geometry_msgs/msg/Vector3"], STORE.types["geometry_msgs/msg/Quaternion"]
    return STORE.types[IMU_TYPE](
        header(t_ns),
        quaternion(0.0, 0.0, 0.0, 1.0),
        np.zeros(9),
        vector(*map(float, rate)),
        np.zeros(9),
        vector(*map(float, force)),
        np.zeros(9),
    )


def info_message(t_ns, focal, size=(32, 24)):
    """A CameraInfo of a pinhole with its centre in the middle."""
    K = np.array([focal, 0, size[0] / 2, 0, focal, size[1] / 2, 0, 0, 1.0])
    roi = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    kind = STORE.types[INFO_TYPE]
    return kind(header(t_ns), size[1], size[0], "plumb_bob", np.zeros(5), K, np.eye(3).ravel(), np.zeros(12), 0, 0, roi)


def grey_message(t_ns, size=(32, 24)):
    pixels = np.full(size[0] * size[1], 90, np.uint8)
    return STORE.types[IMAGE_TYPE](header(t_ns), size[1], size[0], "mono8", 0, size[0], pixels)


def still_imu(count=60, start_ns=START_NS, shift_ns=0, rate=None, force=None, seed=3):
    """(log time in ns, message) of an IMU at rest; its stamps are `shift_ns` after the log times."""
    rng = np.random.default_rng(seed)
    rates = rng.normal(0, 0.01, (count, 3)) if rate is None else np.tile(rate, (count, 1))
    forces = rng.normal((0, 0, 9.81), 0.02, (count, 3)) if force is None else np.tile(force, (count, 1))
    stamps = start_ns + PERIOD_NS * np.arange(count)
    return [(int(t), imu_message(t + shift_ns, w, f)) for t, w, f in zip(stamps, rates, forces)]


def write_bag(folder, streams, storage=rosbag2.StoragePlugin.SQLITE3):
    """A ROS 2 bag; `streams` has (type, messages with their log times) by topic."""
    with rosbag2.Writer(folder, version=9, storage_plugin=storage) as writer:
        ends = {topic: writer.add_connection(topic, name, typestore=STORE) for topic, (name, _) in streams.items()}
        rows = [(t, topic, name, message) for topic, (name, rows) in streams.items() for t, message in rows]
        for t, topic, name, message in sorted(rows, key=lambda row: row[0]):
            writer.write(ends[topic], t, STORE.serialize_cdr(message, name))
    return folder


def convert_to_mcap(bag, file, *, schema=None, chunked=True):
    """Copies the messages of a ROS 1 bag into an MCAP file as they are, as `mcap convert` does.

    `schema` replaces the definitions of all types.
    """
    with rosbag1.Reader(bag) as reader, file.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunked)
        writer.start(profile="ros1")
        channels = {}
        for connection in reader.connections:
            name, text = connection.msgtype.replace("/msg/", "/"), connection.msgdef.data
            number = writer.register_schema(name, "ros1msg", (text if schema is None else schema).encode())
            channels[connection.id] = writer.register_channel(connection.topic, "ros1", number)
        for connection, t_ns, raw in reader.messages():
            writer.add_message(channels[connection.id], log_time=t_ns, publish_time=t_ns, data=bytes(raw))
        writer.finish()
    return file
