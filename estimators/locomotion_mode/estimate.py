"""What the prediction of locomotion modes tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stridetwin.streams.samples import Array

MODES = ("LG", "SA", "SD", "RA", "RD")
"""Level ground, stair ascent and descent, ramp ascent and descent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StepPrediction:
    """One coming step.

    Attributes:
        step: Its number: how many feet will have touched down with it.
        foot: `l` or `r`; "" where no touch-down has told which foot is next.
        mode: The most likely one.
        probabilities: Of each of `MODES`.
        t_ns: When its foot touches down.
        t_sd_s: Standard deviation of that, s.
        p_foot_in_world: (3,) m, on the ground under the heel's centre.
        covariance: (2, 2) m² of it along world x and y; NaN of the published method.
    """

    step: int
    foot: str
    mode: str
    probabilities: Mapping[str, float]
    t_ns: int
    t_sd_s: float
    p_foot_in_world: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class NextChange:
    """Where the ground ahead first becomes another one than that under the foot.

    Attributes:
        mode: Of the first step beyond it.
        p_in_world: (2,) m, where the way crosses its edge or knee.
        distance: From the walker's body to there along the way, m.
        distance_sd: Standard deviation, m.
        time_s: Until the first foot touches down beyond it.
        time_sd_s: Standard deviation, s.
        riser: Height of a step, m, down negative; NaN where it is no stair; likewise below.
        riser_sd: m.
        tread: Depth of a step, m; NaN too while one edge alone is known.
        tread_sd: m.
        slope: Of a ramp in the walking direction, rad, uphill positive; NaN on stairs.
        slope_sd: rad.
    """

    mode: str
    p_in_world: Array
    distance: float
    distance_sd: float
    time_s: float
    time_sd_s: float
    riser: float
    riser_sd: float
    tread: float
    tread_sd: float
    slope: float
    slope_sd: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeEstimate:
    """The coming steps as they are known at one instant.

    Attributes:
        t_ns: When.
        step: How many feet have touched down.
        steps: The coming ones, the next one first.
        change: None where the ground stays as it is as far as it is known.
        heading: Walking direction in the world, rad from x.
        p_body_in_world: (3,) m, what carries the camera: the neck for a head, the waist for a chest.
        step_length: Expected on even ground, m.
        step_length_sd: m.
        step_time: s.
    """

    t_ns: int
    step: int
    steps: tuple[StepPrediction, ...]
    change: NextChange | None
    heading: float
    p_body_in_world: Array
    step_length: float
    step_length_sd: float
    step_time: float
