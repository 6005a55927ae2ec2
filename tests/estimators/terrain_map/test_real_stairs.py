"""One real image of a real staircase, the wearer's leg and shoe in it."""

import numpy as np
import pytest

from benchmarks.real_walks import data_folder
from stridetwin.streams.formats.opening import open_any
from tests.mapped_recording import map_recording

FOLDER = data_folder("stairs_depth")
pytestmark = pytest.mark.skipif(FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")


@pytest.fixture(scope="module")
def terrain_map():
    return map_recording(open_any(FOLDER / "stairs_depth"))


def test_floor_and_treads_with_their_measures(terrain_map):
    flight = max(terrain_map.estimate.stairs, key=lambda s: s.steps)
    assert flight.steps >= 2
    assert ((flight.risers > 0.08) & (flight.risers < 0.11)).all()
    treads = np.diff(flight.edges)
    assert ((treads > 0.26) & (treads < 0.30)).all()
    assert 0.26 < flight.tread < 0.30


def test_leg_shoe_and_stool_are_in_no_tread(terrain_map):
    """Nothing of a tread's columns lies off its plane: what stands on it is not in it."""
    estimate = terrain_map.estimate
    flight = max(estimate.stairs, key=lambda s: s.steps)
    points, plane = terrain_map.surface_points()
    for id_ in flight.planes:
        tread = estimate.planes[id_]
        own = points[plane == id_]
        assert np.abs(own[:, 2] - tread.height(own[:, :2])).max() < 0.045
        assert np.std(own[:, 2] - tread.height(own[:, :2])) < 0.008
    assert max(estimate.planes[i].centre[2] for i in flight.planes) < -0.6
