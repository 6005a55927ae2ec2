"""Formats a comparison: a table for a terminal, Markdown for a pull request, JUnit XML for a build server."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from stridetwin.gate.compare import BETTER, ENOUGH_WALKS, MISSING, NEW, SAME, WALKS, Comparison, Line
from stridetwin.gate.score_table import ScoredWalk

# heads of the columns of a comparison
HEAD = ("estimator", "score", "mean", "baseline", "now", "change", "95 % interval", "p", "verdict")
_NOT_WORSE = "not worse"
"""Of a score without a significant change for the worse or the better, or within the tolerance."""
_NEAR_MISS = "near miss"
"""Of a score that is not proven to be worse, although its whole 95 % interval is worse than the baseline."""
# any character that XML 1.0 does not allow
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, kw_only=True)
class ScoringFailure:
    """An estimator, or `EVERY_ESTIMATOR`, that could not be scored on a walk, and the reason; the gate fails."""

    walk: str
    estimator: str
    why: str


def collect_failures(rows: Sequence[ScoredWalk]) -> list[ScoringFailure]:
    """The failures in results of `score_walk`."""
    return [
        ScoringFailure(walk=row["name"], estimator=name, why=why)
        for row in rows
        for name, why in row.get("failed", {}).items()
    ]


def format_failures(failed: Sequence[ScoringFailure]) -> list[str]:
    """One line per estimator and reason, with the first walk on which it failed and the number of the others."""
    walks: dict[tuple[str, str], list[str]] = {}  # by estimator and reason
    for failure in failed:
        walks.setdefault((failure.estimator, failure.why), []).append(failure.walk)
    lines = []
    for (estimator, why), names in walks.items():
        others = f" and {len(names) - 1} more" if len(names) > 1 else ""
        lines.append(f"FAILED {names[0]}{others}: {estimator}: {why}")
    return lines


def to_cells(line: Line) -> list[str]:
    """The text of a line's cells, one for each column of `HEAD`; - stands for a missing value."""
    values = [f"{value:.4g}" if value is not None else "-" for value in (line.baseline, line.now)]
    unit = "pp" if line.in_points else "%"
    change = "-" if line.change is None else f"{line.change:+.1f} {unit}"
    interval = "-" if line.low is None or line.high is None else f"{line.low:+.1f} to {line.high:+.1f} {unit}"
    if line.limit is not None:  # compared by the tolerance, without a test
        interval = f"limit {line.limit:.4g}"
    p = "-" if line.p is None else f"{line.p:.4f}"
    metric = f"|{line.metric}|" if line.absolute else line.metric
    verdict = _NOT_WORSE if line.verdict == SAME else line.verdict
    return [
        line.estimator,
        metric,
        line.mean or "-",
        *values,
        change,
        interval,
        p,
        _NEAR_MISS if line.near_miss else verdict,
    ]


def find_changes(comparison: Comparison) -> list[Line]:
    """The lines whose verdict is not SAME, and near misses: regressions first, then near misses."""
    changes = [line for line in comparison.lines if line.verdict != SAME or line.near_miss]
    # False sorts before True
    return sorted(changes, key=lambda line: (not line.regressed, not line.near_miss))


def format_limits(comparison: Comparison) -> list[str]:
    """What the verdict does not prove, one line each: near misses, and walks too few to find small changes."""
    near_misses, walks = comparison.near_misses, comparison.tested_walks
    lines = []
    if near_misses:
        count = "1 near miss" if len(near_misses) == 1 else f"{len(near_misses)} near misses"
        lines.append(f"{count}: the whole 95 % interval is worse, but p is above the level; more walks decide")
    if 0 < walks < ENOUGH_WALKS:  # 0: means alone were compared, without a test
        lines.append(f"{walks} walks are too few for changes of 5 to 20 %: expected {ENOUGH_WALKS} or more")
    return lines


def verdict_line(comparison: Comparison, failed: Sequence[ScoringFailure] = ()) -> str:
    """Number of scores that are worse than the baseline, and of failures, as one line of text."""
    count, total = len(comparison.regressions), sum(line.verdict != NEW for line in comparison.lines)
    missing = " or missing" if any(line.verdict == MISSING for line in comparison.regressions) else ""
    if count:
        text, conjunction = f"{count} of {total} scores worse than the baseline{missing}", " and"
    else:
        text, conjunction = f"none of {total} scores is worse", ", but"
    return text + (f"{conjunction} {len(failed)} failed" if failed else "")


def to_markdown(comparison: Comparison, failed: Sequence[ScoringFailure] = ()) -> str:
    """The comparison as a page of Markdown: failures and changes are visible, scores without a change are folded."""
    count = len(comparison.regressions)
    result = f"**{count} worse**" if count else "**nothing worse**"
    result += f"{' and' if count else ', but'} **{len(failed)} failed**" if failed else ""
    out = ["### Estimators against the baseline", "", f"{result} ({comparison.description})", ""]
    out += [line for limit in format_limits(comparison) for line in (_escape(limit), "")]
    changes = find_changes(comparison)
    same = [line for line in comparison.lines if line.verdict == SAME and not line.near_miss]
    if failed:
        rows = [(_escape(x.walk), _escape(x.estimator), _escape(x.why)) for x in failed]
        out += [_markdown_row(row) for row in (("walk", "estimator", "failed"), ("---",) * 3, *rows)] + [""]
    if changes:
        out += [*_markdown_table(changes), ""]
    if same:  # folded: a click on the summary opens the table
        out += ["<details><summary>", f"{len(same)} scores {_NOT_WORSE}", "</summary>", "", *_markdown_table(same), ""]
        out += ["</details>", ""]
    return "\n".join(out)


def _markdown_table(lines: Sequence[Line]) -> list[str]:
    """The rows of a Markdown table of scores against their baselines, with regressions in bold."""
    # the five numbers, from the baseline to p, are aligned to the right, texts to the left
    rows = [_markdown_row(HEAD), _markdown_row(["---"] * 3 + ["---:"] * 5 + ["---"])]
    for line in lines:
        row_cells = [_escape(cell) for cell in to_cells(line)]
        # the last cell is the verdict
        row_cells[-1] = f"**{row_cells[-1]}**" if line.regressed else row_cells[-1]
        rows.append(_markdown_row(row_cells))
    return rows


def _markdown_row(row_cells: Sequence[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row_cells) + " |"


def _escape(text: str) -> str:
    """Text in which Markdown shows underscores literally."""
    return text.replace("_", "\\_")


def to_junit(comparison: Comparison, failed: Sequence[ScoringFailure] = ()) -> str:
    """JUnit XML: one suite per estimator, one test case per score, one error per walk on which it failed."""
    top = ElementTree.Element("testsuites", name="stridetwin score")
    _set_counts(top, comparison.lines, len(failed))
    for name in dict.fromkeys([*(line.estimator for line in comparison.lines), *(x.estimator for x in failed)]):
        lines = [line for line in comparison.lines if line.estimator == name]
        failures_of_name = [failure for failure in failed if failure.estimator == name]
        suite = ElementTree.SubElement(top, "testsuite", name=_valid_xml(name))
        _set_counts(suite, lines, len(failures_of_name))
        for failure in failures_of_name:
            case = _add_case(suite, name, failure.walk)
            ElementTree.SubElement(case, "error", type="failed", message=_valid_xml(failure.why))
        for line in lines:
            case = _add_case(suite, name, line.metric)
            # all cells between the score's name and the verdict, each with the head of its column
            details = ", ".join(f"{head} {cell}" for head, cell in zip(HEAD[2:-1], to_cells(line)[2:-1]) if cell != "-")
            if line.regressed:
                worse = ElementTree.SubElement(
                    case, "failure", type=line.verdict, message=_valid_xml(to_sentence(line))
                )
                worse.text = _valid_xml(f"{details}\n{comparison.description}")
            elif line.verdict == NEW:
                ElementTree.SubElement(case, "skipped", message="not in the baseline")
            elif details:  # what a passed test prints
                ElementTree.SubElement(case, "system-out").text = _valid_xml(details)
    ElementTree.indent(top)
    return ElementTree.tostring(top, encoding="unicode", xml_declaration=True) + "\n"


def _add_case(suite: ElementTree.Element, estimator: str, name: str) -> ElementTree.Element:
    """Adds a test case to a JUnit suite, and returns its element."""
    classname = _valid_xml(f"stridetwin.{estimator}")
    return ElementTree.SubElement(suite, "testcase", classname=classname, name=_valid_xml(name), time="0")


def _set_counts(element: ElementTree.Element, lines: Sequence[Line], failed: int) -> None:
    """Sets the numbers of tests, failures, errors and skipped tests of a JUnit element.

    Args:
        element: The element, which is changed.
        lines: Its scores, one test each; a score that the baseline lacks is a skipped test.
        failed: Number of walks on which an estimator failed, one more test and error each.
    """
    regressed, new = sum(line.regressed for line in lines), sum(line.verdict == NEW for line in lines)
    # the format wants a time, which a score does not have
    counts = {"tests": len(lines) + failed, "failures": regressed, "errors": failed, "skipped": new, "time": 0}
    element.attrib.update({name: str(count) for name, count in counts.items()})


def to_sentence(line: Line) -> str:
    """What has become of one score, as one sentence with both values, the change and its interval."""
    name = f"{line.estimator} {line.metric}"
    if line.verdict == MISSING:
        if line.metric == WALKS:  # both values are numbers of walks
            return f"{line.estimator}: nothing to score on {line.baseline or 0:g} walks but {line.now or 0:g}"
        return f"{name}: missing"
    # the cells in the order of `HEAD`
    _, _, _, baseline, now, change, interval, *_ = to_cells(line)
    result = _NEAR_MISS if line.near_miss else {BETTER: "better", SAME: _NOT_WORSE}.get(line.verdict, line.verdict)
    mean = f" in the {line.mean} mean" if line.mean else ""
    return f"{name}: {result}, {baseline} to {now}{mean} ({change}, {interval})"


def _valid_xml(text: str) -> str:
    """The text without characters that are invalid in XML."""
    return _NOT_XML.sub("?", text)
