"""Steps beside the truth: pairing, displacement, the table, and what the experiment makes of many."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.outputs.csv_tables import write_table
from stridetwin.outputs.steps.files import STEP_COLUMNS, step_cells
from stridetwin.outputs.steps.scores import (
    ScoredStep,
    align_yaw,
    displacement_errors,
    false_steps,
    score_steps,
    step_figures,
    step_scores,
)
from stridetwin.streams.samples import Footprint
from stridetwin.studies.shim2019 import shim_table5
from tests.pinned import assert_pinned, columns


def footprint(i, mode="LG", height=0.0, pitch=0.0):
    return Footprint(
        topic="/truth/footprints",
        t_ns=i * 500_000_000,
        foot="lr"[i % 2],
        p_foot_in_world=np.array([0.5 * i, 0.0, height]),
        q_world_foot=np.array([np.cos(pitch / 2), 0.0, -np.sin(pitch / 2), 0.0]),
        terrain="level",
        mode=mode,
    )


def estimate(i, place=None, **more):
    values = {
        "t_ns": i * 500_000_000 + 300_000_000,
        "step": i,
        "foot": "lr"[i % 2],
        "slope": 0.01,
        "elevation": 0.002,
        "slope_sd": 0.01,
        "elevation_sd": 0.004,
        "normal": np.array([0.0, 0, 1]),
        "covariance": np.eye(3),
        "p_sole_in_world": np.array([0.5 * i, 0.0, 0.0]) if place is None else place,
        "mode": "LG",
        "probability": 0.9,
    }
    return StepEstimate(**(values | more))


def test_each_step_gets_its_own_estimate():
    footprints = [footprint(i, pitch=0.1) for i in range(8)]
    steps = score_steps(footprints, [estimate(i, elevation=0.01 * i) for i in range(2, 8) if i != 5])
    assert [s.is_matched for s in steps] == [True, True, True, False, True, True]
    assert [s.estimated_elevation for s in steps if s.is_matched] == pytest.approx([0.02, 0.03, 0.04, 0.06, 0.07])
    assert steps[0].slope == pytest.approx(0.1)
    assert steps[0].slope_error == pytest.approx(-0.09)


def test_steps_beside_a_footprint_that_is_not_there_are_left_out():
    footprints = [footprint(i) for i in range(10) if i != 5]
    steps = score_steps(footprints, [estimate(i) for i in range(2, 10)])
    assert [s.place[0] for s in steps] == pytest.approx([1.0, 1.5, 3.5, 4.0, 4.5])
    assert all(s.estimated_place[0] == pytest.approx(s.place[0]) for s in steps)


def test_the_first_step_counts_whichever_foot_takes_it():
    footprints = [footprint(i) for i in range(1, 8)]
    footprints = [replace(footprints[0], foot="l"), replace(footprints[0], foot="r"), *footprints[2:]]
    assert [p.foot for p in footprints] == ["l", "r", "r", "l", "r", "l", "r"]
    footprints[0] = replace(footprints[0], p_foot_in_world=np.array([0.5, 0.0, -0.1]))
    steps = score_steps(footprints, [estimate(i) for i in range(3, 8)])
    assert [s.place[0] for s in steps] == pytest.approx([1.5, 2.0, 2.5, 3.0, 3.5])
    assert all(s.is_matched for s in steps)
    assert steps[0].elevation == pytest.approx(0.1)  # over the left foot's, not over its own


def test_steps_that_are_none_are_counted():
    footprints = [footprint(i) for i in range(8)]
    estimates = [estimate(i) for i in range(2, 8)]
    assert false_steps(footprints, estimates) == 0
    assert false_steps(footprints, estimates[:-2]) == 0
    twice = estimate(4, t_ns=estimates[2].t_ns + 100_000_000)
    standing = estimate(1)
    assert false_steps(footprints, [standing, *estimates, twice]) == 2
    assert false_steps([p for p in footprints if p.t_ns != 5 * 500_000_000], estimates) == 0  # the truth lacks one


def test_the_displacement_of_a_run_is_shared_out_over_its_steps():
    modes = ["LG", "LG", "SA", "SA", "SA", "LG", "SD", "SD"]
    steps = [
        ScoredStep(
            mode=m,
            slope=0.0,
            elevation=0.0,
            place=(0.5 * i, 0, 0),
            estimated_mode=m,
            estimated_place=(0.51 * i, 0, 0.002 * i),
        )
        for i, m in enumerate(modes)
    ]
    assert displacement_errors(steps, "SA") == [pytest.approx((0.01, 0.002, 0.0))]
    assert displacement_errors(steps, "SD") == [pytest.approx((0.01, 0.002, 0.0))]
    assert displacement_errors(steps, "RA") == []
    assert displacement_errors(steps, "") == [pytest.approx((0.01, 0.002, 0.0))]


def test_a_way_that_starts_with_another_heading_is_turned_back():
    turn = np.array([[np.cos(0.1), -np.sin(0.1), 0.0], [np.sin(0.1), np.cos(0.1), 0.0], [0.0, 0.0, 1.0]])
    footprints = [footprint(i) for i in range(8)]
    made = [estimate(i, turn @ [0.5 * i, 0.01 * (i % 2), 0.02] + [3.0, 1.0, 0.0]) for i in range(2, 8) if i != 5]
    steps = score_steps(footprints, made)
    ((_, _, left),) = displacement_errors(steps, "")
    assert abs(left) > 0.04
    ((forward, up, left),) = displacement_errors(align_yaw(steps), "")
    assert [forward, up, left] == pytest.approx([0.0, 0.0, 0.0], abs=0.004)
    assert [s.is_matched for s in align_yaw(steps)] == [s.is_matched for s in steps]


def test_the_table_has_a_row_a_step(tmp_path):
    rows = map(step_cells, [estimate(2), estimate(3, slope_sd=np.inf)])
    write_table(STEP_COLUMNS, rows, tmp_path / "steps.csv")
    with (tmp_path / "steps.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == STEP_COLUMNS
    assert (rows[0]["foot"], rows[1]["step"], rows[1]["slope_sd_rad"]) == ("l", "3", "inf")


def test_the_experiment_prints_its_figures_beside_the_papers():
    def steps(mode, elevation):
        return [
            ScoredStep(
                mode=mode,
                slope=0.0,
                elevation=elevation,
                place=(0.3 * i, 0, 0),
                estimated_mode=mode,
                estimated_slope=0.01 * i,
                estimated_elevation=elevation + 0.01,
                estimated_place=(0.3 * i, 0, 0),
                slope_sd=0.02,
                elevation_sd=0.02,
            ).row()
            for i in range(3)
        ]

    walks = {walk: {m: steps("LG", 0.0) for m in ("proposed", "published")} for walk, _ in shim_table5.CASES.values()}
    walks["shim_stairs"] = {m: steps("SA", 0.165) + steps("SD", -0.165) for m in ("proposed", "published")}
    false = {"proposed": 1, "published": 3}
    cases = [{"subject": who, "fell": [], "walks": walks, "false_steps": false} for who in (1, 2)]
    result = shim_table5.collect(cases)
    row = result["summary"]["proposed"]["SA"]
    assert row["elevation_rmse_mm"] == pytest.approx(10.0)
    assert row["slope_rmse_deg"] == pytest.approx(np.degrees(np.sqrt(5 / 3) * 0.01))
    assert (row["steps"], row["elevation_in_95_pct"], row["d_rmse_mm"]) == (6, 100.0, 0.0)
    assert result["paper"]["Shim et al. 2019"]["SD"]["elevation_rmse_mm"] == 28.12
    assert set(result["by_subject"]["published"]) == {"S1", "S2"}
    lines = shim_table5.table(result | {"cases": cases})
    assert any("11.00" in line.split() for line in lines)
    assert result["summary"]["published"]["all"]["false_steps"] == 6
    assert "estimated steps that did not happen: 2" in lines
    alone = shim_table5.collect(cases[:1])  # nobody else's steps to train a machine on
    assert "classification_accuracy_pct" not in alone["summary"]["published"]["all"]
    assert alone["summary"]["proposed"]["all"]["classification_accuracy_pct"] == 100.0
    assert "correct classes by subject, %: S1 -" in shim_table5.table(alone | {"cases": cases[:1]})


def test_pinned_numbers(num_regression):
    rng, modes = np.random.default_rng(2), ("LG", "SA", "SD", "RA", "RD")
    prints = [footprint(i, modes[i // 6 % 5], 0.1 * (i % 7), 0.05 * (i % 5)) for i in range(40)]
    estimates = [
        estimate(
            i,
            prints[i].p_foot_in_world + rng.normal(0.0, 0.01, 3),
            slope=rng.normal(0.0, 0.05),
            elevation=rng.normal(0.0, 0.05),
            mode=modes[i // 6 % 5] if i % 4 else modes[i % 5],
        )
        for i in range(2, 40)
        if i % 9
    ]
    steps = score_steps(prints, estimates)
    places = [place for mode in modes for place in displacement_errors(steps, mode)]
    rows = [
        *steps,
        *align_yaw(steps),
        *({"place": p} for p in places),
        step_scores(steps),
        step_figures(steps, places),
    ]
    assert_pinned(num_regression, columns(rows))
