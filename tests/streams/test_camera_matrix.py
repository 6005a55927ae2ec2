"""Calibrations of OpenCV, ROS messages, MATLAB and Open3D, transforms in parts, and files that are no calibration."""

from __future__ import annotations

import json

import numpy as np
import pytest
from calibration_files import (
    CENTRE,
    FOCAL,
    RADTAN,
    SIZE,
    T_IMU_CAM,
    camodocal,
    kalibr_camera,
    kalibr_imu,
    opencv_matrix,
    rows,
)
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import read_rig

K = [[FOCAL[0], 0.0, CENTRE[0]], [0.0, FOCAL[1], CENTRE[1]], [0.0, 0.0, 1.0]]
FLAT = [value for row in K for value in row]
BY_COLUMNS = np.array(K).T.ravel().tolist()
XML = (
    '<?xml version="1.0"?>\n<opencv_storage>\n<calibration_time>"Wed 01 Jan"</calibration_time>\n'
    "<image_width>752</image_width>\n<image_height>480</image_height>\n"
    '<camera_matrix type_id="opencv-matrix">\n  <rows>3</rows>\n  <cols>3</cols>\n  <dt>d</dt>\n  <data>\n'
    f"{' '.join(f'{value:.16e}' for value in FLAT)}</data></camera_matrix>\n"
    '<distortion_coefficients type_id="opencv-matrix">\n  <rows>5</rows>\n  <cols>1</cols>\n  <dt>d</dt>\n  <data>\n'
    f"{' '.join(map(str, RADTAN))} 0.</data></distortion_coefficients>\n</opencv_storage>\n"
)


def message(width=752, height=480, binning=0, roi=(0, 0, 0, 0), upper=True):
    """A CameraInfo as `rostopic echo` (upper case) or `ros2 topic echo` prints it."""
    names = ("D", "K", "R", "P") if upper else ("d", "k", "r", "p")
    values = ([*RADTAN, 0.0], FLAT, np.eye(3).ravel().tolist(), [*FLAT[:3], 0.0, *FLAT[3:6], 0.0, 0.0, 0.0, 1.0, 0.0])
    matrices = "".join(f"{name}: {value}\n" for name, value in zip(names, values, strict=True))
    x, y, w, h = roi
    return (
        f'header: \n  seq: 0\n  frame_id: "camera"\nheight: {height}\nwidth: {width}\ndistortion_model: "plumb_bob"\n'
        f"{matrices}binning_x: {binning}\nbinning_y: {binning}\nroi: \n  x_offset: {x}\n  y_offset: {y}\n"
        f"  height: {h}\n  width: {w}\n  do_rectify: False\n---\n"
    )


MATLAB = {
    "FocalLength": FOCAL,
    "PrincipalPoint": [CENTRE[0] + 1, CENTRE[1] + 1],
    "ImageSize": [SIZE[1], SIZE[0]],
    "RadialDistortion": RADTAN[:2],
    "TangentialDistortion": RADTAN[2:],
    "IntrinsicMatrix": np.array(K).T.tolist(),
}
CAMERAS = {
    "opencv.xml": XML,
    "python.yaml": f"camera_matrix: {K}\ndist_coeff: [{[*RADTAN, 0.0]}]\n",
    "letters.json": json.dumps({"K": K, "D": RADTAN, "image_size": SIZE}),
    "echo.yaml": message(),
    "echo2.yaml": message(upper=False) + message(upper=False),
    "matlab.json": json.dumps(MATLAB),
    "open3d.json": json.dumps({"width": 752, "height": 480, "intrinsic_matrix": BY_COLUMNS, "distortion": RADTAN}),
    "flat.yaml": "".join(
        f"{key}: {value}\n"
        for key, value in zip(
            ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "width", "height"),
            (*FOCAL, *CENTRE, *RADTAN, *SIZE),
            strict=True,
        )
    ),
    "orb_slam2.yaml": "%YAML:1.0\n"
    + "".join(
        f"Camera.{key}: {value}\n"
        for key, value in zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"), (*FOCAL, *CENTRE, *RADTAN), strict=True)
    ),
}


def read(tmp_path, text, name="camera.yaml", sizes=(SIZE,)):
    """The only camera of a file, and the warnings."""
    (tmp_path / name).write_text(text)
    warnings = []
    rig = read_rig(tmp_path / name, warn=warnings.append, sizes=sizes, needs_rates=False)
    return next(iter(rig.cameras.values())), warnings


@pytest.mark.parametrize("name", CAMERAS)
def test_one_camera_in_the_words_of_each_tool(tmp_path, name):
    camera, _ = read(tmp_path, CAMERAS[name], name)
    assert (camera.width, camera.height, camera.distortion_model) == (*SIZE, "radtan")
    assert camera.intrinsics == pytest.approx((*FOCAL, *CENTRE))
    assert camera.distortion == pytest.approx(RADTAN)


def test_a_file_without_a_size_needs_images(tmp_path):
    _, warnings = read(tmp_path, CAMERAS["python.yaml"])
    assert "that of the recording's is taken, [752, 480]" in warnings[-1]
    with pytest.raises(StrideTwinError, match=r"image_width, image_height: missing"):
        read(tmp_path, CAMERAS["python.yaml"], sizes=())
    with pytest.raises(StrideTwinError, match=r"Camera\.width, Camera\.height: missing"):
        read(tmp_path, CAMERAS["orb_slam2.yaml"], sizes=(SIZE, (640, 480)))


def test_binning_and_a_part_of_the_sensor(tmp_path):
    camera, _ = read(tmp_path, message(binning=2, roi=(100, 60, 400, 300)), sizes=((200, 150),))
    assert (camera.width, camera.height) == (200, 150)
    assert camera.intrinsics == pytest.approx((FOCAL[0] / 2, FOCAL[1] / 2, (CENTRE[0] - 100) / 2, (CENTRE[1] - 60) / 2))
    whole, _ = read(tmp_path, message(binning=2))  # the images are whole all the same
    assert whole.intrinsics == pytest.approx((*FOCAL, *CENTRE))


P, R = T_IMU_CAM[:3, 3].tolist(), T_IMU_CAM[:3, :3].tolist()
Q = dict(zip("xyzw", Rotation.from_matrix(R).as_quat().tolist(), strict=True))


@pytest.mark.parametrize(
    "keys",
    [
        f"  T_imu_cam: {{translation: {dict(zip('xyz', P, strict=True))}, rotation: {Q}}}\n",
        f"  T_imu_cam: {{R: {R}, t: {P}}}\n",
        f"  R_imu_cam: {R}\n  t_imu_cam: {P}\n",
        f"  t_imu_cam: {T_IMU_CAM.tolist()}\n",
        f"  R_cam_imu: {np.transpose(R).tolist()}\n  p_cam_imu: {(-np.transpose(R) @ P).tolist()}\n",
    ],
)
def test_transforms_in_parts(tmp_path, keys):
    camera, _ = read(tmp_path, kalibr_camera() + keys.replace("'", "") + kalibr_imu())
    np.testing.assert_allclose(camera.mount.T_body_sensor, T_IMU_CAM, atol=1e-9)


def test_the_other_names_of_vins(tmp_path):
    (tmp_path / "cam0.yaml").write_text(camodocal())
    head = '%YAML:1.0\nimu: 0\ncam0_calib: "cam0.yaml"\n'
    for key, T in (("imu_T_cam0", T_IMU_CAM), ("cam0_T_body", np.linalg.inv(T_IMU_CAM))):
        camera, _ = read(tmp_path, f"{head}{key}: {opencv_matrix(T)}", "vins.yaml")
        np.testing.assert_allclose(camera.mount.T_body_sensor, T_IMU_CAM, atol=1e-9)
    unknown = f"{head}estimate_extrinsic: 2\nestimate_td: 1\nbody_T_cam0: {opencv_matrix(T_IMU_CAM)}"
    camera, warnings = read(tmp_path, unknown, "vins.yaml")
    np.testing.assert_array_equal(camera.mount.T_body_sensor, np.eye(4))
    assert "the transform to the IMU is not known: it is not used" in warnings[0]
    assert "estimate_td" in warnings[1]


PLAIN = kalibr_camera() + f"  T_imu_cam:\n{rows(T_IMU_CAM)}" + kalibr_imu()


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        (
            "results.txt",
            "Calibration results\n====\nNormalized Residuals\n---\nT_ci:  (imu0\n",
            "Kalibr's report.*camchain",
        ),
        ("report.pdf", "%PDF-1.4\n", "a PDF.*camchain-imucam"),
        ("d435i.txt", "Device info: \n  Name : x\nStream Profiles supported by RGB\n", "rs-enumerate-devices -c"),
        ("Calib_Results.m", "% Intrinsic\nfc = [ 657.3 ; 657.7 ];\n", "other text than YAML or JSON.*MATLAB"),
        ("april.yaml", "target_type: aprilgrid\ntagCols: 6\n", "keys target_type, tagCols"),
        ("rig.yaml", PLAIN + "---\n" + PLAIN, "several documents.*one document"),
        (
            "rig.yaml",
            PLAIN.replace("458.654, 457.296, 367.215", "458.654, 367.215, 457.296"),
            "look like fu, pu, fv, pv",
        ),
        ("rig.yaml", kalibr_camera() + f"  T_imu_cam: {[*P, *Q.values()]}\n", "keys px, py, pz, qx, qy, qz, qw"),
        ("rig.yaml", kalibr_camera() + f"  T_imu_cam: {R}\n", "expected a translation as well: four rows"),
        ("rig.xml", '<?xml version="1.0"?><opencv_storage><!ENTITY a "b"></opencv_storage>', "declarations in XML"),
        ("rig.xml", '<?xml version="1.0"?><opencv_storage><a></opencv_storage>', "not XML"),
    ],
)
def test_what_is_no_calibration_says_what_to_give(tmp_path, name, text, says):
    with pytest.raises(StrideTwinError, match=says) as error:
        read(tmp_path, text, name)
    assert "\n" not in str(error.value)


def test_a_folder_is_no_calibration(tmp_path):
    (tmp_path / "imu.yaml").write_text("")
    with pytest.raises(StrideTwinError, match=r"a folder': expected a calibration file; those inside: imu\.yaml"):
        read_rig(tmp_path)


def test_a_neighbour_of_an_impossible_name_is_an_error_in_one_line(tmp_path):
    with pytest.raises(StrideTwinError, match="cannot be read"):
        read(tmp_path, f'%YAML:1.0\nrelative_config_imu: "{"a" * 300}.yaml"\n')
