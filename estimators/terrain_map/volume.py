"""The volume into which depth images are integrated, and the planes that are seen in it from above."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.depth_camera import DepthCamera, remove_discontinuities
from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_extraction import column_points, extract_planes
from stridetwin.estimators.terrain_map.plane_set import TopView
from stridetwin.estimators.terrain_map.ray_casting import cast_down, column_noise
from stridetwin.estimators.terrain_map.risers import Riser, refine_riser
from stridetwin.estimators.terrain_map.tsdf_integration import allocate, integrate
from stridetwin.estimators.terrain_map.voxel_blocks import EDGE, clear, empty_blocks, roll
from stridetwin.streams.samples import Array

VIEW = 208
"""Columns along the edge of the top view."""
HEADROOM_M = 0.1
"""Nothing higher above the camera is mapped."""
_DISCONTINUITY_SHARE, _DISCONTINUITY_PX = 0.04, 1.0
"""Inverse depths that differ by this share, within so many pixels of a 640-pixel image, belong to two surfaces."""
_BELOW_M = 1.5
"""Distance of the window's middle below the camera: about a person's neck height."""
_AHEAD_M = 1.6
"""Distance ahead of the camera at which the top view is centred."""
_STALE_S = 1.0
"""Voxels not observed for longer are freed first."""


class VoxelVolume:
    """The proposed volume: truncated distances as heights, and a virtual camera that looks straight down on them.

    Grid axes are the world's, rotated about the vertical.

    Args:
        camera: Depth camera.
        R_world_grid: (3, 3) grid to world axes.
        parameters: Size of voxels, truncation and noise.

    Attributes:
        keeps_unobserved: Whether a column unobserved in a top view keeps its plane.
    """

    keeps_unobserved = False

    def __init__(self, camera: DepthCamera, R_world_grid: Array, parameters: TerrainMapParameters) -> None:
        """Begins without voxels; `R_world_grid` (3, 3) rotates grid to world axes."""
        self._camera, self._R_grid_world, self._p = camera, R_world_grid.T, parameters
        self._blocks = empty_blocks()
        # pose of the last depth image; None before the first
        self._T_grid_camera: Array | None = None

    @property
    def origin(self) -> NDArray[np.int64]:
        """(2,) lowest column of the window."""
        return self._blocks.origin[:2] * EDGE

    @property
    def blocks_used(self) -> int:
        """Number of voxel blocks in use."""
        return int(self._blocks.used.sum())

    def clear(self) -> None:
        """Removes all voxels."""
        clear(self._blocks)

    def integrate(self, t_ns: int, depth: NDArray[np.float32], T_grid_camera: Array) -> None:
        """Integrates a depth image into the voxels; the window moves with the camera.

        Args:
            t_ns: Time of the image; blocks without a surface since `_STALE_S` before it are freed.
            depth: (H, W) m, 0 = none.
            T_grid_camera: (4, 4) optical frame to grid axes, m.
        """
        p, blocks, camera = self._p, self._blocks, self._camera
        self._T_grid_camera, eye = T_grid_camera, T_grid_camera[:3, 3]
        window_middle = eye - np.array([0.0, 0.0, _BELOW_M])  # m, grid axes
        roll(blocks, window_middle, EDGE * p.voxel_size_m, t_ns - round(_STALE_S * 1e9))
        clean = remove_discontinuities(depth, _DISCONTINUITY_SHARE, camera.pixels(_DISCONTINUITY_PX))
        top_m = float(eye[2]) + HEADROOM_M
        allocate(blocks, clean, camera.intrinsics, T_grid_camera, p.voxel_size_m, p.truncation_m, top_m, t_ns)
        integrate(
            blocks,
            clean,
            camera.intrinsics,
            np.asarray(np.linalg.inv(T_grid_camera), float),
            p.voxel_size_m,
            p.truncation_m,
            p.max_weight,
            p.depth_noise_per_m,
        )

    def top_view(self) -> TopView:
        """The planes seen in the volume from above, around a point ahead of the last camera pose.

        A depth image must have been integrated before.
        """
        assert self._T_grid_camera is not None
        p, eye_z = self._p, float(self._T_grid_camera[2, 3])
        first = view_corner(self._T_grid_camera, p)
        top = math.floor(eye_z / p.voxel_size_m)  # layer of the camera, from which the rays are cast down
        height, weight = cast_down(
            self._blocks, first[0], first[1], VIEW, top, p.voxel_size_m, eye_z, p.depth_noise_per_m
        )
        noise = column_noise(height, weight, eye_z, min_noise_m(p), p.plane_noise_m, p.depth_noise_per_m)
        labels, sums = extract_planes(column_points(height, first, p.voxel_size_m), noise, p)
        return TopView(first, labels, sums, height, noise)

    def refine_riser(self, edge: Riser, upper: Plane, down: Array) -> Riser:
        """A riser with its edge measured in the volume; `down` (2,) points across all edges of its flight."""
        return refine_riser(edge, upper, down, self._blocks, self._R_grid_world, self._p.voxel_size_m)

    def mesh(self) -> None:
        """None: this volume makes no mesh."""


def min_noise_m(p: TerrainMapParameters) -> float:
    """Standard deviation of the height of the columns nearest to the camera, m: the least that any column has."""
    return p.plane_noise_m / 3


def view_corner(T_grid_camera: Array, p: TerrainMapParameters) -> NDArray[np.int64]:
    """(2,) first column of the top view, whose middle is `_AHEAD_M` ahead of the camera; a multiple of `EDGE`.

    Ahead is the horizontal direction of the optical axis, plus that of the image's up direction: it also holds for a
    camera that looks straight down. `T_grid_camera` is (4, 4), optical frame to grid axes, m.
    """
    ahead = T_grid_camera[:2, 2] - T_grid_camera[:2, 1]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    middle = (T_grid_camera[:2, 3] + _AHEAD_M * ahead) / p.voxel_size_m  # of the top view, columns
    return (np.floor(middle / EDGE).astype(np.int64) - VIEW // EDGE // 2) * EDGE
