"""What a wearer does on the way beside walking straight on, as entries of a scenario's `gait.acts`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from stridetwin.streams.fields import Number

MAX_ASIDE_M = 1.5
"""Greatest distance of side steps, m."""
MIN_ASIDE_M = 0.05
"""Least distance of them, m."""


@dataclass(frozen=True, kw_only=True)
class Act:
    """Something that the wearer does at a place of the way.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
    """

    kind: ClassVar[str] = ""
    """Its name in scenario files."""
    stands: ClassVar[bool] = True
    """Whether the walker stops for it."""
    level_alone: ClassVar[bool] = True
    """Whether it needs level ground."""

    at_m: Annotated[Number, Field(ge=0, le=2000)]

    @property
    def leading_foot(self) -> str | None:
        """Foot that makes the first step, `l` or `r`; None for either."""
        return None


@dataclass(frozen=True, kw_only=True)
class SideStep(Act):
    """Steps to the side, after which the walker goes on beside the middle of the way.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
        left_m: How far to the left; negative to the right.
        for_s: How long the walker stands there.
    """

    kind: ClassVar[str] = "side_step"

    left_m: Annotated[Number, Field(ge=-MAX_ASIDE_M, le=MAX_ASIDE_M)]
    for_s: Annotated[Number, Field(ge=0, le=60)] = 0.0

    @property
    def leading_foot(self) -> str | None:
        """The foot on the side to which the walker steps."""
        return "l" if self.left_m > 0.0 else "r"


@dataclass(frozen=True, kw_only=True)
class StepAside(SideStep):
    """Steps to the side, as to let somebody pass; walking on, the walker comes back to where they walked before.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
        left_m: How far to the left; negative to the right.
        for_s: How long the walker stands there.
    """

    kind: ClassVar[str] = "step_aside"

    for_s: Annotated[Number, Field(ge=0, le=60)] = 2.0


@dataclass(frozen=True, kw_only=True)
class Backwards(Act):
    """A stretch that is walked backwards, also over risers, and then forwards again.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
        for_m: How far back.
        for_s: How long the walker stands there.
    """

    kind: ClassVar[str] = "backwards"
    level_alone: ClassVar[bool] = False

    for_m: Annotated[Number, Field(ge=0.2, le=20)]
    for_s: Annotated[Number, Field(ge=0, le=60)] = 0.0


ACTS: dict[str, type[Act]] = {act.kind: act for act in (SideStep, StepAside, Backwards)}
"""Every kind of act by its name in scenario files."""
