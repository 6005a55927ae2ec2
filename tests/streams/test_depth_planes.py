"""Floor and walls in depth images show the focal length, and the floor the unit of depth."""

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.streams.depth_planes import (
    find_implausible_planes,
    find_planes,
    measure_camera_height,
    measure_focal_ratio,
)
from stridetwin.streams.rig import CameraCalibration, Mount

WIDTH, HEIGHT, F = 320, 240, 200.0
CAMERA = CameraCalibration(
    topic="/head/color",
    part="",
    rate_hz=30.0,
    mount=Mount(body="head"),
    width=WIDTH,
    height=HEIGHT,
    intrinsics=(F, F, (WIDTH - 1) / 2, (HEIGHT - 1) / 2),
    depth_topic="/head/depth",
)


def look(pitch_deg=25.0, height_m=1.6, wall_m=2.5, yaw_deg=0.0, seed=0):
    """Depth (H, W) m of a camera that looks down by an angle at a floor and at a wall ahead, with stereo noise."""
    pitch, yaw = np.radians((pitch_deg, yaw_deg))
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    x, y = (u - (WIDTH - 1) / 2) / F, (v - (HEIGHT - 1) / 2) / F
    down, level = np.cos(pitch) * y + np.sin(pitch), np.cos(pitch) - np.sin(pitch) * y
    ahead = np.cos(yaw) * level + np.sin(yaw) * x
    inverse = np.maximum(down / height_m, ahead / wall_m)
    inverse = inverse + np.random.default_rng(seed).normal(0, 0.005, inverse.shape)
    return np.where(inverse > 0.15, 1 / inverse, 0.0)


def views(camera=CAMERA, factor=1.0, **scene):
    return [
        find_planes(factor * look(pitch, seed=i, **scene), camera)
        for i, pitch in enumerate((20, 22, 24, 26, 28, 30, 32))
    ]


def scaled(factor):
    fu, fv, pu, pv = CAMERA.intrinsics
    return replace(CAMERA, intrinsics=(factor * fu, factor * fv, pu, pv))


def test_a_sound_camera_is_plausible():
    planes = views()
    assert measure_camera_height(planes) == pytest.approx(1.6, abs=0.03)
    assert measure_focal_ratio(planes).ratio == pytest.approx(1.0, abs=0.03)
    assert not list(find_implausible_planes(planes, CAMERA))


@pytest.mark.parametrize("factor", [0.7, 0.85, 1.15, 1.4])
@pytest.mark.parametrize("yaw_deg", [0.0, 25.0])
def test_a_wrong_focal_length_bends_the_angle_of_floor_and_wall(factor, yaw_deg):
    (fault,) = find_implausible_planes(views(scaled(factor), yaw_deg=yaw_deg), scaled(factor))
    assert fault.field == "intrinsics"
    assert float(fault.valid.split("as with ")[1].split(" ")[0]) == pytest.approx(F, rel=0.03)


@pytest.mark.parametrize(
    ("factor", "advice"), [(2.0, "with 0.5 times"), (5.0, "with 0.2 times"), (0.1, "with 10 times")]
)
def test_a_floor_at_another_height_is_named_with_the_unit(factor, advice):
    (fault,) = find_implausible_planes(views(factor=factor), CAMERA, 1000.0)
    assert fault.field == "depth"
    assert advice in fault.valid
    assert "--depth-scale" in fault.valid


def test_a_shoe_may_be_near_the_floor():
    shoe = replace(CAMERA, mount=Mount(body="foot_l"))
    assert not list(find_implausible_planes(views(shoe, height_m=0.15), shoe))


@pytest.mark.parametrize(
    "depth", [np.zeros((HEIGHT, WIDTH)), np.full((HEIGHT, WIDTH), np.nan), np.ones((1, 1)), np.zeros((0, 0))]
)
def test_images_without_planes_say_nothing(depth):
    assert not list(find_implausible_planes([find_planes(depth, CAMERA)] * 8, CAMERA))


def test_a_floor_without_walls_shows_no_focal_length():
    planes = [find_planes(look(pitch, wall_m=100.0), CAMERA) for pitch in (20, 25, 30, 35)]
    assert measure_focal_ratio(planes) is None
