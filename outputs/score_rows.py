"""A report's table of scores, from the declarations of a kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from stridetwin.outputs.base import Score, Scores
from stridetwin.pages.html import number_text, table


def score_rows(declared: Sequence[Score], columns: Sequence[Scores]) -> list[tuple[str, ...]]:
    """One row per declared score that has a label and that any column has: label with unit, then each column's value.

    Args:
        declared: Scores of a kind, in the order of the rows.
        columns: Scores of the outputs to show side by side; a missing score is a dash.
    """
    return [
        (
            f"{score.label}, {score.unit}" if score.unit else score.label,
            *(number_text(c[score.name], score.digits) if score.name in c else "\N{EN DASH}" for c in columns),
        )
        for score in declared
        if score.label and any(score.name in column for column in columns)
    ]


def score_table(declared: Sequence[Score], outputs: Mapping[str, Scores]) -> Markup:
    """The rows of `score_rows` as a table with one column per output, by the title of the column."""
    return table(("Score", *outputs), score_rows(declared, list(outputs.values())), range(1, len(outputs) + 1))
