"""Scores of gait phases: circular errors, true strides, matching of touch-downs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.outputs.gait_phase.scores import (
    PhaseSeries,
    Stride,
    circular_difference,
    find_touch_downs,
    match_touch_downs,
    phase_scores,
    true_phase,
    true_strides,
)
from stridetwin.streams.samples import Footprint

S = 1_000_000_000


def footprint(foot: str, t_s: float, mode: str = "LG") -> Footprint:
    return Footprint(
        topic="/truth/footprints",
        t_ns=round(t_s * S),
        foot=foot,
        p_foot_in_world=np.zeros(3),
        q_world_foot=np.array([1.0, 0.0, 0.0, 0.0]),
        terrain="level",
        mode=mode,
    )


def strides_at(times_s: list[float]) -> list[Stride]:
    return true_strides([footprint("l", t) for t in [0.0, *times_s]], "l")


def perfect(strides: list[Stride], offset: float = 0.0, sd: float = 0.01) -> PhaseSeries:
    """Estimates that differ from the truth by a constant share of the cycle."""
    t_ns = np.arange(strides[0].begin_ns, strides[-1].end_ns, 8_333_333)
    begins = np.array([s.begin_ns for s in strides])
    stride_of = np.searchsorted(begins, t_ns, side="right") - 1
    phase = np.array([true_phase([t], strides[i])[0] for t, i in zip(t_ns, stride_of)])
    return PhaseSeries(
        foot="l",
        t_ns=t_ns,
        phase=(phase + offset) % 1.0,
        phase_sd=np.full(len(t_ns), sd),
        rate=np.ones(len(t_ns)),
        walking=np.ones(len(t_ns), bool),
        swing=np.zeros(len(t_ns), bool),
        touch_down_ns=begins[stride_of],
    )


@given(st.floats(0, 1, exclude_max=True), st.floats(0, 1, exclude_max=True))
def test_circular_differences_are_small_signed_and_periodic(a: float, b: float) -> None:
    difference = float(circular_difference(a, b))
    assert -0.5 <= difference <= 0.5
    assert (b + difference - a) % 1.0 == pytest.approx(0.0, abs=1e-9) or (b + difference - a) % 1.0 > 1.0 - 1e-9
    assert float(circular_difference(a + 3.0, b)) == pytest.approx(difference, abs=1e-9) or abs(difference) > 0.499


def test_99_against_1_percent_is_minus_2() -> None:
    assert float(circular_difference(0.99, 0.01)) == pytest.approx(-0.02)


def test_strides_begin_with_the_first_touch_down_and_know_their_terrain() -> None:
    prints = [footprint("l", 0.0), footprint("r", 1e-9), footprint("l", 2.0), footprint("r", 2.5)]
    prints += [
        footprint("l", 3.0, "SA"),
        footprint("l", 4.2, "LG"),
        footprint("l", 5.2, "RD"),
        footprint("l", 6.2, "RD"),
    ]
    strides = true_strides(prints, "l")
    assert [s.begin_ns for s in strides] == [2 * S, 3 * S, round(4.2 * S), round(5.2 * S)]
    assert [s.terrain for s in strides] == ["stairs", "stairs", "ramp", "ramp"]
    assert true_strides(prints[:3], "l") == []
    assert true_strides(prints, "r") == []


def test_pauses_and_unsteady_strides_are_known() -> None:
    strides = strides_at([1.0, 2.0, 3.0, 4.0, 5.05, 7.0, 8.0, 9.0])
    assert [i for i, s in enumerate(strides) if s.is_pause] == [4]
    assert [s.is_steady for s in strides] == [False, False, True, True, False, False, False]
    assert not any(s.is_pause for s in strides_at([1.0, 3.4, 5.8]))
    assert all(s.is_pause for s in strides_at([1.0, 3.6, 6.2]))


def test_a_perfect_estimate_has_no_error_and_an_offset_is_the_bias() -> None:
    strides = strides_at([1.0, 2.1, 3.1, 4.2])
    scores = phase_scores(perfect(strides), strides)
    assert scores["rmse_pct"] == pytest.approx(0.0, abs=1e-6)
    assert (scores["missed"], scores["extra"], scores["strides"]) == (1.0, 0.0, 3.0)  # the last one ends the series
    late = phase_scores(perfect(strides, offset=-0.03), strides)
    assert late["rmse_pct"] == pytest.approx(3.0)
    assert late["bias_pct"] == pytest.approx(-3.0)
    assert late["p95_pct"] == pytest.approx(3.0)
    assert late["rmse_level_pct"] == pytest.approx(3.0)
    assert "rmse_stairs_pct" not in late
    assert late["within_95_pct"] == 0.0
    assert phase_scores(perfect(strides, offset=-0.03, sd=0.02), strides)["within_95_pct"] == 100.0


def test_without_a_counted_stride_there_are_no_scores() -> None:
    strides = strides_at([1.0, 3.6])
    assert phase_scores(perfect(strides), strides) == {}


@given(st.lists(st.floats(-0.04, 0.04), min_size=5, max_size=5), st.floats(-0.08, 0.08))
def test_touch_downs_are_matched_once(jitter_s: list[float], bias_s: float) -> None:
    true_ns = np.arange(1, 6) * S
    detected_ns = true_ns + np.round((np.array(jitter_s) + bias_s) * S).astype(np.int64)
    assert match_touch_downs(detected_ns, true_ns) == [(i, i) for i in range(5)]
    assert match_touch_downs([], true_ns) == []
    assert match_touch_downs(detected_ns + S // 2, true_ns[:1], tolerance_s=0.2) == []


def test_missed_extra_and_late_touch_downs_are_counted() -> None:
    strides = strides_at([1.0, 2.0, 3.0, 4.0])
    series = perfect(strides)
    detected = np.array([1.01, 2.5, 3.02, 3.4]) * S
    index = np.searchsorted(detected, series.t_ns, side="right") - 1
    touch_down_ns = np.where(index >= 0, detected[index], -1).astype(np.int64)
    series = replace(series, touch_down_ns=touch_down_ns)
    assert find_touch_downs(series).tolist() == detected.tolist()
    scores = phase_scores(series, strides)
    assert (scores["missed"], scores["extra"]) == (2.0, 2.0)
    assert scores["touch_down_error_ms"] == pytest.approx(15.0)
    assert scores["touch_down_bias_ms"] == pytest.approx(15.0)
