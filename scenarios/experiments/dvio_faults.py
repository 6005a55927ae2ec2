"""What the visual-inertial odometry makes of faults: the closed loop (`zhao_loop`), recorded once a seed, spoilt anew.

A fault is borne where the walk drifts no more than three times as far as it does without, or where the odometry calls
itself lost and is healthy again in the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.odometry_walks import (
    FIGURES,
    SENSORS,
    Maker,
    dvio,
    figures,
    follow,
    mean,
    odometry_samples,
    recorded,
    true_path,
    worst_time,
)
from stridetwin.scenarios.experiments.spoilt import Samples, SpoiltRig
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.fitting import STANDARD
from stridetwin.sim.parts.kinds import RgbdPart
from stridetwin.sim.parts.library import part
from stridetwin.sim.picture_faults import Occlusion
from stridetwin.sim.sample_faults import Dropout
from stridetwin.sim.textures import poster
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Depth, Image, Imu

SCENARIO, MOUNT = "zhao_loop", "head"
SEEDS = range(1000, 1003)
AT_S = 20.0
BEARABLE = 3.0
RATE_RANGE, FORCE_RANGE = 0.6, 10.0  # rad/s and m/s², which turns and steps go beyond
PERSON_M, PERSON_SHARE, PERSON_HZ = 1.2, 0.30, 0.15
PERSON_NS = range(10_000_000_000, 30_000_000_000)
_PERSON_SLIM, _PERSON_WAY = 0.5, 0.3  # half width over half height; way to either side over the picture's width


def _noisier(samples: Samples) -> Samples:
    """Depth with three times the part's noise: what is added has the square root of 8 times its deviation."""
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
    """Every fifth frame at random is lost, depth and all."""
    for s in samples:
        if not (isinstance(s, Image | Depth) and np.random.default_rng(s.t_ns).random() < 0.2):
            yield s


def _passed_by(samples: Samples) -> Samples:
    """Somebody close before the camera for 20 s, in bright clothes, who goes to and fro."""
    for s in samples:
        if isinstance(s, Image) and s.t_ns in PERSON_NS:
            cover, clothes, _ = _person(s.t_ns, *s.pixels.shape[:2])
            s = replace(s, pixels=np.where(cover[..., None], clothes, s.pixels))
        elif isinstance(s, Depth) and s.t_ns in PERSON_NS:
            cover, _, depth = _person(s.t_ns, *s.depth.shape)
            s = replace(s, depth=np.where(cover, depth, s.depth))
        yield s


def _person(t_ns: int, height: int, width: int) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.float32]]:
    """(H, W) whom one sees, (H, W, 3) what he wears, and (H, W) m how far it is."""
    aside = round(_PERSON_WAY * width * np.sin(2 * np.pi * PERSON_HZ * 1e-9 * t_ns))
    tall = np.sqrt(PERSON_SHARE * height * width / (np.pi * _PERSON_SLIM))
    v, u = np.mgrid[:height, :width].astype(np.float32)
    out = ((u - width / 2 - aside) / (_PERSON_SLIM * tall)) ** 2 + ((v - height / 2) / tall) ** 2
    cloth = np.roll(_cloth()[:height, :width], aside, axis=1)
    return out < 1.0, cloth, (PERSON_M + 0.12 * out).astype(np.float32)


@cache
def _cloth() -> NDArray[np.uint8]:
    return poster(np.random.default_rng(5))


def _clipped(samples: Samples) -> Samples:
    for s in samples:
        if isinstance(s, Imu):
            s = replace(
                s,
                angular_rate=np.clip(s.angular_rate, -RATE_RANGE, RATE_RANGE),
                specific_force=np.clip(s.specific_force, -FORCE_RANGE, FORCE_RANGE),
            )
        yield s


def _told_clipping(rig: Rig) -> Rig:
    imus = {
        t: replace(c, gyroscope_range=RATE_RANGE, accelerometer_range=FORCE_RANGE) for t, c in rig.imus.items()
    }  # fmt: skip
    return replace(rig, imus=imus)


def _told_shift(rig: Rig) -> Rig:
    shifted = {t: replace(c, timeshift_cam_imu_s=c.timeshift_cam_imu_s + 0.010) for t, c in rig.cameras.items()}
    return replace(rig, cameras=shifted)


def _turned_camera(angle_deg: float) -> Callable[[Rig], Rig]:
    """Told that the camera sits turned against the IMU, about all three axes alike."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.full(3, angle_deg / np.sqrt(3.0)), degrees=True).as_matrix()

    def told(rig: Rig) -> Rig:
        mounts = {t: Mount(body=c.mount.body, T_body_sensor=c.mount.T_body_sensor @ T) for t, c in rig.cameras.items()}
        return replace(rig, cameras={t: replace(c, mount=mounts[t]) for t, c in rig.cameras.items()})

    return told


FAULTS = {
    "none": SpoiltRig(words="nothing wrong"),
    "depth_noise": SpoiltRig(words="three times the noise of depth", samples=_noisier),
    "depth_off_5s": SpoiltRig(
        words="no depth for 5 s", faults=(Dropout(topic=f"/{MOUNT}/depth", at_s=AT_S, duration_s=5.0),)
    ),
    "covered_2s": SpoiltRig(
        words="camera covered for 2 s",
        faults=(Occlusion(topic=f"/{MOUNT}/*", at_s=AT_S, duration_s=2.0, share=1.0),),
    ),
    "frames_dropped": SpoiltRig(words="20 % of the frames lost", samples=_fewer),
    "person": SpoiltRig(words="somebody in 30 % of the view, 20 s", samples=_passed_by),
    "imu_clips": SpoiltRig(words="IMU clips at every step and turn", samples=_clipped, rig=_told_clipping),
    "turned_2deg": SpoiltRig(words="camera told 2° off", rig=_turned_camera(2.0)),
    "clock_10ms": SpoiltRig(words="camera's clock told 10 ms off", rig=_told_shift),
}


def run_case(case: Case, make: Maker = dvio) -> dict[str, Any]:
    """One walk, spoilt in every way.

    Returns:
        `seed`, `physics`, and `faults`: name to `odometry_walks.figures`.
    """
    config = replace(load_scenario(SCENARIO).config, sensors=SENSORS, physics=case.physics, rig_mount=MOUNT)
    with recorded(config, case, MOUNT) as recording:
        truth, found = true_path(recording, MOUNT), {}
        for name, spoilt in FAULTS.items():
            rig = spoilt.rig(recording.rig)
            arriving = spoilt.arriving(odometry_samples(recording, MOUNT), rig, case.seed, recording.duration)
            found[name] = figures(follow(make("proposed", rig, MOUNT), arriving), truth)
    return {"seed": case.seed, "physics": case.physics, "faults": found}


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, means over the walks; `borne` counts those with little drift, or with a loss declared and got over."""
    summary = {}
    for name in FAULTS:
        walks = [r["faults"][name] for r in results]
        borne = [_borne(r["faults"][name], r["faults"]["none"]) for r in results]
        summary[name] = {
            **{figure: mean(walks, figure) for figure in FIGURES},
            "unhealthy_s": mean(walks, "unhealthy_s"),
            "nees_within_95_pct": mean(walks, "nees_within_95_pct"),
            "failures": sum(bool(w["failure"]) for w in walks),
            "borne": sum(borne),
            "time_ms": worst_time(walks),
        }
    return {"summary": summary, "paper": {}}


def _borne(walk: dict[str, Any], nominal: dict[str, Any]) -> bool:
    if walk["failure"] == "lost":
        return bool(walk["recovered"])
    if walk["failure"] or "loop_drift_m" not in nominal:
        return False
    return bool(walk["loop_drift_m"] <= BEARABLE * nominal["loop_drift_m"])


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text; means over the walks."""
    count = len(result["cases"])
    lines = [
        f"{count} walks of {SCENARIO}; borne: no more than {BEARABLE:g} times the drift without the fault, or lost, "
        "said so, and recovered",
        f"{'':<38}{'loop drift m':>14}{'APE m':>9}{'over 5 m %':>12}{'NEES in 95 %':>14}{'unhealthy s':>13}"
        f"{'failed':>8}{'borne':>7}{'ms p99':>8}",
    ]
    for name, spoilt in FAULTS.items():
        of = result["summary"][name]
        cells = [
            "-" if of[key] is None else f"{of[key]:.{digits}f}"
            for key, digits in (
                ("loop_drift_m", 3), ("ape_rmse_m", 3), ("rpe_5m_pct", 2), ("nees_within_95_pct", 0), ("unhealthy_s", 1)
            )
        ]  # fmt: skip
        lines.append(
            f"{spoilt.words:<38}"
            + "".join(f"{cell:>{width}}" for cell, width in zip(cells, (14, 9, 12, 14, 13)))
            + f"{of['failures']:>8}{of['borne']:>7}{of['time_ms']['p99']:>8.1f}"
        )
    return lines
