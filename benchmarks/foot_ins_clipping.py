"""Error of the one-foot inertial navigation on real walks whose samples are clipped at ever smaller ranges.

`python -m benchmarks.foot_ins_clipping [--json]`. `real_walks` finds the recordings. The limits of `stridetwin check`
come from here: up to which share of clipped samples does the error stay as it is, and from which does it multiply?
"""

from __future__ import annotations

import math
from argparse import Namespace
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from benchmarks.real_walks import ViconWalk, armse, data_folder, load_vicon
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.rig import ImuCalibration, Mount, Rig

DEG = math.pi / 180
RANGES = ((450, 5), (450, 0), (400, 0), (350, 0), (300, 0), (250, 0), (200, 0), (0, 5), (0, 4), (0, 3), (0, 2))
"""Ranges of gyroscope, °/s, and accelerometer, g; 0 = that of the recording. The first is that of an ADIS16485."""
SHARES_PCT = (0, 1, 5, 10, 20, 30, 50)
TOPIC = "/foot_l/imu"
_NEAR = 0.999


def clipped(walk: ViconWalk, rate_max: float, force_max: float) -> tuple[float, float]:
    """Share of clipped samples, %, and 2-D ARMSE, m, of a walk at ranges in rad/s and m/s²; 0 = no clipping."""
    columns, hit = dict(walk.imu.columns), np.zeros(len(walk.imu), bool)
    for name, limit in (("angular_rate", rate_max), ("specific_force", force_max)):
        if limit:
            columns[name] = np.clip(columns[name], -limit, limit)
            hit |= (np.abs(columns[name]) >= _NEAR * limit).any(axis=1)
    calibration = ImuCalibration(
        topic=TOPIC,
        part="unknown",
        rate_hz=200.0,
        mount=Mount(body="foot_l"),
        gyroscope_noise_density=0.0,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=0.0,
        accelerometer_random_walk=0.0,
        gyroscope_range=rate_max,
        accelerometer_range=force_max,
    )
    imu = replace(walk.imu, topic=TOPIC, columns=columns)
    path = FootIns(Rig(imus={TOPIC: calibration}), options=Options(foot="l")).run(imu)
    return 100.0 * float(hit.mean()), armse(path.trajectory.p_frame_in_world, walk.truth)


def measure(_: Namespace) -> dict[str, Any]:
    """Ratio of the error to that without clipping, by share of clipped samples, over all walks and ranges."""
    folder = data_folder()
    if folder is None:
        raise StrideTwinError("no real recordings: expected the folder in STRIDETWIN_DATA")
    pairs = []
    for walk in load_vicon(folder):
        _, whole = clipped(walk, 0.0, 0.0)
        for gyro, accelerometer in RANGES:
            share, error = clipped(walk, gyro * DEG, accelerometer * STANDARD_GRAVITY_MPS2)
            if share > 0:
                pairs.append((share, error / whole, error - whole))
    differences = np.array(pairs)
    rows = {}
    for low, high in pairwise(SHARES_PCT):
        some = differences[(differences[:, 0] >= low) & (differences[:, 0] < high)]
        rows[f"{low}-{high} %"] = {
            "cases": len(some),
            "ratio_median": float(np.median(some[:, 1])),
            "ratio_p95": float(np.percentile(some[:, 1], 95)),
            "added_median_m": float(np.median(some[:, 2])),
        }
    return {"summary": rows}


def show(result: dict[str, Any]) -> None:
    """One line per range of shares."""
    for name, row in result["summary"].items():
        print(
            f"{name:10s} {row['cases']:4d} cases: error x {row['ratio_median']:.2f} (95 %: {row['ratio_p95']:.1f}), "
            f"{row['added_median_m']:+.3f} m"
        )


if __name__ == "__main__":
    raise SystemExit(answer(command(__doc__), measure, show))
