"""Scores of a placement: their names, directions and weights, and when a board counts as seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, TypedDict

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from stridetwin.gate.metric_policy import scale_of
from stridetwin.outputs.base import Scores
from stridetwin.streams.fields import DEG, DEGREES, FileModel, Number, Text, field_error
from stridetwin.streams.samples import Array
from stridetwin.streams.validation import suggest

GEOMETRIC_SCORES = {
    "visibility_pct": ("foot_camera", True, "share of the time in which a shoe's camera sees the other's whole board"),
    "sharp_pct": ("foot_camera", True, "the same, with little motion blur"),
    "occlusion_pct": ("foot_camera", False, "share of the time with a board in view in which limbs occlude it"),
    "square_px": ("foot_camera", True, "mean edge of a board's square in the image while it is seen"),
    "ahead_pct": ("head_camera", True, "share of the ground 0.5 to 2.5 m ahead that the depth camera sees"),
    "own_body_pct": ("head_camera", False, "share of its image covered by the walker's own body"),
    "weight_g": ("", False, "weight of all enabled sensors"),
    "foot_weight_g": ("", False, "weight of the sensors on one foot"),
}
"""Scores that need no recording: the group of sensors that they need, whether more is better, and what they are."""


@dataclass(frozen=True, kw_only=True)
class Seeing:
    """When a board counts as seen.

    Attributes:
        least_px: Edge of its squares in the image, at the board's centre, if it were seen face on.
        incidence_rad: Largest angle between its normal and the line of sight.
        blur_squares: Largest displacement of its centre during the exposure, in squares; for `sharp_pct`.
    """

    least_px: Annotated[Number, Field(ge=0.1, le=1000)] = 4.0
    incidence_rad: Annotated[Number, Field(ge=1, le=89.9, alias="incidence_deg"), DEGREES] = 65.0 * DEG
    blur_squares: Annotated[Number, Field(ge=0.001, le=100)] = 0.5


class PlaceRow(TypedDict, total=False):
    """The scores of a place on a walk.

    Attributes:
        walk: Name of the walk.
        scores: Geometric scores by name.
        estimators: Scores of estimators by output.
        failed: Reason by estimator; by `walk` if the place or the walk is infeasible.
    """

    walk: str
    scores: dict[str, float]
    estimators: dict[str, Scores]
    failed: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class PlaceScore:
    """A score by which places are compared: geometric, or of an estimator.

    Attributes:
        name: Of `GEOMETRIC_SCORES`, or ESTIMATOR.METRIC.
        weight: In the objective; 0 for a score that is only reported.
    """

    name: str
    weight: float

    @property
    def geometric(self) -> bool:
        """Whether the score comes from geometry alone and needs no recording."""
        return self.name in GEOMETRIC_SCORES

    @property
    def higher_is_better(self) -> bool:
        """Whether a larger value of the score is better."""
        if self.geometric:
            return GEOMETRIC_SCORES[self.name][1]
        scale = scale_of(self.metric)
        return scale is not None and scale.higher_is_better

    def losses(self, values: Array) -> Array:
        """Losses, lower is better, of values of any shape.

        Where more is better they are the negative values, otherwise the absolute values, so that an error with a sign
        counts by its size.
        """
        return -values if self.higher_is_better else np.abs(values)

    @property
    def metric(self) -> str:
        """Name of the score without that of its estimator; empty for a geometric one."""
        return self.name.partition(".")[2]

    def of(self, row: PlaceRow) -> float:
        """Value of the score in the row of a place on a walk.

        It is the mean of both feet where the estimator gives one for each, and NaN if the score is missing.
        """
        if self.geometric:
            return float(row.get("scores", {}).get(self.name, math.nan))
        values = [output[self.metric] for output in self._scores_of_estimator(row) if self.metric in output]
        return sum(values) / len(values) if values else math.nan

    def find_reported(self, row: PlaceRow) -> set[str]:
        """Names of all scores that the score's estimator reports in a row."""
        return {metric for output in self._scores_of_estimator(row) for metric in output}

    def _scores_of_estimator(self, row: PlaceRow) -> list[Scores]:
        """Scores of each output of the score's estimator in a row: one, or one per foot; none if it has not run."""
        name = self.name.partition(".")[0]  # of the estimator
        outputs = row.get("estimators", {})
        keys = [name] if name in outputs else [f"{name}_l", f"{name}_r"]
        return [outputs[key] for key in keys if key in outputs]


def _check_score_name(name: str) -> str:
    """Returns the name of a score; refuses names that are neither geometric nor an estimator's with a scale."""
    estimator, dot, metric = name.partition(".")
    if name in GEOMETRIC_SCORES or (dot and estimator and metric and scale_of(metric) is not None):
        return name
    alternatives = "or ESTIMATOR.METRIC as `score` reports them, such as foot_ins.end_error_m"
    raise field_error(name, f"{suggest(name, GEOMETRIC_SCORES)}, {alternatives}")


class _Weighed(FileModel):
    """A score and its weight.

    Attributes:
        score: One that needs no recording, or ESTIMATOR.METRIC.
        weight: In the sum that the search minimises; 0 for a score that is only reported.
    """

    score: Annotated[Text, AfterValidator(_check_score_name)]
    weight: Annotated[Number, Field(ge=0, le=1e9)] | None = None


def _to_long_form(node: object) -> object:
    """The long form of a score that is given as text alone; other nodes as they are."""
    return {"score": node} if isinstance(node, str) else node


def _to_place_scores(items: tuple[_Weighed, ...]) -> tuple[PlaceScore, ...]:
    """The scores of a placement with their weights; a first score without weight has 1, any other has 0.

    Raises:
        PydanticCustomError: A score occurs twice, or none has a weight above 0.
    """
    scores: list[PlaceScore] = []
    for i, item in enumerate(items):
        if any(score.name == item.score for score in scores):
            raise field_error(item.score, "every score once", i, "score")
        default_weight = 0.0 if i else 1.0
        weight = default_weight if item.weight is None else item.weight
        scores.append(PlaceScore(name=item.score, weight=weight))
    if not any(score.weight for score in scores):
        raise field_error([score.name for score in scores], "at least one score with a weight above 0")
    return tuple(scores)


ScoresInFile = Annotated[
    tuple[Annotated[_Weighed, BeforeValidator(_to_long_form, json_schema_input_type=str | _Weighed)], ...],
    Field(min_length=1),
    AfterValidator(_to_place_scores),
]
"""Type of the list `scores`."""
