import numpy as np
import pytest
from seen_board import BOARD, EXPOSURE_S, OPTICAL, camera, walk

from stridetwin.streams.errors import FieldLocation
from stridetwin.studies.placement.free import Knob
from stridetwin.studies.placement.problem_file import Optimise
from stridetwin.studies.placement.scores import Seeing
from stridetwin.studies.placement.search import grid, optimise
from stridetwin.studies.placement.visibility import see_board

AT = FieldLocation(source="test")
KNOBS = [
    *(Knob(name=axis, low=-100.0, high=100.0, at=AT) for axis in ("x_mm", "y_mm", "z_mm")),
    *(Knob(name=angle, low=-60.0, high=60.0, at=AT) for angle in ("yaw_deg", "pitch_deg")),
]
OPTIMUM = {"x_mm": 31.0, "y_mm": -58.0, "z_mm": 12.0, "yaw_deg": 17.0, "pitch_deg": -23.0}


class Bowl:
    """An error with a known best place, on walks whose noise is much larger than it and common to all places."""

    def __init__(self, seeds):
        self.offset = np.random.default_rng(0).normal(0.0, 50.0, len(seeds))
        self.slope = np.random.default_rng(1).normal(1.0, 0.1, len(seeds))
        self.count = 0

    def __call__(self, places):
        self.count += len(places)
        return [float(np.mean(self.offset + self.slope * self.error(place.values))) for place in places]

    @staticmethod
    def error(values):
        away = [(values[k] - OPTIMUM[k]) / (40.0 if k.endswith("mm") else 20.0) for k in OPTIMUM]
        ripples = sum(1 - np.cos(4 * a) for a in away)
        return 1.0 + np.dot(away, away) + 0.05 * ripples


def best_of(loss, places):
    values = places[int(np.argmin(loss(places)))].values
    return {k: abs(values[k] - OPTIMUM[k]) for k in OPTIMUM}


@pytest.mark.parametrize("seed", [0, 1])
def test_a_known_optimum_is_found_within_5_mm_and_2_degrees(seed):
    loss = Bowl(range(4))
    off = best_of(loss, optimise(KNOBS, Optimise(budget=600, starts=2), seed, loss))
    assert max(off["x_mm"], off["y_mm"], off["z_mm"]) < 5.0
    assert max(off["yaw_deg"], off["pitch_deg"]) < 2.0


def test_a_search_is_the_same_by_the_same_seed_whatever_else_draws_and_keeps_to_its_budget():
    def tried(seed, disturb):
        np.random.seed(disturb)  # noqa: NPY002
        loss = Bowl(range(2))
        places = optimise(KNOBS, Optimise(budget=95, starts=2), seed, loss)
        assert loss.count == 95
        return [place.key for place in places]

    assert tried(3, 1) == tried(3, 2)
    assert tried(3, 1) != tried(4, 1)


def test_one_number_alone_and_choices_are_searched_too():
    knobs = [KNOBS[0], Knob(name="part", values=("a", "b"), at=AT)]

    def loss(places):
        return [abs(p.values["x_mm"] - 40.0) + (5.0 if p.values["part"] == "a" else 0.0) for p in places]

    places = optimise(knobs, Optimise(budget=120, starts=1), 0, loss)
    best = places[int(np.argmin(loss(places)))].values
    assert best["part"] == "b"
    assert best["x_mm"] == pytest.approx(40.0, abs=2.0)
    assert {p.values["part"] for p in places} == {"a", "b"}


def test_a_camera_is_turned_to_where_the_board_goes_round():
    """The board goes round a circle that hardly fits into the image: it is seen all the time from one direction."""
    u = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    aim = np.radians([12.0, -9.0])  # left, up
    R = turned(*aim)
    circle = np.column_stack([np.full_like(u, 0.4), 0.185 * np.cos(u), 0.185 * np.sin(u)])
    there = walk(circle @ R.T + [0.0, 0.0, 0.5])
    knobs = [Knob(name=n, low=-40.0, high=40.0, at=AT) for n in ("left", "up")]

    def loss(places):
        found = []
        for place in places:
            T = OPTICAL.copy()
            T[:3, :3] = turned(*np.radians([place.values["left"], place.values["up"]])) @ OPTICAL[:3, :3]
            found.append(-float(see_board(there, camera(T=T), BOARD, EXPOSURE_S, Seeing(least_px=1)).seen.mean()))
        return found

    places = optimise(knobs, Optimise(budget=300, starts=2), 0, loss)
    losses = loss(places)
    best = places[int(np.argmin(losses))].values
    assert min(losses) == -1.0
    assert best["up"] == pytest.approx(-9.0, abs=2.0)  # the image is less high than wide


def turned(left, up):
    """Rotation that turns forward to the left and then up."""
    a = np.array([[np.cos(left), -np.sin(left), 0], [np.sin(left), np.cos(left), 0], [0, 0, 1]])
    b = np.array([[np.cos(up), 0, -np.sin(up)], [0, 1, 0], [np.sin(up), 0, np.cos(up)]])
    return a @ b


def test_a_grid_has_every_place_once():
    knobs = [Knob(name="x", low=0.0, high=1.0, step=0.25, at=AT), Knob(name="part", values=("a", "b"), at=AT)]
    places = grid(knobs)
    assert [p.values["x"] for p in places[::2]] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert len({p.key for p in places}) == 10
