"""A depth picture without what is no depth: out of range, or beside an outline."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.compiled import cached

_HERE = Path(__file__).parent


@cached(_HERE)
def in_range(depth: NDArray[np.float32], least: np.float32, most: np.float32) -> tuple[NDArray[np.float32], int]:
    """(H, W) m, 0 for what is not from `least` to `most` or not finite; and how many pixels are."""
    found = np.empty(depth.shape, np.float32)
    nothing, count = np.float32(0.0), 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            inside = (depth[v, u] >= least) & (depth[v, u] <= most)
            found[v, u] = depth[v, u] if inside else nothing
            count += inside
    return found, count


@cached(_HERE, error_model="numpy")
def without_outlines(depth: NDArray[np.float32], share: float, reach: int) -> NDArray[np.float32]:
    """The depth without the pixels beside an outline, which lie on one of two surfaces or between them.

    Taking as much away on either side leaves the middle of the gap where the outline is.

    Args:
        depth: (H, W) m, 0 = none.
        share: Difference of the depths, over the larger one, that makes an outline.
        reach: Pixels.
    """
    height, width = depth.shape
    keeps, nothing, never = np.float32(1.0 - share), np.float32(0.0), np.float32(math.inf)
    found = np.empty(depth.shape, np.float32)
    # Of each column over the rows around, then of its neighbours too; beyond the picture there is none.
    far, near = np.zeros(width + 2 * reach, np.float32), np.full(width + 2 * reach, never)
    farthest, nearest = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(height):
        own_far, own_near = far[reach : reach + width], near[reach : reach + width]
        own_far[:], own_near[:] = nothing, never
        for row in range(max(v - reach, 0), min(v + reach + 1, height)):
            line = depth[row]
            for u in range(width):
                d = line[u]
                own_far[u] = d if d > own_far[u] else own_far[u]
                d = d if d > nothing else never
                own_near[u] = d if d < own_near[u] else own_near[u]
        farthest[:], nearest[:] = far[:width], near[:width]
        for shift in range(1, 2 * reach + 1):
            beside_far, beside_near = far[shift : shift + width], near[shift : shift + width]
            for u in range(width):
                farthest[u] = beside_far[u] if beside_far[u] > farthest[u] else farthest[u]
                nearest[u] = beside_near[u] if beside_near[u] < nearest[u] else nearest[u]
        line, out = depth[v], found[v]
        for u in range(width):
            out[u] = line[u] if nearest[u] >= keeps * farthest[u] else nothing
    return found
