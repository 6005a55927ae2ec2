"""Boxes seen by a depth camera on someone who walks, by exact ray casting: no simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.depth_rig import make_depth_rig, make_rays
from stridetwin.estimators.terrain_map import TerrainEstimate, TerrainMap
from stridetwin.streams.samples import Depth, Odometry

WIDTH, HEIGHT, FOCAL = 320, 240, 192.0
EYE_M, PITCH = 1.65, math.radians(32.0)
PERIOD_NS = 100_000_000
RIG = make_depth_rig(WIDTH, HEIGHT, FOCAL, rate_hz=10.0)
RAYS = make_rays(WIDTH, HEIGHT, FOCAL)
"""(H W, 3) optical axes: a step of 1 along one is 1 m of depth."""


@dataclass(frozen=True, kw_only=True)
class Box:
    """x, y and z from .. to, m."""

    x: tuple[float, float]
    y: tuple[float, float] = (-0.8, 0.8)
    z: tuple[float, float] = (-1.0, 0.0)


FLOOR = Box(x=(-20, 20), y=(-20, 20), z=(-1.0, 0.0))


def flight(
    riser: float, tread: float, steps: int, *, start: float = 0.0, open_risers: bool = False, landing: float = 1.5
) -> list[Box]:
    """Stairs up along x from the floor; the last step is a landing."""
    boxes = [FLOOR]
    for k in range(steps):
        top = (k + 1) * riser
        depth = landing if k == steps - 1 else tread
        bottom = top - 0.04 if open_risers else -1.0
        x = start + k * tread
        boxes.append(Box(x=(x, x + depth + (0.0 if open_risers else 0.01)), z=(bottom, top)))
    return boxes


def slope(angle: float, start: float, rise: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A ramp up along x and what lies behind it, as something that rays meet."""
    run = rise / math.tan(angle)

    def depth(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
        normal = np.array([-math.sin(angle), 0.0, math.cos(angle)])
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((np.array([start, 0.0, 0.0]) - eye) @ normal) / (rays @ normal)
        hit = eye + t[:, None] * rays
        on = (hit[:, 0] >= start) & (hit[:, 0] <= start + run) & (np.abs(hit[:, 1]) < 0.8) & (t > 0)
        return np.where(on, t, np.inf)

    return depth


def winders(
    riser: float, part: float, treads: int, radius: float, half: float
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Treads around a pole on the left of the origin, at `radius`, by `part` rad each, as something that rays meet.

    The first riser is at the origin, across x; behind the last tread there is a landing of a quarter turn.
    """
    pole = np.array([0.0, radius, 0.0])

    def depth(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
        nearest = np.full(len(rays), np.inf)

        def meet(t: np.ndarray, low: float, high: float, first: float, last: float) -> None:
            x, y, z = (eye + t[:, None] * rays - pole).T
            angle, away = np.arctan2(x, -y), np.hypot(x, y)
            on = (t > 0) & (np.abs(away - radius) < half) & (angle > first - 1e-9) & (angle < last + 1e-9)
            on &= (z > low - 1e-9) & (z < high + 1e-9)
            nearest[on] = np.minimum(nearest[on], t[on])

        with np.errstate(divide="ignore", invalid="ignore"):
            for k in range(treads + 1):
                edge, top = k * part, (k + 1) * riser
                end = edge + (part if k < treads else math.pi / 2)
                meet((top - eye[2]) / rays[:, 2], top, top, edge, end)
                facing = np.array([math.cos(edge), math.sin(edge), 0.0])
                meet((pole - eye) @ facing / (rays @ facing), top - riser, top, edge - 1e-6, edge + 1e-6)
        return nearest

    return depth


def cast(boxes: Sequence[Box], eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N,) where rays first meet a box, in lengths of a ray; inf where none is met."""
    nearest = np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.ascontiguousarray(1.0 / rays.T)
    enter, leave, a, b, c = np.empty((5, len(rays)))  # axis by axis and in place, which is much faster
    for box in boxes:
        enter[:], leave[:] = -np.inf, np.inf
        for (low, high), at, per_m in zip((box.x, box.y, box.z), eye, inverse):
            np.multiply(low - at, per_m, out=a)
            np.multiply(high - at, per_m, out=b)
            np.maximum(enter, np.minimum(a, b, out=c), out=enter)
            np.minimum(leave, np.maximum(a, b, out=c), out=leave)
        hit = (enter <= leave) & (enter > 0)
        np.minimum(nearest, enter, out=nearest, where=hit)
    return nearest


def attitude(heading: float, pitch: float = PITCH) -> Rotation:
    """Optical frame to world of a camera that looks along a heading, pitch down."""
    forward_left_up = Rotation.from_euler("ZY", [heading, pitch])
    optical = Rotation.from_matrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    return forward_left_up * optical


def image(
    boxes: Sequence[Box],
    eye: np.ndarray,
    R: Rotation,
    rng: np.random.Generator | None,
    noise_per_m: float = 0.003,
    more: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """(H, W) m, 0 = none, with noise that grows as the depth's square."""
    rays = R.apply(RAYS)
    depth = cast(boxes, eye, rays)
    if more is not None:
        depth = np.minimum(depth, more(eye, rays))
    depth[~np.isfinite(depth) | (depth > 6.0)] = 0.0
    if rng is not None:
        depth += rng.normal(size=depth.shape) * noise_per_m * depth**2
    return depth.reshape(HEIGHT, WIDTH).astype(np.float32)


def pose(t_ns: int, eye: np.ndarray, R: Rotation) -> Odometry:
    """The optical frame's pose."""
    return Odometry(
        topic="/odometry",
        t_ns=t_ns,
        p_frame_in_world=np.asarray(eye, float),
        q_world_frame=R.as_quat(scalar_first=True),
        v_frame_in_world=np.zeros(3),
        angular_rate=np.zeros(3),
    )


def depth(t_ns: int, pixels: np.ndarray) -> Depth:
    """An image."""
    return Depth(topic="/head/depth", t_ns=t_ns, depth=pixels)


def approach(
    boxes: Sequence[Box],
    *,
    start: float,
    end: float,
    heading: float = 0.0,
    to: tuple[float, float] = (0.0, 0.0),
    ground: float = 0.0,
    frames: int = 12,
    seed: int = 0,
    eye_m: float = EYE_M,
    pitch: float = PITCH,
    terrain_map: TerrainMap | None = None,
    first_ns: int = 0,
    more: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> tuple[TerrainMap, TerrainEstimate]:
    """Walks from `start` to `end` metres before a place along a heading; the map and its last estimate."""
    terrain_map = terrain_map or TerrainMap(RIG)
    rng = np.random.default_rng(seed)
    forward = np.array([math.cos(heading), math.sin(heading)])
    estimate = None
    for i, away in enumerate(np.linspace(start, end, frames)):
        eye = np.array([*(np.array(to) - away * forward), ground + eye_m])
        R = attitude(heading, pitch + 0.05 * math.sin(1.3 * i))
        t_ns = first_ns + i * PERIOD_NS
        terrain_map.update(pose(t_ns, eye, R))
        estimate = terrain_map.update(depth(t_ns, image(boxes, eye, R, rng, more=more))) or estimate
    assert estimate is not None
    return terrain_map, estimate
