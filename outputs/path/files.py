"""Estimated paths as files: TUM trajectories, or tables with status and covariance.

An odometry without images continues on its IMU alone, and its error grows with the square of the time. Unless asked
otherwise, a file holds the poses that the estimator trusts and that no long dead reckoning has led to.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import DEPTH_ONLY, TRACKING, AnyEstimator, Declaration, PathEstimate
from stridetwin.outputs.base import LiveOutput, part_file
from stridetwin.outputs.csv_tables import write_table
from stridetwin.outputs.path.run import pose_of
from stridetwin.streams.files import partial_path
from stridetwin.streams.formats.tum import format_seconds, write_tum
from stridetwin.streams.trajectory import Trajectory

DEAD_RECKONING_S = 1.0
"""Poses longer than this after the last tracked one are left out, s: a consumer IMU is then off by some centimetres."""
TABLE = ".csv"
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UPPER = np.triu_indices(6)
COLUMNS = (
    "t_s",
    "x_m",
    "y_m",
    "z_m",
    "qx",
    "qy",
    "qz",
    "qw",
    "status",
    *(f"cov_{_AXES[i]}_{_AXES[j]}" for i, j in zip(*_UPPER)),
)
"""Covariance of position (m) and of rotation about the world's axes (rad), its upper triangle by rows."""


def is_reliable(estimate: PathEstimate) -> NDArray[np.bool_]:
    """(N,) whether each pose is trusted and at most `DEAD_RECKONING_S` after one that images or depth hold."""
    t_ns = estimate.path.t_ns
    keep = np.ones(len(t_ns), bool) if estimate.healthy is None else estimate.healthy.copy()
    if estimate.status is not None:
        held = np.isin(estimate.status, (TRACKING, DEPTH_ONLY))
        # time of each pose that is held; every other pose has a time so early that it never counts as recently tracked
        tracked_ns = np.where(held, t_ns, t_ns[0] - round(2e9 * DEAD_RECKONING_S))
        last_tracked_ns = np.maximum.accumulate(tracked_ns)  # of each pose, the last tracked one up to it
        keep &= t_ns - last_tracked_ns <= DEAD_RECKONING_S * 1e9
    return keep


def write_path(estimate: PathEstimate, file: Path, *, dead_reckoning: bool = False) -> tuple[int, str]:
    """Writes a path: a table of `COLUMNS` if the file ends in `.csv`, else a TUM trajectory.

    Args:
        estimate: The path.
        file: The file.
        dead_reckoning: Whether unreliable poses (`is_reliable`) are written too; they are in any case if no pose is
            reliable.

    Returns:
        The number of poses, and a message about them.
    """
    keep = is_reliable(estimate)
    is_written = np.ones(len(keep), bool) if dead_reckoning or not keep.any() else keep
    path = estimate.path[is_written]
    if file.suffix == TABLE:
        status = None if estimate.status is None else estimate.status[is_written]
        write_table(COLUMNS, _format_rows(path, status), file)
    else:
        write_tum(path, file)
    return len(path), f"{file}: {len(path)} poses{_describe_unreliable(estimate.path, keep, dead_reckoning)}"


def _describe_unreliable(path: Trajectory, keep: NDArray[np.bool_], written: bool) -> str:
    """The end of the message of `write_path`: says how many poses are not reliable, and what happened to them.

    Args:
        path: All poses, also those that were not written.
        keep: (N,) whether each pose is reliable.
        written: Whether the user asked for the unreliable poses too.

    Returns:
        Text that begins with ";", also about a loss of tracking before the end; "" if all poses are reliable.
    """
    if keep.all():
        return ""
    handling = "included" if written else "left out, --dead-reckoning includes them"
    if not keep.any():  # then `write_path` wrote all of them
        return "; tracking never began: all of them are unreliable"
    last = int(np.flatnonzero(keep)[-1])  # the last reliable pose
    lost_s = (int(path.t_ns[-1]) - int(path.t_ns[last])) * 1e-9
    end_text = f"; tracking ended {lost_s:.1f} s before the recording" if lost_s > DEAD_RECKONING_S else ""
    return f"{end_text}; {int((~keep).sum())} poses without tracking {handling}"


def _format_rows(path: Trajectory, status: NDArray[np.str_] | None) -> Iterator[list[str]]:
    """Rows of `COLUMNS`, one per pose; an unknown status or covariance gives empty cells.

    Args:
        path: The N poses that are written.
        status: (N,) status of each; None if the estimator has none.
    """
    # in the order of the columns: x, y, z, qx, qy, qz, qw
    poses = np.column_stack((path.p_frame_in_world, path.q_world_frame[:, [1, 2, 3, 0]])).tolist()
    statuses = [""] * len(path) if status is None else status.tolist()
    # the 21 numbers on and above the diagonal of each covariance
    upper = [None] * len(path) if path.covariance is None else path.covariance[:, *_UPPER].tolist()
    for t_ns, pose, status_text, covariance in zip(path.t_ns.tolist(), poses, statuses, upper):
        covariance_cells = [""] * len(_UPPER[0]) if covariance is None else [f"{v:.6g}" for v in covariance]
        yield [format_seconds(t_ns), *(f"{v:.9g}" for v in pose), status_text, *covariance_cells]


class LivePaths(LiveOutput):
    """The paths of one estimator in `live`: one row per pose, and one TUM file per part, which appears at the end.

    Args:
        declaration: Of the estimator.
        file: File to write; None only gives rows.
    """

    def __init__(self, declaration: Declaration, file: Path | None) -> None:
        self._name, self._parts = declaration.name, declaration.parts  # parts: frame to part, such as `l`
        parts = declaration.parts.values() or ("",)
        self._files = {} if file is None else {part: part_file(file, part) for part in parts}
        # open files by part, under temporary names until `finish`; `_rows` counts their rows
        self._out = {part: partial_path(path).open("w", encoding="ascii") for part, path in self._files.items()}
        self._rows: Counter[str] = Counter()

    def add(self, estimate: object) -> str | None:
        """The row of a pose as text, prefixed with its part if there are several; also writes it to the part's file.

        The row has time, position and quaternion (x, y, z, w). None comes back for an estimate without a pose.
        """
        if (pose := pose_of(estimate, self._name)) is None:
            return None
        part = self._parts.get(pose.frame, "")
        w, x, y, z = pose.q_world_frame.tolist()
        row = (
            f"{format_seconds(pose.t_ns)} {' '.join(f'{v:.9g}' for v in (*pose.p_frame_in_world.tolist(), x, y, z, w))}"
        )
        if part in self._out:
            self._out[part].write(row + "\n")
            self._rows[part] += 1
        return f"{part} {row}".lstrip()

    def finish(self, estimator: AnyEstimator) -> dict[Path, int]:
        """Moves the written files to their places; returns the number of poses in each. It needs no estimator."""
        for part, file in self._files.items():
            self._out[part].close()
            os.replace(partial_path(file), file)
        return {file: self._rows[part] for part, file in self._files.items()}

    def abandon(self) -> None:
        """Removes what has been written so far; existing files stay unchanged."""
        for part, file in self._files.items():
            self._out[part].close()
            partial_path(file).unlink(missing_ok=True)
