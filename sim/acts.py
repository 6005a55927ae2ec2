"""What a wearer does on the way beside walking straight on, as entries of a scenario's `gait.acts`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field, StrictBool

from stridetwin.streams.fields import DEGREES, Number, OneOf

MAX_ASIDE_M = 1.5
"""Greatest distance of side steps, m."""
MIN_ASIDE_M = 0.05
"""Least distance of them, m."""
USUAL_LOOK_RAD = math.radians(75.0)
"""How far the head turns over the shoulder."""


@dataclass(frozen=True, kw_only=True)
class Act:
    """Something that the wearer does at a place of the way.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
    """

    kind: ClassVar[str] = ""
    """Its name in scenario files."""
    level_alone: ClassVar[bool] = True
    """Whether it needs level ground."""

    at_m: Annotated[Number, Field(ge=0, le=2000)]

    @property
    def stands(self) -> bool:
        """Whether the walker stops for it."""
        return True

    @property
    def shortens(self) -> bool:
        """Whether the steps around its foothold are shorter."""
        return self.stands

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


@dataclass(frozen=True, kw_only=True)
class ShuffleInPlace(Act):
    """Small steps of both feet on the spot.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
        for_s: How long.
    """

    kind: ClassVar[str] = "shuffle_in_place"

    for_s: Annotated[Number, Field(ge=1, le=60)] = 3.0


@dataclass(frozen=True, kw_only=True)
class Hesitate(Act):
    """A step that hesitates before it lands, while the walker walks on.

    Attributes:
        at_m: Along the way; the step to the first foothold from there on.
        how: `slow`, a slower swing; `hover`, the foot stays in the air; `retrace`, it goes back a part of its way
            before it goes on; or `half_steps`, four steps of half the length.
        for_s: By how much longer the swing is; for half steps without effect.
    """

    kind: ClassVar[str] = "hesitate"
    level_alone: ClassVar[bool] = False

    how: Annotated[str, OneOf(("slow", "hover", "retrace", "half_steps"))] = "hover"
    for_s: Annotated[Number, Field(ge=0.2, le=1.5)] = 0.6

    @property
    def stands(self) -> bool:
        """The walker walks on."""
        return False

    @property
    def shortens(self) -> bool:
        """Whether the steps around its foothold are shorter."""
        return self.how != "half_steps"


@dataclass(frozen=True, kw_only=True)
class LookBack(Act):
    """A look over the shoulder, with head and chest.

    Attributes:
        at_m: Along the way; it begins when a foot touches down at the first foothold from there on.
        to: The shoulder.
        head_rad: How far the head turns.
        for_s: How long the walker looks there.
        standing: Whether the walker stands meanwhile.
    """

    kind: ClassVar[str] = "look_back"
    level_alone: ClassVar[bool] = False

    to: Annotated[str, OneOf(("left", "right"))] = "left"
    head_rad: Annotated[Number, Field(ge=20, le=85, alias="head_deg"), DEGREES] = USUAL_LOOK_RAD
    for_s: Annotated[Number, Field(ge=0, le=30)] = 1.0
    standing: StrictBool = False

    @property
    def stands(self) -> bool:
        """Whether the walker stops for it."""
        return self.standing


@dataclass(frozen=True, kw_only=True)
class HoldRail(Act):
    """A hand that slides along a rail, which is there for it.

    Attributes:
        at_m: Along the way; where the hand comes to the rail.
        for_m: Length of the stretch along which the hand is on it.
        side: Where the rail is.
        away_m: Distance of the rail from the middle of the way.
        height_m: Height of the rail above the nosings of stairs and the ground.
    """

    kind: ClassVar[str] = "hold_rail"
    level_alone: ClassVar[bool] = False

    for_m: Annotated[Number, Field(ge=1, le=50)]
    side: Annotated[str, OneOf(("left", "right"))] = "right"
    away_m: Annotated[Number, Field(ge=0.3, le=0.5)] = 0.36
    height_m: Annotated[Number, Field(ge=0.8, le=1.1)] = 0.92

    @property
    def stands(self) -> bool:
        """The walker walks on."""
        return False


@dataclass(frozen=True, kw_only=True)
class Pivot(Act):
    """A quick turn on the spot in two steps, on the balls of the feet, and later back or, if it is half a turn, on.

    Attributes:
        at_m: Along the way; it begins at about the first foothold from there on.
        angle_rad: Of the turn, left positive.
        for_s: How long the walker stands turned.
    """

    kind: ClassVar[str] = "pivot"
    MIN_RAD: ClassVar[float] = math.radians(45.0)
    """Least angle to either side."""

    angle_rad: Annotated[Number, Field(ge=-180, le=180, alias="angle_deg"), DEGREES]
    for_s: Annotated[Number, Field(ge=0.8, le=60)] = 1.0

    @property
    def leading_foot(self) -> str | None:
        """The foot on the side to which the walker turns."""
        return "l" if self.angle_rad > 0.0 else "r"


ACTS: dict[str, type[Act]] = {
    act.kind: act for act in (SideStep, StepAside, Backwards, ShuffleInPlace, Hesitate, LookBack, HoldRail, Pivot)
}
"""Every kind of act by its name in scenario files."""
