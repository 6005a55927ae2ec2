"""Depth of another unit and wrong intrinsics contradict the motion that an IMU or given poses measure."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.cli.main import main
from stridetwin.scenarios.check import check_recording, check_table
from stridetwin.scenarios.depth_scale import measure_depth_scales
from stridetwin.streams.formats.opening import ImportOptions, open_any
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.samples import Imu
from tests.floor_walk import HEIGHT, WIDTH, F, rig, walk_over_floor


@pytest.fixture(scope="module")
def walk():
    return walk_over_floor()


def write(path, walk, depth_factor=1.0, focal_factor=1.0, imu=None, with_imu=True):
    with RecordingWriter(path, rig(focal_factor, with_imu), {}, jpeg_quality=None) as writer:
        if with_imu:
            writer.write(walk.imu if imu is None else imu)
        for sample in walk.samples(depth_factor):
            writer.write(sample)
    return path


def measure(path):
    recording = Recording(path, lenient=True)
    topics = ["/head/imu"] if "/head/imu" in recording.topics else []
    blocks = {topic: block.as_kind(Imu) for topic, block in recording.blocks(topics).items()}
    return measure_depth_scales(recording, blocks).get("/head/depth")


def test_depth_and_intrinsics_that_agree_with_the_imu_are_sound(tmp_path, walk):
    scale = measure(write(tmp_path / "a.mcap", walk))
    assert scale.motion.path.ratio == pytest.approx(1.0, abs=0.05)
    assert scale.motion.path.contains(0.0)
    assert list(scale.faults()) == []


def assert_names_unit(fault, factor):
    assert fault.startswith("depth: invalid unit")
    multiplied = float(fault.split("multiply the depth by ")[1].split(",")[0])
    assert multiplied == pytest.approx(1 / factor, rel=0.08)
    assert "--depth-scale" in fault


def test_depth_of_another_unit_contradicts_the_imu(tmp_path, walk):
    ((fault, is_error),) = measure(write(tmp_path / "a.mcap", walk, 1.25)).faults()
    assert is_error
    assert_names_unit(fault, 1.25)


@pytest.mark.parametrize(("factor", "with_imu"), [(0.7, True), (1.15, False)])
def test_a_wrong_focal_length_bends_the_scene(tmp_path, walk, factor, with_imu):
    path = write(tmp_path / "a.mcap", walk, focal_factor=factor, with_imu=with_imu)
    ((fault, _),) = measure(path).faults()
    assert fault.startswith(f"intrinsics: invalid focal length {F * factor:.4g} px: expected ")
    expected = float(fault.split("expected ")[1].split(" ")[0])
    assert expected == pytest.approx(F, rel=0.06)


def test_check_reports_the_scale(tmp_path, walk):
    path = write(tmp_path / "a.mcap", walk, 0.2)
    check = check_recording(Recording(path, lenient=True))
    assert not check.is_valid
    (error,) = [f for f in check.findings if f.is_error]
    assert error.topic == "/head/depth"
    assert_names_unit(error.what, 0.2)
    assert check.data["depth_scales"]["/head/depth"]["scale"] == pytest.approx(0.2, rel=0.05)
    assert any(line.startswith("/head/depth: its motion is 0.") for line in check_table(check))


def test_a_late_clock_does_not_change_the_scale(tmp_path, walk):
    late = replace(walk.imu, t_ns=walk.imu.t_ns + 60_000_000)
    scale = measure(write(tmp_path / "a.mcap", walk, imu=late))
    assert scale.motion.path.ratio == pytest.approx(1.0, abs=0.05)


def test_nothing_is_said_where_the_imu_moves_otherwise(tmp_path, walk):
    turned = {name: values @ np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]) for name, values in walk.imu.columns.items()}
    scale = measure(write(tmp_path / "a.mcap", walk, 0.5, imu=replace(walk.imu, columns=turned)))
    assert scale.motion is None
    assert list(scale.faults()) == []


def write_seven_scenes(folder, walk, per_metre=1000.0, focal_factor=1.0):
    folder.mkdir()
    for i, (pixels, depth, T) in enumerate(zip(walk.pixels, walk.depth, walk.T_world_camera)):
        cv2.imwrite(str(folder / f"frame-{i:06d}.color.png"), pixels)
        cv2.imwrite(str(folder / f"frame-{i:06d}.depth.png"), np.rint(depth * per_metre).astype(np.uint16))
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", T)
    f = F * focal_factor
    np.savetxt(folder / "camera-intrinsics.txt", [[f, 0, (WIDTH - 1) / 2], [0, f, (HEIGHT - 1) / 2], [0, 0, 1]])
    return folder


def write_tum(folder, walk, per_metre):
    for name in ("rgb", "depth"):
        (folder / name).mkdir()
    rows = {"rgb": "", "depth": "", "groundtruth": ""}
    for t_ns, pixels, depth, T in zip(walk.t_ns.tolist(), walk.pixels, walk.depth, walk.T_world_camera):
        stamp = f"{t_ns * 1e-9:.6f}"
        cv2.imwrite(str(folder / f"rgb/{stamp}.png"), pixels)
        cv2.imwrite(str(folder / f"depth/{stamp}.png"), np.rint(depth * per_metre).astype(np.uint16))
        rows["rgb"] += f"{stamp} rgb/{stamp}.png\n"
        rows["depth"] += f"{stamp} depth/{stamp}.png\n"
        q = Rotation.from_matrix(T[:3, :3]).as_quat()
        rows["groundtruth"] += " ".join([stamp, *map(str, T[:3, 3]), *map(str, q)]) + "\n"
    for name, text in rows.items():
        (folder / f"{name}.txt").write_text(text)
    (folder / "calibration.txt").write_text(f"{F} {F} {(WIDTH - 1) / 2} {(HEIGHT - 1) / 2}\n")
    return folder


def test_an_import_names_the_units_to_give(tmp_path, walk):
    recording = open_any(write_tum(tmp_path, walk, 1000.0))  # the layout has 5000
    (warning,) = [w for w in recording.warnings if "depth: " in w]
    assert "with 5 times the depth" in warning
    assert "--depth-scale 1000 in place of 5000" in warning
    mended = open_any(tmp_path, options=ImportOptions(depth_scale=1000.0))
    assert not [w for w in mended.warnings if "depth: " in w]


@pytest.mark.parametrize(
    ("per_metre", "focal_factor", "expected"),
    [
        (1000.0, 1.0, None),
        (5000.0, 1.0, "--depth-scale 5000 in place of 1000"),
        (1000.0, 0.85, "intrinsics: invalid focal length 170 px: expected "),
    ],
)
def test_given_poses_are_a_reference(tmp_path, walk, per_metre, focal_factor, expected):
    folder = write_seven_scenes(tmp_path / "scan", walk, per_metre, focal_factor)
    faults = [f for scale in measure_depth_scales(open_any(folder), {}).values() for f, _ in scale.faults()]
    assert len(faults) == (expected is not None)
    assert all(expected in fault for fault in faults)


def test_truth_is_no_reference(tmp_path, walk):
    tum = write_tum(tmp_path, walk, 2500.0)
    assert (tum / "groundtruth.txt").is_file()
    scale = measure_depth_scales(open_any(tum), {})["/head/depth"]
    assert scale.reference == ""
    assert list(scale.faults()) == []


def test_planes_are_checked_without_a_reference(tmp_path, walk, capsys):
    path = write(tmp_path / "a.mcap", walk, 2.0, with_imu=False)
    assert main(["check", str(path), "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)["findings"]
    (what,) = [f["what"] for f in findings if f["what"].startswith("depth: ")]
    assert "height of the camera of 3.2 m above the floor" in what
    assert "with 0.5 times the depth it would be 1.6 m" in what
