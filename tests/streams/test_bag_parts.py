"""What bags hold beside plain samples: compressed depth, CameraInfo, static transforms."""

from pathlib import Path
from types import SimpleNamespace as Message

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.streams.formats.bag_calibration import BagCalibration
from stridetwin.streams.imported import Notes, Pictures
from stridetwin.streams.ros_pictures import COMPRESSED, picture_kind, read_picture
from stridetwin.streams.ros_types import serialise, typestore
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
    assert picture_kind(payload, COMPRESSED, typestore()) is Depth
    depth = read_picture(payload, COMPRESSED, typestore(), "/d", 5).depth
    np.testing.assert_allclose(depth, [[0, 0, 1.234, 0.003]], atol=1e-6)


def test_compressed_depth_as_inverse():
    z, (a, b) = np.array([[0.5, 1.0, 4.0]]), (100.0, -3.0)
    raw = np.rint(a / z + b).astype(np.uint16)
    raw[0, 2] = 0
    depth = read_picture(compressed("32FC1; compressedDepth", raw, a, b), COMPRESSED, typestore(), "/d", 5).depth
    np.testing.assert_allclose(depth, [[0.5, 1.0, 0.0]], rtol=0.01)


@pytest.mark.parametrize(
    "payload", [b"", b"\0\1\0\0junk", compressed("16UC1; compressedDepth", np.zeros((2, 2), np.uint8))]
)
def test_damaged_pictures_are_value_errors(payload):
    with pytest.raises(ValueError, match=r"sensor_msgs/msg/CompressedImage|compressedDepth"):
        read_picture(payload, COMPRESSED, typestore(), "/d", 5)


def transform(parent, child, rotvec, p):
    x, y, z, w = Rotation.from_rotvec(rotvec).as_quat()
    return Message(
        header=Message(frame_id=parent),
        child_frame_id=child,
        transform=Message(rotation=Message(x=x, y=y, z=z, w=w), translation=Message(x=p[0], y=p[1], z=p[2])),
    )


def info(d=(), model="plumb_bob", focal=400.0):
    return Message(
        k=np.array([focal, 0, 320, 0, focal, 240, 0, 0, 1]),
        d=np.array(d),
        distortion_model=model,
        width=640,
        height=480,
    )


def streams():
    imu = Block(topic="/cam/imu", kind=Imu, t_ns=np.arange(5), columns={})
    picture = Pictures(kind=Image, t_ns=np.arange(5) * 33_333_333, load=lambda topic, i: None)
    return {"/cam/imu": imu}, {"/cam/color/image_raw": picture}


def rig_of(calibration):
    blocks, pictures = streams()
    frames = {"/cam/imu": "imu_frame", "/cam/color/image_raw": "color_optical"}
    return calibration.rig(blocks, pictures, frames)


def test_mounts_come_along_the_tree_of_static_transforms():
    calibration = BagCalibration(Notes(Path("a"), False))
    calibration.camera_info("/cam/color/camera_info", info())
    T = {}
    for child, rotvec, p in (("imu_frame", (0.1, 0, 0), (0, 0, 1)), ("color_optical", (0, -1.5, 0.2), (0.1, 0.2, 0.3))):
        calibration.transforms(Message(transforms=[transform("base", child, rotvec, p)]))
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
    calibration.camera_info("/cam/color/camera_info", info())
    loop = [
        transform("a", "color_optical", (0, 0, 0), (1, 0, 0)),
        transform("color_optical", "a", (0, 0, 0), (1, 0, 0)),
    ]
    calibration.transforms(Message(transforms=loop))
    camera = rig_of(calibration).cameras["/cam/color/image_raw"]
    np.testing.assert_array_equal(camera.mount.T_body_sensor, np.eye(4))
    assert "no mount in /tf_static" in calibration.assumed["/cam/color/image_raw"]


def test_distortions_that_have_no_form_are_told():
    for d, model, told in (
        ((0.1, 0.2, 0.001, 0.002, 0.0), "plumb_bob", False),
        ((0.1, 0.2, 0.001, 0.002, 0.3), "plumb_bob", True),
        ((0.1, 0.2, 0.3, 0.4), "equidistant", False),
        ((0.1,), "omni", True),
    ):
        notes = Notes(Path("a"), False)
        calibration = BagCalibration(notes)
        calibration.camera_info("/cam/color/camera_info", info(d, model))
        camera = rig_of(calibration).cameras["/cam/color/image_raw"]
        assert camera.distortion[0] == 0.1
        assert bool(notes.warnings) is told
        assert camera.distortion_model == ("equidistant" if model == "equidistant" else "radtan")


def test_a_camera_info_without_a_focal_length_is_none():
    notes = Notes(Path("a"), False)
    calibration = BagCalibration(notes)
    calibration.camera_info("/cam/color/camera_info", info(focal=0.0))
    assert not rig_of(calibration).cameras
    assert "not calibrated" in notes.warnings[0]
