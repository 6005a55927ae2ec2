"""Visual-inertial odometry with a camera's clock or forces that are off, and in darkness.

`python -m benchmarks.vio_errors [--seeds FIRST COUNT] [--walks NAME ...] [--errors NAME ...] [--json]`. Each walk of
the twin is recorded once and replayed with every error: the camera's clock 100 ms off to either side, forces 3 % too
large or too small, and no light from 5 s on, with depth images and without. Figures are means over the walks: error at
the end in m and in percent of the way, with the start aligned; height there; NEES of the position (3 if consistent),
and share of the time within its 95 % bound.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.outputs.path.scores import compare, score
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.faults.faults import Fault, FaultPlan
from stridetwin.sim.faults.image_faults import Darkness
from stridetwin.sim.faults.sample_faults import Dropout, Miscalibration
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Imu, Sample
from stridetwin.studies.zhao2023.odometry_walks import odometry_samples, run_odometry, true_path

_DARK_S = 5.0  # when the light goes out
FIGURES = (
    "end_error_m",
    "end_error_pct",
    "end_height_error_m",
    "nees_position_mean",
    "nees_position_within_95_pct",
)


@dataclass(frozen=True, kw_only=True)
class Error:
    """Faults of a walk, and the factor by which its forces are too large."""

    faults: tuple[Fault, ...] = ()
    force: float = 1.0


def _clock(offset_s: float) -> Error:
    return Error(faults=(Miscalibration(topic="/head/color", clock_offset_s=offset_s),))


_DARK = Darkness(topic="/head/color", at_s=_DARK_S)
ERRORS = {
    "none": Error(),
    "clock_100_ms": _clock(0.1),
    "clock_-100_ms": _clock(-0.1),
    "force_3_pct": Error(force=1.03),
    "force_-3_pct": Error(force=0.97),
    "dark": Error(faults=(_DARK,)),
    "dark_without_depth": Error(faults=(_DARK, Dropout(topic="/head/depth", at_s=_DARK_S))),
}


def scale_forces(samples: Iterator[Sample], factor: float) -> Iterator[Sample]:
    """The samples with forces of the IMU times a factor."""
    for sample in samples:
        yield replace(sample, specific_force=sample.specific_force * factor) if isinstance(sample, Imu) else sample


def follow(recording: Recording, error: Error, seed: int) -> dict[str, float]:
    """Figures of one walk with an error."""
    plan = FaultPlan.of(error.faults, recording.rig, seed, recording.duration)
    samples = scale_forces(plan.samples(odometry_samples(recording, "head")), error.force)
    run = run_odometry(Dvio(plan.rig, options=Options(mount="head")), samples)
    scores = score(compare(run.odometry.path, true_path(recording, "head")))
    return {name: float(scores[name]) for name in FIGURES}


def measure(arguments: Namespace) -> dict[str, Any]:
    """Every walk with every error."""
    first, count = arguments.seeds
    cases: dict[str, list[dict[str, float]]] = {name: [] for name in arguments.errors}
    for walk in arguments.walks:
        config = replace(load_scenario(walk).config, sensors=("head_imu", "head_camera"), physics="kinematic")
        for seed in range(first, first + count):
            with TemporaryDirectory() as folder:
                path = Path(folder) / "walk.mcap"
                record(Twin(config, seed), path, lambda stage, share: None)
                for name, rows in cases.items():
                    rows.append(follow(Recording(path), ERRORS[name], seed))
    summary = {
        name: {figure: float(np.mean([row[figure] for row in rows])) for figure in FIGURES}
        for name, rows in cases.items()
    }
    return {"benchmark": "vio_errors", "seeds": [first, count], "summary": summary, "cases": cases}


def show(result: dict[str, Any]) -> None:
    """Prints one line per error."""
    print(f"{'error':<20}" + "".join(f"{name:>30}" for name in FIGURES))
    for name, figures in result["summary"].items():
        print(f"{name:<20}" + "".join(f"{figures[figure]:>30.3f}" for figure in FIGURES))


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=[1000, 1], metavar=("FIRST", "COUNT"))
    parser.add_argument("--walks", nargs="+", default=["dvio_walk", "dvio_stairs", "level_20m"])
    parser.add_argument("--errors", nargs="+", choices=list(ERRORS), default=list(ERRORS))
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
