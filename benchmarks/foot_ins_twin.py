"""The one-foot inertial navigation on the twin: four scenarios, both feet, noisy sensors, known truth.

`python -m benchmarks.foot_ins_twin [--json] [--part NAME] [--seeds 1000 1001 ...]`. Each walk is simulated from its
seed with the foot IMUs alone; the filter gets the sensor's nominal calibration, but no start pose. Errors are those of
`stridetwin score`: 3-D, after alignment of position and heading where the filter has found the vertical. The same walks
go through the smoother.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.command import answer, command, show_summary
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.outputs.path.scores import PathComparison, Scores, compare, score
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import STANDARD, SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Imu

SCENARIOS = ("level_20m", "stair_up_down", "ramp_up_down", "gentle_ramps")
PART = STANDARD["foot_imu"]
SEEDS = range(1000, 1010)
FEET = ("l", "r")
LAG_S = 1.0


def join_blocks(pieces: Sequence[Block[Any]]) -> Block[Any]:
    """Consecutive blocks of a topic, joined."""
    columns = {name: np.concatenate([b.columns[name] for b in pieces]) for name in pieces[0].columns}
    return replace(pieces[0], t_ns=np.concatenate([b.t_ns for b in pieces]), columns=columns)


@lru_cache(maxsize=1)
def feet_of_walk(scenario: str, seed: int, imu_part: str = PART) -> dict[str, tuple[Rig, Block[Imu], TruePath]]:
    """Rig, samples and truth of each foot's IMU, a part of the library, in one walk."""
    fittings = {"foot_imu": SensorConfig(part=load_part(imu_part))}
    twin = Twin(replace(load_scenario(scenario).config, sensors=("foot_imu",), fittings=fittings), seed)
    chunks = [{b.topic: b for b in chunk if isinstance(b, Block)} for chunk in twin.blocks()]
    feet = {}
    for foot in FEET:
        topic = f"/foot_{foot}/imu"
        imu, truth = (join_blocks([c[name] for c in chunks]) for name in (topic, f"/truth{topic}/odometry"))
        feet[foot] = twin.rig, imu, TruePath.of(truth)
    return feet


def scores_of_walk(scenario: str, seed: int, lag_s: float | None = None, imu_part: str = PART) -> dict[str, Scores]:
    """Scores of each foot in one walk, and `swing_error_m`; with a lag, those of the smoother."""
    scores = {}
    for foot, (rig, imu, truth) in feet_of_walk(scenario, seed, imu_part).items():
        path = FootIns.batch(rig, Options(foot=foot, lag_s=lag_s)).run(imu)
        ready_ns = int(path.trajectory.t_ns[path.aligned.argmax()])
        comparison = compare(path.trajectory, truth.since(ready_ns))
        scores[foot] = score(comparison) | {"swing_error_m": swing_error(comparison)}
    return scores


def swing_error(
    comparison: PathComparison, swing_mps: float = 0.3, stance_mps: float = 0.05, stance_s: float = 0.08
) -> float:
    """Error added by the swings: RMS over them minus the straight line between the errors of the stances, m."""
    t, error = comparison.truth.t_ns * 1e-9, comparison.error_m
    speed = np.linalg.norm(np.gradient(comparison.truth.p_frame_in_world, t, axis=0), axis=1)
    stances = np.flatnonzero(np.diff(np.r_[0, speed < stance_mps, 0])).reshape(-1, 2)
    middle = np.array([(a + b) // 2 for a, b in stances if t[b - 1] - t[a] >= stance_s])
    line = np.column_stack([np.interp(t, t[middle], error[middle, i]) for i in range(3)])
    return float(np.sqrt(((error - line)[speed > swing_mps] ** 2).sum(axis=1).mean()))


def summary(cases: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Means and extremes over walks and feet."""

    def column(name: str) -> Array:
        return np.array([case[name] for case in cases])

    height = column("end_height_error_m")
    share = np.abs(height) / column("distance_m")
    result = {
        f"{name}_{how}": float(value)
        for name in ("end_error_pct", "end_error_m", "armse_2d_m", "swing_error_m")
        for how, value in (("mean", column(name).mean()), ("max", column(name).max()))
    }
    return result | {
        "end_height_error_m_mean": float(height.mean()),
        "end_height_pct_median": 100.0 * float(np.median(share)),
        "end_height_error_m_largest": float(abs(height).max()),
        "nees_position_mean": float(column("nees_position_mean").mean()),
        "nees_position_within_95_pct": float(column("nees_position_within_95_pct").mean()),
    }


def measure(seeds: Sequence[int], imu_part: str = PART) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    cases = [
        {"scenario": scenario, "seed": seed, "foot": foot, "lag_s": lag_s, **scores}
        for scenario in SCENARIOS
        for seed in seeds
        for lag_s in (None, LAG_S)
        for foot, scores in scores_of_walk(scenario, seed, lag_s, imu_part).items()
    ]
    names = {None: "", LAG_S: f", smoothed {LAG_S:g} s later"}
    return {
        "experiment": "foot_ins_twin",
        "summary": {
            f"{scenario}{name}": summary([c for c in cases if (c["scenario"], c["lag_s"]) == (scenario, lag_s)])
            for scenario in SCENARIOS
            for lag_s, name in names.items()
        },
        "cases": cases,
    }


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="seeds of the walks (1000 to 1009)")
    parser.add_argument("--part", default=PART, help="the foot IMU, a part of the library")
    return answer(parser, lambda a: measure(a.seeds, a.part), show_summary(28, "8.3f"))


if __name__ == "__main__":
    sys.exit(main())
