"""Trajectories of other tools beside a recording: which order of the quaternion and which world its truth shows."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from stridetwin.outputs.path.quaternion_order import steps_to_order, tilt_of_world
from stridetwin.outputs.truth import true_path
from stridetwin.streams.formats.trajectory_columns import W_FIRST
from stridetwin.streams.formats.trajectory_file import TrajectoryFile, read_trajectory
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS, TrajectoryOptions
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory

_TILTED_RAD = math.radians(20.0)
"""A world that is tilted by more has no z axis upwards; an estimate of gravity is never so wrong."""


def read_estimate(
    file: Path,
    recording: Recording,
    frame: str,
    options: TrajectoryOptions = NO_OPTIONS,
    alignment: str = "start",
    name: str = "",
) -> Trajectory:
    """Reads the trajectory of a frame with the truth of a recording as a witness, and prints warnings on stderr.

    Args:
        file: In one of the forms of `read_trajectory`.
        recording: With the true path of the frame.
        frame: Such as `foot_l/imu`.
        options: What the user says about the file.
        alignment: Of the scores, see `alignment.align`; with `se3` its world may have any attitude.
        name: What warnings call the file; "" is its path.

    Raises:
        StrideTwinError: The file is invalid or not of this recording, or there is no truth of the frame.
    """
    notes = Notes(file, lenient=False)
    read = read_trajectory(file, options, span_ns=span_of(recording), notes=notes)
    read = settle_order(read, recording, frame, notes, may_tilt=alignment == "se3")
    for warning in notes.warnings:
        print(f"stridetwin: warning: {name or file}: {warning}", file=sys.stderr)
    return read.path


def span_of(recording: Recording) -> tuple[int, int] | None:
    """First and last stamp of a recording, ns; None if it is empty."""
    topics = recording.topics.values()
    return (min(t.first_ns for t in topics), max(t.last_ns for t in topics)) if topics else None


def settle_order(
    read: TrajectoryFile, recording: Recording, frame: str, notes: Notes, *, may_tilt: bool
) -> TrajectoryFile:
    """The trajectory with the order of the quaternion that agrees with the truth, unless it is known.

    Args:
        read: As it was read.
        recording: With the true path of the frame.
        frame: Such as `foot_l/imu`.
        notes: Collects what was changed, and a world whose z axis is not up.
        may_tilt: The world may have any attitude.

    Raises:
        RecordingError: There is no truth of the frame.
    """
    truth = true_path(recording, frame)
    inside = (read.path.t_ns >= truth.t_ns[0]) & (read.path.t_ns <= truth.t_ns[-1])
    if inside.sum() < 2:  # the scores refuse it
        return read
    poses = read.path[inside]
    true_poses = truth.at(poses.t_ns)
    tilt = tilt_of_world(poses, true_poses)
    step = -1 if read.order != W_FIRST else 1
    if not read.is_order_known and steps_to_order(poses, true_poses, (step,)):
        settled = read.with_other_order()
        orders = "w last, not first" if settled.order != W_FIRST else "w first"
        notes.warn(
            f"as {read.order} its attitude is off the truth all the way (its z axis by {math.degrees(tilt):.0f}°), as "
            f"{settled.order} it agrees: read with {orders}; --quaternion {settled.order} says so, "
            f"--quaternion {read.order} keeps the other order"
        )
        return settled
    if tilt > _TILTED_RAD and not may_tilt:
        notes.warn(
            f"its world's z axis is {math.degrees(tilt):.0f}° off the vertical, as in the world of a camera's first "
            "image: --align se3 rotates it; if the quaternion has another order, --quaternion says it"
        )
    return read
