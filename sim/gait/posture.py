"""Motion of pelvis, trunk, head and arms that goes with the feet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.config import Gaze
from stridetwin.sim.gait.foot_path import FootPath
from stridetwin.sim.gait.gaze import look
from stridetwin.sim.gait.rhythm import Rhythm
from stridetwin.sim.rotation import from_euler
from stridetwin.sim.route import Strip
from stridetwin.streams.samples import Array

STANDING_TILT_RAD = np.radians(11.0)
_ARM_SWING_RAD = 0.62  # per leg length of distance between the feet
_ELBOW_SWING_RAD = 0.33
_LIST_PEAK = 0.34  # share of a step after touch-down
_TORSO_LEAN = 0.03
_LOOK_AHEAD_M = 1.6
_UPRIGHT_DOWN = 0.31  # rad per unit of slope: downhill the pelvis tilts back
_TURN_SMOOTHING_S = 0.15
_HEAD_LEADS_S = 0.40  # before a turn (Grasso et al. 1996: 0.2-0.5 s)
_TRUNK_LEADS_S = 0.15


@dataclass(frozen=True, kw_only=True, eq=False)
class Posture:
    """Orientations and angles on a time grid.

    Attributes:
        pelvis: (N, 3) yaw, pitch, roll, rad.
        joints: (N,) rad by joint name: lumbar, neck, shoulder and elbow.
    """

    pelvis: Array
    joints: dict[str, Array]


def posture(
    rhythm: Rhythm,
    paths: dict[str, FootPath],
    leg_m: float,
    t: Array,
    profile: Sequence[Strip],
    gaze: Gaze,
    rng: np.random.Generator,
) -> Posture:
    """Posture for the motion of the feet.

    Args:
        rhythm: Steps; their styles give the amplitudes of the pelvis.
        paths: Path of each foot.
        leg_m: Hip centre to sole, m.
        t: (N,) uniform s.
        profile: Ground along the way.
        gaze: Gaze of the walker.
        rng: Draws the directions of a wandering gaze.
    """
    dt = float(t[1] - t[0])
    heading = _smooth((paths["l"].heading + paths["r"].heading) / 2, _TURN_SMOOTHING_S, dt)
    apart = paths["r"].p_foot_in_world - paths["l"].p_foot_in_world
    stride = _smooth((apart[:, 0] * np.cos(heading) + apart[:, 1] * np.sin(heading)) / leg_m, 0.03, dt)
    left_first = float(rhythm.steps[0].foot == "l")  # a side of the pelvis is highest early in its stance
    list_to_left = np.cos(np.pi * (rhythm.phase(t) - left_first - _LIST_PEAK))
    s = (paths["l"].s + paths["r"].s) / 2
    climb = _smooth(_incline(s, profile), 0.35, dt)
    effort = np.clip(climb, 0.0, 0.7)
    yaw = rhythm.styled(t, "turn", 0.0) * stride
    roll = rhythm.styled(t, "list_", 0.0) * list_to_left
    pitch = rhythm.styled(t, "tilt", STANDING_TILT_RAD) + 0.20 * effort + _UPRIGHT_DOWN * np.minimum(climb, 0.0)
    eyes = look(gaze, t, s, climb, profile, leg_m, rng)
    torso_pitch = _TORSO_LEAN + 0.26 * effort + eyes.chest_pitch
    trunk, head = (_ahead_of_time(heading, lead, dt) - heading for lead in (_TRUNK_LEADS_S, _HEAD_LEADS_S))
    # from the heading's own frame, so that several full turns do not matter
    R_pelvis = from_euler(np.stack([yaw, pitch, roll], -1))
    R_torso = from_euler(np.stack([trunk - 0.6 * yaw + eyes.chest_yaw, torso_pitch, -0.35 * roll], -1))
    R_head = from_euler(np.stack([head + 0.1 * yaw + eyes.head_yaw, eyes.head_pitch, np.zeros_like(yaw)], -1))
    joints = {
        **_three_axes("lumbar", np.swapaxes(R_pelvis, 1, 2) @ R_torso),
        **_three_axes("neck", np.swapaxes(R_torso, 1, 2) @ R_head),
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        swing = sign * stride  # the left arm moves with the right foot
        joints[f"shoulder_flexion_{side}"] = torso_pitch + _ARM_SWING_RAD * swing * np.where(swing > 0, 0.8, 1.0) + 0.02
        joints[f"shoulder_abduction_{side}"] = np.full_like(yaw, 0.16)
        joints[f"elbow_flexion_{side}"] = 0.42 + _ELBOW_SWING_RAD * swing
    for name, value in joints.items():
        if name.startswith("shoulder_flexion"):
            joints[name] = _smooth(value, 0.03, dt)
    return Posture(pelvis=np.stack([heading + yaw, pitch, roll], -1), joints=joints)


def _incline(s: Array, profile: Sequence[Strip]) -> Array:
    """(N,) mean slope of the ground from just behind the feet at s to the point of gaze."""
    at = [v for strip in profile for v in (strip.s0, strip.s1)]
    z = [v for strip in profile for v in (strip.z0, strip.z1)]
    ahead, behind = np.interp(s + _LOOK_AHEAD_M / 2, at, z), np.interp(s - 0.3, at, z)
    return (ahead - behind) / (_LOOK_AHEAD_M / 2 + 0.3)


def _ahead_of_time(x: Array, lead_s: float, dt: float) -> Array:
    """(N,) value of x after `lead_s`; constant at the end."""
    rows = np.arange(len(x))
    return np.interp(rows + lead_s / dt, rows, x)


def _three_axes(name: str, R: Array) -> dict[str, Array]:
    """Angles of the hinges flexion (y), bending (x), rotation (z), in this order, that give (N, 3, 3) rotations."""
    bending = -np.arcsin(np.clip(R[:, 1, 2], -1.0, 1.0))
    return {
        f"{name}_flexion": np.arctan2(R[:, 0, 2], R[:, 2, 2]),
        f"{name}_bending": bending,
        f"{name}_rotation": np.arctan2(R[:, 1, 0], R[:, 1, 1]),
    }


def _smooth(x: Array, sigma_s: float, dt: float) -> Array:
    return gaussian_filter1d(x, sigma_s / dt, axis=0, mode="nearest", truncate=5.0)
