"""Blocks of voxels: which ones the window keeps as it moves, and which it frees."""

import numpy as np
import pytest

from stridetwin.estimators.terrain_map import voxel_blocks
from stridetwin.estimators.terrain_map.voxel_blocks import CAPACITY, EDGE, SHAPE, empty_blocks, roll
from tests.estimators.from_python import from_python

add_block = from_python(voxel_blocks.add_block)
slot_of = voxel_blocks.slot_of

BLOCK_M = 0.16
MIDDLE = np.zeros(3)
LATER_NS = 10
"""A block that no surface was seen in before this time is stale."""


def window(*places):
    """A window about the origin with empty blocks at places, and their rows."""
    blocks = empty_blocks()
    roll(blocks, MIDDLE, BLOCK_M, 0)
    return blocks, [add_block(blocks, *place) for place in places]


def kept(blocks, places):
    """Which of the places have a block."""
    return [slot_of(blocks.slots, blocks.origin, *place) >= 0 for place in places]


def test_a_stale_block_is_kept_where_it_or_the_top_of_the_one_below_is_behind_a_surface():
    """Voxels of a block are stored with the height as the fastest index."""
    places = [(0, 0, 0), (5, 0, 0), (5, 0, 1), (9, 0, 0), (9, 0, 1), (15, 0, 0)]
    blocks, rows = window(*places)
    top, below_top = 3 * EDGE**2 + 2 * EDGE + EDGE - 1, 3 * EDGE**2 + 2 * EDGE + EDGE - 2
    for row, voxel in ((rows[1], top), (rows[3], below_top)):
        blocks.distance[row, voxel], blocks.weight[row, voxel] = 0.5, 1.0
    blocks.distance[rows[0], top] = 0.5  # never seen
    blocks.seen_ns[rows[5]] = LATER_NS
    roll(blocks, MIDDLE, BLOCK_M, LATER_NS)
    assert kept(blocks, places) == [False, True, True, True, False, True]
    assert blocks.counts[0] == CAPACITY - 4
    assert sorted(blocks.free[: blocks.counts[0]]) == sorted(set(range(CAPACITY)) - {rows[k] for k in (1, 2, 3, 5)})


@pytest.mark.parametrize("axis", range(3))
def test_blocks_outside_the_window_are_freed(axis):
    first, last = np.zeros(3, int), np.zeros(3, int)
    first[axis], last[axis] = -SHAPE[axis] // 2, SHAPE[axis] // 2 - 1
    blocks, rows = window(first, last)
    blocks.seen_ns[rows] = LATER_NS
    roll(blocks, MIDDLE, BLOCK_M, LATER_NS)
    assert kept(blocks, (first, last)) == [True, True]
    roll(blocks, MIDDLE + 1.5 * BLOCK_M * np.eye(3)[axis], BLOCK_M, LATER_NS)
    assert kept(blocks, (first, last)) == [False, True]


def test_the_farthest_quarter_goes_where_memory_is_short():
    side = np.arange(-16, 16)
    places = np.stack(np.meshgrid(side, side, np.arange(-6, 6)), axis=-1).reshape(-1, 3)
    places = places[: CAPACITY - CAPACITY // 8 + 100]
    blocks, rows = window(*places)
    blocks.seen_ns[rows] = LATER_NS
    roll(blocks, MIDDLE, BLOCK_M, LATER_NS)
    away = np.linalg.norm((places + 0.5) * BLOCK_M, axis=1)
    there = np.array(kept(blocks, places))
    assert there.sum() == len(places) * 3 // 4
    assert away[there].max() <= away[~there].min()
    assert blocks.counts[0] == CAPACITY - there.sum()
