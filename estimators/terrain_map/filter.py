"""The terrain map as an estimator: depth images and poses in, ground out."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.backends import BACKENDS, NUMBA, OPEN3D
from stridetwin.estimators.base import CAMERA_POSES, POSE_STREAM, TERRAIN, Declaration, Options, Stream
from stridetwin.estimators.terrain_map.depth_camera import (
    NOT_SEEN,
    DepthCamera,
    Poses,
    camera_in_frame,
    depth_calibration,
    is_pose,
    transform,
)
from stridetwin.estimators.terrain_map.estimate import Plane, Profile, Terrain, TerrainEstimate
from stridetwin.estimators.terrain_map.open3d_volume import Open3dVolume
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters
from stridetwin.estimators.terrain_map.plane_set import PlaneSet
from stridetwin.estimators.terrain_map.profile import read_profile
from stridetwin.estimators.terrain_map.terrains import Terrains
from stridetwin.estimators.terrain_map.volume import VoxelVolume
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Depth, Odometry, Sample

GRID_ROTATION_RAD = 0.35
"""Angle between grid and world axes, which makes edges across the walking direction oblique to the voxels; tuned.

Doubled: edges move by up to 7 mm, to either side.
"""
_NEVER_NS = -(10**18)
"""A time before any image."""
_MIN_PIXELS = 500
"""A depth image with fewer valid pixels is ignored."""
# (25, 2) offsets of the columns around one
_AROUND = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)


class TerrainMap:
    """Map of the ground around the wearer of a depth camera: level ground, ramps and stairs.

    Causal, of bounded memory, deterministic. A depth image needs a pose no older than `max_pose_age_s`; poses come
    before the images of the same instant. An estimated pose of the camera in their frame replaces its nominal mount.
    Images without such a pose, without depth, or older than the last one are ignored, as are non-finite poses. The map
    is reset when the pose jumps or after a long gap in the poses.

    Every image is integrated; planes are extracted every `period_s`: at 30 Hz, after every other image.

    Args:
        rig: Holds the camera.
        options: `poses_of`, the frame of the incoming poses; `backend`, one of `BACKENDS`: `numba`, the proposed
            volume, or `open3d`, the published one by Open3D.
        topic: Depth stream; None: the rig's first.
        parameters: One set serves every camera and terrain.

    Raises:
        ConfigError: The backend is unknown.
        StrideTwinError: The rig has no such depth camera, or Open3D is not installed.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="terrain_map", kind=TERRAIN, order=1, backends=BACKENDS, budget_s=0.2, window_s=0.06
    )

    def __init__(
        self,
        rig: Rig,
        *,
        options: Options | None = None,
        topic: str | None = None,
        parameters: TerrainMapParameters | None = None,
    ) -> None:
        """Prepares an empty map; a rotated grid keeps edges across the walking direction oblique to the voxels.

        Raises ConfigError for an unknown backend, and StrideTwinError where the rig has no such depth camera or frame.
        """
        Rig.check(rig, "TerrainMap")
        options = options or Options()
        self.parameters = p = parameters or TerrainMapParameters()
        camera = depth_calibration(rig, topic)
        self._camera = DepthCamera(camera)
        self._T_frame_camera = camera_in_frame(rig, camera, options.poses_of)
        self._poses = Poses(p)
        self._R_world_grid = _rotation_z(GRID_ROTATION_RAD)
        self._volume = _build_volume(options.backend, self._camera, self._R_world_grid, p)
        self._planes = PlaneSet(p, keeps_unobserved=self._volume.keeps_unobserved)
        self._terrains = Terrains(self._R_world_grid, p)
        # times of the last image used, and of the last one after which planes were extracted
        self._last_ns = self._extracted_ns = _NEVER_NS
        self._estimate: TerrainEstimate | None = None
        self._last_view: tuple[NDArray[np.float32], Array] | None = None  # the last image, (4, 4) pose of its camera

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """Poses and depth.

        Raises:
            StrideTwinError: The rig has no depth camera.
        """
        return POSE_STREAM, Stream(role="depth", topic=depth_calibration(rig).depth_topic, kind=Depth)

    def update(self, sample: Sample) -> TerrainEstimate | None:
        """Takes one sample; returns the new estimate after an image from which planes were extracted, else None.

        A pose is kept for the images; one that jumps, or comes after a long gap, clears the map. An estimated pose of
        the camera in their frame replaces its mount. An image is integrated if it has a pose and enough depth.
        """
        if isinstance(sample, Odometry):
            if sample.topic == CAMERA_POSES:
                if is_pose(sample):
                    self._T_frame_camera = transform(sample)
            elif self._poses.add(sample):
                self.clear()
            return None
        if not isinstance(sample, Depth) or sample.topic != self._camera.topic or sample.t_ns <= self._last_ns:
            return None
        T_world_frame = self._poses.at(sample.t_ns)
        if T_world_frame is None:
            return None
        self._last_ns = sample.t_ns
        depth, valid_count = self._camera.rectify(sample.depth, self.parameters)
        if valid_count < _MIN_PIXELS:
            return None
        T_world_camera = T_world_frame @ self._T_frame_camera
        T_grid_camera = T_world_camera.copy()
        T_grid_camera[:3] = self._R_world_grid.T @ T_world_camera[:3]  # grid and world have the same origin
        self._last_view = depth, T_world_camera
        self._volume.integrate(sample.t_ns, depth, T_grid_camera)
        self._planes.surface.move(self._volume.origin)  # the columns follow the volume's window
        if not self.due(sample.t_ns):
            return None
        self._extract(sample.t_ns, T_world_camera[:3, 3].copy())
        return self._estimate

    def due(self, t_ns: int) -> bool:
        """Whether planes will be extracted after an image of this time."""
        return t_ns - self._extracted_ns >= self.parameters.period_s * 1e9

    @property
    def estimate(self) -> TerrainEstimate | None:
        """The last estimate; None before the first image and after a jump."""
        return self._estimate

    def heights(self, xy: Array) -> Array:
        """(N,) m, mapped height of the ground at (N, 2) positions in the world; NaN where unobserved."""
        # (N, 2) column of each position; xy @ R_world_grid is xy in grid axes
        columns = np.floor(np.asarray(xy) @ self._R_world_grid[:2, :2] / self.parameters.voxel_size_m).astype(np.int64)
        _, heights = self._planes.surface.at(columns)
        return heights.astype(float)

    def profile(self, origin: Array, heading: float, length_m: float = 4.0) -> Profile:
        """The ground along a line.

        Args:
            origin: (2,) m, world, start of the line.
            heading: Direction of the line in the world, rad from x.
            length_m: Length of the line, m.
        """
        return read_profile(
            self._estimate, self._planes, self._R_world_grid, self.parameters, origin, heading, length_m
        )

    def ground(self, xy: Array) -> tuple[Plane, Terrain | None] | None:
        """The plane and the terrain under a (2,) position in the world, m; None where no plane is known.

        The plane is the majority among the surrounding columns, so a hole in the map is not a hole in the ground.
        """
        if self._estimate is None:
            return None
        # (2,) column of the position; xy @ R_world_grid is xy in grid axes
        column = np.floor(np.asarray(xy) @ self._R_world_grid[:2, :2] / self.parameters.voxel_size_m).astype(np.int64)
        slots, _ = self._planes.surface.at(column + _AROUND)  # (25,) slot of the plane of each column around, or -1
        if not (slots >= 0).any():
            return None
        majority = np.bincount(slots[slots >= 0]).argmax()  # the most frequent slot
        plane = self._estimate.planes[int(self._planes.ids[majority])]
        return plane, self._estimate.terrain_of(plane.id)

    def look_for_ground(self, points: Array) -> NDArray[np.int64]:
        """(N,) what the last depth image shows where ground is expected, at (N, 3) points in the world, m.

        Each is one of `NOT_SEEN` (out of view, too far, or behind something), `GROUND` (there is a surface), `BEHIND`
        (the image shows only something behind it, so nothing is there) and `NO_DEPTH`.
        """
        if self._last_view is None or not len(points):
            return np.full(len(points), NOT_SEEN)
        depth, T_world_camera = self._last_view
        return self._camera.look_at(depth, (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3])

    def mesh(self) -> tuple[Array, NDArray[np.int64]] | None:
        """(V, 3) m, world, and (F, 3): vertices and triangles of all surfaces; None unless the backend makes them."""
        grid_mesh = self._volume.mesh()
        if grid_mesh is None:
            return None
        vertices, triangles = grid_mesh  # in grid axes
        return vertices @ self._R_world_grid.T, triangles

    def surface_points(self) -> tuple[Array, NDArray[np.int64]]:
        """(N, 3) m, world, the ground from above, one point per column; and (N,) the id of its plane, -1 = none."""
        surface = self._planes.surface
        i, j = np.nonzero(np.isfinite(surface.height))  # places in the ring
        places = np.column_stack([i, j])
        # (N, 2) the column of the window that is stored at each place
        columns = surface.origin + (places - surface.origin) % len(surface.label)
        points = np.column_stack([(columns + 0.5) * self.parameters.voxel_size_m, surface.height[i, j]])  # grid axes
        slots = surface.label[i, j]
        return points @ self._R_world_grid.T, np.where(slots >= 0, self._planes.ids[slots], -1)

    def _extract(self, t_ns: int, p_camera_in_world: Array) -> None:
        """Extracts planes from the volume and terrains from the planes, and sets the estimate.

        `t_ns` and `p_camera_in_world` (3,), m, are time and camera position of the last image.
        """
        self._extracted_ns = t_ns
        self._planes.update(self._volume.top_view())
        planes = self._planes.planes(self._R_world_grid)
        terrains, rises = self._terrains.find(planes, self._planes, self._volume.refine_riser, p_camera_in_world)
        self._estimate = TerrainEstimate(
            t_ns=t_ns, planes=planes, terrains=terrains, rises=rises, p_camera_in_world=p_camera_in_world
        )

    def clear(self) -> None:
        """Removes all ground; ids continue."""
        self._volume.clear()
        self._planes.clear()
        self._estimate = self._last_view = None
        self._extracted_ns = _NEVER_NS


def _build_volume(
    backend: str, camera: DepthCamera, R_world_grid: Array, p: TerrainMapParameters
) -> VoxelVolume | Open3dVolume:
    """The volume of a backend: `numba` (or "") is the proposed one, `open3d` the published one.

    Raises:
        ConfigError: The backend is unknown.
    """
    if backend in ("", NUMBA):
        return VoxelVolume(camera, R_world_grid, p)
    if backend == OPEN3D:
        return Open3dVolume(camera, p)
    raise ConfigError("TerrainMap", "backend", backend, ", ".join(BACKENDS))


def _rotation_z(angle: float) -> Array:
    """(3, 3) rotation by an angle, rad, about z; `arrays.rot_z` is for stacks, and its cosine may round otherwise."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
