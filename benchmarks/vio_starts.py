"""Visual-inertial odometry from starts of other kinds than two seconds at rest.

`python -m benchmarks.vio_starts [--seeds FIRST COUNT] [--starts NAME ...] [--methods NAME ...] [--json]`. The same walk
round a room begins at rest for two seconds or for a minute, in the middle of a step, with a head that sways on the spot
(as a hovering drone does), or in the middle of a step with a shaken camera (as one held in the hand). The scale is the
factor on the estimated path, turned about the vertical, that fits the true one best. The method
`proposed_without_depth` gets no depth images.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import dropwhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from stridetwin.outputs.path.scores import compare
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Gaze
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Sample
from stridetwin.studies.zhao2023.odometry_walks import (
    ODOMETRY_METHODS,
    OdometryRun,
    make_odometer,
    mean,
    odometry_samples,
    run_odometry,
    score_odometry,
    true_path,
)

WITHOUT_DEPTH = "proposed_without_depth"
"""The proposed method as it runs on a recording that has no depth images."""
FIGURES = ("first_pose_s", "ape_rmse_m", "rpe_5m_pct", "loop_drift_m", "scale", "nees_within_95_pct")
_SWAYING = Gaze(sway_yaw_rad=np.radians(20.0), sway_pitch_rad=np.radians(10.0), sway_hz=0.4)
_SHAKEN = Gaze(sway_yaw_rad=np.radians(9.0), sway_pitch_rad=np.radians(4.0), sway_hz=2.0)


@dataclass(frozen=True, kw_only=True)
class Start:
    """How a recording begins: the walker's gait, and the time of its first sample, s."""

    gait: Gait
    from_s: float = 0.0


STARTS = {
    "two_seconds_at_rest": Start(gait=Gait()),
    "a_minute_at_rest": Start(gait=Gait(stand_s=60.0)),
    "in_motion": Start(gait=Gait(), from_s=5.3),
    "swaying_on_the_spot": Start(gait=Gait(stand_s=12.0, gaze=_SWAYING), from_s=1.5),
    "shaken_in_motion": Start(gait=Gait(gaze=_SHAKEN), from_s=5.3),
}


def samples_from(recording: Recording, from_s: float, *, depth: bool = True) -> Iterator[Sample]:
    """The samples of the head's camera and IMU from a time on, also those of depth if `depth`."""
    samples = dropwhile(lambda sample: sample.t_ns < from_s * 1e9, odometry_samples(recording, "head"))
    return (sample for sample in samples if depth or not isinstance(sample, Depth))


def run_of(method: str, recording: Recording, from_s: float) -> OdometryRun:
    """One of `ODOMETRY_METHODS`, or `WITHOUT_DEPTH`, on a recording from a time on."""
    if method != WITHOUT_DEPTH:
        return run_odometry(make_odometer(method, recording.rig, "head"), samples_from(recording, from_s))
    rig = recording.rig
    rig = replace(rig, cameras={n: replace(camera, depth_topic="") for n, camera in rig.cameras.items()})
    return run_odometry(make_odometer("proposed", rig, "head"), samples_from(recording, from_s, depth=False))


def scale_of(run: OdometryRun, truth: TruePath) -> float:
    """Factor on the estimated path that fits the true one best."""
    fitted = compare(run.odometry.path[run.odometry.healthy], truth, "yaw")
    true, estimated = (p - p.mean(axis=0) for p in (fitted.truth.p_frame_in_world, fitted.estimate.p_frame_in_world))
    return float((true * estimated).sum() / (estimated * estimated).sum())


@contextmanager
def recorded_walk(seed: int, gait: Gait) -> Iterator[Recording]:
    """A recording of the walk round a room, for as long as it is needed."""
    config = load_scenario("dvio_walk").config
    twin = Twin(replace(config, sensors=("head_imu", "head_camera"), gait=gait, physics="kinematic"), seed)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(twin, path, lambda stage, share: None)
        yield Recording(path)


def one_start(start: Start, seed: int, methods: list[str]) -> dict[str, Any]:
    """Figures by method of a walk."""
    with recorded_walk(seed, start.gait) as recording:
        truth, scores_by_method = true_path(recording, "head"), {}
        for method in methods:
            run = run_of(method, recording, start.from_s)
            scores = score_odometry(run, truth)
            if scores["failure"] not in ("silent", "not finite"):
                first = float(run.odometry.path.t_ns[run.odometry.healthy.argmax()]) * 1e-9
                scores |= {"first_pose_s": first - start.from_s, "scale": scale_of(run, truth)}
            scores_by_method[method] = scores
    return scores_by_method


def summarised(cases: list[dict[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """Means of the named figures over walks, by method, and how many walks failed."""
    return {
        method: {name: mean((c[method] for c in cases), name) for name in names}
        | {"failures": sum(bool(c[method]["failure"]) for c in cases)}
        for method in (cases[0] if cases else ())
    }


def print_table(summary: dict[str, Any], names: Sequence[str], heading: str = "method") -> None:
    """Prints one line per case and method of a summary; the methods' column has a heading."""
    print(f"{'':<24}{heading:<24}" + "".join(f"{name:>20}" for name in (*names, "failures")))
    for case, methods in summary.items():
        for method, method_figures in methods.items():
            cells = ["-" if method_figures[name] is None else f"{method_figures[name]:.3f}" for name in names]
            print(
                f"{case:<24}{method:<24}" + "".join(f"{cell:>20}" for cell in (*cells, str(method_figures["failures"])))
            )


def measure(arguments: Namespace) -> dict[str, Any]:
    """Walks every start with every seed."""
    first, count = arguments.seeds
    cases = {
        name: [one_start(STARTS[name], seed, arguments.methods) for seed in range(first, first + count)]
        for name in arguments.starts
    }
    summary = {name: summarised(method_figures, FIGURES) for name, method_figures in cases.items()}
    return {"benchmark": "vio_starts", "seeds": [first, count], "summary": summary, "cases": cases}


def show(result: dict[str, Any]) -> None:
    """Prints one line per start and method."""
    print_table(result["summary"], FIGURES)


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=[15500, 2], metavar=("FIRST", "COUNT"))
    parser.add_argument("--starts", nargs="+", choices=list(STARTS), default=list(STARTS))
    parser.add_argument(
        "--methods",
        nargs="+",
        choices=(*ODOMETRY_METHODS, WITHOUT_DEPTH),
        default=["proposed", WITHOUT_DEPTH, "vins_mono"],
    )
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
