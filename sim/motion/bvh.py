"""Motion in Biovision's hierarchy, `.bvh`: joints with offsets, channels and a table of frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stridetwin.sim.motion.hierarchy import JointMotion, leg_length, to_segments
from stridetwin.sim.motion.read import check_length, read_text
from stridetwin.sim.motion.segments import SegmentMotion
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_UNITS_M = (1.0, 0.01, 0.001, 0.0254, 0.056444)  # m, cm, mm, inch, and that of CMU's data base (0.45 inches are 1/0.45)
_MAX_JOINTS = 500
_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}


@dataclass(kw_only=True)
class _Joint:
    """A joint of the head of a file."""

    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: list[str] = field(default_factory=list)


def read_bvh(path: Path, leg_m: float) -> SegmentMotion:
    """Orientations of segments, and lengths, of a `.bvh` file.

    The unit, which the format does not tell, is the common one in which the legs are most like the person's.

    Args:
        path: The file, possibly packed with gzip.
        leg_m: Length of the person's thigh and shank, m.

    Raises:
        ConfigError: The file is no such hierarchy, its joints are not known, or its legs are no person's.
    """
    motion = read_hierarchy(path)
    length = leg_length(motion)
    if not length > 0.0:
        raise ConfigError(path, "OFFSET", "legs without length", "offsets of knees and ankles")
    unit_m = min(_UNITS_M, key=lambda unit: abs(np.log(unit * length / leg_m)))
    return to_segments(motion, unit_m, leg_m)


def read_hierarchy(path: Path) -> JointMotion:
    """Joints of a `.bvh` file, in its unit and axes.

    Raises:
        ConfigError: The file is no such hierarchy.
    """
    tokens = read_text(path).split()
    joints, begin = _read_head(path, tokens)
    frames, dt, begin = _read_counts(path, tokens, begin)
    count = sum(len(joint.channels) for joint in joints)
    numbers = tokens[begin:]
    if count == 0 or len(numbers) != frames * count:
        raise ConfigError(path, "MOTION", f"{len(numbers)} numbers", f"{frames} frames of {count} channels")
    check_length(path, frames)
    try:
        table = np.array(numbers, dtype=float).reshape(frames, count)
    except ValueError as error:
        raise ConfigError(path, "MOTION", str(error)[:60], "numbers") from None
    if not np.isfinite(table).all():
        raise ConfigError(path, "MOTION", "NaN", "numbers in every frame")
    offset = np.tile(np.array([joint.offset for joint in joints]), (frames, 1, 1))
    R = np.tile(np.eye(3), (frames, len(joints), 1, 1))
    column = 0
    for j, joint in enumerate(joints):
        for channel in joint.channels:
            axis = "xyz".index(channel[0])
            if channel.endswith("position"):  # it takes the place of the offset
                offset[:, j, axis] = table[:, column]
            else:
                R[:, j] = R[:, j] @ _rotate(axis, np.radians(table[:, column]))
            column += 1
    return JointMotion(
        source=str(path),
        dt=dt,
        names=tuple(joint.name for joint in joints),
        parent=tuple(joint.parent for joint in joints),
        offset=offset,
        R=R,
    )


def _read_head(path: Path, tokens: list[str]) -> tuple[list[_Joint], int]:
    """Joints, and number of the word after them.

    Raises:
        ConfigError: The head is incomplete.
    """
    if not tokens or tokens[0].upper() != "HIERARCHY":
        raise ConfigError(path, "", tokens[0][:40] if tokens else "", "HIERARCHY")
    joints: list[_Joint] = []
    carriers: list[int] = []  # of the open braces
    at = 1
    try:
        while tokens[at].upper() != "MOTION":
            word = tokens[at].upper()
            if word in ("ROOT", "JOINT", "END"):
                until = tokens.index("{", at)
                name = " ".join(tokens[at + 1 : until])
                joints.append(_Joint(name=f"end of {joints[carriers[-1]].name}" if word == "END" else name,
                                     parent=carriers[-1] if carriers else -1))  # fmt: skip
                carriers.append(len(joints) - 1)
                at = until + 1
            elif word == "OFFSET":
                x, y, z = map(float, tokens[at + 1 : at + 4])
                joints[carriers[-1]].offset = (x, y, z)
                at += 4
            elif word == "CHANNELS":
                count = int(tokens[at + 1])
                channels = [channel.lower() for channel in tokens[at + 2 : at + 2 + count]]
                if not set(channels) <= _CHANNELS:
                    raise ConfigError(path, "CHANNELS", " ".join(channels), "Xposition, Zrotation and the like")
                joints[carriers[-1]].channels = channels
                at += 2 + count
            elif word == "}":
                carriers.pop()
                at += 1
            else:
                raise ConfigError(path, "HIERARCHY", tokens[at][:40], "JOINT, OFFSET, CHANNELS, End Site or braces")
            if len(joints) > _MAX_JOINTS:
                raise ConfigError(path, "HIERARCHY", f"more than {_MAX_JOINTS} joints", "a skeleton of a person")
    except (IndexError, ValueError):
        near = " ".join(tokens[max(0, at - 2) : at + 2])
        raise ConfigError(path, "HIERARCHY", near[:60], "joints with OFFSET and CHANNELS, then MOTION") from None
    if [joint.parent for joint in joints].count(-1) != 1 or carriers:
        raise ConfigError(path, "HIERARCHY", f"{len(joints)} joints", "one ROOT that carries all joints")
    return joints, at + 1


def _read_counts(path: Path, tokens: list[str], at: int) -> tuple[int, float, int]:
    """Number of frames, time between two, s, and number of the word after them.

    Raises:
        ConfigError: They are missing.
    """
    try:
        if tokens[at].lower() != "frames:" or [word.lower() for word in tokens[at + 2 : at + 4]] != ["frame", "time:"]:
            raise ValueError
        frames, dt = int(tokens[at + 1]), float(tokens[at + 4])
    except (IndexError, ValueError):
        near = " ".join(tokens[at : at + 5])
        raise ConfigError(path, "MOTION", near[:60], "Frames: and Frame Time:") from None
    if not (frames > 0 and 0.0 < dt < 1.0):
        raise ConfigError(path, "Frame Time", dt, "s between 0 and 1")
    return frames, dt, at + 5


def _rotate(axis: int, angle: Array) -> Array:
    """(N, 3, 3) rotations by (N,) rad about a coordinate axis."""
    R = np.tile(np.eye(3), (len(angle), 1, 1))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[:, i, i] = R[:, j, j] = np.cos(angle)
    R[:, j, i] = np.sin(angle)
    R[:, i, j] = -R[:, j, i]
    return R
