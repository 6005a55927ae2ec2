"""Signals of an IMU on a shoe: the twin's walks, kinematic and dynamic, beside real recordings.

`python -m benchmarks.shoe_imu [--json] [--seeds 1000 1001 ...] [--no-dynamic]`. Real walks: `dual_foot_walk` (204.8 Hz,
16 g) and `foot_imu_vicon` (200 Hz, filtered in the sensor), found by `benchmarks.real_walks`; strides between 1.2 and
1.6 m/s count. The twin walks 20 m on the level at 1.3, 1.4 and 1.5 m/s, alternating with the seeds. Its IMU, without
errors, is sampled at 1 kHz and, for comparison with the real ones, at 204.8 Hz. Every figure is a median over strides.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from benchmarks.real_walks import ViconWalk, data_folder, load_markers, load_vicon
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES, Gait
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.sensors.model import instants
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Block, Imu

BAND = {
    "peak_speed_mps": (4.0, 5.2),
    "peak_rate_dps": (600.0, 1000.0),
    "heel_strike_g_at_1khz": (8.0, 40.0),
    "heel_strike_g": (5.0, 18.0),
    "stance_quietest_mmps": (4.0, 20.0),
    "stance_rms_mmps": (20.0, 200.0),
}
SPEEDS_MPS = (1.3, 1.4, 1.5)
SEEDS = (1000, 1002, 1001)
REAL_HZ = 204.8
_STRIDE_MPS = (1.2, 1.6)
_WINDOW_S = 0.1
_STILL = 4e5  # of the statistic, in units of the noise of a good part
_STANCE_S = (0.1, 1.0)
_MARKER_WINDOW_S = 0.055  # window over which motion capture is differentiated


@dataclass(frozen=True, kw_only=True, eq=False)
class FootWalk:
    """One foot's IMU and true speed.

    Attributes:
        t: (N,) s.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        t_truth: (M,) s.
        p_truth: (M, 3) m.
        speed: (M,) m/s.
    """

    t: Array
    rate: Array
    force: Array
    t_truth: Array
    p_truth: Array
    speed: Array


def stillness(rate: Array, force: Array, dt: float) -> Array:
    """(N,) statistic of SHOE (Skog et al. 2010, IEEE TBME 57:2657, eq. 19) over a centred window."""
    n = max(3, round(_WINDOW_S / dt))

    def smooth(x: Array) -> Array:
        return np.convolve(x, np.ones(n) / n, "same")

    mean = np.column_stack([smooth(axis) for axis in force.T])
    gravity = NOMINAL_GRAVITY_MPS2 * mean / np.linalg.norm(mean, axis=1, keepdims=True)
    energy = ((force - gravity) ** 2).sum(1) / 0.5e-4 + (rate**2).sum(1) / np.radians(0.1) ** 2
    return smooth(energy)


def stances(walk: FootWalk) -> NDArray[np.int64]:
    """(S, 2) first sample of each stationary interval and the first one after it."""
    dt = float(np.median(np.diff(walk.t)))
    still = stillness(walk.rate, walk.force, dt) < _STILL
    spans = np.flatnonzero(np.diff(np.r_[0, still.astype(int), 0])).reshape(-1, 2)
    return spans[(spans[:, 1] - spans[:, 0]) * dt > _STANCE_S[0]]


def strides(walk: FootWalk) -> Iterator[dict[str, float]]:
    """Figures of each stride in the speed range: swing and the following stance."""
    spans = stances(walk)
    last = len(walk.t) - 1
    for (_, off), (touch, end) in pairwise(spans):
        a, b, c = np.searchsorted(walk.t_truth, walk.t[np.minimum([off, touch, end], last)])
        duration = (walk.t[min(end, last)] - walk.t[off]) if c < len(walk.speed) else np.inf
        if duration > 2.0 or c - b < 3 or walk.t[min(end, last)] - walk.t[touch] > _STANCE_S[1]:
            continue
        length = float(np.linalg.norm(walk.p_truth[b, :2] - walk.p_truth[a, :2]))
        if not _STRIDE_MPS[0] < length / duration < _STRIDE_MPS[1]:
            continue
        stance = walk.speed[b:c]
        yield {
            "speed_mps": length / duration,
            "peak_speed_mps": float(walk.speed[a:b].max()),
            "peak_rate_dps": float(np.degrees(np.linalg.norm(walk.rate[off:end], axis=1).max())),
            "heel_strike_g": float(np.linalg.norm(walk.force[off:end], axis=1).max() / NOMINAL_GRAVITY_MPS2),
            "stance_quietest_mmps": 1e3 * float(stance.min()),
            "stance_rms_mmps": 1e3 * float(np.sqrt((stance**2).mean())),
            "stance_rate_rms_dps": float(np.degrees(np.sqrt((walk.rate[touch:end] ** 2).sum(1).mean()))),
            "stance_s": float(walk.t[min(end, last)] - walk.t[touch]),
        }


def twin_walks(twin: Twin, rate_hz: float) -> dict[str, FootWalk]:
    """Samples of both feet's IMUs at another rate than the rig's, by side."""
    t_ns = instants(rate_hz, -1, int(twin.duration_s * 1e9))
    motion = twin.player().motion(t_ns)
    walks = {}
    for side in SIDES:
        worn = twin.sensor_rig.sensors[f"/foot_{side}/imu"]
        imu, part = twin.rig.imu(worn.calibration.topic), replace(make_ideal(worn.part), rate_hz=rate_hz)
        carrier = motion.carrier(imu.mount.body)
        block = ImuModel(imu, part, Noise(None)).read(carrier, t_ns)
        truth = carrier.to_sensor(imu.mount.T_body_sensor)
        walks[side] = FootWalk(
            t=t_ns * 1e-9,
            rate=block.columns["angular_rate"],
            force=block.columns["specific_force"],
            t_truth=t_ns * 1e-9,
            p_truth=truth.p_body_in_world,
            speed=np.linalg.norm(truth.v_body_in_world, axis=1),
        )
    return walks


def real_walks() -> dict[str, list[FootWalk]]:
    """Recorded walks by data set; empty without recordings."""
    folder = data_folder()
    if folder is None:
        return {}
    markers = []
    for foot in load_markers(folder):
        seen = np.isfinite(foot.heel).all(1)
        heel = np.column_stack([np.interp(foot.t, foot.t[seen], foot.heel[seen, k]) for k in range(3)])
        markers.append(recorded(foot.imu, foot.t, heel))
    return {"dual_foot_walk": markers, "foot_imu_vicon": [_of_vicon(w) for w in load_vicon(folder)]}


def _of_vicon(walk: ViconWalk) -> FootWalk:
    return recorded(walk.imu, walk.imu.t_ns * 1e-9, walk.truth)


def recorded(imu: Block[Imu], t: Array, p: Array) -> FootWalk:
    """A recorded IMU and (M, 3) m of its truth at (M,) s."""
    dt = float(np.median(np.diff(t)))
    window = max(5, round(_MARKER_WINDOW_S / dt) | 1)
    velocity = savgol_filter(p, window, 2, deriv=1, delta=dt, axis=0)
    return FootWalk(
        t=imu.t_ns * 1e-9,
        rate=imu.columns["angular_rate"],
        force=imu.columns["specific_force"],
        t_truth=t,
        p_truth=p,
        speed=np.linalg.norm(velocity, axis=1),
    )


def medians(walks: Sequence[FootWalk]) -> dict[str, float]:
    """Median of every figure over all strides, and the number of strides."""
    rows = [row for walk in walks for row in strides(walk)]
    if not rows:
        return {"strides": 0.0}
    return {"strides": float(len(rows))} | {k: float(np.median([r[k] for r in rows])) for k in rows[0]}


def measure(seeds: Sequence[int], physics: Sequence[str]) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    level = replace(load_scenario("level_20m").config, sensors=("foot_imu",))
    summary: dict[str, dict[str, float]] = {}
    for how in physics:
        # a simulated walker stays up at 1.3 m/s, not at 1.5
        speeds = SPEEDS_MPS if how == "kinematic" else SPEEDS_MPS[:1]
        fine, coarse = [], []
        for i, seed in enumerate(seeds):
            gait = Gait(speed_mps=speeds[i % len(speeds)])
            try:
                twin = Twin(replace(level, physics=how, gait=gait), seed)
            except StrideTwinError as error:
                print(f"seed {seed} at {gait.speed_mps} m/s: {error}", file=sys.stderr)
                continue
            fine += twin_walks(twin, 1000.0).values()
            coarse += twin_walks(twin, REAL_HZ).values()
        at_1khz = medians(fine).get("heel_strike_g", float("nan"))
        summary[how] = medians(coarse) | {"feet": float(len(coarse)), "heel_strike_g_at_1khz": at_1khz}
    summary |= {name: medians(walks) for name, walks in real_walks().items()}
    return {"experiment": "shoe_imu", "summary": summary, "band": BAND, "paper": {}, "cases": []}


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="seeds of the walks (1000 to 1002)")
    parser.add_argument("--no-dynamic", action="store_true", help="kinematic walks only")
    arguments = parser.parse_args()
    result = measure(arguments.seeds, ("kinematic",) if arguments.no_dynamic else ("kinematic", "dynamic"))
    if arguments.json:
        print(json.dumps(result))
        return 0
    columns = list(result["summary"])
    print(f"{'median over strides':24s}" + "".join(f"{c:>16s}" for c in columns) + f"{'band':>18s}")
    keys = dict.fromkeys(k for c in columns for k in result["summary"][c])
    for key in keys:
        values = [result["summary"][c].get(key) for c in columns]
        cells = "".join(f"{'-' if v is None else format(v, '.2f'):>16s}" for v in values)
        band = f"{BAND[key][0]:g} to {BAND[key][1]:g}" if key in BAND else ""
        print(f"{key:24s}{cells}{band:>18s}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
