"""The one-foot filter on the twin: what the benchmark promises, for one seed outside of it."""

import runpy
from pathlib import Path

import pytest

bench = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "foot_ins_twin.py"), run_name="bench")


@pytest.mark.parametrize("scenario", bench["SCENARIOS"])
def test_end_error_and_certainty(scenario: str) -> None:
    for scores in bench["scores_of_walk"](scenario, 7).values():
        assert scores["end_error_pct"] < 1.0
        assert scores["armse_2d_m"] < 0.05
        assert scores["nees_position_mean"] < 6.0  # 3 if consistent; larger = too sure of itself
        assert scores["nees_position_within_95_pct"] > 80.0
