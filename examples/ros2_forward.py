"""A ROS 2 node that forwards topics to `stridetwin live` as they are: a frame's payload is the message's CDR bytes.

It needs rclpy and nothing of StrideTwin: python3 ros2_forward.py rig.yaml 127.0.0.1 7365
"""

import json
import socket
import struct
import sys
import time
from functools import partial
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

TOPICS = {  # theirs: ours, type
    "/camera/imu": ("/head/imu", "sensor_msgs/msg/Imu"),
    "/camera/color/image_raw/compressed": ("/head/color", "sensor_msgs/msg/CompressedImage"),
    "/camera/aligned_depth_to_color/image_raw": ("/head/depth", "sensor_msgs/msg/Image"),
    "/xsens/imu": ("/foot_l/imu", "sensor_msgs/msg/Imu"),
}
HELLO, SAMPLE = 1, 2


def frame(kind: int, body: bytes) -> bytes:
    """Length, kind, body."""
    return struct.pack("<IB", len(body) + 1, kind) + body


class Forward(Node):
    """Subscribes without decoding (`raw=True`) and sends what comes."""

    def __init__(self, rig: str, host: str, port: int) -> None:
        super().__init__("stridetwin_forward")
        self.peer = socket.create_connection((host, port))
        hello = {"stridetwin": 1, "rig": rig, "metadata": {}, "epoch_ns": 0}  # ROS stamps are system time
        self.peer.sendall(frame(HELLO, json.dumps(hello).encode()))
        for theirs, (ours, typename) in TOPICS.items():
            forward = partial(self.forward, ours.encode(), typename.encode())
            self.create_subscription(get_message(typename), theirs, forward, qos_profile_sensor_data, raw=True)

    def forward(self, topic: bytes, typename: bytes, payload: bytes) -> None:
        """Sends one message; the stamp in its header counts, not the one here."""
        head = struct.pack("<q", time.time_ns()) + bytes([len(topic)]) + topic + bytes([len(typename)]) + typename
        self.peer.sendall(frame(SAMPLE, head + bytes(payload)))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Forward(Path(sys.argv[1]).read_text(), sys.argv[2], int(sys.argv[3])))
