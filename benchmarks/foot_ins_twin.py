"""The one-foot inertial navigation on the twin: three scenarios, both feet, noisy sensors, known truth.

`python -m benchmarks.foot_ins_twin [--json] [--seeds 1000 1001 ...]`. Each walk is made anew from its seed,
with the foot IMUs alone; the filter is told the sensor's calibration, no start pose. Errors are those of
`stridetwin score`: in 3-D, after the paths agree in position and heading where the filter has found the
vertical.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stridetwin.estimators.foot_ins import FootIns
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.scenarios.scoring import Scores, compare, score
from stridetwin.scenarios.truth import TruePath
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array, Block

SCENARIOS = ("level_20m", "stair_up_down", "ramp_up_down")
SEEDS = range(1000, 1010)
FEET = ("l", "r")


def joined(pieces: Sequence[Block[Any]]) -> Block[Any]:
    """One block of consecutive pieces of a topic."""
    columns = {name: np.concatenate([b.columns[name] for b in pieces]) for name in pieces[0].columns}
    return replace(pieces[0], t_ns=np.concatenate([b.t_ns for b in pieces]), columns=columns)


def scores_of_walk(scenario: str, seed: int) -> dict[str, Scores]:
    """Scores of each foot in one walk."""
    twin = Twin(replace(load_scenario(scenario).config, sensors=("foot_imu",)), seed)
    chunks = [{b.topic: b for b in chunk if isinstance(b, Block)} for chunk in twin.blocks()]
    scores = {}
    for foot in FEET:
        topic = f"/foot_{foot}/imu"
        imu, truth = (joined([c[name] for c in chunks]) for name in (topic, f"/truth{topic}/odometry"))
        path = FootIns(twin.rig.imu(topic)).run(imu)
        ready_ns = int(path.trajectory.t_ns[path.aligned.argmax()])
        scores[foot] = score(compare(path.trajectory, TruePath.of(truth).since(ready_ns)))
    return scores


def summary(cases: Sequence[Scores]) -> dict[str, float]:
    """Means and extremes over walks and feet."""

    def column(name: str) -> Array:
        return np.array([case[name] for case in cases])

    height = column("end_height_error_m")
    result = {
        f"{name}_{how}": float(value)
        for name in ("end_error_pct", "end_error_m", "armse_2d_m")
        for how, value in (("mean", column(name).mean()), ("max", column(name).max()))
    }
    return result | {
        "end_height_error_m_mean": float(height.mean()),
        "end_height_error_m_largest": float(abs(height).max()),
        "nees_position_mean": float(column("nees_position_mean").mean()),
        "nees_position_within_95_pct": float(column("nees_position_within_95_pct").mean()),
    }


def measure(seeds: Sequence[int]) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    walks = [(scenario, seed, scores_of_walk(scenario, seed)) for scenario in SCENARIOS for seed in seeds]
    return {
        "experiment": "foot_ins_twin",
        "summary": {
            name: summary([s for scenario, _, feet in walks if scenario == name for s in feet.values()])
            for name in SCENARIOS
        },
        "cases": [
            {"scenario": scenario, "seed": seed, "foot": foot, **scores}
            for scenario, seed, feet in walks
            for foot, scores in feet.items()
        ],
    }


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="seeds of the walks (1000 to 1009)")
    arguments = parser.parse_args()
    result = measure(arguments.seeds)
    if arguments.json:
        print(json.dumps(result))
        return 0
    for name, figures in result["summary"].items():
        print(name)
        for key, value in figures.items():
            print(f"  {key:28s} {value:8.3f}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except StrideTwinError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
