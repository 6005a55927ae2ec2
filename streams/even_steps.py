"""Means of an inertial stream over even steps of time, from samples at any times."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array
from stridetwin.streams.time_series import interpolate


def integrate(t: Array, values: Array) -> Array:
    """Integrals (N, 3) of values (N, 3) from the first of the increasing times (N,) s on, by the trapezoidal rule."""
    areas = 0.5 * (values[1:] + values[:-1]) * np.diff(t)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(areas, axis=0)])


def average_between(t: Array, integrals: Array, edges: Array) -> Array:
    """Means (M, 3) of a stream over the steps between edges (M + 1,) s, from its integrals (N, 3) at times (N,) s."""
    return np.asarray(np.diff(interpolate(edges, t, integrals), axis=0) / np.diff(edges)[:, None])
