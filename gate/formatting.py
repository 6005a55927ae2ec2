"""Formats a comparison: a table for a terminal, Markdown for a pull request, JUnit XML for a build server."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from stridetwin.gate.compare import BETTER, MISSING, NEW, SAME, WALKS, Comparison, Line

HEAD = ("estimator", "score", "mean", "baseline", "now", "change", "95 % interval", "p", "verdict")
_NOT_WORSE = "not worse"
"""Of a score without a significant change for the worse or the better, or within the tolerance."""
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, kw_only=True)
class Failure:
    """An estimator (or `score_table.EVERY`) that could not be scored on a walk, and the reason; the gate fails."""

    walk: str
    estimator: str
    why: str


def failures(rows: Sequence[Mapping[str, Any]]) -> list[Failure]:
    """The failures in results of `score_walk`."""
    return [
        Failure(walk=str(row["name"]), estimator=name, why=why)
        for row in rows
        for name, why in row.get("failed", {}).items()
    ]


def failed_lines(failed: Sequence[Failure]) -> list[str]:
    """One line per reason, with the first of the walks that it concerns."""
    walks: dict[tuple[str, str], list[str]] = {}
    for x in failed:
        walks.setdefault((x.estimator, x.why), []).append(x.walk)
    return [
        f"FAILED {names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {estimator}: {why}"
        for (estimator, why), names in walks.items()
    ]


def cells(line: Line) -> list[str]:
    """A line's cells, by `HEAD`."""
    values = [f"{value:.4g}" if value is not None else "-" for value in (line.baseline, line.now)]
    unit = "pp" if line.in_points else "%"
    change = "-" if line.change is None else f"{line.change:+.1f} {unit}"
    interval = "-" if line.low is None or line.high is None else f"{line.low:+.1f} to {line.high:+.1f} {unit}"
    if line.limit is not None:
        interval = f"limit {line.limit:.4g}"
    p = "-" if line.p is None else f"{line.p:.4f}"
    metric = f"|{line.metric}|" if line.absolute else line.metric
    return [
        line.estimator,
        metric,
        line.mean or "-",
        *values,
        change,
        interval,
        p,
        _NOT_WORSE if line.verdict == SAME else line.verdict,
    ]


def changed(comparison: Comparison) -> list[Line]:
    """The lines with a change, regressions first."""
    return sorted((x for x in comparison.lines if x.verdict != SAME), key=lambda line: not line.regressed)


def verdict(comparison: Comparison, failed: Sequence[Failure] = ()) -> str:
    """The result of a comparison in one line."""
    count, tested = len(comparison.regressions), sum(line.verdict != NEW for line in comparison.lines)
    missing = " or missing" if any(line.verdict == MISSING for line in comparison.regressions) else ""
    words = (
        f"{count} of {tested} scores worse than the baseline{missing}" if count else f"none of {tested} scores is worse"
    )
    return words + (f"{' and' if count else ', but'} {len(failed)} failed" if failed else "")


def markdown(comparison: Comparison, failed: Sequence[Failure] = ()) -> str:
    """The comparison as a page of Markdown: changes are visible, the rest is folded."""
    count = len(comparison.regressions)
    words = f"**{count} worse**" if count else "**nothing worse**"
    words += f"{' and' if count else ', but'} **{len(failed)} failed**" if failed else ""
    out = ["### Estimators against the baseline", "", f"{words} ({comparison.words})", ""]
    changes = changed(comparison)
    same = [line for line in comparison.lines if line.verdict == SAME]
    if failed:
        rows = [(_escaped(x.walk), _escaped(x.estimator), _escaped(x.why)) for x in failed]
        out += [_markdown_row(row) for row in (("walk", "estimator", "failed"), ("---",) * 3, *rows)] + [""]
    if changes:
        out += [*_markdown_table(changes), ""]
    if same:
        out += ["<details><summary>", f"{len(same)} scores {_NOT_WORSE}", "</summary>", "", *_markdown_table(same), ""]
        out += ["</details>", ""]
    return "\n".join(out)


def _markdown_table(lines: Sequence[Line]) -> list[str]:
    rows = [_markdown_row(HEAD), _markdown_row(["---"] * 3 + ["---:"] * 5 + ["---"])]
    for line in lines:
        words = [_escaped(cell) for cell in cells(line)]
        words[-1] = f"**{words[-1]}**" if line.regressed else words[-1]
        rows.append(_markdown_row(words))
    return rows


def _markdown_row(words: Sequence[str]) -> str:
    return "| " + " | ".join(word.replace("|", "\\|").replace("\n", " ") for word in words) + " |"


def _escaped(word: str) -> str:
    return word.replace("_", "\\_")


def junit(comparison: Comparison, failed: Sequence[Failure] = ()) -> str:
    """JUnit XML: one suite per estimator, one test case per score, one error per walk on which it failed."""
    top = ElementTree.Element("testsuites", name="stridetwin score")
    _count(top, comparison.lines, len(failed))
    for name in dict.fromkeys([*(line.estimator for line in comparison.lines), *(x.estimator for x in failed)]):
        own = [line for line in comparison.lines if line.estimator == name]
        fell = [failure for failure in failed if failure.estimator == name]
        suite = ElementTree.SubElement(top, "testsuite", name=_xml(name))
        _count(suite, own, len(fell))
        for failure in fell:
            case = _case(suite, name, failure.walk)
            ElementTree.SubElement(case, "error", type="failed", message=_xml(failure.why))
        for line in own:
            case = _case(suite, name, line.metric)
            words = ", ".join(f"{head} {cell}" for head, cell in zip(HEAD[2:-1], cells(line)[2:-1]) if cell != "-")
            if line.regressed:
                worse = ElementTree.SubElement(case, "failure", type=line.verdict, message=_xml(sentence(line)))
                worse.text = _xml(f"{words}\n{comparison.words}")
            elif line.verdict == NEW:
                ElementTree.SubElement(case, "skipped", message="not in the baseline")
            elif words:
                ElementTree.SubElement(case, "system-out").text = _xml(words)
    ElementTree.indent(top)
    return ElementTree.tostring(top, encoding="unicode", xml_declaration=True) + "\n"


def _case(suite: Any, estimator: str, name: str) -> Any:
    classname = _xml(f"stridetwin.{estimator}")
    return ElementTree.SubElement(suite, "testcase", classname=classname, name=_xml(name), time="0")


def _count(element: Any, lines: Sequence[Line], failed: int) -> None:
    regressed, new = sum(line.regressed for line in lines), sum(line.verdict == NEW for line in lines)
    counts = {"tests": len(lines) + failed, "failures": regressed, "errors": failed, "skipped": new, "time": 0}
    element.attrib.update({name: str(count) for name, count in counts.items()})


def sentence(line: Line) -> str:
    """A verdict in one sentence."""
    name = f"{line.estimator} {line.metric}"
    if line.verdict == MISSING:
        if line.metric == WALKS:
            return f"{line.estimator}: nothing to score on {line.baseline or 0:g} walks but {line.now or 0:g}"
        return f"{name}: missing"
    _, _, _, baseline, now, change, interval, *_ = cells(line)
    words = {BETTER: "better", SAME: _NOT_WORSE}.get(line.verdict, line.verdict)
    mean = f" in the {line.mean} mean" if line.mean else ""
    return f"{name}: {words}, {baseline} to {now}{mean} ({change}, {interval})"


def _xml(text: str) -> str:
    """The text without characters that are invalid in XML."""
    return _NOT_XML.sub("?", text)
