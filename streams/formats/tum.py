"""Trajectories as TUM text files: `t x y z qx qy qz qw`, one row per pose (https://cvg.cit.tum.de/data/datasets/rgbd-dataset)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import check_type
from stridetwin.streams.files import atomic_file
from stridetwin.streams.formats.trajectory_file import read_trajectory
from stridetwin.streams.trajectory import Trajectory

LATEST_S = 9e9  # range of 64-bit nanoseconds


def write_tum(trajectory: Trajectory, path: str | Path) -> None:
    """Writes a trajectory, atomically: rows `t x y z qx qy qz qw`, t in s and x, y, z in m, without its covariance."""
    check_type("write_tum", "trajectory", trajectory, Trajectory, "a Trajectory, such as the path of a PathEstimate")
    q_xyzw = trajectory.q_world_frame[:, [1, 2, 3, 0]]
    poses = np.column_stack((trajectory.p_frame_in_world, q_xyzw))
    with atomic_file(path) as temporary, temporary.open("w", encoding="ascii") as file:
        for t, pose in zip(trajectory.t_ns.tolist(), poses.tolist()):
            file.write(f"{format_seconds(t)} {' '.join(f'{v:.9g}' for v in pose)}\n")


def format_seconds(t_ns: int) -> str:
    """A stamp in the format's seconds, to the nanosecond."""
    return f"{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}"


def parse_seconds(word: str) -> int:
    """A stamp in seconds to nanoseconds, without a float's rounding of large epochs.

    Raises:
        ValueError: Invalid word; the message says what is valid.
    """
    integer, _, fraction = word.partition(".")
    try:
        value = float(word)
    except ValueError:
        value = math.nan  # out of any range
    if not 0 <= value < LATEST_S:
        raise ValueError("seconds from 0 on; is it in ns?" if value >= LATEST_S else "seconds from 0 on")
    if word.isascii() and integer.isdecimal() and (fraction.isdecimal() or not fraction):
        return int(integer) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))  # further digits are cut off
    return round(value * 1e9)  # other forms, such as 1.5e3


def read_tum(path: str | Path) -> Trajectory:
    """Reads a trajectory as stamps in ns, positions in m, and unit quaternions (w, x, y, z) of a frame in the world.

    `#` begins a comment. Quaternions are normalised. Trajectories of other tools are recognised, see `read_trajectory`.

    Raises:
        StrideTwinError: The file cannot be read, or a row is invalid; names line, column and what is valid.
    """
    return read_trajectory(path).path
