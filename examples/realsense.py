"""A RealSense camera with IMU (D435i, D455) on the head, sent to `stridetwin live`.

python examples/realsense.py --rig rig.yaml           # the camera
python examples/realsense.py --replay walk.mcap       # a recording in its place
"""

import argparse
import queue
import time
from collections.abc import Iterator

import numpy as np
from replay import paced

from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.kalibr import read_rig
from stridetwin.streams.live.sender import Sender
from stridetwin.streams.live.wire import parse_address
from stridetwin.streams.samples import Depth, Image, Imu, Sample

TOPICS = ("/head/imu", "/head/color", "/head/depth")


def camera() -> Iterator[Sample]:
    """Samples of the camera; stamps are system time (its global time domain), of the middle of the exposure."""
    import pyrealsense2 as rs

    config, frames = rs.config(), queue.Queue(maxsize=64)
    config.enable_stream(rs.stream.color, 640, 480, rs.format.rgb8, 30)
    config.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
    config.enable_stream(rs.stream.accel, rs.format.motion_xyz32f)
    config.enable_stream(rs.stream.gyro, rs.format.motion_xyz32f, 200)
    pipeline, align = rs.pipeline(), rs.align(rs.stream.color)
    profile = pipeline.start(config, frames.put)
    for sensor in profile.get_device().query_sensors():
        if sensor.supports(rs.option.global_time_enabled):
            sensor.set_option(rs.option.global_time_enabled, 1)
    metres = profile.get_device().first_depth_sensor().get_depth_scale()
    rates, before = [], None  # the gyroscope's samples wait for the acceleration on their other side
    while True:
        frame = frames.get()
        t_ns = int(frame.get_timestamp() * 1e6)
        if frame.is_frameset():
            both = align.process(frame.as_frameset())
            depth = np.asanyarray(both.get_depth_frame().get_data())
            yield Image(topic="/head/color", t_ns=t_ns, pixels=np.asanyarray(both.get_color_frame().get_data()).copy())
            yield Depth(topic="/head/depth", t_ns=t_ns, depth=depth.astype(np.float32) * np.float32(metres))
            continue
        data = frame.as_motion_frame().get_motion_data()
        now = t_ns, np.array([data.x, data.y, data.z])
        if frame.get_profile().stream_type() == rs.stream.gyro:
            rates.append(now)
            continue
        while before is not None and rates and rates[0][0] <= t_ns:
            t, rate = rates.pop(0)
            share = (t - before[0]) / (t_ns - before[0])
            force = before[1] + share * (now[1] - before[1])
            yield Imu(topic="/head/imu", t_ns=t, angular_rate=rate, specific_force=force)
        before = now


def main() -> None:
    """Sends until it is stopped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rig", help="calibration of the camera, Kalibr YAML")
    parser.add_argument("--replay", help="recording in the place of the camera")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--to", default="", help="HOST:PORT of stridetwin live")
    arguments = parser.parse_args()
    if arguments.replay:
        recording = open_any(arguments.replay)
        rig, samples = recording.rig, paced(recording, TOPICS, arguments.speed)
        epoch_ns = time.time_ns() - min(recording.topics[t].first_ns for t in TOPICS)
    else:
        rig, samples, epoch_ns = read_rig(arguments.rig), camera(), 0  # stamps are system time
    with Sender(rig, parse_address(arguments.to, "--to"), epoch_ns=epoch_ns) as sender:
        for sample in samples:
            sender.send(sample)
    print(f"sent {dict(sender.sent)}, dropped {dict(sender.dropped)}")


if __name__ == "__main__":
    main()
