"""Smooth steps in time, and smoothing."""

from __future__ import annotations

from typing import overload

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import betainc

from stridetwin.streams.samples import Array

_SOFTNESS = 3.4  # parameter of `soft_ease`, and exponent of `bump`: the larger, the softer the ends


@overload
def ease(s: float) -> float: ...


@overload
def ease(s: Array) -> Array: ...


def ease(s: Array | float) -> Array | float:
    """Minimum-jerk step from 0 at s = 0 to 1 at s = 1 (Flash & Hogan 1985), constant outside; scalars and arrays."""
    s = np.minimum(np.maximum(s, 0.0), 1.0)
    return s * s * s * (10.0 + s * (-15.0 + 6.0 * s))


@overload
def ease_rate(s: float) -> float: ...


@overload
def ease_rate(s: Array) -> Array: ...


def ease_rate(s: Array | float) -> Array | float:
    """Derivative by s of the minimum-jerk step `ease`: 30 s² (1 − s)² for s in [0, 1], 0 outside."""
    s = np.minimum(np.maximum(s, 0.0), 1.0)  # the step is constant outside, so its derivative is 0 there
    return 30.0 * (s * (1.0 - s)) ** 2


def soft_ease(s: Array | float) -> Array:
    """Step from 0 at s = 0 to 1 at s = 1 with smoother ends than `ease`, without a jump of the jerk.

    It is the integral of (s (1 − s))^(`_SOFTNESS` − 1), scaled to 1: the regularised incomplete beta function.
    """
    # a parameter of 3 gives the minimum-jerk step, of 4 the minimum-snap step
    return np.asarray(betainc(_SOFTNESS, _SOFTNESS, np.clip(s, 0.0, 1.0)))


def bump(s: Array) -> Array:
    """Smooth bump over (N,) shares: 1 at s = 0.5, 0 at and beyond s = 0 and s = 1, without a jump of the jerk."""
    s = np.clip(s, 0.0, 1.0)
    return (4.0 * s * (1.0 - s)) ** _SOFTNESS


def quintic(s: Array, x0: float, v0: float, x1: float, v1: float) -> Array:
    """(N,) values of a quintic at (N,) s in [0, 1]; its second derivative is 0 at both ends.

    It has the value x0 and the slope v0 by s at s = 0, and x1 and v1 at s = 1.
    """
    d = x1 - x0
    # coefficients of s³, s⁴ and s⁵; that of s² is 0, half the second derivative at the start
    c3, c4, c5 = 10 * d - 6 * v0 - 4 * v1, -15 * d + 8 * v0 + 7 * v1, 6 * d - 3 * (v0 + v1)
    return x0 + v0 * s + s**3 * (c3 + s * (c4 + s * c5))


def smooth_gaussian(x: Array, sigma_s: float, dt: float) -> Array:
    """(N, ...) values every `dt` s, filtered over time by a Gaussian of standard deviation `sigma_s`, in s.

    Beyond the ends, the first and the last row are repeated. The kernel ends at 5 standard deviations.
    """
    return gaussian_filter1d(x, sigma_s / dt, axis=0, mode="nearest", truncate=5.0)
