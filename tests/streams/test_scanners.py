"""Scans of iPhones and recordings of Aria glasses: images, IMU and path in our frames, units and topics."""

from __future__ import annotations

import json
import sys
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest
from scan_files import (
    DEPTH_MM,
    FRAMES,
    GREY,
    HEIGHT,
    R_WORLD_OPTICAL,
    RATE_HZ,
    SMALL,
    WIDTH,
    K,
    P,
    T,
    record3d,
    stray_scanner,
)
from scipy.spatial.transform import Rotation

from stridetwin.cli.main import main
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.opening import open_any, recognise
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2 as G


def check_path(recording):
    path = recording.block("/head/color/odometry").columns
    np.testing.assert_allclose(path["p_frame_in_world"], P[:, [0, 2, 1]] * [1, -1, 1], atol=1e-9)
    R = Rotation.from_quat(path["q_world_frame"], scalar_first=True)
    np.testing.assert_allclose((R_WORLD_OPTICAL.inv() * R).magnitude(), 0, atol=1e-6)
    np.testing.assert_allclose(path["v_frame_in_world"][1:-1], [[0.1 * RATE_HZ, 0, 0]] * (FRAMES - 2), atol=1e-3)


def test_stray_scanner(tmp_path):
    recording = open_any(stray_scanner(tmp_path))
    assert recognise(tmp_path) == "strayscanner"
    check_path(recording)
    np.testing.assert_allclose([d.depth for d in recording.images("/head/depth")], DEPTH_MM / 1000, atol=1e-6)
    colour = {i: image.pixels for i, image in zip((7, 2), recording.images("/head/color", [7, 2]))}
    for i, pixels in colour.items():
        assert pixels.shape == (HEIGHT, WIDTH, 3)
        assert abs(float(pixels.mean()) - GREY[i]) < 3
    imu = recording.block("/head/imu").columns
    np.testing.assert_allclose(imu["specific_force"], [[-G, 0, 0]] * 40)
    np.testing.assert_allclose(imu["angular_rate"], [[0.1, 0.2, 0.3]] * 40)
    camera, depth = recording.rig.cameras["/head/color"], recording.rig.cameras["/head/depth"]
    assert camera.intrinsics == K
    np.testing.assert_allclose(depth.intrinsics, (12.5, 12.75, (31 + 0.5) / 4 - 0.5, (23.5 + 0.5) / 4 - 0.5))
    assert (depth.width, depth.height, depth.depth_topic) == (*SMALL, "/head/depth")
    # in the camera, whose y axis points down, the force points up
    force = camera.mount.T_body_sensor[:3, :3].T @ imu["specific_force"][0]
    np.testing.assert_allclose(force, [0, G, 0], atol=1e-9)


def test_stray_scanner_without_some_of_its_files(tmp_path):
    stray_scanner(tmp_path, imu=False, video=False)
    (tmp_path / "depth" / "000004.png").unlink()
    recording = open_any(tmp_path)
    assert set(recording.topics) == {"/head/depth", "/head/depth/odometry"}
    assert recording.topics["/head/depth"].count == FRAMES - 1
    assert (
        "depth: 1 of 12 images are listed and missing, the first of them 000004.png; they are left out"
        in recording.warnings
    )
    (tmp_path / "camera_matrix.csv").write_text("1,2\n3,4\n")
    with pytest.raises(StrideTwinError, match=r"camera_matrix\.csv: matrix: .*fx 0 cx"):
        open_any(tmp_path)


def test_a_video_with_fewer_frames_than_listed(tmp_path):
    stray_scanner(tmp_path)
    odometry = (tmp_path / "odometry.csv").read_text()
    last = odometry.splitlines()[-1].replace(f"{T[-1]:.6f}", f"{T[-1] + 1 / RATE_HZ:.6f}")
    (tmp_path / "odometry.csv").write_text(odometry + last + "\n")
    recording = open_any(tmp_path)
    with pytest.raises(StrideTwinError, match=r"rgb\.mp4: frames: invalid 12: expected at least 13, as listed"):
        recording.images("/head/color", [FRAMES])


@pytest.mark.parametrize("compressed", [False, True])
def test_record3d(tmp_path, compressed):
    compress = pytest.importorskip("lzfse").compress if compressed else bytes
    recording = open_any(record3d(tmp_path, compress))
    assert recognise(tmp_path) == "record3d"
    check_path(recording)
    expected = DEPTH_MM[5] / 1000
    expected[0, 0] = 0
    np.testing.assert_allclose(recording.images("/head/depth", [5])[0].depth, expected, atol=1e-6)
    assert abs(float(recording.images("/head/color", [5])[0].pixels.mean()) - GREY[5]) < 3
    assert recording.rig.cameras["/head/color"].intrinsics == K
    assert recording.rig.cameras["/head/depth"].width == SMALL[0]


def test_compressed_depth_without_its_package_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "lzfse", None)
    record3d(tmp_path, lambda data: b"bvx2" + data[:-4])
    with pytest.raises(StrideTwinError, match=r"lzfse is not installed; .*0\.depth: .*pip install '\.\[record3d\]'"):
        open_any(tmp_path)


def test_the_map_takes_the_scanner_s_own_poses(tmp_path, capsys):
    (folder := tmp_path / "scan").mkdir()
    stray_scanner(folder, imu=False, video=False)
    for file in (folder / "depth").iterdir():  # the floor, 1.4 m below
        cv2.imwrite(str(file), np.full((120, 160), 1400, np.uint16))
    down = ", ".join(map(str, Rotation.from_euler("x", 90, degrees=True).as_quat()))
    rows = [f"{t:.6f}, {i:06d}, 0.0, 1.4, 0.0, {down}" for i, t in enumerate(T)]
    (folder / "odometry.csv").write_text("\n".join(["timestamp, frame, x, y, z, qx, qy, qz, qw", *rows]) + "\n")
    out = tmp_path / "map.json"
    assert main(["estimate", "terrain_map", str(folder), "-o", str(out), "--json"]) == 0
    planes = json.loads(out.read_text())["planes"]
    assert max(planes, key=lambda plane: plane["area_m2"])["centre_m"][2] == pytest.approx(0.0, abs=0.02)
    assert json.loads(capsys.readouterr().out)["poses"].startswith(
        "recorded poses of /head/depth/odometry, no level"
    )  # a look straight down
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(out)]) == 2
    assert "/head/depth/odometry is an estimate; leave out --poses truth" in capsys.readouterr().err


class Provider:
    """Stands in for the provider of `projectaria_tools`."""

    labels = ("imu-right", "camera-rgb", "mic")

    def get_stream_id_from_label(self, label):
        return label if label in self.labels else None

    def get_label_from_stream_id(self, stream):
        return stream

    def get_all_streams(self):
        return list(self.labels)

    def get_num_data(self, stream):
        return 40 if stream == "imu-right" else 3

    def get_imu_data_by_index(self, stream, i):
        return SimpleNamespace(
            capture_timestamp_ns=10**9 + i * 10**6, gyro_radsec=[0.1, 0.2, 0.3], accel_msec2=[0, G, 0]
        )

    def get_timestamps_ns(self, stream, domain):
        assert domain == "device"
        return [10**9, 10**9 + 10**7, 10**9 + 2 * 10**7]

    def get_image_data_by_index(self, stream, i):
        return SimpleNamespace(to_numpy_array=lambda: np.full((8, 8, 3), i, np.uint8)), None


def test_aria(tmp_path, monkeypatch):
    core, provider, data = (
        ModuleType(f"projectaria_tools.{n}") for n in ("core", "core.data_provider", "core.sensor_data")
    )
    found = {"walk.vrs": Provider()}
    provider.create_vrs_data_provider = lambda name: found.get(name.rpartition("/")[2])
    data.TimeDomain = SimpleNamespace(DEVICE_TIME="device")
    core.data_provider, core.sensor_data = provider, data
    modules = {"projectaria_tools": ModuleType("projectaria_tools"), core.__name__: core, data.__name__: data}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("walk.vrs", "other.vrs"):
        (tmp_path / name).write_bytes(b"VisionRe")
    recording = open_any(tmp_path / "walk.vrs")
    imu = recording.block("/head/imu")
    np.testing.assert_array_equal(imu.t_ns, 10**9 + np.arange(40) * 10**6)
    np.testing.assert_allclose(imu.columns["specific_force"][3], [0, G, 0])
    assert [image.pixels[0, 0, 0] for image in recording.images("/head/color")] == [0, 1, 2]
    assert recording.unread == {"/mic": "stream"}
    with pytest.raises(StrideTwinError, match=r"other\.vrs: cannot be read: projectaria_tools finds no recording"):
        open_any(tmp_path / "other.vrs")


def test_aria_without_its_package_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "projectaria_tools", None)
    (tmp_path / "walk.vrs").write_bytes(b"VisionRe")
    with pytest.raises(StrideTwinError, match=r"projectaria_tools\S* is not installed; .*pip install '\.\[aria\]'"):
        open_any(tmp_path / "walk.vrs")


@pytest.mark.parametrize("spread", [0.0, 4.0])
def test_intrinsics_of_each_image_of_a_phone(tmp_path, spread):
    focal = 60.0 + spread * np.linspace(-1, 1, FRAMES)
    each = [[f, f, 31.0, 23.5] for f in focal.tolist()]
    (stray := tmp_path / "stray").mkdir()
    stray_scanner(stray, imu=False)
    lines = (stray / "odometry.csv").read_text().splitlines()
    rows = [f"{line}, {', '.join(map(repr, values))}" for line, values in zip(lines[1:], each)]
    (stray / "odometry.csv").write_text("\n".join([f"{lines[0]}, fx, fy, cx, cy", *rows]) + "\n")
    (scan := tmp_path / "scan").mkdir()
    record3d(scan)
    metadata = json.loads((scan / "metadata").read_text())
    (scan / "metadata").write_text(json.dumps(metadata | {"perFrameIntrinsicCoeffs": each}))
    for folder in (stray, scan):
        recording = open_any(folder)
        assert recording.rig.cameras["/head/color"].intrinsics[0] == pytest.approx(60.0, abs=0.1 * spread + 1e-9)
        assert any("the intrinsics change from image to image" in w for w in recording.warnings) == bool(spread)
