"""Uses an exoskeleton's step estimates in the prediction of locomotion modes.

The camera observes the ground ahead; the legs measure length, height and slope of the last step. This corrects the
foot's position on the map, and replaces the map where there is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.segments import Piece, lie
from stridetwin.streams.samples import Array

_FLOOR = 1e-3
"""Lower limit of a position's likelihood: the map may be wrong under the foot."""
_LEAST_M = 0.01
_LEAST_RAD = 0.0175
_MOST_TREADS = 6
_STRIDE = 3
"""Footprints per stride."""


@dataclass(frozen=True, kw_only=True)
class Felt:
    """A step as the legs measured it.

    Attributes:
        step: Number of the step in `contact_terrain`.
        foot: `l` or `r`, the foot that stepped.
        length: Horizontal distance from the previous footprint along the path, m.
        length_sd: Standard deviation, m.
        elevation: Height over the previous footprint, m.
        elevation_sd: Standard deviation, m.
        slope: Slope of the ground in the foot's direction, rad, uphill positive.
        slope_sd: Standard deviation, rad.
        mode: Mode estimated by `contact_terrain`.
    """

    step: int
    foot: str
    length: float
    length_sd: float
    elevation: float
    elevation_sd: float
    slope: float
    slope_sd: float
    mode: str


def felt(told: Sequence[StepEstimate]) -> Felt | None:
    """The last of some steps; None if a step between is missing or a value is unknown.

    The feet are side by side, so a step's length is its component along the whole stride.

    Args:
        told: Estimates of the last steps in order, three at most.
    """
    if len(told) < _STRIDE or any(b.step != a.step + 1 for a, b in pairwise(told)):
        return None
    first, before, now = told[-_STRIDE:]
    stride = (now.p_sole_in_world - first.p_sole_in_world)[:2]
    toward = stride / max(math.hypot(*stride.tolist()), 1e-9)
    made = Felt(
        step=now.step, foot=now.foot, length=float((now.p_sole_in_world - before.p_sole_in_world)[:2] @ toward),
        length_sd=math.sqrt(max(float(toward @ now.covariance[:2, :2] @ toward), 0.0)), elevation=now.elevation,
        elevation_sd=now.elevation_sd, slope=now.slope, slope_sd=now.slope_sd, mode=now.mode,
    )  # fmt: skip
    known = (made.length, made.length_sd, made.elevation, made.elevation_sd, made.slope, made.slope_sd)
    return made if all(map(math.isfinite, known)) else None


def suits(step: Felt, s: Array, ground: Sequence[Piece], before: Array, p: LocomotionModeParameters) -> Array:
    """(S,) likelihood of each landing position given the measured step, about 1 at best.

    Args:
        step: The step as the legs measured it.
        s: (S,) m along the path.
        ground: Terrain segments along it.
        before: (S,) density of the previous footprint; sums to 1. It depends on the body's lean, which is the same at
            every step, so the length of the last step does not reduce that uncertainty.
        p: Standard deviations.
    """
    height, slope, slope_sd = lie(ground, s)
    high, far = float(before @ height), float(before @ s)
    high_sd, far_sd = (math.sqrt(max(float(before @ (v - m) ** 2), 0.0)) for v, m in ((height, high), (s, far)))
    off = (
        (s - far - step.length) / math.hypot(far_sd, step.length_sd, p.body_sd_m),
        (height - high - step.elevation) / math.hypot(high_sd, step.elevation_sd, _LEAST_M),
        (slope - step.slope) / np.sqrt(slope_sd**2 + step.slope_sd**2 + _LEAST_RAD**2),
    )
    return np.asarray(np.exp(-0.5 * sum(x**2 for x in off)) + _FLOOR)


def going_on(step: Felt, foot: float, p: LocomotionModeParameters) -> list[Piece]:
    """Extrapolates the measured ground where it was not observed: equal treads, the same slope, or level ground.

    Args:
        step: The last step.
        foot: Position of its foot, m along the path.
        p: Sizes.
    """
    stairs = step.mode in ("SA", "SD")
    slope = 0.0 if stairs or step.mode == "LG" else step.slope
    slope_sd = math.hypot(p.slope_sd_rad, step.slope_sd)
    tread = min(max(step.length, p.tread_min_m), p.tread_max_m)
    first = foot + p.toe_m + p.clearance_sd_m
    edges = [first + k * tread for k in range(_MOST_TREADS)] if stairs else []
    bounds = [-math.inf, *edges, math.inf]
    return [
        Piece(
            start=a, start_sd=p.brink_sd_m if k else 0.0, end=b, end_sd=p.brink_sd_m if k < len(edges) else 0.0,
            drop=step.elevation if k else 0.0, drop_sd=step.elevation_sd, slope=slope, slope_sd=slope_sd,
            mode=step.mode if step.mode in ("RA", "RD") else "LG",
        )
        for k, (a, b) in enumerate(pairwise(bounds))
    ]  # fmt: skip
