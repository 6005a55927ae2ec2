"""Consistency of the foot filters: NEES of the position over many walks of the twin.

`python -m benchmarks.nees [--runs 30] [--cameras 4] [--seed 1000] [--scenario level_20m] [--json]`. Bar-Shalom et al.
2001, 5.4.2: at one instant the mean over N walks of eᵀ P⁻¹ e, times N, is χ² with 3N degrees of freedom if the filter
is consistent. Every filter gets the true start pose of each foot. Walks are kinematic. With `--cameras`, this number of
them is repeated with the shoe cameras, whose images then link the feet; otherwise the sonars do.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks.command import answer, command, show_summary
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_to_foot import FootToFoot, follow
from stridetwin.outputs.path.scores import CHI2_3_95
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory
from stridetwin.studies.jao2020.two_feet import FEET, true_start
from stridetwin.studies.walks import IMUS

SHARES = np.linspace(0.1, 1.0, 46)  # of a walk's duration: instants at which walks are compared


def nees_at(estimate: Trajectory, truth: TruePath) -> Array:
    """(46,) NEES of the position at the `SHARES` of a walk."""
    t_ns = truth.t_ns[0] + (SHARES * (truth.t_ns[-1] - truth.t_ns[0])).astype(np.int64)
    rows = np.searchsorted(estimate.t_ns, t_ns, side="right") - 1
    error = estimate.p_frame_in_world[rows] - truth.at(estimate.t_ns[rows]).p_frame_in_world
    assert estimate.covariance is not None
    return np.asarray(
        np.einsum("ni,ni->n", error, np.linalg.solve(estimate.covariance[rows, :3, :3], error[..., None])[..., 0])
    )


def nees_of_walk(scenario: str, seed: int, cameras: bool) -> dict[str, list[Array]]:
    """By filter, NEES of both feet in one walk."""
    sensors = ("foot_imu", "foot_camera", "sonar") if cameras else ("foot_imu", "sonar")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(Twin(replace(load_scenario(scenario).config, sensors=sensors), seed), path, lambda stage, share: None)
        walk = Recording(path)
        truth = {f: TruePath.of(walk.block(f"/truth/foot_{f}/imu/odometry")) for f in FEET}
        start = true_start(truth)
        heard = [t for t in walk.topics if t.endswith(("/sonar", "/camera"))]
        both = follow(FootToFoot(walk.rig, start=start), walk.samples([*IMUS, *heard]))
        paths_by_method = {"foot_to_foot, cameras" if cameras else "foot_to_foot, sonars": both}
        if not cameras:
            paths_by_method["foot_ins"] = {
                f: FootIns(walk.rig, start=start[f], options=Options(foot=f)).run(walk.block(t))
                for f, t in zip(FEET, IMUS)
            }
        return {name: [nees_at(paths[f].trajectory, truth[f]) for f in FEET] for name, paths in paths_by_method.items()}


def summary(nees: Array) -> dict[str, float]:
    """Statistics of one filter's (walks, feet, instants) NEES.

    Returns:
        `nees_mean` (3 if consistent), `nees_median` (2.37), `within_95_pct`: share of values within the χ² bound;
        `bound_low` and `bound_high`: 95 % bounds of the mean over the walks; `mean_within_95_pct`: share of instants
        within them.
    """
    runs = len(nees)
    low, high = (float(v) / runs for v in chi2.ppf((0.025, 0.975), 3 * runs))
    mean = nees.mean(axis=0)
    return {
        "nees_mean": float(nees.mean()),
        "nees_median": float(np.median(nees)),
        "within_95_pct": 100.0 * float(np.mean(nees <= CHI2_3_95)),
        "bound_low": low,
        "bound_high": high,
        "mean_within_95_pct": 100.0 * float(np.mean((mean >= low) & (mean <= high))),
        "mean_above_95_pct": 100.0 * float(np.mean(mean > high)),
        "runs": float(runs),
    }


def measure(scenario: str, seed: int, runs: int, cameras: int) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    nees_by_method: dict[str, list[list[Array]]] = {}
    for seen, count in ((False, runs), (True, cameras)):
        for walk in range(seed, seed + count):
            for name, feet in nees_of_walk(scenario, walk, seen).items():
                nees_by_method.setdefault(name, []).append(feet)
    return {
        "experiment": "nees",
        "scenario": scenario,
        "summary": {n: summary(np.array(v)) for n, v in nees_by_method.items()},
    }


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--runs", type=int, default=30, help="walks without cameras (30)")
    parser.add_argument("--cameras", type=int, default=4, help="walks with cameras (4)")
    parser.add_argument("--seed", type=int, default=1000, help="of the first walk (1000)")
    parser.add_argument("--scenario", default="level_20m", help="of the catalogue (level_20m)")
    return answer(parser, lambda a: measure(a.scenario, a.seed, a.runs, a.cameras), show_summary(24, "8.2f"))


if __name__ == "__main__":
    sys.exit(main())
