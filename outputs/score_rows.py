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
    rows = []
    for score in declared:
        if score.label and any(score.name in column for column in columns):
            title = f"{score.label}, {score.unit}" if score.unit else score.label
            cells = [
                number_text(column[score.name], score.digits) if score.name in column else "\N{EN DASH}"
                for column in columns
            ]
            rows.append((title, *cells))
    return rows


def score_table(declared: Sequence[Score], outputs: Mapping[str, Scores]) -> Markup:
    """An HTML table of scores: one row per declared score that has a label, one column per output.

    Args:
        declared: Scores of a kind, in the order of the rows.
        outputs: Scores of each output, by the title of its column.
    """
    number_columns = range(1, len(outputs) + 1)  # column 0 has the labels
    return table(("Score", *outputs), score_rows(declared, list(outputs.values())), number_columns)
