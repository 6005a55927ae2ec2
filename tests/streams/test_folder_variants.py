"""RGB-D and EuRoC folders as users have them: without lists, with others' paths, one level off, or of another kind."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from empty_files import touch_files

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.opening import open_any

STAMPS_S = [f"{1_305_031_102 + i * 0.1:.6f}" for i in range(12)]
STAMPS_NS = [1_403_636_579_000_000_000 + 50_000_000 * i for i in range(12)]


def write_image(path, suffix=".png", depth=False):
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((24, 32), 8500, np.uint16) if depth else np.full((24, 32, 3), 90, np.uint8)
    cv2.imwrite(str(path.with_name(path.name + suffix)), pixels)


def write_tum(folder):
    for name in ("rgb", "depth"):
        for stamp in STAMPS_S:
            write_image(folder / name / stamp, depth=name == "depth")
        rows = "".join(f"{stamp} {name}/{stamp}.png\n" for stamp in STAMPS_S)
        (folder / f"{name}.txt").write_text(f"# timestamp filename\n{rows}")
    return folder


def write_euroc(folder, suffix=".png"):
    rng = np.random.default_rng(3)
    imu, camera = folder / "mav0/imu0", folder / "mav0/cam0"
    imu.mkdir(parents=True)
    names = [f"w_RS_S_{a} [rad s^-1]" for a in "xyz"] + [f"a_RS_S_{a} [m s^-2]" for a in "xyz"]
    rows = [
        [
            str(STAMPS_NS[0] + 5_000_000 * i),
            *(f"{v:.5f}" for v in (*rng.normal(0, 0.01, 3), *rng.normal((0, 0, 9.81), 0.05))),
        ]
        for i in range(120)
    ]
    table = [["#timestamp [ns]", *names], *rows]
    (imu / "data.csv").write_text("".join(",".join(row) + "\n" for row in table))
    for stamp in STAMPS_NS:
        write_image(camera / "data" / str(stamp), suffix)
    (camera / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{t},{t}.png\n" for t in STAMPS_NS))
    return folder


def edit(file, old, new):
    file.write_text(file.read_text().replace(old, new))


@pytest.mark.parametrize(
    "old_new",
    [(" rgb/", ",rgb/"), (" rgb/", " rgb\\"), (" rgb/", " /scan/rgb/"), (" rgb/", " C:\\scan\\rgb\\")],
)
def test_lists_of_other_machines(tmp_path, old_new):
    edit(write_tum(tmp_path) / "rgb.txt", *old_new)
    recording = open_any(tmp_path)
    assert len(recording.image_times("/head/color")) == 12
    assert not any("missing" in warning for warning in recording.warnings)


@pytest.mark.parametrize("order", ["rgb depth", "depth rgb"])
def test_a_list_of_pairs(tmp_path, order):
    write_tum(tmp_path)
    first, second = order.split()
    pairs = "".join(f"{t} {first}/{t}.png {t} {second}/{t}.png\n" for t in STAMPS_S)
    for name in ("rgb.txt", "depth.txt"):
        (tmp_path / name).unlink()
    (tmp_path / "associations.txt").write_text(pairs)
    recording = open_any(tmp_path)
    (depth,) = recording.images("/head/depth", [0])
    np.testing.assert_allclose(depth.depth, 1.7, atol=1e-6)
    assert len(recording.image_times("/head/color")) == 12


def test_the_header_of_a_true_path_gives_the_order_of_its_quaternion(tmp_path):
    write_tum(tmp_path)
    rows = "".join(f"{t} 0 0 1.6 0.6 0.8 0 0\n" for t in STAMPS_S)
    for header, q in (("qw qx qy qz", [0.6, 0.8, 0, 0]), ("qx qy qz qw", [0, 0.6, 0.8, 0])):
        (tmp_path / "groundtruth.txt").write_text(f"# timestamp tx ty tz {header}\n{rows}")
        truth = open_any(tmp_path).block("/truth/head/color/odometry")
        np.testing.assert_allclose(truth.columns["q_world_frame"][0], q, atol=1e-9)


def test_calibrations_of_other_names_are_read_or_named(tmp_path):
    (write_tum(tmp_path / "a") / "calib.txt").write_text("517.3 516.5 318.6 255.3\n")
    assert "calib.txt is not read: calibration.txt with fx fy cx cy" in " ".join(open_any(tmp_path / "a").warnings)
    for name, text in (
        ("intrinsics.txt", "20 0 16\n0 21 12\n0 0 1\n"),
        ("intrinsic_color.txt", "20 0 16 0\n0 21 12 0\n0 0 1 0\n0 0 0 1\n"),
    ):
        folder = tmp_path / name
        for kind in ("color", "depth"):
            write_image(folder / f"frame-000000.{kind}", depth=kind == "depth")
        (folder / name).write_text(text)
        assert open_any(folder).rig.cameras["/head/color"].intrinsics == (20.0, 21.0, 16.0, 12.0)


def test_stamps_in_nanoseconds_are_named(tmp_path):
    file = write_tum(tmp_path) / "rgb.txt"
    file.write_text(f"1305031102100000000 rgb/{STAMPS_S[0]}.png\n")
    with pytest.raises(StrideTwinError, match="seconds from 0 on; is it in ns"):
        open_any(tmp_path)


def test_images_without_a_list_have_their_names_as_stamps(tmp_path):
    (write_euroc(tmp_path) / "mav0/cam0/data.csv").unlink()
    recording = open_any(tmp_path)
    np.testing.assert_array_equal(recording.image_times("/head/color"), STAMPS_NS)
    assert "no list of images" in " ".join(recording.warnings)


def test_a_table_inside_of_a_recording_is_said(tmp_path):
    (warning,) = [w for w in open_any(write_euroc(tmp_path) / "mav0/imu0").warnings if "table alone" in w]
    assert "give that folder for the whole recording" in warning


def test_images_of_another_ending_and_tables_with_tabs(tmp_path):
    folder = write_euroc(tmp_path, suffix=".jpg")
    edit(folder / "mav0/imu0/data.csv", ",", "\t")
    recording = open_any(folder)
    assert len(recording.image_times("/head/color")) == 12
    assert len(recording.block("/head/imu")) == 120


SENSOR = (
    "sensor_type: camera\nT_BS: {rows: 4, cols: 4, data: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}\nrate_hz: 20\n"
    "resolution: [32, 24]\n"
)


@pytest.mark.parametrize(
    ("lens", "focal"),
    [
        ("camera_model: omni\nintrinsics: [0.9, 38, 38, 16, 12]\ndistortion_model: none\n", 38 / 1.9),
        (
            "camera_model: pinhole\nintrinsics: [20, 20, 16, 12]\ndistortion_model: plumb_bob\n"
            "distortion_coefficients: [0.1, 0.01, 0, 0, 0]\n",
            20,
        ),
    ],
)
def test_lenses_of_sensor_files(tmp_path, lens, focal):
    (write_euroc(tmp_path) / "mav0/cam0/sensor.yaml").write_text(SENSOR + lens)
    assert open_any(tmp_path).rig.cameras["/head/color"].intrinsics[0] == pytest.approx(focal, rel=1e-3)


@pytest.mark.parametrize(
    ("lens", "says"),
    [
        ("camera_model: omni\nintrinsics: [38, 38, 16, 12]\n", "intrinsics: .*expected 5 numbers of omni"),
        ("intrinsics: [20, 20, 16, 12]\ndistortion_coefficients: [0.1]\n", "expected 4 or 5 or 8 or .* of radtan"),
    ],
)
def test_lenses_with_too_few_numbers(tmp_path, lens, says):
    (write_euroc(tmp_path) / "mav0/cam0/sensor.yaml").write_text(SENSOR + lens)
    with pytest.raises(StrideTwinError, match=says):
        open_any(tmp_path)


@pytest.mark.parametrize(
    ("names", "given", "says"),
    [
        (["mav0/cam0/data/1.png"], "mav0/cam0/data", r"a part of .*mav0 \(euroc\): give that folder"),
        (["rgb.txt", "rgb/1.png"], "rgb", r"a part of .* \(tum\): give that folder"),
        (["rgb.txt", "rgb/1.png"], "rgb/1.png", r"a part of .* \(tum\): give that folder"),
        (["a/b/rgb.txt"], "", r"recordings inside; give one of them: .*a/b$"),
        ([f"s{i:02d}/x.md" for i in range(12)] + ["s11/rgb.txt"], "", r"give one of them: .*s11$"),
        (["oxts/x.txt", "image_02/x.png"], "", "KITTI's raw data, on a car"),
        (["image_0/0.png", "times.txt", "calib.txt"], "", "KITTI's odometry.*write rgb.txt"),
        (["color/0.jpg", "depth/0.png", "pose/0.txt"], "", "ScanNet: name the files as 7-Scenes"),
        (["scene0000_00.sens"], "", "unpack it with ScanNet's SensReader"),
        (["results/frame0.jpg", "traj.txt"], "", "Replica.*--depth-scale 6553.5"),
        (["rgb/0.png", "depth/0.png"], "", "no list of stamps: write rgb.txt and depth.txt"),
        (["walk.mp4"], "", "a video alone is not read"),
        (["walk.mp4"], "walk.mp4", "mp4 files are not read: write its frames"),
    ],
)
def test_other_folders_say_what_to_give(tmp_path, names, given, says):
    touch_files(tmp_path, *names)
    path = tmp_path / given
    if path.is_file():
        path.write_bytes(b"\0\0\0\x18ftypmp42")
    with pytest.raises(StrideTwinError, match=says) as error:
        open_any(path)
    assert "\n" not in str(error.value)
