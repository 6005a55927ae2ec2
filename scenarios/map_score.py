"""The terrain map beside the true terrain: how far off its surface lies, what is missing, and the changes ahead."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from stridetwin.estimators.terrain_map import Profile, TerrainMap
from stridetwin.scenarios.flights import edges, flights
from stridetwin.scenarios.terrain_files import depth_camera, given_poses
from stridetwin.sim.route import Layout, Strip
from stridetwin.sim.solids import Solid, corners
from stridetwin.sim.terrain import Terrain
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array, Depth, Odometry, Sample

LEAD_S = 1.5
"""How long before the foot lands beyond a change it is asked for."""
_HALF_WIDTH_M = 0.5
_NEAR_M, _FAR_M = 0.5, 2.5
_COMPLETE_M = 0.03
_CELL_M = 0.05
_MATCH_M = 0.35
_KNOWN_M = 0.03
"""An edge whose standard deviation is larger is told as not seen."""
_TICK_S = 0.5


@dataclass(frozen=True, kw_only=True)
class TrueChange:
    """Where the ground along the way changes from level to something else.

    Attributes:
        kind: `stairs` or `ramp`.
        s: Arc length of its first edge or knee, m.
        riser: m, down negative; 0 for a ramp.
        tread: m; 0 for a ramp.
        risers: How many.
        slope: rad, down negative; 0 for stairs.
    """

    kind: str
    s: float
    riser: float = 0.0
    tread: float = 0.0
    risers: int = 0
    slope: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ScoredChange:
    """A change as it was known `LEAD_S` before.

    Attributes:
        true: What there is.
        found: Whether it was known; stairs are known with two edges.
        edge_error: Estimate less truth of where it begins, m, NaN where not found; likewise below.
        riser_error: m.
        tread_error: m.
        slope_error: rad.
        riser_sd: As the map told it, m; likewise below.
        tread_sd: m.
        slope_sd: rad.
    """

    true: TrueChange
    found: bool
    edge_error: float = math.nan
    riser_error: float = math.nan
    tread_error: float = math.nan
    slope_error: float = math.nan
    riser_sd: float = math.nan
    tread_sd: float = math.nan
    slope_sd: float = math.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class MapScores:
    """One walk's map.

    Attributes:
        changes: In order of the way.
        accuracy_m: RMS distance of the map's ground on the way ahead from the true mesh.
        accuracy_p95_m: 95th percentile of it.
        completeness: Share of the ground between 0.5 and 2.5 m ahead that is known within 3 cm.
        edge_errors: (E,) m, every edge known to 3 cm on the way ahead, each half second, estimate less truth along it.
    """

    changes: tuple[ScoredChange, ...]
    accuracy_m: float
    accuracy_p95_m: float
    completeness: float
    edge_errors: Array


@dataclass(frozen=True, kw_only=True)
class Drift:
    """What an odometry does to true poses.

    Attributes:
        share: Error of the position over the way travelled.
        attitude_sd_rad: Standard deviation of roll, pitch and yaw about the truth.
        attitude_s: How long such an error lasts.
    """

    share: float = 0.005
    attitude_sd_rad: float = math.radians(0.1)
    attitude_s: float = 1.0

    def applied(self, poses: Iterable[Odometry], rng: np.random.Generator) -> Iterator[Odometry]:
        """Poses as the odometry would tell them."""
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        turn = rng.normal(size=3) * self.attitude_sd_rad
        off = np.zeros(3)
        last: Odometry | None = None
        for pose in poses:
            if last is not None:
                keep = math.exp(-(pose.t_ns - last.t_ns) * 1e-9 / self.attitude_s)
                turn = keep * turn + math.sqrt(1 - keep**2) * self.attitude_sd_rad * rng.normal(size=3)
                off = off + direction * self.share * np.linalg.norm(pose.p_frame_in_world - last.p_frame_in_world)
            last = pose
            q = Rotation.from_rotvec(turn) * Rotation.from_quat(pose.q_world_frame, scalar_first=True)
            yield Odometry(
                topic=pose.topic, t_ns=pose.t_ns, p_frame_in_world=pose.p_frame_in_world + off,
                q_world_frame=q.as_quat(scalar_first=True), v_frame_in_world=pose.v_frame_in_world,
                angular_rate=pose.angular_rate,
            )  # fmt: skip


def mesh_of(solids: Sequence[Solid]) -> trimesh.Trimesh:
    """The exact terrain as one mesh."""
    parts = [trimesh.convex.convex_hull(corners(solid)) for solid in solids]
    return cast(trimesh.Trimesh, trimesh.util.concatenate(parts))


def distance_to(mesh: trimesh.Trimesh, points: Array) -> Array:
    """(N,) m, of (N, 3) points from the surface of a mesh of a few hundred triangles."""
    triangles = np.asarray(mesh.triangles)
    nearest = np.full(len(points), np.inf)
    for triangle in triangles:
        closest = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(points), 3, 3)), points)
        nearest = np.minimum(nearest, np.linalg.norm(points - closest, axis=1))
    return nearest


def true_changes(profile: Sequence[Strip]) -> list[TrueChange]:
    """Stairs and ramps of a way, in order."""
    found = [
        TrueChange(kind="stairs", s=flight.s, riser=flight.riser, tread=flight.tread, risers=flight.risers)
        for flight in flights(profile)
    ]
    found += [TrueChange(kind="ramp", s=strip.s0, slope=strip.slope) for strip in profile if strip.terrain == "ramp"]
    return sorted(found, key=lambda change: change.s)


def score_recording(
    recording: Recording, terrain: Terrain, drift: Drift, rng: np.random.Generator, mapper: TerrainMap | None = None
) -> MapScores:
    """Walks through a twin's recording with a drifting odometry and scores the map that arises.

    Args:
        recording: With depth, the true path of the camera's IMU and the true footprints.
        terrain: What was walked on; its way is straight.
        drift: Of the odometry.
        rng: What the drift is drawn from.
        mapper: The map; None makes one with its standard parameters.
    """
    camera = depth_camera(recording.rig)
    topic, mount = given_poses(recording, camera)
    poses = recording.block(topic)
    footprints = recording.block("/truth/footprints")
    path = np.column_stack([footprints.t_ns, terrain.layout.way.project(footprints.columns["p_foot_in_world"][:, :2])])
    mapper = mapper or TerrainMap(recording.rig, mount=mount)
    truth = {pose.t_ns: pose for pose in poses}
    told = drift.applied(poses, rng)
    samples: Iterator[Sample] = iter(recording.samples([camera.depth_topic]))
    return score_samples(samples, truth, told, path, terrain, mapper)


def score_samples(
    pictures: Iterable[Sample], truth: dict[int, Odometry], told: Iterator[Odometry], path: Array, terrain: Terrain,
    mapper: TerrainMap,
) -> MapScores:  # fmt: skip
    """As `score_recording`, from its parts.

    Args:
        pictures: Depth in time order.
        truth: True poses by their stamps.
        told: The same poses as the odometry tells them, in order.
        path: (F, 2) times (ns) and arc lengths (m) of the true footprints.
        terrain: What was walked on.
        mapper: The map.
    """
    mesh = mesh_of(terrain.solids)
    asked = [(change, _asked_ns(change, path)) for change in true_changes(terrain.layout.profile)]
    scored: list[ScoredChange] = []
    distances, complete, edge_errors = [], [], []
    tick_ns = 0
    pose = next(told)
    pending: Odometry | None = next(told, None)
    for picture in pictures:
        if not isinstance(picture, Depth):
            continue
        while pending is not None and pending.t_ns <= picture.t_ns:
            mapper.update(pose)
            pose, pending = pending, next(told, None)
        mapper.update(pose)
        estimate = mapper.update(picture)
        if estimate is None:
            continue
        off = pose.p_frame_in_world - truth[pose.t_ns].p_frame_in_world
        begin = float(np.interp(pose.t_ns, *path.T))
        here = float(terrain.layout.way.project(truth[pose.t_ns].p_frame_in_world[None, :2], begin=begin)[0])
        for change, at_ns in asked:
            if picture.t_ns <= at_ns < picture.t_ns + 33_000_000:
                scored.append(_score_change(change, mapper, here, off, terrain.layout))
        if picture.t_ns >= tick_ns:
            tick_ns = picture.t_ns + int(_TICK_S * 1e9)
            distances.append(_distances(mapper, here, off, terrain, mesh))
            complete.append(_completeness(mapper, here, off, terrain))
            edge_errors.append(_edge_errors(mapper, here, off, terrain.layout))
    far = np.concatenate(distances) if distances else np.zeros(0)
    return MapScores(
        changes=tuple(scored),
        accuracy_m=float(np.sqrt(np.mean(far**2))) if len(far) else math.nan,
        accuracy_p95_m=float(np.percentile(far, 95)) if len(far) else math.nan,
        completeness=float(np.mean(complete)) if complete else math.nan,
        edge_errors=np.concatenate(edge_errors) if edge_errors else np.zeros(0),
    )


def _asked_ns(change: TrueChange, path: Array) -> float:
    """When the change is asked for: `LEAD_S` before the first foot lands beyond it."""
    beyond = path[path[:, 1] > change.s]
    return float(beyond[0, 0]) - LEAD_S * 1e9 if len(beyond) else math.inf


def _ahead(mapper: TerrainMap, here: float, off: Array, layout: Layout) -> Profile:
    """The map's profile along the way, as if the walker had not drifted."""
    heading = float(layout.way.heading(here))
    return mapper.profile(layout.way.point(here) + off[:2], heading)


def _score_change(change: TrueChange, mapper: TerrainMap, here: float, off: Array, layout: Layout) -> ScoredChange:
    estimate = mapper.estimate
    heading = float(layout.way.heading(change.s))
    forward = np.array([math.cos(heading), math.sin(heading)])
    place = layout.way.point(change.s) + off[:2]
    if estimate is None:
        return ScoredChange(true=change, found=False)
    if change.kind == "ramp":
        near = [c for c in _ahead(mapper, here, off, layout).changes if c.kind == "knee"]
        edge = min((here + c.s - change.s for c in near), key=abs, default=math.nan)
        at = mapper.ground(place + 0.4 * forward) or mapper.ground(place + 0.8 * forward)
        if at is None or at[0].slope < math.radians(5):
            return ScoredChange(true=change, found=False, edge_error=edge)
        slope = math.atan(float(at[0].gradient @ forward))
        return ScoredChange(true=change, found=True, edge_error=edge, slope_error=slope - change.slope,
                            slope_sd=at[0].slope_sd)  # fmt: skip
    for flight in sorted(estimate.stairs, key=lambda f: -f.steps):
        sign = math.copysign(1.0, change.riser)
        if float(flight.up @ forward) * sign < 0.9:
            continue
        own = flight.edges * sign - float(place @ forward)
        first = min(own[np.isfinite(own)], default=math.nan)
        if abs(first) < _MATCH_M and flight.steps >= 2:
            return ScoredChange(
                true=change, found=True, edge_error=float(first), riser_error=flight.riser - abs(change.riser),
                tread_error=flight.tread - change.tread, riser_sd=math.sqrt(flight.covariance[0, 0]),
                tread_sd=math.sqrt(flight.covariance[1, 1]),
            )  # fmt: skip
    return ScoredChange(true=change, found=False)


def _distances(mapper: TerrainMap, here: float, off: Array, terrain: Terrain, mesh: trimesh.Trimesh) -> Array:
    """Distances of the map's ground ahead from the mesh, or from the ground all around."""
    layout = terrain.layout
    points, plane = mapper.surface_points()
    points = points[plane >= 0] - off
    heading = float(layout.way.heading(here))
    forward, left = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])
    offset = points[:, :2] - layout.way.point(here)
    along, aside = offset @ forward, offset @ left
    there = (along > _NEAR_M) & (along < _FAR_M) & (np.abs(aside) < _HALF_WIDTH_M)
    points = points[there][::5]
    return np.minimum(distance_to(mesh, points), np.abs(points[:, 2] - terrain.ground_m))


def _completeness(mapper: TerrainMap, here: float, off: Array, terrain: Terrain) -> float:
    """Share of the ground ahead whose height the map knows."""
    s, aside = np.meshgrid(np.arange(here + _NEAR_M, here + _FAR_M, _CELL_M),
                           np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M + 1e-9, _CELL_M))  # fmt: skip
    xy = terrain.layout.way.point(s.ravel(), aside.ravel())
    told = mapper.heights(xy + off[:2]) - off[2]
    return float(np.mean(np.abs(told - terrain.height(xy)) < _COMPLETE_M))


def _edge_errors(mapper: TerrainMap, here: float, off: Array, layout: Layout) -> Array:
    """Errors of the edges that the profile ahead tells, m, each against the true edge next to it."""
    jumps = np.array([s for s, _, _ in edges(layout.profile)])
    told = np.array(
        [here + c.s for c in _ahead(mapper, here, off, layout).changes if c.kind == "edge" and c.sd < _KNOWN_M]
    )
    if not len(jumps) or not len(told):
        return np.zeros(0)
    errors = told - jumps[np.argmin(np.abs(told[:, None] - jumps), axis=1)]
    return np.asarray(errors[np.abs(errors) < 0.14])
