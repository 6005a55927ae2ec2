"""Where the mapped ground ends, what the camera has shown beyond it, and what a step into the gap is predicted as."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stridetwin.estimators.locomotion_mode.falls import FallFinder
from stridetwin.estimators.locomotion_mode.foothold import GRID_M, Arrival, FootholdEstimator, position
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.rollout import moments
from stridetwin.estimators.locomotion_mode.segments import BEHIND_M, Segment, segments_along, unseen_probability
from stridetwin.estimators.terrain_map import Profile
from stridetwin.estimators.terrain_map.depth_camera import BEHIND, GROUND, NO_DEPTH, NOT_SEEN, DepthCamera
from tests.estimators.terrain_map.scenes import RIG

P = Settings()
ORIGIN, FORWARD = np.zeros(2), np.array([1.0, 0.0])
END_M = 1.6


def level_until(end_m: float) -> Profile:
    """Level ground from the start of the path to a place."""
    s = np.arange(0.01, 4.8, 0.02)
    plane = np.where(s < end_m, 3, -1)
    return Profile(s=s, height=np.where(plane >= 0, 0.0, np.nan), plane=plane, changes=(), slope=0.0 * s, slope_sd=s)


class Shown:
    """A map whose last image shows the same at every place."""

    def __init__(self, code: int) -> None:
        self.code = code

    def look_for_ground(self, points: np.ndarray) -> np.ndarray:
        np.testing.assert_allclose(points[:, 2], 0.0)
        assert (points[:, 0] > END_M).all()
        return np.full(len(points), self.code)


def find_fall(code: int, images: int = 4):
    finder = FallFinder()
    for _ in range(images):
        finder.look(Shown(code), level_until(END_M), ORIGIN, FORWARD)
    return finder.find(level_until(END_M), ORIGIN, FORWARD)


@pytest.mark.parametrize("code", [NOT_SEEN, GROUND])
def test_ground_that_was_seen_or_never_looked_at_is_no_fall(code):
    assert find_fall(code) is None


def test_two_images_without_the_expected_ground_are_a_fall_and_one_is_none():
    assert find_fall(BEHIND, images=1) is None
    deep, unknown = find_fall(BEHIND), find_fall(NO_DEPTH)
    assert deep.is_deep
    assert not unknown.is_deep
    for fall in (deep, unknown):
        assert fall.s == pytest.approx(END_M, abs=0.03)
        assert fall.length > 0.3


def test_a_deep_fall_becomes_treads_and_makes_steps_beyond_it_unsure():
    profile, fall = level_until(END_M), find_fall(BEHIND)
    ground = segments_along(profile, None, FORWARD, P, None, fall)
    assert [segment.drop for segment in ground[1:]] == pytest.approx([-P.mode.usual_riser_m] * (len(ground) - 1))
    assert ground[0].end == pytest.approx(END_M, abs=0.03)
    assert len(segments_along(profile, None, FORWARD, P, None, find_fall(NO_DEPTH))) == 1  # it may be black ground
    s = GRID_M * (np.arange(160) + 0.5)
    chances = [unseen_probability(profile, s, 1.2, P, fall=f) for f in (None, fall, find_fall(NO_DEPTH))]
    beyond = s > END_M + 0.05
    assert (chances[1][beyond] >= 0.4).all()
    assert (chances[2][beyond] >= 0.7).all()
    np.testing.assert_array_equal(chances[1][s < END_M - 0.2], chances[0][s < END_M - 0.2])


def test_an_image_tells_ground_from_what_is_behind_it_and_from_no_depth():
    camera = DepthCamera(RIG.cameras["/head/color"])
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 2.5], [0.0, 0.0, 1.0], [9.0, 0.0, 2.0], [0.0, 0.0, -1.0]])
    depth = np.full(camera.shape, 2.0, np.float32)
    # at the surface; hidden by it; before it, so the image shows what is behind; beside the image; behind the camera
    assert camera.look_at(depth, points).tolist() == [GROUND, NOT_SEEN, BEHIND, NOT_SEEN, NOT_SEEN]
    assert camera.look_at(0.0 * depth, points).tolist() == [NO_DEPTH, NO_DEPTH, NO_DEPTH, NOT_SEEN, NOT_SEEN]
    assert camera.look_at(depth + 9.0, 4.0 * points).tolist() == [NOT_SEEN] * 5  # too far to be sure


def predict_footprint(body_s: float | None, sd_m: float = 0.03) -> tuple[float, float]:
    """Mean and standard deviation of the next footprint of a foot at `BEHIND_M`, m, on level ground."""
    walker = FootholdEstimator(P)
    level = Segment(
        start=-math.inf,
        start_sd=0.0,
        end=math.inf,
        end_sd=0.0,
        drop=0.0,
        drop_sd=0.0,
        slope=0.0,
        slope_sd=0.01,
        mapped_slope=0.0,
        mode="LG",
    )
    density = np.exp(-0.5 * ((walker.s - BEHIND_M) / 0.03) ** 2)
    stance = walker._habits.joint(density / density.sum(), walker._habits.prior)
    assert moments(position(stance), walker.s)[0] == pytest.approx(BEHIND_M, abs=0.01)
    arrival = None if body_s is None else Arrival(body_s, sd_m, 1.3)
    return moments(walker.predict_footprints(stance, [level], ["l", "r"], arrival).density[0], walker.s)


def test_a_body_that_stays_over_the_foot_makes_the_next_step_short():
    usual, usual_sd = predict_footprint(None)
    # at touch-down a body of 1.3 m is 42 mm ahead of the middle between the feet
    kept, kept_sd = predict_footprint(BEHIND_M + 0.5 * (usual - BEHIND_M) + 0.042)
    assert kept == pytest.approx(usual, abs=0.03)
    assert kept_sd < usual_sd
    short, _ = predict_footprint(BEHIND_M + 0.05)
    assert short - BEHIND_M < 0.4 * (usual - BEHIND_M)
    assert predict_footprint(BEHIND_M + 0.05, sd_m=2.0)[0] == pytest.approx(
        usual, abs=0.05
    )  # long before the foot lands
