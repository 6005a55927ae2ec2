"""Poses of a ground truth, with velocities if the source has none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.imported import Notes
from stridetwin.streams.recording.topic_reader import increasing
from stridetwin.streams.samples import Array, Block, Odometry

_UNIT = (0.9, 1.1)


def odometry(
    name: str,
    t_ns: NDArray[np.int64],
    p: Array,
    q: Array,
    v: Array | None,
    notes: Notes,
    file: object,
    T_body_source: Array | None = None,
) -> Block[Odometry]:
    """Poses as a block of odometry; missing velocities are central differences.

    Args:
        name: Topic.
        t_ns: (N,) stamps.
        p: (N, 3) m, origin of the frame in the world.
        q: (N, 4) quaternions (w, x, y, z), frame to world; normalised here.
        v: (N, 3) m/s, or None.
        notes: Collects problems.
        file: Name of the source in errors.
        T_body_source: (4, 4) pose of the source's frame in the wanted frame, m; the source's velocity, which is that of
            another point, is then ignored. None: the frames are equal.

    Raises:
        ConfigError: A quaternion far from unit norm, unless lenient (its row is omitted).
    """
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(q, axis=1)
    sound = (norm > _UNIT[0]) & (norm < _UNIT[1])
    if not sound.all():
        at = int(np.argmin(sound))
        notes.invalid(ConfigError(file, f"row {at + 1}, quaternion", q[at].tolist(), "a unit quaternion"))
        t_ns, p, q, norm = t_ns[sound], p[sound], q[sound], norm[sound]
        v = None if v is None else v[sound]
    q = q / norm[:, None]
    if T_body_source is not None and len(q):
        T_source_body = np.linalg.inv(T_body_source)
        rotation = Rotation.from_quat(q, scalar_first=True)
        p, v = p + rotation.apply(T_source_body[:3, 3]), None
        q = (rotation * Rotation.from_matrix(T_source_body[:3, :3])).as_quat(scalar_first=True)
    rates = np.zeros((2, len(t_ns), 3))
    rising = np.flatnonzero(increasing(t_ns, -1))  # decreasing stamps are rejected or omitted later
    if len(rising) > 1:
        attitude = Rotation.from_quat(q[rising], scalar_first=True)
        rates[:, rising] = _rates(t_ns[rising], p[rising], attitude)
    return Block(
        topic=name,
        kind=Odometry,
        t_ns=t_ns,
        columns={
            "p_frame_in_world": p,
            "q_world_frame": q,
            "v_frame_in_world": rates[0] if v is None else v,
            "angular_rate": rates[1],
        },
    )


def _rates(t_ns: NDArray[np.int64], p: Array, attitude: Rotation) -> Array:
    """(2, N, 3) velocity in the world, and angular rate in the frame, from the neighbours of each pose."""
    i = np.arange(len(t_ns))
    before, after = np.maximum(i - 1, 0), np.minimum(i + 1, len(t_ns) - 1)
    span = (t_ns[after] - t_ns[before])[:, None] * 1e-9
    turn = (attitude[before].inv() * attitude[after]).as_rotvec()
    return np.stack(((p[after] - p[before]) / span, turn / span))
