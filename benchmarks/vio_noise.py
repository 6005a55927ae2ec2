"""Visual-inertial odometry whose IMU is worse than its data sheet says.

`python -m benchmarks.vio_noise [--seeds FIRST COUNT] [--parts NAME ...] [--json]`. The samples of the head's IMU on a
walk round a room get more white noise, or errors of axes and scale that calibration has not removed. The odometry runs
with the noise that images show, and with the fixed multiple of the data sheet's. `found` is the estimated multiple at
the end, of gyroscope and accelerometer.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from benchmarks.vio_starts import print_table, recorded_walk, summarised
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio, DvioMethod, DvioParameters
from stridetwin.sim.config import Gait
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Imu, Sample
from stridetwin.studies.zhao2023.odometry_walks import odometry_samples, run_odometry, score_odometry, true_path

FIGURES = ("ape_rmse_m", "rpe_5m_pct", "nees_within_95_pct", "found_rate", "found_force")
NOISE_FROM = {"images": True, "data_sheet": False}


@dataclass(frozen=True, kw_only=True)
class Part:
    """Errors beyond the simulated part's own.

    Attributes:
        noise: White noise added, of a multiple of the data sheet's density.
        axes_sd: Standard deviation of each entry added to the matrix of axes and scale.
    """

    noise: float = 0.0
    axes_sd: float = 0.0


PARTS = {
    "as_its_data_sheet": Part(),
    "ten_times_the_noise": Part(noise=10.0),
    "thirty_times_the_noise": Part(noise=30.0),
    "axes_and_scale_1_pct": Part(axes_sd=0.01),
    "axes_and_scale_2_pct": Part(axes_sd=0.02),
}


def worse(recording: Recording, part: Part, seed: int) -> Iterator[Sample]:
    """The samples of the head's camera and IMU, the IMU's with the errors of a part."""
    rng, imu = np.random.default_rng(seed), recording.rig.imus["/head/imu"]
    of_rate, of_force = np.eye(3) + part.axes_sd * rng.normal(size=(2, 3, 3))
    rate_sd, force_sd = (
        part.noise * density * np.sqrt(imu.rate_hz)
        for density in (imu.gyroscope_noise_density, imu.accelerometer_noise_density)
    )
    for sample in odometry_samples(recording, "head"):
        if isinstance(sample, Imu) and part != Part():
            sample = replace(
                sample,
                angular_rate=of_rate @ sample.angular_rate + rate_sd * rng.normal(size=3),
                specific_force=of_force @ sample.specific_force + force_sd * rng.normal(size=3),
            )
        yield sample


def one_walk(seed: int, parts: list[str]) -> dict[str, Any]:
    """Figures of a walk by part and origin of the noise."""
    results: dict[str, Any] = {}
    with recorded_walk(seed, Gait()) as recording:
        truth = true_path(recording, "head")
        for part in parts:
            results[part] = {}
            for origin, from_images in NOISE_FROM.items():
                method = DvioMethod(imu_noise_from_images=from_images)
                odometry = Dvio(recording.rig, options=Options(mount="head"), parameters=DvioParameters(method=method))
                scores = score_odometry(run_odometry(odometry, worse(recording, PARTS[part], seed)), truth)
                rate, force = odometry.imu_noise_factors
                results[part][origin] = scores | {"found_rate": rate, "found_force": force}
    return results


def measure(arguments: Namespace) -> dict[str, Any]:
    """Walks every seed with every part."""
    first, count = arguments.seeds
    cases = [one_walk(seed, arguments.parts) for seed in range(first, first + count)]
    summary = {part: summarised([case[part] for case in cases], FIGURES) for part in arguments.parts}
    return {"benchmark": "vio_noise", "seeds": [first, count], "summary": summary, "cases": cases}


def show(result: dict[str, Any]) -> None:
    """Prints one line per part and origin of the noise."""
    print_table(result["summary"], FIGURES, "noise from")


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=[15400, 4], metavar=("FIRST", "COUNT"))
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=list(PARTS))
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
