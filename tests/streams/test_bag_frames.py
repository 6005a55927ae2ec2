"""Bags whose headers tell what their topics do not: frames of sensors, stamps, parts of the sensor."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from robot_files import IMAGE_TYPE, IMU_TYPE, INFO_TYPE, START_NS, STORE, header, info_message, still_imu, write_bag

from stridetwin.outputs.truth import TruePath
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.opening import ImportOptions, open_any

TIMES = [START_NS + 100_000_000 * i for i in range(6)]


def in_frame(frame, messages, stamp_ns=None):
    """IMU messages of a coordinate frame, all with one stamp if it is given."""
    for _, message in messages:
        message.header.frame_id = frame
        if stamp_ns is not None:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return messages


def image_message(t_ns, encoding, pixels):
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)
    return STORE.types[IMAGE_TYPE](header(t_ns), height, width, encoding, 0, pixels.nbytes // height, data)


def write_camera(folder, encoding, pixels, info=None):
    streams = {"/camera/color/image_raw": (IMAGE_TYPE, [(t, image_message(t, encoding, pixels)) for t in TIMES])}
    if info is not None:
        streams["/camera/color/camera_info"] = (INFO_TYPE, [(t, info(t)) for t in TIMES])
    return write_bag(folder, streams)


def test_frames_tell_the_foot_where_topics_do_not(tmp_path):
    streams = {
        "/imu_a/data": (IMU_TYPE, in_frame("left_foot_link", still_imu(seed=1))),
        "/imu_b/data": (IMU_TYPE, in_frame("right_foot_link", still_imu(seed=2))),
    }
    recording = open_any(write_bag(tmp_path / "bag", streams))
    assert {"/foot_l/imu", "/foot_r/imu"} <= set(recording.topics)


def test_sensors_that_share_a_topic_become_streams_of_their_own(tmp_path):
    left = in_frame("imu/left", still_imu(seed=1, rate=(0.1, 0, 0)))
    right = in_frame("imu/right", still_imu(seed=2, start_ns=START_NS + 5_000_000, rate=(0.0, 0.2, 0)))
    rows = sorted(left + right, key=lambda row: row[0])
    recording = open_any(write_bag(tmp_path / "bag", {"/imu": (IMU_TYPE, rows)}))
    for topic, rate in (("/imu/imu_left", (0.1, 0, 0)), ("/imu/imu_right", (0, 0.2, 0))):
        np.testing.assert_allclose(recording.block(topic).columns["angular_rate"], [rate] * 60)
    assert "several sensors, by their frames imu/left, imu/right" in " ".join(recording.warnings)


def test_stamps_that_a_driver_never_sets_are_those_of_arrival(tmp_path):
    rows = in_frame("imu", still_imu(), stamp_ns=START_NS)
    recording = open_any(write_bag(tmp_path / "bag", {"/imu/left_foot": (IMU_TYPE, rows)}))
    np.testing.assert_array_equal(recording.block("/foot_l/imu").t_ns, [t for t, _ in rows])
    assert "all stamps are 1700000000.000 s" in " ".join(recording.warnings)


@pytest.mark.parametrize(
    ("binning", "roi", "intrinsics"),
    [(2, (0, 0, 0, 0), (30.0, 30.0, 16.0, 12.0)), (0, (16, 8, 24, 32), (60.0, 60.0, 16.0, 16.0))],
)
def test_images_of_a_part_of_the_sensor(tmp_path, binning, roi, intrinsics):
    def info(t_ns):
        message = info_message(t_ns, 60.0, (64, 48))
        message.binning_x = message.binning_y = binning
        message.roi = STORE.types["sensor_msgs/msg/RegionOfInterest"](*roi, False)
        return message

    recording = open_any(write_camera(tmp_path / "bag", "rgb8", np.zeros((24, 32, 3), np.uint8), info))
    camera = recording.rig.cameras["/head/color"]
    assert (camera.width, camera.height) == (32, 24)
    assert camera.intrinsics == pytest.approx(intrinsics)


RGB = np.random.default_rng(4).integers(40, 200, (1, 1, 3), np.uint8).repeat(24, 0).repeat(32, 1)
ENCODED = {
    "bgr8": RGB[:, :, ::-1],
    "rgba8": cv2.cvtColor(RGB, cv2.COLOR_RGB2RGBA),
    "bgra8": cv2.cvtColor(RGB, cv2.COLOR_RGB2BGRA),
    "yuv422": cv2.cvtColor(RGB, cv2.COLOR_RGB2YUV_UYVY),
    "yuv422_yuy2": cv2.cvtColor(RGB, cv2.COLOR_RGB2YUV_YUY2),
}


@pytest.mark.parametrize("encoding", [*ENCODED, "bayer_rggb8", "bayer_grbg8"])
def test_encodings_of_drivers_are_read_as_rgb(tmp_path, encoding):
    if encoding.startswith("bayer"):  # the colours of a row of pixels, and of the next one
        mosaic = {c: RGB[:, :, "rgb".index(c)] for c in "rgb"}
        pixels = np.zeros((24, 32), np.uint8)
        for i, colour in enumerate(encoding[6:10]):
            pixels[i // 2 :: 2, i % 2 :: 2] = mosaic[colour][i // 2 :: 2, i % 2 :: 2]
    else:
        pixels = ENCODED[encoding]
    recording = open_any(write_camera(tmp_path / "bag", encoding, pixels))
    (image,) = recording.images("/head/color", [0])
    np.testing.assert_allclose(image.pixels[4:-4, 4:-4].astype(int), RGB[4:-4, 4:-4].astype(int), atol=3)


COMPRESSED = "sensor_msgs/msg/CompressedImage"


def write_compressed(folder, form, data):
    kind = STORE.types[COMPRESSED]
    rows = [(t, kind(header(t), form, np.frombuffer(data, np.uint8))) for t in TIMES]
    return write_bag(folder, {"/camera/depth/image_raw/compressed": (COMPRESSED, rows)})


@pytest.mark.parametrize("form", ["16UC1; png compressed ", "png"])
def test_compressed_images_of_16_bits_are_depth(tmp_path, form):
    data = cv2.imencode(".png", np.full((24, 32), 1700, np.uint16))[1].tobytes()
    (image,) = open_any(write_compressed(tmp_path / "bag", form, data)).images("/head/depth", [0])
    np.testing.assert_allclose(image.depth, 1.7)


def test_images_that_cannot_be_read_are_named_at_once(tmp_path):
    recording = open_any(write_compressed(tmp_path / "bag", "h264", b"\0\0\0\1abcd"))
    assert "its first image cannot be read" in " ".join(recording.warnings)


@pytest.mark.parametrize(
    ("encoding", "pixels", "per_metre"),
    [("16UC1", np.full((24, 32), 6800, np.uint16), 4000.0), ("32FC1", np.full((24, 32), 1700, np.float32), 1000.0)],
)
def test_the_unit_of_depth_of_a_bag_is_an_option(tmp_path, encoding, pixels, per_metre):
    bag = write_camera(tmp_path / "bag", encoding, pixels)
    (image,) = open_any(bag, options=ImportOptions(depth_scale=per_metre)).images("/head/depth", [0])
    np.testing.assert_allclose(image.depth, 1.7, rtol=1e-6)


def odometry_message(t_ns, q):
    def kind(name, *values):
        return STORE.types[f"geometry_msgs/msg/{name}"](*values)

    pose = kind("Pose", kind("Point", 0.0, 0.0, 1.0), kind("Quaternion", *q))
    still = kind("Twist", kind("Vector3", 0.0, 0.0, 0.0), kind("Vector3", 0.0, 0.0, 0.0))
    covariance = np.zeros(36)
    parts = kind("PoseWithCovariance", pose, covariance), kind("TwistWithCovariance", still, covariance)
    return STORE.types[ODOMETRY](header(t_ns), "base", *parts)


ODOMETRY = "nav_msgs/msg/Odometry"


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)])
def test_paths_without_attitudes_are_left_out(tmp_path, q):
    path = (ODOMETRY, [(t, odometry_message(t, q)) for t in TIMES])
    recording = open_any(write_bag(tmp_path / "bag", {"/vicon/odom": path, "/imu": (IMU_TYPE, still_imu())}))
    assert set(recording.topics) == {"/head/imu"}
    assert "6 of 6 poses have no attitude" in " ".join(recording.warnings)
    with pytest.raises(StrideTwinError, match=r"no readable sample: .*no attitude"):
        open_any(write_bag(tmp_path / "alone", {"/vicon/odom": path}))
    block = replace(
        open_any(
            write_bag(
                tmp_path / "good",
                {"/vicon/odom": (ODOMETRY, [(t, odometry_message(t, (0, 0, 0, 1.0))) for t in TIMES])},
            )
        ).block("/truth/head/odometry"),
        topic="/truth/head/odometry",
    )
    block.columns["q_world_frame"][2] = q
    with pytest.raises(StrideTwinError, match="expected the attitude as a unit quaternion"):
        TruePath.of(block)
