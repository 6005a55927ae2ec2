"""People who walk around the walker and enter the view of their cameras and sonars (Zhao et al. 2023, Fig. 3c).

They circle around the walker along the way, all in one sense and evenly spaced, so that they never meet. Each one
crosses the way some metres ahead of the walker and again behind, and passes them on both sides. Their stance feet do
not slip. The state defined here is rendered by the cameras, sensed by the sonars, and written as ground truth. In the
model they are bodies without contacts on their paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.kinematics.smooth import ease
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.world.route import RUN_OUT_M
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Strip

PARTS = ("trunk", *(f"{part}_{side}" for side in "lr" for part in ("thigh", "shank", "foot", "upper_arm", "forearm")))
# of a person of 1.75 m: lengths of thigh and shank, height of the ankle, ankle to ball of the foot, half width of the
# hips, and place of the left shoulder (forward, left, up) from the middle of the hips
THIGH_M, SHANK_M, ANKLE_M, BALL_M, HIP_M, SHOULDER_M = 0.43, 0.41, 0.08, 0.13, 0.085, (0.0, 0.19, 0.49)
UPPER_ARM_M = 0.29  # length of the upper arm
# Sonar targets: spheres (x, y, z, radius) in the frames of the parts, m.
SONAR_SPHERES = {
    "trunk": [(0.0, 0.0, z, 0.13) for z in (0.0, 0.15, 0.30, 0.42)] + [(0.02, 0.0, 0.68, 0.10)],
    "thigh": [(0.0, 0.0, -z, 0.075) for z in (0.05, 0.15, 0.25, 0.35)],
    "shank": [(0.0, 0.0, -z, 0.052) for z in (0.02, 0.12, 0.22, 0.32, 0.40)],
    "foot": [(x, 0.0, -0.04, 0.042) for x in (-0.03, 0.05, 0.13)],
}
_GRID_S = 0.02  # step of the time grid of their paths


# Paths and steps of bystanders; chosen by hand so that they pass the walker without meeting them.
_MAX_AHEAD_M = 2.5  # largest distance in front of the walker
_TURNS_PER_S = 0.45 / (2 * np.pi)  # round the walker
_CROSSING_SQUARENESS = 3.0  # how soon a crossing bystander is back at the side
_MIN_BESIDE_M = 0.72  # least distance from the middle of the way when passing
_EDGE_M = 0.08  # from the border of the way to a foot
_KEEP_AWAY_M = 0.80  # from the walker's pelvis
_PROGRESS_SMOOTHING_S = 0.5  # SD of the filter of the walker's progress
_ENDS_SMOOTHING_S = 0.3  # likewise, at the ends of the way
_CORNER_SMOOTHING_S = 0.35  # likewise, over which a corner is rounded
_PATH_SMOOTHING_S = 0.10  # likewise, of the path
_VELOCITY_SMOOTHING_S = 0.15  # likewise, of the velocity
_YAW_SMOOTHING_S = 0.30  # likewise, of the heading
_HIP_SMOOTHING_S = 0.07  # likewise, of the hips' height
_STEP_M = 0.56  # length of a step
_SUPPORT = 0.60  # half of the distance that a stance foot supports, in steps
_HALF_STANCE_M = 0.07  # from the middle of the body to a foot
_TOE_OFF_PITCH_RAD = 0.75  # pitch of a foot at toe-off
_TOUCH_DOWN_PITCH_RAD = -0.22  # and at touch-down
_LIFT_M = 0.06  # of a swinging foot
_ARM_SWING_RAD = 0.45  # at the reach of one step
_ELBOW_RAD = 0.35  # constant flexion
_TRUNK_LEAN_RAD = 0.04  # forward
_SIZE_RANGE = (0.93, 1.05)  # stature as a share of 1.75 m


@dataclass(frozen=True, kw_only=True, eq=False)
class Bystander:
    """One person who walks around, as functions of time.

    Attributes:
        t: (N,) uniform s.
        p: (N, 3) m, middle of the hips in the world.
        yaw: (N,) rad, unwrapped.
        steps: (N,) number of steps made so far, as a real number that grows.
        holds: (K, 3) m, footholds (balls of the feet) in order, left first; the first one lies before step `first`.
        hold_yaw: (K,) rad, direction of the foot on each.
        first: Number of the first foothold.
        size: Stature as a share of 1.75 m.
    """

    t: Array
    p: Array
    yaw: Array
    steps: Array
    holds: Array
    hold_yaw: Array
    first: int
    size: float

    def parts(self, t: NDArray[np.floating]) -> tuple[Array, Array]:
        """Frames of the eleven `PARTS` at (M,) s, in their order; limbs extend along -z of their frames.

        Returns:
            (M, 11, 3) m, origins in the world; (M, 11, 3, 3) rotations, part to world.
        """
        p = np.stack([np.interp(t, self.t, column) for column in self.p.T], -1)
        yaw, steps = np.interp(t, self.t, self.yaw), np.interp(t, self.t, self.steps)
        (ahead, left), up = _horizontal(yaw), np.array([0.0, 0.0, 1.0])
        # `k` scales all lengths. Lists in the order of `PARTS`: trunk; then thigh, shank, foot, upper arm and forearm
        # of each side
        k, origins, axes = self.size, [p], [_frame(left, up + _TRUNK_LEAN_RAD * ahead)]
        for sign, odd in ((1.0, 0), (-1.0, 1)):  # left, right
            ankle, R_foot, reach = self._foot(steps, odd)
            hip = p + sign * HIP_M * k * left
            knee, ankle = _two_links(hip, ankle, ahead, THIGH_M * k, SHANK_M * k)
            # the shoulders move with the trunk, whose axes are the first ones
            shoulder = p + np.einsum("nij,j->ni", axes[0], np.array(SHOULDER_M) * [1.0, sign, 1.0]) * k
            swing = -_ARM_SWING_RAD * reach / _STEP_M  # the arm swings against the leg
            upper = _swing_limb(left, ahead, swing)
            origins += [hip, knee, ankle, shoulder, shoulder - UPPER_ARM_M * k * upper[:, :, 2]]
            axes += [_frame(left, hip - knee), _frame(left, knee - ankle), R_foot, upper]
            axes.append(_swing_limb(left, ahead, swing + _ELBOW_RAD))
        return np.stack(origins, 1), np.stack(axes, 1)

    def track(self, t_ns: NDArray[np.int64]) -> Track:
        """Track of the middle of the hips, x forward, at (M,) instants."""
        t = t_ns * 1e-9
        p, R = (part[:, 0] for part in self.parts(t))  # of the trunk, the first part
        v = np.stack([np.interp(t, self.t, column) for column in np.gradient(self.p, self.t, axis=0).T], -1)
        return Track(
            t_ns=t_ns,
            p_body_in_world=p,
            q_world_body=to_quaternion(R),
            v_body_in_world=v,
            w_body=np.interp(t, self.t, np.gradient(self.yaw, self.t))[:, None] * R[:, 2],
        )

    def sonar_spheres(self, t: NDArray[np.floating]) -> tuple[Array, Array]:
        """(M, B, 3) centres of the sonar targets in the world, m, and (B,) radii."""
        p, R = self.parts(t)
        # (number of the part, sphere in its frame)
        rows = [
            (i, ball)
            for i, part in enumerate(PARTS)
            for ball in SONAR_SPHERES.get(part.removesuffix("_l").removesuffix("_r"), [])
        ]
        part_index, local = np.array([i for i, _ in rows]), np.array([ball for _, ball in rows]) * self.size
        centres, radii = local[:, :3], local[:, 3]
        return p[:, part_index] + np.einsum("mbij,bj->mbi", R[:, part_index], centres), radii

    def _foot(self, steps: Array, odd: int) -> tuple[Array, Array, Array]:
        """Ankle, axes and reach of one foot, for (M,) numbers of steps made.

        The foot stands for `_SUPPORT` steps before and after the body passes it, then swings to its next foothold.

        Args:
            steps: (M,) number of steps made.
            odd: 0 for the left foot, 1 for the right one.

        Returns:
            (M, 3) m, ankle in the world; (M, 3, 3) axes of the foot; (M,) m, how far the foot is in front of the hips.
        """
        count = steps - odd
        cycle = np.floor((count + _SUPPORT) / 2)  # strides of this foot so far; r is the number of steps in this one
        r = count - 2 * cycle  # -0.6 at touch-down, 0.6 at toe-off, 1.4 at the next touch-down
        at = (2 * cycle + odd - self.first).astype(int)  # row of the foothold that the foot stands on, or leaves
        a, b = self.holds[at], self.holds[at + 2]  # (M, 3) m, that foothold, and the next one of this foot
        share = np.clip((r - _SUPPORT) / (2 - 2 * _SUPPORT), 0.0, 1.0)  # of swing
        rise = b[:, 2] - a[:, 2]
        sooner = np.where(rise > 0, share / 0.6, (share - 0.4) / 0.6)  # up early in the swing, down late
        ball = a + ease(share)[:, None] * (b - a)
        ball[:, 2] = a[:, 2] + ease(sooner) * rise
        # pitch, toes down positive: the heel rises from 0.15 steps after the body has passed the foot until toe-off,
        # and comes down early in the swing; the toes are up late in the swing and just after touch-down
        pitch = _TOE_OFF_PITCH_RAD * ease((r - 0.15) / (_SUPPORT - 0.15)) * (1 - ease(share / 0.55))
        pitch += _TOUCH_DOWN_PITCH_RAD * (
            ease((share - 0.6) / 0.4) * (r > 0) + (1 - ease((r + _SUPPORT) / 0.2)) * (r < 0)
        )
        bump = (4 * share * (1 - share)) ** 2  # share of the swing's lift, 1 in its middle; a riser needs more lift
        # with the toes up the foot stands on its heel, so that the ball is higher
        ball[:, 2] += bump * (_LIFT_M + 0.3 * np.abs(rise)) + BALL_M * self.size * np.sin(np.maximum(-pitch, 0.0))
        yaw = self.hold_yaw[at] + ease(share) * (self.hold_yaw[at + 2] - self.hold_yaw[at])
        ahead, left = _horizontal(yaw)
        R = _swing_limb(left, ahead, -pitch)
        # in stance the body moves over the foot, in swing the foot moves by two steps
        reach = np.where(share > 0, 2 * ease(share) - r, -r) * _STEP_M
        ankle_to_ball = np.array([BALL_M, 0.0, -ANKLE_M]) * self.size  # in the axes of the foot
        return ball - np.einsum("nij,j->ni", R, ankle_to_ball), R, reach


Crowd = tuple[Bystander, ...]
"""All bystanders of a walk."""


def plan_bystanders(
    count: int, terrain: Terrain, t: Array, s: Array, p_walker: Array, rng: np.random.Generator
) -> Crowd:
    """Plans people who circle around a walker.

    Args:
        count: Number of bystanders.
        terrain: Terrain that they walk on.
        t: (N,) s of the walk.
        s: (N,) m, arc length of the walker along the way.
        p_walker: (N, 2) m, pelvis of the walker in the world.
        rng: Draws their common start angle and sense, and the size of each.
    """
    grid = np.arange(t[0], t[-1] + _GRID_S, _GRID_S)
    # on the grid: arc length and position of the walker; then start angle and sense of all bystanders
    along = _smooth(np.interp(grid, t, s), _PROGRESS_SMOOTHING_S)
    walker = np.stack([np.interp(grid, t, column) for column in p_walker.T], -1)
    start = rng.uniform(0.0, 1.0)
    sense = float(rng.choice([-1.0, 1.0]))
    turns = (sense * 2 * np.pi * (grid * _TURNS_PER_S + start + i / count) for i in range(count))
    return tuple(_plan_bystander(terrain, grid, along, walker, turn, size=rng.uniform(*_SIZE_RANGE)) for turn in turns)


def _plan_bystander(terrain: Terrain, t: Array, along: Array, walker: Array, turn: Array, size: float) -> Bystander:
    """Plans one bystander on a smooth path around the walker.

    The path is `_MAX_AHEAD_M` cos(turn) before the walker along the way, and to its left or right by a squared-off sine
    of the turn. It keeps `_KEEP_AWAY_M` from the walker.

    Args:
        terrain: Terrain.
        t: (N,) uniform s.
        along: (N,) m, smooth arc length of the walker.
        walker: (N, 2) m, pelvis of the walker.
        turn: (N,) rad, angle around the walker.
        size: Stature as a share of 1.75 m.
    """
    way, profile = terrain.layout.way, terrain.profile
    # distance from the middle of the way at which a bystander passes, m
    beside = max(terrain.route.width_m / 2 - _EDGE_M - _HALF_STANCE_M, _MIN_BESIDE_M)
    low, high = profile[0].s0 + 0.4, profile[-1].s1 - RUN_OUT_M + 1.6  # ends of the way for bystanders
    s = _smooth(np.clip(along + _MAX_AHEAD_M * np.cos(turn), low, high), _ENDS_SMOOTHING_S)
    left = beside * np.tanh(_CROSSING_SQUARENESS * np.sin(turn)) / np.tanh(_CROSSING_SQUARENESS)
    p = _smooth(way.point(s, left), _CORNER_SMOOTHING_S)
    away = p - walker
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    # at corners they may come close: there they are moved away from the walker
    missing = np.maximum(_KEEP_AWAY_M - distance, 0.0)
    p = p + away / np.maximum(distance, 1e-6) * missing
    p = _smooth(p, _PATH_SMOOTHING_S)
    v = _smooth(np.gradient(p, t, axis=0), _VELOCITY_SMOOTHING_S)
    yaw = _smooth(np.unwrap(np.arctan2(v[:, 1], v[:, 0])), _YAW_SMOOTHING_S)
    # m, length of the path so far; it grows in every row, so that it can be interpolated
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1) + 1e-9)])
    steps = gone / (_STEP_M * size)
    holds, hold_yaw, first = _footholds(np.column_stack([p, s, left, yaw - way.heading(s)]), yaw, steps, profile, size)
    # first without the height of the hips, which follows from the feet
    body = Bystander(
        t=t,
        p=np.column_stack([p, np.zeros(len(t))]),
        yaw=yaw,
        steps=steps,
        holds=holds,
        hold_yaw=hold_yaw,
        first=first,
        size=size,
    )
    body.p[:, 2] = _hip_height(body)
    return body


def _footholds(
    path: Array, yaw: Array, steps: Array, profile: Sequence[Strip], size: float
) -> tuple[Array, Array, int]:
    """Footholds of the balls of the feet.

    Args:
        path: (N, 5) x and y in the world, arc length along the way, distance to its left, m, and yaw relative to it.
        yaw: (N,) rad in the world.
        steps: (N,) steps made.
        profile: Ground along the way; it extends as far to the sides as any bystander walks.
        size: Stature as a share of 1.75 m.

    Returns:
        (K, 3) m in the world; (K,) rad, yaw of the foot on each; and the number of the first one.
    """
    first = -3
    # numbers of the footholds; a few lie before the start and beyond the end of the path, straight ahead
    count = np.arange(first, int(steps[-1]) + 5)
    beyond = (count - np.clip(count, 0.0, steps[-1])) * _STEP_M * size  # m beyond an end of the path
    heading = np.interp(count, steps, yaw)
    ahead = np.stack([np.cos(heading), np.sin(heading)], -1)
    aside = np.stack([-np.sin(heading), np.cos(heading)], -1)  # to the left
    sign = np.where(count % 2 == 0, 1.0, -1.0)
    x, y, s, left, relative_yaw = (np.interp(count, steps, column) for column in path.T)
    forward = beyond + 0.5 * BALL_M  # m, from the place on the path to the ball
    ball = np.stack([x, y], -1) + _HALF_STANCE_M * sign[:, None] * aside + forward[:, None] * ahead
    # the whole sole is above the ground: a foothold inside a riser is moved to the riser's edge
    # (4, K) m, from the place on the path to points of the sole: heel, waist, ball and toes, which are this far from
    # the ball
    sole = forward + size * np.array([[-0.20], [-0.10], [0.0], [0.07]])
    ground = _ground_height(profile, s + sole * np.cos(relative_yaw), left + sole * np.sin(relative_yaw))
    return np.column_stack([ball, ground.max(axis=0)]), heading, first


def _ground_height(profile: Sequence[Strip], s: Array, left: Array) -> Array:
    """(...) height of the ground, m, at (...) arc lengths and distances to the left of the way.

    Each strip rises from the height `z0` at the arc length `s0` to `z1` at `s1`, and by `cross` per metre to the left.
    """
    s0, s1, z0, z1, cross = np.array([(p.s0, p.s1, p.z0, p.z1, np.tan(p.cross_slope)) for p in profile]).T
    i = np.clip(np.searchsorted(s0, s, side="right") - 1, 0, len(s0) - 1)
    return z0[i] + (z1 - z0)[i] * np.clip((s - s0[i]) / (s1 - s0)[i], 0.0, 1.0) + cross[i] * left


def _hip_height(body: Bystander) -> Array:
    """(N,) m, height of the hips: as high as the legs reach, smoothed."""
    reach = (THIGH_M + SHANK_M) * body.size - 0.012  # m, of a nearly straight leg
    limits = []
    for sign, odd in ((1.0, 0), (-1.0, 1)):  # left, right
        ankle, _, _ = body._foot(body.steps, odd)
        hip = body.p[:, :2] + sign * HIP_M * body.size * np.stack([-np.sin(body.yaw), np.cos(body.yaw)], -1)
        away_squared = np.linalg.norm(ankle[:, :2] - hip, axis=1) ** 2  # m², horizontally from hip to ankle
        # at least √0.3 m above the ankle, so that the root exists
        limits.append(ankle[:, 2] + np.sqrt(np.maximum(reach**2 - away_squared, 0.3)))
    return _smooth(np.minimum(*limits), _HIP_SMOOTHING_S) - 0.01  # m, margin: smoothing may exceed the limit


def _smooth(x: Array, sigma_s: float) -> Array:
    """(N, ...) values every `_GRID_S`, filtered over time by a Gaussian of standard deviation `sigma_s`, s."""
    return gaussian_filter1d(x, sigma_s / _GRID_S, axis=0, mode="nearest")


def _two_links(hip: Array, ankle: Array, ahead: Array, thigh: float, shank: float) -> tuple[Array, Array]:
    """Knee, bent forward, and ankle of a leg from hip to ankle, both (N, 3) m; the ankle is moved into reach.

    Args:
        hip: (N, 3) m.
        ankle: (N, 3) m, wanted.
        ahead: (N, 3) unit vectors forward.
        thigh: Length, m.
        shank: Length, m.
    """
    along = ankle - hip
    distance = np.linalg.norm(along, axis=1, keepdims=True)
    unit = along / distance
    reached = np.minimum(distance, thigh + shank - 1e-4)  # m, of a leg that is not quite straight
    # angle at the hip between thigh and the line to the ankle, and the direction forward across that line
    cos = np.clip((thigh**2 + reached**2 - shank**2) / (2 * thigh * reached), -1.0, 1.0)
    forward = ahead - np.sum(ahead * unit, axis=1, keepdims=True) * unit
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    return hip + thigh * (cos * unit + np.sqrt(1 - cos**2) * forward), hip + reached * unit


def _horizontal(yaw: Array) -> tuple[Array, Array]:
    """(N, 3) unit vectors ahead and to the left, for (N,) rad of yaw."""
    cos, sin, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    return np.stack([cos, sin, zero], -1), np.stack([-sin, cos, zero], -1)


def _frame(left: Array, up: Array) -> Array:
    """(N, 3, 3) axes (columns) of a limb: z along `up`, the direction up the limb, and y nearly along `left`.

    `left` and `up` are (N, 3); `up` need not have unit length.
    """
    z = up / np.linalg.norm(up, axis=1, keepdims=True)
    x = np.cross(left, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], -1)


def _swing_limb(left: Array, ahead: Array, flexion: Array) -> Array:
    """(N, 3, 3) axes of a limb that hangs down and is swung forward by (N,) rad of flexion."""
    return _frame(left, np.cos(flexion)[:, None] * np.array([0.0, 0.0, 1.0]) - np.sin(flexion)[:, None] * ahead)


# colours, RGB 0-1; of shirts and trousers one for each bystander
_SHIRTS = ((0.72, 0.30, 0.22), (0.85, 0.70, 0.25), (0.35, 0.50, 0.28), (0.55, 0.40, 0.62))
_TROUSERS = ((0.25, 0.28, 0.38), (0.36, 0.30, 0.26), (0.20, 0.20, 0.22), (0.42, 0.44, 0.47))
_SKIN, _HAIR, _SHOE = (0.82, 0.62, 0.50), (0.22, 0.16, 0.11), (0.15, 0.15, 0.17)
_ELLIPSOID, _CAPSULE, _BOX = mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX
# type, centre, size and colour of a geom
_Geom = tuple[mujoco.mjtGeom, tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def add_bystanders(spec: mujoco.MjSpec, count: int) -> None:
    """Adds the bodies of `count` bystanders to a model, out of sight; `pose_crowd` places them."""
    for i in range(count):
        for part in PARTS:
            body = spec.worldbody.add_body(name=f"bystander_{i}_{part}", mocap=True, pos=(0.0, 0.0, -50.0))
            for kind, pos, size, colour in _geoms(part.removesuffix("_l").removesuffix("_r"), _SHIRTS[i], _TROUSERS[i]):
                body.add_geom(type=kind, pos=pos, size=size, rgba=(*colour, 1.0), contype=0, conaffinity=0, mass=0.0)


def pose_crowd(model: mujoco.MjModel, data: mujoco.MjData, crowd: Crowd, t_s: float) -> None:
    """Places all bystanders of a model at the instant `t_s`, s of the walk."""
    for i, person in enumerate(crowd):
        p, R = person.parts(np.array([t_s]))
        # the parts of a person are consecutive among the bodies without joints that can be placed (MuJoCo's mocap)
        first = int(model.body(f"bystander_{i}_{PARTS[0]}").mocapid[0])
        data.mocap_pos[first : first + len(PARTS)] = p[0]
        data.mocap_quat[first : first + len(PARTS)] = to_quaternion(R[0])


def _geoms(part: str, shirt: tuple[float, float, float], trousers: tuple[float, float, float]) -> list[_Geom]:
    """Type, centre, size and colour of the geoms of a body part, in its frame, m.

    Sizes are as in MuJoCo: three half axes of an ellipsoid; radius and half length of a capsule, whose third entry is
    not used.
    """

    def limb(length: float, radius: float, colour: tuple[float, float, float]) -> _Geom:
        """A capsule from the frame's origin down to `length` m."""
        return (_CAPSULE, (0.0, 0.0, -length / 2), (radius, length / 2, 0.0), colour)

    shoulder = SHOULDER_M[2]
    return {
        "trunk": [
            (_ELLIPSOID, (0.0, 0.0, 0.02), (0.10, HIP_M + 0.075, 0.11), trousers),
            (_ELLIPSOID, (0.0, 0.0, 0.20), (0.10, 0.14, 0.16), shirt),
            (_ELLIPSOID, (0.01, 0.0, shoulder - 0.13), (0.115, 0.18, 0.19), shirt),
            (_CAPSULE, (0.01, 0.0, shoulder + 0.06), (0.05, 0.04, 0.0), _SKIN),
            (_ELLIPSOID, (0.025, 0.0, shoulder + 0.21), (0.092, 0.074, 0.118), _SKIN),
            (_ELLIPSOID, (0.005, 0.0, shoulder + 0.235), (0.094, 0.080, 0.108), _HAIR),
        ],
        "thigh": [limb(THIGH_M, 0.075, trousers)],
        "shank": [limb(SHANK_M, 0.052, trousers)],
        "foot": [(_ELLIPSOID, (0.055, 0.0, -ANKLE_M / 2), (0.135, 0.046, ANKLE_M / 2), _SHOE)],
        "upper_arm": [limb(UPPER_ARM_M, 0.045, shirt)],
        "forearm": [limb(0.30, 0.036, _SKIN)],
    }[part]
