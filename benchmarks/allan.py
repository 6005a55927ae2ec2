"""Allan deviation of every simulated IMU at rest, compared with the figures of its part.

`python -m benchmarks.allan [--hours 2] [--seeds 20] [--plot allan.html] [--json]`. The overlapping Allan
variance of each axis (IEEE Std 952-1997, annex C) is fitted by N²/τ + B² 2 ln 2/π + K² τ/3: white noise N, bias
instability B and rate random walk K. N² includes the quantisation noise. Confidence intervals are those of the mean
over the seeds of the mean over the three axes.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from stridetwin.pages.html import page, section
from stridetwin.pages.plot import Plot
from stridetwin.sim.choices import part_files
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import FLOOR, Noise
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.streams.rig import ImuCalibration, Mount
from stridetwin.streams.samples import Array

CHUNK_S = 100.0
TRIADS = ("gyroscope", "accelerometer")
SHORTEST_S = 0.2  # averaging time
LONGEST_SHARE = 0.1  # of the recording: the longest averaging time of the fit
FIRST_SEED = 1000
COLORS = ("#0b6bcb", "#d9480f", "#2b8a3e")


def parts() -> dict[str, ImuPart]:
    """The library's IMUs."""
    return {name: p for name in part_files() if isinstance(p := load_part(name), ImuPart)}


def at_rest(imu: ImuPart, seconds: float, seed: int) -> Array:
    """Angular rates and specific forces (N, 6) of a level sensor at rest, without limits and delay."""
    free = {"range": math.inf, "bandwidth_hz": math.inf, "delay_s": 0.0}
    imu = replace(imu, gyroscope=replace(imu.gyroscope, **free), accelerometer=replace(imu.accelerometer, **free))
    nominal = ImuCalibration(
        topic="/imu",
        part=imu.name,
        rate_hz=imu.rate_hz,
        mount=Mount(body="b"),
        gyroscope_noise_density=0.0,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=0.0,
        accelerometer_random_walk=0.0,
    )
    model = ImuModel(nominal, imu, Noise.of_topic(seed, imu.name))
    samples = []
    count = round(CHUNK_S * imu.rate_hz)
    for start in range(0, round(seconds * imu.rate_hz), count):
        t_ns = np.round(np.arange(start, start + count) * (1e9 / imu.rate_hz)).astype(np.int64)
        nothing = np.zeros((count, 3))
        still = Track(
            t_ns=t_ns,
            p_body_in_world=nothing,
            q_world_body=np.tile([1.0, 0, 0, 0], (count, 1)),
            v_body_in_world=nothing,
            w_body=nothing,
        )
        block = model.read(still, t_ns)
        samples.append(np.hstack([block.columns["angular_rate"], block.columns["specific_force"]]))
    return np.concatenate(samples)


def means(x: Array, rate_hz: float) -> Array:
    """Means over the shortest averaging time, from which all longer ones are computed."""
    count = round(SHORTEST_S * rate_hz)
    return np.asarray(x[: len(x) // count * count].reshape(-1, count, x.shape[1]).mean(axis=1))


def allan_variance(x: Array, counts: NDArray[np.int64]) -> Array:
    """(M, K) overlapping Allan variance of (N, K) samples, averaged over (M,) numbers of samples."""
    total = np.vstack([np.zeros((1, x.shape[1])), np.cumsum(x - x.mean(axis=0), axis=0)])
    variances = []
    for m in counts.tolist():
        mean = (total[m:] - total[:-m]) / m
        variances.append(np.mean((mean[m:] - mean[:-m]) ** 2, axis=0) / 2)
    return np.array(variances)


def coefficients(tau: Array, variance: Array, expected: Array, seconds: float) -> Array:
    """(3, K) fitted N², B², K², weighted by the expected accuracy of the (M,) variances."""
    basis = np.column_stack([1 / tau, np.full(len(tau), FLOOR**2), tau / 3])
    weight = 1 / (expected * np.sqrt(tau / seconds))
    return np.linalg.lstsq(basis * weight[:, None], variance * weight[:, None], rcond=None)[0]


def truth(imu: ImuPart, triad: str) -> Array:
    """(3,) N², B², K² of a part's three gyroscopes or accelerometers."""
    figures = getattr(imu, triad)
    white = figures.noise_density**2 + figures.resolution**2 / 12 / imu.rate_hz
    return np.array([white, (figures.bias_instability / FLOOR) ** 2, figures.random_walk**2])


def measure(imu: ImuPart, seconds: float, seeds: int) -> dict[str, dict[str, Any]]:
    """Fit of each triad, with 95 % intervals, and its Allan deviation."""
    counts = np.unique(np.round(np.geomspace(1, LONGEST_SHARE * seconds / SHORTEST_S, 40)).astype(np.int64))
    tau = counts * SHORTEST_S
    variance = np.array(
        [
            allan_variance(means(at_rest(imu, seconds, s), imu.rate_hz), counts)
            for s in range(FIRST_SEED, FIRST_SEED + seeds)
        ]
    )
    result = {}
    for i, triad in enumerate(TRIADS):
        expected = truth(imu, triad)
        model = np.column_stack([1 / tau, np.full(len(tau), FLOOR**2), tau / 3]) @ expected
        sensor_variance = variance[:, :, 3 * i : 3 * i + 3]
        fits = np.array([coefficients(tau, v, model, seconds).mean(axis=1) for v in sensor_variance])  # (seeds, 3)
        mean, half = fits.mean(axis=0), stats.t.ppf(0.975, seeds - 1) * fits.std(axis=0, ddof=1) / math.sqrt(seeds)
        result[triad] = {
            "white_over_part": float(np.sqrt(mean[0] / expected[0])),
            **{
                f"{name}_over_part": {
                    "squared": float(mean[k] / expected[k]),
                    "low": float((mean[k] - half[k]) / expected[k]),
                    "high": float((mean[k] + half[k]) / expected[k]),
                    "inside": bool(abs(mean[k] - expected[k]) <= half[k]),
                }
                for k, name in ((1, "instability"), (2, "walk"))
            },
            "tau_s": tau.tolist(),
            "deviation": np.sqrt(sensor_variance.mean(axis=(0, 2))).tolist(),
            "model": np.sqrt(model).tolist(),
        }
    return result


def plot(results: dict[str, dict[str, dict[str, Any]]]) -> str:
    """A page with the gyroscopes' Allan deviations, measured and from the part's figures, on logarithmic axes."""
    tau = np.log10(next(iter(results.values()))["gyroscope"]["tau_s"])
    deviation = {n: np.log10(np.degrees(r["gyroscope"]["deviation"]) * 3600) for n, r in results.items()}
    every = np.concatenate(list(deviation.values()))
    low, high = float(every.min()) - 0.1, float(every.max()) + 0.1
    title = "Allan deviation of the simulated gyroscopes"
    axes = Plot(
        title=title,
        x=(float(tau[0]), float(tau[-1])),
        y=(low, high),
        x_label="averaging time, log10 of seconds",
        y_label="Allan deviation, log10 of deg/h",
        height=380,
    )
    for (name, y), color in zip(deviation.items(), COLORS):
        r = results[name]["gyroscope"]
        axes.line(np.log10(r["tau_s"]), np.log10(np.degrees(r["model"]) * 3600), color, width=1.2, dash="dash")
        axes.dots(np.log10(r["tau_s"]), y, color, size=4.4, label=name)
    return page(title, "Dots: measured at rest. Lines: the parts' figures.", [], [section("", "", axes.html())], "")


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="HTML page with the figure")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    results = {name: measure(imu, 3600 * options.hours, options.seeds) for name, imu in parts().items()}
    if options.plot:
        options.plot.write_text(plot(results), encoding="utf-8")
    if options.json:
        print(json.dumps({"experiment": "allan", "summary": results, "paper": {}, "cases": []}))
        return 0
    print(f"{'':24} {'white':>7} {'instability²':>26} {'walk²':>26}   over the part's figures, 95 % interval")
    for name, triads in results.items():
        for triad, r in triads.items():
            spans = (r["instability_over_part"], r["walk_over_part"])
            cells = [f"{s['squared']:.3f} ({s['low']:.2f}-{s['high']:.2f}){'' if s['inside'] else ' !'}" for s in spans]
            print(f"{name + ' ' + triad:24} {r['white_over_part']:7.4f} {cells[0]:>26} {cells[1]:>26}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
