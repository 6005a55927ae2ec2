"""What an exoskeleton's legs tell of the step that was made, and what that says of map and walker.

The camera says what lies ahead, the legs what was stepped on: how long the step was, how high, how the sole lies. So
they confirm where on the map the foot stands, or correct it, and where there is no map they are all there is.
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
"""Of how well a place suits: the map may be wrong where the foot is."""
_LEAST_M = 0.01
_LEAST_RAD = 0.0175
_MOST_TREADS = 6
_STRIDE = 3
"""Footprints of a stride."""


@dataclass(frozen=True, kw_only=True)
class Felt:
    """A step as the legs measured it.

    Attributes:
        step: Its number, as `contact_terrain` counts.
        foot: `l` or `r`, the one that stepped.
        length: From the footprint before, m, horizontal, along the way.
        length_sd: m.
        elevation: Over the footprint before, m.
        elevation_sd: m.
        slope: Of the ground in the foot's direction, rad, uphill positive.
        slope_sd: rad.
        mode: As `contact_terrain` tells it.
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
    """The last of some steps; None where one between is missing, or not all of it is known.

    Feet go side by side: how far a step goes ahead is its part along the way of the whole stride.

    Args:
        told: The last three or fewer, in order.
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
    """(S,) how well each place along the way suits the step, about 1 at best.

    Args:
        step: As it was felt.
        s: (S,) m along the way.
        ground: Pieces along it.
        before: (S,) density of the footprint before; sums to 1. How the body leans is what it was found with, and
            the same at every step: to know how far the last step went does not make that any surer.
        p: Deviations.
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
    """Ground that nobody has seen goes on as it was felt: treads as high and as deep as the last, a slope, a level.

    Args:
        step: The last one.
        foot: Where its foot stands, m along the way.
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
