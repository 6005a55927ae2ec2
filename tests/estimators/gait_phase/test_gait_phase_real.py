"""Gait phase on recorded walks, without any change of parameters; skipped where the recordings are missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.gait_phase import measure_real
from benchmarks.real_walks import data_folder

FOLDER = data_folder()
pytestmark = pytest.mark.skipif(FOLDER is None, reason="no recorded walks")


@pytest.fixture(scope="module")
def figures() -> dict[str, dict[str, float]]:
    return measure_real(FOLDER or Path())["summary"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_heel_strike_of_the_markers_is_found_in_time(figures: dict[str, dict[str, float]], side: str) -> None:
    row = figures[f"dual_foot_walk {side}"]
    assert row["matched"] == row["strikes"] == 31
    assert abs(row["strike_error_mean_ms"]) < 10.0
    assert row["strike_error_sd_ms"] < 20.0


@pytest.mark.parametrize(
    ("name", "stride_s"),
    [
        ("dual_foot_walk right", 1.09),
        ("2017-11-22-11-22-03", 1.19),
        ("2017-11-22-11-50-42", 1.63),
        ("2017-11-27-11-24-07", 0.79),
        ("ngimu loop", 1.14),
        ("corner_22", 1.17),
        ("corner_27", 1.17),
    ],
)
def test_strides_are_regular_on_every_sensor_and_at_every_pace(
    figures: dict[str, dict[str, float]], name: str, stride_s: float
) -> None:
    row = figures[name]
    assert row["stride_p50_s"] == pytest.approx(stride_s, abs=0.02)
    assert row["stride_p95_s"] < 1.3 * row["stride_p5_s"]
    assert row["rmse_pct"] < 3.0
    assert row["not_walking_pct"] == 0.0
