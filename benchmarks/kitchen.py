"""Kitchens that nobody walks stairs in, scanned by hand: boxes seen by a depth camera, by exact ray casting.

Counters of 0.85-0.95 m along walls, with drawers and a dishwasher standing open, a table, chairs, and boxes of 10-25 cm
on the floor. A depth camera of 57 by 44 degrees is held at chest height and swept by hand, with six degrees of freedom,
close to all of these. The map gets the true poses, as those of 7-Scenes are, with their errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.depth_rig import make_depth_rig, make_rays
from stridetwin.streams.samples import Array, Depth, Odometry, Sample

_WIDTH, _HEIGHT, _FOCAL = 240, 180, 219.0
"""An image of 57 by 44 degrees, as of a Kinect, with fewer pixels for speed."""
_PERIOD_S, _SECONDS = 0.125, 15.0
_RANGE_M, _NOISE_PER_M = (0.5, 4.0), 0.0025
"""Range of the depth, and its noise over the square of the depth, 1/m: those of a Kinect."""
_POSE_SD_M, _POSE_SD_RAD = 0.004, math.radians(0.2)
"""Errors of the poses, which wander within a second."""
_CLEARANCE_M = 0.15
"""The camera stays so far from all boxes in plan, but may be above counters."""
RIG = make_depth_rig(_WIDTH, _HEIGHT, _FOCAL, 1.0 / _PERIOD_S)
_RAYS = make_rays(_WIDTH, _HEIGHT, _FOCAL).astype(np.float32)
_OPTICAL = Rotation.from_matrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box that is turned about the vertical.

    Attributes:
        centre: (x, y) m.
        size: Length and width, m.
        z: From .. to, m.
        yaw_rad: Turn of the length from x.
    """

    centre: tuple[float, float]
    size: tuple[float, float]
    z: tuple[float, float]
    yaw_rad: float = 0.0


def draw_kitchen(rng: np.random.Generator) -> list[Box]:
    """A kitchen of 3 to 4.5 m: floor, walls, counters with open drawers, table, chairs and boxes on the floor."""
    length, width = rng.uniform(3.0, 4.5, 2)
    boxes = [Box(centre=(0.0, 0.0), size=(12.0, 12.0), z=(-0.3, 0.0))]
    for x, y, yaw in ((length / 2, 0, 0), (-length / 2, 0, 0), (0, width / 2, 1), (0, -width / 2, 1)):
        at = (x * (1 + 0.2 / length), y * (1 + 0.2 / width))
        size = (0.2, width + 0.4) if yaw == 0 else (length + 0.4, 0.2)
        boxes.append(Box(centre=at, size=size, z=(-0.1, 2.5)))
    top = rng.uniform(0.85, 0.95)
    boxes += _draw_counter(rng, along=length, wall=width / 2, side=1.0, top=top)
    if rng.uniform() < 0.6:
        boxes += _draw_counter(rng, along=length, wall=width / 2, side=-1.0, top=top)
    table = rng.uniform(-0.4, 0.4, 2)
    yaw = float(rng.uniform(0.0, math.pi))
    height = rng.uniform(0.70, 0.77)
    size = (rng.uniform(0.9, 1.4), rng.uniform(0.6, 0.8))
    if rng.uniform() < 0.7:
        boxes.append(Box(centre=tuple(table), size=size, z=(height - 0.04, height), yaw_rad=yaw))
        for _ in range(int(rng.integers(1, 4))):
            boxes += _draw_chair(rng, table + 0.7 * _unit(rng.uniform(0, 2 * math.pi)))
    for _ in range(int(rng.integers(2, 6))):
        at = rng.uniform(-0.4, 0.4, 2) * (length, width)
        size, height = rng.uniform(0.25, 0.6, 2), rng.uniform(0.10, 0.25)
        turn = float(rng.uniform(0.0, math.pi))
        boxes.append(Box(centre=tuple(at), size=tuple(size), z=(0.0, height), yaw_rad=turn))
        if rng.uniform() < 0.4:  # another box upon it
            size = rng.uniform(0.5, 0.9, 2) * size
            boxes.append(Box(centre=tuple(at), size=tuple(size), z=(height, 2.0 * height), yaw_rad=turn))
    return boxes


def _unit(angle: float) -> Array:
    """(2,) unit vector at an angle, rad, from x."""
    return np.array([math.cos(angle), math.sin(angle)])


def _draw_counter(rng: np.random.Generator, *, along: float, wall: float, side: float, top: float) -> list[Box]:
    """A counter along a wall with things on it, and drawers and a dishwasher that may stand open.

    Args:
        rng: Generator.
        along: Length of the wall, m, along x.
        wall: Its distance from the middle, m, along y.
        side: 1 for the left wall, -1 for the right one.
        top: Height of the counter, m.
    """
    depth, toe = 0.6, 0.10
    front = wall - depth
    boxes = [
        Box(centre=(0.0, side * (wall - depth / 2)), size=(along, depth), z=(top - 0.04, top)),
        Box(centre=(0.0, side * (wall - depth / 2 + 0.03)), size=(along, depth - 0.06), z=(toe, top - 0.04)),
        Box(centre=(0.0, side * (wall - depth / 2 + 0.06)), size=(along, depth - 0.12), z=(0.0, toe)),
    ]
    for x in np.arange(-along / 2 + 0.3, along / 2 - 0.3, 0.62).tolist():
        kind = str(rng.choice(["closed", "closed", "drawers", "drawer", "dishwasher"]))
        if kind in ("drawers", "drawer"):
            # open drawers one above the other reach less far the higher they are, or any is open alone
            levels = (0.15, 0.42, 0.68)
            open_levels = levels if kind == "drawers" else (float(rng.choice(levels)),)
            out = float(rng.uniform(0.3, 0.45))
            for k, low in enumerate(open_levels):
                reach = out * (1.0 - 0.3 * k)
                at = (x, side * (front - reach / 2))
                boxes.append(Box(centre=at, size=(0.56, reach), z=(low, low + float(rng.uniform(0.10, 0.18)))))
        elif kind == "dishwasher":
            boxes.append(Box(centre=(x, side * (front - 0.3)), size=(0.58, 0.6), z=(0.12, 0.17)))
        if rng.uniform() < 0.5:  # something on the counter
            size, height = rng.uniform(0.15, 0.4, 2), float(rng.uniform(0.05, 0.35))
            at = (x, side * (wall - 0.3 + rng.uniform(-0.1, 0.1)))
            boxes.append(Box(centre=at, size=tuple(size), z=(top, top + height)))
    return boxes


def _draw_chair(rng: np.random.Generator, place: Array) -> list[Box]:
    """A chair: seat, back and four legs."""
    yaw, seat = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(0.42, 0.48))
    ahead, left = _unit(yaw), _unit(yaw + math.pi / 2)
    x, y = place.tolist()
    boxes = [Box(centre=(x, y), size=(0.42, 0.42), z=(seat - 0.03, seat), yaw_rad=yaw)]
    back = place - 0.2 * ahead
    boxes.append(Box(centre=tuple(back), size=(0.03, 0.42), z=(seat, seat + 0.45), yaw_rad=yaw))
    for a in (-0.18, 0.18):
        for b in (-0.18, 0.18):
            leg = place + a * ahead + b * left
            boxes.append(Box(centre=tuple(leg), size=(0.04, 0.04), z=(0.0, seat - 0.03), yaw_rad=yaw))
    return boxes


def scan_kitchen(seed: int) -> Iterator[Sample]:
    """Poses and depth images of a scan by hand; equal seeds give equal kitchens and scans."""
    rng = np.random.default_rng([seed, 7])
    boxes = draw_kitchen(rng)
    count = round(_SECONDS / _PERIOD_S)
    t = np.arange(count) * _PERIOD_S
    # place, height, heading, pitch and roll are sums of three oscillations each, as of a hand that sweeps
    reach = (max(0.2, boxes[2].centre[0] * -1.0 - 0.9), max(0.2, boxes[3].centre[1] - 1.1))
    x = _wander(rng, t, 0.0, reach[0], (0.03, 0.2))
    y = _wander(rng, t, 0.0, reach[1], (0.03, 0.2))
    z = _wander(rng, t, rng.uniform(1.2, 1.5), 0.12, (0.05, 0.4))
    heading = np.cumsum(_wander(rng, t, 0.0, 0.9, (0.05, 0.2))) * _PERIOD_S + rng.uniform(0.0, 2.0 * math.pi)
    pitch = _wander(rng, t, math.radians(35.0), math.radians(22.0), (0.05, 0.3))
    roll = _wander(rng, t, 0.0, math.radians(12.0), (0.05, 0.4))
    error = np.array([_wander(rng, t, 0.0, sd, (0.3, 1.0)) for sd in [_POSE_SD_M] * 3 + [_POSE_SD_RAD] * 3])
    for k in range(count):
        eye = np.array([x[k], y[k], z[k]])
        R = Rotation.from_euler("ZYX", [heading[k], pitch[k], roll[k]]) * _OPTICAL
        depth = _cast(boxes, eye, R)
        is_seen = (depth > _RANGE_M[0]) & (depth < _RANGE_M[1])
        depth = np.where(is_seen, depth, 0.0)
        noisy = depth + rng.normal(size=depth.shape) * _NOISE_PER_M * depth**2
        seen = np.where(is_seen, noisy, 0.0).reshape(_HEIGHT, _WIDTH).astype(np.float32)
        t_ns = round(1e9 * float(t[k]))
        yield Odometry(
            topic="/odometry",
            t_ns=t_ns,
            p_frame_in_world=eye + error[:3, k],
            q_world_frame=(Rotation.from_rotvec(error[3:, k]) * R).as_quat(scalar_first=True),
            v_frame_in_world=np.zeros(3),
            angular_rate=np.zeros(3),
        )
        yield Depth(topic="/head/depth", t_ns=t_ns, depth=seen)


def _wander(rng: np.random.Generator, t: Array, mean: float, sd: float, hz: tuple[float, float]) -> Array:
    """(N,) a smooth course about `mean` with the standard deviation `sd` in the long run."""
    waves = [
        math.sqrt(2.0 / 3.0) * np.sin(2.0 * math.pi * rng.uniform(*hz) * t + rng.uniform(0.0, 2.0 * math.pi))
        for _ in range(3)
    ]
    return np.asarray(mean + sd * np.sum(waves, axis=0))


def _cast(boxes: Sequence[Box], eye: Array, R_world_camera: Rotation) -> Array:
    """(N,) depth, m, at which the rays of an image first meet a box; inf where none is met."""
    nearest = np.full(len(_RAYS), np.inf, np.float32)
    for box in boxes:
        c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # world to box
        middle = np.array([*box.centre, 0.5 * (box.z[0] + box.z[1])])
        half = 0.5 * np.array([*box.size, box.z[1] - box.z[0]])
        start, way = turn @ (eye - middle), _RAYS @ (turn @ R_world_camera.as_matrix()).T.astype(np.float32)
        enter, leave = np.zeros(len(_RAYS), np.float32), np.full(len(_RAYS), np.inf, np.float32)
        for axis in range(3):
            with np.errstate(divide="ignore"):
                per_m = 1.0 / way[:, axis]
            a, b = (np.float32(sign * half[axis] - start[axis]) * per_m for sign in (-1.0, 1.0))
            np.maximum(enter, np.minimum(a, b), out=enter)
            np.minimum(leave, np.maximum(a, b), out=leave)
        np.minimum(nearest, enter, out=nearest, where=(enter <= leave) & (enter > 0.0))
    return nearest
