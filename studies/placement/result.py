"""Types of the result of a placement, as JSON holds it."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from stridetwin.studies.significance import IntervalRow, Sentences

PlaceValues = dict[str, object]
"""Value of each knob by name, a number or one of the choices; empty for the unchanged scenario."""


class ScoreInResult(TypedDict):
    """A score: its name and weight, and whether `more` or `less` of it is better."""

    name: str
    weight: float
    better: str


class PlaceInTable(TypedDict):
    """A place of the table.

    Attributes:
        rank: Its rank, from 1.
        label: Its name: its values as text, or `as it is`.
        values: Its values.
        scores: By name, each score's mean over the walks with its 95 % interval; missing ones are left out.
        failed: Reason for a missing score.
    """

    rank: int
    label: str
    values: PlaceValues
    scores: dict[str, IntervalRow]
    failed: NotRequired[str]


class PlacesCompared(TypedDict):
    """The difference of two places, over the walks of the table.

    Attributes:
        first: Rank of the first place, from 1.
        second: Rank of the second one.
        difference: Mean loss of the second place minus that of the first.
        low: Lower end of its 95 % interval; None with one or two walks.
        high: Upper end.
        p: p-value, corrected for the number of pairs.
        significant: Whether the difference is significant.
    """

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
    """A Pareto-optimal place.

    Attributes:
        scores: By name, the mean of each score over the walks.
    """

    scores: dict[str, float]


class PlacementResult(Sentences):
    """The result of a placement.

    Attributes:
        placement: What is placed, in one line.
        scores: The scores.
        free: Names of the knobs; a position on a surface has several.
        walks: Walks of the search.
        walks_of_table: Walks of the table, others with `confirm`.
        tried: Number of places besides the unchanged one.
        failed: Number of places that lack a score on some walk, the unchanged one included.
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
