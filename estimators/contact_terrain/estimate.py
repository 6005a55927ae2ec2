"""The estimate of one step, and its locomotion mode.

`mode_probabilities` uses geometry alone, with thresholds that are dimensions in the world; `TerrainSvm` is a support
vector machine trained on steps (Shim et al. 2019, section 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.estimators.contact_terrain.parameters import ContactTerrainParameters
from stridetwin.streams.errors import StrideTwinError, install_hint
from stridetwin.streams.samples import Array

MODES = ("LG", "SA", "SD", "RA", "RD")
"""Level ground, stair ascent and descent, ramp ascent and descent."""
UNKNOWN = "unknown"
# Penalty C of the published support vector machine, and width γ of its radial basis function per squared share of the
# largest slope and elevation; the paper does not give them, hand-chosen. Doubled: its boundaries follow single training
# steps more closely.
_SVM_C, _SVM_GAMMA = 100.0, 10.0
# Slope above which the ground beyond a riser is a ramp: most such ground is a tread. Doubled: landings on a ramp of
# less than 10° beyond a riser are on stairs.
_TREAD_RAMP_RAD = 2.0 * math.radians(2.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class StepEstimate:
    """The estimated ground under the last footprint, at one instant of its foot-flat.

    Attributes:
        t_ns: Time of the last tick used.
        step: Number of the step, from 1; 0 for the feet on the ground at the start.
        foot: `l` or `r`.
        slope: rad, uphill positive in the direction of the foot.
        elevation: m, height of this footprint over the previous one (of the other foot).
        slope_sd: Standard deviation, rad; inf if the method provides none.
        elevation_sd: Standard deviation, m; inf if the method provides none.
        normal: (3,) unit vector of the ground in world axes, up.
        p_sole_in_world: (3,) m, origin of the sole; the world's origin is under the foot that stood first.
        covariance: (3, 3) m² of `p_sole_in_world` relative to the previous footprint; inf on the diagonal if the method
            provides none.
        mode: One of `MODES`, or `unknown`.
        probability: Probability of `mode`; 0 where a method without classes leaves it unknown.
    """

    t_ns: int
    step: int
    foot: str
    slope: float
    elevation: float
    slope_sd: float
    elevation_sd: float
    normal: Array
    p_sole_in_world: Array
    covariance: Array
    mode: str
    probability: float


class TerrainSvm:
    """Classifies steps by slope and elevation, each divided by its largest magnitude in training.

    Args:
        slope: (N,) rad, slope of each training step.
        elevation: (N,) m, elevation of each.
        modes: (N,) mode of each, of `MODES`.

    Raises:
        StrideTwinError: scikit-learn is not installed, or there are fewer than two modes.
    """

    def __init__(self, slope: ArrayLike, elevation: ArrayLike, modes: ArrayLike) -> None:
        """Trains the machine on N steps: slopes (N,) in rad, elevations (N,) in m, and the mode of each.

        `_scale` holds the largest magnitude of slope, rad, and elevation, m, by which both are divided.
        """
        try:
            from sklearn.svm import SVC
        except ModuleNotFoundError as error:
            raise StrideTwinError(
                f"scikit-learn is not installed; classes that are learnt need it: {install_hint('learn')}"
            ) from error
        labels = np.asarray(modes)
        if len(np.unique(labels)) < 2:
            raise StrideTwinError(f"the steps to learn from are of {len(np.unique(labels))} modes: expected 2 or more")
        features = np.column_stack([np.asarray(slope, dtype=float), np.asarray(elevation, dtype=float)])
        self._scale: Array = np.maximum(np.abs(features).max(axis=0), 1e-9)
        machine = SVC(kernel="rbf", C=_SVM_C, gamma=_SVM_GAMMA)
        self._machine: Any = machine.fit(features / self._scale, labels)

    def classify(self, slope: float, elevation: float) -> str:
        """Mode of one step.

        Args:
            slope: Slope of the ground, rad.
            elevation: Height over the previous footprint, m.
        """
        return str(self._machine.predict(np.array([[slope, elevation]]) / self._scale)[0])


def mode_probabilities(
    slope: float, slope_sd: float, beyond: float, beyond_sd: float, parameters: ContactTerrainParameters
) -> dict[str, float]:
    """Probability of each mode (docs/contact_terrain.md (12)).

    Sloping ground is a ramp. Level ground is a stair if the height between the footprints exceeds what both slopes
    explain, and level otherwise. A foot with a small tilt beyond a riser is on a tread.

    Args:
        slope: Slope of the ground under the foot, rad.
        slope_sd: Its standard deviation, rad.
        beyond: Height over the previous footprint beyond what the slopes explain, m, negative below.
        beyond_sd: Its standard deviation, m.
        parameters: Dimensions in the world.
    """
    riser, ramp = parameters.riser_m, parameters.ramp_rad
    # probabilities of a riser up, of one down, and of neither
    high, low = probability_above(beyond, riser, beyond_sd), probability_above(-beyond, riser, beyond_sd)
    no_riser = 1.0 - high - low
    # probabilities that the ground under the foot slopes up or down as a ramp does
    up, down = probability_above(slope, ramp, slope_sd), probability_above(-slope, ramp, slope_sd)
    # the same beyond a riser, where only a greater slope is a ramp, and a lesser one a tread
    steep_up, steep_down = (
        probability_above(slope, _TREAD_RAMP_RAD, slope_sd),
        probability_above(-slope, _TREAD_RAMP_RAD, slope_sd),
    )
    tread = 1.0 - steep_up - steep_down
    return {
        "LG": no_riser * (1.0 - up - down),
        "SA": tread * high,
        "SD": tread * low,
        "RA": no_riser * up + (high + low) * steep_up,
        "RD": no_riser * down + (high + low) * steep_down,
    }


def most_likely(probabilities: dict[str, float], probability_min: float) -> tuple[str, float]:
    """The most likely mode and its probability; `unknown` where that is below `probability_min`."""
    mode = max(probabilities, key=lambda m: probabilities[m])
    return (mode if probabilities[mode] >= probability_min else UNKNOWN), probabilities[mode]


def height_beyond_slopes(height: float, distance: float, slope: float, slope_before: float) -> float:
    """Height between two footprints that no slope of the ground explains, m (docs/contact_terrain.md (11)).

    Ground that is level or slopes as under either footprint reaches a range of heights over the distance; this is the
    height above or, negative, below that range.

    Args:
        height: Height of the footprint over the previous one, m.
        distance: Horizontal distance of the two, m.
        slope: Slope under the footprint, rad.
        slope_before: Slope under the previous one, rad.
    """
    # heights that level ground, and ground with either slope, reaches over the distance, m
    reach = (0.0, distance * math.tan(slope), distance * math.tan(slope_before))
    explained = min(max(height, min(reach)), max(reach))  # the height, limited to their range
    return height - explained


def ramp_probability(slope: float, sd: float, ramp_rad: float) -> float:
    """Probability that ground of a slope (rad, standard deviation `sd`) rises or falls by more than `ramp_rad`."""
    return probability_above(slope, ramp_rad, sd) + probability_above(-slope, ramp_rad, sd)


def probability_above(value: float, limit: float, sd: float) -> float:
    """Probability that a normally distributed value of standard deviation `sd` exceeds a limit."""
    return 0.5 * math.erfc((limit - value) / (math.sqrt(2.0) * max(sd, 1e-9)))
