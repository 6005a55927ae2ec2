"""The rig file: round trips, plain Kalibr files, and errors that say where."""

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rigs import small_rig
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import read_rig, rig_from_yaml, rig_to_yaml, write_rig
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig

finite = st.floats(-1e3, 1e3)
positive = st.floats(1e-9, 1e3)
names = st.text("abcdefghijklmnopqrstuvwxyz_/0123456789", min_size=1, max_size=12)


@st.composite
def mounts(draw, body=names):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(draw(st.tuples(*[st.floats(-3, 3)] * 3))).as_matrix()
    T[:3, 3] = draw(st.tuples(finite, finite, finite))
    return Mount(body=draw(body), T_body_sensor=T)


@st.composite
def rigs(draw):
    topics = draw(st.lists(names, min_size=3, max_size=6, unique=True))
    noise = draw(st.tuples(*[positive] * 6))
    imu = ImuCalibration(
        topic=topics[0],
        part=draw(names),
        rate_hz=draw(positive),
        mount=draw(mounts(st.just("head"))),
        gyroscope_noise_density=noise[0],
        gyroscope_random_walk=noise[1],
        accelerometer_noise_density=noise[2],
        accelerometer_random_walk=noise[3],
        gyroscope_bias_sd=noise[4],
        accelerometer_bias_sd=noise[5],
    )
    camera = CameraCalibration(
        topic=topics[1],
        part=draw(names),
        rate_hz=draw(positive),
        mount=draw(mounts(st.just("head"))),
        width=draw(st.integers(1, 9999)),
        height=draw(st.integers(1, 9999)),
        intrinsics=draw(st.tuples(positive, positive, finite, finite)),
        distortion_model=draw(st.sampled_from(["radtan", "equidistant"])),
        distortion=draw(st.tuples(*[finite] * 4)),
        depth_topic=draw(st.sampled_from(["", "/d"])),
        imu_topic=draw(st.sampled_from(["", topics[0]])),
        timeshift_cam_imu_s=draw(finite),
        readout_s=draw(st.sampled_from([0.0, 0.016])),
    )
    others = {
        t: OtherSensor(
            topic=t,
            kind="insole",
            part=draw(names),
            rate_hz=draw(positive),
            mount=draw(mounts()),
            parameters={"sd": draw(finite), "cells": [draw(finite), draw(finite)]},
        )
        for t in topics[2:]
    }
    return Rig(imus={imu.topic: imu}, cameras={camera.topic: camera}, others=others)


def same(a, b):
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    return np.array_equal(a, b)


@pytest.mark.parametrize("number", ["9" * 400, "0x" + "9" * 9000], ids=["decimal", "hexadecimal"])
def test_numbers_of_hundreds_of_digits_are_errors_that_say_where(number):
    text = rig_to_yaml(small_rig())
    for valid, evil, where in (
        ("update_rate: 200.0", f"update_rate: {number}", r"imu0\.update_rate"),
        ("resolution: [32,", f"resolution: [{number},", r"cam0\.resolution\[0\]"),
    ):
        assert valid in text
        with pytest.raises(StrideTwinError, match=where) as caught:
            rig_from_yaml(text.replace(valid, evil), "rig")
        assert len(str(caught.value)) < 1000


@given(rigs())
def test_round_trip_is_exact(rig):
    assert same(rig, rig_from_yaml(rig_to_yaml(rig), "text"))


def test_file_round_trip_with_board(tmp_path):
    write_rig(small_rig(), tmp_path / "rig.yaml")
    assert same(small_rig(), read_rig(tmp_path / "rig.yaml"))
    assert [p.name for p in tmp_path.iterdir()] == ["rig.yaml"]


def change(path, value):
    document = yaml.safe_load(rig_to_yaml(small_rig()))
    *parents, last = path
    node = document
    for key in parents:
        node = node[key]
    if value is None:
        del node[last]
    else:
        node[last] = value
    return yaml.safe_dump(document)


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("cam0", "camera_model"), "spherical", "cam0.camera_model: invalid 'spherical': expected pinhole, omni"),
        (
            ("cam0", "intrinsics"),
            [1, 2, 3],
            "cam0.intrinsics: .*expected a list of four items: a number above 0, a number above 0",
        ),
        (("cam0", "intrinsics"), [-1, 2, 3, 4], r"cam0.intrinsics\[0\]: invalid -1: expected a number above 0"),
        (("cam0", "resolution"), [640.5, 480], r"cam0.resolution\[0\]: invalid 640.5: expected a whole number"),
        (("cam0", "distortion_model"), "lut", "cam0.distortion_model: invalid .lut.: expected radtan, equidistant"),
        (("cam0", "T_cam_imu"), [[0] * 4] * 4, "cam0.T_cam_imu: .*rigid transform"),
        (("cam0", "T_cam_imu"), np.eye(4).tolist(), "cam0.T_cam_imu: .*stridetwin.cam0.mount.T_body_sensor"),
        (("imu0", "update_rate"), 0, "imu0.update_rate: invalid 0: .*above 0"),
        (("imu0", "gyroscope_noise_density"), "lots", "imu0.gyroscope_noise_density: invalid 'lots': .*a number"),
        (("imu0", "gyroscope_random_walk"), None, "imu0.gyroscope_random_walk: missing: expected a number"),
        (("stridetwin", "cam0", "imu_topic"), "/x", "stridetwin.cam0.imu_topic: invalid '/x': .*/head/imu"),
        (("stridetwin", "sensors", 0, "kind"), "radar", r"sensors\[0\].kind: invalid 'radar': expected range, insole"),
        (("stridetwin", "sensors", 0, "colour"), "red", r"sensors\[0\]: invalid 'colour': expected keys topic"),
        (
            ("stridetwin", "boards", "foot_l", "squares"),
            [6, 1],
            r"boards.foot_l.squares\[1\]: invalid 1: expected a whole number, 2-",
        ),
    ],
)
def test_errors_name_file_key_value_and_what_is_valid(path, value, says):
    with pytest.raises(StrideTwinError, match=rf"rig\.yaml: (stridetwin\.)?{says}") as caught:
        rig_from_yaml(change(path, value), "rig.yaml")
    assert "\n" not in str(caught.value)


def test_mount_may_be_left_to_T_cam_imu():
    rig = rig_from_yaml(change(("stridetwin", "cam0", "mount", "T_body_sensor"), None), "rig.yaml")
    expected = small_rig().cameras["/head/color"].mount.T_body_sensor
    np.testing.assert_allclose(rig.cameras["/head/color"].mount.T_body_sensor, expected, atol=1e-12)


def test_plain_kalibr_files(tmp_path):
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    T10 = np.eye(4)
    T10[0, 3] = -0.11
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [400.0, 400.0, 320.0, 240.0],
        "distortion_model": "radtan",
        "distortion_coeffs": [0.0, 0.0, 0.0, 0.0],
        "resolution": [640, 480],
    }
    chain = {
        "cam0": camera | {"T_cam_imu": T.tolist(), "rostopic": "/cam0/image_raw", "cam_overlaps": [1]},
        "cam1": camera | {"T_cn_cnm1": T10.tolist(), "rostopic": "/cam1/image_raw"},
    }
    imu = "rostopic: /imu0\nupdate_rate: 200.0\n"
    imu += "accelerometer_noise_density: 1e-2\naccelerometer_random_walk: 2e-4\n"
    imu += "gyroscope_noise_density: 1.0e-03\ngyroscope_random_walk: 2.0e-05\n"
    (tmp_path / "camchain-imucam.yaml").write_text(yaml.safe_dump(chain))
    (tmp_path / "imu.yaml").write_text(imu)
    rig = read_rig(tmp_path / "camchain-imucam.yaml", tmp_path / "imu.yaml")
    assert rig.imus["/imu0"].accelerometer_noise_density == 0.01
    np.testing.assert_allclose(rig.cameras["/cam0/image_raw"].mount.T_body_sensor, np.linalg.inv(T))
    np.testing.assert_allclose(rig.cameras["/cam1/image_raw"].mount.T_body_sensor, np.linalg.inv(T10 @ T))
    assert read_rig(tmp_path / "imu.yaml").imu("/imu0").rate_hz == 200


@pytest.mark.parametrize("text", ["a: [1", "- 1", "hello", "", "x: 1"])
def test_what_is_no_calibration(text):
    with pytest.raises(StrideTwinError, match=r"rig\.yaml"):
        rig_from_yaml(text, "rig.yaml")


def test_all_errors_of_a_file_are_reported_at_once():
    document = yaml.safe_load(rig_to_yaml(small_rig()))
    document["cam0"]["camera_model"] = "spherical"
    del document["imu0"]["update_rate"]
    document["stridetwin"]["sensors"][0]["kind"] = "radar"
    with pytest.raises(StrideTwinError) as caught:
        rig_from_yaml(yaml.safe_dump(document), "rig.yaml")
    places = ("cam0.camera_model", "imu0.update_rate", "stridetwin.sensors[0].kind")
    assert [line.split(": ")[:2] for line in str(caught.value).splitlines()] == [
        ["rig.yaml", place] for place in places
    ]
