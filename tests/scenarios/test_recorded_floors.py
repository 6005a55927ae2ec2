"""Floors of recorded walks: rests, planes and unevenness of motions whose floor is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import recorded_floors
from stridetwin.sim.world.uneven_floor import UnevenFloor


def test_a_foot_rests_where_it_is_still_on_its_level() -> None:
    """Five rests of 0.4 s, 0.6 m apart on a slope of 10 mm/m; one more is 0.2 m higher."""
    t = np.arange(0.0, 6.0, 0.01)
    x = np.interp(t % 1.0, [0.0, 0.4, 1.0], [0.0, 0.0, 0.6]) + 0.6 * np.floor(t)
    p = np.column_stack([x, np.zeros_like(x), 0.01 * x + 0.2 * (t >= 5.0)])
    rows, places = recorded_floors.find_rests(t, p)
    assert len(rows) == 5
    np.testing.assert_allclose(places[:, 0], 0.6 * np.arange(5), atol=0.01)
    assert np.ptp(np.diff(rows)) <= 4


def test_plane_and_tilt_are_taken_off() -> None:
    xy = np.random.default_rng(0).uniform(-2.0, 2.0, (40, 2))
    places = np.column_stack([xy, 0.1 + xy @ [0.003, -0.005]])
    slope, above = recorded_floors.fit_plane(places)
    np.testing.assert_allclose(slope, [0.003, -0.005])
    np.testing.assert_allclose(above, 0.0, atol=1e-12)
    np.testing.assert_allclose(recorded_floors.untilt(places, slope)[:, 2], 0.1)


@pytest.mark.parametrize("unevenness_m", [0.004, 0.012])
def test_unevenness_of_drawn_floors_is_found_beside_the_scatter_of_rests(unevenness_m: float) -> None:
    rng = np.random.default_rng(1)
    walks = []
    for seed in range(40):
        xy = rng.uniform(-1.5, 1.5, (30, 2))
        height = UnevenFloor.draw(unevenness_m, seed).height(xy) + 0.002 * rng.standard_normal(30)
        walks.append(recorded_floors.pairs(np.column_stack([xy, height])))
    unevenness, scatter = recorded_floors.fit_unevenness(walks)
    assert unevenness == pytest.approx(unevenness_m, rel=0.2)
    # floors differ in how rough they are, which counts as scatter
    assert np.median(scatter) == pytest.approx(0.002, abs=3e-4 + 0.1 * unevenness_m)


def test_slope_is_common_and_drifts_are_of_each_walk() -> None:
    rng = np.random.default_rng(2)
    walks = []
    for drift in (0.01, -0.02, 0.0):
        way = rng.uniform(-1.0, 1.0, (60, 2))
        walks.append((way, drift + way @ [0.0, 0.005] + 1e-3 * rng.standard_normal(60)))
    slope, error = recorded_floors.slope_seen(walks)
    assert np.all(abs(slope - [0.0, 0.005]) < 4.0 * error)
    assert np.all(error < 3e-4)


def test_without_recordings_it_says_where_they_belong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_floors, "data_folder", lambda: None)
    with pytest.raises(Exception, match="STRIDETWIN_DATA"):
        recorded_floors.measure(SimpleNamespace())  # type: ignore[arg-type]
