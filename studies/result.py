"""Types of what experiments compute: the rows of their cases, and the results that tables and reports show.

Rows and results are JSON. A module's `run_case` gives a `Row`; the types with named keys are what its `collect` and
`table` read of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Generic, NotRequired, TypedDict, TypeVar

from stridetwin.batch.jobs import Row

SummaryT = TypeVar("SummaryT")
PaperT = TypeVar("PaperT")
CaseT = TypeVar("CaseT")
FiguresT = TypeVar("FiguresT")

Figures = Mapping[str, object]
"""Figures of one line of a table by name: numbers, texts, lists of numbers, or None for a missing one."""
LabelledFigures = tuple[str, Figures]
"""Label and figures of one line of a table."""
Summary = dict[str, object]
"""Figures over all cases by name; some are of all methods, others of one, by the name of the method."""
NoPaper = dict[str, object]
"""Published figures of an experiment without any: empty."""


class CaseRow(TypedDict):
    """What every row has; a row also has the levels whose turn it is with the seed.

    Attributes:
        seed: Seed of the case.
        physics: How the body moves.
    """

    seed: int
    physics: str


class FaultRow(CaseRow, Generic[FiguresT]):
    """The row of a fault study.

    Attributes:
        faults: What came of each fault, by label.
    """

    faults: dict[str, FiguresT]


class Collected(TypedDict, Generic[SummaryT, PaperT]):
    """Figures over all cases.

    Attributes:
        summary: Ours.
        paper: Those of a paper.
    """

    summary: SummaryT
    paper: PaperT


class Result(Collected[SummaryT, PaperT], Generic[SummaryT, PaperT, CaseT]):
    """The result of an experiment.

    Attributes:
        experiment: Its name in the catalogue.
        description: What is compared, in one line.
        cases: Row of each case.
        parameters: Values of `--set`, by estimator and name; only where there are any.
    """

    experiment: str
    description: str
    cases: list[CaseT]
    parameters: NotRequired[dict[str, dict[str, object]]]


AnyResult = Result[Mapping[str, object], Mapping[str, object], Row]
"""The result of any experiment; only its own module knows what its summary holds."""


def get_figures(figures: Figures, name: str) -> Figures:
    """The figures below a name, such as those of one method in a summary."""
    inner = figures[name]
    assert isinstance(inner, Mapping)
    return inner
