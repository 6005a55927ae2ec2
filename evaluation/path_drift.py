"""Scores of a visual-inertial path: loop drift, error after alignment, relative error, and failure.

Only position and heading are unobservable to an odometry with gravity: every alignment is a translation and a rotation
about the vertical (Zhang & Scaramuzza 2018). Absolute error: Sturm et al. 2012. A closed loop hides a wrong scale and
wrong extrinsics; the error over 5 m of path reveals both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.evaluation.path_scores import CHI2_3_95, Comparison, compare, nees_position, relative_errors_m
from stridetwin.evaluation.truth import TruePath
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

LOST_M = 2.0
SPAN_M = 5.0
CLIMB_M = 0.3
_SPACING_M = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Odometry:
    """The output of an odometry on a walk.

    Attributes:
        path: N poses of the IMU in a world of its own.
        healthy: (N,) whether it reports itself healthy.
    """

    path: Trajectory
    healthy: NDArray[np.bool_]


def drift_figures(told: Odometry, truth: TruePath) -> dict[str, Any]:
    """The figures of one walk, ready for JSON, from the first healthy pose on.

    Args:
        told: Output of the odometry.
        truth: True path of the same frame.

    Returns:
        `failure`: "" or what went wrong: `silent` (no two healthy poses), `not finite`, `lost` (declared) or `off`
        (more than 2 m away with start or path aligned). `unhealthy_s`: how long it reported itself lost after its first
        healthy pose, and `recovered` whether it was healthy at the end. Except after the first two failures also
        `loop_drift_m` and `loop_drift_xyz_m` (error at the end with the start aligned), `ape_rmse_m` (path aligned),
        `rpe_5m_pct` (None if the walk is shorter), `height_rmse_m` (start aligned), `climb_error_m`
        (`climb_errors_m`, the largest; None without climbs), `coverage_pct` of the walk, and with a covariance
        `nees_mean` and `nees_within_95_pct` of the position.
    """
    first = int(told.healthy.argmax()) if told.healthy.any() else len(told.healthy)
    path, healthy = told.path[first:], told.healthy[first:]
    inside = (path.t_ns >= truth.t_ns[0]) & (path.t_ns <= truth.t_ns[-1])
    if inside.sum() < 2:
        return {"failure": "silent", "unhealthy_s": 0.0, "recovered": False}
    steps = np.diff(path.t_ns, append=path.t_ns[-1]) * 1e-9
    states: dict[str, Any] = {"unhealthy_s": float(steps[~healthy].sum()), "recovered": bool(healthy[-1])}
    if not (np.isfinite(path.p_frame_in_world).all() and np.isfinite(path.q_world_frame).all()):
        return {"failure": "not finite", **states, "recovered": False}
    from_start, fitted = compare(path, truth, "start"), compare(path, truth, "yaw")
    error = from_start.error_m
    away = np.linalg.norm(fitted.error_m, axis=1)
    relative, climbs = relative_errors_m(fitted, SPAN_M), climb_errors_m(fitted)
    off = max(float(away.max()), float(np.linalg.norm(error, axis=1).max())) > LOST_M
    return {
        "failure": "lost" if not healthy.all() else "off" if off else "",
        **states,
        "loop_drift_m": float(np.linalg.norm(error[-1])),
        "loop_drift_xyz_m": error[-1].tolist(),
        "ape_rmse_m": float(np.sqrt(np.mean(away**2))),
        "rpe_5m_pct": 100.0 * float(relative.mean()) / SPAN_M if len(relative) else None,
        "height_rmse_m": float(np.sqrt(np.mean(error[:, 2] ** 2))),
        "climb_error_m": float(np.abs(climbs).max()) if len(climbs) else None,
        "coverage_pct": 100.0 * from_start.coverage,
        **_honesty(from_start),
    }


def climb_errors_m(comparison: Comparison) -> Array:
    """Error of the height gain over every 5 m of path that rise or fall by more than 0.3 m.

    Returns:
        (K,) m, estimated minus true; empty if there are none.
    """
    s = comparison.distance_m
    starts = np.searchsorted(s, np.arange(s[0], s[-1] - SPAN_M, _SPACING_M))
    ends = np.searchsorted(s, s[starts] + SPAN_M)
    starts, ends = starts[ends < len(s)], ends[ends < len(s)]
    told, true = (p.p_frame_in_world[:, 2] for p in (comparison.estimate, comparison.truth))
    gained = true[ends] - true[starts]
    error: Array = told[ends] - told[starts] - gained
    return error[np.abs(gained) > CLIMB_M]


def _honesty(comparison: Comparison) -> dict[str, float]:
    if comparison.estimate.covariance is None:
        return {}
    nees = nees_position(comparison)
    return {"nees_mean": float(nees.mean()), "nees_within_95_pct": 100.0 * float(np.mean(nees <= CHI2_3_95))}
