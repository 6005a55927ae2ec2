"""The paths of both feet from a stream of samples."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stridetwin.estimators.base import FEET, PROPOSED, Options, PathEstimate
from stridetwin.estimators.foot_ins.filter import FootInsEstimate, FootInsPath
from stridetwin.estimators.foot_to_foot.filter import FootToFoot
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Image, Imu, Range, Sample
from stridetwin.streams.trajectory import Trajectory


def follow(estimator: FootToFoot, samples: Iterable[Sample]) -> dict[str, FootInsPath]:
    """Estimates after each usable IMU sample.

    Args:
        estimator: Takes the samples.
        samples: In time order, images included; samples of other kinds are skipped.

    Returns:
        Path of each foot with samples, by `l` and `r`, as of `FootIns.run`.
    """
    rows: dict[str, list[FootInsEstimate]] = {}
    for sample in samples:
        if not isinstance(sample, Imu | Image | Range):
            continue
        estimate = estimator.update(sample)
        if estimate is not None and isinstance(sample, Imu):
            foot = estimator.foot_of(sample)
            rows.setdefault(foot, []).append(estimate.feet[foot])
    return {foot: _path(own) for foot, own in sorted(rows.items())}


def follow_recording(estimator: FootToFoot, recording: Recording, options: Options) -> list[PathEstimate]:
    """`FootToFoot.follow`."""
    declaration = estimator.declaration
    streams = [s for s in estimator.streams(recording.rig, options) if s.required or s.topic in recording.topics]
    if any(s.kind is Image for s in streams):
        paths = follow(estimator, recording.samples([s.topic for s in streams]))
    else:  # no image is searched at a prediction, so one block gives the same numbers
        blocks = {foot: recording.block(f"/foot_{foot}/imu") for foot in FEET}
        echoes = [sample for s in streams if s.kind is Range for sample in recording.block(s.topic)]
        paths = estimator.run(blocks, echoes)
    world = declaration.name if options.method == PROPOSED else f"{declaration.name}_{options.method}"
    common = {kind: value for kind, value in estimator.nis.items() if not kind.startswith("standing")}
    found = []
    for foot, path in paths.items():
        standing = estimator.nis.get(f"standing_{foot}")
        nis = common if standing is None else {"standing": standing, **common}
        found.append(path.estimate(recording, world, foot, declaration.label or "", nis, world))
    return found


def _path(rows: list[FootInsEstimate]) -> FootInsPath:
    pose = np.r_[0:3, 6:9]  # position and attitude among the 15 errors
    return FootInsPath(
        trajectory=Trajectory(
            t_ns=np.array([e.t_ns for e in rows], np.int64),
            p_frame_in_world=np.array([e.pose.p_frame_in_world for e in rows]),
            q_world_frame=np.array([e.pose.q_world_frame for e in rows]),
            covariance=np.array([e.covariance[np.ix_(pose, pose)] for e in rows]),
        ),
        v_imu_in_world=np.array([e.v_imu_in_world for e in rows]),
        standing_speed_sd=np.array([e.standing_speed_sd for e in rows]),
        aligned=np.array([e.aligned for e in rows]),
    )
