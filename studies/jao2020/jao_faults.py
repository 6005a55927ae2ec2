"""Foot-to-foot filter under injected faults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NotRequired

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators.foot_ins import StartPose
from stridetwin.estimators.foot_to_foot import Aiding, FootToFoot, FootToFootEstimate, follow
from stridetwin.outputs.truth import TruePath
from stridetwin.sim.faults.faults import FaultPlan
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Image, Imu
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.fault_injection import fault_plans, summarize_by_fault
from stridetwin.studies.jao2020.two_feet import FEET, FootScores, score_paths, true_start
from stridetwin.studies.result import Collected, FaultRow, Figures, NoPaper
from stridetwin.studies.walks import RecordedWalk, record_shoes

_FigureOfFeet = Literal["end_nees", "nees_mean", "nees_within_95_pct", "coverage_pct"]
# scores with a value per foot, of which the means over walks are given
_OF_FEET: tuple[_FigureOfFeet, ...] = ("end_nees", "nees_mean", "nees_within_95_pct", "coverage_pct")


class FaultFigures(FootScores):
    """Scores of both feet under one fault, with the reported uncertainty; only `error` where the filter refuses.

    Attributes:
        sd_max_m: Largest horizontal standard deviation of either foot.
        apart_sd_mean_m: Horizontal standard deviation of the feet's position to each other, mean over the walk.
        apart_sd_max_m: Its largest value.
        error: Message with which the filter refuses.
    """

    sd_max_m: float
    apart_sd_mean_m: float
    apart_sd_max_m: float
    error: NotRequired[str]


class _UncertaintyLog(FootToFoot):
    """Our filter, which records the uncertainty of the feet's relative position.

    Attributes:
        apart_sd: At each IMU sample, horizontal standard deviation of the feet's relative position, m.
    """

    def __init__(self, rig: Rig, start: Mapping[str, StartPose]) -> None:
        super().__init__(rig, start=start)
        self.apart_sd: list[float] = []

    def update(self, sample: Imu | Image | Aiding) -> FootToFootEstimate | None:
        """Updates the filter; records the standard deviation of the relative position after each IMU sample.

        For the feet's horizontal covariance blocks it is √tr(P_ll + P_rr - P_lr - P_rl).
        """
        estimate = super().update(sample)
        if estimate is not None and isinstance(sample, Imu):
            # (2, 2, 2, 2): foot, axis, foot, axis, of the horizontal axes; the states of both feet follow each other,
            # each with its position first
            P = estimate.covariance.reshape(2, len(estimate.covariance) // 2, 2, -1)[:, :2, :, :2]
            # (2, 2) m², covariance of the horizontal relative position; rounding may turn its trace negative
            apart = P[0, :, 0] + P[1, :, 1] - P[0, :, 1] - P[1, :, 0]
            self.apart_sd.append(math.sqrt(max(np.trace(apart), 0.0)))
        return estimate


def run_case(case: ExperimentCase) -> Row:
    """Runs the filter on one recorded walk with each fault.

    Returns:
        The case's row with `faults`: label of the fault to the scores and reported uncertainty of the paths.
    """
    with record_shoes(case) as walk:
        plans = fault_plans(case, walk.shoes.rig, walk.shoes.duration)
        return case.row(faults={label: _run_with_fault(plan, walk, walk.truth()) for label, plan in plans.items()})


def _run_with_fault(plan: FaultPlan, walk: RecordedWalk, truth: Mapping[str, TruePath]) -> Figures:
    """Runs the filter on one walk with one fault.

    Args:
        plan: The fault, with the rig that the filter gets.
        walk: Recordings of the walk.
        truth: True path of each foot's IMU, by `l` and `r`.

    Returns:
        The scores of both paths (`two_feet.score_paths`); the largest reported horizontal standard deviation of either
        foot, `sd_max_m`; and that of the feet's position to each other, mean and largest, `apart_sd_mean_m` and
        `apart_sd_max_m`. Or only `error`, the message with which the filter refuses.
    """
    estimator = _UncertaintyLog(plan.rig, true_start(truth))
    try:
        paths = follow(estimator, plan.samples(walk.samples()))
    except StrideTwinError as error:
        return {"error": str(error)}
    # (N, 6, 6) of each foot; the first two entries are the horizontal position, m²
    pose_covariances = [paths[f].trajectory.covariance for f in FEET]
    return {
        **score_paths(paths, truth),
        "sd_max_m": max(math.sqrt(float((P[:, 0, 0] + P[:, 1, 1]).max())) for P in pose_covariances if P is not None),
        "apart_sd_mean_m": float(np.mean(estimator.apart_sd)),
        "apart_sd_max_m": max(estimator.apart_sd),
    }


def collect(results: list[FaultRow[FaultFigures]]) -> Collected[dict[str, Figures], NoPaper]:
    """Means by fault over the walks; two numbers are of the left and the right foot.

    A fault with which the filter refuses to run has only `error`, its first message, `refused`, the number of walks on
    which it refused, and `of`, the number of all walks.
    """
    return summarize_by_fault(results, _mean_figures)


def _mean_figures(rows: list[FaultFigures]) -> Figures:
    """Means of a fault's figures over walks, and the largest standard deviations.

    `end_error_m` is the horizontal size of the error at the end, `end_height_error_m` the size of its vertical part.
    If the filter has refused any of the walks, only its first message (`error`), the number of refusals (`refused`) and
    that of walks (`of`) are given.
    """
    errors = [f["error"] for f in rows if "error" in f]
    if errors:
        return {"error": errors[0], "refused": len(errors), "of": len(rows)}
    # (walks, feet, axes) m: left, right; x, y, z of the world
    ends: Array = np.array([f["end_error_m"] for f in rows])
    return {
        "end_error_m": np.linalg.norm(ends[:, :, :2], axis=2).mean(axis=0).tolist(),
        "end_height_error_m": np.abs(ends[:, :, 2]).mean(axis=0).tolist(),
        **{name: np.mean([f[name] for f in rows], axis=0).tolist() for name in _OF_FEET},
        "feet_disagree_rms_m": float(np.mean([f["feet_disagree_rms_m"] for f in rows])),
        "apart_sd_mean_m": float(np.mean([f["apart_sd_mean_m"] for f in rows])),
        "sd_max_m": max(f["sd_max_m"] for f in rows),
        "apart_sd_max_m": max(f["apart_sd_max_m"] for f in rows),
    }
