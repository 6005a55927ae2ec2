"""Faults: each does what it says, leaves everything else alone, and is recorded and read as it should be."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators import base
from stridetwin.sim.faults.faults import POSES, FaultPlan, LooseStrap, arrivals, check_faults, plan_faults
from stridetwin.sim.faults.image_faults import (
    Darkness,
    DepthNoise,
    HighView,
    LensDirt,
    MirrorFloor,
    Occlusion,
    PasserBy,
)
from stridetwin.sim.faults.sample_faults import (
    ClockJump,
    DeadCell,
    Dropout,
    Exchange,
    Freeze,
    Interpolated,
    Late,
    Miscalibration,
    Nan,
    Offset,
    OutOfOrder,
    Repeat,
    Restart,
    Saturation,
)
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import full_scales, load_part
from stridetwin.streams.errors import ConfigError, RecordingError
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Ahrs, Block, Depth, Encoder, Image, Imu, Insole, Odometry, Sample

RATE_HZ, DURATION_S = 100.0, 10.0
LEFT, RIGHT, INSOLE, COLOR, DEPTH = "/foot_l/imu", "/foot_r/imu", "/foot_l/insole", "/head/color", "/head/depth"
KNEE, BACK = "/exo/knee_l/encoder", "/exo/back/ahrs"


def _imu(topic: str, part: str, body: str) -> ImuCalibration:
    return ImuCalibration(
        topic=topic,
        part=part,
        rate_hz=RATE_HZ,
        mount=Mount(body=body),
        gyroscope_noise_density=1e-4,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=1e-3,
        accelerometer_random_walk=0.0,
    )


RIG = Rig(
    imus={t: _imu(t, "ADIS16485", t.split("/")[1]) for t in (LEFT, RIGHT)} | {
        "/head/imu": _imu("/head/imu", "BMI055", "head")
    },
    cameras={
        COLOR: CameraCalibration(
            topic=COLOR, part="D455", rate_hz=10.0, mount=Mount(body="head"), width=64, height=48,
            intrinsics=(50.0, 50.0, 31.5, 23.5), depth_topic=DEPTH, imu_topic="/head/imu",
        )
    },
    others={
        topic: OtherSensor(topic=topic, kind=kind, part=part, rate_hz=RATE_HZ, mount=Mount(body=body))
        for topic, kind, part, body in (
            (INSOLE, "insole", "FlexiForce A401", "foot_l"),
            (KNEE, "encoder", "AMT203", "exo_shank_l"),
            (BACK, "ahrs", "MW-AHRSv1", "exo_back"),
        )
    },
)  # fmt: skip


def imu_block(topic: str = LEFT, seconds: float = DURATION_S) -> Block[Imu]:
    t_ns = (np.arange(round(seconds * RATE_HZ)) * 10_000_000).astype(np.int64)
    rng = np.random.default_rng(len(topic))
    columns = {"angular_rate": rng.normal(0, 5, (len(t_ns), 3)), "specific_force": rng.normal(0, 40, (len(t_ns), 3))}
    return Block(topic=topic, kind=Imu, t_ns=t_ns, columns=columns)


def insole_block() -> Block[Insole]:
    t_ns = (np.arange(1000) * 10_000_000).astype(np.int64)
    force = np.arange(4000.0).reshape(1000, 4)
    return Block(topic=INSOLE, kind=Insole, t_ns=t_ns, columns={"force": force})


def cut(block: Block, size: int) -> list[Block]:
    return [
        replace(block, t_ns=block.t_ns[i : i + size], columns={n: c[i : i + size] for n, c in block.columns.items()})
        for i in range(0, len(block), size)
    ]


def corrupted(block: Block, *faults, seed: int = 0, size: int = 200) -> tuple[np.ndarray, np.ndarray, dict]:
    """Stamps, arrivals and columns of what arrives of one block, sent in parts."""
    planned = plan_faults(faults, RIG, seed, DURATION_S)
    got = list(arrivals(cut(block, size), planned))
    stamps = np.concatenate([a.item.t_ns for a in got])
    logs = np.concatenate([a.item.t_ns if a.log_ns is None else a.log_ns for a in got])
    return stamps, logs, {n: np.concatenate([a.item.columns[n] for a in got]) for n in block.columns}


def during(t_ns: np.ndarray, start: float, end: float) -> np.ndarray:
    return (t_ns >= round(start * 1e9)) & (t_ns < round(end * 1e9))


def test_dropout_takes_the_samples_of_its_time_and_no_others() -> None:
    block = imu_block()
    stamps, logs, _ = corrupted(block, Dropout(topic=LEFT, at_s=3, duration_s=0.5))
    np.testing.assert_array_equal(stamps, block.t_ns[~during(block.t_ns, 3, 3.5)])
    np.testing.assert_array_equal(logs, stamps)


def test_freeze_repeats_the_value_before_it_with_new_stamps() -> None:
    block = imu_block()
    stamps, _, columns = corrupted(block, Freeze(topic=LEFT, at_s=3, duration_s=0.5))
    frozen = during(block.t_ns, 3, 3.5)
    np.testing.assert_array_equal(stamps, block.t_ns)
    assert (columns["angular_rate"][frozen] == block.columns["angular_rate"][299]).all()
    np.testing.assert_array_equal(columns["angular_rate"][~frozen], block.columns["angular_rate"][~frozen])


def test_repeat_sends_each_sample_twice_with_its_stamp() -> None:
    block = imu_block()
    stamps, logs, columns = corrupted(block, Repeat(topic=LEFT, at_s=3, duration_s=0.5))
    times = np.where(during(block.t_ns, 3, 3.5), 2, 1)
    np.testing.assert_array_equal(stamps, np.repeat(block.t_ns, times))
    np.testing.assert_array_equal(logs, stamps)
    np.testing.assert_array_equal(columns["specific_force"], np.repeat(block.columns["specific_force"], times, axis=0))


def test_nan_spoils_every_value() -> None:
    block = imu_block()
    stamps, _, columns = corrupted(block, Nan(topic=LEFT, at_s=3, duration_s=0.5))
    bad = during(stamps, 3, 3.5)
    for values in columns.values():
        assert np.isnan(values[bad]).all()
        assert np.isfinite(values[~bad]).all()


@pytest.mark.parametrize(("share", "packet_samples"), [(0.2, 1), (0.5, 4), (1.0, 3)])
def test_filled_samples_lie_on_lines_between_those_that_arrived(share: float, packet_samples: int) -> None:
    block = imu_block()
    fault = Interpolated(topic=LEFT, at_s=3, duration_s=5, share=share, packet_samples=packet_samples)
    stamps, logs, columns = corrupted(block, fault)
    np.testing.assert_array_equal(stamps, block.t_ns)
    assert (np.diff(logs) >= 0).all()
    filled = (columns["angular_rate"] != block.columns["angular_rate"]).any(axis=1)
    assert not filled[~during(stamps, 3, 8)].any()
    assert filled[during(stamps, 3, 8)].mean() == pytest.approx(share, abs=0.12)
    for name, sent in block.columns.items():
        on_lines = [np.interp(stamps, stamps[~filled], axis[~filled]) for axis in sent.T]
        np.testing.assert_allclose(columns[name], np.column_stack(on_lines), atol=1e-9)
    # what is filled arrives with the next that is not
    next_whole = np.flatnonzero(~filled)[np.searchsorted(np.flatnonzero(~filled), np.flatnonzero(filled))]
    np.testing.assert_array_equal(logs[filled], stamps[next_whole])


def test_packets_are_lost_in_fast_motion_alone() -> None:
    block = imu_block()
    limit = np.radians(500)
    fault = Interpolated(topic=LEFT, at_s=0, duration_s=9.5, share=0.5, above_rad_s=limit)
    stamps, _, columns = corrupted(block, fault)
    filled = (columns["angular_rate"] != block.columns["angular_rate"]).any(axis=1)
    is_fast = (np.linalg.norm(block.columns["angular_rate"], axis=1) >= limit) & (stamps < 9_500_000_000)
    assert filled[is_fast].mean() == pytest.approx(0.5, abs=0.07)
    assert not filled[~is_fast].any()


def test_what_nothing_follows_is_not_filled_and_the_first_sample_is_never_lost() -> None:
    block = imu_block(seconds=1)
    stamps, _, _ = corrupted(block, Interpolated(topic=LEFT, at_s=0, share=1.0))
    np.testing.assert_array_equal(stamps, block.t_ns[:1])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), share=st.floats(0.1, 1), packet_samples=st.integers(1, 4))
def test_what_is_repeated_and_out_of_order_is_filled_with_finite_values(seed, share, packet_samples) -> None:
    before = (
        OutOfOrder(topic=LEFT, at_s=0.02),
        Repeat(topic=LEFT, at_s=0.01),
        OutOfOrder(topic=LEFT, at_s=0.03, name="again"),
    )
    fault = Interpolated(topic=LEFT, at_s=0, share=share, packet_samples=packet_samples)
    _, _, columns = corrupted(imu_block(seconds=1), *before, fault, seed=seed)
    assert all(np.isfinite(values).all() for values in columns.values())


def test_lost_packets_do_not_depend_on_where_the_stream_begins() -> None:
    samples = list(imu_block())
    fault = Interpolated(topic=LEFT, at_s=0, share=0.2, packet_samples=5)
    whole = {s.t_ns: s.angular_rate.tobytes() for s in replayed(samples, fault)}
    late = {s.t_ns: s.angular_rate.tobytes() for s in replayed(samples[500:], fault)}
    # the line to the first sample may begin before it
    assert all(whole[t_ns] == value for t_ns, value in list(late.items())[20:])


def test_late_samples_keep_stamps_and_order_and_hold_up_those_after_them() -> None:
    block = imu_block()
    stamps, logs, _ = corrupted(block, Late(topic=LEFT, at_s=3, duration_s=0.5, delay_s=0.25))
    late = during(stamps, 3, 3.5)
    np.testing.assert_array_equal(stamps, block.t_ns)
    np.testing.assert_array_equal(logs[late], stamps[late] + 250_000_000)
    assert (np.diff(logs) >= 0).all()
    assert (logs >= stamps).all()
    np.testing.assert_array_equal(logs[stamps > logs[late][-1]], stamps[stamps > logs[late][-1]])


def test_out_of_order_swaps_neighbours_and_loses_none() -> None:
    block = imu_block()
    stamps, logs, _ = corrupted(block, OutOfOrder(topic=LEFT, at_s=9.8))
    np.testing.assert_array_equal(np.sort(stamps), block.t_ns)
    assert (np.diff(stamps)[stamps[:-1] >= 9_800_000_000] < 0).sum() == 10
    assert (np.diff(logs) >= 0).all()


def test_a_clock_that_jumps_shifts_stamps_but_not_arrivals() -> None:
    block = imu_block()
    stamps, logs, _ = corrupted(block, ClockJump(topic=LEFT, at_s=3, jump_s=-5))
    np.testing.assert_array_equal(logs, block.t_ns)
    np.testing.assert_array_equal(stamps - block.t_ns, np.where(block.t_ns >= 3_000_000_000, -5_000_000_000, 0))


def test_saturation_clips_at_its_share_of_the_parts_full_scale() -> None:
    _, _, columns = corrupted(imu_block(), Saturation(topic=LEFT, at_s=0, fraction=0.5))
    assert abs(columns["angular_rate"]).max() == pytest.approx(np.radians(225))
    assert abs(columns["specific_force"]).max() == pytest.approx(2.5 * 9.80665)


@pytest.mark.parametrize("name", ["MW-AHRSv1-imu", "3DM-GX4-25-imu", "MPU-9250"])
def test_a_part_has_its_own_full_scale_and_not_that_of_a_shorter_name(name: str) -> None:
    worn = load_part(name)
    assert isinstance(worn, ImuPart)
    own = {"angular_rate": worn.gyroscope.range, "specific_force": worn.accelerometer.range}
    assert full_scales(worn.description) == full_scales(f"an {name} of ours") == own


@pytest.mark.parametrize("stuck", [False, True])
def test_a_dead_cell_reads_zero_or_stays(stuck: bool) -> None:
    block = insole_block()
    fault = DeadCell(topic=INSOLE, at_s=3, duration_s=1, cell="medial_ball", stuck=stuck)
    stamps, _, columns = corrupted(block, fault)
    dead = during(stamps, 3, 4)
    assert (columns["force"][dead, 2] == (block.columns["force"][300, 2] if stuck else 0)).all()
    np.testing.assert_array_equal(np.delete(columns["force"], 2, 1), np.delete(block.columns["force"], 2, 1))
    np.testing.assert_array_equal(columns["force"][~dead], block.columns["force"][~dead])


def images(*faults) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    pixels = rng.integers(60, 255, (48, 64, 3)).astype(np.uint8)
    items = [Image(topic=COLOR, t_ns=10, pixels=pixels), Depth(topic=DEPTH, t_ns=10, depth=np.ones((48, 64), "f4"))]
    colour, depth = (a.item for a in arrivals(items, plan_faults(faults, RIG, 1, DURATION_S)))
    return (colour.pixels != pixels).any(axis=2), depth.depth == 0


def test_occlusion_covers_its_share_of_colour_and_of_depth_alike() -> None:
    covered, no_depth = images(Occlusion(topic="/head/*", at_s=0, share=0.25))
    assert covered.mean() == pytest.approx(0.25, abs=0.02)
    np.testing.assert_array_equal(covered, no_depth)


def test_dirt_spoils_spots_and_spares_the_rest() -> None:
    blurred, no_depth = images(LensDirt(topic="/head/*", at_s=0, spots=3, size=0.1))
    assert 0.02 < blurred.mean() < 0.35
    assert 0.01 < no_depth.mean() < blurred.mean()
    assert blurred[no_depth].mean() > 0.95


def test_images_that_share_their_pixels_share_them_behind_dirt() -> None:
    pixels = np.full((48, 64, 3), 90, np.uint8)
    pixels.setflags(write=False)
    own = pixels.copy()
    items = [Image(topic=COLOR, t_ns=t, pixels=p) for t, p in ((10, pixels), (20, own), (30, pixels))]
    first, second, third = (
        a.item.pixels for a in arrivals(items, plan_faults([LensDirt(topic=COLOR, at_s=0)], RIG, 1, DURATION_S))
    )
    assert third is first
    assert not first.flags.writeable
    np.testing.assert_array_equal(first, second)
    assert (own == 90).all()


def replayed(items: list[Sample], *faults, seed: int = 1) -> list[Sample]:
    return list(FaultPlan.of(faults, RIG, seed, DURATION_S).samples(items))


def frames(count: int, depth_m: float = 3.0) -> list[Sample]:
    """Colour and depth of a camera at 10 Hz."""
    return [
        sample
        for t_ns in range(0, count * 100_000_000, 100_000_000)
        for sample in (
            Image(topic=COLOR, t_ns=t_ns, pixels=np.full((48, 64, 3), 250, np.uint8)),
            Depth(topic=DEPTH, t_ns=t_ns, depth=np.full((48, 64), depth_m, np.float32)),
        )
    ]


def depths(samples: list[Sample]) -> np.ndarray:
    return np.array([s.depth for s in samples if isinstance(s, Depth)])


@pytest.mark.parametrize(
    "fault",
    [
        Dropout(topic="/head/*", at_s=0, share=0.3),
        PasserBy(topic="/head/*", at_s=0),
        DepthNoise(topic=DEPTH, at_s=0),
    ],
    ids=lambda f: f.kind,
)
def test_random_choices_depend_on_seed_and_instant_alone(fault) -> None:
    def content(samples: list[Sample]) -> list[tuple]:
        return [(s.topic, s.t_ns, (s.pixels if isinstance(s, Image) else s.depth).tobytes()) for s in samples]

    whole = content(replayed(frames(20), fault))
    assert content(replayed(frames(20)[20:], fault)) == [c for c in whole if c[1] >= 1_000_000_000]
    assert content(replayed(frames(20), fault, seed=2)) != whole
    assert content(replayed(frames(20), replace(fault, name="other"))) != whole


def test_a_share_of_the_frames_is_lost_with_their_depth() -> None:
    samples = replayed(frames(100), Dropout(topic="/head/*", at_s=0, share=0.2))
    colour, depth = ({s.t_ns for s in samples if isinstance(s, kind)} for kind in (Image, Depth))
    assert colour == depth
    assert 0.1 < 1 - len(colour) / 100 < 0.3


def test_exchanged_streams_arrive_under_the_other_topic() -> None:
    planned = plan_faults([Exchange(topic="/foot_*/imu")], RIG, 0, DURATION_S)
    got = list(arrivals([imu_block(LEFT), imu_block(RIGHT)], planned))
    assert [(a.topic, len(a.item)) for a in got] == [(RIGHT, 1000), (LEFT, 1000)]
    np.testing.assert_array_equal(got[0].item.columns["angular_rate"], imu_block(LEFT).columns["angular_rate"])


def test_a_level_of_clipping_concerns_only_what_it_names() -> None:
    block = imu_block()
    _, _, columns = corrupted(block, Saturation(topic=LEFT, at_s=0, accelerometer_mps2=20.0))
    np.testing.assert_array_equal(columns["angular_rate"], block.columns["angular_rate"])
    np.testing.assert_array_equal(columns["specific_force"], np.clip(block.columns["specific_force"], -20, 20))


def test_all_cells_of_an_insole_are_dead() -> None:
    _, _, columns = corrupted(insole_block(), DeadCell(topic=INSOLE, at_s=3, cell="all"))
    assert (columns["force"][300:] == 0).all()
    _, _, stuck = corrupted(insole_block(), DeadCell(topic=INSOLE, at_s=3, cell="all", stuck=True))
    assert (stuck["force"][300:] == insole_block().columns["force"][300]).all()


def test_the_zero_of_an_insole_drifts_and_stays() -> None:
    block = insole_block()
    _, _, columns = corrupted(block, Offset(topic=INSOLE, at_s=2, offset_n=-3, drift_n_per_s=3, drift_s=4))
    since_s = block.t_ns * 1e-9 - 2
    offset_n = np.where(since_s < 0, 0, -3 + 3 * np.clip(since_s, 0, 4))
    np.testing.assert_allclose(columns["force"] - block.columns["force"], np.outer(offset_n, np.ones(4)), atol=1e-9)


def test_an_encoder_slips_and_a_heading_drifts_without_tilt() -> None:
    angles = [Encoder(topic=KNEE, t_ns=t * 10**9, angle=0.5) for t in (1, 9)]
    slipped = replayed(angles, Offset(topic=KNEE, at_s=6, offset_rad=np.radians(2)))
    assert [s.angle for s in slipped] == pytest.approx([0.5, 0.5 + np.radians(2)])
    level = Ahrs(topic=BACK, t_ns=9 * 10**9, q_world_sensor=np.array([1.0, 0, 0, 0]), angular_rate=np.zeros(3))
    (drifted,) = replayed([level], Offset(topic=BACK, at_s=3, drift_rad_s=np.radians(1 / 60)))
    w, x, y, z = drifted.q_world_sensor
    assert 2 * np.degrees(np.arctan2(z, w)) == pytest.approx(0.1)
    assert (x, y) == pytest.approx((0.0, 0.0))


def test_depth_gets_its_noise_and_nothing_stays_nothing() -> None:
    items = [replace(s, depth=np.where(np.arange(64) < 8, 0, s.depth)) for s in frames(40) if isinstance(s, Depth)]
    noisy = depths(replayed(items, DepthNoise(topic=DEPTH, at_s=0, noise_per_m=0.01)))
    assert np.std(noisy[:, :, 8:] - 3) == pytest.approx(0.01 * 9.0, rel=0.05)
    assert (noisy[:, :, :8] == 0).all()
    assert noisy.dtype == np.float32


def test_darkness_leaves_noise_in_colour_and_keeps_depth() -> None:
    clean, dark = frames(3), replayed(frames(3), Darkness(topic="/head/*", at_s=0, light=0.02, noise=1.5))
    np.testing.assert_array_equal(depths(dark), depths(clean))
    pixels = [s.pixels.astype(float) for s in dark if isinstance(s, Image)]
    bright = next(s.pixels for s in clean if isinstance(s, Image)).astype(float)
    assert np.mean(pixels) == pytest.approx(0.02 * bright.mean() + 1.5, abs=0.3)
    assert np.std(pixels[0] - pixels[1]) == pytest.approx(1.5 * np.sqrt(2), rel=0.1)  # new noise in each


def test_a_view_that_is_too_high_keeps_its_share_of_the_ground() -> None:
    (depth,) = depths(replayed(frames(1), HighView(topic=DEPTH, at_s=0, share=0.25)))
    assert (depth[:11] == 3).all()
    assert (depth[12:] == 0).all()


def test_a_passer_by_covers_the_share_in_colour_and_depth_and_moves() -> None:
    samples = replayed(frames(90), PasserBy(topic="/head/*", at_s=0, share=0.3, distance_m=1.2))
    near = depths(samples) < 2.0
    assert near.mean(axis=(1, 2)).max() == pytest.approx(0.3, abs=0.03)
    columns = [np.flatnonzero(frame.any(axis=0)).mean() for frame in near]
    assert max(columns) - min(columns) > 15
    pixels = np.array([s.pixels for s in samples if isinstance(s, Image)])
    np.testing.assert_array_equal((pixels != 250).any(axis=3), near)
    grey = [Image(topic=COLOR, t_ns=0, pixels=np.full((48, 64), 250, np.uint8))]
    assert replayed(grey, PasserBy(topic=COLOR, at_s=0))[0].pixels.shape == (48, 64)


def test_a_floor_that_mirrors_loses_depth_or_shows_the_ceiling() -> None:
    down = np.array([0.0, 1.0, 0.0, 0.0])  # the optical axis points down: x forward, y right
    eye = Odometry(
        topic="/truth/head/imu/odometry",
        t_ns=0,
        p_frame_in_world=np.array([0.0, 0, 1.5]),
        q_world_frame=down,
        v_frame_in_world=np.zeros(3),
        angular_rate=np.zeros(3),
    )
    fault = MirrorFloor(topic=DEPTH, at_s=0, holes=0.3, mirrored=0.2)
    first, _, depth = replayed([eye, *frames(1, 1.5)], fault)
    assert first is eye
    assert set(np.unique(depth.depth)) == {np.float32(x) for x in (0.0, 1.5, 3.9)}
    assert (depth.depth == 0).mean() == pytest.approx(0.3, abs=0.15)
    assert (depth.depth > 3).mean() == pytest.approx(0.2, abs=0.12)
    assert (depths(replayed([eye, *frames(1, 1.0)], fault)) == 1.0).all()  # no floor at this distance
    assert (depths(replayed(frames(1, 1.5), fault)) == 1.5).all()  # where it is unknown


@given(offset_s=st.floats(-0.1, 0.1))
def test_a_camera_is_off_its_imu_by_what_the_fault_says(offset_s) -> None:
    plan = FaultPlan.of([Miscalibration(topic=COLOR, clock_offset_s=offset_s)], RIG, 0, DURATION_S)
    nominal = RIG.cameras[COLOR].timeshift_cam_imu_s
    assert plan.rig.cameras[COLOR].timeshift_cam_imu_s == pytest.approx(nominal + offset_s, abs=1e-12)


def test_errors_of_the_calibration_are_where_the_fault_says() -> None:
    faults = (
        Miscalibration(topic=COLOR, rotation_rad=(0.02, 0, 0), translation_m=(0, 0.01, 0), clock_offset_s=0.01),
        Miscalibration(topic="/foot_*/imu", gyroscope_rad_s=5.0),
    )
    plan = FaultPlan.of(faults, RIG, 0, DURATION_S)
    T = plan.rig.cameras[COLOR].mount.T_body_sensor
    assert np.arccos((np.trace(T[:3, :3]) - 1) / 2) == pytest.approx(0.02)
    np.testing.assert_allclose(T[:3, 3], [0, 0.01, 0])
    assert plan.rig.cameras[COLOR].timeshift_cam_imu_s == 0.01
    assert [plan.rig.imus[t].gyroscope_range for t in (LEFT, RIGHT, "/head/imu")] == [5.0, 5.0, 0.0]
    assert plan.rig.imus[LEFT].accelerometer_range == 0.0
    assert [(e.from_ns, e.until_ns) for e in plan.planned[0][1][COLOR]] == [(0, 10_000_000_001)]
    items = [imu_block(LEFT)]
    assert [a.item for a in plan.arrivals(items)] == items


def test_poses_have_the_topic_of_the_estimators() -> None:
    assert base.POSES == POSES
    ((_, events),) = plan_faults([Restart(topic="/poses", at_s=3, duration_s=2)], RIG, 0, DURATION_S)
    assert set(events) == {POSES}
    assert POSES not in plan_faults([Dropout(topic="*", at_s=0)], RIG, 0, DURATION_S)[0][1]


def test_what_is_overtaken_last_still_arrives_through_the_faults_after_it() -> None:
    block = imu_block(seconds=0.05)
    twice = OutOfOrder(topic=LEFT, at_s=0.04), OutOfOrder(topic=LEFT, at_s=0.03, name="other"), Late(topic=LEFT, at_s=0)
    stamps, logs, _ = corrupted(block, *twice)
    np.testing.assert_array_equal(np.sort(stamps), block.t_ns)
    assert (np.diff(logs) >= 0).all()


FAULTS = (
    Dropout(topic=LEFT, rate_per_min=60, duration_s=0.1),
    Freeze(topic=LEFT, rate_per_min=30, duration_s=0.2),
    Repeat(topic=LEFT, rate_per_min=30, duration_s=0.1),
    Nan(topic=LEFT, rate_per_min=30, duration_s=0.05),
    Late(topic=LEFT, rate_per_min=30, duration_s=0.2),
    Interpolated(topic=LEFT, rate_per_min=30, duration_s=1.5, share=0.5, packet_samples=3, above_rad_s=5.0),
    OutOfOrder(topic=LEFT, rate_per_min=30, duration_s=0.15),
    ClockJump(topic=LEFT, rate_per_min=10, duration_s=0.5, jump_s=0.3),
    Saturation(topic=LEFT, at_s=0),
)


@settings(max_examples=20, deadline=None)
@given(
    faults=st.lists(st.sampled_from(FAULTS), unique=True, max_size=5),
    seed=st.integers(0, 2**32),
    size=st.integers(1, 1000),
)
def test_any_faults_together_give_the_same_arrivals_however_the_stream_is_cut(faults, seed, size) -> None:
    block = imu_block(seconds=3)
    whole, pieces = corrupted(block, *faults, seed=seed, size=10**6), corrupted(block, *faults, seed=seed, size=size)
    for a, b in zip((*whole[:2], *whole[2].values()), (*pieces[:2], *pieces[2].values()), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (np.diff(whole[1]) >= 0).all()


def test_what_no_fault_is_about_passes_as_it_is() -> None:
    blocks = [imu_block(RIGHT), insole_block()]
    got = list(arrivals(blocks, plan_faults(FAULTS, RIG, 0, DURATION_S)))
    assert [a.item for a in got] == blocks
    assert all(a.log_ns is None for a in got)


def test_one_fault_more_moves_no_event_of_the_others() -> None:
    alone = [events for _, events in plan_faults(FAULTS[:1], RIG, 4, 600.0)]
    among = [events for _, events in plan_faults(FAULTS[::-1], RIG, 4, 600.0)]
    assert among[-1] == alone[0]
    assert plan_faults(FAULTS[:1], RIG, 5, 600.0)[0][1] != alone[0]
    named = plan_faults([replace(FAULTS[0], name="other")], RIG, 4, 600.0)[0][1]
    assert named != alone[0]


def test_random_events_come_at_their_rate_and_do_not_overlap() -> None:
    ((_, events),) = plan_faults([Dropout(topic="/foot_*/imu", rate_per_min=12, duration_s=0.5)], RIG, 1, 3600.0)
    assert set(events) == {LEFT, RIGHT}
    assert events[LEFT] != events[RIGHT]
    for own in events.values():
        # a gap of 5 s on average, then half a second of event
        assert len(own) == pytest.approx(3600 / 5.5, rel=0.1)
        assert all(a.until_ns < b.from_ns for a, b in pairwise(own))


def test_what_hangs_together_slips_together() -> None:
    ((_, events),) = plan_faults([LooseStrap(topic="/head/imu", rate_per_min=6, duration_s=1)], RIG, 1, 100.0)
    assert set(events) == {"/head/imu", COLOR, DEPTH}
    assert len({tuple((e.from_ns, e.key) for e in own) for own in events.values()}) == 1


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ([Nan(topic=COLOR, at_s=1)], r"faults\[0\]\.topic: invalid '/head/color': expected .*/foot_l/imu"),
        ([Occlusion(topic="/foot_*/imu", at_s=1)], r"faults\[0\]\.topic: .*expected /head/color, /head/depth"),
        ([Saturation(topic="/foot_l/sonar", at_s=1)], r"expected .*/foot_l/imu, /foot_l/insole"),
        ([Dropout(topic="/foot_l/imv", at_s=1)], r"invalid '/foot_l/imv'"),
        (
            [Dropout(topic=LEFT, at_s=1), Dropout(topic=LEFT, at_s=2)],
            r"faults\[1\]\.name: invalid 'dropout /foot_l/imu'",
        ),
    ],
)
def test_faults_that_cannot_be_are_refused_by_name(faults, words) -> None:
    with pytest.raises(ConfigError, match=words) as error:
        check_faults("mine.yaml", faults, RIG)
    assert str(error.value).startswith("mine.yaml: ")


REFUSED = {
    Repeat(topic=LEFT, at_s=3, duration_s=0.5): "the stamp is not after the previous one",
    Nan(topic=LEFT, at_s=3, duration_s=0.5): "NaN or infinity",
    OutOfOrder(topic=LEFT, at_s=3, duration_s=0.5): "the stamp is not after the previous one",
    ClockJump(topic=LEFT, at_s=3, jump_s=-5.0): "the stamp is not after the previous one",
    ClockJump(topic=LEFT, at_s=3, jump_s=3600.0): "Hz where the rig declares",
    Dropout(topic=LEFT, at_s=3, duration_s=5): "Hz where the rig declares",
}
HARMLESS = (
    Dropout(topic=LEFT, at_s=3, duration_s=0.5),
    Freeze(topic=LEFT, at_s=3, duration_s=0.5),
    Late(topic=LEFT, at_s=3, duration_s=0.5),
    Saturation(topic=LEFT, at_s=3),
)


@pytest.mark.parametrize("fault", [*REFUSED, *HARMLESS], ids=lambda f: f.full_name)
def test_a_recording_with_a_fault_is_refused_by_name_or_read_and_always_read_leniently(tmp_path, fault) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, RIG) as writer:
        sent = [block for pair in zip(cut(imu_block(), 200), cut(imu_block(RIGHT), 200)) for block in pair]
        for arrival in arrivals(sent, plan_faults([fault], RIG, 0, DURATION_S)):
            writer.write(arrival.item, arrival.log_ns)
    if fault in REFUSED:
        with pytest.raises(RecordingError, match=f"{LEFT} at .*{REFUSED[fault]}.*--lenient"):
            Recording(path)
    else:
        assert not Recording(path).problems
    recording = Recording(path, lenient=True)
    assert (np.diff([s.t_ns for s in recording.samples()]) >= 0).all()
    block = recording.block(LEFT)
    assert (np.diff(block.t_ns) > 0).all()
    assert all(np.isfinite(values).all() for values in block.columns.values())
