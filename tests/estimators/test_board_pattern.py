"""Lens, view and pose of a board against OpenCV's projection, and the model of a corner against its definition."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from board_images import BOARD, pose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import erf

from stridetwin.estimators.checkerboard import detector, saddle_points
from stridetwin.estimators.checkerboard.pattern import BoardPattern, DistortionModel, View, sample
from stridetwin.estimators.checkerboard.pose import BoardObservation, find_board_poses
from stridetwin.streams.rig import CameraCalibration, Mount
from tests.estimators.from_python import from_python

CAMERA = CameraCalibration(
    topic="/foot_l/camera",
    part="",
    rate_hz=60.0,
    mount=Mount(body="foot_l"),
    width=800,
    height=600,
    intrinsics=(420.0, 430.0, 405.0, 295.0),
    distortion_model="radtan",
    distortion=(-0.08, 0.02, 0.003, -0.004),
)
FISHEYE = replace(CAMERA, distortion_model="equidistant", distortion=(-0.03, 0.01, -0.004, 0.001))
PATTERN = BoardPattern(BOARD)
SQUARES = np.array([[0.0, 0.0], [1.5, -0.5], [-2.0, 1.0], [0.7, 2.3]])


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["radtan", "equidistant"])
def test_a_lens_is_opencvs(camera):
    lens = DistortionModel(camera)
    rays = np.random.default_rng(0).uniform(-0.6, 0.6, (30, 2))
    points = np.column_stack([rays, np.ones(30)])[:, None]
    project = cv2.fisheye.projectPoints if camera is FISHEYE else cv2.projectPoints
    zero, D = np.zeros(3), np.array(camera.distortion)
    expected = project(points, zero, zero, camera.K, D)[0].reshape(-1, 2)
    np.testing.assert_allclose(lens.pixels(rays), expected, atol=1e-9)
    np.testing.assert_allclose(lens.rays(expected), rays, atol=1e-4)
    assert (lens.focal_px, lens.size) == (425.0, (800, 600))


def test_rays_beyond_the_fold_of_a_polynomial_have_no_pixel():
    """r (1 + k r²) with k = -0.3 rises until r² = 1 / 0.9."""
    lens = DistortionModel(replace(CAMERA, distortion=(-0.3, 0.0, 0.0, 0.0)))
    fold = np.sqrt(1.0 / 0.9)
    assert lens.reach == pytest.approx(fold, rel=0.03)
    at = lens.reach * np.array([[0.0, 0.999], [0.6, -0.799], [1.001, 0.0], [-0.75, 0.75]])
    assert np.isnan(lens.pixels(at)).any(axis=1).tolist() == [False, False, True, True]


@pytest.fixture
def seen():
    """A board's pose, and the view of it."""
    T = pose(0.03, -0.02, 0.3, 0.4, -0.3, 0.2)
    H = T[:3, [0, 1, 3]] * [BOARD.square_m, BOARD.square_m, 1.0]
    return T, View(lens=DistortionModel(CAMERA), H=H)


def projected(T, squares):
    points = np.column_stack([np.asarray(squares) * BOARD.square_m, np.zeros(len(squares))])
    rotation = cv2.Rodrigues(T[:3, :3])[0]
    return cv2.projectPoints(points, rotation, T[:3, 3], CAMERA.K, np.array(CAMERA.distortion))[0].reshape(-1, 2)


def test_a_view_is_the_projection_of_the_board(seen):
    T, view = seen
    np.testing.assert_allclose(view.pixels(SQUARES), projected(T, SQUARES), atol=1e-8)
    edges = view.edges(SQUARES)
    for axis, half in enumerate(0.5 * np.eye(2)):
        expected = projected(T, SQUARES + half) - projected(T, SQUARES - half)
        np.testing.assert_allclose(edges[:, axis], expected, atol=1e-8)
    np.testing.assert_allclose(view.size_px(SQUARES), np.sqrt(np.abs(np.linalg.det(edges))))
    way = np.array([0.02, -0.05])
    np.testing.assert_allclose(view.to_squares(way @ view.edges(np.zeros((1, 2)))[0]), way, rtol=1e-9)
    np.testing.assert_allclose(view.shift(1.0, -2.0).pixels(SQUARES), view.pixels(SQUARES + [1.0, -2.0]), atol=1e-9)
    again = View.from_points(view.lens, SQUARES, view.rays(SQUARES))
    np.testing.assert_allclose(again.H / again.H[2, 2], view.H / view.H[2, 2], atol=1e-6)
    behind = View.from_points(view.lens, SQUARES, view.rays(SQUARES) * [-1.0, 1.0])
    assert behind is None
    assert View.from_points(view.lens, SQUARES[:3], view.rays(SQUARES[:3])) is None
    outlier = view.rays(PATTERN.corners)
    outlier[5] += 0.3
    robust = View.from_points(view.lens, PATTERN.corners, outlier, 1e-3)
    np.testing.assert_allclose(robust.pixels(SQUARES), view.pixels(SQUARES), atol=1e-3)


def test_a_point_behind_the_camera_has_no_ray():
    view = View(lens=DistortionModel(CAMERA), H=np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.1, 0.0, 1.0]]))
    assert np.isnan(view.rays(np.array([[-9.4, 0.0], [-9.6, 0.0], [-20.0, 1.0]])))[:, 0].tolist() == [False, True, True]


def test_the_pattern_alternates_from_a_dark_square_within_a_white_margin():
    columns, rows = BOARD.squares
    assert PATTERN.shape == (columns - 1, rows - 1)
    np.testing.assert_allclose(PATTERN.corners.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(PATTERN.points_in_board[:, :2], PATTERN.corners * BOARD.square_m)
    bright = PATTERN.bright
    assert bright.shape == (rows + 2, columns + 2)
    assert (bright[[0, -1]] == 1.0).all()
    assert (bright[:, [0, -1]] == 1.0).all()
    inner = bright[1:-1, 1:-1]
    assert inner[0, 0] == -1.0
    assert (inner[1:] == -inner[:-1]).all()
    assert (inner[:, 1:] == -inner[:, :-1]).all()
    cells = PATTERN.cells.reshape(rows + 2, columns + 2, 2)
    for corner, colour in zip(PATTERN.corners, PATTERN.corner_colour):
        (at,) = np.argwhere(np.abs(cells - (corner + 0.5)).max(axis=2) < 1e-9)
        assert bright[tuple(at)] == colour


def test_brightness_between_pixels_is_bilinear_and_unknown_outside():
    image = np.random.default_rng(0).integers(0, 256, (5, 7)).astype(np.uint8)
    g = image.astype(float)
    found = sample(image, np.array([[2.0, 3.0], [2.25, 3.5], [6.0, 4.0], [6.1, 2.0], [-0.1, 0.0], [1.0, 4.1]]))
    mixed = 0.75 * (g[3, 2] + g[4, 2]) / 2 + 0.25 * (g[3, 3] + g[4, 3]) / 2
    np.testing.assert_allclose(found, [g[3, 2], mixed, g[4, 6], np.nan, np.nan, np.nan], rtol=1e-5)


def test_a_pose_is_the_least_squares_solution_with_its_covariance(seen):
    T, _ = seen
    rng, sd = np.random.default_rng(3), np.linspace(1e-4, 4e-4, len(PATTERN.corners))
    points = PATTERN.points_in_board

    def rays(x, T=T):
        moved = Rotation.from_rotvec(x[3:]).apply(points @ T[:3, :3].T) + T[:3, 3] + x[:3]
        return moved[:, :2] / moved[:, 2:]

    measured = rays(np.zeros(6)) + sd[:, None] * rng.normal(size=(len(points), 2))
    observation = BoardObservation(topic="/c", t_ns=0, points_in_board=points, rays=measured, ray_sd=sd)
    best = find_board_poses(observation)[0]
    fit = least_squares(lambda x: ((rays(x) - measured) / sd[:, None]).ravel(), np.zeros(6), xtol=1e-15, x_scale=1e-3)
    turn = Rotation.from_matrix(best.T_camera_board[:3, :3] @ T[:3, :3].T).as_rotvec()
    np.testing.assert_allclose(best.T_camera_board[:3, 3] - T[:3, 3], fit.x[:3], atol=1e-7)
    np.testing.assert_allclose(turn, fit.x[3:], atol=1e-6)
    assert best.chi2 == pytest.approx(2.0 * fit.cost, rel=1e-6)
    h, at = 1e-6 * np.eye(6), best.T_camera_board  # rotations count from the solution
    J = np.array([(rays(e, at) - rays(-e, at)) / 2e-6 / sd[:, None] for e in h]).reshape(6, -1).T
    np.testing.assert_allclose(best.covariance, np.linalg.inv(J.T @ J), rtol=1e-4, atol=1e-14)


@pytest.mark.parametrize("sd", [0.03, 0.2, 0.5])
def test_the_smoothed_square_wave_has_its_slopes(sd):
    wave = from_python(saddle_points._square_wave)

    def value(u, of):
        """Edges at all whole numbers, alternately up and down, each an error function; far ones cancel in pairs."""
        k = np.arange(-20, 21)
        return float(np.sum(np.where(k % 2 == 0, 1.0, -1.0) * erf((u - k) / (of * np.sqrt(2.0)))))

    h = 1e-5
    for u in (-1.7, -1.0, -0.4, 0.0, 0.05, 0.5, 0.93, 1.3, 1.9):
        found, slope, by_sd = wave(u, sd)
        edges_near = 4.0 * sd < 2.0 - abs(u) + 1.0  # those beyond two squares are left out
        if edges_near:
            assert found == pytest.approx(value(u, sd), abs=2e-3)
            assert slope == pytest.approx((value(u + h, sd) - value(u - h, sd)) / (2 * h), abs=5e-3 / sd)
            assert by_sd == pytest.approx((value(u, sd + h) - value(u, sd - h)) / (2 * h), abs=2e-2 / sd)


def test_corners_are_alone_where_no_shift_to_squares_of_the_same_colours_is_within_reach():
    """Of corners in columns 1 to 3 of six, in all rows, only the shift by two columns keeps the colours."""
    board, view = SimpleNamespace(shape=(6, 4)), SimpleNamespace(pixels=lambda squares: 10.0 * squares)
    some = np.array([v * 6 + u for v in range(4) for u in (1, 2, 3)])
    assert detector.is_unambiguous(board, view, some, np.zeros(2), 19.0)
    assert not detector.is_unambiguous(board, view, some, np.zeros(2), 21.0)
    assert detector.is_unambiguous(board, view, np.arange(24), np.zeros(2), 1e9)
