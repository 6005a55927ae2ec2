"""Runs and scores odometries on recorded walks with the camera on head or chest.

Every method reads the same samples in the same order. Time is that of `update` alone, summed from image to image,
without reading and decoding of the recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators import registry
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.outputs.path.run import pose_of
from stridetwin.outputs.path.scores import DriftFigures, OdometryPath, drift_figures
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Image, Sample
from stridetwin.streams.trajectory import Pose, trajectory_of
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.result import CaseRow
from stridetwin.studies.walks import fell_at_s, record_walk

ESTIMATORS = ("dvio",)
"""Estimators whose parameters `--set` changes here."""

ODOMETRY_METHODS = ("proposed", "dvio", "vins_rgbd", "vins_mono")
"""Ours, then those of Zhao et al. 2023 under their names there: complete, and ablated."""
FigureName = Literal[
    "loop_drift_m",
    "ape_rmse_m",
    "rpe_5m_pct",
    "height_rmse_m",
    "climb_error_m",
    "unhealthy_s",
    "nees_within_95_pct",
]
"""Names of figures of `OdometryFigures` of which means over walks are taken."""
FIGURES: tuple[FigureName, ...] = ("loop_drift_m", "ape_rmse_m", "rpe_5m_pct", "height_rmse_m", "climb_error_m")
"""Those of them that measure drift."""


class Odometer(Protocol):
    """An odometry that runs."""

    def update(self, sample: Sample) -> object:
        """Takes a sample, in time order; returns a `Pose` of the IMU, an object with one, or None."""


Maker = Callable[[str, Rig, str], Odometer]
"""Makes an odometry from its name, the nominal rig, and the mount of the camera."""


def make_odometer(name: str, rig: Rig, mount: str) -> Odometer:
    """Builds one of `ODOMETRY_METHODS`, or an installed estimator of paths.

    Args:
        name: The method or the estimator.
        rig: Nominal rig.
        mount: Mount of the camera: head or chest.
    """
    if name in ODOMETRY_METHODS:  # all of them are methods of one class
        return Dvio(rig, options=Options(method=name, mount=mount), **parameter_keywords(Dvio, name))
    # an installed estimator runs with the first of its methods
    estimator_class = registry.estimator(name)
    first = estimator_class.declaration.methods[0]
    options = Options(method=first, mount=mount)
    return estimator_class(rig, options=options, **parameter_keywords(estimator_class, first))


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryRun:
    """Result of an odometry on a recording.

    Attributes:
        odometry: Its path, and where it reports that it is healthy.
        frame_ms: (N,) processing time from one image to the next.
    """

    odometry: OdometryPath
    frame_ms: Array


def run_odometry(odometry: Odometer, samples: Iterable[Sample]) -> OdometryRun:
    """Runs an odometry on samples in time order; of several poses of one instant the last one is kept.

    Returns:
        The path, and the processing time from each image to the next, ms.
    """
    poses: dict[int, Pose] = {}
    frame_ms: list[float] = []
    spent = 0.0  # since the last image, ms; what comes before the first image is left out at the end
    for sample in samples:
        if isinstance(sample, Image):
            frame_ms.append(spent)
            spent = 0.0
        began = time.perf_counter()
        estimate = odometry.update(sample)
        spent += 1e3 * (time.perf_counter() - began)
        if (pose := pose_of(estimate, type(odometry).__name__)) is not None:
            poses[pose.t_ns] = pose  # the last one at an instant uses most samples
    path = [poses[t] for t in sorted(poses)]
    # whether the odometry reports each pose as healthy
    healthy = np.array([pose.valid for pose in path], bool)
    return OdometryRun(
        odometry=OdometryPath(path=trajectory_of(path), healthy=healthy), frame_ms=np.array(frame_ms[1:])
    )


def odometry_samples(recording: Recording, mount: str) -> Iterator[Sample]:
    """Samples of IMU, colour images and depth of the camera on a mount, in time order."""
    return recording.samples([f"/{mount}/{stream}" for stream in ("imu", "color", "depth")])


def true_path(recording: Recording, mount: str) -> TruePath:
    """True path of the IMU of the camera on a mount."""
    return TruePath.of(recording.block(f"/truth/{mount}/imu/odometry"))


class OdometryFigures(DriftFigures):
    """Drift and failure of an odometry on one walk.

    Attributes:
        time_ms: Processing time per frame: `mean` and `p99`.
    """

    time_ms: dict[str, float]


def score_odometry(run: OdometryRun, truth: TruePath) -> OdometryFigures:
    """Figures of one run: drift and failure by `drift_figures`, and `time_ms` per frame, `mean` and `p99`."""
    return {**drift_figures(run.odometry, truth), "time_ms": time_statistics(run.frame_ms)}


class OdometryRow(CaseRow):
    """The row of a walk; a walk of a bench also has the name of its sequence.

    Attributes:
        mount: Body of the camera: head or chest.
        fell_at_s: When the walker fell; None without a fall.
        rate_radps: Measured angular rate of this body: `p95` and `max`.
        methods: Drift, failure and time, by method.
    """

    mount: str
    fell_at_s: float | None
    rate_radps: dict[str, float]
    methods: dict[str, OdometryFigures]


def run_every_method(
    recording: Recording, mount: str, make: Maker, further_names: Sequence[str] = ()
) -> dict[str, OdometryFigures]:
    """Figures of each of `ODOMETRY_METHODS` and of other installed estimators on one walk, by name.

    Args:
        recording: The walk.
        mount: Mount of the camera: head or chest.
        make: Makes an odometry from its name, the rig, and the mount.
        further_names: Names of the other estimators.
    """
    truth = true_path(recording, mount)
    figures = {}
    for name in (*ODOMETRY_METHODS, *further_names):
        run = run_odometry(make(name, recording.rig, mount), odometry_samples(recording, mount))
        figures[name] = score_odometry(run, truth)
    return figures


def run_case(case: ExperimentCase, make: Maker = make_odometer) -> Row:
    """Runs every method and other installed estimators on one walk.

    Returns:
        The case's row with `mount`, `fell_at_s`, `rate_radps` (`p95` and `max` of the measured angular rate of head or
        chest), and `methods`: method to its drift, failure and time (`score_odometry`).
    """
    (walk,) = case.walks()
    mount = walk.config.rig_mount
    with record_walk(walk, case) as recording:
        rate = np.linalg.norm(recording.block(f"/{mount}/imu").columns["angular_rate"], axis=1)
        return case.row(
            mount=mount,
            fell_at_s=fell_at_s(recording),
            rate_radps={"p95": float(np.percentile(rate, 95)), "max": float(rate.max())},
            methods=run_every_method(recording, mount, make, case.estimators),
        )


def time_statistics(frame_ms: Array) -> dict[str, float]:
    """Mean (`mean`) and 99th percentile (`p99`) of times, ms; 0 without any."""
    if not len(frame_ms):
        return {"mean": 0.0, "p99": 0.0}
    return {"mean": float(frame_ms.mean()), "p99": float(np.percentile(frame_ms, 99))}


def mean(walks: Iterable[OdometryFigures], name: FigureName) -> float | None:
    """Mean of a figure over the walks that have it; None without any."""
    values = [value for w in walks if (value := w.get(name)) is not None]
    return float(np.mean(values)) if values else None


def summarize_time(walks: Iterable[OdometryFigures]) -> dict[str, float]:
    """Mean of the walks' mean times per frame (`mean`), and the largest 99th percentile of any walk (`p99`), ms."""
    times = [w["time_ms"] for w in walks]
    return {"mean": float(np.mean([t["mean"] for t in times])), "p99": max(t["p99"] for t in times)}
