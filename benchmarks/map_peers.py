"""The terrain map beside Open3D's on the same walks of the twin: accuracy, coverage and computing time.

`python -m benchmarks.map_peers [--walks SCENARIO ...] [--seed 900] [--mount head] [--json]`. Open3D's voxel grid
(`VoxelBlockGrid`) gets the same depth with the same true poses and voxels of the same size as our map. Every half
second, its points and the planar patches that Open3D detects in them are evaluated in the same way as those of our map,
and of the published one (`--backend open3d` of `terrain_map`):

- `off_rms_mm`, `off_p95_mm`: distance of the points on the path ahead (0.5 to 2.5 m) from the true ground.
- `known_pct`: places, every 5 cm of that ground, with a point within 3 cm.
- `surfaces_pct`: levels, treads and ramps ahead that have a plane of their own, within 1 cm at their middle and within
  3 degrees; a plane across two treads counts for neither.
- `image_ms`, `look_ms`: CPU time per image, and per query of points and planes. Our map detects planes in every
  second image, which counts as `image_ms`; the query only reads them.
"""

from __future__ import annotations

import math
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

from benchmarks.command import answer, command
from stridetwin.estimators.backends import OPEN3D
from stridetwin.estimators.base import Options
from stridetwin.estimators.terrain_map import TerrainMap, TerrainMapParameters
from stridetwin.estimators.terrain_map.depth_camera import camera_in_frame, depth_calibration
from stridetwin.outputs.chosen_poses import find_pose_topic
from stridetwin.outputs.terrain.scores import (
    FAR_M,
    NEAR_M,
    cells_ahead,
    distance_to,
    mesh_of,
    points_ahead,
    true_heights,
)
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Depth, Odometry
from stridetwin.streams.terrain_truth import Layout, Strip, terrain_layout

WALKS = ("zhao_stair_20cm", "zhao_ramp_15_8")
_LOOK_NS = 500_000_000
_NEAR_M = 0.03
_SAME_M, _SAME_RAD = 0.01, math.radians(3.0)
_MARGIN_M = 0.03
_TALL_M = 0.05
_EVERY = 5


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A plane at a place: its id, height there (m) and gradient (2,)."""

    number: int
    height: float
    gradient: Array


class Map(Protocol):
    """A map under test."""

    def take(self, sample: Odometry | Depth) -> None:
        """Takes a pose, or a depth image at the time of the last pose."""

    def look(self) -> tuple[Array, Callable[[Array], Piece | None]]:
        """Ground points (N, 3) m, and a function that returns the plane at a (2,) place."""


class Ours:
    """`TerrainMap`."""

    def __init__(self, recording: Recording, camera: CameraCalibration, backend: str = "") -> None:
        options = Options(poses_of=find_pose_topic(recording, camera)[1], backend=backend)
        self._map = TerrainMap(recording.rig, options=options)

    def take(self, sample: Odometry | Depth) -> None:
        """As `Map`."""
        self._map.update(sample)

    def look(self) -> tuple[Array, Callable[[Array], Piece | None]]:
        """As `Map`."""
        points, plane = self._map.surface_points()
        return points[plane >= 0], self._piece

    def _piece(self, place: Array) -> Piece | None:
        there = self._map.ground(place)
        if there is None:
            return None
        plane, _ = there
        return Piece(number=plane.id, height=float(plane.height(place)), gradient=plane.gradient)


class Open3d:
    """Open3D's `VoxelBlockGrid`, and `detect_planar_patches` on its points."""

    def __init__(self, recording: Recording, camera: CameraCalibration) -> None:
        self._T_frame_camera = camera_in_frame(recording.rig, camera, find_pose_topic(recording, camera)[1])
        fx, fy, cx, cy = camera.intrinsics
        self._K = o3d.core.Tensor([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]], o3d.core.float64)
        p = TerrainMapParameters()
        self._far_m, self._band = p.max_range_m, p.truncation_m / p.voxel_size_m
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1,), (1,)), p.voxel_size_m, 16, 20_000
        )
        self._T_world_camera = np.eye(4)

    def take(self, sample: Odometry | Depth) -> None:
        """As `Map`."""
        if isinstance(sample, Odometry):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = from_quaternion(sample.q_world_frame), sample.p_frame_in_world
            self._T_world_camera = T @ self._T_frame_camera
            return
        depth = o3d.t.geometry.Image(np.ascontiguousarray(np.nan_to_num(sample.depth), np.float32))
        extrinsic = o3d.core.Tensor(np.linalg.inv(self._T_world_camera))
        seen = self._grid.compute_unique_block_coordinates(depth, self._K, extrinsic, 1.0, self._far_m, self._band)
        self._grid.integrate(seen, depth, self._K, extrinsic, 1.0, self._far_m, self._band)

    def look(self) -> tuple[Array, Callable[[Array], Piece | None]]:
        """As `Map`."""
        cloud = self._grid.extract_point_cloud(weight_threshold=3.0).to_legacy()
        points = np.asarray(cloud.points)
        near = np.linalg.norm(points[:, :2] - self._T_world_camera[:2, 3], axis=1) < FAR_M + 0.5
        cloud = cloud.select_by_index(np.flatnonzero(near))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.08, max_nn=30))
        boxes = cloud.detect_planar_patches(
            normal_variance_threshold_deg=60,
            coplanarity_deg=75,
            outlier_ratio=0.75,
            min_plane_edge_length=0.1,
            min_num_points=30,
            search_param=o3d.geometry.KDTreeSearchParamKNN(knn=30),
        )
        return np.asarray(cloud.points), lambda place: _piece_of(boxes, place)


MAPS: dict[str, Callable[[Recording, CameraCalibration], Map]] = {
    "ours": Ours,
    "published": partial(Ours, backend=OPEN3D),
    "open3d": Open3d,
}


def _piece_of(boxes: Sequence[Any], place: Array) -> Piece | None:
    """The highest walkable patch at a place."""
    pieces = []
    for i, box in enumerate(boxes):
        R, normal = np.asarray(box.R), np.asarray(box.R)[:, 2]
        if abs(normal[2]) < math.cos(math.radians(40)):
            continue
        gradient = -normal[:2] / normal[2]
        height = float(box.center[2] + (place - box.center[:2]) @ gradient)
        inside = np.abs(R.T @ (np.array([*place, height]) - box.center))
        if (inside[:2] <= np.asarray(box.extent)[:2] / 2 + _MARGIN_M).all():
            pieces.append(Piece(number=i, height=height, gradient=gradient))
    return max(pieces, key=lambda piece: piece.height, default=None)


@dataclass(kw_only=True)
class Tally:
    """Measurements of a map."""

    points: list[Array] = field(default_factory=list)
    known: list[float] = field(default_factory=list)
    surfaces: list[bool] = field(default_factory=list)
    images_s: list[float] = field(default_factory=list)
    looks_s: list[float] = field(default_factory=list)

    def figures(self, layout: Layout) -> dict[str, float]:
        """Figures by the names above."""
        off = distance_to(mesh_of(layout.slabs), np.concatenate(self.points)[::_EVERY])
        return {
            "off_rms_mm": 1e3 * float(np.sqrt(np.mean(off**2))),
            "off_p95_mm": 1e3 * float(np.percentile(off, 95)),
            "known_pct": 100.0 * float(np.mean(self.known)),
            "surfaces_pct": 100.0 * float(np.mean(self.surfaces)),
            "image_ms": 1e3 * float(np.mean(self.images_s)),
            "look_ms": 1e3 * float(np.mean(self.looks_s)),
        }


def walked(recording: Recording, make: Callable[[Recording, CameraCalibration], Map]) -> dict[str, float]:
    """Figures of one map on one walk."""
    camera, layout = depth_calibration(recording.rig), terrain_layout(recording.metadata)
    assert layout is not None
    ground, tally, due_ns, here = make(recording, camera), Tally(), 0, 0.0
    for sample in recording.samples([find_pose_topic(recording, camera)[0], camera.depth_topic]):
        if isinstance(sample, Odometry):
            here = float(layout.way.project(sample.p_frame_in_world[None, :2], begin=here)[0])
        assert isinstance(sample, Odometry | Depth)
        began = time.process_time()
        ground.take(sample)
        if not isinstance(sample, Depth):
            continue
        tally.images_s.append(time.process_time() - began)
        due_ns = due_ns or sample.t_ns + 2 * _LOOK_NS
        if sample.t_ns < due_ns:
            continue
        due_ns = sample.t_ns + _LOOK_NS
        began = time.process_time()
        points, piece_at = ground.look()
        tally.looks_s.append(time.process_time() - began)
        ahead = points_ahead(points, here, layout)
        tally.points.append(ahead)
        tally.known.append(_known(ahead, here, layout))
        tally.surfaces += _surfaces(piece_at, here, layout)
    return tally.figures(layout)


def _known(points: Array, here: float, layout: Layout) -> float:
    """Share of the places ahead that have a point."""
    s, aside = cells_ahead(here, layout)
    places = np.column_stack([layout.way.point(s, aside), true_heights(layout.profile, s, aside)])
    return float(np.mean(cKDTree(points).query(places)[0] < _NEAR_M)) if len(s) else 1.0


def _surfaces(piece_at: Callable[[Array], Piece | None], here: float, layout: Layout) -> list[bool]:
    """For each level, tread and ramp whose middle is ahead, whether it has a plane of its own."""
    low, high = here + NEAR_M, here + FAR_M
    strip_pieces: list[tuple[Strip, Piece | None]] = []
    for strip in layout.profile:
        s0, s1 = max(strip.s0, low), min(strip.s1, high)
        if s1 - s0 > _TALL_M and (strip.s0 >= low or strip.s1 - strip.s0 > 1.0):
            strip_pieces.append((strip, _own(piece_at, strip, (s0 + s1) / 2, layout)))
    numbers = [piece.number for _, piece in strip_pieces if piece is not None]
    return [piece is not None and numbers.count(piece.number) == 1 for _, piece in strip_pieces]


def _own(piece_at: Callable[[Array], Piece | None], strip: Strip, s: float, layout: Layout) -> Piece | None:
    """The plane at the middle of a strip, if its height and slope match the strip's."""
    piece, heading = piece_at(np.asarray(layout.way.point(s))), float(layout.way.heading(s))
    if piece is None or abs(piece.height - strip.height(s, 0.0)) > _SAME_M:
        return None
    forward = np.array([math.cos(heading), math.sin(heading)])
    across = np.array([-forward[1], forward[0]])
    along, aside = math.atan(float(piece.gradient @ forward)), math.atan(float(piece.gradient @ across))
    return piece if max(abs(along - strip.slope), abs(aside)) < _SAME_RAD else None


def measure(arguments: Namespace) -> dict[str, Any]:
    """Both maps on each walk."""
    summary = {}
    for name in arguments.walks:
        config = load_scenario(name).config
        sensors = ("head_imu", "head_camera")
        config = replace(config, physics="kinematic", rig_mount=arguments.mount, sensors=sensors, exo=None)
        with TemporaryDirectory() as folder:
            file = Path(folder) / "walk.mcap"
            record(Twin(config, arguments.seed), file, lambda stage, share: None)
            if not summary:
                walked(Recording(file), Ours)  # compiles
            for peer, make in MAPS.items():
                summary[f"{name} {peer}"] = walked(Recording(file), make)
    return {"seed": arguments.seed, "mount": arguments.mount, "summary": summary}


def show(result: dict[str, Any]) -> None:
    """Prints one line per walk and map."""
    names = list(next(iter(result["summary"].values())))
    print(f"{'':28s}" + "".join(f"{name:>14s}" for name in names))
    for which, figures in result["summary"].items():
        print(f"{which:28s}" + "".join(f"{figures[name]:14.1f}" for name in names))


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("--walks", nargs="+", default=list(WALKS))
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--mount", default="head", choices=("head", "chest"))
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
