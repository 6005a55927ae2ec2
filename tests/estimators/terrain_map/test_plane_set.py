"""Planes of one view join the known planes: pieces of one plane do, treads that looked like a ramp from afar do not."""

import math

import numpy as np
import pytest

from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_extraction import column_points, plane_sums
from stridetwin.estimators.terrain_map.plane_set import PlaneSet, TopView

P = TerrainMapParameters()
LONG, WIDE, TREAD = 48, 40, 16  # columns: three treads of 0.32 m


def view(height, labels):
    """Columns of (LONG, WIDE) heights as the top view of planes."""
    n = 64
    first = np.zeros(2, np.int64)
    heights = np.full((n, n), np.nan, np.float32)
    numbers = np.full((n, n), -1, np.int32)
    noise = np.full((n, n), 0.004, np.float32)
    heights[:LONG, :WIDE], numbers[:LONG, :WIDE] = height, labels
    sums = plane_sums(column_points(heights, first, P.voxel_size_m), noise, numbers, int(labels.max()) + 1)
    return TopView(first, numbers, sums, heights, noise)


def ids_after(*views):
    """Slots' ids at (LONG, WIDE) columns after the views."""
    planes = PlaneSet(P)
    for one in views:
        planes.update(one)
    label = planes.surface.label[:LONG, :WIDE]
    return np.where(label >= 0, planes.ids[label], -1)


along = np.arange(LONG)[:, None] * np.ones((1, WIDE))
three = (along // TREAD).astype(np.int32)
one = np.zeros((LONG, WIDE), np.int32)


@pytest.mark.parametrize("riser_m", [0.05, 0.06, 0.07, 0.08])
@pytest.mark.parametrize("down", [False, True])
def test_treads_that_were_one_ramp_become_planes_of_their_own(riser_m, down):
    sign = -1.0 if down else 1.0
    ramp = sign * riser_m / TREAD * (along - TREAD / 2)
    treads = sign * riser_m * three
    ids = ids_after(view(ramp, one), view(ramp, one), view(treads, three))
    per_tread = [set(ids[three == k].tolist()) for k in range(3)]
    assert all(len(found) == 1 for found in per_tread)
    assert len(set.union(*per_tread)) == 3


@pytest.mark.parametrize("slope_deg", [0.0, 4.0, 15.0])
def test_pieces_of_one_plane_remain_one(slope_deg):
    plane = P.voxel_size_m * along * math.tan(math.radians(slope_deg))
    ids = ids_after(view(plane, one), view(plane, three))
    assert len(set(ids.ravel().tolist())) == 1
