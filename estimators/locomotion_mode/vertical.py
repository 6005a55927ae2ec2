"""How far the map leans along the path, and which of its segments are level.

Odometry finds the vertical only within some tenths of a degree, and the map leans with it. Most ground is level as
built. So what several segments have in common is more likely the lean than a slope of all of them. But two segments
that meet in a slope break are hardly both level.
"""

from __future__ import annotations

import math

import numpy as np

from stridetwin.streams.samples import Array

_LEANS = 81
"""Smallest number of hypotheses of the lean."""
_LARGEST_STEP_RAD = 0.004
"""Largest distance between two hypotheses: less than the standard deviation of ground built level."""
_REACH_SD = 4.0
"""Largest lean, in standard deviations."""
_FLAT_SD_RAD, _RAMP_SD_RAD = 0.006, 0.12
"""Standard deviations of the slope, about level, of ground built level and of ramps."""
_LEVEL_SHARE = 0.85
"""π of docs/locomotion_mode.md (10): share of level ground among planes too long for a tread."""
_FALSE_BREAK = 0.1
"""ψ of docs/locomotion_mode.md (11): weight of a slope break between two segments that are both level."""
_LEVEL, _RAMP = 0, 1
"""Indices of the two kinds of ground in arrays."""


def remove_lean(slope: Array, sd: Array, breaks: Array, lean_sd_rad: float) -> tuple[Array, Array]:
    """True slopes of segments from mapped ones, which all contain the map's lean: docs/locomotion_mode.md (10), (11).

    Args:
        slope: (N,) rad, as mapped, uphill positive, in order along the path.
        sd: (N,) rad, without the lean that all have in common.
        breaks: (N - 1,) whether a segment and the next one meet in a slope break.
        lean_sd_rad: Standard deviation of the lean, rad.

    Returns:
        (N,) slopes, rad; (N,) their standard deviations, rad.
    """
    # (L,) hypotheses, rad; more of them where the lean may be large
    count = max(_LEANS, 2 * math.ceil(_REACH_SD * lean_sd_rad / _LARGEST_STEP_RAD) + 1)
    lean = np.linspace(-_REACH_SD, _REACH_SD, count) * lean_sd_rad
    off, variance = slope[:, None] - lean, sd[:, None] ** 2  # (N, L) slopes without the lean
    # variance, rad², and share of the kinds of ground: level, ramp
    built = np.array([_FLAT_SD_RAD, _RAMP_SD_RAD]) ** 2
    share = np.array([_LEVEL_SHARE, 1.0 - _LEVEL_SHARE])
    # (N, 2, L) of each segment's slope, if the segment is of a kind and the map leans by a hypothesis
    likelihood = share[:, None] * _normal_density(off[:, None, :], (variance + built)[:, :, None])
    kinds, evidence = _infer_kinds(likelihood, breaks)  # (N, 2, L), and (L,) likelihood of each lean
    weight = _normal_density(lean, lean_sd_rad**2) * evidence
    weight /= weight.sum()
    # The slope of each segment for each lean: a mixture of level ground and a ramp.
    shrink = built / (built + variance)  # (N, 2) share of the measured slope that is kept
    # (N, L) means over the kinds: of that share and its square; of the true slope and its square
    kept, kept_squared = (np.einsum("nk,nkl->nl", factor, kinds) for factor in (shrink, shrink**2))
    mean, square = off * kept, variance * kept + off**2 * kept_squared
    true_slope = mean @ weight
    return true_slope, np.sqrt(np.maximum(square @ weight - true_slope**2, 0.0))


def _infer_kinds(likelihood: Array, breaks: Array) -> tuple[Array, Array]:
    """Probability that each segment is level or a ramp, for each lean: forward and backward along the path.

    Args:
        likelihood: (N, 2, L) of each segment's slope by kind of ground and lean, times the prior of the kind.
        breaks: (N - 1,) whether two segments meet in a slope break.

    Returns:
        (N, 2, L) the probability; (L,) evidence of each lean.
    """
    # weights of the kinds (level, ramp) of two neighbours: all equal or, at a slope break, both level is unlikely
    beside = np.ones((2, 2))
    at_break = beside.copy()
    at_break[_LEVEL, _LEVEL] = _FALSE_BREAK
    weights = [at_break if meets else beside for meets in breaks]  # of each segment and the next one
    # by kind and lean: from the first segment up to each one, itself included; from the last one back to it
    forward = likelihood.copy()
    for k, pair in enumerate(weights):
        forward[k + 1] *= pair @ forward[k]
    backward = np.ones_like(likelihood)
    for k in reversed(range(len(weights))):
        backward[k] = weights[k] @ (backward[k + 1] * likelihood[k + 1])
    both = forward * backward
    # the sum over the kinds is the same at every segment
    evidence = both[0].sum(axis=0) if len(both) else np.ones(likelihood.shape[2])
    return both / both.sum(axis=1, keepdims=True), evidence


def _normal_density(x: Array, variance: Array | float) -> Array:
    """Normal density of mean 0 at x; the variance has the shape of x or is a number."""
    return np.asarray(np.exp(-0.5 * x**2 / variance) / np.sqrt(2.0 * math.pi * variance))
