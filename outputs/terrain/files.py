"""Files of a terrain map: planes and terrains as JSON, the ground as PLY points and as a glTF mesh."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import AnyEstimator
from stridetwin.estimators.terrain_map import Plane, Ramp, Stairs, Terrain, TerrainEstimate, TerrainMap
from stridetwin.outputs.base import LiveOutput
from stridetwin.outputs.terrain.grid import GroundGrid
from stridetwin.streams.errors import RecordingError, explain_import_error
from stridetwin.streams.files import atomic_file, to_json
from stridetwin.streams.samples import Array

if TYPE_CHECKING:
    import trimesh

COLORS = {"none": (150, 150, 150), "level": (70, 170, 90), "ramp": (230, 140, 30), "stairs": (50, 110, 220)}
"""RGB of a point of the `.ply` by its class."""
# pose of the map in a glTF scene, whose y axis is up
_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


class TerrainDocument(TypedDict):
    """Planes and terrains of a map for a JSON file: m, degrees, world axes; unknown values are null."""

    t_s: float
    p_camera_in_world_m: list[float | None]
    planes: list[dict[str, object]]
    terrains: list[dict[str, object]]


def terrain_document(estimate: TerrainEstimate) -> TerrainDocument:
    """Planes and terrains for a JSON file: m, degrees, world axes; unknown values are null."""
    return {
        "t_s": estimate.t_ns * 1e-9,
        "p_camera_in_world_m": _to_list(estimate.p_camera_in_world),
        "planes": [_plane_fields(p, estimate.terrain_of(p.id)) for p in estimate.planes.values()],
        "terrains": [_terrain_fields(t) for t in estimate.terrains],
    }


def write_terrain(terrain_map: TerrainMap, file: Path, *, mesh: bool = False) -> list[Path]:
    """Writes planes and terrains as JSON, and the ground as points in a `.ply` of the same name.

    Args:
        terrain_map: The map.
        file: The JSON.
        mesh: Also writes a `.glb`, the ground as a surface; and every surface as `_mesh.ply`, if the map has one.

    Raises:
        RecordingError: The map is empty, because no depth image had a pose.
        StrideTwinError: A mesh is requested, and the library that writes it is not installed.
    """
    estimate = terrain_map.estimate
    if estimate is None:
        raise RecordingError("no depth image has a pose, so the map is empty")
    mesh_files = _export_meshes(terrain_map, estimate, file) if mesh else {}
    points, plane = terrain_map.surface_points()  # (N, 3) m, and (N,) id of the plane of each point
    kinds = [_terrain_name(estimate.terrain_of(int(p))) for p in plane]
    cloud = file.with_suffix(".ply")
    with atomic_file(cloud) as out:
        _write_ply(points, kinds, plane, out)
    with atomic_file(file) as out:
        out.write_text(to_json(terrain_document(estimate)), encoding="utf-8")
    for surface, content in mesh_files.items():
        with atomic_file(surface) as out:
            out.write_bytes(content)
    return [file, cloud, *mesh_files]


def _export_meshes(terrain_map: TerrainMap, estimate: TerrainEstimate, file: Path) -> dict[Path, bytes]:
    """Contents of the mesh files, by path: the ground as `.glb`, and every surface as `_mesh.ply` if the map has one.

    Args:
        terrain_map: The map.
        estimate: Its planes and terrains, which colour the ground.
        file: The JSON file, whose name the others take over.

    Raises:
        StrideTwinError: trimesh is not installed.
    """
    with explain_import_error("a mesh needs it", "twin"):
        import trimesh
    scene = trimesh.Scene()
    scene.add_geometry(
        _build_ground_mesh(terrain_map, estimate), node_name="ground", geom_name="ground", transform=_Y_UP
    )
    files = {file.with_suffix(".glb"): bytes(scene.export(file_type="glb", include_normals=True))}
    if (surfaces := terrain_map.mesh()) is not None:  # vertices and triangles of all surfaces
        mesh = trimesh.Trimesh(*surfaces, process=False)
        content = mesh.export(file_type="ply")
        assert isinstance(content, bytes)
        files[file.with_name(f"{file.stem}_mesh.ply")] = content
    return files


def _build_ground_mesh(terrain_map: TerrainMap, estimate: TerrainEstimate) -> trimesh.Trimesh:
    """The ground as a mesh, m: one vertex per column of the map, coloured by class.

    Vertices are in the map's world, z up; the scene's node rotates them to y up, as glTF requires.
    """
    import trimesh

    grid = GroundGrid.of(terrain_map)
    points, plane = grid.points()
    is_known = np.isfinite(grid.height)
    # number of the vertex in each cell; -1 without one. Four neighbours with vertices make two triangles.
    number = np.full(is_known.shape, -1, np.int64)
    number[is_known] = np.arange(len(points))
    # (I - 1, J - 1, 4) vertices of each square of four neighbouring cells, in order around it
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    squares = corners[(corners >= 0).all(axis=-1)]  # those with all four vertices
    faces = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    # colour of each vertex, looked up once per plane
    ids, id_index = np.unique(plane, return_inverse=True)
    rgb = np.array([COLORS[_terrain_name(estimate.terrain_of(int(i)))] for i in ids], np.uint8)[id_index]
    surface = trimesh.Trimesh(vertices=points, faces=faces, vertex_colors=rgb, process=False)
    surface.remove_unreferenced_vertices()
    surface.vertex_normals  # noqa: B018  (computed here, and so written)
    return surface


def _terrain_name(terrain: Terrain | None) -> str:
    """Name of a kind of terrain in files, such as `stairs`; `none` without a terrain."""
    return "none" if terrain is None else type(terrain).__name__.lower()


def _plane_fields(plane: Plane, terrain: Terrain | None) -> dict[str, object]:
    """A plane as plain values for the JSON file."""
    return {
        "id": plane.id,
        "terrain": _terrain_name(terrain),
        "centre_m": _to_list(plane.centre),
        "normal": _to_list(plane.normal),
        "area_m2": plane.area_m2,
        "slope_deg": math.degrees(plane.slope),
        "slope_sd_deg": math.degrees(plane.slope_sd),
        "height_sd_m": math.sqrt(plane.covariance[0, 0]),  # 0 is the height
        "votes": plane.votes,
    }


def _terrain_fields(terrain: Terrain) -> dict[str, object]:
    """Stairs, a ramp or level ground as plain values for the JSON file."""
    if isinstance(terrain, Stairs):
        sd = np.sqrt(np.diag(terrain.covariance))  # 0 riser, 1 tread, 3 start; the rest is not written
        return {
            "type": "stairs",
            "id": terrain.id,
            "planes": list(terrain.planes),
            "steps": terrain.steps,
            "riser_m": terrain.riser,
            "riser_sd_m": _finite_or_none(sd[0]),
            "tread_m": _finite_or_none(terrain.tread),
            "tread_sd_m": _finite_or_none(sd[1]),
            "heading_deg": math.degrees(terrain.heading),
            "start_m": terrain.start,
            "start_sd_m": _finite_or_none(sd[3]),
            "base_m": terrain.base,
            "edges_m": _to_list(terrain.edges),
            "risers_m": _to_list(terrain.risers),
            "across_m": _to_list(terrain.across),
        }
    fields: dict[str, object] = {"type": _terrain_name(terrain), "id": terrain.id, "planes": [terrain.plane]}
    if isinstance(terrain, Ramp):
        fields |= {
            "slope_deg": math.degrees(terrain.slope),
            "slope_sd_deg": math.degrees(terrain.slope_sd),
            "heading_deg": math.degrees(terrain.heading),
        }
    return fields


def _finite_or_none(value: float) -> float | None:
    """The number, or None, which JSON can hold, if it is not finite."""
    return float(value) if math.isfinite(value) else None


def _to_list(values: Iterable[float]) -> list[float | None]:
    """Numbers as a list for JSON, with None in place of those that are not finite."""
    return [_finite_or_none(v) for v in values]


def _write_ply(points: Array, kinds: list[str], plane: NDArray[np.int64], file: Path) -> None:
    """Writes points as binary PLY: x, y, z in m, the class's colour, and the plane's id.

    Args:
        points: (N, 3) m.
        kinds: Class of each point, a key of `COLORS`.
        plane: (N,) id of the plane of each point.
        file: The file.
    """
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


class LiveTerrain(LiveOutput):
    """Each new map as one line of JSON in `live`, and the files of the last one.

    Args:
        file: JSON to write, beside which the other files lie; None only gives rows.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file

    def add(self, estimate: object) -> str | None:
        """A new map as one line of JSON; None without one."""
        if not isinstance(estimate, TerrainEstimate):
            return None
        return json.dumps(terrain_document(estimate), allow_nan=False)

    def finish(self, estimator: AnyEstimator) -> dict[Path, int]:
        """Writes the files of the last map; returns the number of planes for each."""
        if self._file is None:
            return {}
        terrain_map: Any = estimator
        files, last = write_terrain(terrain_map, self._file), terrain_map.estimate
        return {file: len(last.planes) if last else 0 for file in files}
