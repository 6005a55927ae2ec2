"""A walk of one foot straight ahead on the level, from a few formulas, as a recording with its truth alone."""

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.recording.reader import RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Odometry
from stridetwin.streams.trajectory import Trajectory

RATE_HZ, STAND_S, STRIDE_S, STRIDE_M, STRIDES = 100.0, 1.0, 1.1, 1.2, 18
DURATION_S = 2 * STAND_S + STRIDES * STRIDE_S


def foot_walk(begin_s=0.0):
    """Positions straight along x with the foot pitching alone, from rest to rest."""
    t = np.arange(0, DURATION_S, 1 / RATE_HZ)
    strides = np.clip((t - STAND_S) / STRIDE_S, 0, STRIDES)
    u = strides - np.floor(strides)
    s = u**3 * (10 - 15 * u + 6 * u**2)
    swing = (4 * u * (1 - u)) ** 3
    p = np.column_stack([STRIDE_M * (np.floor(strides) + s), 0 * t, 0.1 * swing])
    q = Rotation.from_rotvec(np.outer(0.9 * swing * np.sin(2 * np.pi * u), [0, 1, 0])).as_quat(scalar_first=True)
    return Trajectory(t_ns=np.rint((t + begin_s) * 1e9).astype(np.int64), p_frame_in_world=p, q_world_frame=q)


def write_truth(file, path, frame="foot_l/imu"):
    """A recording that holds a path as the truth of a frame."""
    t = path.t_ns * 1e-9
    v = np.gradient(path.p_frame_in_world, t, axis=0)
    columns = {
        "p_frame_in_world": path.p_frame_in_world,
        "v_frame_in_world": v,
        "q_world_frame": path.q_world_frame,
        "angular_rate": np.zeros_like(v),
    }
    block = Block(topic=f"/truth/{frame}/odometry", kind=Odometry, t_ns=path.t_ns, columns=columns)
    with RecordingWriter(file, Rig(), {}) as writer:
        writer.write(block)
    return file


def tum_rows(path):
    """The cells t, x, y, z, qx, qy, qz, qw of each pose."""
    poses = np.column_stack([path.p_frame_in_world, path.q_world_frame[:, [1, 2, 3, 0]]])
    stamps = [f"{t // 10**9}.{t % 10**9:09d}" for t in path.t_ns.tolist()]
    return [[t, *(f"{v:.9g}" for v in pose)] for t, pose in zip(stamps, poses.tolist())]


def write_rows(file, rows, header="", separator=" "):
    """Writes a header and rows of cells."""
    file.write_text(header + "".join(separator.join(row) + "\n" for row in rows))
    return file
