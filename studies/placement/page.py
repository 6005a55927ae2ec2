"""The report of a placement: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from stridetwin.report.film import data_uri
from stridetwin.report.html import multiples, page, rendered, section, table
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.body_map import BodyImage
from stridetwin.studies.placement.figures import fronts, profiles, value_map
from stridetwin.studies.placement.measure import Measured
from stridetwin.studies.placement.places import AS_IT_IS, format_value
from stridetwin.studies.placement.problem_file import Problem


def placement_page(
    problem: Problem, searched: Measured, losses: Array, result: Mapping[str, Any], image: BodyImage | None
) -> str:
    """The page.

    Args:
        problem: The placement problem.
        searched: All places.
        losses: (P,) mean loss of each.
        result: Result of `run_placement`.
        image: The body map.
    """
    chips = [f"{result['tried']} places", f"{len(result['walks'])} walks each", *result["words"][:1]]
    lead = "Means over the same walks at every place, with 95 % intervals; the best first."
    if result["walks_of_table"] != result["walks"]:
        lead += f" The table is of {len(result['walks_of_table'])} other walks than the search has seen."
    sections = [
        section("Places", lead, _table(problem, result)),
        section("What is more than chance", "Pairs of the table, walk by walk, corrected for their number.",
                rendered("list", words=result["words"])),
    ]  # fmt: skip
    if image is not None:
        tag = Markup('<img src="{}" alt="{}" style="max-width:100%">')
        sections.append(section("On the body", image.words, tag.format(data_uri(image.png, "image/png"), image.words)))
    if drawn := value_map(problem, searched, losses):
        sections.append(section("Over two values", "The other values at their best.", drawn))
    if drawn_over := profiles(problem, searched, losses):
        sections.append(section("Over each value", "Every place.", multiples(drawn_over)))
    if pairs := fronts(problem, searched, losses):
        lead = "On the front no place is better in one score without being worse in the other."
        sections.append(section("What one score costs in another", lead, multiples(pairs)))
    return page("Placement", problem.description, chips, sections, "Drawn by stridetwin place.")


def _table(problem: Problem, result: Mapping[str, Any]) -> str:
    knobs = [knob.name for knob in problem.knobs]
    head = ("place", *knobs, *(s.name for s in problem.scores))
    rows = [
        (
            Markup("<br>").join([str(row["rank"]), *([row["failed"]] if "failed" in row else [])]),
            *(said_value(row["values"], name) for name in knobs),
            *(said(row["scores"].get(s.name)) for s in problem.scores),
        )
        for row in result["table"]
    ]
    return table(head, rows, range(1, len(head)))


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
