"""Text tables of the studies."""

from stridetwin.studies.tables import table_lines

COLUMNS = (
    ("end m", 12, "{end:.2f}"),
    ("rms mm", 8, "{rms!m:.0f}"),
    ("lead s", 8, "{lead[median]:.1f}"),
    ("change %", 10, "{change:+.1f}"),
)


def test_pairs_thousandths_and_signs_are_formatted():
    row = {"end": [0.104, 2.0], "rms": [0.001, 0.002], "lead": {"median": 1.25}, "change": 3.0}
    head, line = table_lines(COLUMNS, [("left, right", row)], 14, "feet")
    assert head == "feet                 end m  rms mm  lead s  change %"
    assert line == "left, right      0.10 2.00     1 2     1.2      +3.0"


def test_what_is_missing_is_a_dash_and_text_stays_as_it_is():
    (_, line) = table_lines(COLUMNS, [("none", {"end": "", "rms": None, "lead": None})], 14)
    assert line.split() == ["none", "-", "-", "-"]


def test_a_refused_fault_has_its_reason():
    row = {"error": "no IMU", "refused": 2, "of": 3}
    assert table_lines(COLUMNS, [("IMU dead", row)], 10)[1] == "IMU dead  2 of 3 refused: no IMU"
