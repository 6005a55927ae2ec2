"""Trajectories as TUM text files: `t x y z qx qy qz qw`, one row per pose (https://cvg.cit.tum.de/data/datasets/rgbd-dataset)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError, check_type
from stridetwin.streams.files import atomic_file
from stridetwin.streams.formats.text_rows import parse_row_stamp
from stridetwin.streams.trajectory import Trajectory

LATEST_S = 9e9  # range of 64-bit nanoseconds
_FARTHEST_M = 1e9  # beyond it squared errors overflow
_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Time in s, position in m, and quaternion of a row."""


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
        raise ValueError("seconds from 0 on")
    if word.isascii() and integer.isdecimal() and (fraction.isdecimal() or not fraction):
        return int(integer) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))  # further digits are cut off
    return round(value * 1e9)  # other forms, such as 1.5e3


def read_tum(path: str | Path) -> Trajectory:
    """Reads a trajectory as stamps in ns, positions in m, and unit quaternions (w, x, y, z) of a frame in the world.

    `#` begins a comment. Quaternions are normalised.

    Raises:
        StrideTwinError: The file cannot be read, or a row is invalid; names line, column and what is valid.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    for number, line in enumerate(read_lines(Path(path)), 1):
        cells = line.partition("#")[0].replace(",", " ").split()
        if cells:
            rows.append(_parse_row(path, number, cells))
            stamps.append(parse_row_stamp(path, number, cells[0], parse_seconds))
            if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
                raise ConfigError(path, f"line {number}, t", cells[0], "a time after that of the previous row")
    if not rows:
        raise StrideTwinError(f"{path}: no pose: expected rows of {' '.join(_COLUMNS)}")
    table = np.array(rows)
    q = table[:, [7, 4, 5, 6]]  # w, x, y, z
    return Trajectory(
        t_ns=np.array(stamps, np.int64),
        p_frame_in_world=table[:, 1:4],
        q_world_frame=q / np.linalg.norm(q, axis=1, keepdims=True),
    )


def _parse_row(path: str | Path, number: int, cells: list[str]) -> list[float]:
    """The eight numbers of a row: time in s, position in m, and quaternion (x, y, z, w).

    Args:
        path: Named by errors.
        number: Number of the line in the file.
        cells: The words of the line.

    Raises:
        ConfigError: Another number of cells, a number out of range, or no unit quaternion.
    """
    if len(cells) != len(_COLUMNS):
        raise ConfigError(path, f"line {number}", " ".join(cells), f"8 numbers: {' '.join(_COLUMNS)}")
    values: list[float] = []
    for name, word in zip(_COLUMNS, cells, strict=True):
        try:
            values.append(float(word))
        except ValueError:
            values.append(np.nan)  # out of any range
        most = LATEST_S if name == "t" else _FARTHEST_M
        if not abs(values[-1]) < most:
            raise ConfigError(path, f"line {number}, {name}", word, f"a finite number, {-most:g} to {most:g}")
    if not 0.9 < float(np.linalg.norm(values[4:])) < 1.1:
        raise ConfigError(path, f"line {number}, qx qy qz qw", values[4:], "a unit quaternion")
    return values
