"""A recording becomes a walk of a wearer: calibration, coordinates, stances, terrain and grounded feet, in rounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stridetwin.sim.config import Route
from stridetwin.sim.motion.feet import ground_foot, sole_frame
from stridetwin.sim.motion.ground import Ground, RoutePlacement, find_ground, place_route
from stridetwin.sim.motion.ik import (
    PointSet,
    calibrate,
    cutoffs_of,
    initial_coordinates,
    point_errors,
    solve_coordinates,
)
from stridetwin.sim.motion.marker_sets import MarkerPlace, place_markers
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.read import MarkerTable
from stridetwin.sim.motion.rests import FootRest, FootTrack, stances_of
from stridetwin.sim.motion.segments import SegmentMotion, fit_legs, points_of
from stridetwin.sim.motion.skeleton import Skeleton, lengths_of
from stridetwin.sim.people import Person
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

SIDES = ("l", "r")
_GROUNDING_ROUNDS = 2  # of calibration with feet on the ground
_PINNING_ROUNDS = 6
_ROUNDS_FROM_STANDING = 10  # Gauss-Newton steps where nothing but the pelvis is known at the start
_LEVEL = 1e-4  # rise over length of a level
_REST_SD_M = 0.002  # scatter of a sole that rests, in the calibration


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedWalk:
    """A recorded walk as coordinates of a wearer in the world of its route.

    Attributes:
        person: The person, with fitted lengths.
        skeleton: The wearer without exoskeleton.
        dt: Time between two rows, s.
        x: (N, D) coordinates in the world.
        x_unpinned: (N, D) coordinates before the soles were put on the ground; they fit the recording best.
        rests: Stances of both feet in order of time, in the world.
        ground: Heights under them, and the route.
        points: The recorded points, in the world.
        placement: How the laboratory, with z up, lies in the world.
    """

    person: Person
    skeleton: Skeleton
    dt: float
    x: Array
    x_unpinned: Array
    rests: tuple[FootRest, ...]
    ground: Ground
    points: PointSet
    placement: RoutePlacement

    @property
    def duration_s(self) -> float:
        """Length of the walk, s."""
        return (len(self.x) - 1) * self.dt

    @property
    def residuals_m(self) -> dict[str, float]:
        """RMS distance of each marker from its place on the wearer, m."""
        errors = point_errors(self.skeleton, self.points, self.x)
        return dict(zip(self.points.names, np.sqrt(np.nanmean(errors**2, axis=0)).tolist()))


def fit_markers(
    table: MarkerTable,
    person: Person,
    marker_set: str | Mapping[str, MarkerPlace] | None = None,
    route: Route | None = None,
    parameters: MotionParameters | None = None,
) -> FittedWalk:
    """Fits a wearer to recorded markers.

    Args:
        table: Markers in the axes of the laboratory, any of which may point up.
        person: Height, mass and sex; lengths are fitted.
        marker_set: Name of a set of markers or a table of places; None for the set that fits the names.
        route: Terrain, if it is known; None to find it from the rests of the feet.
        parameters: None for the usual ones.

    Raises:
        ConfigError: The markers do not suffice.
    """
    parameters = parameters or MotionParameters()
    places = place_markers(table.source, table.names, marker_set)
    table = replace(table, x=_turn_up(table, places))
    dt = float(table.t[-1] - table.t[0]) / (len(table.t) - 1)
    person = lengths_of(person)
    skeleton = Skeleton.of(person)
    points = PointSet.of_markers(table, places, skeleton, parameters)
    x = initial_coordinates(skeleton, points, table.source)
    x = solve_coordinates(skeleton, points, x, dt, parameters)
    person, points = calibrate(person, points, x, parameters)
    skeleton = Skeleton.of(person)
    x = solve_coordinates(skeleton, points, x, dt, parameters)
    whole = RoutePlacement(turn=0.0, shift=np.zeros(3))
    for _ in range(_GROUNDING_ROUNDS):  # soles that rest show where the markers of the feet are on the shoes
        feet = track_feet(skeleton, x)
        stances = stances_of(feet, skeleton.size.shoe, dt, parameters)
        placement = place_route(stances, x[:, :3])
        whole = whole.then(placement)
        feet, stances = _to_world(placement, feet, stances)
        ground = find_ground(stances, feet, skeleton.size.shoe, parameters)
        lift = RoutePlacement(turn=0.0, shift=np.array([0.0, 0.0, ground.lift_m]))
        placement, whole = placement.then(lift), whole.then(lift)
        rests = _rest_points(skeleton, stances, ground, len(x), _REST_SD_M)
        points = _place_points(points, placement)
        x = _place_coordinates(x, placement)
        person, both = calibrate(person, points.append(rests), x, parameters)
        points = replace(points, places=both.places[: len(points.names)])
        skeleton = Skeleton.of(person)
        x = solve_coordinates(skeleton, points, x, dt, parameters)
    fitted = ground_walk(skeleton, person, points, x, dt, parameters, route)
    return replace(fitted, placement=whole.then(fitted.placement))


def fit_segments(
    motion: SegmentMotion, person: Person, route: Route | None = None, parameters: MotionParameters | None = None
) -> FittedWalk:
    """Fits a wearer to recorded orientations of segments, such as joint angles give.

    Args:
        motion: Orientations.
        person: Height, mass, sex, and lengths that are known.
        route: Terrain, if it is known; None to find it from the rests of the feet.
        parameters: None for the usual ones.

    Raises:
        StrideTwinError: A foot never rests.
    """
    parameters = parameters or MotionParameters()
    motion, person = fit_legs(motion, person, parameters)
    skeleton = Skeleton.of(person)
    points = points_of(motion, skeleton, parameters)
    x = initial_coordinates(skeleton, points, motion.source)
    x = solve_coordinates(skeleton, points, x, motion.dt, parameters, rounds=_ROUNDS_FROM_STANDING)
    return ground_walk(skeleton, person, points, x, motion.dt, parameters, route)


def ground_walk(
    skeleton: Skeleton,
    person: Person,
    points: PointSet,
    x: Array,
    dt: float,
    parameters: MotionParameters,
    route: Route | None = None,
) -> FittedWalk:
    """Puts the feet of a fitted walk on the ground, and the rest of the body after them.

    Args:
        skeleton: The wearer.
        person: The person.
        points: Recorded points, to which the body stays as near as the feet allow.
        x: (N, D) coordinates that fit them.
        dt: Time between two rows, s.
        parameters: Times and scatter.
        route: Terrain, if it is known.
    """
    shoe = skeleton.size.shoe
    feet = track_feet(skeleton, x)
    stances = stances_of(feet, skeleton.size.shoe, dt, parameters)
    placement = place_route(stances, x[:, :3])
    feet, stances = _to_world(placement, feet, stances)
    if route is None:
        ground = find_ground(stances, feet, shoe, parameters)
        lift = RoutePlacement(turn=0.0, shift=np.array([0.0, 0.0, ground.lift_m]))
        feet, stances = _to_world(lift, feet, stances)
        placement = placement.then(lift)
    else:
        ground = _find_given_ground(route, stances, shoe)
    points, x = _place_points(points, placement), _place_coordinates(x, placement)
    terrain = Terrain.from_route(ground.route)
    landed = np.isfinite(ground.heights)
    stances = [s for s, is_down in zip(stances, landed) if is_down]
    ground = replace(ground, heights=ground.heights[landed], slopes=ground.slopes[landed])
    targets: PointSet | None = None
    for k, side in enumerate(SIDES):
        rows = [i for i, s in enumerate(stances) if s.side == side]
        placed = ground_foot(
            feet[k],
            [stances[i] for i in rows],
            ground.heights[rows],
            ground.slopes[rows],
            shoe,
            terrain.height,
            dt,
            parameters,
        )
        soles = _foot_points(skeleton, placed, 1.0 / parameters.foot_sd_m)
        targets = soles if targets is None else targets.append(soles)
    assert targets is not None
    # legs and trunk follow slowly what the feet are corrected: a knee that is nearly straight turns far for some mm
    cutoffs = cutoffs_of(skeleton, parameters.leg_follow_hz, parameters.follow_hz)
    pinned = solve_coordinates(
        skeleton, points, x, dt, parameters, rounds=_PINNING_ROUNDS, targets=targets, follow_hz=cutoffs
    )
    return FittedWalk(
        person=person,
        skeleton=skeleton,
        dt=dt,
        x=pinned,
        x_unpinned=x,
        rests=tuple(stances),
        ground=ground,
        points=points,
        placement=placement,
    )


def _find_given_ground(route: Route, stances: Sequence[FootRest], shoe: Shoe) -> Ground:
    """Heights and slopes of a known terrain under stances; the ground under the middle of a sole bears it."""
    terrain = Terrain.from_route(route)
    p, yaw = np.array([s.p[:2] for s in stances]), np.array([s.yaw for s in stances])
    middle = p + 0.5 * (shoe.heel_back_x + shoe.toe_hinge_x) * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    normal = terrain.normal(middle)
    rise = -normal[:, 0] / normal[:, 2]
    on_ramp = terrain.height(middle) + rise * (p - middle)[:, 0]
    heights = np.where(np.abs(rise) > _LEVEL, on_ramp, terrain.height(p))
    return Ground(route=route, heights=heights, slopes=np.arctan(rise), riser_mm=(), tread_mm=())


def track_feet(skeleton: Skeleton, x: Array) -> list[FootTrack]:
    """Paths of the left and the right foot."""
    poses = skeleton.poses(x)
    return [
        FootTrack(
            side=side,
            p=poses.p[:, skeleton.index(f"foot_{side}")],
            R=poses.R[:, skeleton.index(f"foot_{side}")],
            toe=x[:, skeleton.column(f"toe_extension_{side}")],
        )
        for side in SIDES
    ]


def _turn_up(table: MarkerTable, places: Mapping[str, MarkerPlace]) -> Array:
    """(N, M, 3) the markers with z up: the axis along which the pelvis is above the feet."""
    columns = {name: i for i, name in enumerate(table.names)}
    pelvis = [columns[name] for name, place in places.items() if place.body in ("pelvis", "torso")]
    feet = [columns[name] for name, place in places.items() if place.body.startswith(("foot", "toe"))]
    if not pelvis or not feet:
        raise ConfigError(table.source, "markers", ", ".join(table.names[:8]), "markers on the pelvis and on the feet")
    up = np.nanmedian(table.x[:, pelvis], axis=(0, 1)) - np.nanmedian(table.x[:, feet], axis=(0, 1))
    axis = int(np.argmax(np.abs(up)))
    if axis == 2 and up[2] > 0:
        return table.x
    if axis == 1 and up[1] > 0:  # OpenSim: x ahead, y up
        return np.stack([table.x[..., 0], -table.x[..., 2], table.x[..., 1]], axis=-1)
    if axis == 0 and up[0] > 0:
        return np.stack([table.x[..., 1], table.x[..., 2], table.x[..., 0]], axis=-1)
    raise ConfigError(table.source, "axes", f"{'xyz'[axis]} down", "an axis that points up")


def _to_world(
    placement: RoutePlacement, feet: Sequence[FootTrack], stances: Sequence[FootRest]
) -> tuple[list[FootTrack], list[FootRest]]:
    """Feet and stances in the world of the route."""
    return (
        [FootTrack(side=f.side, p=placement.points(f.p), R=placement.matrix @ f.R, toe=f.toe) for f in feet],
        [replace(s, p=placement.points(s.p), yaw=s.yaw + placement.turn) for s in stances],
    )


def _place_points(points: PointSet, placement: RoutePlacement) -> PointSet:
    """Recorded points in the world of the route."""
    return replace(points, paths=placement.points(points.paths))


def _place_coordinates(x: Array, placement: RoutePlacement) -> Array:
    """(N, D) coordinates in the world of the route."""
    x = x.copy()
    x[:, :3] = placement.points(x[:, :3])
    x[:, 3] += placement.turn
    return x


def _rest_points(skeleton: Skeleton, rests: Sequence[FootRest], ground: Ground, frames: int, sd_m: float) -> PointSet:
    """Points of soles that lie flat: their heights, at the recorded places in the plane.

    Only heights are known of a rest; the weights of the plane are those of a foot that rests where it was recorded.
    """
    targets = None
    for side in SIDES:
        p, R = np.full((frames, 3), np.nan), np.tile(np.eye(3), (frames, 1, 1))
        for stance, height, slope in zip(rests, ground.heights, ground.slopes):
            if stance.side == side and stance.flat is not None and np.isfinite(height):
                rows = slice(*stance.flat)
                p[rows], R[rows] = [*stance.p[:2], height], sole_frame(stance, float(slope))
        track = FootTrack(side=side, p=p, R=R, toe=np.zeros(frames))
        points = _foot_points(skeleton, track, 1.0 / sd_m)
        points = points.append(_hinge_points(skeleton, side, rests, ground, frames, 1.0 / sd_m))
        targets = points if targets is None else targets.append(points)
    assert targets is not None
    return targets


def _hinge_points(
    skeleton: Skeleton, side: str, rests: Sequence[FootRest], ground: Ground, frames: int, weight: float
) -> PointSet:
    """The toe hinge of one foot, whose height is known while the ball rests after the heel has risen."""
    shoe = skeleton.size.shoe
    path = np.full((frames, 1, 3), np.nan)
    for rest, height, slope in zip(rests, ground.heights, ground.slopes):
        if rest.side == side and rest.flat is not None and rest.ball is not None and np.isfinite(height):
            hinge = sole_frame(rest, float(slope)) @ [shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z]
            path[rest.flat[1] : rest.ball[1], 0] = np.array([*rest.p[:2], height]) + hinge
    return PointSet(
        names=(f"hinge_{side}",),
        bodies=np.array([skeleton.index(f"toe_{side}")]),
        places=np.zeros((1, 3)),
        sd_m=np.zeros(1),
        paths=path,
        weights=np.isfinite(path[..., 0]) * weight,
    )


def _foot_points(skeleton: Skeleton, track: FootTrack, weight: float) -> PointSet:
    """Points that fix the pose of a foot and its toes; their paths are NaN where the foot's is."""
    shoe, side = skeleton.size.shoe, track.side
    local = np.array([[0.0, 0.0, 0.0], [shoe.toe_hinge_x, 0.0, 0.0], [0.0, 0.1, 0.0]])
    paths = track.p[:, None] + np.einsum("nij,pj->npi", track.R, local)
    toe_place = np.array([0.05, 0.0, 0.0])
    c, s = np.cos(track.toe), np.sin(track.toe)
    toe = np.stack([shoe.toe_hinge_x + 0.05 * c, np.zeros_like(c), shoe.toe_hinge_z + 0.05 * s], -1)
    toe_path = track.p + np.einsum("nij,nj->ni", track.R, toe)
    paths = np.concatenate([paths, toe_path[:, None]], axis=1)
    known = np.isfinite(paths[..., 0])
    return PointSet(
        names=tuple(f"sole_{side}_{i}" for i in range(4)),
        bodies=np.array([*[skeleton.index(f"foot_{side}")] * 3, skeleton.index(f"toe_{side}")]),
        places=np.vstack([local, toe_place]),
        sd_m=np.zeros(4),
        paths=paths,
        weights=known * weight,
    )
