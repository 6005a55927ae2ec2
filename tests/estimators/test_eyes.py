"""Pictures of a shoe camera: looked at when their time has come, where the filter expects the board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_pictures import BOARD, Scene, camera, image, pose, project
from scipy.spatial.transform import Rotation

from stridetwin.estimators.checkerboard.pattern import Lens
from stridetwin.estimators.foot_to_foot.board_tracking import Expected, Eyes
from stridetwin.estimators.foot_to_foot.shoe_rig import Shoes
from stridetwin.streams.samples import Array, Image

POSE = pose(0.01, -0.01, 0.18, 0.3, 0.3, -0.2)
CLEAR = (0.003, 0.02)  # standard deviations of position and rotation, m and rad


@pytest.fixture(scope="module")
def picture() -> Image:
    return image(Scene("pinhole").bright(POSE), np.random.default_rng(0))


def eyes(timeshift_s: float = 0.0) -> Eyes:
    calibration = camera(timeshift_s=timeshift_s)
    shoes = Shoes(
        imus={},
        cameras={"l": calibration},
        boards={"r": BOARD},
        mounts=np.zeros((4, 7)),
        sonars=np.zeros((2, 3)),
        sonar_topics=("", ""),
    )
    return Eyes(shoes, 0.002)


def expected(T: Array = POSE, sd: tuple[float, float] = CLEAR, T_before: Array | None = None) -> Expected:
    covariance = np.diag(np.repeat(sd, 3) ** 2)
    return Expected(T_camera_board=T, covariance=covariance, T_before=T if T_before is None else T_before)


def test_a_board_is_found_where_it_is_expected_within_the_filters_doubt(picture: Image) -> None:
    off = POSE.copy()
    off[:3, 3] += (0.004, -0.003, 0.005)
    sighting = eyes().look(picture, expected(off))
    assert sighting is not None
    assert sighting.topic == picture.topic
    miss = Lens(camera()).pixels(sighting.rays) - project(POSE, sighting.points_in_board, "pinhole")
    assert np.abs(miss).max() < 0.3


def test_a_picture_waits_until_both_imus_have_reached_its_shifted_time(picture: Image) -> None:
    watching = eyes(timeshift_s=0.004)
    assert watching.take(picture)
    assert watching.ready(picture.t_ns + 3_999_999) == []
    assert [(p is picture, foot, t) for p, foot, t in watching.ready(picture.t_ns + 4_000_000)] == [
        (True, 0, picture.t_ns + 4_000_000)
    ]
    assert watching.ready(2**62) == []


def test_pictures_that_do_not_follow_or_show_no_board_are_not_kept(picture: Image) -> None:
    watching = eyes()
    assert watching.take(picture)
    assert not watching.take(picture)
    assert not watching.take(replace(picture, t_ns=picture.t_ns - 1))
    assert not watching.take(replace(picture, topic="/head/color"))


def test_nothing_is_searched_behind_the_board_or_out_of_view(picture: Image) -> None:
    turned = POSE.copy()
    turned[:3, :3] = POSE[:3, :3] @ Rotation.from_euler("x", np.pi).as_matrix()
    assert eyes().look(picture, expected(turned)) is None
    aside = POSE.copy()
    aside[0, 3] += 1.0
    assert eyes().look(picture, expected(aside)) is None


def test_a_lost_board_is_searched_in_the_whole_picture_now_and_then(picture: Image) -> None:
    watching, lost = eyes(), expected(sd=(0.3, 1.0))
    assert watching.look(picture, lost) is not None
    assert watching.look(replace(picture, t_ns=picture.t_ns + 50_000_000), lost) is None
    assert watching.look(replace(picture, t_ns=picture.t_ns + 100_000_000), lost) is not None


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
