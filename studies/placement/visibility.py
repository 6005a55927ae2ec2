"""Geometric scores of a place: lines of sight from its sensors over a walk, without recording or rendering."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.checkerboard.pattern import DistortionModel
from stridetwin.scenarios.record import make_twin
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.sim.config import SIDES
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.parts.kinds import CameraPart, RgbdPart
from stridetwin.sim.rendering.cameras import board_seen_by
from stridetwin.sim.sensors.standard_rig import SensorRig
from stridetwin.sim.wearer.limbs import Limbs
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Board, CameraCalibration
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.scores import GEOMETRIC_SCORES, Seeing

RATE_HZ = 50.0  # instants of a walk per second
AHEAD_M, ASIDE_M = np.arange(0.5, 2.51, 0.25), (-0.25, 0.0, 0.25)
"""The ground that determines the next steps: m ahead of the pelvis along the route, and to its left."""
NEAR_M = 0.03  # nearer points are not in an image
_EVERY = 5  # every n-th instant is used where each needs hundreds of lines of sight
_FAN = (16, 12)  # lines of sight across and down the image that find the walker's own body
_ARM_M = 1.0  # depth at which these lines end
_SHORT_OF_M = 0.02  # a line of sight ends this far before the ground
_CELLS = {"insole": 4, "interaction": 2}  # number of parts of a sensor
_WITHIN = ("head_imu", "exo_imu", "actuator")  # groups inside other parts or the exoskeleton: they add no weight

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedWalk:
    """The motion of a walk, on which any placement of the sensors can be scored.

    Attributes:
        bodies: Tracks of the bodies with sensors at N instants, by name; for a foot, of the shoe's upper.
        limbs: Limbs that may occlude.
        terrain: The terrain.
        ground: Points on the ground ahead of the walker, (N, A, 3) m in the world.
    """

    bodies: dict[str, Track]
    limbs: Limbs
    terrain: Terrain
    ground: Array

    def __len__(self) -> int:
        return len(self.ground)


def pose_walk(scenario: Scenario, seed: int) -> PosedWalk:
    """Plans the walk of a scenario, independent of its sensors.

    Raises:
        StrideTwinError: The walk is infeasible, or the simulator is not installed.
    """
    # without sensors and faults, so that places that differ in these share the walk
    bare = replace(scenario, config=replace(scenario.config, sensors=(), fittings={}, faults=()))
    twin = make_twin(bare, seed)
    steps = [step for side in SIDES for step in twin.walk.steps[side]]
    # the instants lie between the first toe-off and the last touch-down
    offs = [step.t_off for step in steps if np.isfinite(step.t_off)]
    ends = [step.t_touch for step in steps if np.isfinite(step.t_touch)]
    t = np.arange(min(offs), min(max(ends), twin.duration_s), 1.0 / RATE_HZ)  # (N,) s
    q, v = twin.walk.position_velocity(t)  # generalised positions and velocities at these instants
    motion = twin.player().motion(np.round(t * 1e9).astype(np.int64))
    bodies = {name: motion.carrier(name) for name in motion.tracks}
    layout = twin.terrain.layout
    along_m = layout.way.project(bodies["pelvis"].p_body_in_world[:, :2])  # (N,) m along the route
    # at each of N instants, each of D distances ahead on each of the three lines beside the route: (N D, 3, 2), then
    # (N, A, 2) with A = 3 D
    ahead = np.stack([layout.way.point((along_m[:, None] + AHEAD_M).ravel(), left) for left in ASIDE_M], axis=1)
    ahead = ahead.reshape(len(t), -1, 2)
    ground = np.concatenate([ahead, twin.terrain.height(ahead)[..., None]], axis=-1)
    return PosedWalk(bodies=bodies, limbs=Limbs.of(twin.model, q, v), terrain=twin.terrain, ground=ground)


def is_in_image(camera: CameraCalibration, points: Array) -> Flags:
    """(...) whether points (..., 3) m of the optical frame are in the image and at least `NEAR_M` in front of it."""
    z = np.where(points[..., 2] > NEAR_M, points[..., 2], np.nan)  # NaN pixels are in no image
    pixels = DistortionModel(camera).pixels((points[..., :2] / z[..., None]).reshape(-1, 2))
    inside = (pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))
    return np.asarray(inside.all(axis=1).reshape(z.shape))


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardVisibility:
    """What a camera sees of a board at N instants.

    Attributes:
        in_view: (N,) the whole board is in the image, large and flat enough; occlusion is not considered.
        behind_limbs: (N,) in view, and partly occluded by a limb.
        seen: (N,) in view without occlusion.
        sharp: (N,) seen with little blur.
        px: (N,) edge of a square, pixels.
        blur_px: (N,) displacement of the centre during the exposure, pixels.
    """

    in_view: Flags
    behind_limbs: Flags
    seen: Flags
    sharp: Flags
    px: Array
    blur_px: Array


def see_board(
    walk: PosedWalk, camera: CameraCalibration, board: Board, exposure_s: float, seeing: Seeing
) -> BoardVisibility:
    """What a camera on one body sees of a board on another one over a walk.

    A square's edge is focal length × square / depth in pixels. Blur is the speed of the board's centre in the image
    times the exposure, with v = d/dt (x / z, y / z) = ((vx z - x vz) / z², (vy z - y vz) / z²).

    Args:
        walk: The walk.
        camera: Calibration and mount of the camera.
        board: The board.
        exposure_s: Exposure of an image.
        seeing: When a board counts as seen.
    """
    carrier, board_body = walk.bodies[camera.mount.body], walk.bodies[board.mount.body]
    T_world_camera = carrier.poses() @ camera.mount.T_body_sensor
    T_world_board = board_body.poses() @ board.mount.T_body_sensor
    eye, middle = T_world_camera[:, :3, 3], T_world_board[:, :3, 3]  # (N, 3) m, camera and centre of the board
    # points 0, the centre, and 1-4, the corners of the board: (N, 5, 3) in the world, then in the camera's frame
    half = np.array([*board.squares, 0.0]) * board.square_m / 2  # half of the board's width and height, m
    corners = np.array([[0, 0, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half
    points = corners @ np.swapaxes(T_world_board[:, :3, :3], 1, 2) + middle[:, None]
    R_world_camera = T_world_camera[:, :3, :3]
    in_camera = (points - eye[:, None]) @ R_world_camera
    away = eye - middle  # from the board to the camera
    distance = np.linalg.norm(away, axis=1)
    # cosine of the angle between the board's normal and the line of sight
    facing = np.sum(away * T_world_board[:, :3, 2], axis=1) / np.maximum(distance, 1e-9)
    x, y, z = in_camera[:, 0].T  # of the centre
    z = np.maximum(z, 1e-6)  # a centre behind the camera is not in the image, but must not divide by 0
    focal = math.sqrt(camera.intrinsics[0] * camera.intrinsics[1])
    px = focal * board.square_m / z
    in_view = (
        is_in_image(camera, in_camera).all(axis=1) & (px >= seeing.least_px) & (facing > math.cos(seeing.incidence_rad))
    )

    # velocity of the board's centre as seen in the rotating camera
    rotation_velocity = np.cross(_angular_rate(carrier), middle - eye)
    relative = _velocity(board_body, middle) - _velocity(carrier, eye) - rotation_velocity
    vx, vy, vz = (relative[:, None] @ R_world_camera)[:, 0].T  # in the camera's axes, m/s
    blur_px = exposure_s * focal * np.hypot((vx * z - x * vz) / z**2, (vy * z - y * vz) / z**2)

    behind_limbs, behind_ground = np.zeros_like(in_view), np.zeros_like(in_view)
    rows = np.flatnonzero(in_view)  # lines of sight are costly, so only for these instants
    if len(rows):
        behind_limbs[rows] = walk.limbs.occludes(rows, eye[rows], points[rows]).any(axis=1)
        behind_ground[rows] = _is_behind_ground(walk, eye[rows], points[rows]).any(axis=1)
    seen = in_view & ~behind_limbs & ~behind_ground
    sharp = seen & (blur_px < seeing.blur_squares * px)
    return BoardVisibility(in_view=in_view, behind_limbs=behind_limbs, seen=seen, sharp=sharp, px=px, blur_px=blur_px)


def _angular_rate(body: Track) -> Array:
    """(N, 3) angular rates of a body in world axes, rad/s."""
    return np.asarray(np.einsum("nij,nj->ni", body.rotation.as_matrix(), body.w_body))


def _velocity(body: Track, p_in_world: Array) -> Array:
    """(N, 3) m/s, velocities of (N, 3) points fixed to a body."""
    return body.v_body_in_world + np.cross(_angular_rate(body), p_in_world - body.p_body_in_world)


def _is_behind_ground(walk: PosedWalk, eyes: Array, points: Array) -> Flags:
    """(M, K) whether the ground or an object on it is between (M, 3) eyes and (M, K, 3) points, m in the world.

    A surface at the point itself does not hide it: the last `_SHORT_OF_M` of a line of sight do not count.
    """
    sight = points - eyes[:, None]
    length = np.linalg.norm(sight, axis=-1)
    origins = np.broadcast_to(eyes[:, None], points.shape).reshape(-1, 3)
    # (M, K) m from the eye to the first surface on each line of sight
    hit = walk.terrain.ray_cast(origins, sight.reshape(-1, 3)).reshape(length.shape)
    return np.asarray(hit < length - _SHORT_OF_M)


def measure_outlook(walk: PosedWalk, camera: CameraCalibration, range_m: tuple[float, float]) -> tuple[float, float]:
    """How much of the ground ahead a depth camera sees over a walk, and how much of its image is the walker.

    Args:
        walk: The walk.
        camera: Calibration and mount of the camera.
        range_m: Nearest and farthest depth that it measures.

    Returns:
        Share of the ground 0.5 to 2.5 m ahead on the route that is seen, and share of the image in which the walker's
        body is nearer than `_ARM_M`, both 0-1 and means over the walk.
    """
    rows = np.arange(0, len(walk), _EVERY)  # (M,) numbers of the instants
    T = walk.bodies[camera.mount.body][rows].poses() @ camera.mount.T_body_sensor
    eye, R = T[:, :3, 3], T[:, :3, :3]
    ground = walk.ground[rows]
    nearest_m, farthest_m = range_m
    in_camera = (ground - eye[:, None]) @ R  # (M, A, 3) m in the camera's frame
    depth = in_camera[..., 2]
    seen = is_in_image(camera, in_camera) & (depth > nearest_m) & (depth < farthest_m)
    seen &= ~walk.limbs.occludes(rows, eye, ground) & ~_is_behind_ground(walk, eye, ground)
    # a regular grid of pixels, and the lines of sight through them, in the camera's frame and in the world
    u, v = np.meshgrid(*((np.arange(n) + 0.5) * size / n for n, size in zip(_FAN, (camera.width, camera.height))))
    fu, fv, pu, pv = camera.intrinsics
    rays = np.stack([(u - pu) / fu, (v - pv) / fv, np.ones_like(u)], axis=-1).reshape(-1, 3) * _ARM_M
    fan = rays @ np.swapaxes(R, 1, 2) + eye[:, None]  # (M, K, 3) m, ends of the K lines of sight
    return float(seen.mean()), float(walk.limbs.occludes(rows, eye, fan).mean())


def geometric_scores(
    sensor_rig: SensorRig, walk: PosedWalk | None, names: Collection[str], seeing: Seeing
) -> dict[str, float]:
    """Geometric scores of a place on a walk, by name; undefined scores (no board ever in view) are left out.

    Args:
        sensor_rig: Sensors at the place.
        walk: The walk; None where only weights are needed.
        names: Scores of `GEOMETRIC_SCORES`.
        seeing: When a board counts as seen.

    Raises:
        StrideTwinError: A sensor that a score needs is off, or a part has no weight.
    """
    groups = {sensor.group for sensor in sensor_rig.sensors.values()}
    # group of sensors that each score needs; "" for none
    needed = {name: GEOMETRIC_SCORES[name][0] for name in names}
    for name, group in needed.items():
        if group and group not in groups:
            raise StrideTwinError(f"{name} needs {group}, which is off")
    scores: dict[str, float] = {}
    if walk is not None and "foot_camera" in needed.values():
        scores |= _score_boards(sensor_rig, walk, seeing)
    if walk is not None and "head_camera" in needed.values():
        scores |= _score_outlook(sensor_rig, walk)
    for name, body in (("weight_g", None), ("foot_weight_g", "foot_l")):
        if name in names:
            scores[name] = _weight_g(sensor_rig, body)
    return {name: scores[name] for name in names if name in scores}


def _score_boards(sensor_rig: SensorRig, walk: PosedWalk, seeing: Seeing) -> dict[str, float]:
    """Scores of shoe cameras that see the other shoe's board, %, and the mean edge of a seen square, px.

    Args:
        sensor_rig: Sensors at the place.
        walk: The walk.
        seeing: When a board counts as seen.

    Returns:
        `visibility_pct` and `sharp_pct` by at least one of the cameras; `occlusion_pct` if a board is ever in view, and
        `square_px` if one is ever seen.
    """
    visibilities = []
    for topic, camera in sensor_rig.rig.cameras.items():
        board, part = board_seen_by(sensor_rig, topic), sensor_rig.sensors[topic].part
        if board is not None and isinstance(part, CameraPart):
            visibilities.append(see_board(walk, camera, board, part.imager.exposure_s, seeing))
    seen = np.array([s.seen for s in visibilities])  # (cameras, N)
    # instants with a board in view, counted for each camera
    in_view = sum(int(s.in_view.sum()) for s in visibilities)
    scores = {
        "visibility_pct": 100.0 * float(seen.any(axis=0).mean()),
        "sharp_pct": 100.0 * float(np.array([s.sharp for s in visibilities]).any(axis=0).mean()),
    }
    if in_view:
        scores["occlusion_pct"] = 100.0 * sum(int(s.behind_limbs.sum()) for s in visibilities) / in_view
    if seen.any():
        scores["square_px"] = float(np.concatenate([s.px[s.seen] for s in visibilities]).mean())
    return scores


def _score_outlook(sensor_rig: SensorRig, walk: PosedWalk) -> dict[str, float]:
    """Scores of the head camera: seen share of the ground ahead, and share of the image with the own body, %."""
    # the head camera is the one with depth
    topic, camera = next((topic, camera) for topic, camera in sensor_rig.rig.cameras.items() if camera.depth_topic)
    part = sensor_rig.sensors[topic].part
    assert isinstance(part, RgbdPart)
    ahead, own_body = measure_outlook(walk, camera, (part.depth.range_min, part.depth.range_max))
    return {"ahead_pct": 100.0 * ahead, "own_body_pct": 100.0 * own_body}


def _weight_g(sensor_rig: SensorRig, body: str | None) -> float:
    """Weight of all sensors, or of those on one body, g.

    Args:
        sensor_rig: The sensors.
        body: Name of the body; None for all sensors.

    Raises:
        StrideTwinError: A part has no weight.
    """
    total = 0.0
    for topic, sensor in sensor_rig.sensors.items():
        if sensor.group in _WITHIN or body not in (None, sensor.calibration.mount.body):
            continue
        if not sensor.part.mass_kg:
            raise StrideTwinError(f"the part of {topic}, {sensor.part.name}, has no mass_g, which weight needs")
        total += 1e3 * sensor.part.mass_kg * _CELLS.get(sensor.group, 1)
    return total
