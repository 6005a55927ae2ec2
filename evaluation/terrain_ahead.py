"""Evaluates terrain maps and mode prediction on a whole recording, with poses from an odometry.

The terrain map and, with insoles, the mode prediction receive the odometry's poses as they would on the walker. Their
output is aligned with the truth at each instant, so that drift of the poses counts only as an error of the odometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.batch.processes import open_pool
from stridetwin.estimators import registry
from stridetwin.estimators.base import MAP, MODES, PATH, Options, Progress
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.estimators.terrain_map import Plane, Stairs, TerrainEstimate, TerrainMap
from stridetwin.evaluation.alignment import MovingAlignment, YawAlignment
from stridetwin.evaluation.evaluate import Estimate, true_path
from stridetwin.evaluation.map_scores import MapScorer, MapScores, map_figures
from stridetwin.evaluation.mode_scores import ModeScores, mode_figures, score_modes
from stridetwin.evaluation.path_scores import Scores
from stridetwin.evaluation.truth import FOOTPRINTS, TruePath, along_way, true_footprints
from stridetwin.pipeline.run import Found, all_paths, fed, merged
from stridetwin.pipeline.terrain_files import KINDS, GroundGrid, kinds_at
from stridetwin.scenarios.metadata import terrain_layout
from stridetwin.sim.world.route import Layout
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Depth, Footprint, Image
from stridetwin.streams.trajectory import Trajectory

HALF_WIDTH_M, CELL_M = 1.0, 0.04
"""Half width of the stored ground along the route, and its cell size."""
_SOLE_M = 0.27
_BEHIND_M, _AHEAD_M = 0.2, 2.5
_STEPPED_M = 1.2
"""An edge is stored when it is at most this far ahead."""
_SAME_EDGE_M = 0.1
_BESIDE_M, _ACROSS = 0.3, 0.7
"""An edge that begins farther beside the route, or lies more along than across it, does not belong to the route."""
_WINDOW_M, _SHOWN_M = 3.0, 0.1
_LEAST_PLANE_M2 = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """The ground around the walker at one instant, in the true world.

    Attributes:
        t_ns: Its time.
        points: (N, 3) m.
        kinds: (N,) numbers of `KINDS`.
        planes: Outline of each plane, (5, 3) m, and its number of `KINDS`.
        edges: Ends of each edge of a flight, (2, 3) m.
    """

    t_ns: int
    points: NDArray[np.float32]
    kinds: NDArray[np.uint8]
    planes: list[tuple[Array, int]]
    edges: list[Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenWay:
    """The ground along the unrolled route, as it was last mapped before the walker stood on it.

    Attributes:
        s: (S,) m along the route, centres of the cells.
        left: (L,) m to the left of it.
        height: (S, L) m in the true world, NaN where nothing was seen.
        kind: (S, L) numbers of `KINDS`.
        edges: (E, 3) m: position along the route, and both ends to the left, of each edge.
    """

    s: Array
    left: Array
    height: Array
    kind: NDArray[np.uint8]
    edges: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Ahead:
    """Maps and mode predictions on one recording.

    Attributes:
        estimates: Predictions of the coming steps, in time order; empty without insoles.
        modes: Their scores; None without insoles.
        ground: Scores of the map.
        terrain_map: The map at the end.
        seen: The ground along the route.
        snapshots: Each half second.
        alignment: Alignment of the estimators' world with the true one.
        layout: The true terrain.
        footprints: The true footprints.
        path: (N, 3) m, true path of the camera.
        scores: By estimator.
        predicted: Predictions of every mode estimator; `estimates` are those of the first.
        maps: Every map at the end; `terrain_map` is the first.
    """

    estimates: list[ModeEstimate]
    modes: ModeScores | None
    ground: MapScores
    terrain_map: TerrainMap
    seen: SeenWay
    snapshots: list[Snapshot]
    alignment: MovingAlignment
    layout: Layout
    footprints: list[Footprint]
    path: Array
    scores: dict[str, Scores]
    predicted: Mapping[str, list[ModeEstimate]] = field(default_factory=dict)
    maps: Mapping[str, TerrainMap] = field(default_factory=dict)


def all_estimates(
    recording: Recording, progress: Progress, backend: str = "", only: Container[str] | None = None
) -> tuple[list[Estimate], Ahead | None]:
    """The path of every estimator that the recording feeds, and the result of `look_ahead` if an odometry is available.

    The paths of other estimators with cameras are computed in a parallel process, because they take as long.

    Args:
        recording: The recording.
        progress: Receives the stage and its progress (0-1).
        backend: Of the terrain map, see `Options.backend`.
        only: Names of the estimators to run, such as `score_needs.estimators_of`; None runs all.
    """
    with ExitStack() as stack:
        others: Callable[[], list[Estimate]] = partial(all_paths, recording, leads=False, only=only)
        if recording.is_mcap and two_see(recording, only):
            pool = stack.enter_context(open_pool(1))
            others = pool.submit(_others, recording.path, recording.lenient, only).result
        leading = all_paths(recording, leads=True, only=only)
        odometry = odometry_of(recording, leading) if is_map_or_modes_asked(only) else None
        ahead = look_ahead(recording, odometry, progress, backend, only) if odometry is not None else None
        return others() + leading, ahead


def _others(path: Path, lenient: bool, only: Container[str] | None) -> list[Estimate]:
    return all_paths(Recording(path, lenient), leads=False, only=only)


def is_map_or_modes_asked(only: Container[str] | None) -> bool:
    """Whether a map or mode estimator is among the estimators to run; None runs all."""
    return only is None or any(name in only for kind in (MAP, MODES) for name in registry.estimators(kind))


def two_see(recording: Recording, only: Container[str] | None = None) -> bool:
    """Whether the recording feeds images to the odometry and to another path estimator of those to run."""
    seeing = set()
    for name, found in registry.estimators(PATH).items():
        if only is not None and name not in only:
            continue
        for options in fed(found, recording):
            streams = found.streams(recording.rig, options) if recording.has_rig else ()
            if any(s.kind is Image and s.topic in recording.topics for s in streams):
                seeing.add(found.declaration.leads)
    return len(seeing) == 2


def odometry_of(recording: Recording, made: Iterable[Estimate]) -> Estimate | None:
    """The path estimate that supplies poses for map and mode prediction; None if there is none.

    They need depth on the body of the odometry's IMU; scoring needs true footprints, ground and path of the IMU.
    """
    odometry = next((e for e in made if e.leads), None)
    if odometry is None or FOOTPRINTS not in recording.topics or terrain_layout(recording.metadata) is None:
        return None
    body = recording.rig.imu(f"/{odometry.frame}").mount.body
    camera = next((c for c in recording.rig.cameras.values() if c.depth_topic), None)
    there = camera is not None and camera.depth_topic in recording.topics and camera.mount.body == body
    there = there and f"/truth/{odometry.frame}/odometry" in recording.topics
    usable = len(odometry.path) > 1 and (odometry.healthy is None or bool(odometry.healthy.any()))
    return odometry if there and usable else None


class _Watch:
    """Scores one map during the walk, and stores what a report shows."""

    def __init__(self, ground: TerrainMap, layout: Layout, footprints: list[Footprint], here: Array) -> None:
        places = along_way([f.p_foot_in_world for f in footprints], layout)
        self.ground, self._layout, self._here = ground, layout, here
        self.scorer = MapScorer(layout, np.column_stack([[f.t_ns for f in footprints], places]))
        self.way = _Unrolled(layout, float(here.min()) - 0.5, float(max(here.max(), places.max())) + 1.0)
        self.snapshots: list[Snapshot] = []

    def look(self, t_ns: int, at: int, alignment: YawAlignment) -> None:
        """Samples the map after the depth image of `t_ns`; the walker is at the pose `at` of the path."""
        ground, here = self.ground, float(self._here[at])
        if (
            ground.estimate is None
            or ground.estimate.t_ns != t_ns
            or not self.scorer.look(t_ns, ground, alignment, here)
        ):
            return
        grid = GroundGrid.of(ground)
        heading = float(self._layout.way.heading(here)) - alignment.yaw
        self.way.look(grid, ground.estimate, alignment, here)
        self.snapshots.append(_snapshot(grid, ground.estimate, alignment, heading))


def _led_by(
    recording: Recording, odometry: Estimate, backend: str, only: Container[str] | None
) -> tuple[dict[str, Any], dict[str, TerrainMap]]:
    """Mode estimators, then maps that none of these contains, with poses from an odometry; and all maps, by name."""

    def with_backend(found: Found, options: Options) -> Options:
        return replace(options, backend=backend) if backend in found.declaration.backends else options

    def at_work(kind: str, but: Container[type[Any]] = ()) -> dict[str, Any]:
        return {
            name: found(recording.rig, options=with_backend(found, replace(options, poses_of=odometry.frame)))
            for name, found in registry.estimators(kind).items()
            if found not in but and (only is None or name in only)
            for options in fed(found, recording)
        }

    predictors = at_work(MODES)
    built = {type(p.ground): p.ground for p in predictors.values() if hasattr(p, "ground")}
    alone = at_work(MAP, but=built)
    maps = {name: built.get(found, alone.get(name)) for name, found in registry.estimators(MAP).items()}
    return predictors | alone, {name: terrain_map for name, terrain_map in maps.items() if terrain_map is not None}


def look_ahead(
    recording: Recording, odometry: Estimate, progress: Progress | None = None, backend: str = "",
    only: Container[str] | None = None,
) -> Ahead:  # fmt: skip
    """Runs the map and mode estimators that a recording feeds, with the poses of `odometry_of`.

    Args:
        recording: The recording.
        odometry: The poses.
        progress: Receives the stage and its progress (0-1).
        backend: Of the terrain map, see `Options.backend`.
        only: Names of the estimators to run, at least one of these; None runs all.
    """
    layout = terrain_layout(recording.metadata)
    assert layout is not None
    led, maps = _led_by(recording, odometry, backend, only)
    truth = true_path(recording, odometry.frame)
    poses = _trusted(odometry, truth)
    true = truth.at(poses.t_ns)
    alignment = MovingAlignment(poses, true)
    here = layout.way.project(true.p_frame_in_world[:, :2])
    footprints = true_footprints(recording)
    watches = {name: _Watch(terrain_map, layout, footprints, here) for name, terrain_map in maps.items()}

    predicted: dict[str, list[ModeEstimate]] = {name: [] for name in led if name not in maps}
    streams = [s for e in led.values() for s in e.streams(recording.rig, Options()) if s.topic in recording.topics]
    topics = list(dict.fromkeys(s.topic for s in streams))
    for sample in merged(poses, recording, topics, odometry.camera):
        for name, estimator in led.items():
            estimate = estimator.update(sample)
            if estimate is not None and name in predicted:
                predicted[name].append(estimate)
        if not isinstance(sample, Depth):
            continue
        if progress is not None:
            progress("terrain ahead", float(np.mean(poses.t_ns <= sample.t_ns)))
        at = int(np.searchsorted(poses.t_ns, sample.t_ns, side="right")) - 1
        if at >= 0:
            for watch in watches.values():
                watch.look(sample.t_ns, at, alignment.at(sample.t_ns))

    shoe_m = float(recording.metadata.get("shoe_length_m", _SOLE_M))
    modes = {name: score_modes(footprints, e, alignment, layout, shoe_m) for name, e in predicted.items()}
    grounds = {name: watch.scorer.scores() for name, watch in watches.items()}
    scores = {name: map_figures(ground) for name, ground in grounds.items()}
    scores |= {name: mode_scores(of_steps) for name, of_steps in modes.items()}
    first = next(iter(maps))
    return Ahead(
        estimates=next(iter(predicted.values()), []), modes=next(iter(modes.values()), None), ground=grounds[first],
        terrain_map=maps[first], seen=watches[first].way.seen(), snapshots=watches[first].snapshots,
        alignment=alignment, layout=layout, footprints=footprints, path=true.p_frame_in_world, scores=scores,
        predicted=predicted, maps=maps,
    )  # fmt: skip


def mode_scores(modes: ModeScores) -> Scores:
    """The scores of one walk's steps; undefined scores are left out.

    Returns:
        `accuracy_pct`, `strict_accuracy_pct`, `straddling_pct`, `transition_accuracy_pct`, `changes_found_pct`;
        `lead_median_s`, `lead_p5_s`, `transition_lead_median_s`; `footprint_forward_rmse_m`,
        `footprint_left_rmse_m`; `riser_rmse_mm`, `tread_rmse_mm`, `slope_rmse_deg`; `calibration_error`; `steps`,
        `transitions`.
    """
    figures = mode_figures([modes])
    flat = {
        name: figures[name]
        for name in (
            "accuracy_pct", "strict_accuracy_pct", "straddling_pct", "transition_accuracy_pct", "changes_found_pct",
            "riser_rmse_mm", "tread_rmse_mm", "slope_rmse_deg", "calibration_error", "steps", "transitions",
        )
    } | {
        "lead_median_s": figures["lead_time_s"]["median"],
        "lead_p5_s": figures["lead_time_s"]["p5"],
        "transition_lead_median_s": figures["transition_lead_time_s"]["median"],
        "footprint_forward_rmse_m": figures["footprint_rmse_m"]["forward"],
        "footprint_left_rmse_m": figures["footprint_rmse_m"]["left"],
    }  # fmt: skip
    return {name: float(value) for name, value in flat.items() if value is not None}


def _trusted(odometry: Estimate, truth: TruePath) -> Trajectory:
    """The odometry's path where it reports itself healthy and the truth is known."""
    path = odometry.path
    keep = (path.t_ns >= truth.t_ns[0]) & (path.t_ns <= truth.t_ns[-1])
    if odometry.healthy is not None:
        keep &= odometry.healthy
    return path[keep]


class _Unrolled:
    """The ground along a route, filled during the walk."""

    def __init__(self, layout: Layout, s0: float, s1: float) -> None:
        self._way, self._profile = layout.way, layout.profile
        self._s = np.arange(s0, s1, CELL_M) + CELL_M / 2
        self._left = np.arange(-HALF_WIDTH_M, HALF_WIDTH_M - 1e-9, CELL_M) + CELL_M / 2
        self._height = np.full((len(self._s), len(self._left)), np.nan)
        self._kind = np.full(self._height.shape, KINDS.index("none"), np.uint8)
        self._edges: list[tuple[float, float, float]] = []

    def look(self, grid: GroundGrid, estimate: TerrainEstimate, alignment: YawAlignment, here: float) -> None:
        """Replaces the stored ground near the walker by the current estimate."""
        some = np.flatnonzero((self._s > here - _BEHIND_M) & (self._s < here + _AHEAD_M))
        s, left = np.meshgrid(self._s[some], self._left, indexing="ij")
        height, plane = grid.at(alignment.to_estimated(self._way.point(s, left)))
        heading = float(self._way.heading(here + 0.5 * _AHEAD_M)) - alignment.yaw
        kind = kinds_at(estimate, plane, heading)
        known = np.isfinite(height)
        rows, columns = np.nonzero(known)
        self._height[some[rows], columns] = height[known] - alignment.estimated[2] + alignment.true[2]
        self._kind[some[rows], columns] = kind[known]
        for flight in estimate.stairs:
            for a, b in _edge_lines(flight):
                self._keep_edge(alignment.to_true(a), alignment.to_true(b), here)

    def _keep_edge(self, a: Array, b: Array, here: float) -> None:
        """Stores an edge ahead of the walker and replaces its earlier estimate."""
        around = np.arange(here, here + _STEPPED_M, 0.02)
        way, heading = self._way.point(around), self._way.heading(around)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        off = np.abs(_beside(way, a, b))
        k = int(off.argmin())
        if off[k] > 0.02:
            return
        low, high = sorted(float((end[:2] - way[k]) @ left[k]) for end in (a, b))
        across = float(abs((b - a)[:2] @ left[k])) / max(float(np.linalg.norm((b - a)[:2])), 1e-9)
        if across < _ACROSS or low > _BESIDE_M or high < -_BESIDE_M:
            return
        forward = np.array([math.cos(heading[k]), math.sin(heading[k])])
        middle = a[:2] + (b - a)[:2] * float(
            np.clip((way[k] - a[:2]) @ (b - a)[:2] / ((b - a)[:2] @ (b - a)[:2]), 0, 1)
        )
        s = float(around[k]) + float((middle - way[k]) @ forward)
        self._edges = [e for e in self._edges if abs(e[0] - s) > _SAME_EDGE_M]
        self._edges.append((s, low, high))

    def seen(self) -> SeenWay:
        """The stored ground."""
        edges = np.array(sorted(self._edges), float).reshape(-1, 3)
        return SeenWay(s=self._s, left=self._left, height=self._height, kind=self._kind, edges=edges)


def _beside(points: Array, a: Array, b: Array) -> Array:
    """(N,) m, distances of (N, 2) points from the line through a and b, in the horizontal plane."""
    along = (b - a)[:2] / np.linalg.norm((b - a)[:2])
    offset = points - a[:2]
    return np.asarray(offset[:, 0] * along[1] - offset[:, 1] * along[0])


def _edge_lines(flight: Stairs) -> list[Array]:
    """Ends of each detected edge, (2, 3) m in the map's world, at the height of the tread above it."""
    up = flight.up
    aside = np.array([-up[1], up[0]])
    lines = []
    for k, s in enumerate(flight.edges):
        if math.isfinite(s):
            z = flight.base + (k + 1) * flight.riser
            lines.append(np.array([[*(s * up + reach * aside), z] for reach in flight.across]))
    return lines


def _snapshot(grid: GroundGrid, estimate: TerrainEstimate, alignment: YawAlignment, heading: float) -> Snapshot:
    points, plane = grid.points()
    eye = estimate.p_camera_in_world
    some = np.flatnonzero(np.linalg.norm(points[:, :2] - eye[:2], axis=1) < _WINDOW_M)
    i, j = np.floor((points[some, :2] - eye[:2]) / _SHOWN_M).astype(np.int64).T
    some = some[np.unique(i * 4096 + j, return_index=True)[1]]
    near = [
        p for p in estimate.planes.values()
        if p.area_m2 > _LEAST_PLANE_M2 and np.linalg.norm(p.centre[:2] - eye[:2]) < _WINDOW_M
    ]  # fmt: skip
    kinds = kinds_at(estimate, np.array([p.id for p in near], np.int64), heading)
    return Snapshot(
        t_ns=estimate.t_ns, points=alignment.to_true(points[some]).astype(np.float32),
        kinds=kinds_at(estimate, plane[some], heading),
        planes=[(alignment.to_true(_outline(p)), int(kind)) for p, kind in zip(near, kinds)],
        edges=[alignment.to_true(line) for flight in estimate.stairs for line in _edge_lines(flight)],
    )  # fmt: skip


def _outline(plane: Plane) -> Array:
    """(5, 3) m, the rectangle in the plane that its points would fill if evenly distributed."""
    variances, axes = np.linalg.eigh(plane.spread)
    half = np.sqrt(3.0 * np.maximum(variances, 0.0))
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    xy = plane.centre[:2] + corners @ axes.T
    return np.column_stack([xy, plane.height(xy)])
