"""Foot-to-foot filter under injected faults, on the straight walk of Jao, Wang, Shkel 2020: one recording per seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stridetwin.estimators.foot_ins import StartPose
from stridetwin.estimators.foot_to_foot import Aiding, FootToFoot, FootToFootEstimate, follow
from stridetwin.outputs.truth import TruePath
from stridetwin.sim.faults.image_faults import Occlusion
from stridetwin.sim.faults.sample_faults import ClockJump, Dropout
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Image, Imu, Sample
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import (
    InjectedFault,
    by_fault,
    camera_offset,
    changed,
    clip,
    fault_table,
    imu_range,
)
from stridetwin.studies.jao2020.two_feet import FEET, figures, true_start
from stridetwin.studies.walks import RecordedWalk, recorded_walk

SCENARIO = "jao_straight_53m"
SEEDS = range(1000, 1003)
AT_S, LOST_S = 20.0, 10.0
STRIKE_RANGE = 25.0  # m/s², half the range of the ADIS16485's accelerometer


def _clipped(s: Imu) -> Imu:
    return replace(s, specific_force=clip(s.specific_force, STRIKE_RANGE))


def _exchanged(s: Sample) -> Sample:
    """The sample under the topic of the other foot."""
    topic = s.topic.replace("foot_l", "foot_?").replace("foot_r", "foot_l").replace("foot_?", "foot_r")
    return replace(s, topic=topic)


_OF_FEET = ("end_nees", "nees_mean", "nees_within_95_pct", "coverage_pct")

BOTH = "/foot_?/camera"
FAULTS = {
    "none": InjectedFault(words="no fault"),
    "camera_covered": InjectedFault(
        words="left camera covered", faults=(Occlusion(topic="/foot_l/camera", at_s=0.0, share=1.0),)
    ),
    "half_seen": InjectedFault(
        words="half of each image covered", faults=(Occlusion(topic=BOTH, at_s=0.0, share=0.5),)
    ),
    "lost_10s": InjectedFault(
        words="no image for 10 s",
        faults=(Dropout(topic=BOTH, at_s=AT_S, duration_s=LOST_S),),
    ),
    "strikes_clip": InjectedFault(
        words="heel strikes saturate the accelerometers",
        samples=changed(_clipped, kinds=Imu),
        calibration=imu_range(accelerometer_range=STRIKE_RANGE),
    ),
    "imu_dead": InjectedFault(words="right IMU dead from 20 s on", faults=(Dropout(topic="/foot_r/imu", at_s=AT_S),)),
    "clock_10ms": InjectedFault(
        words="cameras' stamps 10 ms late", faults=(ClockJump(topic=BOTH, at_s=0.0, jump_s=0.010),)
    ),
    "turned_2deg": InjectedFault(
        words="camera mounts 2° off in the calibration", calibration=camera_offset((2.0, 0.0, 0.0))
    ),
    "shifted_5mm": InjectedFault(
        words="camera mounts 5 mm off in the calibration", calibration=camera_offset((0.0, 0.0, 0.0), (0.005, 0.0, 0.0))
    ),
    "shoes_exchanged": InjectedFault(words="left and right exchanged", samples=changed(_exchanged, kinds=Sample)),
    "cameras_exchanged": InjectedFault(words="cameras exchanged", samples=changed(_exchanged, kinds=Image)),
    "imus_exchanged": InjectedFault(words="IMUs exchanged", samples=changed(_exchanged, kinds=Imu)),
}


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


def _result(fault: InjectedFault, walk: RecordedWalk, truth: Mapping[str, TruePath], seed: int) -> dict[str, Any]:
    """Figures of one fault, or `error`, the message with which the filter refuses.

    `two_feet.figures`, `sd_max_m` (horizontal, of either foot), `apart_sd_{mean,max}_m` (of the feet to each other).
    """
    rig = fault.calibration(walk.shoes.rig)
    estimator = _UncertaintyLog(rig, true_start(truth))
    try:
        paths = follow(estimator, fault.inject(walk.samples(), rig, seed, walk.shoes.duration))
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
    words = {name: fault.words for name, fault in FAULTS.items()}
    return [f"{len(result['cases'])} walks of {SCENARIO}", *fault_table(words, result["summary"], _COLUMNS, 43)]
