"""Lines of a history that are none, which are neither read nor written."""

import json

import pytest

from stridetwin.cli.main import main
from stridetwin.gate.history_file import append_history
from stridetwin.report.history import history_page
from stridetwin.streams.errors import StrideTwinError

LONG = 10**399
LINE = {
    "label": "v1",
    "verdict": "passed",
    "regressions": [],
    "walks": 1,
    "walks_digest": "0a",
    "failed": 0,
    "estimators": {"a": {"end_error_m": 0.1}},
}
BAD = [
    *(
        ({"estimators": {"a": {"end_error_m": value}}}, f"estimators.a.end_error_m: invalid {value!r}: expected a n")
        for value in ("x", [1], None, LONG, 1e308, -1e308, float("nan"), float("inf"))
    ),
    ({"estimators": {"a": 1}}, "estimators.a: invalid 1"),
    ({"estimators": []}, "estimators: invalid []: expected estimators, each with its scores"),
    ({"estimators": {"x\ud800": {}}}, r"estimators: invalid 'x\ud800'"),
    *(
        ({"regressions": value}, f"regressions: invalid {value!r}: expected a list of texts")
        for value in (None, 5, [1], "mine: worse")
    ),
    ({"walks_digest": [1]}, "walks_digest: invalid [1]: expected text"),
    ({"label": "x\ud800"}, r"label: invalid 'x\ud800': expected text in UTF-8"),
    ({"label": None}, "label: invalid None"),
    ({"label": "x" * 1000 + "\ud800"}, f"label: invalid '{'x' * 399}..."),
    ({"verdict": [1]}, "verdict: invalid [1]: expected passed, worse, failed, no baseline"),
    *(({"walks": value}, f"walks: invalid {value!r}: expected a whole number") for value in ("x", -1, True, LONG)),
    ({"failed": "x"}, "failed: invalid 'x'"),
]


@pytest.mark.parametrize(("change", "said"), BAD)
def test_a_line_with_a_bad_field_is_one_error_and_is_not_written(tmp_path, capsys, change, said):
    file, new = tmp_path / "h.jsonl", tmp_path / "folder" / "new.jsonl"
    file.write_text(json.dumps(LINE) + "\n" + json.dumps(LINE | change) + "\n")
    assert main(["history", str(file), "-o", str(tmp_path / "page.html")]) == 2
    assert f"error: {file}: line 2: {said}" in capsys.readouterr().err
    with pytest.raises(StrideTwinError) as error:
        append_history(new, LINE | change)
    assert f"{new}: new line: {said}" in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["h.jsonl"]


@pytest.mark.parametrize("text", ["[" * 100_000, "[" * 900 + "]" * 900, "[]", "5", "null", "9" * 5000])
def test_a_line_that_is_none_is_one_error(tmp_path, capsys, text):
    file = tmp_path / "h.jsonl"
    file.write_text(json.dumps(LINE) + "\n" + text + "\n")
    assert main(["history", str(file), "-o", str(tmp_path / "page.html")]) == 2
    message = capsys.readouterr().err
    assert f"error: {file}: line 2: " in message
    assert "lines that `stridetwin score --history` has written" in message
    assert len(message) < len(str(file)) + 650


def test_the_largest_and_the_smallest_scores_are_drawn():
    lines = [LINE | {"estimators": {"a": {"end_error_m": v}}} for v in (-1e100, 0, 1e-100, 1e100)]
    assert 'class="plot"' in history_page(lines, "All")
    assert 'class="plot"' in history_page(lines[2:3], "Small")
