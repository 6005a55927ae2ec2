"""The published map with Open3D reconstructs planes, ramps and stairs, stays bounded, and says what it lacks."""

import math
import sys

import numpy as np
import pytest
import scenes

from stridetwin.estimators.backends import OPEN3D
from stridetwin.estimators.base import Options
from stridetwin.estimators.terrain_map import Level, TerrainMap
from stridetwin.estimators.terrain_map.depth_camera import DepthCamera
from stridetwin.estimators.terrain_map.open3d_volume import Open3dVolume
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.streams.errors import ConfigError, StrideTwinError

OPTIONS = Options(backend=OPEN3D)
FLOOR = scenes.flight(0.16, 0.30, 1, start=20.0)


def published_map():
    return TerrainMap(scenes.RIG, options=OPTIONS)


def test_a_floor_is_one_level_plane_where_it_is():
    terrain_map, estimate = scenes.approach(FLOOR, start=2.0, end=1.0, frames=8, terrain_map=published_map())
    (plane,) = estimate.planes.values()
    assert isinstance(estimate.terrain_of(plane.id), Level)
    assert plane.height(np.array([0.5, 0.0])) == pytest.approx(0.0, abs=0.01)
    assert plane.slope < math.radians(1.0)
    heights = terrain_map.heights(np.array([[0.3, 0.1], [0.8, -0.2]]))
    np.testing.assert_allclose(heights, 0.0, atol=0.015)


def test_stairs_have_their_risers_and_treads():
    terrain_map, estimate = scenes.approach(
        scenes.flight(0.16, 0.30, 5), start=2.2, end=1.2, terrain_map=published_map()
    )
    stairs = max(estimate.stairs, key=lambda s: s.steps)
    assert stairs.steps >= 3
    assert stairs.riser == pytest.approx(0.16, abs=0.01)
    assert stairs.tread == pytest.approx(0.30, abs=0.03)
    assert abs(stairs.heading) < math.radians(5.0)
    edges = [c for c in terrain_map.profile(np.array([-1.2, 0.0]), 0.0).changes if c.kind == "edge"]
    np.testing.assert_allclose([c.s for c in edges[:3]], 1.2 + 0.3 * np.arange(3), atol=0.05)
    np.testing.assert_allclose([c.drop for c in edges[:3]], 0.16, atol=0.02)


def test_a_ramp_has_its_slope():
    ramp = scenes.slope(math.radians(12.0), 0.0, 0.4)
    estimate = scenes.approach(FLOOR, start=2.0, end=1.0, more=ramp, terrain_map=published_map())[1]
    found = max(estimate.ramps, key=lambda r: estimate.planes[r.plane].area_m2)
    assert found.slope == pytest.approx(math.radians(12.0), abs=math.radians(1.0))


def test_columns_between_the_pixels_lie_in_their_plane():
    volume = Open3dVolume(DepthCamera(scenes.RIG.cameras["/head/color"]), TerrainMapParameters())
    tilt = math.radians(30.0)
    along, across = np.meshgrid(np.arange(-1.0, 1.0, 0.08), np.arange(-0.5, 0.5, 0.08))
    points = np.stack([along, across, 0.4 + along * math.tan(tilt)], axis=-1).reshape(-1, 3).astype(np.float32)
    normal = np.array([-math.sin(tilt), 0.0, math.cos(tilt)])
    plane = np.array([[*normal, 0.4 * math.cos(tilt)]])
    count = len(points)
    view = volume._project_down(points, np.full(count, 0.004, np.float32), np.zeros(count, np.int32), plane)
    i, j = np.nonzero(np.isfinite(view.height))
    assert len(i) > 5 * count
    x = (view.first[0] + i + 0.5) * 0.02
    np.testing.assert_allclose(view.height[i, j], 0.4 + x * math.tan(tilt), atol=0.01)  # half a column is 6 mm


def test_ground_that_left_the_view_stays_and_memory_is_bounded():
    terrain_map = published_map()
    held = []
    for i, x in enumerate(np.arange(0.0, 16.0, 0.4)):
        eye, R = np.array([x, 0.0, scenes.EYE_M]), scenes.attitude(0.0)
        terrain_map.update(scenes.pose(i * scenes.PERIOD_NS, eye, R))
        terrain_map.update(
            scenes.depth(i * scenes.PERIOD_NS, scenes.image([scenes.Box(x=(-5, 40), y=(-5, 5))], eye, R, None))
        )
        held.append(terrain_map._volume.blocks_used)
    assert terrain_map.ground(np.array([x, 0.0])) is not None  # under the feet
    assert max(held[-10:]) < 1.3 * max(held[15:25])


def test_a_view_that_grows_is_cast_whole_at_once():
    volume = Open3dVolume(DepthCamera(scenes.RIG.cameras["/head/color"]), TerrainMapParameters())
    for i in range(4):
        eye, R = np.array([0.3 * i, 0.0, scenes.EYE_M]), scenes.attitude(0.2 * i)
        T_grid_camera = np.eye(4)
        T_grid_camera[:3, :3], T_grid_camera[:3, 3] = R.as_matrix(), eye
        volume.integrate(i * scenes.PERIOD_NS, scenes.image(FLOOR, eye, R, None), T_grid_camera)
        np.testing.assert_array_equal(volume.render_depth(), volume.render_depth())


def test_two_runs_agree_to_the_bit():
    images = []
    for _ in range(2):  # the hash map puts its blocks in another order in each run
        terrain_map, _ = scenes.approach(FLOOR, start=2.0, end=1.6, frames=4, terrain_map=published_map())
        images.append(terrain_map._volume.render_depth())
    np.testing.assert_array_equal(*images)


def test_the_mesh_lies_on_the_ground():
    terrain_map, _ = scenes.approach(FLOOR, start=2.0, end=1.6, frames=5, terrain_map=published_map())
    vertices, triangles = terrain_map.mesh()
    assert triangles.max() < len(vertices)
    assert np.median(np.abs(vertices[:, 2])) < 0.01
    assert TerrainMap(scenes.RIG).mesh() is None


def test_a_missing_open3d_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(StrideTwinError, match=r"open3d is not installed; .*\.\[open3d\]"):
        published_map()


def test_an_unknown_backend_is_named():
    with pytest.raises(ConfigError, match=r"backend: invalid 'cuda': expected numba, open3d"):
        TerrainMap(scenes.RIG, options=Options(backend="cuda"))


def test_jumps_clear_the_volume():
    terrain_map, _ = scenes.approach(FLOOR, start=2.0, end=1.6, frames=3, terrain_map=published_map())
    assert isinstance(terrain_map._volume, Open3dVolume)
    terrain_map.update(scenes.pose(10**12, np.array([50.0, 0.0, scenes.EYE_M]), scenes.attitude(0.0)))
    assert terrain_map._volume.blocks_used == 0
    assert terrain_map.estimate is None
