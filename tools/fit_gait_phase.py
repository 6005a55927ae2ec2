"""Fits the templates of `estimators/gait_phase/template.py` to twin walks, and prints its tables.

`python -m tools.fit_gait_phase`: kinematic walks of `benchmarks.gait_phase`, seeds 0 to 99, the terrain by turns.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.gait_phase import TERRAINS, FootWalk, simulate
from stridetwin.estimators.gait_phase.template import AFTER, BEFORE, BINS, DOWN, LEVEL, N_STRIDE_KINDS, UP
from stridetwin.outputs.gait_phase.scores import Stride
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

SEEDS = range(100)
_LANDING = {"LG": LEVEL, "RA": LEVEL, "RD": LEVEL, "SA": UP, "SD": DOWN}
_KIND = {ends: kind for kind, ends in enumerate(zip(BEFORE.tolist(), AFTER.tolist()))}
_MIN_LEVEL_STRIDES = 2


def pitch_per_cycle(walk: FootWalk, stride: Stride) -> Array:
    """(BINS,) pitch rate times stride time over the bins of the phase, rad per cycle."""
    y_foot_in_imu = walk.rig.imu(f"/foot_{walk.foot}/imu").mount.T_body_sensor[1, :3]
    duration_ns = stride.end_ns - stride.begin_ns
    t_ns = stride.begin_ns + (np.arange(BINS) + 0.5) / BINS * duration_ns
    return np.interp(t_ns, walk.imu.t_ns, walk.imu.columns["angular_rate"] @ y_foot_in_imu) * duration_ns * 1e-9


def fit(walks: list[FootWalk]) -> tuple[Array, Array, Array]:
    """Mean and standard deviation (N_STRIDE_KINDS, BINS) of the pitch, log-ratios (N_STRIDE_KINDS,) of stride times."""
    pitch: list[list[Array]] = [[] for _ in range(N_STRIDE_KINDS)]
    ratios: list[list[float]] = [[] for _ in range(N_STRIDE_KINDS)]
    for walk in walks:
        level = [s.end_ns - s.begin_ns for s in walk.strides[1:-1] if (s.begin_mode, s.end_mode) == ("LG", "LG")]
        for stride in walk.strides:
            ends = _LANDING[stride.begin_mode], _LANDING[stride.end_mode]
            if stride.is_pause or ends not in _KIND:
                continue
            pitch[_KIND[ends]].append(pitch_per_cycle(walk, stride))
            if len(level) >= _MIN_LEVEL_STRIDES:
                ratios[_KIND[ends]].append(float(np.log((stride.end_ns - stride.begin_ns) / np.median(level))))
    log_ratio = np.array([np.mean(values) for values in ratios])
    return np.array([np.mean(p, axis=0) for p in pitch]), np.array([np.std(p, axis=0) for p in pitch]), log_ratio


def main() -> int:
    """Prints the tables."""
    walks: list[FootWalk] = []
    for seed in SEEDS:
        try:
            walks += simulate(TERRAINS[seed % len(TERRAINS)], seed)
        except StrideTwinError as error:
            print(f"{seed}: {error}", file=sys.stderr)
    mean, sd, log_ratio = fit(walks)
    for name, table in (("_MEANS", mean), ("_SDS", sd)):
        print(name)
        for row in table:
            print("    " + " ".join(f"{value:.1f}" for value in row))
    print("LOG_RATIO", log_ratio.round(2).tolist())
    return 0


if __name__ == "__main__":
    sys.exit(main())
