"""A comparison in words: a table for a terminal, Markdown for a pull request, JUnit XML for a build server."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from stridetwin.scenarios.gate.compare import BETTER, MISSING, NEW, SAME, WALKS, Comparison, Line

HEAD = ("estimator", "score", "baseline", "now", "change", "95 % interval", "p", "verdict")
_WIDTHS = (44, 11, 11, 11, 24, 9)
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def cells(line: Line) -> list[str]:
    """A line's cells, by `HEAD`."""
    values = [f"{value:.4g}" if value is not None else "-" for value in (line.baseline, line.now)]
    unit = "pp" if line.in_points else "%"
    change = "-" if line.change is None else f"{line.change:+.1f} {unit}"
    interval = "-" if line.low is None or line.high is None else f"{line.low:+.1f} to {line.high:+.1f} {unit}"
    if line.limit is not None:
        interval = f"limit {line.limit:.4g}"
    p = "-" if line.p is None else f"{line.p:.4f}"
    return [line.estimator, line.metric, *values, change, interval, p, line.verdict]


def table_lines(comparison: Comparison) -> list[str]:
    """What has changed, what closes the gate first; that nothing has in one line."""
    told = [line for line in comparison.lines if line.verdict != SAME]
    lines = [f"against the baseline: {comparison.words}"]
    if told:
        lines.append(_row(HEAD))
    lines += [_row(cells(line)) for line in sorted(told, key=lambda line: not line.regressed)]
    count, judged = len(comparison.regressions), sum(line.verdict != NEW for line in comparison.lines)
    verdict = f"{count} of {judged} scores worse than the baseline" if count else f"none of {judged} scores is worse"
    return [*lines, verdict]


def _row(words: Sequence[str]) -> str:
    named = [" ".join(words[:2]), *words[2:7]]
    return f"{named[0]:<{_WIDTHS[0]}}{''.join(f'{x:>{n}}' for x, n in zip(named[1:], _WIDTHS[1:]))}  {words[7]}"


def markdown(comparison: Comparison) -> str:
    """The comparison as a page of Markdown: what has changed open to see, all else folded."""
    count = len(comparison.regressions)
    verdict = f"**{count} worse**" if count else "**nothing worse**"
    out = ["### Estimators against the baseline", "", f"{verdict} ({comparison.words})", ""]
    told = sorted((x for x in comparison.lines if x.verdict != SAME), key=lambda line: not line.regressed)
    same = [line for line in comparison.lines if line.verdict == SAME]
    if told:
        out += [*_markdown_table(told), ""]
    if same:
        out += ["<details><summary>", f"{len(same)} scores unchanged", "</summary>", "", *_markdown_table(same), ""]
        out += ["</details>", ""]
    return "\n".join(out)


def _markdown_table(lines: Sequence[Line]) -> list[str]:
    def row(words: Sequence[str]) -> str:
        return "| " + " | ".join(word.replace("|", "\\|").replace("\n", " ") for word in words) + " |"

    rows = [row(HEAD), row(["---"] * 2 + ["---:"] * 5 + ["---"])]
    for line in lines:
        words = [cell.replace("_", "\\_") for cell in cells(line)]
        words[-1] = f"**{words[-1]}**" if line.regressed else words[-1]
        rows.append(row(words))
    return rows


def junit(comparison: Comparison) -> str:
    """The comparison as JUnit XML: a suite an estimator, a test case a score."""
    top = ElementTree.Element("testsuites", name="stridetwin score")
    _count(top, comparison.lines)
    for name in dict.fromkeys(line.estimator for line in comparison.lines):
        own = [line for line in comparison.lines if line.estimator == name]
        suite = ElementTree.SubElement(top, "testsuite", name=_xml(name))
        _count(suite, own)
        for line in own:
            case = ElementTree.SubElement(
                suite, "testcase", classname=_xml(f"stridetwin.{name}"), name=_xml(line.metric)
            )
            case.set("time", "0")
            words = ", ".join(f"{head} {cell}" for head, cell in zip(HEAD[2:-1], cells(line)[2:-1]) if cell != "-")
            if line.regressed:
                failure = ElementTree.SubElement(case, "failure", type=line.verdict, message=_xml(said(line)))
                failure.text = _xml(f"{words}\n{comparison.words}")
            elif line.verdict == NEW:
                ElementTree.SubElement(case, "skipped", message="not in the baseline")
            elif words:
                ElementTree.SubElement(case, "system-out").text = _xml(words)
    ElementTree.indent(top)
    return ElementTree.tostring(top, encoding="unicode", xml_declaration=True) + "\n"


def _count(element: Any, lines: Sequence[Line]) -> None:
    element.set("tests", str(len(lines)))
    element.set("failures", str(sum(line.regressed for line in lines)))
    element.set("errors", "0")
    element.set("skipped", str(sum(line.verdict == NEW for line in lines)))
    element.set("time", "0")


def said(line: Line) -> str:
    """A verdict in one sentence."""
    name = f"{line.estimator} {line.metric}"
    if line.verdict == MISSING:
        if line.metric == WALKS:
            return f"{line.estimator}: nothing to score on {line.baseline or 0:g} walks but {line.now or 0:g}"
        return f"{name}: missing"
    _, _, baseline, now, change, interval, _, verdict = cells(line)
    words = {BETTER: "better", SAME: "unchanged"}.get(verdict, verdict)
    return f"{name}: {words}, {baseline} to {now} ({change}, {interval})"


def _xml(text: str) -> str:
    """Without the characters that XML cannot hold."""
    return _NOT_XML.sub("?", text)
