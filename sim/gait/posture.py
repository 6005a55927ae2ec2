"""What pelvis, trunk, head and arms do while the feet walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.rotation import from_euler
from stridetwin.streams.samples import Array

PELVIS_TILT_RAD = np.radians(12.0)
_PELVIS_YAW_RAD = 0.075  # at a full step
_PELVIS_LIST_RAD = 0.035
_ARM_SWING_RAD = 0.42
_TORSO_LEAN = 0.03
_LOOK_AHEAD_M = 1.6


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
    p_foot: dict[str, Array],
    shares: dict[str, Array],
    step_m: float,
    dt: float,
    height: Callable[[Array], Array],
) -> Posture:
    """Posture that goes with the feet.

    Args:
        p_foot: (N, 3) path of each foot, world.
        shares: (N,) share of the load on each foot.
        step_m: Length of a full step.
        dt: Time between rows, s.
        height: Height of the ground at (..., 2) points.
    """
    stride = _smooth((p_foot["r"] - p_foot["l"])[:, 0] / step_m, 0.03, dt)
    list_to_left = _smooth(shares["l"] - shares["r"], 0.05, dt)
    middle = 0.5 * (p_foot["l"] + p_foot["r"])
    climb = _smooth(_incline(middle, height), 0.35, dt)
    effort = np.clip(climb, 0.0, 0.7)
    yaw = _PELVIS_YAW_RAD * stride
    roll = _PELVIS_LIST_RAD * list_to_left
    pitch = PELVIS_TILT_RAD + 0.20 * effort
    torso_pitch = _TORSO_LEAN + 0.26 * effort
    look_down = 0.06 + 0.45 * np.abs(climb)
    R_pelvis = from_euler(np.stack([yaw, pitch, roll], -1))
    R_torso = from_euler(np.stack([-0.6 * yaw, torso_pitch, -0.35 * roll], -1))
    R_head = from_euler(np.stack([0.1 * yaw, look_down, np.zeros_like(yaw)], -1))
    joints = {
        **_three_axes("lumbar", np.swapaxes(R_pelvis, 1, 2) @ R_torso),
        **_three_axes("neck", np.swapaxes(R_torso, 1, 2) @ R_head),
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        swing = sign * stride  # the left arm goes with the right foot
        joints[f"shoulder_flexion_{side}"] = torso_pitch + _ARM_SWING_RAD * swing * np.where(swing > 0, 0.8, 1.0) + 0.02
        joints[f"shoulder_abduction_{side}"] = np.full_like(yaw, 0.16)
        joints[f"elbow_flexion_{side}"] = 0.42 + 0.22 * swing
    for name, value in joints.items():
        if name.startswith("shoulder_flexion"):
            joints[name] = _smooth(value, 0.03, dt)
    return Posture(pelvis=np.stack([yaw, pitch, roll], -1), joints=joints)


def _incline(middle: Array, height: Callable[[Array], Array]) -> Array:
    """(N,) mean slope of the ground from just behind the feet to the place that the walker looks at."""
    ahead = height(np.stack([middle[:, 0] + _LOOK_AHEAD_M / 2, np.zeros(len(middle))], -1))
    behind = height(np.stack([middle[:, 0] - 0.3, np.zeros(len(middle))], -1))
    return (ahead - behind) / (_LOOK_AHEAD_M / 2 + 0.3)


def _three_axes(name: str, R: Array) -> dict[str, Array]:
    """Angles of the hinges flexion (y), bending (x), rotation (z), in this order, that make (N, 3, 3) rotations."""
    bending = -np.arcsin(np.clip(R[:, 1, 2], -1.0, 1.0))
    return {
        f"{name}_flexion": np.arctan2(R[:, 0, 2], R[:, 2, 2]),
        f"{name}_bending": bending,
        f"{name}_rotation": np.arctan2(R[:, 1, 0], R[:, 1, 1]),
    }


def _smooth(x: Array, sigma_s: float, dt: float) -> Array:
    return gaussian_filter1d(x, sigma_s / dt, axis=0, mode="nearest", truncate=5.0)
