"""IMUs as people have them: a part whose errors are drawn for each walk from those of a class of parts.

Estimators keep the calibration of the nominal part, which knows nothing of the drawn one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.figure import DEG, G
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import load_part

_DRAWN = (
    "noise_density",
    "bias_instability",
    "random_walk",
    "turn_on_bias",
    "scale_factor",
    "misalignment",
    "g_sensitivity",
    "resolution",
    "delay_s",
)
"""Figures of a triad that are drawn; the nominal part keeps rate, range and bandwidth, which drivers set and tell."""
_SELF_HEATING_K = 3.0  # of a part with its case in the first minutes [estimated]


@dataclass(frozen=True, kw_only=True)
class Population:
    """A class of IMUs.

    Attributes:
        members: Parts of the library, whose figures span those of the class.
        gyroscope_warm_up: Least and largest change of a gyroscope's bias until it is warm, rad/s.
        accelerometer_warm_up: Likewise of an accelerometer's, m/s².
    """

    members: tuple[str, ...]
    gyroscope_warm_up: tuple[float, float]
    accelerometer_warm_up: tuple[float, float]


POPULATIONS = {
    # Change of the bias per kelvin: makers' figures for the BMI055 (0.015 °/s, 1 mg) and the MPU-9250 (30 °/s over
    # 125 K, 1.5 mg), not checked against the sheets.
    "consumer": Population(
        members=("MPU-9250", "MPU-9250-wearable", "BMI055", "NGIMU-uncalibrated", "MTw-uncalibrated", "x-IMU"),
        gyroscope_warm_up=(0.015 * DEG * _SELF_HEATING_K, 0.24 * DEG * _SELF_HEATING_K),
        accelerometer_warm_up=(1e-3 * G * _SELF_HEATING_K, 1.5e-3 * G * _SELF_HEATING_K),
    ),
    # Makers compensate the temperature; what is left is estimated: 1 to 10 % of the better consumer part's.
    "industrial": Population(
        members=("ADIS16485", "3DM-GX4-25-imu"),
        gyroscope_warm_up=(0.00015 * DEG * _SELF_HEATING_K, 0.0015 * DEG * _SELF_HEATING_K),
        accelerometer_warm_up=(1e-5 * G * _SELF_HEATING_K, 1e-4 * G * _SELF_HEATING_K),
    ),
}
"""The populations by name."""


def draw_part(name: str, nominal: ImuPart, noise: Noise) -> ImuPart:
    """One part of a population, in place of a nominal one; each walk draws one, and each sensor of it its own errors.

    A figure is log-uniform between the least and the largest of the members. Where that of a member is 0, as the delay
    of a channel mostly is, it is that of a random member, as such figures are there or not.

    Args:
        name: One of `POPULATIONS`.
        nominal: Gives rate, ranges, bandwidths and the text.
        noise: Source of the draws.
    """
    population = POPULATIONS[name]
    members: list[Any] = [load_part(member) for member in population.members]
    triads = {}
    for triad, warm_up in (
        ("gyroscope", population.gyroscope_warm_up),
        ("accelerometer", population.accelerometer_warm_up),
    ):
        nominal_triad = getattr(nominal, triad)
        ranges = {
            figure: [getattr(getattr(member, triad), figure) for member in members]
            for figure in _DRAWN
            if hasattr(nominal_triad, figure)
        }
        ranges["warm_up"] = list(warm_up)
        # every figure takes one number of its own, so that none changes the others
        quantiles = noise.uniform(len(ranges)).tolist()
        triads[triad] = replace(
            nominal_triad, **{figure: _at(values, u) for (figure, values), u in zip(ranges.items(), quantiles)}
        )
    return replace(nominal, **triads)


def _at(values: list[float], quantile: float) -> float:
    """Figure at a quantile (0-1) of a population with these figures of its members."""
    low, high = min(values), max(values)
    if low == 0.0:
        return sorted(values)[min(int(quantile * len(values)), len(values) - 1)]
    return low * math.exp(quantile * math.log(high / low))
