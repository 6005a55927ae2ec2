"""The comparison of recorded walks with those of the twin: figures of a walk whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import people_beside_twin, transfer


def test_heights_of_strides_on_stairs_and_on_the_level_are_apart() -> None:
    """Stances at 0, 0, 0.17 and 0.34 m; the path rises 10 mm too much on the level, and 20 mm on each stair."""
    spans = [(0, 9), (20, 29), (40, 49), (60, 69)]
    true_m, path_m = np.repeat([0.0, 0.0, 0.17, 0.34], 20), np.repeat([0.0, 0.01, 0.20, 0.39], 20)
    block = transfer.real_walks.imu_block(0.005 * np.arange(80), np.zeros((80, 3)), np.zeros((80, 3)))
    truth = np.column_stack([np.zeros((80, 2)), true_m])
    walk = transfer.FootWalk(name="stair", imu=block, truth=truth)
    errors = people_beside_twin.stride_height_errors(walk, spans, np.column_stack([np.zeros((80, 2)), path_m]))
    assert errors == pytest.approx({"level_stride_mm": 10.0, "stair_stride_mm": 20.0})
    level = people_beside_twin.stride_height_errors(walk, spans[:2], truth)
    assert level == pytest.approx({"level_stride_mm": 0.0})


def test_samples_at_the_limit_are_counted_on_any_axis() -> None:
    rate = np.zeros((100, 3))
    rate[:4, 1], rate[50, 2], rate[60, 0] = 9.6, -9.4, 3.0
    assert people_beside_twin.clipped_pct(rate) == pytest.approx(5.0)
    assert people_beside_twin.clipped_pct(0.5 * rate) == 0.0


def test_quartiles_are_of_the_walks_that_have_the_figure() -> None:
    rows = [{"a": 1.0}, {"a": 2.0, "b": 5.0}, {"a": 3.0, "b": np.nan}]
    assert people_beside_twin.quartiles(rows, "a") == {"walks": 3, "low": 1.5, "median": 2.0, "high": 2.5}
    assert people_beside_twin.quartiles(rows, "b")["walks"] == 1
    assert people_beside_twin.quartiles(rows, "c")["walks"] == 0


def test_a_simulated_walk_has_every_figure_but_those_of_stairs(tmp_path) -> None:  # type: ignore[no-untyped-def]
    job = transfer.twin_jobs(0, 1)[0]
    figures = people_beside_twin.figures_of(transfer.twin_walk(job, "", tmp_path))
    assert set(people_beside_twin.FIGURES) - set(figures) <= {"stair_stride_mm"}
    assert 0.0 <= figures["height_within_95_pct"] <= 100.0
    assert figures["level_stride_mm"] < 50.0
