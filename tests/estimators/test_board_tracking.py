"""Images of a shoe camera: searched when their time has come, where the filter expects the board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_images import BOARD, Scene, camera, image_of, pose, project
from scipy.spatial.transform import Rotation

from stridetwin.estimators.checkerboard.pattern import DistortionModel
from stridetwin.estimators.foot_to_foot.board_tracking import BoardPrediction, BoardTracker
from stridetwin.estimators.foot_to_foot.shoe_rig import Shoes
from stridetwin.streams.samples import Array, Image

POSE = pose(0.01, -0.01, 0.18, 0.3, 0.3, -0.2)
CLEAR = (0.003, 0.02)  # standard deviations of position and rotation, m and rad


@pytest.fixture(scope="module")
def image() -> Image:
    return image_of(Scene("pinhole").bright(POSE), np.random.default_rng(0))


def tracker(timeshift_s: float = 0.0) -> BoardTracker:
    calibration = camera(timeshift_s=timeshift_s)
    shoes = Shoes(
        imus={},
        cameras={"l": calibration},
        boards={"r": BOARD},
        mounts=np.zeros((4, 7)),
        sonars=np.zeros((2, 3)),
        sonar_topics=("", ""),
    )
    return BoardTracker(shoes, 0.002)


def expected(T: Array = POSE, sd: tuple[float, float] = CLEAR, T_before: Array | None = None) -> BoardPrediction:
    covariance = np.diag(np.repeat(sd, 3) ** 2)
    return BoardPrediction(T_camera_board=T, covariance=covariance, T_before=T if T_before is None else T_before)


def test_a_board_is_found_where_it_is_expected_within_the_filters_uncertainty(image: Image) -> None:
    off = POSE.copy()
    off[:3, 3] += (0.004, -0.003, 0.005)
    observation = tracker().detect(image, expected(off))
    assert observation is not None
    assert observation.topic == image.topic
    miss = DistortionModel(camera()).pixels(observation.rays) - project(POSE, observation.points_in_board, "pinhole")
    assert np.abs(miss).max() < 0.3


def test_an_image_waits_until_both_imus_have_reached_its_shifted_time(image: Image) -> None:
    boards = tracker(timeshift_s=0.004)
    assert boards.enqueue(image)
    assert boards.pop_ready(image.t_ns + 3_999_999) == []
    assert [(p is image, foot, t) for p, foot, t in boards.pop_ready(image.t_ns + 4_000_000)] == [
        (True, 0, image.t_ns + 4_000_000)
    ]
    assert boards.pop_ready(2**62) == []


def test_images_that_do_not_follow_or_show_no_board_are_not_kept(image: Image) -> None:
    boards = tracker()
    assert boards.enqueue(image)
    assert not boards.enqueue(image)
    assert not boards.enqueue(replace(image, t_ns=image.t_ns - 1))
    assert not boards.enqueue(replace(image, topic="/head/color"))


def test_nothing_is_searched_behind_the_board_or_out_of_view(image: Image) -> None:
    turned = POSE.copy()
    turned[:3, :3] = POSE[:3, :3] @ Rotation.from_euler("x", np.pi).as_matrix()
    assert tracker().detect(image, expected(turned)) is None
    aside = POSE.copy()
    aside[0, 3] += 1.0
    assert tracker().detect(image, expected(aside)) is None


def test_a_lost_board_is_searched_in_the_whole_image_now_and_then(image: Image) -> None:
    boards, lost = tracker(), expected(sd=(0.3, 1.0))
    assert boards.detect(image, lost) is not None
    assert boards.detect(replace(image, t_ns=image.t_ns + 50_000_000), lost) is None
    assert boards.detect(replace(image, t_ns=image.t_ns + 100_000_000), lost) is not None


def test_the_error_in_pixels_is_that_of_many_draws() -> None:
    rng, points = np.random.default_rng(2), np.array([[0.0, 0.0, 0.0], [0.02, 0.01, 0.0]])
    belief = expected(sd=(0.002, 0.01))
    seen = []
    for _ in range(4000):
        T = POSE.copy()
        T[:3, 3] += rng.normal(0.0, 0.002, 3)
        T[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix() @ POSE[:3, :3]
        p = points @ T[:3, :3].T + T[:3, 3]
        seen.append(270.0 * p[:, :2] / p[:, 2:])
    spread = np.sqrt(np.var(seen, axis=0).sum(axis=1)).max()
    assert belief.error_px(points, 270.0) == pytest.approx(spread, rel=0.05)
