"""Runs and scores odometries on recorded walks with the camera on head or chest.

Every method reads the same samples in the same order. Time is that of `update` alone, summed from image to image,
without reading and decoding of the recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.evaluation.path_scores import Odometry, drift_figures
from stridetwin.evaluation.truth import TruePath
from stridetwin.scenarios.record import record
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.pose import Pose, trajectory_of
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Depth, Image, Imu, Sample
from stridetwin.studies.case import Case

METHODS = ("proposed", "dvio", "vins_rgbd", "vins_mono")
"""Ours, then those of Zhao et al. 2023 under their names there: complete, and ablated."""
SENSORS = ("head_imu", "head_camera")
HEALTHY = ("tracking", "coasting")
FIGURES = ("loop_drift_m", "ape_rmse_m", "rpe_5m_pct", "height_rmse_m", "climb_error_m")


class Estimate(Protocol):
    """What an odometry estimates at one instant.

    Attributes:
        t_ns: Its time.
        pose: Of the IMU in a world of its own, z up.
        health: `tracking`, `coasting` (IMU-only propagation for a short time), or anything else if it is lost.
    """

    @property
    def t_ns(self) -> int: ...  # noqa: D102
    @property
    def pose(self) -> Pose: ...  # noqa: D102
    @property
    def health(self) -> str: ...  # noqa: D102


class Odometer(Protocol):
    """A running odometry."""

    def update(self, sample: Imu | Image | Depth) -> Estimate | None:
        """Processes a sample; samples come in time order."""


Maker = Callable[[str, Rig, str], Odometer]
"""Makes an odometry from a method, the nominal rig, and the mount of the camera."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ride:
    """Result of an odometry on a recording.

    Attributes:
        told: Its path.
        frame_ms: (N,) processing time from one image to the next.
    """

    told: Odometry
    frame_ms: Array


def dvio(method: str, rig: Rig, mount: str) -> Odometer:
    """The odometry of a method (`METHODS`)."""
    return Dvio(rig, options=Options(method=method, mount=mount))


def follow(odometer: Odometer, samples: Iterable[Sample]) -> Ride:
    """Runs an odometry on samples in time order."""
    estimates: dict[int, Estimate] = {}
    frame_ms: list[float] = []
    spent = 0.0
    for sample in samples:
        assert isinstance(sample, Imu | Image | Depth)
        if isinstance(sample, Image):
            frame_ms.append(spent)
            spent = 0.0
        began = time.perf_counter()
        estimate = odometer.update(sample)
        spent += 1e3 * (time.perf_counter() - began)
        if estimate is not None:
            estimates[estimate.t_ns] = estimate  # the last one at an instant uses most samples
    return Ride(told=_odometry(estimates), frame_ms=np.array(frame_ms[1:]))


def _odometry(estimates: Mapping[int, Estimate]) -> Odometry:
    inorder = [estimates[t] for t in sorted(estimates)]
    path = trajectory_of([e.pose for e in inorder])
    return Odometry(path=path, healthy=np.array([e.health in HEALTHY for e in inorder], bool))


@contextmanager
def recorded(config: TwinConfig, case: Case, name: str) -> Iterator[Recording]:
    """A walk, recorded into the case's folder; the file is deleted afterwards unless kept."""
    file = case.file(f"_{name}.mcap")
    if not (case.resume and file.exists()):
        record(Twin(config, case.seed), file, lambda stage, share: None)
    yield Recording(file)
    if not case.keep:
        file.unlink()


def odometry_samples(recording: Recording, mount: str) -> Iterator[Sample]:
    """IMU, images and depth, in time order."""
    return recording.samples([f"/{mount}/{stream}" for stream in ("imu", "color", "depth")])


def true_path(recording: Recording, mount: str) -> TruePath:
    """True path of the camera's IMU."""
    return TruePath.of(recording.block(f"/truth/{mount}/imu/odometry"))


def figures(ride: Ride, truth: TruePath) -> dict[str, Any]:
    """`drift_figures`, and `time_ms` per frame."""
    return drift_figures(ride.told, truth) | {"time_ms": time_of(ride.frame_ms)}


def every_method(
    recording: Recording, mount: str, make: Maker, methods: Sequence[str] = METHODS
) -> dict[str, dict[str, Any]]:
    """Figures by method."""
    truth = true_path(recording, mount)
    return {
        method: figures(follow(make(method, recording.rig, mount), odometry_samples(recording, mount)), truth)
        for method in methods
    }


def time_of(frame_ms: NDArray[np.float64]) -> dict[str, float]:
    """Mean and 99th percentile."""
    if not len(frame_ms):
        return {"mean": 0.0, "p99": 0.0}
    return {"mean": float(frame_ms.mean()), "p99": float(np.percentile(frame_ms, 99))}


def mean(walks: Iterable[Mapping[str, Any]], name: str) -> float | None:
    """Mean of a figure over the walks that have it."""
    values = [w[name] for w in walks if w.get(name) is not None]
    return float(np.mean(values)) if values else None


def worst_time(walks: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Mean time per frame, and the largest 99th percentile of any walk."""
    times = [w["time_ms"] for w in walks]
    return {"mean": float(np.mean([t["mean"] for t in times])), "p99": max(t["p99"] for t in times)}
