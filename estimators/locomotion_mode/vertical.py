"""How far the map leans along the path, and which of its segments are level.

Odometry finds the vertical only within some tenths of a degree, and the map leans with it. Most ground is level as
built. So what several segments have in common is more likely the lean than a slope of all of them.
"""

from __future__ import annotations

import math

import numpy as np

from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.streams.samples import Array

_LEANS = 81


def without_lean(slope: Array, sd: Array, p: LocomotionModeParameters) -> tuple[Array, Array]:
    """True slopes of segments from mapped ones.

    See docs/locomotion_mode.md (10), (11).

    Args:
        slope: (N,) rad, as mapped, uphill positive.
        sd: (N,) rad, without the lean that all have in common.
        p: Prior of lean and ground.

    Returns:
        (N,) rad; (N,) standard deviation, rad.
    """
    lean = np.linspace(-p.lean_reach_sd, p.lean_reach_sd, _LEANS) * p.lean_sd_rad
    off = slope[:, None] - lean
    variance = sd[:, None] ** 2
    level = p.level_share * _normal(off, variance + p.flat_sd_rad**2)
    ramp = (1.0 - p.level_share) * _normal(off, variance + p.ramp_sd_rad**2)
    weight = _normal(lean, p.lean_sd_rad**2) * np.prod(level + ramp, axis=0)
    weight /= weight.sum()
    # The slope of each segment for each lean: a mixture of level ground and a ramp.
    is_level = level / (level + ramp)
    share_level, share_ramp = (v / (v + variance) for v in (p.flat_sd_rad**2, p.ramp_sd_rad**2))
    mean = off * (is_level * share_level + (1.0 - is_level) * share_ramp)
    square = variance * (is_level * share_level + (1.0 - is_level) * share_ramp) + off**2 * (
        is_level * share_level**2 + (1.0 - is_level) * share_ramp**2
    )
    found = mean @ weight
    return found, np.sqrt(np.maximum(square @ weight - found**2, 0.0))


def _normal(x: Array, variance: Array | float) -> Array:
    return np.asarray(np.exp(-0.5 * x**2 / variance) / np.sqrt(2.0 * math.pi * variance))
