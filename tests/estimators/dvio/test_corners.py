"""New points are corners: on a straight edge a point slides, or sticks to the jaggies of the image."""

import cv2
import numpy as np
import pytest

from stridetwin.estimators.dvio.tracker import Tracker

SHAPE = (240, 320)


def found(image, wanted=60):
    """(N, 2) px of the new points in an image (H, W) of grey levels, with a little noise."""
    noise = np.random.default_rng(1).normal(0.0, 1.0, SHAPE)
    tracker = Tracker(SHAPE)
    tracker.set_image(np.clip(image + noise, 0, 255).astype(np.uint8))
    return tracker.find(np.zeros((0, 2), np.float32), wanted)


def edge(angle_deg):
    """A jagged edge between two grey levels through the middle."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    a = np.radians(angle_deg)
    beyond = (u - SHAPE[1] / 2) * np.sin(a) - (v - SHAPE[0] / 2) * np.cos(a) > 0
    return np.where(beyond, 150.0, 80.0)


@pytest.mark.parametrize("angle_deg", [3.0, 17.0, 31.0, 45.0, 62.0, 80.0])
def test_a_straight_edge_has_no_points(angle_deg):
    assert len(found(edge(angle_deg))) <= 2


def test_corners_of_a_chequered_floor_are_points():
    side = 40
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    board = cv2.GaussianBlur(np.where((u // side + v // side) % 2, 150.0, 80.0), (3, 3), 0.0)
    points = found(board)
    off = np.abs((points + side / 2) % side - side / 2).max(axis=1)
    assert len(points) >= 25
    assert np.mean(off < 4.0) > 0.95
