"""Poses of SMPL, SMPL-H and SMPL-X bodies, such as AMASS has them in `.npz` files (Mahmood et al. 2019).

The licensed body, and with it the shape of the person, is not needed: of the body's joints at rest, only the directions
of the segments are used, which hardly differ between people. Lengths are the person's, or are fitted.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.motion.hierarchy import JointMotion, to_segments
from stridetwin.sim.motion.read import check_length
from stridetwin.sim.motion.segments import SegmentMotion
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_RATES = ("mocap_framerate", "mocap_frame_rate", "framerate", "fps")
_WIDTHS = (72, 156, 165)  # of `poses`: SMPL, SMPL-H, SMPL-X
_USED = 22  # joints of the body, which all of them have first

# The joints of the body: their carrier, and place in its axes (x left, y up, z forward) at rest, m: those of the mean
# person, rounded to 5 mm.
JOINTS: tuple[tuple[str, int, tuple[float, float, float]], ...] = (
    ("Hips", -1, (0.0, 0.0, 0.0)),
    ("LeftHip", 0, (0.06, -0.085, -0.015)), ("RightHip", 0, (-0.06, -0.085, -0.015)),
    ("Spine1", 0, (0.0, 0.125, -0.035)),
    ("LeftKnee", 1, (0.045, -0.385, 0.0)), ("RightKnee", 2, (-0.045, -0.385, 0.0)),
    ("Spine2", 3, (0.0, 0.14, 0.025)),
    ("LeftAnkle", 4, (-0.015, -0.42, -0.04)), ("RightAnkle", 5, (0.015, -0.42, -0.04)),
    ("Spine3", 6, (0.0, 0.055, 0.0)),
    ("LeftToe", 7, (0.04, -0.06, 0.12)), ("RightToe", 8, (-0.04, -0.06, 0.12)),
    ("Neck", 9, (0.0, 0.21, -0.035)),
    ("LeftCollar", 9, (0.075, 0.115, -0.02)), ("RightCollar", 9, (-0.075, 0.115, -0.02)),
    ("Head", 12, (0.0, 0.09, 0.05)),
    ("LeftShoulder", 13, (0.12, 0.045, -0.02)), ("RightShoulder", 14, (-0.12, 0.045, -0.02)),
    ("LeftElbow", 16, (0.255, -0.015, -0.02)), ("RightElbow", 17, (-0.255, -0.015, -0.02)),
    ("LeftWrist", 18, (0.265, 0.01, -0.005)), ("RightWrist", 19, (-0.265, 0.01, -0.005)),
)  # fmt: skip
"""Joints of the body in the order of the poses."""


def read_amass(path: Path, leg_m: float) -> SegmentMotion:
    """Orientations of segments of an `.npz` file with `poses`, `trans` and a frame rate.

    Args:
        path: The file.
        leg_m: Length of the person's thigh and shank, m.

    Raises:
        ConfigError: The file lacks an array, or one has another form.
    """
    arrays = _load(path)
    missing = [name for name in ("poses", "trans") if name not in arrays]
    rates = [name for name in _RATES if name in arrays]
    if missing or not rates:
        raise ConfigError(path, "arrays", ", ".join(arrays) or "none", f"poses, trans and {_RATES[0]}")
    poses, trans, rate = arrays["poses"], arrays["trans"], arrays[rates[0]]
    if poses.ndim != 2 or poses.shape[1] not in _WIDTHS:
        raise ConfigError(
            path, "poses", list(poses.shape), f"(N, {', '.join(map(str, _WIDTHS[:-1]))} or {_WIDTHS[-1]})"
        )
    if trans.shape != (len(poses), 3):
        raise ConfigError(path, "trans", list(trans.shape), f"({len(poses)}, 3)")
    if rate.size != 1 or not 1.0 <= float(rate.ravel()[0]) <= 2000.0:
        raise ConfigError(path, rates[0], rate.ravel()[:3].tolist(), "frames per second, from 1 to 2000")
    check_length(path, len(poses))
    for name, values in (("poses", poses), ("trans", trans)):
        if not np.isfinite(values).all():
            raise ConfigError(path, name, "NaN", "numbers in every frame")
    if np.abs(poses).max() > 4.0 * np.pi:
        raise ConfigError(path, "poses", float(np.abs(poses).max()), "rotation vectors in rad")
    n = len(poses)
    R = Rotation.from_rotvec(poses[:, : 3 * _USED].reshape(-1, 3)).as_matrix().reshape(n, _USED, 3, 3)
    offset = np.tile(np.array([place for _, _, place in JOINTS]), (n, 1, 1))
    offset[:, 0] = trans
    motion = JointMotion(
        source=str(path),
        dt=1.0 / float(rate.ravel()[0]),
        names=tuple(name for name, _, _ in JOINTS),
        parent=tuple(up for _, up, _ in JOINTS),
        offset=offset,
        R=R,
    )
    return to_segments(motion, None, leg_m)


def _load(path: Path) -> dict[str, Array]:
    """Arrays of numbers of an `.npz` file; others are left out.

    Raises:
        ConfigError: The file is no such file.
    """
    arrays = {}
    try:
        with np.load(path, allow_pickle=False) as content:
            for name in content.files if isinstance(content, np.lib.npyio.NpzFile) else ():
                if name in ("poses", "trans", *_RATES):
                    arrays[name] = np.asarray(content[name], dtype=float)
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise ConfigError(path, "", str(error)[:80], "a file .npz of numbers") from None
    return arrays
