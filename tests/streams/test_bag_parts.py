"""What bags hold beside plain samples: compressed depth, CameraInfo, static transforms."""

import re
from pathlib import Path
from types import SimpleNamespace as Message

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.streams.formats.assumed_calibration import with_assumed_calibration
from stridetwin.streams.formats.bag_calibration import BagCalibration
from stridetwin.streams.recording.imported import ImageStream
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.ros_images import COMPRESSED, detect_image_kind, read_image_message
from stridetwin.streams.recording.ros_types import serialise, typestore
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu


def compressed(form, raw, a=0.0, b=0.0):
    _, png = cv2.imencode(".png", raw)
    head = np.zeros(3, "<f4")
    head[1:] = a, b
    data = np.concatenate((head.view(np.uint8), png.ravel()))
    return serialise(COMPRESSED, {"format": form, "data": data})


def test_compressed_depth_in_mm():
    raw = np.array([[0, 65535, 1234, 3]], np.uint16)
    payload = compressed("16UC1; compressedDepth png", raw)
    assert detect_image_kind(payload, COMPRESSED, typestore()) is Depth
    depth = read_image_message(payload, COMPRESSED, typestore(), "/d", 5).depth
    np.testing.assert_allclose(depth, [[0, 0, 1.234, 0.003]], atol=1e-6)


def test_compressed_depth_as_inverse():
    z, (a, b) = np.array([[0.5, 1.0, 4.0]]), (100.0, -3.0)
    raw = np.rint(a / z + b).astype(np.uint16)
    raw[0, 2] = 0
    depth = read_image_message(compressed("32FC1; compressedDepth", raw, a, b), COMPRESSED, typestore(), "/d", 5).depth
    np.testing.assert_allclose(depth, [[0.5, 1.0, 0.0]], rtol=0.01)


@pytest.mark.parametrize(
    "payload", [b"", b"\0\1\0\0junk", compressed("16UC1; compressedDepth", np.zeros((2, 2), np.uint8))]
)
def test_damaged_images_are_value_errors(payload):
    with pytest.raises(ValueError, match=r"sensor_msgs/msg/CompressedImage|compressedDepth"):
        read_image_message(payload, COMPRESSED, typestore(), "/d", 5)


def transform(parent, child, rotvec, p):
    x, y, z, w = Rotation.from_rotvec(rotvec).as_quat()
    return Message(
        header=Message(frame_id=parent),
        child_frame_id=child,
        transform=Message(rotation=Message(x=x, y=y, z=z, w=w), translation=Message(x=p[0], y=p[1], z=p[2])),
    )


def info(d=(), model="plumb_bob", focal=400.0, p=()):
    return Message(
        k=np.array([focal, 0, 320, 0, focal, 240, 0, 0, 1]),
        d=np.array(d),
        p=np.array(p),
        distortion_model=model,
        width=640,
        height=480,
    )


def streams():
    imu = Block(topic="/cam/imu", kind=Imu, t_ns=np.arange(5), columns={})
    image = ImageStream(kind=Image, t_ns=np.arange(5) * 33_333_333, load=lambda topic, i: None)
    return {"/cam/imu": imu}, {"/cam/color/image_raw": image}


def rig_of(calibration):
    blocks, images = streams()
    frames = {"/cam/imu": "imu_frame", "/cam/color/image_raw": "color_optical"}
    return calibration.build_rig(blocks, images, frames)


def test_mounts_come_along_the_tree_of_static_transforms():
    calibration = BagCalibration(Notes(Path("a"), False))
    calibration.add_camera_info("/cam/color/camera_info", info())
    T = {}
    for child, rotvec, p in (("imu_frame", (0.1, 0, 0), (0, 0, 1)), ("color_optical", (0, -1.5, 0.2), (0.1, 0.2, 0.3))):
        calibration.add_transforms(Message(transforms=[transform("base", child, rotvec, p)]))
        T[child] = np.eye(4)
        T[child][:3, :3], T[child][:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), p
    camera = rig_of(calibration).cameras["/cam/color/image_raw"]
    np.testing.assert_allclose(
        camera.mount.T_body_sensor, np.linalg.inv(T["imu_frame"]) @ T["color_optical"], atol=1e-12
    )
    assert camera.imu_topic == "/cam/imu"
    assert not calibration.assumed


def test_a_loop_or_a_gap_in_the_tree_is_no_mount():
    calibration = BagCalibration(Notes(Path("a"), False))
    calibration.add_camera_info("/cam/color/camera_info", info())
    loop = [
        transform("a", "color_optical", (0, 0, 0), (1, 0, 0)),
        transform("color_optical", "a", (0, 0, 0), (1, 0, 0)),
    ]
    calibration.add_transforms(Message(transforms=loop))
    camera = rig_of(calibration).cameras["/cam/color/image_raw"]
    np.testing.assert_array_equal(camera.mount.T_body_sensor, np.eye(4))
    assert "no mount in /tf_static" in calibration.assumed["/cam/color/image_raw"]


@pytest.mark.parametrize(
    ("d", "model", "report"),
    [
        ((0.1, 0.2, 0.001, 0.002, 0.0), "plumb_bob", ""),
        ((0.1, 0.2, 0.3, 0.4), "equidistant", ""),
        ((0.1, 0.2, 0.3, 0.4), "Kannala Brandt4", ""),
        ((0.1,), "omni", "'omni' with 1 coefficients is not supported; .*--rig"),
        ((0.1, 0.2, 0.0, 0.0, 40.0), "plumb_bob", "is not supported"),
    ],
)
def test_unsupported_distortions_are_reported(d, model, report):
    calibration = BagCalibration(Notes(Path("a"), False))
    calibration.add_camera_info("/cam/color/camera_info", info(d, model))
    camera = rig_of(calibration).cameras["/cam/color/image_raw"]
    assert camera.distortion[0] == 0.1
    words = calibration.assumed["/cam/color/image_raw"].partition("the same orientation")[2]
    assert re.search(report, words) if report else not words
    assert camera.distortion_model == ("radtan" if model in ("plumb_bob", "omni") else "equidistant")


AZURE = (0.5237, -2.2886, 0.0007, -0.0002, 1.3255, 0.4035, -2.1325, 1.2605)


@pytest.mark.parametrize(
    ("d", "model"), [(AZURE, "rational_polynomial"), ((-0.056, 0.066, 5e-4, 3e-4, -0.021), "plumb_bob")]
)
def test_lenses_of_more_terms_are_fitted_and_the_rest_is_reported(d, model):
    calibration = BagCalibration(Notes(Path("a"), False))
    calibration.add_camera_info("/cam/color/camera_info", info(d, model))
    camera = rig_of(calibration).cameras["/cam/color/image_raw"]
    u, v = np.meshgrid(np.linspace(-0.7, 0.7, 15), np.linspace(-0.5, 0.5, 11))
    rays, zero = np.column_stack((u.ravel(), v.ravel(), np.ones(u.size))), np.zeros(3)
    full, ours = (cv2.projectPoints(rays, zero, zero, camera.K, np.array(c))[0][:, 0] for c in (d, camera.distortion))
    off = np.linalg.norm(full - ours, axis=1)[(full >= 0).all(axis=1) & (full < (640, 480)).all(axis=1)]
    assert len(off) > 100
    reported = float(re.search(r"fitted by radtan, up to (\S+) px off", calibration.assumed["/cam/color/image_raw"])[1])
    assert off.max() <= 1.1 * reported < 2.0


@pytest.mark.parametrize(
    "topic", ["/cam/color/image_rect_color", "/cam/color/image_rect", "/cam/color/rectified/image"]
)
def test_rectified_images_go_with_p_and_no_distortion(topic):
    calibration = BagCalibration(Notes(Path("a"), False))
    P = (380.0, 0, 310, -20, 0, 381, 235, 0, 0, 0, 1, 0)
    calibration.add_camera_info("/cam/color/camera_info", info((-0.3, 0.1, 1e-3, 0, 0), p=P))
    blocks, images = streams()
    raw = images["/cam/color/image_raw"]
    cameras = calibration.build_rig(blocks, {topic: raw, "/cam/color/image_raw": raw}, {}).cameras
    assert cameras[topic].intrinsics == (380.0, 381.0, 310.0, 235.0)
    assert not any(cameras[topic].distortion)
    assert cameras["/cam/color/image_raw"].intrinsics == (400.0, 400.0, 320.0, 240.0)
    assert cameras["/cam/color/image_raw"].distortion[0] == -0.3
    calibration.add_camera_info("/cam/color/camera_info", info((-0.3, 0.1, 1e-3, 0, 0), p=np.zeros(12)))
    camera = calibration.build_rig(blocks, {topic: raw}, {}).cameras[topic]
    assert (camera.intrinsics[0], any(camera.distortion)) == (400.0, False)
    assert "has no P for rectified images" in calibration.assumed[topic]


def test_realsense_files_keep_calibrations_apart_from_images():
    calibration = BagCalibration(Notes(Path("a"), False))
    for sensor, focal in (("Color_0", 610.0), ("Depth_0", 420.0)):
        calibration.add_camera_info(f"/device_0/sensor_1/{sensor}/info/camera_info", info(focal=focal))
    blocks, images = streams()
    topics = [f"/device_0/sensor_1/{sensor}/image/data" for sensor in ("Color_0", "Depth_0")]
    cameras = calibration.build_rig(blocks, dict.fromkeys(topics, images["/cam/color/image_raw"]), {}).cameras
    assert [cameras[t].intrinsics[0] for t in topics] == [610.0, 420.0]


def test_depth_of_the_size_of_colour_is_taken_as_registered_with_a_warning():
    def load(topic, i):
        blank = np.zeros((480, 640))
        return Depth(topic=topic, t_ns=0, depth=blank) if "depth" in topic else Image(topic=topic, t_ns=0, pixels=blank)

    t = np.arange(5) * 33_333_333
    images = {
        "/head/color": ImageStream(kind=Image, t_ns=t, load=lambda topic, i: load("color", i)),
        "/head/depth": ImageStream(kind=Depth, t_ns=t, load=lambda topic, i: load("depth", i)),
    }
    for registered in ((), ("/head/depth",)):
        notes = Notes(Path("a"), False)
        rig = with_assumed_calibration(Rig(), {}, images, notes, registered)
        assert rig.cameras["/head/color"].depth_topic == "/head/depth"
        assert any("because of its size" in w for w in notes.warnings) is not bool(registered)


def test_a_camera_info_without_a_focal_length_is_none():
    notes = Notes(Path("a"), False)
    calibration = BagCalibration(notes)
    calibration.add_camera_info("/cam/color/camera_info", info(focal=0.0))
    assert not rig_of(calibration).cameras
    assert "not calibrated" in notes.warnings[0]
