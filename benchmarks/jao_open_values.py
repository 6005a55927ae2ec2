"""Values that Jao et al. 2020 leave open: the end error of their zero-velocity method on the tuning walks, by value.

Run as `python -m benchmarks.jao_open_values [--walks N] [--physics kinematic|dynamic] [--json]`. Walks are the 53 m of
Table II with gyros that do not saturate, seeds 0 to N - 1, none of which is in a results page. One value varies at a
time, the others are those of `PublishedParameters`.
"""

from __future__ import annotations

import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_to_foot import FootToFoot, FootToFootParameters, PublishedParameters
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.studies.jao2020.two_feet import FEET, score_paths, true_start
from stridetwin.studies.walks import endless_gyro

GRID: dict[str, tuple[float, ...]] = {
    "zero_velocity_sd_mps": (0.003, 0.01, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5),
    "threshold": (1e3, 3e3, 1e4, 3e4, 1e5, 3e5),
    "window_s": (0.025, 0.05, 0.1, 0.15),
}


def variants() -> Iterator[tuple[str, float, FootToFootParameters]]:
    """Every value of the grid, with the parameters that have it."""
    for name, values in GRID.items():
        for value in values:
            yield name, value, FootToFootParameters(published=replace(PublishedParameters(), **{name: value}))


def measured(arguments: Namespace) -> dict[str, Any]:
    """Horizontal end errors, m, of both feet on every walk: `{NAME: {VALUE: [..]}}`; and the values in use."""
    end_errors_m: dict[str, dict[str, list[float]]] = {
        name: {f"{v:g}": [] for v in values} for name, values in GRID.items()
    }
    config = replace(
        load_scenario("jao_straight_53m").config,
        sensors=("foot_imu",),
        fittings={"foot_imu": endless_gyro()},
        physics=arguments.physics,
    )
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(arguments.walks):
            file = Path(folder) / f"{seed}.mcap"
            record(Twin(config, seed), file, lambda stage, share: None)
            walk = Recording(file)
            truth = {foot: TruePath.of(walk.block(f"/truth/foot_{foot}/imu/odometry")) for foot in FEET}
            imus = {foot: walk.block(f"/foot_{foot}/imu") for foot in FEET}
            for name, value, parameters in variants():
                pair = FootToFoot(
                    walk.rig, options=Options(method="zupt"), start=true_start(truth), parameters=parameters
                )
                ends = score_paths(pair.run(imus, []), truth)["end_error_m"]
                end_errors_m[name][f"{value:g}"] += [float(np.hypot(*end[:2])) for end in ends]
            file.unlink()
    used = PublishedParameters()
    return {"walks": arguments.walks, "ends_m": end_errors_m, "used": {name: getattr(used, name) for name in GRID}}


def show(result: dict[str, Any]) -> None:
    """Prints the median and the mean of the end errors by value."""
    print(f"{result['walks']} walks of 53 m, both feet; * in use")
    print(f"{'value':<32}{'median m':>10}{'mean m':>10}{'worst m':>10}")
    for name, by_value in result["ends_m"].items():
        for value, ends in by_value.items():
            mark = "*" if float(value) == result["used"][name] else ""
            print(f"{f'{name} {value}{mark}':<32}{np.median(ends):>10.2f}{np.mean(ends):>10.2f}{max(ends):>10.2f}")


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--walks", type=int, default=6)
    parser.add_argument("--physics", choices=("kinematic", "dynamic"), default="dynamic")
    sys.exit(answer(parser, measured, show))
