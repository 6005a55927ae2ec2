"""Which way of walking a step belongs to, from geometry alone: every threshold is a size in the world."""

from __future__ import annotations

import math

from stridetwin.estimators.contact_terrain.estimate import UNKNOWN

RAMP_RAD = math.radians(2.5)
"""Ground that slopes more is a ramp: half of the gentlest ramp that one is built for, 5°."""
RISER_M = 0.055
"""A footprint that is further above (or below) what slopes explain is on a stair: between a kerb, 40 mm, and 70 mm."""
SURE = 0.70
"""A class less likely than this is not told."""


def step_modes(slope: float, slope_sd: float, beyond: float, beyond_sd: float) -> dict[str, float]:
    """Probability of each mode.

    A foot on sloping ground is on a ramp, whatever lies between the footprints; on level ground it is on a stair where
    the height between them is more than the slopes of both explain, and else on the level.

    Args:
        slope: Of the ground under the foot, rad.
        slope_sd: rad.
        beyond: Height over the footprint before beyond what the slopes explain, m, negative below.
        beyond_sd: m.
    """
    up, down = _above(slope, RAMP_RAD, slope_sd), _above(-slope, RAMP_RAD, slope_sd)
    flat = 1.0 - up - down
    high, low = _above(beyond, RISER_M, beyond_sd), _above(-beyond, RISER_M, beyond_sd)
    return {"LG": flat * (1.0 - high - low), "SA": flat * high, "SD": flat * low, "RA": up, "RD": down}


def most_likely(probabilities: dict[str, float]) -> tuple[str, float]:
    """The most likely mode and its probability; `unknown` where no mode is likely enough."""
    mode = max(probabilities, key=lambda m: probabilities[m])
    return (mode if probabilities[mode] >= SURE else UNKNOWN), probabilities[mode]


def beyond_slopes(height: float, distance: float, slope: float, slope_before: float) -> float:
    """Height that ground between two footprints cannot explain, sloping as under the one or the other, m."""
    reach = (0.0, distance * math.tan(slope), distance * math.tan(slope_before))
    return height - min(max(height, min(reach)), max(reach))


def _above(value: float, limit: float, sd: float) -> float:
    return 0.5 * math.erfc((limit - value) / (math.sqrt(2.0) * max(sd, 1e-9)))
