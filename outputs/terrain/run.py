"""Keeps the terrain map that an estimator gives for a recording, and samples it against the truth on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.terrain_map import TerrainMap
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import Collector, Output
from stridetwin.outputs.coverage import compute_covered_share
from stridetwin.outputs.terrain.grid import GroundGrid
from stridetwin.outputs.terrain.mapped_route import MappedRoute, RouteMapper
from stridetwin.outputs.terrain.scores import MapScorer, MapScores
from stridetwin.outputs.terrain.snapshots import Snapshot, take_snapshot
from stridetwin.outputs.truth import walking_span_ns
from stridetwin.streams.samples import Depth, Sample


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledMap:
    """What was sampled of a map during a walk whose truth is known; a map changes, so its past cannot be read later.

    Attributes:
        walk: The walk.
        scores: Scores of the map.
        route: The ground along the route, as it was mapped before the walker stood on it.
        snapshots: The ground around the walker each half second.
        coverage: Share of the time from the first footprint to the last with maps, 0-1.
    """

    walk: AlignedWalk
    scores: MapScores
    route: MappedRoute
    snapshots: list[Snapshot]
    coverage: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class MapRun:
    """The result of a map on a recording.

    Attributes:
        terrain_map: The map at the end.
        sampled: What was sampled of it on the way; None without a truth.
    """

    terrain_map: TerrainMap
    sampled: SampledMap | None = None


class MapCollector(Collector[MapRun]):
    """Keeps a map; samples it after each depth image if the truth of the walk is known.

    Args:
        name: Name of the output.
        terrain_map: The map, at work.
        walk: The walk beside the truth; None if it is not known.
    """

    def __init__(self, name: str, terrain_map: TerrainMap, walk: AlignedWalk | None) -> None:
        self._name, self._map = name, terrain_map
        self._sampler = None if walk is None else _MapSampler(terrain_map, walk)

    def add(self, sample: Sample, estimate: object) -> None:
        """Samples the map after a depth image; it reads the map itself, not `estimate`."""
        if self._sampler is not None and isinstance(sample, Depth):
            self._sampler.sample(sample.t_ns)

    def outputs(self) -> list[Output[MapRun]]:
        """The only output: the map at the end, with its samples."""
        sampled = None if self._sampler is None else self._sampler.result()
        return [Output(name=self._name, estimates=MapRun(terrain_map=self._map, sampled=sampled))]


class _MapSampler:
    """Samples a map along a walk with known truth: scores, the ground along the route, and snapshots."""

    def __init__(self, terrain_map: TerrainMap, walk: AlignedWalk) -> None:
        self._map, self._walk = terrain_map, walk
        # (F, 2) time, ns, and place, m, of each footprint
        path = np.column_stack([[f.t_ns for f in walk.footprints], walk.foot_places_m])
        self._scorer = MapScorer(walk.layout, path)
        last_m = float(max(walk.place_m.max(), walk.foot_places_m.max()))
        # the stored ground reaches a little beyond the walk at both ends
        self._route = RouteMapper(walk.layout, float(walk.place_m.min()) - 0.5, last_m + 1.0)
        self._snapshots: list[Snapshot] = []
        self._mapped_ns: list[int] = []  # times of the depth images after which there was a map

    def sample(self, t_ns: int) -> None:
        """Compares the map with the truth, if the depth image of `t_ns` has just changed it and the pose is known."""
        estimate, place_m = self._map.estimate, self._walk.place_at(t_ns)
        if estimate is None or estimate.t_ns != t_ns or place_m is None:
            return
        self._mapped_ns.append(t_ns)
        alignment = self._walk.alignment.at(t_ns)
        if not self._scorer.sample(t_ns, self._map, alignment, place_m):  # the whole ground only each half second
            return
        grid = GroundGrid.of(self._map)
        heading = float(self._walk.layout.way.heading(place_m)) - alignment.yaw
        self._route.add(grid, estimate, alignment, place_m)
        self._snapshots.append(take_snapshot(grid, estimate, alignment, heading))

    def result(self) -> SampledMap:
        """Everything that has been sampled so far."""
        return SampledMap(
            walk=self._walk,
            scores=self._scorer.scores(),
            route=self._route.result(),
            snapshots=self._snapshots,
            coverage=compute_covered_share(
                np.array(self._mapped_ns, np.int64), *walking_span_ns(self._walk.footprints)
            ),
        )
