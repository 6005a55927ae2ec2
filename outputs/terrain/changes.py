"""Terrain changes of a route, and the errors of their estimates."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stridetwin.streams.terrain_truth import Strip


@dataclass(frozen=True, kw_only=True)
class TerrainChange:
    """A place on the route where stairs, a ramp or level ground begin.

    Attributes:
        s: Its place, m along the route.
        mode: Mode of the steps beyond it: LG, SA, SD, RA or RD.
        riser: Height of the risers of stairs that begin, m, down negative; 0 if none begin.
        tread: Depth of their treads, m; 0 if none begin.
        risers: Number of their risers; 0 if none begin, or if it is not needed.
        slope: Slope of a ramp that begins, rad, down negative; 0 if none begins.
    """

    s: float
    mode: str
    riser: float = 0.0
    tread: float = 0.0
    risers: int = 0
    slope: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ScoredChange:
    """Errors of an estimated terrain change (estimated minus true) with the reported standard deviations.

    Numbers are NaN where unknown. Each error has its standard deviation beside it: `riser_sd_m` is that of `riser_m`.

    Attributes:
        mode: True mode of the steps beyond it.
        is_detected: Whether it was detected.
        distance_m: Error of the position along the route.
        riser_m: Error of the height of the risers.
        tread_m: Error of the depth of the treads.
        slope_rad: Error of the slope.
    """

    mode: str
    is_detected: bool
    distance_m: float = math.nan
    distance_sd_m: float = math.nan
    riser_m: float = math.nan
    riser_sd_m: float = math.nan
    tread_m: float = math.nan
    tread_sd_m: float = math.nan
    slope_rad: float = math.nan
    slope_sd_rad: float = math.nan


def mode_of(strip: Strip) -> str:
    """Mode of the steps along a strip without edges."""
    return "LG" if strip.slope == 0 else "RA" if strip.slope > 0 else "RD"
