"""The report of a study: one self-contained HTML file with figures, the table, the comparison, and the study file."""

from __future__ import annotations

from stridetwin.pages.html import page, render_template, section, table, text_block
from stridetwin.pages.plot import PALETTE, Plot
from stridetwin.studies.study_file.results import StudyResult, table_head, table_rows

_SPREAD = 0.5
"""Share of the distance between combinations over which the methods are spread."""


def study_page(result: StudyResult, text: str, command: str) -> str:
    """The page of a study.

    Args:
        result: Result of `run_study`.
        text: Text of the study file, which the page shows.
        command: The command that makes the page.
    """
    # sentences above the figures and above the comparison
    lead = "Means over walks, and over the outputs of a method, such as both feet, with 95 % intervals."
    tested = "Each method against the first one, walk by walk, corrected for the number of comparisons (Holm)."
    head = table_head(result)
    # the table has one line per combination and method
    combination_count = len(result["table"]) // len(result["methods"])
    sections = [
        section("Scores", lead, "".join(_draw_score(result, score) for score in result["scores"])),
        section(
            "Table",
            "The same as numbers.",
            table(head, table_rows(result), range(len(result["factors"]) + 1, len(head))),
        ),
        section("Comparison", tested, render_template("list", words=result["words"])) if result["words"] else "",
        section("The study", command, text_block(text.splitlines())),
    ]
    chips = [", ".join(result["methods"]), f"{combination_count} combinations", f"{len(result['seeds'])} walks of each"]
    return page("Study", result["study"], chips, sections, "Drawn by stridetwin experiment.")


def _draw_score(result: StudyResult, score: str) -> str:
    """A figure of the means of one score with their intervals, by combination; a colour per method."""
    methods = result["methods"]
    # of each combination, once: the first line of each
    names = [", ".join(line["levels"].values()) or "all walks" for line in result["table"][:: len(methods)]]
    plot = Plot(title=score, x_names=names, x=(-0.5, len(names) - 0.5), y_label=score, height=360)
    for m, method in enumerate(methods):
        color = PALETTE[m % len(PALETTE)]
        shift = _SPREAD * ((m + 0.5) / len(methods) - 0.5)  # the methods are drawn side by side at each combination
        # lines of the table are ordered by combination, then by method: every n-th one from m on is of this method
        means = [line["scores"].get(score) for line in result["table"][m :: len(methods)]]
        # place on the axis, and mean with its interval, where the method has the score
        drawn = [(c + shift, mean) for c, mean in enumerate(means) if mean is not None]
        plot.dots([x for x, _ in drawn], [mean["mean"] for _, mean in drawn], color, size=8, label=method)
        # a vertical line for each interval
        bounds = [(x, mean["low"], mean["high"]) for x, mean in drawn]
        ends = [[(x, low), (x, high)] for x, low, high in bounds if low is not None and high is not None]
        plot.curves(ends, color, label=method, width=2)
    return plot.html()
