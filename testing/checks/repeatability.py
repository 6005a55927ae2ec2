"""Equal samples give equal estimates: again, beside another instance, at any later time, and in `follow`."""

from __future__ import annotations

import numpy as np

from stridetwin.estimators.base import PathEstimate
from stridetwin.streams.samples import copy_sample
from stridetwin.streams.trajectory import Pose, Trajectory, trajectory_of
from stridetwin.testing.leaves import difference, flatten
from stridetwin.testing.subject import (
    ConformanceError,
    Returned,
    Subject,
    call_update,
    describe,
    feed,
    pose_of,
    require_equal,
    skip,
)


def check_deterministic(subject: Subject) -> None:
    """A second instance returns the same estimates, bit by bit."""
    require_equal(
        feed(subject.create(), subject.walk.samples),
        subject.reference,
        "a second instance returned other estimates for the same samples; use no clock, no random number without a "
        "fixed seed, and no state of the class or module",
    )


def check_independent(subject: Subject) -> None:
    """Two instances that take samples in turn, one a third of the walk behind, return what each returns alone."""
    samples = subject.walk.samples
    lag = len(samples) // 3  # samples by which the second instance is behind
    instances = subject.create(), subject.create()
    returned: tuple[list[Returned], list[Returned]] = [], []  # estimates of each
    for turn in range(2 * lag):
        for instance, estimates, i in zip(instances, returned, (turn, turn - lag)):
            if i >= 0:  # the second instance begins when the first one is `lag` samples ahead
                sample = copy_sample(samples[i])
                if (estimate := call_update(instance, sample)) is not None:
                    estimates.append(Returned(i, sample.t_ns, estimate, flatten(estimate)))
    for estimates, end in zip(returned, (2 * lag, lag)):  # number of samples that each instance has taken
        require_equal(
            estimates,
            [one for one in subject.reference if one.index < end],
            "two instances that take samples in turn influence each other; keep all state in the instance",
        )


def check_causal(subject: Subject) -> None:
    """An estimate, which `update` can make of the samples so far alone, does not change after it was returned."""
    for one in subject.reference:
        if text := difference(flatten(one.estimate), one.leaves):  # its values now, and when it was returned
            raise ConformanceError(
                f"the estimate at {one.t_ns * 1e-9:.3f} s changed after it was returned ({text}): return copies of the "
                "state's arrays"
            )


def check_follow(subject: Subject) -> None:
    """`follow` on the whole recording gives the poses of `update` sample by sample."""
    follow = getattr(subject.estimator_class, "follow", None)
    if follow is None:
        raise skip("the estimator has no follow")
    walk = subject.walk
    try:
        paths: list[PathEstimate] = follow(walk.recording, walk.options, None)  # None: without progress
    except Exception as error:
        raise ConformanceError(f"follow raised {describe(error)}") from error
    poses: dict[str, list[Pose]] = {}  # those of `update`, by frame
    for returned in subject.reference:
        if (pose := pose_of(returned.estimate)) is not None:
            poses.setdefault(pose.frame, []).append(pose)
    for path in paths:
        if path.frame not in poses:
            frames = ", ".join(poses)
            raise ConformanceError(f"follow gives a path of {path.frame!r}; the poses of update are of {frames!r}")
        _require_same_path(path.path, trajectory_of(poses[path.frame]), path.frame)


def _require_same_path(path: Trajectory, expected: Trajectory, frame: str) -> None:
    """Two paths have the stamps, positions and rotations of each other, bit by bit.

    Args:
        path: Path of `follow`.
        expected: Path of `update`, sample by sample.
        frame: Their frame, for the message.

    Raises:
        ConformanceError: They differ.
    """
    advice = "let follow call update, or both the same function"
    if not np.array_equal(path.t_ns, expected.t_ns):
        raise ConformanceError(
            f"follow gives {len(path)} poses of {frame}, update {len(expected)}, or at other stamps: {advice}"
        )
    for name in ("p_frame_in_world", "q_world_frame"):
        values, others = getattr(path, name), getattr(expected, name)
        if values.tobytes() != others.tobytes():
            largest = np.abs(values - others).max()
            raise ConformanceError(f"{name} of {frame} differs between follow and update by {largest:.3g}: {advice}")
