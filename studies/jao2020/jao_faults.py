"""Foot-to-foot filter under injected faults, on the straight walk of Jao, Wang, Shkel 2020: one recording per seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from stridetwin.estimators.foot_ins import StartPose
from stridetwin.estimators.foot_to_foot import Aiding, FootToFoot, FootToFootEstimate, follow
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Image, Imu
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import FaultCase, by_fault, fault_table, read_cases
from stridetwin.studies.jao2020.two_feet import FEET, figures, true_start
from stridetwin.studies.walks import RecordedWalk, recorded_walk

SCENARIO = "jao_straight_53m"
SEEDS = range(1000, 1003)
_OF_FEET = ("end_nees", "nees_mean", "nees_within_95_pct", "coverage_pct")
FAULTS = read_cases(__file__)
_COLUMNS = (
    ("covered %", 18, "{coverage_pct:.0f}"),
    ("end error m", 18, "{end_error_m:.3f}"),
    ("height m", 18, "{end_height_error_m:.3f}"),
    ("NEES", 18, "{nees_mean:.1f}"),
    ("in 95 %", 18, "{nees_within_95_pct:.0f}"),
    ("largest sd m", 18, "{sd_max_m:.3f}"),
    ("feet apart, sd mm", 18, "{apart_sd_mean_m!m:.0f} {apart_sd_max_m!m:.0f}"),
    ("disagree, rms mm", 18, "{feet_disagree_rms_m!m:.0f}"),
)


class _UncertaintyLog(FootToFoot):
    """Our filter, which records the uncertainty of the feet's relative position.

    Attributes:
        apart_sd: At each IMU sample, horizontal standard deviation of the feet's relative position, m.
    """

    def __init__(self, rig: Rig, start: Mapping[str, StartPose]) -> None:
        super().__init__(rig, start=start)
        self.apart_sd: list[float] = []

    def update(self, sample: Imu | Image | Aiding) -> FootToFootEstimate | None:
        """As `FootToFoot.update`."""
        estimate = super().update(sample)
        if estimate is not None and isinstance(sample, Imu):
            P = estimate.covariance.reshape(2, len(estimate.covariance) // 2, 2, -1)[:, :2, :, :2]
            apart = P[0, :, 0] + P[1, :, 1] - P[0, :, 1] - P[1, :, 0]
            self.apart_sd.append(math.sqrt(max(np.trace(apart), 0.0)))
        return estimate


def run_case(case: Case) -> dict[str, Any]:
    """One walk, with each fault.

    Returns:
        `seed`, `physics`, and `faults`: name to `_result`.
    """
    with recorded_walk(SCENARIO, case) as walk:
        truth = walk.truth()
        found = {name: _result(fault, walk, truth, case.seed) for name, fault in FAULTS.items()}
    return case.row(faults=found)


def _result(fault: FaultCase, walk: RecordedWalk, truth: Mapping[str, TruePath], seed: int) -> dict[str, Any]:
    """Figures of one fault, or `error`, the message with which the filter refuses.

    `two_feet.figures`, `sd_max_m` (horizontal, of either foot), `apart_sd_{mean,max}_m` (of the feet to each other).
    """
    plan = fault.plan(walk.shoes.rig, seed, walk.shoes.duration)
    estimator = _UncertaintyLog(plan.rig, true_start(truth))
    try:
        paths = follow(estimator, plan.samples(walk.samples()))
    except StrideTwinError as error:
        return {"error": str(error)}
    ground = [paths[f].trajectory.covariance for f in FEET]
    return figures(paths, truth) | {
        "sd_max_m": max(math.sqrt(float((P[:, 0, 0] + P[:, 1, 1]).max())) for P in ground if P is not None),
        "apart_sd_mean_m": float(np.mean(estimator.apart_sd)),
        "apart_sd_max_m": max(estimator.apart_sd),
    }


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, means over the walks; pairs are left and right. `error` is the filter's message where it refuses."""
    return by_fault(FAULTS, results, _mean)


def _mean(found: list[dict[str, Any]]) -> dict[str, Any]:
    errors = [f["error"] for f in found if "error" in f]
    if errors:
        return {"error": errors[0], "refused": len(errors), "of": len(found)}
    ends: Array = np.array([f["end_error_m"] for f in found])
    return {
        "end_error_m": np.linalg.norm(ends[:, :, :2], axis=2).mean(axis=0).tolist(),
        "end_height_error_m": np.abs(ends[:, :, 2]).mean(axis=0).tolist(),
        **{k: np.mean([f[k] for f in found], axis=0).tolist() for k in _OF_FEET},
        **{k: float(np.mean([f[k] for f in found])) for k in ("feet_disagree_rms_m", "apart_sd_mean_m")},
        **{k: max(f[k] for f in found) for k in ("sd_max_m", "apart_sd_max_m")},
    }


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text; pairs are left and right. The end error is that at the last estimate."""
    return [f"{len(result['cases'])} walks of {SCENARIO}", *fault_table(FAULTS, result["summary"], _COLUMNS, 43)]
