"""The paths of both feet from a stream of samples."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stridetwin.estimators.foot_ins.filter import FootInsEstimate, FootInsPath
from stridetwin.estimators.foot_to_foot.filter import FootToFoot
from stridetwin.streams.samples import Image, Imu, Range, Sample
from stridetwin.streams.trajectory import Trajectory


def follow(estimator: FootToFoot, samples: Iterable[Sample]) -> dict[str, FootInsPath]:
    """What was believed after each usable IMU sample.

    Args:
        estimator: Takes the samples.
        samples: In order of time, pictures included; of other kinds they are passed over.

    Returns:
        Path of each foot that gave a sample, by `l` and `r`, as of `FootIns.run`.
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


def _path(rows: list[FootInsEstimate]) -> FootInsPath:
    pose = np.r_[0:3, 6:9]  # position and attitude among the 15 errors
    return FootInsPath(
        trajectory=Trajectory(
            t_ns=np.array([e.t_ns for e in rows], np.int64),
            p_frame_in_world=np.array([e.p_imu_in_world for e in rows]),
            q_world_frame=np.array([e.q_world_imu for e in rows]),
            covariance=np.array([e.covariance[np.ix_(pose, pose)] for e in rows]),
        ),
        v_imu_in_world=np.array([e.v_imu_in_world for e in rows]),
        standing_speed_sd=np.array([e.standing_speed_sd for e in rows]),
        aligned=np.array([e.aligned for e in rows]),
    )
