"""Visual-inertial odometry under injected faults, on the closed loop `zhao_loop`: one recording per seed.

A fault is tolerated (`borne`) if the drift is at most three times that without fault, or if the odometry reports that
it is lost and is healthy again at the end.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.faults.image_faults import Occlusion
from stridetwin.sim.faults.sample_faults import Dropout
from stridetwin.sim.parts.kinds import RgbdPart
from stridetwin.sim.parts.library import part
from stridetwin.sim.parts.sensor_config import STANDARD
from stridetwin.sim.world.textures import poster
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image, Imu
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import (
    InjectedFault,
    Samples,
    by_fault,
    camera_offset,
    changed,
    clip,
    fault_table,
    imu_range,
)
from stridetwin.studies.walks import recorded
from stridetwin.studies.zhao2023.odometry_walks import (
    FIGURES,
    SENSORS,
    Maker,
    figures,
    follow,
    mean,
    odometer,
    odometry_samples,
    true_path,
    worst_time,
)

SCENARIO, MOUNT = "zhao_loop", "head"
SEEDS = range(1000, 1003)
AT_S = 20.0
DRIFT_RATIO = 3.0
RATE_RANGE, FORCE_RANGE = 0.6, 10.0  # rad/s and m/s², exceeded by turns and steps
PERSON_M, PERSON_SHARE, PERSON_HZ = 1.2, 0.30, 0.15
PERSON_NS = range(10_000_000_000, 30_000_000_000)
_PERSON_SLIM, _PERSON_WAY = 0.5, 0.3  # half width over half height; amplitude of the motion over the image's width


def _noisier(samples: Samples) -> Samples:
    """Depth with three times the part's noise: the added noise has √8 times its standard deviation."""
    camera = part(STANDARD["head_camera"])
    assert isinstance(camera, RgbdPart)
    sd, alike = np.float32(np.sqrt(8.0) * camera.depth.noise), camera.depth.noise_px
    for s in samples:
        if isinstance(s, Depth):
            rng, (height, width) = np.random.default_rng(s.t_ns), s.depth.shape
            coarse = rng.standard_normal((round(height / alike) + 1, round(width / alike) + 1), np.float32)
            noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
            s = replace(s, depth=np.maximum(s.depth + sd / noise.std() * s.depth**2 * noise, 0.0).astype(np.float32))
        yield s


def _fewer(samples: Samples) -> Samples:
    """A random fifth of the frames is lost, colour and depth."""
    for s in samples:
        if not (isinstance(s, Image | Depth) and np.random.default_rng(s.t_ns).random() < 0.2):
            yield s


def _passed_by(samples: Samples) -> Samples:
    """A person in bright clothes moves to and fro close to the camera for 20 s."""
    for s in samples:
        if isinstance(s, Image) and s.t_ns in PERSON_NS:
            cover, clothes, _ = _person(s.t_ns, *s.pixels.shape[:2])
            s = replace(s, pixels=np.where(cover[..., None], clothes, s.pixels))
        elif isinstance(s, Depth) and s.t_ns in PERSON_NS:
            cover, _, depth = _person(s.t_ns, *s.depth.shape)
            s = replace(s, depth=np.where(cover, depth, s.depth))
        yield s


def _person(t_ns: int, height: int, width: int) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.float32]]:
    """(H, W) pixels that the person covers, (H, W, 3) colour of the clothes, and (H, W) depth, m."""
    aside = round(_PERSON_WAY * width * np.sin(2 * np.pi * PERSON_HZ * 1e-9 * t_ns))
    tall = np.sqrt(PERSON_SHARE * height * width / (np.pi * _PERSON_SLIM))
    v, u = np.mgrid[:height, :width].astype(np.float32)
    out = ((u - width / 2 - aside) / (_PERSON_SLIM * tall)) ** 2 + ((v - height / 2) / tall) ** 2
    cloth = np.roll(_cloth()[:height, :width], aside, axis=1)
    return out < 1.0, cloth, (PERSON_M + 0.12 * out).astype(np.float32)


@cache
def _cloth() -> NDArray[np.uint8]:
    return poster(np.random.default_rng(5))


def _clipped(s: Imu) -> Imu:
    return replace(s, angular_rate=clip(s.angular_rate, RATE_RANGE), specific_force=clip(s.specific_force, FORCE_RANGE))


def _time_offset(rig: Rig) -> Rig:
    cameras = {t: replace(c, timeshift_cam_imu_s=c.timeshift_cam_imu_s + 0.010) for t, c in rig.cameras.items()}
    return replace(rig, cameras=cameras)


FAULTS = {
    "none": InjectedFault(words="no fault"),
    "depth_noise": InjectedFault(words="three times the noise of depth", samples=_noisier),
    "depth_off_5s": InjectedFault(
        words="no depth for 5 s", faults=(Dropout(topic=f"/{MOUNT}/depth", at_s=AT_S, duration_s=5.0),)
    ),
    "covered_2s": InjectedFault(
        words="camera covered for 2 s",
        faults=(Occlusion(topic=f"/{MOUNT}/*", at_s=AT_S, duration_s=2.0, share=1.0),),
    ),
    "frames_dropped": InjectedFault(words="20 % of the frames lost", samples=_fewer),
    "person": InjectedFault(words="a person in 30 % of the view, 20 s", samples=_passed_by),
    "imu_clips": InjectedFault(
        words="IMU clips at every step and turn",
        samples=changed(_clipped, kinds=Imu),
        calibration=imu_range(gyroscope_range=RATE_RANGE, accelerometer_range=FORCE_RANGE),
    ),
    "turned_2deg": InjectedFault(
        words="camera mount 2° off in the calibration", calibration=camera_offset([2.0 / np.sqrt(3.0)] * 3)
    ),
    "clock_10ms": InjectedFault(words="camera clock 10 ms off in the calibration", calibration=_time_offset),
}
_COLUMNS = (
    ("loop drift m", 14, "{loop_drift_m:.3f}"),
    ("APE m", 9, "{ape_rmse_m:.3f}"),
    ("over 5 m %", 12, "{rpe_5m_pct:.2f}"),
    ("NEES in 95 %", 14, "{nees_within_95_pct:.0f}"),
    ("unhealthy s", 13, "{unhealthy_s:.1f}"),
    ("failed", 8, "{failures}"),
    ("tolerated", 11, "{borne}"),
    ("ms p99", 8, "{time_ms[p99]:.1f}"),
)


def run_case(case: Case, make: Maker = odometer) -> dict[str, Any]:
    """One walk, with each fault.

    Returns:
        `seed`, `physics`, and `faults`: name to `odometry_walks.figures`.
    """
    config = replace(load_scenario(SCENARIO).config, sensors=SENSORS, physics=case.physics, rig_mount=MOUNT)
    with recorded(config, case, MOUNT) as recording:
        truth, found = true_path(recording, MOUNT), {}
        for name, fault in FAULTS.items():
            rig = fault.calibration(recording.rig)
            samples = fault.inject(odometry_samples(recording, MOUNT), rig, case.seed, recording.duration)
            found[name] = figures(follow(make("proposed", rig, MOUNT), samples), truth)
    return case.row(faults=found)


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, means over the walks; `borne` counts the walks that tolerate it."""
    nominal = [r["faults"]["none"] for r in results]

    def fault_figures(walks: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            **{figure: mean(walks, figure) for figure in (*FIGURES, "unhealthy_s", "nees_within_95_pct")},
            "failures": sum(bool(w["failure"]) for w in walks),
            "borne": sum(map(_tolerated, walks, nominal)),
            "time_ms": worst_time(walks),
        }

    return by_fault(FAULTS, results, fault_figures)


def _tolerated(walk: dict[str, Any], nominal: dict[str, Any]) -> bool:
    if walk["failure"] == "lost":
        return bool(walk["recovered"])
    if walk["failure"] or "loop_drift_m" not in nominal:
        return False
    return bool(walk["loop_drift_m"] <= DRIFT_RATIO * nominal["loop_drift_m"])


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text; means over the walks."""
    head = f"{len(result['cases'])} walks of {SCENARIO}; tolerated: at most {DRIFT_RATIO:g} times the drift without "
    words = {name: fault.words for name, fault in FAULTS.items()}
    return [head + "the fault, or a loss reported and recovered", *fault_table(words, result["summary"], _COLUMNS, 42)]
