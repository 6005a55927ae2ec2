from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import DepthSensor, Imager
from stridetwin.sim.parts.library import load_part, make_ideal
from stridetwin.sim.rendering.imager import SPARE, ImageSensor, RenderedLens
from stridetwin.sim.rendering.stereo_depth import DepthModel
from stridetwin.sim.rendering.sweep import Sweep
from stridetwin.streams.rig import CameraCalibration, Mount

SHOE: Imager = load_part("acA800-200gc").imager
D455 = load_part("D455")


def sensor(imager=SHOE, light=1.0, shape=(200, 300)):
    return ImageSensor(shape, imager, light, Noise.of_topic(1, "/foot_l/camera"))


def flat(level, shape=(200, 300)):
    return np.full(shape, level, np.uint8)


@pytest.mark.parametrize("level", [20, 90, 200])
@pytest.mark.parametrize("light", [1.0, 0.1])
def test_shot_and_read_noise_follow_the_electrons(level, light):
    bare = replace(SHOE, vignetting=0.0)
    seen = sensor(bare, light).expose(1, flat(level)).astype(float)
    electrons = level / 255 * bare.full_well * light
    sd = 255 / bare.full_well * np.sqrt(electrons + bare.read_noise**2)
    assert seen.mean() == pytest.approx(level * light, abs=0.6)
    if level * light > 4 * sd:  # else black clips it
        assert seen.std() == pytest.approx(np.hypot(sd, 1 / np.sqrt(12)), rel=0.1)


def test_automatic_exposure_makes_low_light_bright_and_noisy_after_its_lag():
    imager = replace(D455.imager, vignetting=0.0)
    camera = sensor(imager, shape=(200, 300, 3))
    frame_ns = 33_333_333
    bright = [camera.expose(k * frame_ns, flat(200, (200, 300, 3))).mean() for k in range(3)]
    assert bright[-1] == pytest.approx(0.45 * 255, rel=0.02)
    dark = [camera.expose(k * frame_ns, flat(20, (200, 300, 3))) for k in range(3, 60)]
    means = np.array([p.mean() for p in dark])
    assert means[0] < 20
    assert np.all(np.diff(means[:20]) > 0)
    assert means[-1] == pytest.approx(0.45 * 255, rel=0.05)
    after = int(np.argmax(np.log(means / means[0]) > (1 - np.exp(-1)) * np.log(means[-1] / means[0])))
    assert after * frame_ns * 1e-9 == pytest.approx(imager.auto_exposure_s, rel=0.25)
    # the same level, of fewer electrons
    dim = sensor(replace(imager, auto_exposure_s=1e-9), 0.02, (200, 300, 3)).expose(1, flat(200, (200, 300, 3)))
    lit = sensor(replace(imager, auto_exposure_s=1e-9), 1.0, (200, 300, 3)).expose(1, flat(200, (200, 300, 3)))
    assert dim.mean() == pytest.approx(lit.mean(), rel=0.05)
    assert dim.std() > 4 * lit.std()


def test_corners_are_darker_by_the_vignetting_and_an_ideal_sensor_changes_nothing():
    seen = sensor(replace(SHOE, full_well=np.inf, read_noise=0.0), shape=(600, 800)).expose(1, flat(200, (600, 800)))
    assert seen[0, 0] == pytest.approx(200 * (1 - SHOE.vignetting), abs=2)
    assert seen[300, 400] == 200
    clean = np.random.default_rng(0).integers(0, 256, (200, 300), dtype=np.uint8)
    np.testing.assert_array_equal(sensor(make_ideal(load_part("acA800-200gc")).imager).expose(1, clean), clean)


@pytest.mark.parametrize("shape", [(60, 80), (60, 80, 3)])
def test_levels_are_those_of_the_formula(shape):
    clean = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    imager, light = replace(SHOE, vignetting=0.3, read_noise=9.0, full_well=5000.0), 0.8
    noise = Noise.of_topic(4, "/camera")
    measured = ImageSensor(shape, imager, light, noise).expose(7, clean)
    normal = Noise.of_topic(4, "/camera").normal(1.0, (60 + SPARE, 80 + SPARE, *shape[2:]))
    row, column = noise.at(7).integers((SPARE, SPARE))
    level = np.moveaxis(clean, -1, 0).astype(float) if len(shape) == 3 else clean.astype(float)
    grain = np.moveaxis(normal, -1, 0) if len(shape) == 3 else normal
    v, u = np.mgrid[:60, :80]
    r2 = ((u - 39.5) ** 2 + (v - 29.5) ** 2) / (30**2 + 40**2)
    electrons = level / 255 * imager.full_well * light
    sd = 255 / (imager.full_well * light) * np.sqrt(electrons + imager.read_noise**2)
    bright = level / (1 + ((1 - 0.3) ** -0.5 - 1) * r2) ** 2 + sd * grain[..., row : row + 60, column : column + 80]
    expected = np.clip(np.rint(light * bright), 0, 255)
    expected = np.moveaxis(expected, 0, -1) if len(shape) == 3 else expected
    assert np.abs(measured - expected).max() <= 1
    assert np.mean(measured != expected) < 0.001  # rounding


def test_noise_is_that_of_the_instant_and_does_not_wrap_round():
    a, b = sensor(), sensor()
    b.expose(2, flat(90))
    np.testing.assert_array_equal(a.expose(1, flat(90)), b.expose(1, flat(90)))
    assert not np.array_equal(a.expose(1, flat(90)), a.expose(2, flat(90)))
    for level in (0, 255):
        assert np.abs(sensor(replace(SHOE, vignetting=0.0)).expose(1, flat(level)).astype(int) - level).max() < 30


def test_a_part_has_the_noise_of_its_place_in_the_image():
    whole, part = sensor().expose(1, flat(90)), sensor().expose(1, flat(90)[40:90, 100:180], 40, 100)
    np.testing.assert_array_equal(whole[40:90, 100:180], part)


def sweep(velocity=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0), distance=0.4, focal=540.0):
    K = np.array([[focal, 0, 149.5], [0, focal, 99.5], [0, 0, 1.0]])
    return Sweep(K=K, normal=np.array([0, 0, 1.0]), distance=distance, velocity=np.array(velocity), rate=np.array(rate))


@settings(max_examples=25, deadline=None)
@given(speed=st.floats(0.5, 5.0), away=st.floats(0.2, 0.6), exposure=st.floats(0.0005, 0.002))
def test_blur_is_as_long_as_speed_times_exposure_times_focal_length_over_distance(speed, away, exposure):
    moving = sweep(velocity=(speed, 0.0, 0.0), distance=away)
    expected = speed * exposure * 540.0 / away
    assert moving.path_px(exposure, 149.5, 99.5) == pytest.approx(expected, rel=1e-9)
    edge = np.zeros((200, 300), np.uint8)
    edge[:, 150:] = 255
    row = moving.blur(edge, exposure)[100].astype(float) / 255
    if expected > 2:  # a step becomes a ramp of that length, whose variance is length² / 12
        density = np.clip(np.diff(row), 0, None)
        at = np.arange(len(density))
        middle = np.sum(at * density) / density.sum()
        assert np.sqrt(12 * np.sum((at - middle) ** 2 * density) / density.sum()) == pytest.approx(expected, abs=1.2)
        assert middle == pytest.approx(149, abs=0.7)  # the middle of the exposure


def test_a_rolling_shutter_leans_what_moves_sideways():
    line = np.zeros((200, 300), np.uint8)
    line[:, 149:152] = 255
    moving = sweep(velocity=(1.0, 0.0, 0.0))
    rolled = moving.apply_rolling_shutter(line, 0.02)
    column = [np.average(np.arange(300), weights=r) for r in rolled[[0, 100, 199]].astype(float)]
    assert column[1] == pytest.approx(150, abs=0.3)
    assert column[2] - column[0] == pytest.approx(0.02 * 540 / 0.4, abs=0.5)


@pytest.mark.parametrize("model", ["radtan", "equidistant"])
def test_a_distorted_image_is_where_the_calibration_says(model):
    calibration = CameraCalibration(
        topic="/c",
        part="",
        rate_hz=1.0,
        mount=Mount(body="b"),
        width=320,
        height=240,
        intrinsics=(200.0, 200.0, 159.5, 119.5),
        distortion_model=model,
        distortion=(-0.25, 0.06, 0.001, -0.002) if model == "radtan" else (0.02, -0.01, 0.0, 0.0),
    )
    lens = RenderedLens(calibration)
    point = np.array([[[0.45, -0.3, 1.0]]])
    fu, fv, pu, pv = lens.intrinsics
    straight = np.zeros((lens.height, lens.width), np.uint8)
    u, v = fu * 0.45 + pu, fv * -0.3 + pv
    cv2.circle(straight, (round(u * 16), round(v * 16)), 64, 255, -1, shift=4)
    bent = lens.distort(straight).astype(float)
    rows, columns = np.mgrid[:240, :320]
    found = np.array([(columns * bent).sum(), (rows * bent).sum()]) / bent.sum()
    project = cv2.projectPoints if model == "radtan" else cv2.fisheye.projectPoints
    if model == "radtan":
        measured, _ = project(point, np.zeros(3), np.zeros(3), calibration.K, np.array(calibration.distortion))
    else:
        measured, _ = project(point, np.zeros(3), np.zeros(3), calibration.K, np.array(calibration.distortion))
    np.testing.assert_allclose(found, np.ravel(measured), atol=0.3)


def depth_model(sensor: DepthSensor = D455.depth, seed=1, shape=(240, 320)):
    return DepthModel(shape, 192.0, (159.5, 119.5), sensor, Noise.of_topic(seed, "/head/depth"))


@pytest.mark.parametrize("z", [0.6, 1.0, 2.0, 4.0])
def test_depth_residuals_grow_with_the_square_of_the_range(z):
    model = depth_model()
    measured = np.stack([model.image(k, np.full((240, 320), z, np.float32)) for k in range(8)])
    kept = measured[(measured > 0) & (measured < 6)]
    sensor = D455.depth
    step = sensor.disparity_step * z * z
    expected = np.sqrt((sensor.noise * z * z) ** 2 + step**2 / 12 + sensor.resolution**2 / 12)
    assert kept.std() == pytest.approx(expected, rel=0.1)
    assert abs(kept.mean() - z) < 0.15 * expected + 0.01 * z * z * sensor.noise + 0.003 * z
    np.testing.assert_allclose(kept * 1000, np.round(kept * 1000), atol=2e-3)


def test_there_is_no_depth_too_near_too_far_in_the_sky_on_black_or_at_a_glance():
    depth = np.full((240, 320), 2.0, np.float32)
    depth[:80, :100], depth[:80, 100:200], depth[:80, 200:] = D455.depth.range_min / 2, D455.depth.range_max + 2, 0
    grey = np.full((240, 320), 128, np.uint8)
    grey[160:, :] = 2
    measured = depth_model().image(1, depth, grey)
    for columns in (slice(0, 95), slice(105, 195), slice(205, 320)):  # away from outlines
        assert np.all(measured[:75, columns] == 0)
    assert np.all(measured[162:] == 0)
    assert np.mean(measured[90:150, 10:-10] > 0) > 0.99
    v = (np.mgrid[:240, :320][0] - 119.5) / 192.0
    for degrees, share in ((5.0, 0.0), (30.0, 1.0)):
        slope = np.radians(degrees)  # a floor that falls away from the line of sight in the middle by this angle
        floor = (0.8 * np.sin(slope) / (np.sin(slope) + v * np.cos(slope) + 1e-9)).astype(np.float32)
        seen = (depth_model().image(1, floor) > 0)[112:128, 20:-20]
        assert np.mean(seen) == pytest.approx(share, abs=0.1)


def test_what_is_nearer_than_the_finest_steps_resolve_has_no_depth():
    sensor = replace(D455.depth, range_min=0.1, disparity_step=1e-4)
    near, far = (depth_model(sensor).image(1, np.full((240, 320), z, np.float32)) for z in (0.2, 0.5))
    assert not near.any()  # 1 / (1e-4 * 32767) is 0.305 m
    assert np.median(far[far > 0]) == pytest.approx(0.5, abs=0.01)


def test_beside_an_outline_depth_is_missing_or_between_the_surfaces():
    depth = np.full((240, 320), 1.0, np.float32)
    depth[:, 160:] = 2.0
    measured = depth_model(replace(D455.depth, noise=1e-5)).image(1, depth)
    beside = measured[:, 156:164]
    assert 0.2 < np.mean(beside == 0) < 0.8
    between = (beside > 1.05) & (beside < 1.9)
    assert 0.01 < between.mean() < 0.6
    assert np.all(measured[:, :150] > 0)


def test_measured_depth_is_that_of_the_formula():
    rng = np.random.default_rng(5)
    depth = np.where(rng.random((240, 320)) < 0.02, 0, rng.uniform(0.8, 1.2)).astype(np.float32)
    depth[60:180, 100:200] *= 1.6
    sensor, noise = D455.depth, Noise.of_topic(1, "/head/depth")
    model = depth_model()
    measured = model.image(3, depth)
    row, column = noise.at(3).integers((SPARE, SPARE))
    cut = (slice(row, row + 240), slice(column, column + 320))
    counts = np.where(depth > 0, np.float32(1 / sensor.disparity_step) / np.where(depth > 0, depth, 1), 0)
    counts = counts.astype(np.float32)
    window = 2 * round(sensor.edge_px) + 1
    discontinuity = np.abs(counts - cv2.blur(counts, (window, window))) > np.float32(0.012) * counts
    plain = (depth > 0) & ~discontinuity & (measured > 0)
    steps = np.rint(counts + model._bank[cut])
    expected = sensor.resolution * np.round(1 / (sensor.disparity_step * np.maximum(steps, 1)) / sensor.resolution)
    np.testing.assert_allclose(measured[plain], expected[plain], rtol=1e-6)
    assert plain.mean() > 0.1
    assert np.all(measured[depth == 0] == 0)
    missing = model._mixed[cut] > 0
    assert np.all(measured[discontinuity & missing] == 0)
    far, near = (
        cv2.erode(counts[::2, ::2].copy(), np.ones((3, 3))),
        cv2.dilate(counts[::2, ::2].copy(), np.ones((3, 3))),
    )
    flying = discontinuity & ~missing & (measured > 0)
    count = 1 / (sensor.disparity_step * measured[flying])
    spread = 5 * model._bank.std() + 1
    assert np.all(count > np.repeat(np.repeat(far, 2, 0), 2, 1)[flying] - spread)
    assert np.all(count < np.repeat(np.repeat(near, 2, 0), 2, 1)[flying] + spread)


def test_ideal_depth_is_exact_within_its_range():
    depth = np.linspace(0.1, 8.0, 240 * 320, dtype=np.float32).reshape(240, 320)
    measured = depth_model(make_ideal(D455).depth).image(1, depth)
    within = (depth >= D455.depth.range_min) & (depth <= D455.depth.range_max)
    np.testing.assert_array_equal(measured[within], depth[within])
    assert np.all(measured[~within] == 0)
