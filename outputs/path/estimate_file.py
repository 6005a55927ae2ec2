"""Trajectories of other tools beside a recording: which order of the quaternion and which world its truth shows."""

from __future__ import annotations

import math
from pathlib import Path

from stridetwin.outputs.path.quaternion_order import (
    is_inverse,
    is_mirrored,
    steps_to_order,
    tilt_of_world,
    turn_of_frame,
)
from stridetwin.outputs.truth import true_path
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.opening import print_warnings
from stridetwin.streams.formats.trajectory_columns import METRES, W_FIRST
from stridetwin.streams.formats.trajectory_file import TrajectoryFile, read_trajectory
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS, TrajectoryOptions
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory

_LEAST_SPREAD_M, _SAME_SPREAD = 0.3, 0.3
"""Standard deviation of true positions from which the unit of others is checked, and how far the two may differ in the
right one, as a share."""
_TILTED_RAD = math.radians(20.0)
"""A world that is tilted by more has no z axis upwards; an estimate of gravity is never so wrong."""

ASSUMED_W_FIRST = "its quaternions are read with w first (--quaternion wxyz); --quaternion xyzw if w is last"
"""Warning about a trajectory without names of columns."""


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
    print_warnings(name or file, notes.warnings)
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
        ConfigError: The positions are in cm or mm.
        RecordingError: There is no truth of the frame.
    """
    truth = true_path(recording, frame)
    inside = (read.path.t_ns >= truth.t_ns[0]) & (read.path.t_ns <= truth.t_ns[-1])
    if inside.sum() < 2:  # the scores refuse it
        return read
    poses = read.path[inside]
    true_poses = truth.at(poses.t_ns)
    _check_length_unit(notes.path, poses, true_poses)
    tilt = tilt_of_world(poses, true_poses)
    step = 1 if read.order == W_FIRST else -1
    if steps_to_order(poses, true_poses, (step,), by_shape=not read.is_order_known):
        if read.is_order_known:  # the scores refuse a wrong order that the user or a header has given
            return read
        read = _with_right_order(read, tilt, notes)
        tilt = tilt_of_world(read.path[inside], true_poses)
    elif read.order == W_FIRST and not read.is_order_known:
        notes.warn(ASSUMED_W_FIRST)
    if is_inverse(read.path[inside], true_poses):
        notes.warn("its attitudes are those of the world in the frame: expected the frame in the world, the inverse")
    elif turn := turn_of_frame(read.path[inside], true_poses):
        notes.warn(
            f"its frame is turned by {math.degrees(turn):.0f}° from {frame} all the way, as that of a camera is: "
            f"expected poses of {frame}, or --frame with the frame that they are of"
        )
    elif tilt > _TILTED_RAD and not may_tilt:
        notes.warn(
            f"its world's z axis is {math.degrees(tilt):.0f}° off the vertical, as in the world of a camera's first "
            "image: --align se3 rotates it; if the quaternion has another order, --quaternion says it"
        )
    elif not may_tilt and is_mirrored(read.path[inside], true_poses):
        notes.warn("its way is the true one with left and right exchanged: expected a right-handed world with z up")
    return read


def _check_length_unit(file: Path, poses: Trajectory, true_poses: Trajectory) -> None:
    """Refuses positions that spread 100 or 1000 times as far as the true ones at the same stamps.

    Raises:
        ConfigError: They do; the message has the option that says their unit.
    """
    spread, true_spread = (float(path.p_frame_in_world.std(axis=0).max()) for path in (poses, true_poses))
    if true_spread < _LEAST_SPREAD_M:
        return
    for unit in ("cm", "mm"):
        if abs(spread * METRES[unit] / true_spread - 1.0) < _SAME_SPREAD:
            ratio = f"{spread / true_spread:.0f} times as far apart as the true ones"
            raise ConfigError(file, "positions", ratio, f"metres; --length-unit {unit} reads them as {unit}")


def _with_right_order(read: TrajectoryFile, tilt: float, notes: Notes) -> TrajectoryFile:
    """The trajectory with its quaternions in the other order, with a note that says so.

    Args:
        read: In the wrong order.
        tilt: Of its world by the truth, rad.
        notes: Gets the note.
    """
    settled = read.with_other_order()
    wrong, right = ("w last", "w first") if settled.order == W_FIRST else ("w first", "w last")
    is_turn = tilt > _TILTED_RAD
    off = f"its attitude is {math.degrees(tilt):.0f}° off all the way" if is_turn else "its attitude does not fit"
    notes.warn(
        f"the truth says that its quaternions have {right}: with {wrong} {off}; read as {settled.order}, --quaternion "
        f"{settled.order} says so, --quaternion {read.order} keeps the other order"
    )
    return settled
