"""What of the scores is judged, and on which scale: a loss of which more is worse, and of which a mean makes sense.

Errors and leads lie on a scale of ratios, shares on one of percentage points. What a filter's innovations and errors
are against its own claims (NIS, NEES) is judged on a scale of ratios too, by whether it has grown: then it errs more
than before for what it claims, or claims more. Its distance from an honest filter's figure does not serve: a timid one
comes nearer to that by erring more. That it has shrunk is neither good nor bad: the filter errs less, or has
become timid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

ERROR, LEAD, SHARE, BAD_SHARE, CLAIM = "error", "lead", "share", "bad_share", "claim"
OVERALL = "overall"
"""The composite of an estimator's errors, beside its scores."""

# what rounding between machines may do, in the unit of the key
_SLACK = {"_m": 0.002, "_mm": 0.2, "_deg": 0.02, "_pct": 0.02, "_s": 0.05, "_error": 0.02}
_SHARES = (
    "nees_position_within_95_pct", "coverage_pct", "classification_accuracy_pct", "slope_in_95_pct",
    "elevation_in_95_pct", "accuracy_pct", "strict_accuracy_pct", "transition_accuracy_pct", "changes_found_pct",
    "completeness_pct", "found_pct",
)  # fmt: skip
_BAD_SHARES = ("unknown_pct", "missed_pct", "false_pct", "edge_false_pct")
_LEADS = ("lead_median_s", "lead_p5_s", "transition_lead_median_s")
_NOT_JUDGED = ("distance_m", "duration_s", "steps", "transitions", "straddling_pct", "edge_mean_mm")
_SIGNED = ("end_height_error_m",)
_CLAIMS = ("nis_", "nees_position_mean")


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How a score is judged.

    Attributes:
        kind: ERROR, LEAD, SHARE, BAD_SHARE or CLAIM.
        slack: What rounding between machines may do, in the score's unit; no error counts less.
        signed: Only over walks, where signs do not cancel.
    """

    kind: str
    slack: float = 0.0
    signed: bool = False

    @property
    def higher_is_better(self) -> bool:
        """Whether more of the score is better."""
        return self.kind in (LEAD, SHARE)

    @property
    def in_points(self) -> bool:
        """Whether changes are told in percentage points, else in % of the value."""
        return self.kind in (SHARE, BAD_SHARE)

    @property
    def by_walks_only(self) -> bool:
        """Whether a mean over walks alone says nothing of it."""
        return self.signed or self.kind == CLAIM

    def loss(self, value: float) -> float:
        """The value on the scale on which it is judged; more is worse."""
        if self.in_points:
            return -value if self.kind == SHARE else value
        floored = math.log(max(abs(value), self.slack, 1e-12))
        return -floored if self.kind == LEAD else floored

    def told(self, loss: float) -> float:
        """A mean loss as people read it: in the score's unit."""
        if self.in_points:
            return -loss if self.kind == SHARE else loss
        return math.exp(-loss if self.kind == LEAD else loss)

    def change(self, difference: float) -> float:
        """A difference of losses as a change of the score: in %, or in percentage points (`in_points`)."""
        if self.in_points:
            return -difference if self.kind == SHARE else difference
        return 100.0 * math.expm1(min(-difference if self.kind == LEAD else difference, 50.0))

    def worse_by(self, difference: float) -> float:
        """How much worse a difference of losses is, in % or percentage points; negative where better."""
        return difference if self.in_points else 100.0 * math.expm1(min(difference, 50.0))


def scale_of(metric: str) -> Scale | None:
    """How a score is judged; None where it only describes the walk."""
    if metric in _NOT_JUDGED:
        return None
    if metric.startswith(_CLAIMS):
        return Scale(kind=CLAIM)
    slack = next((s for unit, s in _SLACK.items() if metric.endswith(unit)), 0.0)
    for kind, names in ((SHARE, _SHARES), (BAD_SHARE, _BAD_SHARES), (LEAD, _LEADS)):
        if metric in names:
            return Scale(kind=kind, slack=slack)
    return Scale(kind=ERROR, slack=slack, signed=metric in _SIGNED)
