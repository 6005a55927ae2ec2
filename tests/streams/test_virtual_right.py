"""The right view of a stereo pair that is made from depth."""

import cv2
import numpy as np
import pytest
from rigs import small_rig

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.euroc import make_right_camera, render_right_view

FOCAL, BASELINE, SIZE = 200.0, 0.1, (120, 160)


def texture(x, y):
    return 128 + 60 * np.sin(x * 9) + 60 * np.cos(y * 7 + x)


def seen(depth, shift_m):
    """A camera `shift_m` to the right looks at a textured surface whose depth follows from the ray's slope."""
    v, u = np.indices(SIZE)
    z = depth(u, shift_m)
    x = (u - 79.5) / FOCAL * z + shift_m
    return np.clip(texture(x, (v - 59.5) / FOCAL * z), 0, 255).astype(np.uint8), z.astype(np.float32)


@pytest.mark.parametrize("z", [0.8, 1.7, 4.0])
def test_a_wall_is_seen_as_from_the_right(z):
    left, depth = seen(lambda u, _: np.full(SIZE, z), 0.0)
    expected, _ = seen(lambda u, _: np.full(SIZE, z), BASELINE)
    inside = slice(0, SIZE[1] - int(FOCAL * BASELINE / z) - 2)
    off = np.abs(render_right_view(left, depth, FOCAL, BASELINE)[:, inside].astype(int) - expected[:, inside])
    assert off.mean() < 1.0


def test_a_slanted_wall_is_seen_as_from_the_right():
    def slanted(u, shift):  # z = 2 + 0.5 x in the left camera's frame
        return (2 + 0.5 * shift) / (1 - 0.5 * (u - 79.5) / FOCAL)

    left, depth = seen(slanted, 0.0)
    expected, _ = seen(slanted, BASELINE)
    off = np.abs(render_right_view(left, depth, FOCAL, BASELINE)[:, 2:140].astype(int) - expected[:, 2:140])
    assert off.mean() < 1.5


def test_what_is_near_hides_what_is_far_and_leaves_background_behind():
    left = np.full(SIZE, 50, np.uint8)
    depth = np.full(SIZE, 4.0, np.float32)
    left[:, 60:100], depth[:, 60:100] = 200, 1.0
    right = render_right_view(left, depth, FOCAL, BASELINE)
    assert (right[:, 42:78] == 200).all()
    assert (right[:, 82:150] == 50).all()
    assert (right[:, :38] == 50).all()


def test_images_without_depth_stay_where_they_are():
    colour = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), np.uint8)
    np.testing.assert_array_equal(render_right_view(colour, np.zeros(SIZE, np.float32), FOCAL, BASELINE), colour)


def test_stereo_matching_finds_the_depth_again():
    rng = np.random.default_rng(4)
    left = cv2.GaussianBlur(rng.integers(0, 256, SIZE, np.uint8), (0, 0), 1.0)
    depth = np.full(SIZE, 1.25, np.float32)
    matcher = cv2.StereoSGBM.create(0, 32, 5)
    disparity = matcher.compute(left, render_right_view(left, depth, FOCAL, BASELINE)) / 16
    assert np.median(disparity[20:100, 50:150]) == pytest.approx(16.0, abs=0.1)


def test_cameras_that_cannot_have_a_right_one_are_refused():
    camera = small_rig().cameras["/head/color"]
    with pytest.raises(StrideTwinError, match=r"distortion: .*without distortion"):
        make_right_camera(camera, 0.1, "/r")
    with pytest.raises(StrideTwinError, match=r"--stereo-baseline: invalid 2.0: .*0\.001 to 1 m"):
        make_right_camera(camera, 2.0, "/r")
