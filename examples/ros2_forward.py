"""A ROS 2 node that forwards topics to `stridetwin live` as they are: a sample's payload is the message's CDR bytes.

It needs rclpy and eclipse-zenoh, and nothing of StrideTwin: python3 ros2_forward.py rig.yaml 127.0.0.1 7365
"""

import json
import struct
import sys
import time
from collections import Counter
from functools import partial
from pathlib import Path

import rclpy
import zenoh
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

TOPICS = {  # theirs: ours, type
    "/camera/imu": ("/head/imu", "sensor_msgs/msg/Imu"),
    "/camera/color/image_raw/compressed": ("/head/color", "sensor_msgs/msg/CompressedImage"),
    "/camera/aligned_depth_to_color/image_raw": ("/head/depth", "sensor_msgs/msg/Image"),
    "/xsens/imu": ("/foot_l/imu", "sensor_msgs/msg/Imu"),
}
SETTINGS = {"mode": "client", "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}


class Forward(Node):
    """Subscribes without decoding (`raw=True`) and sends what comes."""

    def __init__(self, rig: str, host: str, port: int) -> None:
        super().__init__("stridetwin_forward")
        config = zenoh.Config()
        for key, value in {**SETTINGS, "connect/endpoints": [f"tcp/{host}:{port}"]}.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.key, self.numbers = f"stridetwin/{self.session.zid()}", Counter()
        self.ask("hello", {"version": 2, "rig": rig, "epoch_ns": 0})  # ROS stamps are system time
        for theirs, (ours, typename) in TOPICS.items():
            forward = partial(self.forward, ours, typename)
            self.create_subscription(get_message(typename), theirs, forward, qos_profile_sensor_data, raw=True)

    def forward(self, topic: str, typename: str, payload: bytes) -> None:
        """Sends one message; the stamp in its header counts, not the one here."""
        mark = struct.pack("<qQ", time.time_ns(), self.numbers[topic])
        self.numbers[topic] += 1
        encoding = f"application/cdr;{typename}"
        self.session.put(f"{self.key}/samples{topic}", bytes(payload), encoding=encoding, attachment=mark)

    def ask(self, what: str, content: dict) -> None:
        """Says hello or the end."""
        for reply in self.session.get(f"{self.key}/{what}", payload=json.dumps(content), timeout=10):
            if reply.err is None:
                return
            raise SystemExit(reply.err.payload.to_string())
        raise SystemExit("no `stridetwin live` there")

    def end(self) -> None:
        """Says that nothing more comes."""
        self.ask("end", self.numbers)
        self.session.close()


if __name__ == "__main__":
    rclpy.init()
    node = Forward(Path(sys.argv[1]).read_text(), sys.argv[2], int(sys.argv[3]))
    try:
        rclpy.spin(node)
    finally:
        node.end()
