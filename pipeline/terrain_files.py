"""The poses that a terrain map uses, its ground as a grid of heights and classes, and its files: JSON, PLY and glTF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import POSES
from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.estimators.terrain_map import Plane, Ramp, Stairs, Terrain, TerrainEstimate, TerrainMap
from stridetwin.streams.errors import RecordingError, needing
from stridetwin.streams.files import json_text, whole_file
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Array, Odometry

KINDS = (*MODES, "none")
"""Class of the ground for a walker in a given direction: the mode of steps on it; `none` without a class."""
KIND_COLORS = (
    (70, 170, 90), (50, 110, 220), (130, 80, 205), (230, 140, 30), (185, 70, 45), (150, 150, 150),
)  # fmt: skip
"""RGB of each of `KINDS`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundGrid:
    """Columns of the map in the map's own, rotated grid.

    Attributes:
        first: (2,) int64, column of the first cell.
        height: (I, J) m, NaN where unknown.
        plane: (I, J) int64, id of the plane, -1 without a plane.
        rotation: (2, 2), grid to world.
        cell_m: Edge of a column.
    """

    first: NDArray[np.int64]
    height: Array
    plane: NDArray[np.int64]
    rotation: Array
    cell_m: float

    @classmethod
    def of(cls, terrain_map: TerrainMap) -> GroundGrid:
        """The current ground of a map."""
        p = terrain_map.parameters
        c, s = math.cos(p.grid_rotation_rad), math.sin(p.grid_rotation_rad)
        rotation = np.array([[c, -s], [s, c]])
        points, plane = terrain_map.surface_points()
        columns = np.floor(points[:, :2] @ rotation / p.voxel_size_m).astype(np.int64)
        first = columns.min(axis=0) if len(columns) else np.zeros(2, np.int64)
        shape = columns.max(axis=0) - first + 1 if len(columns) else np.zeros(2, np.int64)
        height, ids = np.full(shape, np.nan), np.full(shape, -1, np.int64)
        i, j = (columns - first).T
        height[i, j], ids[i, j] = points[:, 2], plane
        return cls(first=first, height=height, plane=ids, rotation=rotation, cell_m=p.voxel_size_m)

    def at(self, xy: Array) -> tuple[Array, NDArray[np.int64]]:
        """Heights (...) m and plane ids (...) at places (..., 2) in the map's world; NaN and -1 where unknown."""
        cell = np.floor(xy @ self.rotation / self.cell_m).astype(np.int64) - self.first
        inside = np.asarray(((cell >= 0) & (cell < self.height.shape)).all(axis=-1), bool)
        if not self.height.size:
            return np.full(inside.shape, np.nan), np.full(inside.shape, -1, np.int64)
        i, j = np.moveaxis(np.where(inside[..., None], cell, 0), -1, 0)
        return np.where(inside, self.height[i, j], np.nan), np.where(inside, self.plane[i, j], -1)

    def points(self) -> tuple[Array, NDArray[np.int64]]:
        """(N, 3) m in the map's world, and (N,) ids."""
        i, j = np.nonzero(np.isfinite(self.height))
        xy = (np.column_stack([i, j]) + self.first + 0.5) * self.cell_m @ self.rotation.T
        return np.column_stack([xy, self.height[i, j]]), self.plane[i, j]


def kind_of(estimate: TerrainEstimate, plane: int, heading: float) -> str:
    """One of `KINDS`: the class of a plane for a walker whose direction is given in rad from x in the map's world."""
    terrain = estimate.terrain_of(plane)
    if terrain is None:
        return "none"
    if not isinstance(terrain, Ramp | Stairs):
        return "LG"
    up = math.cos(terrain.heading - heading) >= 0.0
    if isinstance(terrain, Stairs):
        return "SA" if up else "SD"
    return "RA" if up else "RD"


def kinds_at(estimate: TerrainEstimate, plane: NDArray[np.int64], heading: float) -> NDArray[np.uint8]:
    """Indices (...) into `KINDS` for plane ids (...)."""
    ids, where = np.unique(plane, return_inverse=True)
    known = [kind_of(estimate, int(i), heading) if i >= 0 else "none" for i in ids]
    return np.array([KINDS.index(kind) for kind in known], np.uint8)[where].reshape(np.shape(plane))


COLORS = {"none": (150, 150, 150), "level": (70, 170, 90), "ramp": (230, 140, 30), "stairs": (50, 110, 220)}
"""RGB of a point of the `.ply` by its class."""
_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def given_poses(recording: Recording, camera: CameraCalibration) -> tuple[str, str]:
    """The poses in a recording, and the frame that they belong to.

    Returns:
        Topic of the camera's own path, or of that of another sensor on its body; and that frame, "" for a folder of
        depth alone.

    Raises:
        RecordingError: There are none.
    """
    rig = recording.rig
    frames: list[CameraCalibration | ImuCalibration] = [camera, *rig.imus.values(), *rig.cameras.values()]
    for frame in frames:
        topic = f"/truth{frame.topic}/odometry"
        if topic in recording.topics and frame.mount.body == camera.mount.body:
            return topic, frame.topic.removeprefix("/")
    paths = [topic for topic, info in recording.topics.items() if info.kind is Odometry]
    if len(paths) == 1 and not recording.is_mcap:  # in a folder of depth alone, the poses are the depth camera's
        return paths[0], ""
    raise RecordingError(
        f"{recording.path}: no poses (/truth{camera.topic}/odometry); expected such poses, or --poses FILE"
    )


def pose_sample(t_ns: int, p: Array, q: Array, topic: str = POSES) -> Odometry:
    """A pose, position (3,) m and quaternion (4,), as a sample; its velocities are unknown."""
    unknown = np.full(3, np.nan)
    return Odometry(
        topic=topic, t_ns=t_ns, p_frame_in_world=p, q_world_frame=q, v_frame_in_world=unknown, angular_rate=unknown
    )


def document(estimate: TerrainEstimate) -> dict[str, Any]:
    """Planes and terrains for a JSON file: m, degrees, world axes; unknown values are null."""
    return {
        "t_s": estimate.t_ns * 1e-9,
        "p_camera_in_world_m": _plain(estimate.p_camera_in_world),
        "planes": [_plane(p, estimate.terrain_of(p.id)) for p in estimate.planes.values()],
        "terrains": [_terrain(t) for t in estimate.terrains],
    }


def write_terrain(terrain_map: TerrainMap, file: Path, *, mesh: bool = False) -> list[Path]:
    """Writes planes and terrains as JSON, and the ground as a `.ply` of the same name.

    Args:
        terrain_map: The map.
        file: The JSON.
        mesh: Also writes a `.glb`, the ground as a surface; and every surface as `_mesh.ply`, if the map has one.

    Raises:
        RecordingError: The map is empty.
        StrideTwinError: A mesh is requested, and the library that writes it is not installed.
    """
    estimate = terrain_map.estimate
    if estimate is None:
        raise RecordingError("no depth image has a pose, so the map is empty")
    extra = _meshes(terrain_map, estimate, file) if mesh else {}
    points, plane = terrain_map.surface_points()
    cloud = file.with_suffix(".ply")
    with whole_file(cloud) as out:
        _write_ply(points, [_kind(estimate.terrain_of(int(p))) for p in plane], plane, out)
    with whole_file(file) as out:
        out.write_text(json_text(document(estimate)), encoding="utf-8")
    for surface, content in extra.items():
        with whole_file(surface) as out:
            out.write_bytes(content)
    return [file, cloud, *extra]


def _meshes(terrain_map: TerrainMap, estimate: TerrainEstimate, file: Path) -> dict[Path, bytes]:
    """Content of the mesh files.

    Raises:
        StrideTwinError: trimesh is not installed.
    """
    with needing("a mesh needs it", "twin"):
        import trimesh
    scene = trimesh.Scene()
    scene.add_geometry(_ground(terrain_map, estimate), node_name="ground", geom_name="ground", transform=_Y_UP)
    files = {file.with_suffix(".glb"): bytes(scene.export(file_type="glb", include_normals=True))}
    if (surfaces := terrain_map.mesh()) is not None:
        mesh: Any = trimesh.Trimesh(*surfaces, process=False)
        files[file.with_name(f"{file.stem}_mesh.ply")] = bytes(mesh.export(file_type="ply"))
    return files


def _ground(terrain_map: TerrainMap, estimate: TerrainEstimate) -> Any:
    """The ground as a mesh, m: one vertex per column of the map, coloured by class.

    Vertices are in the map's world, z up; the scene's node rotates them to y up, as glTF requires.
    """
    import trimesh

    grid = GroundGrid.of(terrain_map)
    points, plane = grid.points()
    known = np.isfinite(grid.height)
    number = np.full(known.shape, -1, np.int64)
    number[known] = np.arange(len(points))
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    whole = corners[(corners >= 0).all(axis=-1)]
    faces = np.concatenate([whole[:, [0, 1, 2]], whole[:, [0, 2, 3]]])
    ids, where = np.unique(plane, return_inverse=True)
    rgb = np.array([COLORS[_kind(estimate.terrain_of(int(i)))] for i in ids], np.uint8)[where]
    surface = trimesh.Trimesh(vertices=points, faces=faces, vertex_colors=rgb, process=False)
    surface.remove_unreferenced_vertices()
    surface.vertex_normals  # noqa: B018  (computed here, and so written)
    return surface


def _kind(terrain: Terrain | None) -> str:
    return "none" if terrain is None else type(terrain).__name__.lower()


def _plane(plane: Plane, terrain: Terrain | None) -> dict[str, Any]:
    return {
        "id": plane.id,
        "terrain": _kind(terrain),
        "centre_m": _plain(plane.centre),
        "normal": _plain(plane.normal),
        "area_m2": plane.area_m2,
        "slope_deg": math.degrees(plane.slope),
        "slope_sd_deg": math.degrees(plane.slope_sd),
        "height_sd_m": math.sqrt(plane.covariance[0, 0]),
        "votes": plane.votes,
    }


def _terrain(terrain: Terrain) -> dict[str, Any]:
    if isinstance(terrain, Stairs):
        sd = np.sqrt(np.diag(terrain.covariance))
        return {
            "type": "stairs", "id": terrain.id, "planes": list(terrain.planes), "steps": terrain.steps,
            "riser_m": terrain.riser, "riser_sd_m": _number(sd[0]), "tread_m": _number(terrain.tread),
            "tread_sd_m": _number(sd[1]), "heading_deg": math.degrees(terrain.heading), "start_m": terrain.start,
            "start_sd_m": _number(sd[3]), "base_m": terrain.base, "edges_m": _plain(terrain.edges),
            "risers_m": _plain(terrain.risers), "across_m": _plain(terrain.across),
        }  # fmt: skip
    known: dict[str, Any] = {"type": _kind(terrain), "id": terrain.id, "planes": [terrain.plane]}
    if isinstance(terrain, Ramp):
        known |= {"slope_deg": math.degrees(terrain.slope), "slope_sd_deg": math.degrees(terrain.slope_sd),
                  "heading_deg": math.degrees(terrain.heading)}  # fmt: skip
    return known


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _plain(values: Any) -> list[float | None]:
    return [_number(v) for v in values]


def _write_ply(points: Any, kinds: list[str], plane: Any, file: Path) -> None:
    """Binary PLY: x, y, z, colour, and the plane's id."""
    columns = [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("plane", "<i4"),
    ]
    rows = np.empty(len(points), columns)
    rows["x"], rows["y"], rows["z"] = points.T
    rows["red"], rows["green"], rows["blue"] = np.array([COLORS[k] for k in kinds], np.uint8).reshape(-1, 3).T
    rows["plane"] = plane
    names = {"<f4": "float", "u1": "uchar", "<i4": "int"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property {names[kind]} {name}" for name, kind in columns]
    file.write_bytes(("\n".join([*header, "end_header"]) + "\n").encode() + rows.tobytes())
