"""Motion of pelvis, trunk, head and arms with the feet, and the walker's gaze.

The gaze is along the path, down at the ground of the next steps, or around; the chest follows it less. Between
movements the head sways with the stride alone (`body_sway`), and pitches against its own rise and fall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stridetwin.sim.config import Gaze
from stridetwin.sim.gait.body_sway import Sway
from stridetwin.sim.gait.foot_path import FootPath
from stridetwin.sim.gait.footsteps import Rhythm
from stridetwin.sim.gait.look_back import turn_back
from stridetwin.sim.kinematics.smooth import ease, smooth_gaussian
from stridetwin.streams.algebra.arrays import from_euler
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Strip, profile_height

# Rotations of head and chest with the gaze; chosen by hand where no source is named.
_LEVEL_PITCH_RAD = 0.06  # down
_PITCH_BY_CLIMB = 0.45  # rad per unit of slope: on stairs and ramps the head pitches down farther
_LOOK_AHEAD_S = 1.8  # two steps (Marigold & Patla 2007: mostly this far, 1.5-2 s)
_MIN_LOOK_AHEAD_M = 1.1  # for slow walkers
_HEAD_SHARE = 0.45  # of a downward gaze; the eyes do the rest
_EYE_HEIGHT_LEGS = 1.78  # height of the eyes, leg lengths
_PITCH_SMOOTHING_S = 0.22  # SD of the filter of the head's pitch towards the ground
_HOLD_S = 1.1  # median time for which a direction is held
_HOLD_LOG_SD = 0.5  # SD of its logarithm
_HOLD_RANGE_S = (0.35, 4.0)  # limits of that time
_YAW_SD_RAD = np.radians(22.0)  # of the held directions
_MAX_YAW_RAD = np.radians(40.0)  # limit of the held directions
_PITCH_SD_RAD = 0.24  # of the held directions
_MIN_PITCH_RAD = -0.62  # limit of the held directions, up
_MAX_PITCH_RAD = 0.75  # likewise, down
_MOVE_S = 0.22  # duration of a movement between two directions
_MOVE_S_PER_RAD = 0.32  # and more for a larger one
_SWAY_ONSET_S = 1.0  # the head is still for this time, and reaches full sway after twice this time
_MAX_NECK_RAD = 1.0  # neck relative to trunk; approached, never exceeded
_CHEST_YAW_SHARE = 0.22  # share of the head's rotation
_CHEST_PITCH_SHARE = 0.12  # likewise
_CHEST_SMOOTHING_S = 0.30  # SD of the filter of the chest's share


@dataclass(frozen=True, kw_only=True, eq=False)
class GazeMotion:
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


def plan_gaze(
    gaze: Gaze, t: Array, s: Array, climb: Array, profile: Sequence[Strip], leg_m: float, rng: np.random.Generator
) -> GazeMotion:
    """Rotations of head and chest with the walker's gaze.

    Args:
        gaze: Gaze of the walker.
        t: (N,) uniform s.
        s: (N,) m along the way.
        climb: (N,) mean slope of the ground nearby.
        profile: Ground along the way.
        leg_m: Hip centre to sole, m.
        rng: Draws the directions of a wandering gaze; other kinds do not use it.
    """
    dt = float(t[1] - t[0])
    usual = _LEVEL_PITCH_RAD + _PITCH_BY_CLIMB * np.abs(climb)  # pitch of a head that looks along the path
    pitch, yaw = usual, np.zeros_like(t)
    if gaze.kind == "terrain":
        toward_ground = smooth_gaussian(_ground_gaze_pitch(s, dt, profile, leg_m), _PITCH_SMOOTHING_S, dt)
        pitch = usual - _LEVEL_PITCH_RAD + toward_ground  # in place of the pitch on the level
    elif gaze.kind == "wandering":
        away, yaw = _draw_gaze_shifts(t, rng)
        pitch = usual + away
    if gaze == Gaze():  # along the path: the chest does not follow, and the neck is far from its limit
        return GazeMotion(head_pitch=pitch, head_yaw=yaw, chest_pitch=np.zeros_like(t), chest_yaw=np.zeros_like(t))
    # sway of the head: its phase, and the share of its amplitude, which rises from 0 to 1
    phase, share = 2 * np.pi * gaze.sway_hz * (t - t[0]), ease((t - t[0]) / _SWAY_ONSET_S - 1.0)
    pitch = pitch - gaze.sway_pitch_rad * share * np.cos(phase)
    yaw = yaw + gaze.sway_yaw_rad * share * np.sin(phase)
    # with the constant direction of the gaze, softly limited to what the neck can turn
    pitch = _MAX_NECK_RAD * np.tanh((pitch + gaze.pitch_rad) / _MAX_NECK_RAD)
    yaw = _MAX_NECK_RAD * np.tanh((yaw + gaze.yaw_rad) / _MAX_NECK_RAD)
    return GazeMotion(
        head_pitch=pitch,
        head_yaw=yaw,
        chest_pitch=_CHEST_PITCH_SHARE * smooth_gaussian(pitch - usual, _CHEST_SMOOTHING_S, dt),
        chest_yaw=_CHEST_YAW_SHARE * smooth_gaussian(yaw, _CHEST_SMOOTHING_S, dt),
    )


def _ground_gaze_pitch(s: Array, dt: float, profile: Sequence[Strip], leg_m: float) -> Array:
    """(N,) rad, pitch of a head that looks at the ground where the walker will be in `_LOOK_AHEAD_S`; eyes do the rest.

    Args:
        s: (N,) m along the way.
        dt: Time between rows, s.
        profile: Ground along the way.
        leg_m: Hip centre to sole, m.
    """
    # distance of that place along the way, and its depth below the eyes, m
    ahead = np.maximum(_advance_in_time(s, _LOOK_AHEAD_S, dt) - s, _MIN_LOOK_AHEAD_M)
    below = _EYE_HEIGHT_LEGS * leg_m + profile_height(profile, s) - profile_height(profile, s + ahead)
    return _HEAD_SHARE * np.arctan2(np.maximum(below, 0.0), ahead)


def _draw_gaze_shifts(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(N,) pitch and (N,) yaw of a wandering gaze at (N,) s, rad: quick movements between directions that are held.

    The time for which a direction is held is log-normal; the directions are normal, within limits.
    """
    angles = [np.zeros_like(t), np.zeros_like(t)]  # pitch, yaw
    now, last = t[0], np.zeros(2)  # end of the last movement, s, and the direction (pitch, yaw) that it reached
    while now < t[-1]:
        now += float(np.clip(_HOLD_S * np.exp(_HOLD_LOG_SD * rng.standard_normal()), *_HOLD_RANGE_S))
        pitch = np.clip(rng.normal(0.0, _PITCH_SD_RAD), _MIN_PITCH_RAD, _MAX_PITCH_RAD)
        yaw = np.clip(rng.normal(0.0, _YAW_SD_RAD), -_MAX_YAW_RAD, _MAX_YAW_RAD)
        goal = np.array([pitch, yaw])
        # s, duration of the movement, which adds a smooth step to each angle
        move = _MOVE_S + _MOVE_S_PER_RAD * float(np.hypot(*(goal - last)))
        for angle, step in zip(angles, goal - last):
            angle += step * ease((t - now) / move)
        now, last = now + move, goal
    return angles[0], angles[1]


# Orientation of pelvis and trunk, and the swing of the arms; chosen by hand where no source is named.
_STANDING_TILT_RAD = np.radians(11.0)  # of the pelvis
_TILT_BY_EFFORT = 0.20  # rad per unit of slope uphill
_TILT_BACK_BY_DESCENT = 0.31  # rad per unit of slope: downhill the pelvis tilts back
_TORSO_LEAN_RAD = 0.03  # forward, on level ground
_LEAN_BY_EFFORT = 0.26  # rad per unit of slope uphill
_MAX_EFFORT = 0.7  # slope
_ARM_SWING_RAD = 0.62  # per leg length of distance between the feet
_ARM_FORWARD = 0.8  # forward swing relative to backward swing
_ARM_FLEXION_RAD = 0.02  # mean
_ARM_ABDUCTION_RAD = 0.16  # constant
_ELBOW_FLEXION_RAD = 0.42  # mean
_ELBOW_SWING_RAD = 0.33  # per leg length of distance between the feet
_SLOPE_AHEAD_M = 0.8  # distance over which the slope ahead counts
_SLOPE_BEHIND_M = 0.3  # distance behind the walker over which the slope counts
_CLIMB_SMOOTHING_S = 0.35  # SD of the filter of that slope
_TURN_SMOOTHING_S = 0.15  # SD of the filter of the pelvis' heading
_SWING_SMOOTHING_S = 0.03  # SD of the filter of the swing of the arms
_HEAD_LEADS_S = 0.40  # before a turn (Grasso et al. 1996: 0.2-0.5 s)
_TRUNK_LEADS_S = 0.15  # likewise
_MAX_TRUNK_RAD, _MAX_HEAD_RAD = 0.35, 1.1  # limits of trunk and head before a pivot; approached, never exceeded


@dataclass(frozen=True, kw_only=True, eq=False)
class Posture:
    """Orientations and angles on a time grid.

    Attributes:
        pelvis: (N, 3) yaw, pitch, roll, rad.
        joints: (N,) rad by joint name: lumbar, neck, shoulder and elbow.
    """

    pelvis: Array
    joints: dict[str, Array]


def plan_posture(
    rhythm: Rhythm,
    paths: dict[str, FootPath],
    leg_m: float,
    t: Array,
    profile: Sequence[Strip],
    gaze: Gaze,
    sway: Sway,
    wave: Array,
    rng: np.random.Generator,
) -> Posture:
    """Posture for the motion of the feet: the sway of the stride about slower changes with ground, turns and gaze.

    Args:
        rhythm: Steps.
        paths: Path of each foot, by side.
        leg_m: Hip centre to sole, m.
        t: (N,) uniform s.
        profile: Ground along the way.
        gaze: Gaze of the walker.
        sway: Sway of the walker.
        wave: (N,) m, oscillation of the pelvis' height; the head pitches against it.
        rng: Draws the directions of a wandering gaze; other kinds do not use it.
    """
    dt = float(t[1] - t[0])
    heading = smooth_gaussian((paths["l"].heading + paths["r"].heading) / 2, _TURN_SMOOTHING_S, dt)
    apart = paths["r"].p_foot_in_world - paths["l"].p_foot_in_world
    # how far the right foot is in front of the left one, in leg lengths
    ahead = (apart[:, 0] * np.cos(heading) + apart[:, 1] * np.sin(heading)) / leg_m
    stride = smooth_gaussian(ahead, _SWING_SMOOTHING_S, dt)
    s = (paths["l"].s + paths["r"].s) / 2
    # mean slope of the ground from just behind the feet to the point of gaze
    rise = profile_height(profile, s + _SLOPE_AHEAD_M) - profile_height(profile, s - _SLOPE_BEHIND_M)
    climb = smooth_gaussian(rise / (_SLOPE_AHEAD_M + _SLOPE_BEHIND_M), _CLIMB_SMOOTHING_S, dt)
    effort = np.clip(climb, 0.0, _MAX_EFFORT)
    swaying = sway.angles(rhythm, t)
    pitch = rhythm.blend_style(t, "tilt", _STANDING_TILT_RAD) + _TILT_BY_EFFORT * effort
    pitch += _TILT_BACK_BY_DESCENT * np.minimum(climb, 0.0) + swaying["pelvis_pitch"]
    eyes = plan_gaze(gaze, t, s, climb, profile, leg_m, rng)
    if looks := [(step.t_touch, step.look_back) for step in rhythm.steps if step.look_back is not None]:
        yaw, chest_yaw, looking = turn_back(looks, t)
        eyes = replace(
            eyes, head_yaw=(1.0 - looking) * eyes.head_yaw + yaw, chest_yaw=(1.0 - looking) * eyes.chest_yaw + chest_yaw
        )
    torso_pitch = _TORSO_LEAN_RAD + _LEAN_BY_EFFORT * effort + eyes.chest_pitch + swaying["chest_pitch"]
    # rad, by which trunk and head turn ahead of the pelvis' heading
    trunk = _advance_in_time(heading, _TRUNK_LEADS_S, dt) - heading
    head = _advance_in_time(heading, _HEAD_LEADS_S, dt) - heading
    if any(step.twist is not None for step in rhythm.steps):  # in a quick turn, only as far as trunk and neck turn
        trunk, head = (most * np.tanh(angle / most) for most, angle in ((_MAX_TRUNK_RAD, trunk), (_MAX_HEAD_RAD, head)))
    # rotations from the heading's own frame, so that several full turns do not matter; angles: yaw, pitch, roll
    yaw, roll = swaying["pelvis_yaw"], swaying["pelvis_roll"]
    R_pelvis = from_euler(np.stack([yaw, pitch, roll], -1))
    torso_yaw = trunk + eyes.chest_yaw + swaying["chest_yaw"]
    R_torso = from_euler(np.stack([torso_yaw, torso_pitch, swaying["chest_roll"]], -1))
    head_yaw = head + eyes.head_yaw + swaying["head_yaw"]
    # down while it rises: the gaze stays on a point `fixation_m` ahead
    head_pitch = eyes.head_pitch + wave / sway.fixation_m + swaying["head_pitch"]
    R_head = from_euler(np.stack([head_yaw, head_pitch, swaying["head_roll"]], -1))
    joints = {
        **_hinge_angles("lumbar", np.swapaxes(R_pelvis, 1, 2) @ R_torso),
        **_hinge_angles("neck", np.swapaxes(R_torso, 1, 2) @ R_head),
    }
    for side, sign in (("l", 1.0), ("r", -1.0)):
        swing = sign * stride  # the left arm moves with the right foot
        flexion = torso_pitch + _ARM_SWING_RAD * swing * np.where(swing > 0, _ARM_FORWARD, 1.0)
        joints[f"shoulder_flexion_{side}"] = smooth_gaussian(flexion + _ARM_FLEXION_RAD, _SWING_SMOOTHING_S, dt)
        joints[f"shoulder_abduction_{side}"] = np.full_like(yaw, _ARM_ABDUCTION_RAD)
        joints[f"elbow_flexion_{side}"] = _ELBOW_FLEXION_RAD + _ELBOW_SWING_RAD * swing
    return Posture(pelvis=np.stack([heading + yaw, pitch, roll], -1), joints=joints)


def _advance_in_time(x: Array, lead_s: float, dt: float) -> Array:
    """(N,) values of x `lead_s` s later; x has rows every `dt` s and is constant after its end."""
    rows = np.arange(len(x))
    return np.interp(rows + lead_s / dt, rows, x)


def _hinge_angles(name: str, R: Array) -> dict[str, Array]:
    """(N,) rad by joint name, angles of the three hinges of a joint that give (N, 3, 3) rotations.

    The hinges are flexion, bending and rotation, from the body that carries them outwards: R = R_y(flexion)
    R_x(bending) R_z(rotation). `name` is the first part of the joint names, `lumbar` or `neck`.
    """
    return {
        f"{name}_flexion": np.arctan2(R[:, 0, 2], R[:, 2, 2]),
        f"{name}_bending": -np.arcsin(np.clip(R[:, 1, 2], -1.0, 1.0)),
        f"{name}_rotation": np.arctan2(R[:, 1, 0], R[:, 1, 1]),
    }
