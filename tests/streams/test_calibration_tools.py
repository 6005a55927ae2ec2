"""Calibration files of other tools: every key is used or named, and absurd values are refused."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import calibration_files as files
import cv2
import numpy as np
import pytest
from calibration_files import CENTRE, FOCAL, NOISE, RADTAN, SHIFT_S, SIZE, T_C1_C2, T_IMU_CAM, rigid

from benchmarks.foreign_files import FORMATS, HEIGHT, IMU_HZ, WIDTH, Walk
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.assumed_calibration import _check_distance
from stridetwin.streams.formats.opening import ImportOptions, open_any
from stridetwin.streams.kalibr import read_rig
from stridetwin.streams.lenses import to_rig_lens
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import Mount

WRITERS = {
    "kalibr": (files.write_kalibr, 2, True, SHIFT_S, ""),
    "openvins": (files.write_openvins, 2, True, SHIFT_S, "verbosity, max_clones"),
    "vins_fusion": (
        files.write_vins_fusion,
        2,
        False,
        SHIFT_S,
        "output_path, max_cnt, g_norm",
    ),
    "orb_slam3": (
        files.write_orb_slam3,
        2,
        True,
        0.0,
        "Camera.fps, Camera.RGB, Stereo.ThDepth, ORBextractor.nFeatures, Viewer.KeyFrameSize",
    ),
    "orb_slam3_old": (files.write_orb_slam3_old, 1, True, 0.0, ""),
    "basalt": (files.write_basalt, 2, True, SHIFT_S, ""),
}
"""Writer of each tool's file, number of cameras, whether it has the IMU's rate, time shift, and unused keys."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """A folder of EuRoC and a bag of one small walk."""
    folder, walk = tmp_path_factory.mktemp("foreign"), Walk()
    return {name: FORMATS[name](folder, walk) for name in ("euroc", "rosbag1")}


def read(path, **options):
    """The rig of a file, and the warnings about it."""
    said = []
    return read_rig(path, warn=said.append, needs_rates=False, **options), said


def check_first_camera(rig):
    """The first camera has the known lens and pose."""
    camera = next(iter(rig.cameras.values()))
    assert (camera.width, camera.height) == SIZE
    np.testing.assert_allclose(camera.intrinsics, (*FOCAL, *CENTRE))
    assert camera.distortion_model == "radtan"
    np.testing.assert_allclose(camera.distortion, RADTAN)
    np.testing.assert_allclose(camera.mount.T_body_sensor, T_IMU_CAM, atol=1e-7)


@pytest.mark.parametrize("tool", WRITERS)
def test_one_calibration_in_the_words_of_each_tool(tmp_path, tool):
    write, cameras, has_rate, shift, unused = WRITERS[tool]
    path = write(tmp_path)
    rig, said = read(path)
    check_first_camera(rig)
    assert len(rig.cameras) == cameras
    second = list(rig.cameras.values())[1:]
    for camera in second:
        np.testing.assert_allclose(camera.mount.T_body_sensor, T_IMU_CAM @ T_C1_C2, atol=1e-7)
    np.testing.assert_allclose([camera.timeshift_cam_imu_s for camera in rig.cameras.values()], shift)
    imu = rig.imu("/imu0")
    noise = ("gyroscope_noise_density", "gyroscope_random_walk")
    noise += ("accelerometer_noise_density", "accelerometer_random_walk")
    np.testing.assert_allclose([getattr(imu, name) for name in noise], NOISE)
    assert imu.rate_hz == (200.0 if has_rate else 0.0)
    assert said == ([f"{path}: keys that are not used: {unused}"] if unused else [])


def test_an_imu_without_a_rate_needs_one_where_no_stamps_give_it(tmp_path):
    with pytest.raises(StrideTwinError, match=r"config\.yaml: imu0\.update_rate: missing: expected the rate"):
        read_rig(files.write_vins_fusion(tmp_path), warn=lambda text: None)


def test_a_euroc_sensor_file(tmp_path):
    rig, said = read(files.write_euroc_sensor(tmp_path))
    check_first_camera(rig)
    assert not said


def test_the_output_of_rs_enumerate_devices(tmp_path):
    path = files.write_realsense_text(tmp_path)
    rig, said = read(path, sizes=[SIZE])
    check_first_camera(rig)
    assert len(said) == 1
    assert 'Intrinsic of "Depth" / 640x480, Intrinsic of "Color" / 640x480, Motion Intrinsic of "Gyro"' in said[0]
    with pytest.raises(StrideTwinError, match=r"of color: invalid '640 x 480, 752 x 480': expected one resolution;"):
        read(path)


def test_json_of_realsense(tmp_path):
    rig, said = read(files.write_realsense_json(tmp_path))
    check_first_camera(rig)
    assert said == [f"{tmp_path / 'rs.json'}: keys that are not used: serial"]


def test_ros_camera_info(tmp_path):
    K = [FOCAL[0], 0.0, CENTRE[0], 0.0, FOCAL[1], CENTRE[1], 0.0, 0.0, 1.0]
    (tmp_path / "ost.yaml").write_text(
        f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: narrow\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {K}\ndistortion_model: plumb_bob\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: {[*RADTAN, 0.0]}\n"
    )
    camera = read(tmp_path / "ost.yaml")[0].cameras["/cam0"]
    assert camera.intrinsics == (*FOCAL, *CENTRE)
    np.testing.assert_allclose(camera.distortion, RADTAN)


TO_CAMERA = ("T_cam_imu", "T_ci", "T_c_i", "T_CI", "T_cam_body", "cam_T_imu", "T_ItoC", "T_cam0_imu0", "T_CS")
TO_IMU = ("T_imu_cam", "T_ic", "T_i_c", "T_BS", "T_SC", "Tbc", "T_b_c1", "T_B_C", "body_T_cam0", "imu_T_cam", "T_C0toI")


@pytest.mark.parametrize("form", ["rows", "opencv", "flat", "three rows"])
@pytest.mark.parametrize("key", [*TO_CAMERA, *TO_IMU])
def test_spellings_of_the_transform_between_camera_and_imu(tmp_path, key, form):
    T = np.linalg.inv(T_IMU_CAM) if key in TO_CAMERA else T_IMU_CAM
    values = {
        "rows": "\n" + files.rows(T),
        "opencv": files.opencv_matrix(T, "    "),
        "flat": f"{T.ravel().tolist()}\n",
        "three rows": "\n" + files.rows(T[:3]),
    }
    path = tmp_path / "rig.yaml"
    path.write_text(f"%YAML:1.0\n---\n{files.kalibr_camera()}  {key}: {values[form]}{files.kalibr_imu()}")
    rig, said = read(path)
    check_first_camera(rig)
    assert not said


def test_two_directions_must_agree(tmp_path):
    path = tmp_path / "rig.yaml"
    both = files.kalibr_camera() + "  T_imu_cam:\n" + files.rows(T_IMU_CAM) + "  T_cam_imu:\n"
    path.write_text(both + files.rows(np.linalg.inv(T_IMU_CAM)) + files.kalibr_imu())
    check_first_camera(read(path)[0])
    path.write_text(both + files.rows(T_IMU_CAM) + files.kalibr_imu())
    with pytest.raises(StrideTwinError, match=r"cam0\.T_imu_cam: .*the inverse of the other direction"):
        read(path)
    path.write_text(files.kalibr_camera() + "  Tbc:\n" + files.rows(T_IMU_CAM) + "  T_BS:\n" + files.rows(T_IMU_CAM))
    with pytest.raises(StrideTwinError, match=r"cam0\.T_BS: .*expected T_imu_cam under one name alone"):
        read(path)


def test_transforms_between_cameras_and_between_imus(tmp_path):
    path = tmp_path / "rig.yaml"
    T_imu0_imu1 = rigid((0.0, 0.3, 0.0), (0.05, 0.0, 0.02))
    cameras = files.kalibr_camera() + "  T_imu_cam:\n" + files.rows(T_IMU_CAM)
    cameras += files.kalibr_camera("cam1") + "  T_cam0_cam1:\n" + files.rows(T_C1_C2)
    imus = files.kalibr_imu() + files.kalibr_imu("imu1") + "  T_i_b:\n" + files.rows(np.linalg.inv(T_imu0_imu1))
    path.write_text(cameras + imus)
    rig, said = read(path)
    pose = rig.cameras["/cam1/image_raw"].mount.T_body_sensor
    np.testing.assert_allclose(pose, T_IMU_CAM @ T_C1_C2, atol=1e-9)
    np.testing.assert_allclose(rig.imu("/imu1").mount.T_body_sensor, T_imu0_imu1, atol=1e-9)
    assert not said


def test_keys_that_are_not_used_are_named_in_one_line(tmp_path):
    path = tmp_path / "rig.yaml"
    scale = "  Tw:\n" + files.rows(np.diag([1.01, 1.0, 1.0]))
    text = files.kalibr_camera() + "  T_cam_imuu:\n" + files.rows(T_IMU_CAM) + "  gamma: 2.2\n"
    path.write_text(text + files.kalibr_imu() + scale + "  time_offset: 0.01\nlidar0:\n  rate: 10\n")
    with pytest.warns(UserWarning, match="keys that are not used") as issued:
        read_rig(path)
    unused = "cam0.T_cam_imuu, cam0.gamma, imu0.Tw, imu0.time_offset, lidar0"
    assert str(issued[0].message) == f"{path}: keys that are not used: {unused}"
    assert "cam0: no transform to the IMU" in str(issued[1].message)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("T_cam_imu", (30.2, 7.4, 16.0), r"cam0\.T_cam_imu: .*up to 1 m from its IMU, not 35 m; is it in mm\?"),
        ("T_cam_imu", (3.0, 0.7, 1.6), r"cam0\.T_cam_imu: .*not 3\.47 m; is it in cm or mm\?"),
        ("timeshift_cam_imu: 0.0042", "timeshift_cam_imu: -4.2", r"timeshift_cam_imu: invalid -4\.2: .*in ms\?"),
        ("timeshift_cam_imu: 0.0042", "timeshift_cam_imu: 4200000", r"timeshift_cam_imu: .*in ns, or the difference"),
        ("intrinsics: [458.654, 457.296, ", "intrinsics: [0.61, 0.61, ", r"cam0\.intrinsics: .*in mm, or in widths"),
        ("intrinsics: [458.654, 457.296, ", "intrinsics: [458.654, 45.7, ", r"cam0\.intrinsics: .*factor of 2"),
        ("367.215, 248.375]", "3672.15, 248.375]", r"cam0\.intrinsics: .*a centre in images of 752 x 480"),
        ("gyroscope_noise_density: 1.6968e-04", "gyroscope_noise_density: 0.9", r"noise_density: .*in °/s/√Hz\?"),
        ("gyroscope_noise_density: 1.6968e-04", "gyroscope_noise_density: 2.9e-9", r"noise_density: .*a variance\?"),
        (
            "accelerometer_noise_density: 2.0000e-03",
            "accelerometer_noise_density: 150",
            r"noise_density: .*in µg/√Hz\?",
        ),
        ("update_rate: 200.0", "update_rate: 0.005", r"imu0\.update_rate: .*is it a period in s\?"),
    ],
)
def test_values_that_nobody_wears_are_refused(tmp_path, old, new, says):
    path = files.write_kalibr(tmp_path)
    text = path.read_text().split("cam1:")
    if old == "T_cam_imu":
        new = files.rows(rigid((0.4, -1.1, 1.3), new))
        old = files.rows(np.linalg.inv(T_IMU_CAM))
    assert old in path.read_text()
    path.write_text("cam1:".join([text[0].replace(old, new), text[1].replace(old, new)]))
    with pytest.raises(StrideTwinError, match=says) as caught:
        read(path)
    assert all(len(line) < 400 for line in str(caught.value).splitlines())


@pytest.mark.parametrize(
    ("T", "says"),
    [
        (np.diag([1.0, 1.0, -1.0, 1.0]), r"mirrored \(left-handed\)"),
        (rigid((0.1, 0.2, 0.3), (0.1, 0.2, 0.3)).T, r"transposed\)\?"),
        (np.diag([1000.0, 1000.0, 1000.0, 1.0]), "scaled by 1000"),
        (np.diag([1.0, 0.9, 1.0, 1.0]), "off unit length"),
    ],
)
def test_what_is_wrong_with_a_transform_is_said(tmp_path, T, says):
    path = tmp_path / "rig.yaml"
    path.write_text(files.kalibr_camera() + "  Tbc:\n" + files.rows(T) + files.kalibr_imu())
    with pytest.raises(StrideTwinError, match=rf"cam0\.Tbc: .*a rigid transform: .*{says}") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_a_rotation_of_three_decimals_is_made_a_rotation(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(files.kalibr_camera() + "  T_imu_cam:\n" + files.rows(np.round(T_IMU_CAM, 3)) + files.kalibr_imu())
    pose = read(path)[0].cameras["/cam0/image_raw"].mount.T_body_sensor
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(pose, T_IMU_CAM, atol=1e-3)


@pytest.mark.parametrize("model", ["none", "None", "null", '""'])
def test_no_distortion(tmp_path, model):
    path = tmp_path / "rig.yaml"
    path.write_text(files.kalibr_camera(model=model, coefficients=()))
    rig, said = read(path)
    assert rig.cameras["/cam0/image_raw"].distortion == (0.0,) * 4
    assert not said


@pytest.mark.parametrize(
    ("lens", "intrinsics", "model", "coefficients", "worst"),
    [
        ("ds", (-0.172, 0.593, 260.0, 260.1, 376.0, 240.0), "none", (), 0.01),
        ("eucm", (0.571, 1.05, 300.0, 300.0, 376.0, 240.0), "none", (), 0.01),
        ("omni", (1.8476, 1150.0, 1150.0, 376.0, 240.0), "radtan", (-0.05, 0.2, 0.0, 0.0), 0.01),
        ("pinhole", (460.0, 460.0, 376.0, 240.0), "fov", (0.92,), 0.01),
        ("pinhole", (460.0, 460.0, 376.0, 240.0), "radtan", (-0.05, 0.06, 3e-4, 6e-4, -0.02), 1.0),
        ("pinhole", (460.0, 460.0, 376.0, 240.0), "equi", (0.01, -0.02, 0.03, -0.01), 0.0),
    ],
)
def test_lenses_of_kalibr(tmp_path, lens, intrinsics, model, coefficients, worst):
    path = tmp_path / "rig.yaml"
    path.write_text(files.kalibr_camera(lens=lens, intrinsics=intrinsics, model=model, coefficients=coefficients))
    rig, said = read(path)
    camera = rig.cameras["/cam0/image_raw"]
    angle = np.linspace(0.02, 0.5, 12)
    rays = np.column_stack((np.sin(angle) * 0.8, np.sin(angle) * 0.6, np.cos(angle)))
    expected = project(lens, intrinsics, model, coefficients, rays)
    K, d = camera.K, np.array(camera.distortion)
    if camera.distortion_model == "equidistant":
        seen = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), K, d)[0][:, 0]
    else:
        seen = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, d)[0][:, 0]
    np.testing.assert_allclose(seen, expected, atol=max(worst, 1e-6))
    assert bool(said) is (worst > 0.01)


def project(lens, intrinsics, model, coefficients, rays):
    """Pixels of unit rays by the definitions of the models."""
    *terms, fu, fv, pu, pv = intrinsics
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]])
    if model == "equi":
        return cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), K, np.array(coefficients))[0][:, 0]
    x_y, z = rays[:, :2], rays[:, 2]
    if lens == "omni":
        z = z + terms[0]
    elif lens == "eucm":
        z = terms[0] * np.sqrt(terms[1] * (x_y**2).sum(1) + z**2) + (1 - terms[0]) * z
    elif lens == "ds":
        z = terms[1] * np.sqrt((x_y**2).sum(1) + (terms[0] + z) ** 2) + (1 - terms[1]) * (terms[0] + z)
    plane = x_y / z[:, None]
    if model == "fov":
        r = np.linalg.norm(plane, axis=1, keepdims=True)
        plane = plane / r * np.arctan(2 * r * np.tan(coefficients[0] / 2)) / coefficients[0]
        coefficients = ()
    d = np.array(coefficients) if len(coefficients) else np.zeros(4)
    return cv2.projectPoints(np.column_stack((plane, np.ones(len(plane)))), np.zeros(3), np.zeros(3), K, d)[0][:, 0]


def test_lenses_that_cannot_be_represented(tmp_path):
    path = tmp_path / "rig.yaml"
    for lens, model, coefficients, says in (
        ("pinhole", "radtan", (0.1, 0.2), r"distortion_coeffs: .*4 or 5 or 8 .*coefficients of radtan"),
        ("pinhole", "none", (0.1, 0.2, 0, 0), r"distortion_coeffs: .*expected no coefficients"),
        (
            "pinhole",
            "radtan",
            (0.1, 0.2, 0, 0, 0, 0, 0, 0, 0.5, 0, 0, 0),
            r"distortion_coeffs: .*a lens that radtan or",
        ),
    ):
        path.write_text(files.kalibr_camera(lens=lens, model=model, coefficients=coefficients))
        with pytest.raises(StrideTwinError, match=says):
            read(path)
    assert (
        to_rig_lens("omni", (1.0, 400.0, 400.0, 320.0, 240.0), "equidistant", (0,) * 4, (640, 480)).error_px == np.inf
    )


def test_fisheyes_of_camodocal_and_orb_slam(tmp_path):
    k, centre = (0.01, -0.02, 0.03, -0.01), (300.0, 301.0, 376.0, 240.0)
    names = ("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0")
    numbers = "".join(f"   {name}: {value}\n" for name, value in zip(names, (*k, *centre), strict=True))
    (tmp_path / "a.yaml").write_text(files.camodocal("KANNALA_BRANDT", f"projection_parameters:\n{numbers}"))
    lens = zip(("k1", "k2", "k3", "k4", "fx", "fy", "cx", "cy"), (*k, *centre), strict=True)
    settings = "".join(f"Camera1.{name}: {value}\n" for name, value in lens)
    size = f"Camera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\n"
    (tmp_path / "b.yaml").write_text(f'%YAML:1.0\nCamera.type: "KannalaBrandt8"\n{settings}{size}')
    for name in ("a.yaml", "b.yaml"):
        camera = read(tmp_path / name)[0].cameras["/cam0"]
        assert (camera.intrinsics, camera.distortion_model, camera.distortion) == (centre, "equidistant", k)


@pytest.mark.parametrize(
    ("write", "old", "new", "says"),
    [
        (files.write_orb_slam3, "Camera1.fx: 458.654", "Camera1.fx: wide", r"Camera1\.fx: invalid 'wide': .*a number"),
        (files.write_orb_slam3, "Camera1.cy: 248.375", "", r"Camera1\.cy: missing: expected a number"),
        (files.write_orb_slam3, "rows: 4", "rows: 4\n  unit: mm", ""),
        (files.write_orb_slam3, "Camera.fps: 20", "LEFT.K: [1.0]", r"LEFT\.K: .*rectified"),
        (files.write_vins_fusion, "cam0_pinhole.yaml", "../other.yaml", r"cam0_calib: .*a file in the same folder"),
        (files.write_vins_fusion, "cam0_pinhole.yaml", "none.yaml", r"none\.yaml: cannot be read"),
        (files.write_openvins, "kalibr_imu_chain.yaml", "none.yaml", r"none\.yaml: cannot be read"),
        (files.write_basalt, "pinhole-radtan8", "spherical", r"intrinsics\[0\]\.camera_type: invalid 'spherical'"),
        (files.write_basalt, '"px": ', '"px": 1e3, "other": ', r"value0\.T_imu_cam\[0\]"),
        (files.write_orb_slam3, "IMU.NoiseAcc: 2.0000e-03", "IMU.NoiseAcc: 90", r"IMU\.NoiseAcc: .*in µg/√Hz\?"),
    ],
)
def test_errors_name_the_key_of_the_tool(tmp_path, write, old, new, says):
    path = write(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    if not says:
        check_first_camera(read(path)[0])
        return
    with pytest.raises(StrideTwinError, match=says):
        read(path)


def write_small_rig(path, key, T):
    """A calibration of the small images of the folders, with the pose of the camera under any key."""
    camera = files.kalibr_camera(intrinsics=(27.25, 27.25, 15.0, 11.0), coefficients=(0.0,) * 4)
    size = f"resolution: [{WIDTH}, {HEIGHT}]"
    camera = camera.replace(f"resolution: [{SIZE[0]}, {SIZE[1]}]", size)
    imu = files.kalibr_imu().replace("200.0", str(float(IMU_HZ)))
    path.write_text(f"%YAML:1.0\n\n{camera}  {key}: {T.tolist()}\n{imu}")
    return ImportOptions(rig=path)


def test_an_import_uses_openvins_transform_as_kalibrs(sources, tmp_path):
    by_key = [
        open_any(sources["euroc"], options=write_small_rig(tmp_path / "rig.yaml", key, T))
        for key, T in (("T_cam_imu", np.linalg.inv(T_IMU_CAM)), ("T_imu_cam", T_IMU_CAM))
    ]
    for recording in by_key:
        camera, imu = recording.rig.cameras["/head/color"], recording.rig.imu("/head/imu")
        T_imu_cam = np.linalg.inv(imu.mount.T_body_sensor) @ camera.mount.T_body_sensor
        np.testing.assert_allclose(T_imu_cam, T_IMU_CAM, atol=1e-9)


def test_an_import_names_unused_keys_and_refuses_millimetres(sources, tmp_path):
    options = write_small_rig(tmp_path / "rig.yaml", "T_imu_camera_guess", T_IMU_CAM)
    warnings = open_any(sources["euroc"], options=options).warnings
    assert f"{tmp_path / 'rig.yaml'}: keys that are not used: cam0.T_imu_camera_guess" in warnings
    T = T_IMU_CAM.copy()
    T[:3, 3] *= 1000
    with pytest.raises(StrideTwinError, match=r"rig\.yaml: cam0\.T_imu_cam: .*is it in mm\?"):
        open_any(sources["euroc"], options=write_small_rig(tmp_path / "rig.yaml", "T_imu_cam", T))


def test_an_identity_in_the_file_replaces_the_mount_of_the_source(sources, tmp_path):
    folder = tmp_path / "euroc"
    shutil.copytree(sources["euroc"], folder)
    (sensor,) = folder.rglob("cam0/sensor.yaml")
    sensor.write_text(sensor.read_text().replace("data: [1.0, 0, 0, 0,", "data: [1.0, 0, 0, 0.05,") + "gain: 3\n")
    for key, x in (("T_cam_imu", 0.0), ("comment", 0.05)):
        options = write_small_rig(tmp_path / "rig.yaml", key, np.eye(4))
        recording = open_any(folder, options=options)
        assert recording.rig.cameras["/head/color"].mount.T_body_sensor[0, 3] == pytest.approx(x)
    assert "cam0/sensor.yaml: keys that are not used: gain" in recording.warnings


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-16"])
def test_encodings_of_calibration_files(tmp_path, encoding):
    path = files.write_kalibr(tmp_path)
    path.write_bytes(("%YAML:1.0\r\n# 10°\r\n" + path.read_text().replace("\n", "\r\n")).encode(encoding))
    check_first_camera(read(path)[0])


def test_a_bag_that_says_that_its_camera_is_far_away_is_warned_of():
    imu = SimpleNamespace(topic="/imu", mount=Mount(body="head"))
    T = np.eye(4)
    T[0, 3] = 35.0
    camera = SimpleNamespace(topic="/camera", imu_topic="/imu", mount=Mount(body="head", T_body_sensor=T))
    notes = Notes(Path("bag"), lenient=False)
    _check_distance(camera, {"/imu": imu}, notes)
    assert notes.warnings == ["/camera: 35 m from /imu: expected up to 1 m; is it in mm?"]


@pytest.mark.parametrize("name", ["euroc", "rosbag1"])
def test_a_calibration_without_topics_finds_the_only_camera_and_imu(sources, tmp_path, name):
    gyro, gyro_walk, accel, accel_walk = NOISE
    lens = {"fx": 27.25, "fy": 27.25, "cx": 15.0, "cy": 11.0}
    value = {
        "T_imu_cam": [{"px": 0.01, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}],
        "intrinsics": [{"camera_type": "pinhole", "intrinsics": lens}],
        "resolution": [[WIDTH, HEIGHT]],
        "accel_noise_std": accel,
        "gyro_noise_std": gyro,
        "accel_bias_std": accel_walk,
        "gyro_bias_std": gyro_walk,
    }
    (tmp_path / "calibration.json").write_text(json.dumps({"value0": value}))
    known = open_any(sources[name])
    rig = open_any(sources[name], options=ImportOptions(rig=tmp_path / "calibration.json")).rig
    assert rig.cameras["/head/color"].intrinsics == (27.25, 27.25, 15.0, 11.0)
    assert rig.imu("/head/imu").gyroscope_noise_density == gyro
    assert rig.imu("/head/imu").rate_hz == pytest.approx(known.rig.imu("/head/imu").rate_hz)
