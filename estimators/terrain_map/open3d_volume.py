"""The volume of Zhao 2023 as published, with Open3D: Zhao 2023 (19)-(22), ray casting, and planes of I_D^s.

The truncation t_δ is a distance along the line of sight, every image has the weight 1, and planes are extracted by
agglomerative clustering from the smoothed depth image in the camera's view (sections II-E and F). The paper does not
give sizes of voxels and cells, t_δ or W_max; they are those of `TerrainMapParameters`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.terrain_map.depth_camera import DepthCamera
from stridetwin.estimators.terrain_map.estimate import Plane
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_extraction import column_points, extract_large_planes, plane_sums
from stridetwin.estimators.terrain_map.plane_set import COLUMNS, NONE, TopView
from stridetwin.estimators.terrain_map.risers import Riser
from stridetwin.estimators.terrain_map.volume import HEADROOM_M, VIEW, min_noise_m, view_corner
from stridetwin.estimators.terrain_map.voxel_blocks import CAPACITY, EDGE
from stridetwin.streams.errors import explain_import_error
from stridetwin.streams.samples import Array

_SMOOTHED = 2
"""Pixels of the camera's image per pixel of the smoothed image."""
_GAP = np.ones((7, 7), np.uint8)
"""Columns of a plane that may lie between two pixels' columns: pixels are 10 cm apart at the end of the range."""
_FRAGMENTS = 4 * CAPACITY
"""Parts of the image that blocks can cover: Open3D casts rays in parts of 128 px, and a block touches up to four."""


class Open3dVolume:
    """The published volume by Open3D's `VoxelBlockGrid`; the interface is that of `VoxelVolume`.

    Args:
        camera: Depth camera.
        parameters: Size of voxels, truncation and range.

    Raises:
        StrideTwinError: Open3D is not installed.
    """

    keeps_unobserved = True

    def __init__(self, camera: DepthCamera, parameters: TerrainMapParameters) -> None:
        """Begins without voxels; raises StrideTwinError if Open3D is not installed."""
        with explain_import_error("the backend open3d needs it", "open3d"):
            import open3d
        self._o3d: Any = open3d
        self._camera, self._p = camera, parameters
        self._K = self._tensor(_matrix(camera.intrinsics))
        self._shape = camera.shape[0] // _SMOOTHED, camera.shape[1] // _SMOOTHED
        # (4,) fu, fv, pu, pv of the smoothed image: the middle of its pixel 0 lies between the first `_SMOOTHED` pixels
        # of the camera's image
        self._intrinsics = (camera.intrinsics - np.array([0.0, 0.0, 1.0, 1.0]) * (_SMOOTHED - 1) / 2) / _SMOOTHED
        v, u = np.mgrid[: self._shape[0], : self._shape[1]]
        fu, fv, pu, pv = self._intrinsics
        # (h, w, 3) rays of its pixels at depth 1, camera's axes
        self._rays = np.stack([(u - pu) / fu, (v - pv) / fv, np.ones(self._shape)], axis=-1)
        self._band = parameters.truncation_m / parameters.voxel_size_m  # truncation, voxels
        self.clear()

    def clear(self) -> None:
        """Removes all voxels."""
        float32 = self._o3d.core.float32
        self._grid = self._o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (float32, float32), ((1,), (1,)), self._p.voxel_size_m, EDGE, CAPACITY
        )
        self._T_grid_camera = np.eye(4)
        self._in_view: Any = None  # (N, 3) keys of the blocks in view of the last image, as a tensor
        self._has_room = False  # whether Open3D's buffer for ray casting is large enough

    @property
    def origin(self) -> NDArray[np.int64]:
        """(2,) lowest column of the window, which is centred on the camera."""
        return np.floor(self._T_grid_camera[:2, 3] / self._p.voxel_size_m).astype(np.int64) - COLUMNS // 2

    @property
    def blocks_used(self) -> int:
        """Number of voxel blocks in use."""
        return int(self._grid.hashmap().size())

    def integrate(self, t_ns: int, depth: NDArray[np.float32], T_grid_camera: Array) -> None:
        """Integrates a depth image, (H, W) m, 0 = none, from a (4, 4) camera pose, m, by Zhao 2023 (19)-(22).

        Free space in view is updated too, so that moving objects vanish.
        """
        p, grid, self._T_grid_camera = self._p, self._grid, T_grid_camera
        image = self._o3d.t.geometry.Image(np.ascontiguousarray(depth))
        extrinsic = self._tensor(np.asarray(np.linalg.inv(T_grid_camera), float))
        limits = 1.0, p.max_range_m, self._band  # units of depth per metre, largest depth, m, truncation, voxels
        with self._quiet():
            grid.hashmap().activate(grid.compute_unique_block_coordinates(image, self._K, extrinsic, *limits))
            rows, self._in_view = self._visible_blocks()
            grid.integrate(self._in_view, image, self._K, extrinsic, *limits)
        weight = grid.attribute("weight").numpy()  # a view: assignments change the grid
        weight[rows] = np.minimum(weight[rows], p.max_weight)  # Zhao 2023 (22)

    def _visible_blocks(self) -> tuple[NDArray[np.int32], Any]:
        """Rows and keys of the blocks that may be in view of the last pose; those beyond the window are freed.

        Returns:
            (N,) rows of the blocks in Open3D's buffers, and their (N, 3) block coordinates as a tensor.
        """
        p, hashmap = self._p, self._grid.hashmap()
        rows = hashmap.active_buf_indices().numpy()  # (N,) of all blocks in use
        # (N, 3) block coordinates; (N, 3) m, from the camera to the middle of each block, grid axes
        keys, block_m = hashmap.key_tensor().numpy()[rows], EDGE * p.voxel_size_m
        offset = (keys + 0.5) * block_m - self._T_grid_camera[:3, 3]
        near = np.abs(offset).max(axis=1) < 0.5 * COLUMNS * p.voxel_size_m  # within the window
        if not near.all():
            for attribute in ("tsdf", "weight"):  # rows are used again as they are
                self._grid.attribute(attribute).numpy()[rows[~near]] = 0.0
            hashmap.erase(self._o3d.core.Tensor(keys[~near]))
        # middles of the blocks in the camera's axes; they may lie beside the image by up to two edges of a block
        x, y, z = (offset @ self._T_grid_camera[:3, :3]).T
        (fu, fv, pu, pv), (height, width) = self._camera.intrinsics, self._camera.shape
        # largest |x| / z and |y| / z in the image
        slope_u, slope_v = max(pu, width - pu) / fu, max(pv, height - pv) / fv
        seen = (z > 0.0) & (z < p.max_range_m + block_m)
        seen &= (np.abs(x) < slope_u * z + 2.0 * block_m) & (np.abs(y) < slope_v * z + 2.0 * block_m)
        return rows[near & seen], self._o3d.core.Tensor(keys[near & seen])

    def render_depth(self) -> NDArray[np.float32]:
        """(H / 2, W / 2) m, 0 = none: the smoothed depth image I_D^s, rendered from the last pose."""
        if self._in_view is None or not len(self._in_view):
            return np.zeros(self._shape, np.float32)
        if not self._has_room:
            blocks = self._in_view.numpy()  # a cast with too little room leaves out rays, and makes room for the next
            self._cast(self._o3d.core.Tensor(np.tile(blocks, (_FRAGMENTS // len(blocks) + 1, 1))))
            self._has_room = True
        return self._cast(self._in_view)

    def _cast(self, blocks: Any) -> NDArray[np.float32]:
        """(H / 2, W / 2) m, 0 = none: depth of the surface in a tensor of (N, 3) blocks, from the last pose."""
        p, extrinsic = self._p, self._tensor(np.asarray(np.linalg.inv(self._T_grid_camera), float))
        with self._quiet():
            cast = self._grid.ray_cast(
                blocks,
                self._tensor(_matrix(self._intrinsics)),
                extrinsic,
                self._shape[1],
                self._shape[0],
                ["depth"],
                1.0,  # units of depth per metre
                p.min_range_m,
                p.max_range_m,
                1.0,  # least weight of a voxel
                self._band,
            )
        return np.asarray(cast["depth"].numpy()[..., 0], np.float32)

    def top_view(self) -> TopView:
        """The planes of the smoothed depth image from the last pose, projected down to the columns of the ground."""
        p, T = self._p, self._T_grid_camera
        depth = self.render_depth()
        points = (depth[..., None] * self._rays @ T[:3, :3].T + T[:3, 3]).astype(np.float32)  # (h, w, 3) m, grid axes
        points[(depth == 0.0) | (points[..., 2] > T[2, 3] + HEADROOM_M)] = np.nan
        noise = np.hypot(min_noise_m(p), p.depth_noise_per_m * depth**2).astype(np.float32)
        labels, planes = extract_large_planes(points, noise, p)
        return self._project_down(points, noise, labels, planes)

    def _project_down(
        self, points: NDArray[np.float32], noise: NDArray[np.float32], labels: NDArray[np.int32], planes: Array
    ) -> TopView:
        """Projects labelled points down to the columns of a top view; in each column the highest point counts.

        Args:
            points: (h, w, 3) m, grid axes.
            noise: (h, w) m, standard deviation of each point.
            labels: (h, w) number of each point's plane, -1 = none.
            planes: (P, 4) planes a x + b y + c z = d; small gaps of a plane between its columns are filled by it.
        """
        voxel_m, first = self._p.voxel_size_m, view_corner(self._T_grid_camera, self._p)
        on_plane = labels >= 0
        points, noise, labels = points[on_plane], noise[on_plane], labels[on_plane]
        columns = np.floor(points[:, :2] / voxel_m).astype(np.int64) - first
        # from the lowest to the highest point: of those in one column the last one written, the highest, remains
        order = np.argsort(points[:, 2], kind="stable")
        order = order[((columns >= 0) & (columns < VIEW)).all(axis=1)[order]]
        i, j = columns[order].T
        height, spread = np.full((VIEW, VIEW), np.nan, np.float32), np.zeros((VIEW, VIEW), np.float32)
        label = np.full((VIEW, VIEW), NONE, np.int32)
        height[i, j], spread[i, j], label[i, j] = points[order, 2], noise[order], labels[order]
        view = column_points(height, first, voxel_m)  # (VIEW, VIEW, 3) m
        for number, (a, b, c, d) in enumerate(planes):
            # the plane's columns with the gaps between them; a gap gets the height of the plane there
            closed = cv2.morphologyEx((label == number).astype(np.uint8), cv2.MORPH_CLOSE, _GAP) > 0
            gap = closed & (label == NONE)
            view[gap, 2] = ((d - a * view[..., 0] - b * view[..., 1]) / c)[gap]
            label[gap], spread[gap] = number, self._p.plane_noise_m
        return TopView(first, label, plane_sums(view, spread, label, len(planes)), view[..., 2].copy(), spread)

    def refine_riser(self, edge: Riser, upper: Plane, down: Array) -> Riser:
        """Returns the riser unchanged, because the paper takes stairs from the planes alone.

        The other arguments are those of `VoxelVolume.refine_riser`, and not used.
        """
        return edge

    def mesh(self) -> tuple[Array, NDArray[np.int64]]:
        """(V, 3) m, grid axes, and (F, 3): vertices and triangles of all surfaces, by marching cubes."""
        mesh = self._grid.extract_triangle_mesh(weight_threshold=1.0)
        return mesh.vertex.positions.numpy().astype(float), mesh.triangle.indices.numpy().astype(np.int64)

    def _tensor(self, values: Array) -> Any:
        """An array as Open3D's tensor of doubles."""
        return self._o3d.core.Tensor(np.ascontiguousarray(values), self._o3d.core.float64)

    @contextmanager
    def _quiet(self) -> Iterator[None]:
        """Suppresses Open3D's warnings at each growth of its buffers."""
        with self._o3d.utility.VerbosityContextManager(self._o3d.utility.VerbosityLevel.Error):
            yield


def _matrix(intrinsics: Array) -> Array:
    """(3, 3) pinhole matrix of (4,) fu, fv, pu, pv."""
    fu, fv, pu, pv = intrinsics
    return np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])
