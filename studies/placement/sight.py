"""Visibility of a board, or of the ground ahead, over a walk, from projected points without rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.fields import DEG, number
from stridetwin.streams.rig import Board, CameraCalibration
from stridetwin.streams.samples import Array

NEAR_M = 0.03


def project(camera: CameraCalibration, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Image coordinates of points (Brown 1966 and Conrady 1919; Kannala & Brandt 2006, as OpenCV has them).

    Args:
        camera: Intrinsics and distortion.
        points: (..., 3) m, optical frame.

    Returns:
        (..., 2) pixels, the centre of the top-left one is (0, 0); and (...) whether the point is in front of the camera
        and inside the image, within the valid range of the distortion model.
    """
    z = np.where(points[..., 2] > NEAR_M, points[..., 2], np.inf)
    x, y = points[..., 0] / z, points[..., 1] / z
    bent, fair = _radtan if camera.distortion_model == "radtan" else _equidistant, np.isfinite(z)
    x, y, straight = bent(x, y, *camera.distortion)
    fu, fv, pu, pv = camera.intrinsics
    u, v = fu * x + pu, fv * y + pv
    inside = fair & straight & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    return np.stack([u, v], axis=-1), inside


def _radtan(x: Array, y: Array, k1: float, k2: float, p1: float, p2: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    r2 = x**2 + y**2
    radial = 1.0 + r2 * (k1 + r2 * k2)
    out = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return *out, 1.0 + r2 * (3 * k1 + 5 * k2 * r2) > 0.0


def _equidistant(
    x: Array, y: Array, k1: float, k2: float, k3: float, k4: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    r = np.hypot(x, y)
    angle = np.arctan(r)
    a2 = angle**2
    bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    scale = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
    grows = 1.0 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4))) > 0.0
    return x * scale, y * scale, grows


if TYPE_CHECKING:
    from stridetwin.studies.placement.posed_walk import PosedWalk

Flags = NDArray[np.bool_]
_EVERY = 5  # every n-th instant is used where each needs hundreds of lines of sight
_FAN = (16, 12)
_ARM_M = 1.0
_SHORT_OF_M = 0.02  # a line of sight ends this far before the ground


@dataclass(frozen=True, kw_only=True)
class Seeing:
    """When a board counts as seen.

    Attributes:
        least_px: Edge of its squares in the image, at the board's centre, if it were seen face on.
        incidence_rad: Largest angle between its normal and the line of sight.
        blur_squares: Largest displacement of its centre during the exposure, in squares; for `sharp`.
    """

    least_px: Annotated[float, number(0.1, 1000)] = 4.0
    incidence_rad: Annotated[float, number(1, 89.9, key="incidence_deg", scale=DEG)] = math.radians(65.0)
    blur_squares: Annotated[float, number(0.001, 100)] = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Sight:
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


def see_board(walk: PosedWalk, camera: CameraCalibration, board: Board, exposure_s: float, seeing: Seeing) -> Sight:
    """What a camera sees of a board.

    Args:
        walk: Walk with N instants.
        camera: On one body.
        board: On another one.
        exposure_s: Exposure of its images, s.
        seeing: What counts.
    """
    carrier, other = walk.bodies[camera.mount.body], walk.bodies[board.mount.body]
    T_world_camera, T_world_board = carrier.seats(camera.mount.T_body_sensor), other.seats(board.mount.T_body_sensor)
    eye, middle = T_world_camera[:, :3, 3], T_world_board[:, :3, 3]
    half = np.array([*board.squares, 0.0]) * board.square_m / 2
    corners = np.array([[0, 0, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half
    points = corners @ np.swapaxes(T_world_board[:, :3, :3], 1, 2) + middle[:, None]
    R_world_camera = T_world_camera[:, :3, :3]
    seen_from = (points - eye[:, None]) @ R_world_camera
    _, inside = project(camera, seen_from)
    away = eye - middle
    distance = np.linalg.norm(away, axis=1)
    facing = np.sum(away * T_world_board[:, :3, 2], axis=1) / np.maximum(distance, 1e-9)
    x, y, z = seen_from[:, 0].T
    z = np.maximum(z, 1e-6)
    focal = math.sqrt(camera.intrinsics[0] * camera.intrinsics[1])
    px = focal * board.square_m / z
    in_view = inside.all(axis=1) & (px >= seeing.least_px) & (facing > math.cos(seeing.incidence_rad))

    relative = other.velocity(middle) - carrier.velocity(eye) - np.cross(carrier.w, middle - eye)
    vx, vy, vz = (relative[:, None] @ R_world_camera)[:, 0].T
    blur_px = exposure_s * focal * np.hypot((vx * z - x * vz) / z**2, (vy * z - y * vz) / z**2)

    behind, buried = np.zeros_like(in_view), np.zeros_like(in_view)
    rows = np.flatnonzero(in_view)
    if len(rows):
        behind[rows] = walk.limbs.hide(rows, eye[rows], points[rows]).any(axis=1)
        buried[rows] = _buried(walk, eye[rows], points[rows]).any(axis=1)
    seen = in_view & ~behind & ~buried
    sharp = seen & (blur_px < seeing.blur_squares * px)
    return Sight(in_view=in_view, behind_limbs=behind, seen=seen, sharp=sharp, px=px, blur_px=blur_px)


def _buried(walk: PosedWalk, eyes: Array, points: Array) -> Flags:
    """(M, K) whether the ground or an object on it is between (M, 3) eyes and (M, K, 3) points."""
    sight = points - eyes[:, None]
    length = np.linalg.norm(sight, axis=-1)
    origins = np.broadcast_to(eyes[:, None], points.shape).reshape(-1, 3)
    hit = walk.terrain.ray_cast(origins, sight.reshape(-1, 3)).reshape(length.shape)
    return np.asarray(hit < length - _SHORT_OF_M)


@dataclass(frozen=True, kw_only=True)
class Outlook:
    """Contents of a depth camera's view.

    Attributes:
        ahead: Share of the ground 0.5 to 2.5 m ahead on the route that it sees, over the walk.
        own_body: Share of its image that the walker's body fills, over the walk.
    """

    ahead: float
    own_body: float


def look_ahead(walk: PosedWalk, camera: CameraCalibration, range_m: tuple[float, float]) -> Outlook:
    """Visible ground ahead of a depth camera.

    Args:
        walk: The walk.
        camera: The camera with its mount.
        range_m: Smallest and largest depth that it measures.
    """
    rows = np.arange(0, len(walk), _EVERY)
    T = walk.bodies[camera.mount.body].seats(camera.mount.T_body_sensor)[rows]
    eye, R = T[:, :3, 3], T[:, :3, :3]
    ground = walk.ground[rows]
    seen_from = (ground - eye[:, None]) @ R
    _, seen = project(camera, seen_from)
    seen &= (seen_from[..., 2] > range_m[0]) & (seen_from[..., 2] < range_m[1])
    seen &= ~walk.limbs.hide(rows, eye, ground)
    seen &= ~_buried(walk, eye, ground)
    u, v = np.meshgrid(*((np.arange(n) + 0.5) * size / n for n, size in zip(_FAN, (camera.width, camera.height))))
    fu, fv, pu, pv = camera.intrinsics
    rays = np.stack([(u - pu) / fu, (v - pv) / fv, np.ones_like(u)], axis=-1).reshape(-1, 3) * _ARM_M
    fan = rays @ np.swapaxes(R, 1, 2) + eye[:, None]
    return Outlook(ahead=float(seen.mean()), own_body=float(walk.limbs.hide(rows, eye, fan).mean()))
