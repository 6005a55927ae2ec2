"""The report of a study: one self-contained HTML file with figures, the table, the comparison, and the study file."""

from __future__ import annotations

from typing import Any

from stridetwin.pages.html import boxes, page, preformatted, rendered, section, table
from stridetwin.pages.plot import PALETTE, Plot
from stridetwin.studies.study_file.results import failure_lines, table_head, table_rows

_SPREAD = 0.5
"""Share of the distance between combinations over which the methods are spread."""


def study_page(result: dict[str, Any], text: str, command: str) -> str:
    """The page of a study from the result of `run_study`, the text of its file, and the command that makes the page."""
    head, texts = len(result["factors"]) + 1, [*result["words"], *failure_lines(result)]
    walks = f"{len(result['seeds'])} walks of each combination"
    lead = "Means over walks, and over the outputs of a method, such as both feet, with 95 % intervals."
    titles = table_head(result)
    figures = boxes(_score_figure(result, score) for score in result["scores"])
    tested = "Each method against the first one, walk by walk, corrected for the number of comparisons (Holm)."
    sections = [
        section("Scores", lead, figures, css="figures"),
        section("Table", lead, table(titles, table_rows(result), range(head, len(titles)))),
        section("Significance", tested, rendered("list", words=texts)) if texts else "",
        section("The study", command, preformatted(text.splitlines())),
    ]
    chips = [", ".join(result["methods"]), f"{len(result['table']) // len(result['methods'])} combinations", walks]
    return page("Study", result["study"], chips, sections, "Drawn by stridetwin experiment.")


def _score_figure(result: dict[str, Any], score: str) -> str:
    """The means of one score with their intervals, by combination; a colour per method."""
    methods = result["methods"]
    lines = [result["table"][start :: len(methods)] for start in range(len(methods))]
    names = [", ".join(line[factor] for factor in result["factors"]) or "all walks" for line in lines[0]]
    plot = Plot(title=score, x_names=names, x=(-0.5, len(names) - 0.5), y_label=score, height=360)
    for m, method in enumerate(methods):
        color, shift = PALETTE[m % len(PALETTE)], _SPREAD * ((m + 0.5) / len(methods) - 0.5)
        drawn = [(c + shift, line["scores"][score]) for c, line in enumerate(lines[m]) if score in line["scores"]]
        plot.dots([x for x, _ in drawn], [mean["mean"] for _, mean in drawn], color, size=8, label=method)
        ends = [[(x, mean["low"]), (x, mean["high"])] for x, mean in drawn if mean["low"] is not None]
        plot.curves(ends, color, label=method, width=2)
    return plot.html()
