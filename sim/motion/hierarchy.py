"""Orientations of segments from a hierarchy of joints, whatever the axes in which each joint was recorded.

The frames of the segments follow from the recording, because files differ in the posture and the axes in which all
angles are zero. A limb's long axis points to its next joint. Thigh and shank turn about the knee's axis, along which
the rotation between them points most; from the straightest posture knees bend backwards. Pelvis and trunk have their
left side by the hips and the shoulders. They are upright where all angles are zero, if the legs are then straight down,
and otherwise in the mean. Feet point to the toes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.motion.segments import SegmentMotion
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_LEAST_BEND_RAD = 0.2  # of a knee whose axis is found
_SLOW_SHARE = 0.3  # of the frames, in which a foot is slowest
_STRAIGHT_COSINE = np.cos(np.radians(30.0))  # of legs that stand; CMU's hips are 20° apart at rest

# Joints by their parts of the body; the side is added before, and all but letters and digits is left out.
RIGS: dict[str, dict[str, str]] = {
    "motionbuilder": {  # also CMU's and Mixamo's
        "hip": "upleg", "knee": "leg", "ankle": "foot", "toe": "toebase", "shoulder": "arm", "elbow": "forearm",
        "wrist": "hand",
    },
    "xsens": {
        "hip": "hip", "knee": "knee", "ankle": "ankle", "toe": "toe", "shoulder": "shoulder", "elbow": "elbow",
        "wrist": "wrist",
    },
    "rokoko": {
        "hip": "thigh", "knee": "shin", "ankle": "foot", "toe": "toe", "shoulder": "arm", "elbow": "forearm",
        "wrist": "hand",
    },
    "biovision": {
        "hip": "upleg", "knee": "lowleg", "ankle": "foot", "toe": "toes", "shoulder": "uparm", "elbow": "lowarm",
        "wrist": "hand",
    },
}  # fmt: skip
"""Names of joints by rig, without the side."""
_LEG = ("hip", "knee", "ankle")
_ARM = ("shoulder", "elbow", "wrist")
_SIDES = {"l": "left", "r": "right"}


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion:
    """Joints of a hierarchy over time; every joint comes after the one that carries it.

    Attributes:
        source: File.
        dt: Time between two rows, s.
        names: (J,) of the joints.
        parent: (J,) number of the joint that carries each, -1 of the root.
        offset: (N, J, 3) places in the carrier's axes, in any unit; of the root in the laboratory.
        R: (N, J, 3, 3) rotations in the carrier's axes.
    """

    source: str
    dt: float
    names: tuple[str, ...]
    parent: tuple[int, ...]
    offset: Array
    R: Array

    def in_laboratory(self) -> tuple[Array, Array]:
        """(N, J, 3, 3) joint to laboratory, and (N, J, 3) places."""
        R, p = np.empty_like(self.R), np.empty_like(self.offset)
        for j, up in enumerate(self.parent):
            if up < 0:
                R[:, j], p[:, j] = self.R[:, j], self.offset[:, j]
            else:
                R[:, j] = R[:, up] @ self.R[:, j]
                p[:, j] = p[:, up] + np.einsum("nij,nj->ni", R[:, up], self.offset[:, j])
        return R, p


def find_joints(source: str, names: Sequence[str], parent: Sequence[int]) -> dict[str, int]:
    """Numbers of the joints of the body, such as `hip_l`, by the rig that knows all of the legs.

    Args:
        source: File, for messages.
        names: Joints of the file.
        parent: Number of the joint that carries each, -1 of the root.

    Raises:
        ConfigError: No rig knows the legs.
    """
    bare = [re.sub(r"[^a-z0-9]", "", name.rsplit(":", 1)[-1].lower()) for name in names]
    for rig in RIGS.values():
        joints = {
            f"{part}_{side}": number
            for part, word in rig.items()
            for side, before in _SIDES.items()
            # other words may be in front, as in Model_LeftFoot
            if (number := next((i for i, name in enumerate(bare) if name.endswith(before + word)), None)) is not None
        }
        if all(f"{part}_{side}" in joints for part in _LEG for side in _SIDES):
            break
    else:
        valid = "; ".join(
            f"{name}: {', '.join('Left' + rig[part].title() for part in _LEG)}" for name, rig in RIGS.items()
        )
        raise ConfigError(source, "joints", ", ".join(names[:8]), f"legs of a known rig ({valid})")
    for side in _SIDES:  # files without toes have an end of the foot
        if f"toe_{side}" not in joints:
            below = [i for i, up in enumerate(parent) if up == joints[f"ankle_{side}"]]
            if not below:
                raise ConfigError(source, "joints", names[joints[f"ankle_{side}"]], "a joint of the toes, or an end")
            joints[f"toe_{side}"] = below[0]
    return joints


def to_segments(motion: JointMotion, unit_m: float | None, leg_m: float) -> SegmentMotion:
    """Orientations of the wearer's segments.

    Args:
        motion: The joints.
        unit_m: Unit of places, m; None if lengths mean nothing but proportions, and the places are in m.
        leg_m: Length of the person's thigh and shank, m, of which the unit is a check.

    Raises:
        ConfigError: The joints of the legs are not known, the axes are, or lengths are no person's.
    """
    joints = find_joints(motion.source, motion.names, motion.parent)
    R, p = motion.in_laboratory()
    up = _find_up(motion.source, p, joints)
    R, p = up @ R, p @ up.T * (1.0 if unit_m is None else unit_m)
    vertical = _vertical_at_zero(motion, joints)
    frames: dict[str, Array] = {}
    root = _common_carrier(motion.parent, joints["hip_l"], joints["hip_r"])
    frames["pelvis"] = _upright_frame(R[:, root], p[:, joints["hip_l"]] - p[:, joints["hip_r"]], vertical)
    for side in _SIDES:
        hip, knee, ankle, toe = (joints[f"{part}_{side}"] for part in (*_LEG, "toe"))
        frames[f"thigh_{side}"], frames[f"shank_{side}"] = _leg_frames(
            R[:, hip], R[:, knee], p[:, knee] - p[:, hip], p[:, ankle] - p[:, knee], frames["pelvis"][..., 1]
        )
        frames[f"foot_{side}"] = _foot_frame(R[:, ankle], p[:, toe] - p[:, ankle], p[:, ankle])
    if all(f"{part}_{side}" in joints for part in _ARM for side in _SIDES):
        trunk = _common_carrier(motion.parent, joints["shoulder_l"], joints["shoulder_r"])
        across = p[:, joints["shoulder_l"]] - p[:, joints["shoulder_r"]]
        frames["torso"] = _upright_frame(R[:, trunk], across, vertical)
        for side in _SIDES:
            shoulder, elbow, wrist = (joints[f"{part}_{side}"] for part in _ARM)
            left = frames["torso"][..., 1]
            frames[f"upper_arm_{side}"] = _long_frame(p[:, elbow] - p[:, shoulder], left)
            frames[f"forearm_{side}"] = _long_frame(p[:, wrist] - p[:, elbow], left)
    lengths = {} if unit_m is None else _measure(p, joints)
    if unit_m is not None and not 0.75 < (lengths["thigh_m"] + lengths["shank_m"]) / leg_m < 1.33:
        raise ConfigError(
            motion.source,
            "OFFSET",
            f"legs of {lengths['thigh_m'] + lengths['shank_m']:.3g} m",
            f"about {leg_m:.2f} m, as of this person",
        )
    hips = 0.5 * (p[:, joints["hip_l"]] + p[:, joints["hip_r"]])
    return SegmentMotion(source=motion.source, dt=motion.dt, hips=hips, R=frames, lengths=lengths)


def leg_length(motion: JointMotion) -> float:
    """Length of thigh and shank in the file's unit."""
    lengths = _measure(motion.in_laboratory()[1], find_joints(motion.source, motion.names, motion.parent))
    return lengths["thigh_m"] + lengths["shank_m"]


def _measure(p: Array, joints: Mapping[str, int]) -> dict[str, float]:
    """Lengths of segments, in the unit of the (N, J, 3) places; means of both sides."""

    def apart(a: str, b: str) -> float:
        return float(np.median(np.linalg.norm(p[:, joints[a]] - p[:, joints[b]], axis=1)))

    lengths = {"hip_width_m": apart("hip_l", "hip_r")}
    parts = {"thigh_m": ("hip", "knee"), "shank_m": ("knee", "ankle")}
    if "wrist_l" in joints and "wrist_r" in joints and "shoulder_l" in joints and "elbow_l" in joints:
        parts |= {"upper_arm_m": ("shoulder", "elbow"), "forearm_m": ("elbow", "wrist")}
        lengths["shoulder_width_m"] = apart("shoulder_l", "shoulder_r")
    for name, (a, b) in parts.items():
        lengths[name] = 0.5 * (apart(f"{a}_l", f"{b}_l") + apart(f"{a}_r", f"{b}_r"))
    return lengths


def _find_up(source: str, p: Array, joints: Mapping[str, int]) -> Array:
    """(3, 3) rotation that turns the axis up, along which the hips are above the ankles, to z.

    Raises:
        ConfigError: No axis is up.
    """
    up = np.median(
        0.5 * (p[:, joints["hip_l"]] + p[:, joints["hip_r"]] - p[:, joints["ankle_l"]] - p[:, joints["ankle_r"]]), 0
    )
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) < 0.8 * np.linalg.norm(up):
        raise ConfigError(source, "axes", np.round(up, 3).tolist(), "hips above the feet along one axis")
    if up[axis] < 0:
        raise ConfigError(source, "axes", f"{'xyz'[axis]} down", "an axis that points up")
    return np.roll(np.eye(3), 2 - axis, axis=0)  # a cyclic change keeps the handedness


def _common_carrier(parent: Sequence[int], a: int, b: int) -> int:
    """Nearest joint that carries both."""
    above = [a]
    while parent[above[-1]] >= 0:
        above.append(parent[above[-1]])
    while b not in above:
        b = parent[b]
    return b


def _attach(R: Array, frame: Array) -> Array:
    """(N, 3, 3) the frame that is fixed to a joint and is nearest to the (N, 3, 3) given ones."""
    return R @ np.asarray(Rotation.from_matrix(np.swapaxes(R, 1, 2) @ frame).mean().as_matrix())


def _frame(y: Array, z: Array) -> Array:
    """(N, 3, 3) frames with the direction z, and y as near to the one that is given as that allows."""
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    y = y - np.sum(y * z, axis=-1, keepdims=True) * z
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _upright_frame(R: Array, left: Array, vertical: Array | None) -> Array:
    """(N, 3, 3) a frame fixed to a joint, whose left is that of (N, 3).

    Args:
        R: (N, 3, 3) of the joint.
        left: (N, 3) to the left.
        vertical: (3,) up in the joint's axes; None for what is up in the mean.
    """
    up = R[:, 2].mean(0) if vertical is None else vertical
    y = np.einsum("nij,ni->nj", R, left).mean(0)
    return R @ _frame(y, up - (up @ y) / (y @ y) * y)


def _vertical_at_zero(motion: JointMotion, joints: Mapping[str, int]) -> Array | None:
    """(3,) axis that is up where all angles are zero; None if nobody stands like that, with straight legs."""
    offset = np.median(motion.offset, axis=0)
    legs = np.array([offset[joints[f"{part}_{side}"]] for part in ("knee", "ankle") for side in _SIDES])
    down = legs.sum(0)
    up = -np.sign(down[np.argmax(np.abs(down))]) * np.eye(3)[np.argmax(np.abs(down))]
    places = np.zeros_like(offset)
    for j, carrier in enumerate(motion.parent):
        places[j] = offset[j] + places[carrier] if carrier >= 0 else 0.0
    trunk = np.mean([places[joints[name]] for name in ("shoulder_l", "shoulder_r") if name in joints] or [up], axis=0)
    is_straight = np.all(legs @ up < -_STRAIGHT_COSINE * np.linalg.norm(legs, axis=1))
    return up if is_straight and trunk @ up > 0.5 * np.linalg.norm(trunk) else None


def _long_frame(along: Array, left: Array) -> Array:
    """(N, 3, 3) frames whose −z is along a limb."""
    return _frame(left, -along)


def _leg_frames(R_hip: Array, R_knee: Array, thigh: Array, shank: Array, left: Array) -> tuple[Array, Array]:
    """(N, 3, 3) thigh and shank, whose y is the axis of the knee.

    Args:
        R_hip: (N, 3, 3) of the joint that carries the thigh.
        R_knee: (N, 3, 3) of the joint that carries the shank.
        thigh: (N, 3) to the knee.
        shank: (N, 3) to the ankle.
        left: (N, 3) of the pelvis, for knees that hardly bend.
    """
    cosine = np.sum(thigh * shank, axis=1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
    bend = np.arccos(np.clip(cosine, -1.0, 1.0))
    straight = int(np.argmin(bend))
    between = np.swapaxes(R_hip, 1, 2) @ R_knee
    turns = Rotation.from_matrix(between @ between[straight].T).as_rotvec()  # in the thigh's axes
    if np.linalg.norm(turns, axis=1).max() > _LEAST_BEND_RAD:
        axis = np.sum(turns * np.linalg.norm(turns, axis=1, keepdims=True), axis=0)
        y_thigh, y_shank = R_hip @ axis, R_knee @ (between[straight].T @ axis)
    else:
        y_thigh = y_shank = left
    return _attach(R_hip, _frame(y_thigh, -thigh)), _attach(R_knee, _frame(y_shank, -shank))


def _foot_frame(R: Array, to_toe: Array, p: Array) -> Array:
    """(N, 3, 3) the foot, whose x points to the toes and whose z is up while it is slow."""
    speed = np.linalg.norm(np.gradient(p, axis=0), axis=1)
    slow = speed <= np.quantile(speed, _SLOW_SHARE)
    up = R[slow, 2].mean(0)  # the vertical as the foot sees it
    ahead = np.einsum("nij,ni->nj", R, to_toe).mean(0)
    return R @ _frame(np.cross(up, ahead), up)
