"""Voxels in blocks of 8 x 8 x 8, in a window of constant memory that follows the walker.

The index of the blocks is a ring: block (i, j, k) is stored at (i mod X, j mod Y, k mod Z), so the window moves
without moving voxels. Grid axes: the world's, rotated about the vertical.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel

_HERE = Path(__file__).parent

EDGE = 8
"""Voxels along the edge of a block."""
VOXELS = EDGE**3
"""Voxels of a block; voxel (i, j, k) is at index 64 i + 8 j + k."""
SHAPE = (64, 64, 32)
"""Blocks in the window; powers of two."""
CAPACITY = 12000
"""Largest number of allocated blocks."""
_NONE = -1
"""Row of a block that is not allocated."""


class Blocks(NamedTuple):
    """The allocated voxels, in N blocks of 512.

    Attributes:
        slots: (X, Y, Z) int32 ring, row of each block in the arrays below; -1 = none.
        places: (N, 3) int32, block coordinates.
        used: (N,) bool, whether the row holds a block.
        distance: (N, 512) float32, λ of docs/terrain_map.md (4), -1 to 1, positive behind the surface.
        weight: (N, 512) float32, W of docs/terrain_map.md (4); 0 = never seen.
        solid: (N,) bool, whether the block is known to have a voxel behind a surface.
        seen_ns: (N,) int64, when a surface was last observed in the block.
        free: (N,) int32, stack of unused rows.
        counts: (1,) int64, height of that stack.
        origin: (3,) int64, lowest block of the window.
    """

    slots: NDArray[np.int32]
    places: NDArray[np.int32]
    used: NDArray[np.bool_]
    distance: NDArray[np.float32]
    weight: NDArray[np.float32]
    solid: NDArray[np.bool_]
    seen_ns: NDArray[np.int64]
    free: NDArray[np.int32]
    counts: NDArray[np.int64]
    origin: NDArray[np.int64]


def empty_blocks() -> Blocks:
    """An empty window."""
    return Blocks(
        slots=np.full(SHAPE, _NONE, np.int32),
        places=np.zeros((CAPACITY, 3), np.int32),
        used=np.zeros(CAPACITY, np.bool_),
        distance=np.zeros((CAPACITY, VOXELS), np.float32),
        weight=np.zeros((CAPACITY, VOXELS), np.float32),
        solid=np.zeros(CAPACITY, np.bool_),
        seen_ns=np.zeros(CAPACITY, np.int64),
        free=np.arange(CAPACITY - 1, -1, -1, dtype=np.int32),  # row 0 is on top of the stack
        counts=np.array([CAPACITY], np.int64),
        origin=np.zeros(3, np.int64),
    )


def clear(blocks: Blocks) -> None:
    """Removes all voxels."""
    blocks.slots[:] = _NONE
    blocks.used[:] = False
    blocks.free[:] = np.arange(CAPACITY - 1, -1, -1, dtype=np.int32)
    blocks.counts[0] = CAPACITY


def roll(blocks: Blocks, centre: NDArray[np.float64], block_m: float, stale_ns: int) -> None:
    """Moves the window; frees blocks outside it or without a surface, and the farthest ones when memory is short.

    Args:
        blocks: Changed in place.
        centre: (3,) m, grid axes, new middle of the window.
        block_m: Edge of a block.
        stale_ns: A block without a surface, and with none observed since then, is freed.
    """
    blocks.origin[:] = np.floor(centre / block_m).astype(np.int64) - np.array(SHAPE) // 2
    _free_unused(blocks, stale_ns)
    if blocks.counts[0] < CAPACITY // 8:  # short of memory: frees the farthest quarter
        rows = np.flatnonzero(blocks.used)
        distance = np.linalg.norm((blocks.places[rows] + 0.5) * block_m - centre, axis=1)  # of their middles, m
        nearest_first = rows[np.argsort(distance, kind="stable")]
        _free_rows(blocks, nearest_first[len(rows) * 3 // 4 :])


@entry_kernel(_HERE)
def _free_unused(blocks: Blocks, stale_ns: int) -> None:
    """Frees the blocks outside the window, and those without a surface in them or just below.

    A block in the window in which a surface was observed at `stale_ns` or later is kept in any case. Marks blocks as
    `solid` that have a voxel behind a surface.
    """
    for row in range(CAPACITY):
        if not blocks.used[row]:
            continue
        i, j, k = blocks.places[row]
        inside = (
            blocks.origin[0] <= i < blocks.origin[0] + SHAPE[0]
            and blocks.origin[1] <= j < blocks.origin[1] + SHAPE[1]
            and blocks.origin[2] <= k < blocks.origin[2] + SHAPE[2]
        )
        if inside and (blocks.seen_ns[row] >= stale_ns or blocks.solid[row]):  # in use
            continue
        if inside and _is_solid(blocks.distance[row], blocks.weight[row], 0, 1):
            blocks.solid[row] = True
            continue
        below = slot_of(blocks.slots, blocks.origin, i, j, k - 1)
        # A surface may lie just above the top voxels of the block below: this block then delimits the solid ground. The
        # top layer of a block are its voxels EDGE - 1, 2 EDGE - 1, ...
        if inside and below >= 0 and _is_solid(blocks.distance[below], blocks.weight[below], EDGE - 1, EDGE):
            continue
        blocks.slots[i & (SHAPE[0] - 1), j & (SHAPE[1] - 1), k & (SHAPE[2] - 1)] = _NONE
        blocks.used[row] = False
        blocks.free[blocks.counts[0]] = row
        blocks.counts[0] += 1


@njit(**INNER_KERNEL)
def _is_solid(distance: NDArray[np.float32], weight: NDArray[np.float32], first: int, stride: int) -> bool:
    """Whether a block has an observed voxel behind a surface, among its voxels from `first` on, `stride` apart."""
    at = first
    while at < VOXELS and not (distance[at] > 0.0 and weight[at] > 0.0):
        at += stride
    return at < VOXELS


def _free_rows(blocks: Blocks, rows: NDArray[np.intp]) -> None:
    """Frees the blocks in some rows."""
    i, j, k = (blocks.places[rows] % np.array(SHAPE, np.int32)).T  # places in the ring
    blocks.slots[i, j, k] = _NONE
    blocks.used[rows] = False
    n = int(blocks.counts[0])
    blocks.free[n : n + len(rows)] = rows
    blocks.counts[0] = n + len(rows)


@njit(inline="always")
def slot_of(slots: NDArray[np.int32], origin: NDArray[np.int64], i: int, j: int, k: int) -> int:
    """Row of block (i, j, k) in the arrays of `Blocks`; -1 if it is not allocated or outside the window."""
    if (
        i < origin[0]
        or i >= origin[0] + SHAPE[0]
        or j < origin[1]
        or j >= origin[1] + SHAPE[1]
        or k < origin[2]
        or k >= origin[2] + SHAPE[2]
    ):
        return _NONE
    return slots[i & (SHAPE[0] - 1), j & (SHAPE[1] - 1), k & (SHAPE[2] - 1)]


@njit(**INNER_KERNEL)
def add_block(blocks: Blocks, i: int, j: int, k: int) -> int:
    """Allocates block (i, j, k) within the window; returns its row, or -1 if the buffer is full."""
    if blocks.counts[0] == 0:
        return _NONE
    blocks.counts[0] -= 1
    row = blocks.free[blocks.counts[0]]
    blocks.slots[i & (SHAPE[0] - 1), j & (SHAPE[1] - 1), k & (SHAPE[2] - 1)] = row
    blocks.places[row, 0], blocks.places[row, 1], blocks.places[row, 2] = i, j, k
    blocks.used[row] = True
    blocks.solid[row] = False
    blocks.distance[row] = 0.0
    blocks.weight[row] = 0.0
    return row
