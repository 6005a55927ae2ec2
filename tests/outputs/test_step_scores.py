"""Scores of the steps that the legs estimate, and their figures."""

import numpy as np
import pytest

from stridetwin.cli.console import plain_text
from stridetwin.cli.score import score_tables
from stridetwin.gate.compare import Rules, compare_scores
from stridetwin.gate.score_table import table_of
from stridetwin.outputs.steps.figures import steps_from_above, steps_from_aside
from stridetwin.outputs.steps.scores import ScoredStep, step_scores
from stridetwin.sim.config import Level, Ramp, Route
from stridetwin.sim.world.route import lay_out
from tests.plots import figure, figures


def step(i, *, mode="LG", estimated_mode="LG", seen=True, elevation=0.004, slope=0.0):
    if not seen:
        return ScoredStep(mode=mode, slope=0.0, elevation=0.0, place=(0.5 * i, 0.0, 0.0))
    return ScoredStep(
        mode=mode,
        slope=0.0,
        elevation=0.0,
        place=(0.5 * i, 0.0, 0.0),
        estimated_mode=estimated_mode,
        estimated_slope=slope,
        estimated_elevation=elevation,
        estimated_place=(9.0 + 0.51 * i, 1.0, 0.0),
        slope_sd=0.01,
        elevation_sd=0.001,
        probability=0.9,
    )


def test_scores_count_missed_and_unknown_steps():
    steps = [step(0), step(1, estimated_mode="unknown"), step(2, seen=False), step(3, estimated_mode="SA", slope=0.005)]
    scores = step_scores(steps)
    assert scores["elevation_rmse_mm"] == pytest.approx(4.0)
    assert scores["slope_rmse_deg"] == pytest.approx(np.degrees(0.005 / np.sqrt(3)))
    assert (scores["slope_in_95_pct"], scores["elevation_in_95_pct"]) == (100.0, 0.0)
    assert (scores["classification_accuracy_pct"], scores["unknown_pct"], scores["missed_pct"]) == (25.0, 25.0, 25.0)
    assert scores["end_error_m"] == pytest.approx(0.03)
    assert scores["end_error_pct"] == pytest.approx(2.0)
    assert all(isinstance(v, float) and np.isfinite(v) for v in scores.values())


def test_a_worse_class_is_a_regression_and_a_better_one_is_not():
    good, bad = step_scores([step(i) for i in range(4)]), step_scores([step(i, estimated_mode="SA") for i in range(4)])
    good, bad = (table_of({"estimators": {"contact_terrain": scores}}, "b") for scores in (good, bad))
    assert compare_scores(good, good, Rules()).regressions == []
    worse = compare_scores(bad, good, Rules()).regressions
    assert [r.metric for r in worse] == ["classification_accuracy_pct"]
    assert compare_scores(good, bad, Rules()).regressions == []


def test_paths_and_steps_have_tables_of_their_own():
    scores = {"foot_ins_l": {"end_error_m": 0.1}, "contact_terrain": step_scores([step(0), step(1)])}
    lines = plain_text(score_tables(scores)).splitlines()
    assert [line.split()[0] for line in lines if line] == ["estimator", "foot_ins_l", "estimator", "contact_terrain"]
    assert "class %" in lines[3]
    assert "class %" not in lines[0]


def test_figures_show_every_step_that_was_seen():
    route = Route(segments=(Level(length_m=2.0), Ramp(angle_rad=0.1, rise_m=0.2), Level(length_m=2.0)))
    steps = [step(i, seen=i != 2) for i in range(6)]
    aside = figures(steps_from_aside(lay_out(route), steps, "Ramp"))["Ramp"]
    assert len(aside.shapes("estimated plane")) == len(aside.shapes("its normal")) == 5
    assert {"level", "ramp"} <= set(aside.labels)
    above = figure(steps_from_above(None, steps))
    assert len(above.points("true footprints")) == 5


def test_planes_have_their_slope_in_a_figure_to_scale():
    tilted = [step(0, slope=0.5), step(1, slope=0.5)]
    aside = figure(steps_from_aside(None, tilted))
    assert aside.layout["yaxis"]["scaleanchor"] == "x"
    (x0, y0), (x1, y1) = aside.shapes("estimated plane")[0]
    assert np.arctan2(y1 - y0, x1 - x0) == pytest.approx(0.5, abs=1e-3)
