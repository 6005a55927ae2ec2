"""Motion of pelvis, trunk, head and arms with the feet, and the walker's gaze.

The gaze is along the path, down at the ground of the next steps, or around. The head is held still in space between
movements, as balance reflexes do (Pozzo, Berthoz & Lefort 1990); the chest follows it less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import Gaze
from stridetwin.sim.gait.foot_path import FootPath
from stridetwin.sim.gait.footsteps import Rhythm
from stridetwin.sim.kinematics.smooth import ease, smoothed
from stridetwin.streams.samples import Array
from stridetwin.streams.so3 import from_euler
from stridetwin.streams.terrain_truth import Strip, profile_height


@dataclass(frozen=True, kw_only=True)
class GazeParameters:
    """Rotations of head and chest with the gaze; chosen by hand where no source is named."""

    level_pitch: float = 0.06  # rad, down
    by_climb: float = 0.45  # rad per unit of slope: on stairs and ramps the head pitches down farther
    ahead_s: float = 1.8  # two steps (Marigold & Patla 2007: mostly this far, 1.5-2 s)
    ahead_min_m: float = 1.1
    head_share: float = 0.45  # of a downward gaze; the eyes do the rest
    eyes_legs: float = 1.78  # height of the eyes, leg lengths
    pitch_smoothing_s: float = 0.22
    hold_s: float = 1.1  # median time for which a direction is held
    hold_spread: float = 0.5  # SD of its logarithm
    hold_range_s: tuple[float, float] = (0.35, 4.0)
    yaw_sd: float = np.radians(22.0)  # of the held directions
    yaw_max: float = np.radians(40.0)
    pitch_sd: float = 0.24  # rad
    pitch_min: float = -0.62  # rad
    pitch_max: float = 0.75  # rad
    move_s: float = 0.22  # duration of a movement between two directions
    move_s_per_rad: float = 0.32  # and more for a larger one
    sway_onset_s: float = 1.0  # the head is still for this time, and reaches full sway after twice this time
    head_limit_rad: float = 1.0  # neck relative to trunk; approached, never exceeded
    chest_yaw: float = 0.22  # share of the head's rotation
    chest_pitch: float = 0.12  # likewise
    chest_smoothing_s: float = 0.30


_GAZE = GazeParameters()


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
    """Rotations of head and chest at (N,) m along the way, with (N,) mean slope nearby; the rest as for `posture`."""
    dt = float(t[1] - t[0])
    usual = _GAZE.level_pitch + _GAZE.by_climb * np.abs(climb)
    pitch, yaw = usual, np.zeros_like(t)
    if gaze.kind == "terrain":
        toward = smoothed(_toward_ground(s, dt, profile, leg_m), _GAZE.pitch_smoothing_s, dt)
        pitch = usual - _GAZE.level_pitch + toward
    elif gaze.kind == "wandering":
        away, yaw = _wander(t, rng)
        pitch = usual + away
    if gaze == Gaze():
        return Look(head_pitch=pitch, head_yaw=yaw, chest_pitch=np.zeros_like(t), chest_yaw=np.zeros_like(t))
    yaw_sway, pitch_sway = _sway(gaze, t)
    pitch, yaw = pitch + pitch_sway, yaw + yaw_sway
    pitch, yaw = (_GAZE.head_limit_rad * np.tanh((x + more) / _GAZE.head_limit_rad)
                  for x, more in ((pitch, gaze.pitch_rad), (yaw, gaze.yaw_rad)))  # fmt: skip
    return Look(
        head_pitch=pitch,
        head_yaw=yaw,
        chest_pitch=_GAZE.chest_pitch * smoothed(pitch - usual, _GAZE.chest_smoothing_s, dt),
        chest_yaw=_GAZE.chest_yaw * smoothed(yaw, _GAZE.chest_smoothing_s, dt),
    )


def _toward_ground(s: Array, dt: float, profile: Sequence[Strip], leg_m: float) -> Array:
    """(N,) pitch of a head that looks at the ground where the walker will be in `_GAZE.ahead_s`."""
    rows = np.arange(len(s))
    ahead = np.maximum(np.interp(rows + _GAZE.ahead_s / dt, rows, s) - s, _GAZE.ahead_min_m)
    below = _GAZE.eyes_legs * leg_m + profile_height(profile, s) - profile_height(profile, s + ahead)
    return _GAZE.head_share * np.arctan2(np.maximum(below, 0.0), ahead)


def _wander(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(N,) pitch and (N,) yaw offsets: quick movements between directions that are held for a while."""
    angles = [np.zeros_like(t), np.zeros_like(t)]
    now, last = t[0], np.zeros(2)
    while now < t[-1]:
        now += float(np.clip(_GAZE.hold_s * np.exp(_GAZE.hold_spread * rng.standard_normal()), *_GAZE.hold_range_s))
        pitch = np.clip(rng.normal(0.0, _GAZE.pitch_sd), _GAZE.pitch_min, _GAZE.pitch_max)
        yaw = np.clip(rng.normal(0.0, _GAZE.yaw_sd), -_GAZE.yaw_max, _GAZE.yaw_max)
        goal = np.array([pitch, yaw])
        move = _GAZE.move_s + _GAZE.move_s_per_rad * float(np.hypot(*(goal - last)))
        for angle, step in zip(angles, goal - last):
            angle += step * ease((t - now) / move)
        now, last = now + move, goal
    return angles[0], angles[1]


def _sway(gaze: Gaze, t: Array) -> tuple[Array, Array]:
    """(N,) yaw and (N,) pitch of a commanded periodic head motion."""
    phase, share = 2 * np.pi * gaze.sway_hz * (t - t[0]), ease((t - t[0]) / _GAZE.sway_onset_s - 1.0)
    return gaze.sway_yaw_rad * share * np.sin(phase), -gaze.sway_pitch_rad * share * np.cos(phase)


@dataclass(frozen=True, kw_only=True)
class PostureParameters:
    """Orientation of pelvis and trunk, and the swing of the arms; chosen by hand where no source is named."""

    standing_tilt_rad: float = np.radians(11.0)  # of the pelvis
    tilt_by_effort: float = 0.20  # rad per unit of slope uphill
    upright_down: float = 0.31  # rad per unit of slope: downhill the pelvis tilts back
    list_peak: float = 0.34  # share of a step after touch-down
    torso_lean: float = 0.03  # rad
    lean_by_effort: float = 0.26  # rad per unit of slope uphill
    effort_max: float = 0.7  # slope
    torso_against_pelvis: tuple[float, float] = (0.6, 0.35)  # share of the pelvis' yaw and roll, opposite
    head_with_pelvis: float = 0.1  # share of the pelvis' yaw
    arm_swing_rad: float = 0.62  # per leg length of distance between the feet
    arm_forward: float = 0.8  # forward swing relative to backward swing
    arm_flexion_rad: float = 0.02  # mean
    arm_abduction_rad: float = 0.16
    elbow_flexion_rad: float = 0.42  # mean
    elbow_swing_rad: float = 0.33
    look_ahead_m: float = 1.6  # twice the distance over which the slope ahead counts
    look_behind_m: float = 0.3
    climb_smoothing_s: float = 0.35
    turn_smoothing_s: float = 0.15
    swing_smoothing_s: float = 0.03
    head_leads_s: float = 0.40  # before a turn (Grasso et al. 1996: 0.2-0.5 s)
    trunk_leads_s: float = 0.15


_POSTURE = PostureParameters()


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
    rhythm: Rhythm, paths: dict[str, FootPath], leg_m: float, t: Array, profile: Sequence[Strip], gaze: Gaze,
    rng: np.random.Generator,
) -> Posture:  # fmt: skip
    """Posture for the motion of the feet; the styles of the steps give the amplitudes of the pelvis.

    Args:
        rhythm: Steps.
        paths: Path of each foot.
        leg_m: Hip centre to sole, m.
        t: (N,) uniform s.
        profile: Ground along the way.
        gaze: Gaze of the walker.
        rng: Draws the directions of a wandering gaze; other kinds do not use it.
    """
    dt = float(t[1] - t[0])
    heading = smoothed((paths["l"].heading + paths["r"].heading) / 2, _POSTURE.turn_smoothing_s, dt)
    apart = paths["r"].p_foot_in_world - paths["l"].p_foot_in_world
    ahead = (apart[:, 0] * np.cos(heading) + apart[:, 1] * np.sin(heading)) / leg_m
    stride = smoothed(ahead, _POSTURE.swing_smoothing_s, dt)
    left_first = float(rhythm.steps[0].foot == "l")  # a side of the pelvis is highest early in its stance
    list_to_left = np.cos(np.pi * (rhythm.phase(t) - left_first - _POSTURE.list_peak))
    s = (paths["l"].s + paths["r"].s) / 2
    climb = smoothed(_incline(s, profile), _POSTURE.climb_smoothing_s, dt)
    effort = np.clip(climb, 0.0, _POSTURE.effort_max)
    yaw = rhythm.styled(t, "turn", 0.0) * stride
    roll = rhythm.styled(t, "list_", 0.0) * list_to_left
    pitch = rhythm.styled(t, "tilt", _POSTURE.standing_tilt_rad) + _POSTURE.tilt_by_effort * effort
    pitch = pitch + _POSTURE.upright_down * np.minimum(climb, 0.0)
    eyes = look(gaze, t, s, climb, profile, leg_m, rng)
    torso_pitch = _POSTURE.torso_lean + _POSTURE.lean_by_effort * effort + eyes.chest_pitch
    trunk = _ahead_of_time(heading, _POSTURE.trunk_leads_s, dt) - heading
    head = _ahead_of_time(heading, _POSTURE.head_leads_s, dt) - heading
    # from the heading's own frame, so that several full turns do not matter
    R_pelvis = from_euler(np.stack([yaw, pitch, roll], -1))
    against_yaw, against_roll = _POSTURE.torso_against_pelvis
    R_torso = from_euler(np.stack([trunk - against_yaw * yaw + eyes.chest_yaw, torso_pitch, -against_roll * roll], -1))
    head_yaw = head + _POSTURE.head_with_pelvis * yaw + eyes.head_yaw
    R_head = from_euler(np.stack([head_yaw, eyes.head_pitch, np.zeros_like(yaw)], -1))
    joints = {
        **_three_axes("lumbar", np.swapaxes(R_pelvis, 1, 2) @ R_torso),
        **_three_axes("neck", np.swapaxes(R_torso, 1, 2) @ R_head),
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        swing = sign * stride  # the left arm moves with the right foot
        flexion = torso_pitch + _POSTURE.arm_swing_rad * swing * np.where(swing > 0, _POSTURE.arm_forward, 1.0)
        joints[f"shoulder_flexion_{side}"] = smoothed(
            flexion + _POSTURE.arm_flexion_rad, _POSTURE.swing_smoothing_s, dt
        )
        joints[f"shoulder_abduction_{side}"] = np.full_like(yaw, _POSTURE.arm_abduction_rad)
        joints[f"elbow_flexion_{side}"] = _POSTURE.elbow_flexion_rad + _POSTURE.elbow_swing_rad * swing
    return Posture(pelvis=np.stack([heading + yaw, pitch, roll], -1), joints=joints)


def _incline(s: Array, profile: Sequence[Strip]) -> Array:
    """(N,) mean slope of the ground from just behind the feet at s to the point of gaze."""
    ahead, behind = _POSTURE.look_ahead_m / 2, _POSTURE.look_behind_m
    return (profile_height(profile, s + ahead) - profile_height(profile, s - behind)) / (ahead + behind)


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
