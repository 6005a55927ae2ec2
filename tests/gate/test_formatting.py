"""What the gate reports, to people and to machines."""

import json
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest
from score_tables import of_rows, table

from stridetwin.cli.main import main
from stridetwin.gate.compare import Line, Rules, compare_scores
from stridetwin.gate.formatting import (
    collect_failures,
    find_changes,
    format_limits,
    to_cells,
    to_junit,
    to_markdown,
    to_sentence,
    verdict_line,
)
from stridetwin.gate.history_file import append_history, history_line, read_history
from stridetwin.report.history import history_page
from stridetwin.streams.errors import StrideTwinError


@pytest.fixture(scope="module")
def worse():
    return compare_scores(
        table(1, 20, 1.1, 0.05, ("mine", "a<b>&\x01")), table(1, 20, names=("mine", "a<b>&\x01")), Rules()
    )


@pytest.fixture(scope="module")
def fine():
    return compare_scores(table(1, 20), table(1, 20), Rules())


def test_junit_has_a_case_a_score_and_a_failure_a_regression(worse, fine):
    top = ElementTree.fromstring(to_junit(worse))
    assert top.tag == "testsuites"
    cases = top.findall("testsuite/testcase")
    assert len(cases) == len(worse.lines) == int(top.get("tests"))
    failures = top.findall("testsuite/testcase/failure")
    assert len(failures) == len(worse.regressions) == int(top.get("failures"))
    messages = [f.get("message") for f in failures]
    assert any(re.search(r"^mine overall: worse, .* \(\+\d", message) for message in messages)
    assert sum(int(s.get("tests")) for s in top) == len(cases)
    assert {s.get("name") for s in top} == {"mine", "a<b>&?"}
    assert ElementTree.fromstring(to_junit(fine)).findall("testsuite/testcase/failure") == []


def test_markdown_shows_what_changed_and_folds_the_rest(worse, fine):
    text = to_markdown(worse)
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1
    assert "| mine | overall |" in text
    assert f"**{len(worse.regressions)} worse**" in text
    assert text.index("overall") < text.index("<details>")
    assert re.search(r"\d+ scores not worse\n</summary>", text)
    assert "**nothing worse**" in to_markdown(fine)


def test_the_table_names_what_is_worse_first(worse, fine):
    assert "20 walks in both tables, compared in pairs" in worse.description
    assert verdict_line(worse) == f"{len(worse.regressions)} of {len(worse.lines)} scores worse than the baseline"
    assert find_changes(worse)[0].verdict == "worse"
    assert verdict_line(fine) == f"none of {len(fine.lines)} scores is worse"
    assert find_changes(fine) == []
    assert to_cells(fine.lines[0])[-1] == "not worse"


def test_means_are_named_and_signed_scores_compared_by_size_say_so():
    rows = [
        {"name": f"w{i}", "sha256": f"{i}", "estimators": {"mine": {"end_height_error_m": h, "coverage_pct": 90.0}}}
        for i, h in enumerate((-0.1, 0.2, -0.4, 0.1, -0.2, 0.3, -0.3, 0.2))
    ]
    found = compare_scores(of_rows(rows), of_rows(rows), Rules())
    shown = {line.metric: to_cells(line) for line in found.lines}
    assert shown["end_height_error_m"][:4] == ["mine", "|end_height_error_m|", "geometric", "0.203"]
    assert shown["coverage_pct"][:4] == ["mine", "coverage_pct", "arithmetic", "90"]


def test_a_failed_estimator_is_reported_beside_every_verdict(fine, worse):
    why = "no <map>\x01 | at\nall"
    rows = [{"name": "w_1", "sha256": "1", "failed": {"mine": why, "new_one": why}}, {"name": "w_2", "sha256": "2"}]
    failed = collect_failures(rows)
    top = ElementTree.fromstring(to_junit(fine, failed))
    assert (top.get("errors"), top.get("failures")) == ("2", "0")
    assert int(top.get("tests")) == len(fine.lines) + 2 == len(top.findall("testsuite/testcase"))
    cases = [case for case in top.findall("testsuite/testcase") if case.find("error") is not None]
    assert [(case.get("classname"), case.get("name")) for case in cases] == [
        ("stridetwin.mine", "w_1"),
        ("stridetwin.new_one", "w_1"),
    ]
    assert cases[0].find("error").get("message").startswith("no <map>?")
    text = to_markdown(fine, failed)
    assert "**nothing worse**, but **2 failed**" in text
    assert r"| w\_1 | new\_one | no <map>" in text
    assert verdict_line(fine, failed).endswith("scores is worse, but 2 failed")
    assert f"**{len(worse.regressions)} worse** and **2 failed**" in to_markdown(worse, failed)
    for comparison, expected in ((fine, "failed"), (None, "failed"), (worse, "worse")):
        line = history_line("v1", rows, {"mine": {}}, comparison)
        assert line["verdict"] == expected
        assert "an estimator failed on 1 of 2 walks" in history_page([line], "One")


def test_a_missing_score_is_reported_in_one_sentence():
    line = Line(estimator="mine", metric="walks", method="paired", walks=5, verdict="missing", baseline=5.0, now=3.0)
    assert to_sentence(line) == "mine: nothing to score on 5 walks but 3"


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.outside, self.plots = [], 0

    def handle_starttag(self, tag, attributes):
        self.plots += ("class", "plot") in attributes
        self.outside += [v for k, v in attributes if k in ("src", "href") and not (v or "").startswith(("data:", "#"))]


def test_a_history_grows_by_a_line_a_run_and_is_drawn_on_a_page_of_its_own(worse, fine, tmp_path, capsys):
    file, out = tmp_path / "deep" / "history.jsonl", tmp_path / "page.html"
    for i, comparison in enumerate((None, fine, worse)):
        scores = table(1 + i // 2, 20, 1.0 + 0.1 * (i == 2))
        rows = [{"sha256": key} for key in scores.walks]
        append_history(file, history_line(f"v{i}<&>", rows, scores.means, comparison))
    lines = read_history(file)
    assert [line["verdict"] for line in lines] == ["no baseline", "passed", "worse"]
    assert lines[0]["walks_digest"] == lines[1]["walks_digest"] != lines[2]["walks_digest"]
    assert main(["history", str(file), "-o", str(out), "--title", "Mine", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["versions"] == 3
    text = out.read_text()
    page = _Page()
    page.feed(text)
    assert page.outside == []
    assert page.plots == len([m for m in lines[0]["estimators"]["mine"] if m != "distance_m"])
    assert "v2&lt;&amp;&gt;" in text
    assert "v2<&>" not in text


def test_one_line_is_history_enough_and_others_are_none(fine, tmp_path):
    scores = table(1, 20)
    assert 'class="plot"' in history_page([history_line("v1", [{"sha256": "a"}], scores.means, fine)], "One")
    file = tmp_path / "h.jsonl"
    for text, words in (("", "no line in it"), ("{}", "line 1"), ("x", "line 1"), ('{"estimators": 3}', "line 1")):
        file.write_text(text)
        with pytest.raises(StrideTwinError, match=words):
            read_history(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(StrideTwinError, match=r"h\.jsonl: is not text in UTF-8"):
        read_history(file)


def test_near_misses_and_too_few_walks_are_said():
    """An error doubles on ten walks, so unevenly that the test proves nothing: the terminal says what it cannot."""
    baseline = of_rows(_height_rows([0.1] * 10))
    now = of_rows(_height_rows([0.1, 0.08, 0.12, 0.2, 0.2, 0.3, 0.5, 0.9, 0.07, 0.11]))
    comparison = compare_scores(now, baseline, Rules())
    (height,) = comparison.near_misses
    assert (height.metric, height.verdict, comparison.regressions) == ("end_error_m", "same", [])
    assert height.low > 0.0
    limits = format_limits(comparison)
    assert limits[0].startswith("1 near miss: the whole 95 % interval is worse")
    assert limits[1] == "10 walks are too few for changes of 5 to 20 %: expected 30 or more"
    assert find_changes(comparison) == [height]
    assert to_cells(height)[-1] == "near miss"
    page = to_markdown(comparison)
    assert page.count(r"end\_error\_m |") == 1
    assert "10 walks are too few" in page
    better = of_rows(_height_rows([0.1, 0.1, 0.1, 0.05, 0.05, 0.03, 0.02, 0.01, 0.01, 0.11]))
    assert compare_scores(better, baseline, Rules()).near_misses == []


def _height_rows(values):
    return [
        {"name": f"w{i}", "sha256": f"{i}", "estimators": {"mine": {"end_error_m": value}}}
        for i, value in enumerate(values)
    ]


def test_enough_walks_without_a_change_have_no_remark(fine):
    assert format_limits(fine) == ["20 walks are too few for changes of 5 to 20 %: expected 30 or more"]
    assert format_limits(compare_scores(table(1, 30), table(1, 30), Rules())) == []
    assert format_limits(compare_scores(table(1, 3), table(1, 3), Rules())) == []  # the heading says it
