"""`check`: what is sound passes, each thing that would spoil an estimate is named."""

import json
import shutil
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.foreign_files import Walk, write_euroc
from stridetwin.cli.main import main
from stridetwin.scenarios.camera_report import report_cameras
from stridetwin.scenarios.check import check_recording, check_table
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu

SECONDS, HZ = 6, 200
K = np.array([[200.0, 0, 79.5], [0, 200.0, 59.5], [0, 0, 1]])


def imu_calibration(topic="/head/imu", rate=float(HZ), part="BMI055"):
    return ImuCalibration(
        topic=topic,
        part=part,
        rate_hz=rate,
        mount=Mount(body="head"),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=2e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=3e-4,
    )


def inertial(gyro=None, t_ns=None):
    n = SECONDS * HZ
    rng = np.random.default_rng(3)
    gyro = rng.normal(0, 0.02, (n, 3)) if gyro is None else gyro
    up, force = np.array([0, -9.81, 0]), []
    for back in Rotation.from_rotvec(-gyro / HZ):
        up = back.apply(up)
        force.append(up)
    columns = {"angular_rate": gyro, "specific_force": np.array(force) + rng.normal(0, 0.05, (n, 3))}
    t_ns = np.arange(n) * (10**9 // HZ) if t_ns is None else t_ns
    return Block(topic="/head/imu", kind=Imu, t_ns=t_ns, columns=columns)


def checked(path, rig, *items, **options):
    with RecordingWriter(path, rig, **options) as writer:
        for item in items:
            writer.write(item)
    return check_recording(Recording(path, lenient=True))


def errors(check):
    return [f.what for f in check.findings if f.is_error]


def test_a_sound_recording_is_fit(tmp_path):
    check = checked(tmp_path / "a.mcap", Rig(imus={"/head/imu": imu_calibration()}), inertial())
    assert errors(check) == []
    row = check.data["topics"]["/head/imu"]
    assert row["rate_hz"] == pytest.approx(HZ)
    assert (row["gaps"], row["range_hits_pct"]) == (0, 0.0)
    assert row["force_m_s2"] == pytest.approx(9.81, abs=0.05)
    assert check_table(check)[-1] == "valid"


def test_gaps_jitter_limits_and_rates_are_seen(tmp_path):
    n = SECONDS * HZ
    t = np.arange(n) * (10**9 // HZ)
    late = np.where(t > 3 * 10**9, t + 400_000_000, t)
    gyro = np.clip(np.random.default_rng(1).normal(0, 30, (n, 3)), -2000 * np.pi / 180, 2000 * np.pi / 180)
    jitter = np.sort(t + np.random.default_rng(2).integers(0, 2_000_000, n))
    rig = Rig(imus={"/head/imu": imu_calibration()})
    gaps = checked(tmp_path / "gap.mcap", rig, inertial(t_ns=late))
    assert any("1 gaps, the longest 0.405 s at 3.000 s" in w for w in errors(gaps))
    limits = checked(tmp_path / "limit.mcap", rig, inertial(gyro))
    assert any("at the end of the range" in w for w in errors(limits))
    some = np.random.default_rng(1).normal(0, 0.02, (n, 3))
    some[: n // 10, 1] = 2000 * np.pi / 180
    few = checked(tmp_path / "few.mcap", rig, inertial(some))
    assert errors(few) == []
    assert any("10.0 % of the samples at the end of the range: expected up to 5 %" in f.what for f in few.findings)
    shaken = checked(tmp_path / "jitter.mcap", rig, inertial(t_ns=jitter))
    assert 0.3 < shaken.data["topics"]["/head/imu"]["jitter_ms"] < 1.5
    slow = checked(tmp_path / "rate.mcap", Rig(imus={"/head/imu": imu_calibration(rate=100.0)}), inertial())
    assert any("where the rig declares 100 Hz" in w for w in errors(slow))
    bare = checked(tmp_path / "bare.mcap", Rig(), inertial())
    assert any("no calibration" in w for w in errors(bare))


USUAL_HZ = (5 / 2 / np.pi, 3.1 / 2 / np.pi, 4.3 / 2 / np.pi)


@cache
def frames(hz):
    """Angular rates of a turning camera, and its images of a far textured wall, each with its time in s."""
    rng = np.random.default_rng(8)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (400, 500), np.uint8), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    n = SECONDS * HZ
    t = np.arange(n) / HZ
    x, y, z = 2 * np.pi * np.outer(hz, t)
    angles = 0.12 * np.column_stack((np.sin(x), np.sin(y + 1), 0.5 * np.sin(z))) * min(1.0, 2.0 / max(hz))
    R = Rotation.from_rotvec(angles)
    gyro = np.zeros((n, 3))
    gyro[1:] = (R[:-1].inv() * R[1:]).as_rotvec() * HZ
    centre = K.copy()
    centre[:2, 2] = 249.5, 199.5
    images = []
    for i in range(40, n - 40, 7):
        H = K @ R[i].as_matrix().T @ np.linalg.inv(centre)
        images.append((t[i], cv2.warpPerspective(texture, H, (160, 120))))
    return gyro, images


def rendered(shift_s, with_depth, hz=USUAL_HZ):
    """Rates and images of a camera whose clock is `shift_s` behind the IMU's."""
    gyro, timed = frames(hz)
    images = []
    for at_s, grey in timed:
        t_ns = round((at_s - shift_s) * 1e9)
        images.append(Image(topic="/head/color", t_ns=t_ns, pixels=grey))
        if with_depth:
            images.append(Depth(topic="/head/depth", t_ns=t_ns, depth=np.full((120, 160), 4.0, np.float32)))
    return gyro, images


def check_of(
    tmp_path,
    gyro,
    images,
    *,
    with_depth=True,
    calibrated_s=0.0,
    turned=None,
    body="head",
    boards=None,
    focal=200.0,
    metadata=None,
):
    """Check of a camera whose mount is calibrated turned by a rotation from the true one."""
    T = np.eye(4)
    T[:3, :3] = np.eye(3) if turned is None else turned.as_matrix()
    camera = CameraCalibration(
        topic="/head/color",
        part="",
        rate_hz=200 / 7,
        mount=Mount(body=body, T_body_sensor=T),
        width=160,
        height=120,
        intrinsics=(focal, focal, 79.5, 59.5),
        depth_topic="/head/depth" if with_depth else "",
        imu_topic="/head/imu",
        timeshift_cam_imu_s=calibrated_s,
    )
    imu = replace(imu_calibration(), mount=Mount(body=body))
    rig = Rig(imus={"/head/imu": imu}, cameras={camera.topic: camera}, boards=boards or {})
    return checked(tmp_path / "a.mcap", rig, inertial(gyro), *images, jpeg_quality=None, metadata=metadata or {})


@pytest.mark.parametrize(
    ("shift", "calibrated_s", "fit", "with_depth"),
    [(0.0, 0.0, True, False), (0.03, 0.0, False, False), (0.03, 0.0, False, True), (0.03, 0.03, True, True)],
)
def test_the_clock_of_a_camera_is_measured(tmp_path, shift, calibrated_s, fit, with_depth):
    check = check_of(tmp_path, *rendered(shift, with_depth), with_depth=with_depth, calibrated_s=calibrated_s)
    assert check.data["camera_clocks"]["/head/color"]["shift_s"] == pytest.approx(shift, abs=0.002)
    assert check.data["camera_clocks"]["/head/color"]["mount_off_deg"] == 0.0
    assert (not errors(check)) is fit
    clock = check.data["camera_clocks"]["/head/color"]
    assert abs(clock["shift_s"] - shift) < clock["half_s"] < 0.005
    assert fit or any("ms from that of /head/imu, in the calibration by +0.0 ms" in w for w in errors(check))


@pytest.mark.parametrize(
    ("axis", "degrees", "with_depth"),
    [((0, 0, 1), 90, False), ((0, 0, 1), -20, True), ((0, 1, 0), 180, False), ((1, 1, 1), 120, True)],
)
def test_a_camera_whose_nominal_mount_is_wrong_is_invalid(tmp_path, axis, degrees, with_depth):
    turned = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    check = check_of(tmp_path, *rendered(0.01, with_depth), with_depth=with_depth, turned=turned)
    clock = check.data["camera_clocks"]["/head/color"]
    assert clock["mount_off_deg"] == pytest.approx(abs(degrees), abs=3.0)
    assert clock["shift_s"] == pytest.approx(0.01, abs=0.004)
    assert clock["correlation"] > 0.9
    assert [w for w in errors(check) if "from the calibration of it and /head/imu" in w]
    assert check_table(check)[-1] == "invalid: see ERROR"


def restamp(images, late_s):
    return [replace(image, t_ns=image.t_ns + round(late_s * 1e9)) for image in images]


@pytest.mark.parametrize("late_s", [0.4, 1.3])
def test_a_clock_far_off_is_measured(tmp_path, late_s):
    gyro, images = rendered(0.0, False)
    check = check_of(tmp_path, gyro, restamp(images, late_s), with_depth=False)
    assert check.data["camera_clocks"]["/head/color"]["shift_s"] == pytest.approx(-late_s, abs=0.003)
    assert any("its clock differs by" in w for w in errors(check))


def test_images_and_imu_that_share_no_time_are_named(tmp_path):
    gyro, images = rendered(0.0, False)
    (error,) = errors(check_of(tmp_path, gyro, restamp(images, 3600.0), with_depth=False))
    assert "its images are from 3600.200 to 3605.765 s, /head/imu from 0.000 to 5.995 s" in error
    assert "if -3600.00" in error
    blank = [replace(image, pixels=np.full_like(image.pixels, 128)) for image in restamp(images, 3600.0)]
    (error,) = errors(check_of(tmp_path, gyro, blank, with_depth=False))
    assert error.endswith("expected stamps of one clock")


def test_a_wrong_focal_length_is_an_error(tmp_path):
    (error,) = errors(check_of(tmp_path, *rendered(0.0, False), with_depth=False, focal=150.0))
    fitting = float(error.partition("focal lengths of about ")[2].partition(",")[0])
    assert fitting == pytest.approx(200.0, rel=0.05)


def test_an_imported_camera_is_looked_at_before_it_is_used(tmp_path, capsys):
    check_of(tmp_path, *rendered(0.019, False), with_depth=False, metadata={"imported_from": "euroc"})
    recording = Recording(tmp_path / "a.mcap")
    (warning,) = report_cameras(recording, ["/head/color"], lenient=False)
    assert "its clock differs by +18." in warning
    assert warning in capsys.readouterr().err
    assert report_cameras(recording, ["/head/imu"], lenient=False) == []


def test_an_offset_that_an_unknown_readout_explains_is_no_fault_of_an_imported_camera(tmp_path):
    check_of(tmp_path, *rendered(0.012, False), with_depth=False, metadata={"imported_from": "euroc"})
    assert report_cameras(Recording(tmp_path / "a.mcap"), ["/head/color"], lenient=False) == []


def test_an_imported_camera_that_spoils_an_estimate_is_refused(tmp_path):
    turned = Rotation.from_euler("z", 90, degrees=True)
    check_of(tmp_path, *rendered(0.0, False), with_depth=False, turned=turned, metadata={"imported_from": "euroc"})
    with pytest.raises(RecordingError, match="turned by 90° about its z axis"):
        report_cameras(Recording(tmp_path / "a.mcap"), ["/head/color"], lenient=False)
    check_of(tmp_path, *rendered(0.0, False), with_depth=False, turned=turned)
    assert report_cameras(Recording(tmp_path / "a.mcap"), ["/head/color"], lenient=False) == []


def test_a_camera_turned_by_less_than_can_be_measured_is_valid(tmp_path):
    check = check_of(tmp_path, *rendered(0.0, True), turned=Rotation.from_euler("z", 2, degrees=True))
    assert errors(check) == []


def test_what_images_do_not_show_is_reported_as_not_checked(tmp_path):
    gyro, images = rendered(0.0, False)
    blank = [Image(topic=p.topic, t_ns=p.t_ns, pixels=np.full_like(p.pixels, 128)) for p in images]
    still = check_of(tmp_path, gyro, blank, with_depth=False)
    other = check_of(tmp_path, np.random.default_rng(5).permutation(gyro), images, with_depth=False)
    for check in (still, other):
        assert check.data["camera_clocks"] == {}
        assert errors(check) == []
        assert any(
            f.what == "its clock and mount could not be checked with its images and the gyroscope of /head/imu"
            for f in check.findings
        )


def test_a_clock_is_not_measured_where_the_rotation_repeats_within_the_shifts(tmp_path):
    gyro, images = rendered(0.0, False, hz=(10.0, 10.0, 10.0))
    check = check_of(tmp_path, gyro, images, with_depth=False)
    assert check.data["camera_clocks"] == {}
    assert errors(check) == []


def test_a_shoe_camera_that_sees_the_board_of_the_other_shoe_is_not_judged(tmp_path):
    gyro, images = rendered(0.06, False)
    board = Board(name="foot_r", mount=Mount(body="foot_r"), squares=(5, 4), square_m=0.02)
    check = check_of(tmp_path, gyro, images, with_depth=False, body="foot_l", boards={"foot_r": board})
    assert check.data["camera_clocks"] == {}
    assert errors(check) == []
    assert any("show the board of foot_r, which moves" in f.what for f in check.findings)


def test_the_command_line_reports_in_a_table_and_by_its_exit_code(tmp_path, capsys):
    source = write_euroc(tmp_path, Walk())
    assert main(["check", str(source)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "valid"
    broken = shutil.copytree(source, tmp_path / "broken") / "mav0" / "imu0" / "data.csv"
    lines = broken.read_text().splitlines()
    broken.write_text("\n".join([*lines[:50], lines[30], *lines[50:]]))
    assert main(["check", str(tmp_path / "broken"), "--json"]) == 1
    data = json.loads(capsys.readouterr().out)
    assert not data["valid"]
    assert any("is not after" in f["what"] for f in data["findings"])
    next((source / "mav0" / "cam0" / "data").iterdir()).write_bytes(b"junk")
    assert main(["check", str(source)]) == 1
    assert "damaged image" in capsys.readouterr().out
    assert open_any(source).topics["/head/imu"].count == 200
