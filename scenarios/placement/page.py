"""The page of a placement: one HTML file with everything inside it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from stridetwin.scenarios.film import data_uri
from stridetwin.scenarios.placement.body_map import BodyImage
from stridetwin.scenarios.placement.figures import fronts, profiles, value_map
from stridetwin.scenarios.placement.measure import Measured
from stridetwin.scenarios.placement.places import AS_IT_IS, format_value
from stridetwin.scenarios.placement.problem_file import Problem
from stridetwin.scenarios.report import page, section
from stridetwin.streams.samples import Array


def placement_page(
    problem: Problem, searched: Measured, losses: Array, result: Mapping[str, Any], image: BodyImage | None
) -> str:
    """The page.

    Args:
        problem: The placement problem.
        searched: All places.
        losses: (P,) mean loss of each.
        result: As `run_placement` gives it.
        image: The places on the body.
    """
    chips = [f"{result['tried']} places", f"{len(result['walks'])} walks each", *result["words"][:1]]
    lead = "Means over the same walks at every place, with 95 % intervals; the best first."
    if result["walks_of_table"] != result["walks"]:
        lead += f" The table is of {len(result['walks_of_table'])} other walks than the search has seen."
    sections = [
        section("Places", lead, _table(problem, result)),
        section("What is more than chance", "Pairs of the table, walk by walk, corrected for their number.",
                f"<ul>{''.join(f'<li>{escape(words)}</li>' for words in result['words'])}</ul>"),
    ]  # fmt: skip
    if image is not None:
        body = f'<img src="{data_uri(image.png, "image/png")}" alt="{escape(image.words)}" style="max-width:100%">'
        sections.append(section("On the body", image.words, body))
    if drawn := value_map(problem, searched, losses):
        sections.append(section("Over two values", "The other values at their best.", drawn))
    if drawn_over := profiles(problem, searched, losses):
        figures = "".join(f"<figure>{svg}</figure>" for svg in drawn_over)
        sections.append(section("Over each value", "Every place.", f'<div class="multiples">{figures}</div>'))
    if pairs := fronts(problem, searched, losses):
        figures = "".join(f"<figure>{svg}</figure>" for svg in pairs)
        lead = "On the front no place is better in one score without being worse in the other."
        sections.append(section("What one score costs in another", lead, f'<div class="multiples">{figures}</div>'))
    return page("Placement", problem.description, chips, sections, "Drawn by stridetwin place.")


def _table(problem: Problem, result: Mapping[str, Any]) -> str:
    knobs = [knob.name for knob in problem.knobs]
    head = "".join(f"<th class='n'>{escape(name)}</th>" for name in (*knobs, *(s.name for s in problem.scores)))
    rows = ""
    for row in result["table"]:
        cells = "".join(f"<td class='n'>{escape(said(row['scores'].get(s.name)))}</td>" for s in problem.scores)
        values = "".join(f"<td class='n'>{escape(said_value(row['values'], name))}</td>" for name in knobs)
        words = f"<br>{escape(row['failed'])}" if "failed" in row else ""
        rows += f"<tr><td>{row['rank']}{words}</td>{values}{cells}</tr>"
    return f'<div class="scroll"><table><tr><th>place</th>{head}</tr>{rows}</table></div>'


def said_value(values: Mapping[str, Any], name: str) -> str:
    """The value of a knob in a table."""
    return format_value(values[name]) if values else AS_IT_IS


def said(interval: Mapping[str, float | None] | None) -> str:
    """A mean with its interval."""
    if interval is None:
        return "-"
    if interval["low"] is None:
        return f"{interval['mean']:.4g}"
    return f"{interval['mean']:.4g} ({interval['low']:.4g} to {interval['high']:.4g})"
