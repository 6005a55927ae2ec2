"""Types of the result of a placement, as JSON holds it."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from stridetwin.studies.significance import IntervalRow, Sentences

PlaceValues = dict[str, object]
"""Value of each free field by name, a number or one of the choices; empty for the unchanged scenario."""


class ScoreInResult(TypedDict):
    """A score: its name and weight, and whether `more` or `less` of it is better."""

    name: str
    weight: float
    better: str


class PlaceInTable(TypedDict):
    """A place of the table: rank, name, values, and each score with its 95 % interval; `failed` is a reason."""

    rank: int
    label: str
    values: PlaceValues
    scores: dict[str, IntervalRow]
    failed: NotRequired[str]


class PlacesCompared(TypedDict):
    """The difference of two places by rank, with its 95 % interval and p-value."""

    first: int
    second: int
    difference: float
    low: float | None
    high: float | None
    p: float
    significant: bool


class BestPlace(TypedDict):
    """The best place: its name and values."""

    label: str
    values: PlaceValues


class ParetoPlace(BestPlace):
    """A Pareto-optimal place with its mean scores."""

    scores: dict[str, float]


class PlacementResult(Sentences):
    """The result of a placement.

    Attributes:
        placement: What is placed, in one line.
        scores: The scores.
        free: Names of the free fields.
        walks: Walks of the search.
        walks_of_table: Walks of the table, others with `confirm`.
        tried: Number of places besides the unchanged one.
        failed: Number of places that failed somewhere.
        best: The best place.
        table: Some places, the best first.
        comparisons: Differences of the table's places.
        words: The comparison as sentences.
        pareto: Pareto-optimal places.
        files: Names of the written files.
    """

    placement: str
    scores: list[ScoreInResult]
    free: list[str]
    walks: list[str]
    walks_of_table: list[str]
    tried: int
    failed: int
    best: BestPlace
    table: list[PlaceInTable]
    comparisons: list[PlacesCompared]
    pareto: list[ParetoPlace]
    files: NotRequired[list[str]]
