"""What the filter of two feet makes of faults: the straight walk of Jao, Wang, Shkel 2020, recorded once, spoilt anew.

Faults of samples are those of `sim.faults`; wrong calibration and exchanged shoes are done to what the filter is told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins import StartPose
from stridetwin.estimators.foot_to_foot import Aiding, FootToFoot, FootToFootEstimate, follow
from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.spoilt import Samples, SpoiltRig
from stridetwin.scenarios.experiments.two_feet import FEET, figures, true_start
from stridetwin.scenarios.experiments.walks import RecordedWalk, recorded_walk
from stridetwin.scenarios.truth import TruePath
from stridetwin.sim.picture_faults import Occlusion
from stridetwin.sim.sample_faults import ClockJump, Dropout
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Array, Image, Imu

SCENARIO = "jao_straight_53m"
SEEDS = range(1000, 1003)
AT_S, LOST_S = 20.0, 10.0
STRIKE_RANGE = 25.0  # m/s², half of what the accelerometer of an ADIS16485 can tell


def _clipped(samples: Samples) -> Samples:
    for s in samples:
        if isinstance(s, Imu):
            s = replace(s, specific_force=np.clip(s.specific_force, -STRIKE_RANGE, STRIKE_RANGE))
        yield s


def _exchanged(samples: Samples) -> Samples:
    return (replace(s, topic=_other(s.topic)) for s in samples)


def _exchanged_cameras(samples: Samples) -> Samples:
    return (replace(s, topic=_other(s.topic)) if isinstance(s, Image) else s for s in samples)


def _exchanged_imus(samples: Samples) -> Samples:
    return (replace(s, topic=_other(s.topic)) if isinstance(s, Imu) else s for s in samples)


def _other(topic: str) -> str:
    return topic.replace("foot_l", "foot_?").replace("foot_r", "foot_l").replace("foot_?", "foot_r")


def _told_clipping(rig: Rig) -> Rig:
    return replace(rig, imus={t: replace(c, accelerometer_range=STRIKE_RANGE) for t, c in rig.imus.items()})


def _moved_cameras(rotation_deg: float, shift_m: float) -> Callable[[Rig], Rig]:
    """Told that the cameras sit turned about their own right, and shifted along it, from where they do."""
    T = np.eye(4)
    T[:3, :3], T[0, 3] = Rotation.from_euler("x", rotation_deg, degrees=True).as_matrix(), shift_m

    def told(rig: Rig) -> Rig:
        mounts = {t: Mount(body=c.mount.body, T_body_sensor=c.mount.T_body_sensor @ T) for t, c in rig.cameras.items()}
        return replace(rig, cameras={t: replace(c, mount=mounts[t]) for t, c in rig.cameras.items()})

    return told


_OF_FEET = ("end_nees", "nees_mean", "nees_within_95_pct", "coverage_pct")

BOTH = "/foot_?/camera"
FAULTS = {
    "none": SpoiltRig(words="nothing wrong"),
    "camera_covered": SpoiltRig(
        words="left camera covered", faults=(Occlusion(topic="/foot_l/camera", at_s=0.0, share=1.0),)
    ),
    "half_seen": SpoiltRig(words="half of each picture covered", faults=(Occlusion(topic=BOTH, at_s=0.0, share=0.5),)),
    "lost_10s": SpoiltRig(
        words="no picture for 10 s",
        faults=(Dropout(topic=BOTH, at_s=AT_S, duration_s=LOST_S),),
    ),
    "strikes_clip": SpoiltRig(words="heel strikes beyond the accelerometers", samples=_clipped, rig=_told_clipping),
    "imu_dead": SpoiltRig(words="right IMU dead from 20 s on", faults=(Dropout(topic="/foot_r/imu", at_s=AT_S),)),
    "clock_10ms": SpoiltRig(
        words="cameras' stamps 10 ms late", faults=(ClockJump(topic=BOTH, at_s=0.0, jump_s=0.010),)
    ),
    "turned_2deg": SpoiltRig(words="cameras told 2° off", rig=_moved_cameras(2.0, 0.0)),
    "shifted_5mm": SpoiltRig(words="cameras told 5 mm off", rig=_moved_cameras(0.0, 0.005)),
    "shoes_exchanged": SpoiltRig(words="left and right exchanged", samples=_exchanged),
    "cameras_exchanged": SpoiltRig(words="cameras exchanged", samples=_exchanged_cameras),
    "imus_exchanged": SpoiltRig(words="IMUs exchanged", samples=_exchanged_imus),
}


class _Unsure(FootToFoot):
    """Our filter, which notes how well it knows one foot from the other, and how well where they are.

    Attributes:
        apart_sd: At each IMU sample, standard deviation on the ground of the right IMU's place from the left's, m.
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
    """One walk, spoilt in every way.

    Returns:
        `seed`, `physics`, and `faults`: name to `_result`.
    """
    with recorded_walk(SCENARIO, case) as walk:
        truth = walk.truth()
        found = {name: _result(spoilt, walk, truth, case.seed) for name, spoilt in FAULTS.items()}
    return {"seed": case.seed, "physics": case.physics, "faults": found}


def _result(spoilt: SpoiltRig, walk: RecordedWalk, truth: Mapping[str, TruePath], seed: int) -> dict[str, Any]:
    """What one fault does.

    Returns:
        `two_feet.figures`, `sd_max_m` (of either foot on the ground), `apart_sd_mean_m` and `apart_sd_max_m` (of one
        foot from the other); or `error`, what the filter says where it refuses.
    """
    rig = spoilt.rig(walk.shoes.rig)
    estimator = _Unsure(rig, true_start(truth))
    try:
        paths = follow(estimator, spoilt.arriving(walk.samples(), rig, seed, walk.shoes.duration))
    except StrideTwinError as error:
        return {"error": str(error)}
    ground = [paths[f].trajectory.covariance for f in FEET]
    return figures(paths, truth) | {
        "sd_max_m": max(math.sqrt(float((P[:, 0, 0] + P[:, 1, 1]).max())) for P in ground if P is not None),
        "apart_sd_mean_m": float(np.mean(estimator.apart_sd)),
        "apart_sd_max_m": max(estimator.apart_sd),
    }


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, means over the walks; pairs are left and right. `error` is what the filter said, where it refused."""
    return {"summary": {name: _mean([r["faults"][name] for r in results]) for name in FAULTS}, "paper": {}}


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
    """As lines of text; of two figures left and right. The end is that of the part that estimates cover."""
    head = (
        "covered %",
        "end error m",
        "height m",
        "NEES",
        "in 95 %",
        "largest sd m",
        "feet apart, sd mm",
        "disagree, rms mm",
    )
    lines = [f"{len(result['cases'])} walks of {SCENARIO}", f"{'':<36}" + "".join(f"{words:>18}" for words in head)]
    for name, spoilt in FAULTS.items():
        of = result["summary"][name]
        if "error" in of:
            lines.append(f"{spoilt.words:<36}{of['refused']} of {of['of']} refused: {of['error']}")
            continue
        pairs = (
            ("coverage_pct", 0),
            ("end_error_m", 3),
            ("end_height_error_m", 3),
            ("nees_mean", 1),
            ("nees_within_95_pct", 0),
        )
        cells = [" ".join(f"{value:.{digits}f}" for value in of[key]) for key, digits in pairs]
        apart = [1e3 * of[f"apart_sd_{which}_m"] for which in ("mean", "max")]
        cells += [f"{of['sd_max_m']:.3f}", "{:.0f} {:.0f}".format(*apart), f"{1e3 * of['feet_disagree_rms_m']:.0f}"]
        lines.append(f"{spoilt.words:<36}" + "".join(f"{cell:>18}" for cell in cells))
    return lines
