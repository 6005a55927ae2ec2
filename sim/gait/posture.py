"""Motion of pelvis, trunk, head and arms with the feet, and the walker's gaze.

The gaze is along the path, down at the ground of the next steps, or around. The head is held still in space between
movements, as balance reflexes do (Pozzo, Berthoz & Lefort 1990); the chest follows it less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.config import Gaze
from stridetwin.sim.gait.foot_path import FootPath
from stridetwin.sim.gait.footsteps import Rhythm
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.sim.world.route import Strip
from stridetwin.streams.samples import Array
from stridetwin.streams.so3 import from_euler

_LEVEL_PITCH = 0.06
_BY_CLIMB = 0.45  # on stairs and ramps the head pitches down farther
_AHEAD_S, _AHEAD_MIN_M = 1.8, 1.1  # two steps (Marigold & Patla 2007: mostly this far, 1.5-2 s)
_HEAD_SHARE = 0.45  # of a downward gaze; the eyes do the rest
_EYES_LEGS = 1.78  # height of the eyes, in leg lengths
_PITCH_SMOOTHING_S = 0.22
_HOLD_S, _HOLD_SPREAD = 1.1, 0.5  # median, and SD of its logarithm
_YAW_SD, _YAW_MAX = np.radians(22.0), np.radians(40.0)
_PITCH_SD, _PITCH_MIN, _PITCH_MAX = 0.24, -0.62, 0.75
_MOVE_S, _MOVE_S_PER_RAD = 0.22, 0.32
_SWAY_ONSET_S = 1.0  # the head is still for this time, and reaches full sway after twice this time
_HEAD_LIMIT_RAD = 1.0  # neck relative to trunk; approached, never exceeded
_CHEST_YAW, _CHEST_PITCH = 0.22, 0.12  # of the head's rotation
_CHEST_SMOOTHING_S = 0.30


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """Rotations on a time grid, (N,) rad.

    Attributes:
        head_pitch: Of the head in the world, down positive.
        head_yaw: Of the head relative to the way, left positive.
        chest_pitch: Added to the pitch of the chest.
        chest_yaw: Added to the yaw of the chest.
    """

    head_pitch: Array
    head_yaw: Array
    chest_pitch: Array
    chest_yaw: Array


def look(
    gaze: Gaze, t: Array, s: Array, climb: Array, profile: Sequence[Strip], leg_m: float, rng: np.random.Generator
) -> Look:  # fmt: skip
    """Rotations of head and chest.

    Args:
        gaze: Kind of gaze and its offsets.
        t: (N,) uniform s.
        s: (N,) m, the walker along the way.
        climb: (N,) mean slope of the ground nearby.
        profile: Ground along the way.
        leg_m: Hip centre to sole, m.
        rng: Draws the directions of a wandering gaze; other kinds do not use it.
    """
    dt = float(t[1] - t[0])
    usual = _LEVEL_PITCH + _BY_CLIMB * np.abs(climb)
    pitch, yaw = usual, np.zeros_like(t)
    if gaze.kind == "terrain":
        pitch = usual - _LEVEL_PITCH + _smooth(_toward_ground(s, dt, profile, leg_m), _PITCH_SMOOTHING_S, dt)
    elif gaze.kind == "wandering":
        away, yaw = _wander(t, rng)
        pitch = usual + away
    if gaze == Gaze():
        return Look(head_pitch=pitch, head_yaw=yaw, chest_pitch=np.zeros_like(t), chest_yaw=np.zeros_like(t))
    yaw_sway, pitch_sway = _sway(gaze, t)
    pitch, yaw = pitch + pitch_sway, yaw + yaw_sway
    pitch, yaw = (_HEAD_LIMIT_RAD * np.tanh((x + more) / _HEAD_LIMIT_RAD)
                  for x, more in ((pitch, gaze.pitch_rad), (yaw, gaze.yaw_rad)))  # fmt: skip
    return Look(
        head_pitch=pitch,
        head_yaw=yaw,
        chest_pitch=_CHEST_PITCH * _smooth(pitch - usual, _CHEST_SMOOTHING_S, dt),
        chest_yaw=_CHEST_YAW * _smooth(yaw, _CHEST_SMOOTHING_S, dt),
    )


def _toward_ground(s: Array, dt: float, profile: Sequence[Strip], leg_m: float) -> Array:
    """(N,) pitch of a head that looks at the ground where the walker will be in `_AHEAD_S`."""
    at = [v for strip in profile for v in (strip.s0, strip.s1)]
    z = [v for strip in profile for v in (strip.z0, strip.z1)]
    rows = np.arange(len(s))
    ahead = np.maximum(np.interp(rows + _AHEAD_S / dt, rows, s) - s, _AHEAD_MIN_M)
    below = _EYES_LEGS * leg_m + np.interp(s, at, z) - np.interp(s + ahead, at, z)
    return _HEAD_SHARE * np.arctan2(np.maximum(below, 0.0), ahead)


def _wander(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(N,) pitch and (N,) yaw offsets: quick movements between directions that are held for a while."""
    angles = [np.zeros_like(t), np.zeros_like(t)]
    now, last = t[0], np.zeros(2)
    while now < t[-1]:
        now += float(np.clip(_HOLD_S * np.exp(_HOLD_SPREAD * rng.standard_normal()), 0.35, 4.0))
        pitch = np.clip(rng.normal(0.0, _PITCH_SD), _PITCH_MIN, _PITCH_MAX)
        yaw = np.clip(rng.normal(0.0, _YAW_SD), -_YAW_MAX, _YAW_MAX)
        goal = np.array([pitch, yaw])
        move = _MOVE_S + _MOVE_S_PER_RAD * float(np.hypot(*(goal - last)))
        for turn, step in zip(angles, goal - last):
            turn += step * ease((t - now) / move)
        now, last = now + move, goal
    return angles[0], angles[1]


def _sway(gaze: Gaze, t: Array) -> tuple[Array, Array]:
    """(N,) yaw and (N,) pitch of a commanded periodic head motion."""
    phase, share = 2 * np.pi * gaze.sway_hz * (t - t[0]), ease((t - t[0]) / _SWAY_ONSET_S - 1.0)
    return gaze.sway_yaw_rad * share * np.sin(phase), -gaze.sway_pitch_rad * share * np.cos(phase)


def _smooth(x: Array, sigma_s: float, dt: float) -> Array:
    return gaussian_filter1d(x, sigma_s / dt, mode="nearest", truncate=5.0)


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
    heading = _smoothed((paths["l"].heading + paths["r"].heading) / 2, _TURN_SMOOTHING_S, dt)
    apart = paths["r"].p_foot_in_world - paths["l"].p_foot_in_world
    stride = _smoothed((apart[:, 0] * np.cos(heading) + apart[:, 1] * np.sin(heading)) / leg_m, 0.03, dt)
    left_first = float(rhythm.steps[0].foot == "l")  # a side of the pelvis is highest early in its stance
    list_to_left = np.cos(np.pi * (rhythm.phase(t) - left_first - _LIST_PEAK))
    s = (paths["l"].s + paths["r"].s) / 2
    climb = _smoothed(_incline(s, profile), 0.35, dt)
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
            joints[name] = _smoothed(value, 0.03, dt)
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


def _smoothed(x: Array, sigma_s: float, dt: float) -> Array:
    return gaussian_filter1d(x, sigma_s / dt, axis=0, mode="nearest", truncate=5.0)
