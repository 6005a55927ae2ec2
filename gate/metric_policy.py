"""Which scores the gate checks, and on which scale: a loss, larger is worse, that can be averaged.

Errors and lead times use a scale of ratios, shares one of percentage points. NIS and NEES use ratios too, and only
growth counts as worse: the errors have grown relative to the reported covariance. The distance from the value of a
consistent filter is no criterion, because a conservative filter approaches it by larger errors. A decrease is neutral:
the errors are smaller, or the filter has become conservative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stridetwin.outputs.base import BAD_SHARE, CLAIM, DESCRIPTIVE, ERROR, LEAD, SHARE
from stridetwin.outputs.registry import all_scores

ARITHMETIC, GEOMETRIC = "arithmetic", "geometric"
OVERALL = "overall"
"""Name of the composite of an estimator's errors."""

# rounding differences between machines, by the end of a score's name, in the unit that it stands for
_SLACK = {"_m": 0.002, "_mm": 0.2, "_deg": 0.02, "_pct": 0.02, "_s": 0.05, "_error": 0.02}
_CLAIMS = "nis_"
"""Prefix of scores that are claims without being declared by name, because each kind of measurement has its own."""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How the gate compares a score: the kind of its loss, its slack and its sign.

    Attributes:
        kind: ERROR (smaller is better), LEAD (a lead time), SHARE (of what is right), BAD_SHARE (of what is wrong), or
            CLAIM (NIS or NEES: an error relative to the reported covariance).
        slack: Rounding differences between machines, in the score's unit; the smallest value of an error.
        signed: Only compared over walks, where signs do not cancel.
    """

    kind: str
    slack: float = 0.0
    signed: bool = False

    @property
    def higher_is_better(self) -> bool:
        """Whether larger is better."""
        return self.kind in (LEAD, SHARE)

    @property
    def mean(self) -> str:
        """How values are averaged over walks: ratios need geometric means."""
        return ARITHMETIC if self.in_points else GEOMETRIC

    @property
    def in_points(self) -> bool:
        """Whether changes are given in percentage points, else in % of the value."""
        return self.kind in (SHARE, BAD_SHARE)

    @property
    def by_walks_only(self) -> bool:
        """Whether a mean over walks alone is meaningless."""
        return self.signed or self.kind == CLAIM

    def loss(self, value: float) -> float:
        """The value as a loss, which is larger if it is worse and can be averaged over walks.

        Shares stay in percentage points, with the sign turned where more is better. Other scores become logarithms of
        their absolute value, at least `slack`; of a lead time the negative one.
        """
        if self.in_points:
            return -value if self.kind == SHARE else value
        floored = math.log(max(abs(value), self.slack, 1e-12))  # 1e-12: a score of 0 has no logarithm
        return -floored if self.kind == LEAD else floored

    def value(self, loss: float) -> float:
        """The score's value, in its own unit, from a mean loss: the inverse of `loss`, without the sign of an error."""
        if self.in_points:
            return -loss if self.kind == SHARE else loss
        return math.exp(-loss if self.kind == LEAD else loss)

    def change(self, difference: float) -> float:
        """A difference of losses as a change of the score: in %, or in percentage points (`in_points`).

        The change has the sign of the score, not of the loss: a larger share or lead time is a positive change.
        """
        if self.in_points:
            return -difference if self.kind == SHARE else difference
        # losses are logarithms, so exp(difference) is the ratio of the scores; up to e⁵⁰, so that it does not overflow
        return 100.0 * math.expm1(min(-difference if self.kind == LEAD else difference, 50.0))

    def worse_by(self, difference: float) -> float:
        """A difference of losses as a deterioration, in % or percentage points; negative if better.

        The relative one is exp(difference) - 1, with differences limited to 50 so that it does not overflow.
        """
        return difference if self.in_points else 100.0 * math.expm1(min(difference, 50.0))


def scale_of(metric: str) -> Scale | None:
    """The scale of a score, as a kind of output declares it, else that of an error; None if it describes the walk."""
    # a score that no kind declares, such as one of a user's own, counts as an error
    declared = all_scores().get(metric)
    kind_without_prefix = ERROR if declared is None else declared.scale
    kind = CLAIM if metric.startswith(_CLAIMS) else kind_without_prefix
    if kind == DESCRIPTIVE:
        return None
    # slack by the unit at the end of the name; a claim has no unit
    unit_slack = next((slack for unit, slack in _SLACK.items() if metric.endswith(unit)), 0.0)
    slack = 0.0 if kind == CLAIM else unit_slack
    return Scale(kind=kind, slack=slack, signed=declared is not None and declared.signed)
