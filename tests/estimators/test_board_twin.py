"""The board detector on images of the twin, as the benchmark measures it, for a seed outside of it."""

from benchmarks.board_detection import cases_of_walk, summary


def test_rendered_walk() -> None:
    figures = summary(cases_of_walk("stair_up_down", 7, exposure_ms=2.0, every=15))
    assert figures["whole_board"] > 30
    assert figures["wrong"] == 0
    assert figures["false"] == 0
    assert figures["detected_usable_pct"] > 97.0
    assert figures["detected_pct"] > 80.0
    assert figures["corner_sd_px"] < 0.08
    assert figures["pose_nees_mean"] < 4.0
    assert figures["along_sight_rms_mm"] < 0.6
