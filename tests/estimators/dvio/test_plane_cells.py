"""The planes of a depth image, and what their covariances are worth."""

from __future__ import annotations

import numpy as np
import pytest

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.plane_cells import PLANE_ERROR, SIDE, sample_pixels

SHAPE, FOCAL = (480, 640), 384.0
SD = 0.007  # of an inverse depth, 1/m


def rays() -> np.ndarray:
    return np.asarray((sample_pixels(SHAPE) - [319.5, 239.5]) / FOCAL)


def depth_image(planes: list[np.ndarray], rng: np.random.Generator | None = None) -> np.ndarray:
    """(H, W) m, of the nearest of some planes; with noise where a generator is given."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    m = np.stack([(u - 319.5) / FOCAL, (v - 239.5) / FOCAL, np.ones(SHAPE)], axis=-1)
    xi = np.max([m @ p for p in planes], axis=0)
    if rng is not None:
        xi = xi + SD * rng.normal(size=SHAPE)
    return np.where(xi > 0.05, 1 / np.maximum(xi, 0.05), 0.0).astype(np.float32)


def measured_planes(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) planes, 1/m, and (P, 3, 3) inverses of their covariances."""
    measured, weights = np.zeros((6, 3)), np.zeros((6, 3, 3))
    n = kernel.read_planes(depth, rays(), SIDE, 0.3, SD, measured, weights)
    return measured[:n], weights[:n]


def depth_noise(plane: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(3, 3) covariance of a measured plane, of the noise of the depth alone."""
    return np.asarray(np.linalg.inv(weight) - PLANE_ERROR**2 * (plane @ plane) * np.eye(3))


def test_planes_of_a_corner_are_no_worse_than_their_covariance_says():
    """Cells across a crease bend them a little; the plane error covers that."""
    rng = np.random.default_rng(0)
    floor, left, right = np.array([0.02, 0.6, 0.25]), np.array([-0.35, 0.02, 0.2]), np.array([0.3, -0.05, 0.25])
    squares = []
    for _ in range(4):
        measured, weights = measured_planes(depth_image([floor, left, right], rng))
        assert len(measured) == 3
        for plane in (floor, left, right):
            i = int(np.argmin(np.linalg.norm(measured - plane, axis=1)))
            e = measured[i] - plane
            assert np.linalg.norm(e) < 0.02 * np.linalg.norm(plane)
            squares.append(e @ weights[i] @ e)
    assert np.mean(squares) < 3.0


def test_the_covariance_of_one_plane_is_that_of_its_noise():
    rng, plane, squares = np.random.default_rng(1), np.array([0.05, 0.5, 0.4]), []
    for _ in range(12):
        measured, weights = measured_planes(depth_image([plane], rng))
        e = measured[0] - plane
        squares.append(e @ np.linalg.solve(depth_noise(measured[0], weights[0]), e))
    assert 1.6 < np.mean(squares) < 4.8  # 3; its mean of 12 scatters by 0.7


def test_steps_are_no_plane_and_neither_is_nothing():
    v = np.arange(SHAPE[0])[:, None] * np.ones((1, SHAPE[1]))
    steps = 1.5 + 0.25 * (v // 16 % 2)
    assert not len(measured_planes(steps.astype(np.float32))[0])
    assert not len(measured_planes(np.zeros(SHAPE, np.float32))[0])
    assert not len(measured_planes(np.full(SHAPE, np.nan, np.float32))[0])


def test_the_plane_error_bounds_the_information_of_an_image():
    plane = np.array([0.0, 0.0, 2.0])
    (measured,), (weight,) = measured_planes(depth_image([plane]))
    assert np.linalg.eigvalsh(np.linalg.inv(depth_noise(measured, weight))).max() > 1e7
    assert np.linalg.eigvalsh(weight).max() == pytest.approx((PLANE_ERROR * 2.0) ** -2, rel=0.01)
