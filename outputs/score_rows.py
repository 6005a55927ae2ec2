"""Rows of a report's table of scores, from the declarations of a kind."""

from __future__ import annotations

from collections.abc import Sequence

from stridetwin.outputs.base import Score, Scores
from stridetwin.pages.html import number_text


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
