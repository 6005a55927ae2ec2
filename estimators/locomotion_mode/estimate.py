"""The output of the locomotion mode prediction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from stridetwin.estimators.contact_terrain import MODES, UNKNOWN
from stridetwin.streams.samples import Array

__all__ = ["MODES", "UNKNOWN", "ModeEstimate", "NextChange", "StepPrediction"]


@dataclass(frozen=True, kw_only=True, eq=False)
class StepPrediction:
    """One coming step.

    Attributes:
        step: Number of the step: touch-downs up to and including it.
        foot: `l` or `r`; "" while the next foot is unknown.
        mode: The most likely of `MODES`, or `UNKNOWN` where the poses have drifted too far to tell.
        probabilities: Probability of each of `MODES`.
        t_ns: Time of its touch-down.
        t_sd_s: Standard deviation of that time, s.
        p_foot_in_world: (3,) m, on the ground under the heel's centre.
        covariance: (2, 2) m², its covariance along world x and y; NaN for the published method.
        slope: Slope of the ground under it in the walking direction, rad, uphill positive, also where it is too gentle
            for a ramp; NaN for the published method.
        slope_sd: Standard deviation of `slope`, rad.
    """

    step: int
    foot: str
    mode: str
    probabilities: Mapping[str, float]
    t_ns: int
    t_sd_s: float
    p_foot_in_world: Array
    covariance: Array
    slope: float = math.nan
    slope_sd: float = math.nan

    @property
    def probability(self) -> float:
        """Probability of the most likely mode."""
        return max(self.probabilities.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class NextChange:
    """The first change of the ground ahead from that under the foot.

    Attributes:
        mode: Mode of the first step beyond it.
        p_in_world: (2,) m, where the path crosses its edge or slope break.
        distance: Distance from the walker's body along the path, m.
        distance_sd: Standard deviation of `distance`, m.
        time_s: Time until the first touch-down beyond it.
        time_sd_s: Standard deviation of `time_s`, s.
        riser: Height of a step, m, down negative; NaN if not stairs, as are the next three.
        riser_sd: Standard deviation of `riser`, m.
        tread: Depth of a step, m; NaN also while only one edge is known.
        tread_sd: Standard deviation of `tread`, m.
        slope: Slope of a ramp in the walking direction, rad, uphill positive; NaN on stairs.
        slope_sd: Standard deviation of `slope`, rad.
    """

    mode: str
    p_in_world: Array
    distance: float
    distance_sd: float
    time_s: float
    time_sd_s: float
    riser: float = math.nan
    riser_sd: float = math.nan
    tread: float = math.nan
    tread_sd: float = math.nan
    slope: float = math.nan
    slope_sd: float = math.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeEstimate:
    """The predicted steps at one instant.

    Attributes:
        t_ns: Time of the estimate.
        step: Number of touch-downs so far.
        steps: Predicted steps, the next one first.
        change: Next change of the ground; None if the known ground does not change.
        heading: Walking direction in the world, rad from x.
        p_body_in_world: (3,) m, the body that carries the camera: neck for a head mount, waist for a chest mount.
        step_length: Expected step length on even ground, m.
        step_length_sd: Standard deviation of `step_length`, m.
        step_time: Expected step time, s.
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
