"""A hand on a rail: the arm reaches to the rail and slides along it, and the trunk leans towards it a little.

The arm has three hinges (flexion and abduction of the shoulder, flexion of the elbow), which bring the palm to any
point within reach in closed form. Nothing bears on the rail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from stridetwin.sim.acts import HoldRail
from stridetwin.sim.gait.posture import Posture
from stridetwin.sim.kinematics.smooth import ease, smooth_gaussian
from stridetwin.sim.world.rails import Rail
from stridetwin.streams.algebra.arrays import from_euler, rot_x, rot_y, rot_z
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

# Chosen by hand.
_PALM_M = 0.075  # from the wrist to the middle of the palm
_STRETCH = 0.93  # distance from shoulder to palm, relative to the straight arm
_AHEAD_RANGE_M = (0.02, 0.60)  # of the hand before the shoulder
_CHOICE_M = 0.01  # between the places that the hand chooses from
_REACH_S = 0.8  # time in which the hand reaches to the rail, and in which it leaves it
_LEAN_RAD = 0.05  # of the trunk towards the rail
_PLACE_SMOOTHING_S = 0.15  # SD of the filter of the place of the hand along the rail
_REACH_SHARE = 0.985  # of the straight arm: a bent elbow
_SOFT_M = 0.008  # distance within which the reach ends softly
_GAP_M = 0.03  # a rail farther from the palm is out of reach
_NEAREST_M = 0.22  # least distance from the middle of the pelvis
_HELD = 0.999  # share of holding from which the palm is on the rail


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """Dimensions of an arm.

    Attributes:
        side: `l` or `r`.
        p_torso_in_pelvis: (3,) m.
        p_shoulder_in_torso: (3,) m.
        upper_m: Shoulder to elbow, m.
        lower_m: Elbow to palm, m.
    """

    side: str
    p_torso_in_pelvis: Array
    p_shoulder_in_torso: Array
    upper_m: float
    lower_m: float

    @classmethod
    def of(cls, model: mujoco.MjModel, side: str) -> Arm:
        """The arm of a compiled wearer."""
        return cls(
            side=side,
            p_torso_in_pelvis=model.body("torso").pos.copy(),
            p_shoulder_in_torso=model.body(f"upper_arm_{side}").pos.copy(),
            upper_m=float(-model.body(f"forearm_{side}").pos[2]),
            lower_m=float(-model.body(f"hand_{side}").pos[2]) + _PALM_M,
        )

    def solve(self, r: Array) -> tuple[Array, Array, Array]:
        """Angles that bring the palm to points (N, 3) m from the shoulder, in the torso's axes.

        Points out of reach are drawn nearer, softly.

        Returns:
            (N,) rad, flexion and abduction of the shoulder, and flexion of the elbow.
        """
        a, b, sign = self.upper_m, self.lower_m, 1.0 if self.side == "l" else -1.0
        distance = np.linalg.norm(r, axis=1)
        beyond = (distance - _REACH_SHARE * (a + b)) / _SOFT_M
        within = distance - _SOFT_M * np.logaddexp(0.0, beyond)
        r = r * (within / distance)[:, None]
        elbow = np.arccos(np.clip((within**2 - a * a - b * b) / (2 * a * b), -1.0, 1.0))
        # palm in the axes of the upper arm: forward and up
        forward, up = b * np.sin(elbow), -a - b * np.cos(elbow)
        abduction = np.arcsin(np.clip(sign * r[:, 1] / -up, -1.0, 1.0))
        flexion = np.arctan2(r[:, 2], r[:, 0]) - np.arctan2(np.cos(abduction) * up, forward)
        return (flexion + np.pi) % (2 * np.pi) - np.pi, abduction, elbow


def hold_rails(
    acts: Sequence[HoldRail], rails: Sequence[Rail], model: mujoco.MjModel, pose: Posture, p_pelvis: Array, t: Array
) -> tuple[Posture, Array]:
    """The posture with a hand on each rail.

    Args:
        acts: Acts of holding a rail.
        rails: Their rails.
        model: Compiled model of the wearer.
        pose: Posture without a rail.
        p_pelvis: (N, 3) m, pelvis in the world.
        t: (N,) uniform s.

    Raises:
        ConfigError: The walker does not pass a rail, or runs into it.

    Returns:
        The posture; (acts,) m, largest distance from the palm to its rail while it is held.
    """
    gaps = []
    dt = float(t[1] - t[0])
    for act, rail in zip(acts, rails):
        sign, side = (1.0, "l") if act.side == "left" else (-1.0, "r")
        arm = Arm.of(model, side)
        s = smooth_gaussian(rail.layout.way.project(p_pelvis[:, :2]), _PLACE_SMOOTHING_S, dt)
        # first and last instant at which the pelvis is on the stretch of the rail
        along = np.flatnonzero((s >= act.at_m) & (s <= act.at_m + act.for_m))
        if not len(along):
            raise ConfigError("gait", "acts.at_m", act.at_m, "a place that the walker passes")
        begin, end = t[along[0]], t[along[-1]]
        held = ease((t - begin) / _REACH_S + 0.5) * ease((end - t) / _REACH_S + 0.5)
        joints = dict(pose.joints)
        joints["lumbar_bending"] = joints["lumbar_bending"] - sign * _LEAN_RAD * held
        joints["neck_bending"] = joints["neck_bending"] + sign * _LEAN_RAD * held
        R_pelvis = from_euler(pose.pelvis)
        R_torso = (
            R_pelvis
            @ rot_y(joints["lumbar_flexion"])
            @ rot_x(joints["lumbar_bending"])
            @ rot_z(joints["lumbar_rotation"])
        )
        shoulder = p_pelvis + R_pelvis @ arm.p_torso_in_pelvis + R_torso @ arm.p_shoulder_in_torso
        beside = smooth_gaussian(rail.layout.way.project(shoulder[:, :2]), _PLACE_SMOOTHING_S, dt)
        near = np.linalg.norm((rail.points(beside) - p_pelvis)[held > _HELD, :2], axis=1).min(initial=np.inf)
        if near < _NEAREST_M:
            valid = f"farther: the walker comes as near to the rail as {1e3 * near:.0f} mm"
            raise ConfigError("gait", "acts.away_m", act.away_m, valid)
        target = rail.points(beside + _hand_ahead(arm, rail, beside, shoulder, dt))
        r = np.einsum("nji,nj->ni", R_torso, target - shoulder)
        angles = dict(zip(("shoulder_flexion", "shoulder_abduction", "elbow_flexion"), arm.solve(r)))
        for joint, angle in angles.items():
            name = f"{joint}_{side}"
            joints[name] = joints[name] + held * (angle - joints[name])
        pose = replace(pose, joints=joints)
        reach = _REACH_SHARE * (arm.upper_m + arm.lower_m)
        distance = np.linalg.norm(r[held > _HELD], axis=1)
        gaps.append(float(np.max(distance - reach, initial=0.0)))
    return pose, np.array(gaps)


def _hand_ahead(arm: Arm, rail: Rail, s: Array, shoulder: Array, dt: float) -> Array:
    """(N,) m, how far before the shoulder a hand is on a rail: as far as an elbow that is bent a little allows.

    Where the rail is too far away for that, it is the nearest place.

    Args:
        arm: The arm.
        rail: The rail.
        s: (N,) m, arc length of the shoulder.
        shoulder: (N, 3) m, in the world.
        dt: Time between rows, s.
    """
    side = rail.points(s) - shoulder
    choices = np.arange(*_AHEAD_RANGE_M, _CHOICE_M)[:, None]
    above = np.interp(s + choices, rail.grid, rail.height) - shoulder[:, 2]
    distance = np.sqrt(choices**2 + np.sum(side[:, :2] ** 2, axis=1) + above**2)
    near = distance < _STRETCH * (arm.upper_m + arm.lower_m)
    farthest = len(choices) - 1 - np.argmax(near[::-1], axis=0)
    chosen = np.where(near.any(axis=0), farthest, np.argmin(distance, axis=0))
    return smooth_gaussian(choices[chosen, 0], _PLACE_SMOOTHING_S, dt)


def check_reach(acts: Sequence[HoldRail], gaps: Array) -> None:
    """Refuses a rail that the hand does not reach.

    Args:
        acts: Acts of holding a rail.
        gaps: (acts,) m, distance by which each rail is out of reach.

    Raises:
        ConfigError: The message names the distance.
    """
    for act, gap in zip(acts, gaps.tolist()):
        if gap > _GAP_M:
            valid = f"nearer or higher: the hand misses the rail by {1e3 * gap:.0f} mm"
            raise ConfigError("gait", "acts.away_m", act.away_m, valid)
