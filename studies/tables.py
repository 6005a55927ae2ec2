"""Text tables of the studies: labelled rows of figures in declared columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from string import Formatter

from stridetwin.studies.result import AnyResult, Figures, LabelledFigures

Column = tuple[str, int, str]
"""Header, width in characters, and format string of a row's figures, such as `{up:.3f}`.

Missing figures print as -; `!m` multiplies by 1000.
"""


def table_lines(columns: Sequence[Column], rows: Iterable[LabelledFigures], width: int, title: str = "") -> list[str]:
    """Lines of text: the header, then one line per row.

    Args:
        columns: The columns after the label.
        rows: Label and figures of each line; figures with `error` are of an estimator that refused to run.
        width: Width of the labels, characters.
        title: Header of the labels.
    """
    header = "".join(f"{head:>{column_width}}" for head, column_width, _ in columns)
    lines = [f"{label:<{width}}{_cells_text(columns, figures)}" for label, figures in rows]
    return [f"{title:<{width}}{header}", *lines]


def rows_table(
    title: str,
    columns: Sequence[Column],
    rows: Callable[[AnyResult], Iterable[LabelledFigures]] | None,
    result: AnyResult,
) -> list[str]:
    """Lines of text: a title, walks that ended by a fall if the cases name them (`fell`), and one line per row.

    Args:
        title: Lines above the columns; `{count}` is the number of cases.
        columns: The columns of the figures.
        rows: From the result to the label and figures of each row; None takes the mappings in its `summary`.
        result: Result of an experiment.
    """
    cases = result["cases"]
    lines = title.format(count=len(cases)).splitlines()
    if "fell" in cases[0]:
        fell = [f"{walk} {case['seed']}" for case in cases for walk in _to_list(case["fell"])]
        lines.append(f"walks that ended by a fall: {', '.join(fell) or 'none'}")
    summary = [(label, figures) for label, figures in result["summary"].items() if isinstance(figures, Mapping)]
    labelled_figures = list(rows(result)) if rows else summary
    width = max(len(label) for label, _ in labelled_figures) + 2  # two spaces after the longest label
    return [*lines, *table_lines(columns, labelled_figures, width)]


def _to_list(value: object) -> list[object]:
    """A value of a row, typed as the list that it is."""
    assert isinstance(value, list)
    return value


def _cells_text(columns: Sequence[Column], figures: Figures) -> str:
    """The cells of one row as text, without its label.

    A row with `error` says instead on how many walks the estimator refused to run, and its first message.
    """
    if "error" in figures:
        return f"{figures['refused']} of {figures['of']} refused: {figures['error']}"
    return "".join(f"{_CELL.vformat(cell, (), figures):>{width}}" for _, width, cell in columns).rstrip()


class _Cell(Formatter):
    """Formats a cell as `str.format` does, but lists value by value, and a missing value as -."""

    def get_field(self, field_name: str, args: Sequence[object], kwargs: Mapping[str, object]) -> object:
        """The value of a field of a row, and its name; None in place of a value that is missing."""
        try:
            return super().get_field(field_name, args, kwargs)
        except (KeyError, TypeError):
            return None, field_name

    def convert_field(self, value: object, conversion: str | None) -> object:
        """The value after a conversion; `!m` multiplies it, or each value of a list, by 1000."""
        if conversion != "m":
            return super().convert_field(value, conversion)
        if value is None or isinstance(value, list):
            return None if value is None else [1e3 * v for v in value]
        assert isinstance(value, (int, float))
        return 1e3 * value

    def format_field(self, value: object, format_spec: str) -> str:
        """The value as text: the values of a list one after the other, and - for a missing one."""
        if isinstance(value, list):
            return " ".join(format(v, format_spec) for v in value)
        if value is None:
            # only the width of a format such as `+8.2f` counts: what is before the point, without the sign
            return format("-", format_spec.split(".")[0].lstrip("+"))
        return str(value) if isinstance(value, str) else format(value, format_spec)


_CELL = _Cell()
