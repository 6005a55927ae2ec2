"""Directions in which the pixels of a camera look."""

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.streams.rays import find_rays
from stridetwin.streams.rig import CameraCalibration, Mount

CAMERA = CameraCalibration(
    topic="/head/color",
    part="",
    rate_hz=30,
    mount=Mount(body="head", T_body_sensor=np.eye(4)),
    width=640,
    height=480,
    intrinsics=(500.0, 400.0, 319.5, 239.5),
)


def test_without_distortion_a_ray_is_the_distance_from_the_centre_over_the_focal_length():
    pixels = np.array([[319.5, 239.5], [569.5, 139.5]])
    np.testing.assert_allclose(find_rays(pixels, CAMERA), [[0, 0], [0.5, -0.25]], atol=1e-9)


@pytest.mark.parametrize("model", ["radtan", "equidistant"])
def test_the_lens_is_undone(model):
    k = 0.02
    ray = np.array([0.4, 0.0])
    r = ray[0] if model == "radtan" else np.arctan(ray[0])
    distorted = r * (1 + k * r**2)
    camera = replace(CAMERA, distortion_model=model, distortion=(k, 0.0, 0.0, 0.0))
    pixels = np.array([[319.5 + 500.0 * distorted, 239.5]])
    np.testing.assert_allclose(find_rays(pixels, camera)[0], ray, atol=1e-5)
