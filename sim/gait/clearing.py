"""Smoothest rise or fall of a foot over an obstacle."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import nnls

from stridetwin.streams.samples import Array

_REST = 3  # samples at each end that are at rest: position, velocity and acceleration are given there
_AT_REST: Any = [(1, 0.0), (2, 0.0)]  # SciPy's stubs do not allow pairs


def smoothest_above(rise: float, least: Array) -> tuple[BSpline, float]:
    """Height that changes by `rise` from rest to rest with the least jerk and nowhere falls below `least`.

    Without a limit it is the minimum-jerk step (Flash & Hogan 1985); where that would be too low, it touches the limit
    with a bounded acceleration. Solved as a bounded least-squares problem in the samples of the height.

    Args:
        rise: End minus start, m.
        least: (N,) m above the start, at N uniform instants from the start to the end; -inf for no limit.

    Returns:
        Height over the start, m, as a spline on [0, 1], and the mean square of its third derivative by that parameter.
    """
    n = len(least)
    inner = slice(_REST, n - _REST)
    third, Q, free = _least_jerk(n)
    z = np.zeros(n)
    z[-_REST:] = rise
    z[inner] = free @ (Q.T @ (-third @ z))
    limited = np.isfinite(least[inner])
    short = (least - z)[inner][limited]
    if (short > 0.0).any():
        # the least change of the residual that lifts the height by its shortfall (Lawson & Hanson 1974, ch. 23)
        goal = np.append(np.zeros(free.shape[1]), 1.0)
        system = np.vstack([free[limited].T, short])
        left = system @ nnls(system, goal)[0] - goal
        z[inner] -= free @ (left[:-1] / left[-1])
    spline = make_interp_spline(np.linspace(0.0, 1.0, n), z, k=5, bc_type=(_AT_REST, _AT_REST))
    return spline, float(np.mean((third @ z) ** 2)) * (n - 1) ** 6


@cache
def _least_jerk(n: int) -> tuple[Array, Array, Array]:
    """Third difference of n samples, and the Q and inverse R of the samples that are not at rest."""
    third = np.diff(np.eye(n), 3, axis=0)
    Q, R = np.linalg.qr(third[:, _REST : n - _REST])
    return third, Q, np.linalg.inv(R)
