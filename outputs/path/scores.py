"""Scores of an estimated path relative to the true one: vectorised, deterministic, units in the names.

Definitions follow Sturm et al. 2012 (IROS) and Zhang & Scaramuzza 2018 (IROS): absolute pose error (APE)
after one alignment, relative pose error (RPE) over a distance travelled. NEES: Bar-Shalom et al. 2001, 5.4.

An odometry with gravity cannot observe position and heading, so its path is aligned by a translation and a rotation
about the vertical. A closed loop hides a wrong scale and wrong extrinsics; the error over 5 m of path reveals both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.outputs.alignment import Rigid, align, vertical_rotation
from stridetwin.outputs.base import CLAIM, DESCRIPTIVE, SHARE, Score, Scores
from stridetwin.outputs.coverage import COVERAGE, compute_covered_share, reaches_end
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

RPE_DISTANCES_M = (1.0, 5.0)
RPE_SPACING_M = 0.1  # distance between the starts of two stretches
CHI2_3_95 = 7.814727903251179  # 95 % quantile of the chi-square distribution with 3 degrees of freedom
_VARIANCE_FLOOR_M2 = 1e-12  # added to variances, so that a covariance of 0 can be inverted
LOST_M = 2.0  # a path farther away than this is off
SPAN_M = 5.0  # length of the stretches of path over which drift and climbs are taken
_MOVED_M = 0.1  # least distance of which an error is a percentage
CLIMB_M = 0.3  # least change of height of a stretch that counts as a climb

SCORES = (
    Score(name="end_error_m", heading="end m", label="End error", unit="m", digits=4),
    Score(name="end_error_pct", heading="end %", label="End error, share of the distance", unit="%", digits=3),
    Score(
        name="end_height_error_m", signed=True, heading="height m", label="Height error at the end", unit="m", digits=4
    ),
    Score(name="ape_rmse_m", heading="APE RMSE m", label="Position error, RMS", unit="m", digits=4),
    Score(name="ape_mean_m", label="Position error, mean", unit="m", digits=4),
    Score(name="ape_max_m", label="Position error, largest", unit="m", digits=4),
    Score(name="rpe_1m_pct", label="Relative error over 1 m", unit="%"),
    Score(name="rpe_5m_pct", heading="RPE 5 m %", label="Relative error over 5 m", unit="%"),
    Score(
        name="armse_2d_m",
        heading="2-D ARMSE m",
        label="2-D ARMSE (as the pyshoe benchmark defines it)",
        unit="m",
        digits=4,
    ),
    Score(name="nees_position_mean", scale=CLAIM, label="NEES of the position, mean (3 if consistent)"),
    Score(
        name="nees_position_within_95_pct",
        scale=SHARE,
        heading="in 95 % bound %",
        label="Time within its own 95 % bound",
        unit="%",
        digits=1,
    ),
    Score(name="nis_standing", scale=CLAIM, label="Zero-velocity updates, NIS per degree of freedom (1 if consistent)"),
    Score(name="nis_sightings", scale=CLAIM, label="Checkerboard observations, NIS per degree of freedom"),
    Score(name="nis_echoes", scale=CLAIM, label="Sonar ranges, NIS per degree of freedom"),
    Score(name="distance_m", scale=DESCRIPTIVE, label="Distance travelled by the frame", unit="m"),
    Score(name="duration_s", scale=DESCRIPTIVE),
    COVERAGE,
)
"""The scores of a path. The NIS of other measurements, `nis_KIND`, are claims, too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PathComparison:
    """An estimate aligned with the truth, at the estimate's stamps.

    Attributes:
        estimate: N poses in the truth's world.
        truth: The N true poses.
        distance_m: (N,) m travelled by the true frame since the truth's first sample.
        coverage: Share of the truth's duration that the estimate covers, without its holes, 0-1.
        reaches_end: Whether the estimate lasts until the truth ends.
        transform: Transform from the estimate's own world to the truth's.
    """

    estimate: Trajectory
    truth: Trajectory
    distance_m: Array
    coverage: float
    transform: Rigid
    reaches_end: bool = True

    @property
    def error_m(self) -> Array:
        """(N, 3) m, estimate minus truth in world axes."""
        return self.estimate.p_frame_in_world - self.truth.p_frame_in_world


def compare(
    estimate: Trajectory,
    path: TruePath,
    alignment: str = "start",
    transform: Rigid | None = None,
    ready_ns: int = 0,
) -> PathComparison:
    """Aligns an estimate with the truth.

    Args:
        estimate: Poses in any world that differs from the truth's by a translation and a rotation (see `align`).
        path: The true path of the same frame.
        alignment: `start`, `yaw` or `se3`.
        transform: Replaces the alignment, if another frame in the same world has fixed it.
        ready_ns: The poses before this time are left out, and it counts as not covered.

    Raises:
        RecordingError: The estimate is not finite, or has fewer than two stamps within the truth's span.
    """
    finite = np.isfinite(estimate.p_frame_in_world).all(axis=1) & np.isfinite(estimate.q_world_frame).all(axis=1)
    if not finite.all():
        at = estimate.t_ns[(~finite).argmax()] / 1e9
        raise RecordingError(f"the estimate is not finite at t = {at:.3f} s; every pose must be")
    span_ns, path = (int(path.t_ns[0]), int(path.t_ns[-1])), path.since(ready_ns)
    inside = (estimate.t_ns >= path.t_ns[0]) & (estimate.t_ns <= path.t_ns[-1])
    if inside.sum() < 2:
        raise RecordingError(
            f"{inside.sum()} poses of the estimate lie within the truth's "
            f"{path.t_ns[0] / 1e9:.3f}-{path.t_ns[-1] / 1e9:.3f} s; at least 2 are needed"
        )
    # the truth is interpolated at the estimate's stamps
    inside_poses = estimate[inside]
    truth = path.at(inside_poses.t_ns)
    transform = transform or align(inside_poses, truth, alignment)
    return PathComparison(
        estimate=transform.apply(inside_poses),
        truth=truth,
        distance_m=np.interp(inside_poses.t_ns, path.t_ns, path.distance_m),
        coverage=compute_covered_share(inside_poses.t_ns, *span_ns),
        reaches_end=reaches_end(inside_poses.t_ns, span_ns[1]),
        transform=transform,
    )


def score(comparison: PathComparison, alone: bool = True) -> Scores:
    """Every score of one estimate.

    Args:
        comparison: The aligned estimate.
        alone: Its world is not shared with the estimate of another frame.

    Returns:
        `ape_{rmse,mean,max}_m`; `rpe_1m_pct`, `rpe_5m_pct` (mean relative error, % of the distance; left out if
        the walk is shorter); `end_error_m`, `end_error_pct` (% of the distance travelled by the frame, left out if it
        did not move) and `end_height_error_m` (signed), unless the estimate ends before the truth; `armse_2d_m` if
        `alone`, because it rotates each estimate by itself;
        `nees_position_mean` (3 for a consistent filter) and `nees_position_within_95_pct` if the estimate has
        a covariance; `distance_m`, `duration_s`, `coverage_pct`.
    """
    error = comparison.error_m
    norm = np.linalg.norm(error, axis=1)
    distance = float(comparison.distance_m[-1] - comparison.distance_m[0])
    t_ns = comparison.truth.t_ns
    scores = {
        "ape_rmse_m": float(np.sqrt(np.mean(norm**2))),
        "ape_mean_m": float(norm.mean()),
        "ape_max_m": float(norm.max()),
        "distance_m": distance,
        "duration_s": float((t_ns[-1] - t_ns[0]) / 1e9),
        "coverage_pct": 100.0 * comparison.coverage,
    }
    if alone:
        scores["armse_2d_m"] = armse_2d(comparison.estimate.p_frame_in_world, comparison.truth.p_frame_in_world)
    if comparison.reaches_end:
        scores["end_error_m"], scores["end_height_error_m"] = float(norm[-1]), float(error[-1, 2])
        if distance > _MOVED_M:
            scores["end_error_pct"] = 100.0 * scores["end_error_m"] / distance
    for span in RPE_DISTANCES_M:
        errors = relative_errors_m(comparison, span)
        if len(errors):
            scores[f"rpe_{span:g}m_pct"] = float(100.0 * errors.mean() / span)
    if comparison.estimate.covariance is not None:  # without one nothing is claimed that could be checked
        nees = nees_position(comparison)
        scores["nees_position_mean"] = float(nees.mean())
        scores["nees_position_within_95_pct"] = float(100.0 * np.mean(nees <= CHI2_3_95))
    return scores


def relative_errors_m(comparison: PathComparison, span_m: float) -> Array:
    """Error of the relative translation over every stretch of `span_m` of the true path.

    Stretches start each 0.1 m travelled, so that stationary phases do not count. Each is rotated about the vertical
    so that the headings agree at its start (Zhang & Scaramuzza 2018: tilt is observable from gravity, heading is
    not), which makes the result independent of the alignment.

    Returns:
        (K,) m; empty if the path is shorter than the span.
    """
    estimate, truth = comparison.estimate, comparison.truth
    starts, ends = _stretches(comparison.distance_m, span_m)
    if not len(starts):
        return np.empty(0)
    # at the start of each stretch, the true attitude and the estimated one, and the difference of their headings
    attitudes = [Rotation.from_quat(p.q_world_frame[starts], scalar_first=True) for p in (truth, estimate)]
    rotation = vertical_rotation((attitudes[0] * attitudes[1].inv()).as_matrix())
    # (K, 3) m, displacement over each stretch
    estimated_moves, true_moves = (p.p_frame_in_world[ends] - p.p_frame_in_world[starts] for p in (estimate, truth))
    rotated_moves = np.einsum("nij,nj->ni", rotation, estimated_moves)
    return np.asarray(np.linalg.norm(rotated_moves - true_moves, axis=1))


def _stretches(distance_m: Array, span_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last index of every stretch of `span_m` of a path; a stretch starts each 0.1 m travelled.

    Args:
        distance_m: (N,) m travelled up to each pose, not decreasing.
        span_m: Length of the stretches, m.

    Returns:
        Two arrays of the same length, which is 0 if the path is shorter than the span.
    """
    starts = np.searchsorted(distance_m, np.arange(distance_m[0], distance_m[-1] - span_m, RPE_SPACING_M))
    ends = np.searchsorted(distance_m, distance_m[starts] + span_m)
    is_complete = ends < len(distance_m)  # the path does not end before the stretch does
    return starts[is_complete], ends[is_complete]


def nees_position(comparison: PathComparison) -> Array:
    """Normalised estimation error squared of the position, eᵀ P⁻¹ e; χ² with 3 degrees of freedom if consistent.

    Returns:
        (N,) values. The alignment removes the error of the first pose, so the value is close to 0 there.
    """
    covariance = comparison.estimate.covariance
    if covariance is None:
        raise ValueError("the estimate has no covariance")
    P = covariance[:, :3, :3] + _VARIANCE_FLOOR_M2 * np.eye(3)
    e = comparison.error_m  # (N, 3) m
    P_inverse_e = np.linalg.solve(P, e[..., None])[..., 0]
    return np.asarray(np.einsum("ni,ni->n", e, P_inverse_e))


def armse_2d(estimate: Array, truth: Array, far_m: float = 0.8) -> float:
    """Horizontal error as the pyshoe benchmark defines its "2-D ARMSE".

    Both paths start at 0; the estimate is rotated about z so that its bearing agrees with the truth's where it is
    first `far_m` from its start; the result is the mean over all samples of sqrt((ex² + ey²) / 2).

    Args:
        estimate: (N, 2 or 3) m.
        truth: (N, 2 or 3) m at the same stamps.
        far_m: Distance that fixes the bearing.
    """
    e, g = estimate[:, :2] - estimate[0, :2], truth[:, :2] - truth[0, :2]  # (N, 2) m: estimate and ground truth
    # index of the sample that fixes the bearing; the last one if the estimate never gets that far
    far = np.linalg.norm(e, axis=1) > far_m
    i = int(np.argmax(far)) if far.any() else len(e) - 1
    # angle by which the estimate is rotated, rad; rows are points, so the matrix is the transpose of the rotation
    a = np.arctan2(g[i, 1], g[i, 0]) - np.arctan2(e[i, 1], e[i, 0])
    rotated = e @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    return float(np.mean(np.sqrt(((rotated - g) ** 2).sum(axis=1) / 2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryPath:
    """The path of an odometry.

    Attributes:
        path: N poses of the IMU in a world of the odometry's own.
        healthy: (N,) whether the odometry reports each pose as healthy.
    """

    path: Trajectory
    healthy: NDArray[np.bool_]


class ConsistencyFigures(TypedDict, total=False):
    """NEES of a position, which only a path with covariance has."""

    nees_mean: float
    nees_within_95_pct: float


class DriftFigures(ConsistencyFigures):
    """Drift and failure of an odometry on one walk, see `drift_figures`."""

    failure: str
    unhealthy_s: float
    recovered: bool
    loop_drift_m: NotRequired[float]
    loop_drift_xyz_m: NotRequired[list[float]]
    ape_rmse_m: NotRequired[float]
    rpe_5m_pct: NotRequired[float | None]
    height_rmse_m: NotRequired[float]
    climb_error_m: NotRequired[float | None]
    coverage_pct: NotRequired[float]


def drift_figures(odometry: OdometryPath, truth: TruePath) -> DriftFigures:
    """Drift and failure of an odometry on one walk, from its first healthy pose on, ready for JSON.

    Args:
        odometry: The estimated path.
        truth: True path of the same frame.

    Returns:
        `failure`: "" or what went wrong: `silent` (no two healthy poses), `not finite`, `lost` (declared) or `off`
        (more than 2 m away with start or path aligned). `unhealthy_s`: how long it reported itself lost after its first
        healthy pose, and `recovered` whether it was healthy at the end. Except after the first two failures also
        `loop_drift_m` and `loop_drift_xyz_m` (error at the end with the start aligned), `ape_rmse_m` (path aligned),
        `rpe_5m_pct` (None if the walk is shorter), `height_rmse_m` (start aligned), `climb_error_m` (`climb_errors_m`,
        the largest; None without climbs), `coverage_pct` of the walk, and with a covariance `nees_mean` and
        `nees_within_95_pct` of the position.
    """
    # the first healthy pose; without any, nothing remains
    first = int(odometry.healthy.argmax()) if odometry.healthy.any() else len(odometry.healthy)
    path, healthy = odometry.path[first:], odometry.healthy[first:]
    inside = (path.t_ns >= truth.t_ns[0]) & (path.t_ns <= truth.t_ns[-1])
    if inside.sum() < 2:
        return {"failure": "silent", "unhealthy_s": 0.0, "recovered": False}
    # time that each pose stands for, s; 0 for the last one
    steps = np.diff(path.t_ns, append=path.t_ns[-1]) * 1e-9
    unhealthy_s = float(steps[~healthy].sum())
    if not (np.isfinite(path.p_frame_in_world).all() and np.isfinite(path.q_world_frame).all()):
        return {"failure": "not finite", "unhealthy_s": unhealthy_s, "recovered": False}
    # compared with the first pose aligned, and with the whole path aligned
    from_start, from_fit = compare(path, truth, "start"), compare(path, truth, "yaw")
    error = from_start.error_m  # (N, 3) m
    distances = np.linalg.norm(from_fit.error_m, axis=1)
    relative, climbs = relative_errors_m(from_fit, SPAN_M), climb_errors_m(from_fit)
    is_off = max(float(distances.max()), float(np.linalg.norm(error, axis=1).max())) > LOST_M
    return {
        "failure": "lost" if not healthy.all() else "off" if is_off else "",
        "unhealthy_s": unhealthy_s,
        "recovered": bool(healthy[-1]),
        "loop_drift_m": float(np.linalg.norm(error[-1])),
        "loop_drift_xyz_m": error[-1].tolist(),
        "ape_rmse_m": float(np.sqrt(np.mean(distances**2))),
        "rpe_5m_pct": 100.0 * float(relative.mean()) / SPAN_M if len(relative) else None,
        "height_rmse_m": float(np.sqrt(np.mean(error[:, 2] ** 2))),
        "climb_error_m": float(np.abs(climbs).max()) if len(climbs) else None,
        "coverage_pct": 100.0 * from_start.coverage,
        **_consistency(from_start),
    }


def climb_errors_m(comparison: PathComparison) -> Array:
    """Error of the height gain over every stretch of 5 m of the path on which it rises or falls by more than 0.3 m.

    Stretches start each 0.1 m travelled, so that they overlap.

    Returns:
        (K,) m, estimated minus true; empty if there are none.
    """
    starts, ends = _stretches(comparison.distance_m, SPAN_M)
    estimated, true = (p.p_frame_in_world[:, 2] for p in (comparison.estimate, comparison.truth))  # (N,) m, heights
    true_gain = true[ends] - true[starts]
    error: Array = estimated[ends] - estimated[starts] - true_gain
    return error[np.abs(true_gain) > CLIMB_M]


def _consistency(comparison: PathComparison) -> ConsistencyFigures:
    """Mean NEES of the position, 3 if consistent, and share within the 95 % bound, %; empty without a covariance."""
    if comparison.estimate.covariance is None:
        return {}
    nees = nees_position(comparison)
    return {"nees_mean": float(nees.mean()), "nees_within_95_pct": 100.0 * float(np.mean(nees <= CHI2_3_95))}
