import cv2
import numpy as np
import pytest
from seen_board import BOARD, EXPOSURE_S, FACING_BACK, OPTICAL, camera, walk

from stridetwin.streams.rig import Board, Mount
from stridetwin.studies.placement.scores import Seeing
from stridetwin.studies.placement.visibility import is_in_image, measure_outlook, see_board


@pytest.mark.parametrize(
    ("model", "distortion"), [("radtan", (-0.28, 0.07, 0.001, -0.002)), ("equidistant", (0.02, -0.004, 0.003, -0.001))]
)
def test_points_are_in_the_image_as_opencv_projects_them(model, distortion):
    points = np.random.default_rng(1).uniform([-0.9, -0.7, 0.6], [0.9, 0.7, 1.5], (50, 3))
    inside = is_in_image(camera(model, distortion), points)
    K, D, none = camera().K, np.array(distortion), np.zeros(3)
    if model == "radtan":
        theirs, _ = cv2.projectPoints(points, none, none, K, D)
    else:
        theirs, _ = cv2.fisheye.projectPoints(points[:, None], none, none, K, D)
    theirs = theirs.reshape(-1, 2)
    within = ((theirs >= 0) & (theirs <= [799, 599])).all(axis=1)
    np.testing.assert_array_equal(inside, within)
    assert 0 < within.sum() < 50
    assert not is_in_image(camera(model, distortion), points * [1, 1, -1]).any()  # behind


def test_a_board_is_seen_while_opencv_projects_all_its_corners_into_the_image():
    y = np.linspace(-0.5, 0.5, 201)
    p = np.column_stack([np.full_like(y, 0.4), y, np.full_like(y, 0.5)])
    sight = see_board(walk(p), camera(), BOARD, EXPOSURE_S, Seeing(least_px=1.0))
    corners = np.array([[x, z, 0.0] for x in (-0.015, 0.015) for z in (-0.0225, 0.0225)])
    for place, seen in zip(p, sight.seen):
        world = corners @ FACING_BACK[:3, :3].T + place
        T = np.linalg.inv(OPTICAL)
        optical = (world - [0, 0, 0.5]) @ T[:3, :3].T
        pixels = cv2.projectPoints(optical, np.zeros(3), np.zeros(3), camera().K, None)[0].reshape(-1, 2)
        assert seen == bool(((pixels >= 0) & (pixels <= [799, 599])).all())
    assert 0.4 < sight.seen.mean() < 0.7
    assert sight.px[100] == pytest.approx(540 * 0.005 / 0.4)


def test_a_board_that_is_small_aslant_or_hidden_is_not_seen():
    near, far = np.array([[0.4, 0.0, 0.5]]), np.array([[0.8, 0.0, 0.5]])
    assert see_board(walk(near), camera(), BOARD, EXPOSURE_S, Seeing()).seen.all()
    assert not see_board(walk(far), camera(), BOARD, EXPOSURE_S, Seeing()).seen.any()  # 3.4 px a square
    turned = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(70)]))[0] @ FACING_BACK[:3, :3]
    aslant = FACING_BACK.copy()
    aslant[:3, :3] = turned
    board = Board(name="b", mount=Mount(body="foot_r", T_body_sensor=aslant), squares=(6, 9), square_m=0.005)
    assert not see_board(walk(near), camera(), board, EXPOSURE_S, Seeing()).seen.any()
    behind = see_board(walk(near, ball=(0.2, 0.0, 0.5)), camera(), BOARD, EXPOSURE_S, Seeing())
    assert behind.in_view.all()
    assert behind.behind_limbs.all()
    assert not behind.seen.any()
    low = walk(np.array([[0.4, 0.0, -0.2]]))  # in the ground
    down = camera(T=np.array([[0.0, -0.7071, 0.7071, 0], [-1, 0, 0, 0], [0, -0.7071, -0.7071, 0], [0, 0, 0, 1]]))
    buried = see_board(low, down, BOARD, EXPOSURE_S, Seeing(least_px=1.0))
    assert buried.in_view.all()
    assert not buried.seen.any()


def test_blur_is_the_way_that_opencv_sees_the_board_go_during_the_exposure():
    p, v = np.array([[0.4, 0.05, 0.52]]), np.array([[0.8, 2.0, -1.0]])
    sight = see_board(walk(p, v), camera(), BOARD, EXPOSURE_S, Seeing())
    ends = []
    for t in (-EXPOSURE_S / 2, EXPOSURE_S / 2):
        optical = (p + t * v - [0, 0, 0.5]) @ np.linalg.inv(OPTICAL)[:3, :3].T
        ends.append(cv2.projectPoints(optical, np.zeros(3), np.zeros(3), camera().K, None)[0].ravel())
    assert sight.blur_px[0] == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=1e-3)
    assert sight.seen[0]
    assert not sight.sharp[0]


def test_a_depth_camera_sees_the_ground_within_its_image_and_range():
    down = camera(T=np.array([[0.0, -0.342, 0.9397, 0], [-1, 0, 0, 0], [0, -0.9397, -0.342, 0], [0, 0, 0, 1]]))
    there = walk(np.tile([0.4, 9.0, 0.5], (5, 1)))
    assert measure_outlook(there, down, (0.3, 6.0)) == (pytest.approx(2 / 3), 0.0)  # the third place is far aside
    assert measure_outlook(there, down, (0.3, 1.2))[0] == pytest.approx(1 / 3)
    dark = walk(np.tile([0.4, 9.0, 0.5], (5, 1)), ball=(0.055, 0.0, 0.48))
    ahead, own_body = measure_outlook(dark, down, (0.3, 6.0))
    assert own_body > 0.3
    assert ahead < 2 / 3
