"""Folders of OpenLORIS-Scene: images, the IMU in two files, OpenCV's calibration files, and the robot's true path."""

import shutil

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.opening import ImportOptions, open_any, recognise
from stridetwin.streams.samples import Accelerometer

WIDTH, HEIGHT = 64, 48
STAMPS = 1_560_000_000 + np.arange(8) / 10
RATE_T, FORCE_T = STAMPS[0] + np.arange(0, 0.7, 0.0025), STAMPS[0] + np.arange(0, 0.7, 0.004)
DEPTH_MM = np.random.default_rng(1).integers(500, 3000, (HEIGHT, WIDTH)).astype(np.uint16)
RATES = np.random.default_rng(2).normal(0, 0.01, (len(RATE_T), 3))
FORCES = np.random.default_rng(3).normal([0, -9.81, 0], 0.05, (len(FORCE_T), 3))


def transform(rotvec, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), p
    return T


T_BASE_COLOR = transform([0.5, -1.0, 0.7], [0.2, 0.0, 1.0])
T_COLOR_IMU = transform([0.1, 0.0, -0.1], [0.02, 0.005, 0.01])


def opencv_matrix(values, columns, indent):
    data = ", ".join(f"{v:.12g}" for v in np.ravel(values))
    gap = " " * indent
    lines = [f"rows: {np.size(values) // columns}", f"cols: {columns}", "dt: d", f"data: [ {data} ]"]
    return "!!opencv-matrix\n" + "".join(f"{gap}{line}\n" for line in lines)


def write_table(file, t, values):
    rows = [f"{s:.8f} " + " ".join(f"{v:.9g}" for v in row) for s, row in zip(t, values)]
    file.write_text("\n".join(["#Time x y z", *rows]) + "\n")


def write_folder(root, device="d400"):
    for name, pixels in (("color", np.full((HEIGHT, WIDTH, 3), 90, np.uint8)), ("aligned_depth", DEPTH_MM)):
        (root / name).mkdir(parents=True)
        files = [f"{name}/{t:.6f}.png" for t in STAMPS]
        for file in files:
            cv2.imwrite(str(root / file), pixels)
        rows = [f"{t:.6f} {file}" for t, file in zip(STAMPS, files)]
        (root / f"{name}.txt").write_text("\n".join(rows) + "\n")
    (root / "depth.txt").write_text(f"{STAMPS[0]:.6f} depth/{STAMPS[0]:.6f}.png\n")  # of the depth camera's own view
    (root / "odom.txt").write_text("# not read\n")
    write_table(root / f"{device}_gyroscope.txt", RATE_T, RATES)
    write_table(root / f"{device}_accelerometer.txt", FORCE_T, FORCES)
    (root / "sensors.yaml").write_text(
        "%YAML:1.0\n---\nd400_color_optical_frame:\n   sensor_type: camera\n"
        f"   width: {WIDTH}\n   height: {HEIGHT}\n   fps: 10\n   model: pinhole\n   intrinsics: "
        f"{opencv_matrix([50.0, 31.0, 51.0, 23.0], 4, 6)}"
        "   distortion_model: radial-tangential\n   distortion_coefficients: "
        f"{opencv_matrix([0.1, -0.2, 0.001, 0.002, 0.0], 5, 6)}"
        f"{device}_gyroscope:\n   imu_intrinsic: {opencv_matrix(np.eye(3, 4), 4, 6)}"
    )
    entries = (("base_link", "d400_color_optical_frame", T_BASE_COLOR),)
    entries += (("d400_color_optical_frame", f"{device}_gyroscope", T_COLOR_IMU),)
    (root / "trans_matrix.yaml").write_text(
        "%YAML:1.0\ntrans_matrix:\n"
        + "".join(
            f"   - parent_frame: {parent}\n     child_frame: {child}\n     matrix: {opencv_matrix(T, 4, 7)}"
            for parent, child, T in entries
        )
    )
    base = np.column_stack((0.1 * np.arange(8), np.zeros((8, 2)), np.zeros((8, 3)), np.ones(8)))
    rows = [f"{t:.6f} " + " ".join(map(repr, row)) for t, row in zip(STAMPS, base.tolist())]
    (root / "groundtruth.txt").write_text("#Time px py pz qx qy qz qw\n" + "\n".join(rows) + "\n")
    return root


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("openloris") / "home1-1")


def test_a_folder_with_calibration(folder):
    assert recognise(folder) == "openloris"
    recording = open_any(folder)
    assert set(recording.topics) == {"/head/color", "/head/depth", "/head/imu", "/truth/head/imu/odometry"}
    imu = recording.block("/head/imu")
    assert len(imu) == np.searchsorted(RATE_T, FORCE_T[-1] + 1e-6)
    np.testing.assert_allclose(imu.columns["angular_rate"], RATES[: len(imu)], atol=1e-8)
    np.testing.assert_allclose(recording.images("/head/depth", [0])[0].depth, DEPTH_MM / 1000, atol=1e-6)
    camera = recording.rig.cameras["/head/color"]
    assert camera.intrinsics == (50.0, 51.0, 31.0, 23.0)  # the file has fx cx fy cy
    assert camera.distortion == (0.1, -0.2, 0.001, 0.002)
    assert (camera.depth_topic, camera.imu_topic) == ("/head/depth", "/head/imu")
    np.testing.assert_allclose(camera.mount.T_body_sensor, np.linalg.inv(T_COLOR_IMU), atol=1e-9)
    truth = recording.block("/truth/head/imu/odometry").columns
    T = T_BASE_COLOR @ T_COLOR_IMU
    np.testing.assert_allclose(truth["p_frame_in_world"], T[:3, 3] + np.outer(0.1 * np.arange(8), [1, 0, 0]), atol=1e-9)
    R = Rotation.from_quat(truth["q_world_frame"][3], scalar_first=True).as_matrix()
    np.testing.assert_allclose(R, T[:3, :3], atol=1e-9)
    assert set(recording.unread) == {"/depth", "/odom"}
    assert any("d400_gyroscope: imu_intrinsic" in w for w in recording.warnings)


def test_a_folder_without_calibration(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "a")
    for name in ("sensors.yaml", "trans_matrix.yaml", "aligned_depth.txt", "depth.txt"):
        (tmp_path / "a" / name).unlink()
    recording = open_any(tmp_path / "a")
    assert set(recording.topics) == {"/head/color", "/head/imu"}
    assert any("groundtruth.txt is not read: its poses are those of base_link" in w for w in recording.warnings)


def test_the_imu_of_the_other_device(tmp_path):
    recording = open_any(write_folder(tmp_path / "a", "t265"))
    camera = recording.rig.cameras["/head/color"]
    np.testing.assert_allclose(camera.mount.T_body_sensor, np.linalg.inv(T_COLOR_IMU), atol=1e-9)


def test_forces_and_rates_that_do_not_overlap(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "a")
    write_table(tmp_path / "a" / "d400_gyroscope.txt", RATE_T + 1000, RATES)
    with pytest.raises(StrideTwinError, match=r"d400_gyroscope\.txt: stamps from .* those of .*do not overlap"):
        open_any(tmp_path / "a")
    assert open_any(tmp_path / "a", lenient=True).topics["/head/accelerometer"].kind is Accelerometer


def test_options_count(folder):
    options = ImportOptions(names={"/head/imu": "/chest/imu"}, depth_scale=2000.0)
    recording = open_any(folder, options=options)
    np.testing.assert_allclose(recording.images("/head/depth", [0])[0].depth, DEPTH_MM / 2000, atol=1e-6)
    assert "/chest/imu" in recording.topics


def test_intrinsics_in_the_usual_order(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "a")
    text = f"d400_color_optical_frame: {{width: {WIDTH}, height: {HEIGHT}, intrinsics: [50, 51, 31, 23]}}\n"
    (tmp_path / "a" / "sensors.yaml").write_text(text)
    assert open_any(tmp_path / "a").rig.cameras["/head/color"].intrinsics == (50.0, 51.0, 31.0, 23.0)


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("sensors.yaml", "d400_color_optical_frame: {width: 0}", "d400_color_optical_frame: .*width: invalid 0"),
        ("sensors.yaml", "[1, 2]", r"sensors\.yaml: invalid"),
        ("trans_matrix.yaml", "trans_matrix: 3", r"trans_matrix\.yaml: trans_matrix: invalid 3"),
        ("trans_matrix.yaml", "a: [", r"trans_matrix\.yaml: .*not YAML|trans_matrix\.yaml: line"),
    ],
)
def test_invalid_calibration_files(folder, tmp_path, file, text, says):
    shutil.copytree(folder, tmp_path / "a")
    (tmp_path / "a" / file).write_text(text)
    with pytest.raises(StrideTwinError, match=says):
        open_any(tmp_path / "a")
