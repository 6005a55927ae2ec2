"""Compiled loops over the solids of a terrain: rays against convex solids, and the surface under points."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array


@numba.njit(cache=True)
def cast(origins: Array, directions: Array, normals: Array, offsets: Array, ground: float) -> tuple[Array, Array]:
    """Nearest intersections of rays with solids or the ground plane.

    A convex solid is the intersection of half-spaces n.p <= c: a ray is inside from its last entry to its first exit.

    Args:
        origins: (N, 3) m.
        directions: (N, 3) unit.
        normals: (S, F, 3) outward, of each solid's faces.
        offsets: (S, F) m.
        ground: Height of the plane, m.

    Returns:
        (N,) distance, inf for none, 0 from inside; (N, 3) outward normal of the face, zero for none.
    """
    n = len(origins)
    distance, normal = np.empty(n), np.zeros((n, 3))
    for i in range(n):
        ox, oy, oz = origins[i]
        dx, dy, dz = directions[i]
        best = np.inf
        solid, side = -1, -1
        for s in range(len(offsets)):
            entry, leave, face = -np.inf, np.inf, 0
            for f in range(offsets.shape[1]):
                nx, ny, nz = normals[s, f]
                speed = nx * dx + ny * dy + nz * dz
                gap = offsets[s, f] - (nx * ox + ny * oy + nz * oz)
                if speed < 0.0:
                    if gap / speed > entry:
                        entry, face = gap / speed, f
                elif speed > 0.0:
                    leave = min(leave, gap / speed)
                elif gap < 0.0:
                    leave = -np.inf
                if leave < 0.0 or entry > leave or entry >= best:
                    break
            else:
                if max(entry, 0.0) < best:
                    best, solid, side = max(entry, 0.0), s, face
        if dz < 0.0 and max((ground - oz) / dz, 0.0) < best:
            best = max((ground - oz) / dz, 0.0)
            normal[i, 2] = 1.0
        elif solid >= 0:
            normal[i] = normals[solid, side]
        distance[i] = best
    return distance, normal


@numba.njit(cache=True)
def top(
    points: Array, centre: Array, axes: Array, half: Array, mid: Array, slope: Array, touch: float
) -> tuple[Array, NDArray[np.intp]]:
    """Highest top over (N, 2) points: (N,) height, -inf for none, and (N,) index of the solid."""
    n = len(points)
    height, which = np.full(n, -np.inf), np.full(n, -1)
    for i in range(n):
        for s in range(len(mid)):
            x, y = points[i, 0] - centre[s, 0], points[i, 1] - centre[s, 1]
            along = axes[s, 0, 0] * x + axes[s, 0, 1] * y
            across = axes[s, 1, 0] * x + axes[s, 1, 1] * y
            if abs(along) <= half[s, 0] + touch and abs(across) <= half[s, 1] + touch:
                z = (
                    mid[s]
                    + slope[s, 0] * min(max(along, -half[s, 0]), half[s, 0])
                    + slope[s, 1] * min(max(across, -half[s, 1]), half[s, 1])
                )
                if z > height[i]:
                    height[i], which[i] = z, s
    return height, which
