"""Clock, mount, focal length and lever arm of a camera by its motion and that of the IMU beside it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_walk import FOCAL, CameraWalk
from scipy.spatial.transform import Rotation

from stridetwin.scenarios.camera_axes import find_rate_fault, is_upright
from stridetwin.scenarios.camera_clock import GyroRates, estimate_clock
from stridetwin.scenarios.camera_fit import describe_turn, list_cameras_beside_imus
from stridetwin.scenarios.camera_focal import estimate_focal
from stridetwin.scenarios.camera_lever import estimate_lever
from stridetwin.scenarios.camera_motion import build_parts, prepare_parts
from stridetwin.scenarios.camera_report import _list_cameras
from stridetwin.scenarios.image_rotation import Rates, estimate_rates
from stridetwin.streams.recording.imported import IMPORTED_FROM
from stridetwin.streams.rig import Board, CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Accelerometer, Depth, Image, Imu


class Fitted:
    """What the motion of a walk says about a calibration.

    Args:
        walk: The walk.
        focal: Calibrated focal length, px.
        arm_off: By which the calibrated place is off, m.
        readout_s: Calibrated readout.
        shift_s: By which the images are stamped early.
        has_depth: Whether the camera measures depth.
        has_lens: Whether the focal length is estimated.
    """

    def __init__(
        self, walk, *, focal=FOCAL, arm_off=(0, 0, 0), readout_s=0.0, shift_s=0.0, has_depth=True, has_lens=True
    ):
        imu, camera, T = walk.imu(), walk.camera(focal, readout_s), walk.T_imu_cam.copy()
        T[:3, 3] += arm_off
        early = round(shift_s * 1e9)
        segments = [
            [
                replace(x, t_ns=(x.t_ns[0] - early, x.t_ns[1] - early), depth=x.depth if has_depth else None)
                for x in segment
            ]
            for segment in walk.tracks()
        ]
        gyro = GyroRates.of(imu, T[:3, :3].T)
        rates = [estimate_rates(camera, segment) for segment in segments]
        self.clock = estimate_clock(camera, gyro, rates)
        self.focal = self.lever = None
        if not has_lens:
            return
        self.focal = estimate_focal(camera, T, imu, gyro, segments, rates, self.clock)
        if has_depth:
            parts = build_parts(camera, list(prepare_parts(T[:3, :3], imu, segments, self.clock.shift_s)))
            self.lever = estimate_lever(parts, T, 3.0, readout_s)


@pytest.mark.parametrize("is_flat", [False, True])
def test_a_right_calibration_is_right(is_flat):
    fit = Fitted(CameraWalk(seed=1, flat=is_flat))
    assert abs(fit.clock.shift_s) < 0.002
    assert fit.clock.mount_off_deg == 0.0
    assert fit.focal.ratio == pytest.approx(1, abs=0.03)
    assert not fit.focal.is_off
    assert not fit.lever.is_off


@pytest.mark.parametrize("factor", [0.7, 1.15])
def test_a_wrong_focal_length_is_named(factor):
    fit = Fitted(CameraWalk(seed=2), focal=factor * FOCAL)
    assert fit.focal.ratio == pytest.approx(1 / factor, rel=0.03)
    assert fit.focal.is_off
    assert not fit.focal.is_gyro_off
    assert not fit.clock.is_off


def test_a_wrong_focal_length_without_depth_is_named():
    fit = Fitted(CameraWalk(seed=2), focal=1.3 * FOCAL, has_depth=False)
    assert fit.focal.ratio == pytest.approx(1 / 1.3, rel=0.03)
    assert fit.focal.is_off


def test_a_place_that_is_off_by_a_foot_is_seen():
    fit = Fitted(CameraWalk(seed=3), arm_off=(0.0, 0.0, 0.3))
    assert fit.lever.is_off
    assert abs(fit.lever.measured[2] + 0.03) < fit.lever.half[2]
    assert fit.lever.gain > 100.0
    assert not fit.focal.is_off
    # where people walk about, another place fits a little better by chance
    assert not replace(fit.lever, gain=2.0).is_off


@pytest.mark.parametrize("calibrated_s", [0.0, 0.016])
def test_a_rolling_shutter_is_no_other_place(calibrated_s):
    fit = Fitted(CameraWalk(seed=4, readout_s=0.016), readout_s=calibrated_s)
    assert fit.lever.readout_s == pytest.approx(0.016, abs=0.006)
    assert not fit.lever.is_off
    assert not fit.focal.is_off


def test_depth_of_another_scale_is_no_other_place_or_lens():
    fit = Fitted(CameraWalk(seed=5, depth_factor=1.4))
    assert not fit.lever.is_off
    assert not fit.focal.is_off


@pytest.mark.parametrize("shift_s", [0.3, 3600.0, -1.7e9])
def test_a_clock_is_found_wherever_it_is(shift_s):
    fit = Fitted(CameraWalk(seed=6), shift_s=shift_s, has_lens=False)
    assert fit.clock.shift_s == pytest.approx(shift_s, abs=0.003)
    assert fit.clock.is_off


INVERTIBLE = Rotation.from_euler("xyz", (-90, 0, -90), degrees=True).as_matrix()


@pytest.mark.parametrize(
    ("turn", "cause"),
    [
        (Rotation.from_euler("z", 90, degrees=True), "the camera is turned by 90° about its z axis"),
        (Rotation.from_euler("x", -92, degrees=True), "the camera is turned by 90° about its x axis"),
        (Rotation.from_euler("y", 180, degrees=True), "the camera is turned by 180° about its y axis"),
        (Rotation.from_matrix(INVERTIBLE.T @ INVERTIBLE.T), "T_cam_imu is inverted"),
        (Rotation.from_euler("z", 37, degrees=True), "T_cam_imu is of another camera or mount"),
        (Rotation.from_rotvec(np.full(3, np.radians(120) / np.sqrt(3))), "its axes x, y, z are z, x, y of the calib"),
    ],
)
def test_a_wrong_mount_has_a_name(turn, cause):
    text = describe_turn(turn.as_matrix(), INVERTIBLE)
    assert f"probably {cause}" in text
    fitting = np.array(eval(text.partition("fits is ")[2].partition(", for")[0]))
    np.testing.assert_allclose(fitting, turn.as_matrix() @ INVERTIBLE, atol=0.05)


def test_a_mount_that_is_off_by_little_has_its_rotation_in_the_message():
    small = Rotation.from_euler("x", 7, degrees=True).as_matrix()
    text = describe_turn(small, np.eye(3))
    assert "probably T_cam_imu is not exact" in text
    np.testing.assert_allclose(eval(text.partition("fits is ")[2].partition(", for")[0]), small, atol=1e-3)


def axes_fault(walk, M=None, factor=1.0):
    """What the images say about rates that are multiplied by a matrix and a factor."""
    M = np.eye(3) if M is None else M
    imu = walk.imu()
    rate = factor * imu.columns["angular_rate"] @ M.T
    wrong = replace(imu, columns={**imu.columns, "angular_rate": rate})
    gyro = GyroRates.of(wrong, walk.T_imu_cam[:3, :3].T)
    rates = [estimate_rates(walk.camera(), segment) for segment in walk.tracks()]
    return find_rate_fault(walk.camera(), gyro, rates, estimate_clock(walk.camera(), gyro, rates))


@pytest.mark.parametrize(
    ("M", "factor", "words"),
    [
        (np.eye(3), 1.0, ""),
        (np.diag([1.0, -1.0, 1.0]), 1.0, "mirrored"),
        (-np.eye(3), 1.0, "mirrored"),
        (np.eye(3)[[1, 0, 2]], 1.0, "mirrored"),
        (np.eye(3), 180 / np.pi, "°/s"),
        (np.eye(3), 1e-3, "1000 times too small"),
    ],
)
def test_images_show_the_unit_and_the_handedness_of_rates(M, factor, words):
    fault = axes_fault(CameraWalk(seed=6), M, factor)
    assert words in fault
    assert bool(fault) == bool(words)


@pytest.mark.parametrize(("M", "is_mirrored"), [(np.eye(3), False), (np.diag([1.0, 1.0, -1.0]), True)])
@pytest.mark.parametrize("seed", range(2))
def test_wild_images_do_not_hide_mirrored_rates_of_a_head_that_turns_about_two_axes(M, is_mirrored, seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0, 13, 0.01)
    rate = np.column_stack([a * np.sin(w * t + p) for a, w, p in ((0.9, 2.0, 0.3), (0.5, 5.0, 1.2), (0.1, 9.0, 2.0))])
    gyro = GyroRates(t_ns=np.round(t * 1e9).astype(np.int64), rate=rate @ M.T, R_cam_imu=np.eye(3))
    starts = np.arange(0.5, 12, 1 / 30)
    spans = np.round(np.column_stack((starts, starts + 1 / 30)) * 1e9).astype(np.int64)
    true = GyroRates(t_ns=gyro.t_ns, rate=rate, R_cam_imu=np.eye(3)).mean_between(spans, np.zeros(1))[0]
    noise = rng.choice([0.02, 0.4], p=[0.6, 0.4], size=(len(true), 1))
    visual = true + noise * rng.standard_normal(true.shape)
    unknown = np.full(visual.shape, np.nan)
    rates = [Rates(t_ns=spans, rate=visual, shift=unknown, depth=unknown[:, 0])]
    camera = CameraWalk(seed=1).camera()
    fault = find_rate_fault(camera, gyro, rates, estimate_clock(camera, gyro, rates))
    assert ("mirrored" in fault) == is_mirrored


@pytest.mark.parametrize(
    ("up", "is_worn"),
    [((0, -1, 0), True), ((0, -0.8, -0.6), True), ((1, 0, 0), False), ((0, 1, 0), False), ((0, -0.8, 0.6), False)],
)
def test_who_wears_a_camera_holds_it_upright(up, is_worn):
    camera = CameraWalk(seed=1).camera()
    assert is_upright(replace(camera, mount=replace(camera.mount, body="head")), np.array(up, float)) == is_worn


def test_a_camera_is_compared_if_its_images_and_its_imu_are_recorded():
    def camera(body, color, depth="", imu=""):
        rates = {"rate_hz": 30.0, "width": 640, "height": 480, "intrinsics": (600.0, 600.0, 319.5, 239.5)}
        return CameraCalibration(
            topic=color, part="", mount=Mount(body=body), depth_topic=depth, imu_topic=imu or f"/{body}/imu", **rates
        )

    cameras = [
        camera("head", "/head/color", "/head/depth"),
        camera("chest", "/chest/depth", "/chest/depth"),
        camera("foot_l", "/foot_l/camera"),
        camera("pelvis", "/pelvis/unrecorded"),
        camera("thigh", "/thigh/color", imu="/thigh/unrecorded"),
        camera("shank", "/shank/color", imu="/shank/accelerometer"),
    ]
    board = Board(name="foot_r", mount=Mount(body="foot_r"), squares=(5, 4), square_m=0.02)
    rig = Rig(cameras={c.topic: c for c in cameras}, boards={"board": board})
    kinds = {"/chest/depth": Depth, "/head/depth": Depth, "/shank/accelerometer": Accelerometer}
    kinds |= {c.topic: Image for c in cameras if c.topic not in {"/chest/depth", "/pelvis/unrecorded"}}
    kinds |= {f"/{body}/imu": Imu for body in ("head", "chest", "foot_l", "pelvis")}
    topics = {topic: SimpleNamespace(kind=kind) for topic, kind in kinds.items()}
    recording = SimpleNamespace(has_rig=True, rig=rig, topics=topics, metadata={IMPORTED_FROM: "a bag"})
    reasons = {camera.topic: reason for camera, reason in list_cameras_beside_imus(recording)}
    assert reasons == {
        "/head/color": "",
        "/chest/depth": "depth images alone do not show how it turns",
        "/foot_l/camera": "its images show the board of foot_r, which moves",
    }
    for used in ("/head/color", "/head/depth"):
        assert [c.topic for c in _list_cameras(recording, [used])] == ["/head/color"]
    assert not list(_list_cameras(recording, ["/chest/depth", "/foot_l/camera", "/head/imu"]))
    assert not list(list_cameras_beside_imus(SimpleNamespace(has_rig=False, topics=topics)))
