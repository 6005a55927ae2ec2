"""The terrain map as an estimator: depth images and poses in, ground out."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import MAP, POSE_STREAM, Declaration, Options, Stream, deprecated
from stridetwin.estimators.terrain_map.depth_camera import (
    DepthCamera,
    Poses,
    camera_in_frame,
    depth_calibration,
    without_outlines,
)
from stridetwin.estimators.terrain_map.estimate import Plane, Profile, Terrain, TerrainEstimate
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_extraction import patches
from stridetwin.estimators.terrain_map.plane_set import PlaneSet
from stridetwin.estimators.terrain_map.profile import profile
from stridetwin.estimators.terrain_map.ray_casting import from_above, from_camera, well_seen
from stridetwin.estimators.terrain_map.terrains import Terrains
from stridetwin.estimators.terrain_map.tsdf_integration import integrate, touch
from stridetwin.estimators.terrain_map.voxel_blocks import EDGE, clear, empty_blocks, roll
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Array, Depth, Odometry, Sample

_VIEW = 208
"""Columns along the edge of the top view."""
_NEVER_NS = -(10**18)
_AROUND = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)
_SMOOTHED = 4
"""Pixels of the camera's image per pixel of the smoothed image."""


class TerrainMap:
    """Map of the ground around the wearer of a depth camera: level ground, ramps and stairs.

    Causal, of bounded memory, deterministic. A depth image needs a pose no older than `max_pose_age_s`; poses come
    before the images of the same instant. Images without such a pose, without depth, or older than the last one are
    ignored, as are non-finite poses. The map is reset when the pose jumps or after a long gap in the poses.

    Every image is integrated; planes are extracted every `period_s`: at 30 Hz, after every other image.

    Args:
        rig: Holds the camera.
        options: `poses_of`, the frame of the incoming poses.
        mount: Deprecated; pose of the depth camera's optical frame in the frame of the poses (`T_body_sensor`).
        topic: Depth stream; None: the rig's first.
        parameters: One set serves every camera and terrain.

    Raises:
        StrideTwinError: The rig has no such depth camera.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="terrain_map", kind=MAP, order=1, budget_s=0.2, window_s=0.06,
        description="planes, ramps and stairs around the walker from depth images and poses",
    )  # fmt: skip

    def __init__(
        self,
        rig: Rig,
        *,
        options: Options | None = None,
        mount: Mount | None = None,
        topic: str | None = None,
        parameters: TerrainMapParameters | None = None,
    ) -> None:
        self.parameters = p = parameters or TerrainMapParameters()
        self._camera = DepthCamera.of(rig, topic)
        if mount is None:
            camera = depth_calibration(rig, topic)
            self._T_frame_camera = camera_in_frame(rig, camera, (options or Options()).poses_of)
        else:
            deprecated("TerrainMap(mount=...)", "TerrainMap(rig, options=Options(poses_of=FRAME))")
            self._T_frame_camera = np.asarray(mount.T_body_sensor, dtype=float)
        self._poses = Poses(p)
        self._blocks = empty_blocks()
        self._planes = PlaneSet(p)
        self._R_world_grid = _turned(p.grid_turn_rad)
        self._terrains = Terrains(self._R_world_grid, p)
        self._last_ns = self._looked_ns = _NEVER_NS
        self._T_grid_camera: Array | None = None
        self._estimate: TerrainEstimate | None = None

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """Poses and depth.

        Raises:
            StrideTwinError: The rig has no depth camera.
        """
        return POSE_STREAM, Stream(role="depth", topic=depth_calibration(rig).depth_topic, kind=Depth)

    def update(self, sample: Sample) -> TerrainEstimate | None:
        """Takes one sample; returns the new estimate of the ground, or None if nothing changed."""
        if isinstance(sample, Odometry):
            if self._poses.add(sample):
                self._forget()
            return None
        if not isinstance(sample, Depth) or sample.topic != self._camera.topic or sample.t_ns <= self._last_ns:
            return None
        T_world_frame = self._poses.at(sample.t_ns)
        if T_world_frame is None:
            return None
        self._last_ns = sample.t_ns
        depth, count = self._camera.rectified(sample.depth, self.parameters)
        if count < self.parameters.pixels_min:
            return None
        T_world_camera = T_world_frame @ self._T_frame_camera
        T_grid_camera = self._take(sample.t_ns, depth, T_world_camera)
        if not self.due(sample.t_ns):
            return None
        self._look(sample.t_ns, T_grid_camera, T_world_camera[:3, 3].copy())
        return self._estimate

    def due(self, t_ns: int) -> bool:
        """Whether planes will be extracted after an image of this time."""
        return t_ns - self._looked_ns >= self.parameters.period_s * 1e9

    def run(self, samples: Iterable[Sample]) -> TerrainEstimate | None:
        """Takes samples as `update` would; returns the last estimate."""
        for sample in samples:
            self.update(sample)
        return self._estimate

    @property
    def estimate(self) -> TerrainEstimate | None:
        """The last estimate; None before the first image and after a jump."""
        return self._estimate

    @property
    def blocks_used(self) -> int:
        """Number of voxel blocks in use."""
        return int(self._blocks.used.sum())

    def heights(self, xy: Array) -> Array:
        """(N,) m, mapped height of the ground at (N, 2) positions in the world; NaN where unobserved."""
        columns = np.floor(np.asarray(xy) @ self._R_world_grid[:2, :2] / self.parameters.voxel_size_m).astype(np.int64)
        return self._planes.surface.at(columns)[1].astype(float)

    def profile(self, origin: Array, heading: float, length_m: float = 4.0) -> Profile:
        """The ground along a line.

        Args:
            origin: (2,) m, world, start of the line.
            heading: Its direction in the world, rad from x.
            length_m: Its length.
        """
        return profile(self._estimate, self._planes, self._R_world_grid, self.parameters, origin, heading, length_m)

    def ground(self, xy: Array) -> tuple[Plane, Terrain | None] | None:
        """The plane and the terrain under a (2,) position in the world, m; None where no plane is known.

        The plane is the majority among the surrounding columns, so a hole in the map is not a hole in the ground.
        """
        if self._estimate is None:
            return None
        column = np.floor(np.asarray(xy) @ self._R_world_grid[:2, :2] / self.parameters.voxel_size_m).astype(np.int64)
        slots = self._planes.surface.at(column + _AROUND)[0]
        if not (slots >= 0).any():
            return None
        plane = self._estimate.planes[int(self._planes.ids[np.bincount(slots[slots >= 0]).argmax()])]
        return plane, self._estimate.terrain_of(plane.id)

    def smoothed(self) -> NDArray[np.float32]:
        """(H / 4, W / 4) m, 0 = none: the smoothed depth image I_D^s, the map rendered from the current camera pose."""
        shape = (self._camera.shape[0] // _SMOOTHED, self._camera.shape[1] // _SMOOTHED)
        if self._T_grid_camera is None:
            return np.zeros(shape, np.float32)
        shift = np.array([0.0, 0.0, 1.0, 1.0]) * (_SMOOTHED - 1) / 2
        p = self.parameters
        return from_camera(
            self._blocks, (self._camera.intrinsics - shift) / _SMOOTHED, shape, self._T_grid_camera, p.voxel_size_m,
            p.range_max_m,
        )  # fmt: skip

    def surface_points(self) -> tuple[Array, NDArray[np.int64]]:
        """(N, 3) m, world, the ground from above, one point per column; and (N,) the id of its plane, -1 = none."""
        surface = self._planes.surface
        i, j = np.nonzero(np.isfinite(surface.height))
        columns = np.column_stack([i, j])
        columns = surface.origin + (columns - surface.origin) % len(surface.label)
        points = np.column_stack([(columns + 0.5) * self.parameters.voxel_size_m, surface.height[i, j]])
        label = surface.label[i, j]
        return points @ self._R_world_grid.T, np.where(label >= 0, self._planes.ids[label], -1)

    def _take(self, t_ns: int, depth: NDArray[np.float32], T_world_camera: Array) -> Array:
        """Integrates a depth image into the voxels; returns the (4, 4) camera pose in grid axes."""
        p, blocks, camera = self.parameters, self._blocks, self._camera
        T_grid_camera = T_world_camera.copy()
        T_grid_camera[:3] = self._R_world_grid.T @ T_world_camera[:3]
        self._T_grid_camera = T_grid_camera
        eye = T_grid_camera[:3, 3]
        block_m = EDGE * p.voxel_size_m
        roll(blocks, eye - np.array([0.0, 0.0, p.below_m]), block_m, t_ns - round(p.stale_s * 1e9))
        self._planes.surface.move(blocks.origin[:2] * EDGE)
        clean = without_outlines(depth, p.outline_share, camera.pixels(p.outline_px))
        top_m = float(eye[2]) + p.headroom_m
        touch(blocks, clean, camera.intrinsics, T_grid_camera, p.voxel_size_m, p.truncation_m, top_m, t_ns)
        integrate(
            blocks, clean, camera.intrinsics, np.asarray(np.linalg.inv(T_grid_camera), float), p.voxel_size_m,
            p.truncation_m, p.weight_max, p.depth_noise_per_m,
        )  # fmt: skip
        return T_grid_camera

    def _look(self, t_ns: int, T_grid_camera: Array, p_camera_in_world: Array) -> None:
        """Extracts planes from the voxels and terrains from the planes."""
        p, blocks, eye = self.parameters, self._blocks, T_grid_camera[:3, 3]
        self._looked_ns = t_ns
        first = self._view_corner(T_grid_camera)
        height, weight = from_above(
            blocks, first[0], first[1], _VIEW, math.floor(eye[2] / p.voxel_size_m), p.voxel_size_m
        )
        noise = well_seen(height, weight, float(eye[2]), p.plane_noise_m / 3, p.plane_noise_m, p.depth_noise_per_m)
        fewest = round(p.strip_area_m2 / p.voxel_size_m**2)
        corner = first.astype(float) * p.voxel_size_m
        labels, sums = patches(height, noise, corner, p.voxel_size_m, p.ramp_rad, fewest, p.cell_angle_rad)
        self._planes.update(first, labels, sums, height, noise)
        planes = self._planes.planes(self._R_world_grid)
        self._estimate = TerrainEstimate(
            t_ns=t_ns, planes=planes, p_camera_in_world=p_camera_in_world,
            terrains=self._terrains.find(planes, self._planes, blocks),
        )  # fmt: skip

    def _view_corner(self, T_grid_camera: Array) -> NDArray[np.int64]:
        """(2,) first column of the top view, ahead of the camera along its axis and the image's up direction."""
        p = self.parameters
        ahead = T_grid_camera[:2, 2] - T_grid_camera[:2, 1]
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        middle = (T_grid_camera[:2, 3] + p.ahead_m * ahead) / p.voxel_size_m
        return (np.floor(middle / EDGE).astype(np.int64) - _VIEW // EDGE // 2) * EDGE

    def _forget(self) -> None:
        clear(self._blocks)
        self._planes.clear()
        self._estimate = None
        self._looked_ns = _NEVER_NS


def _turned(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
