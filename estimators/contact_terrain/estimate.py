"""The estimate of one step."""

from __future__ import annotations

from dataclasses import dataclass

from stridetwin.streams.samples import Array

MODES = ("LG", "SA", "SD", "RA", "RD")
UNKNOWN = "unknown"


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
        normal: (3,) unit vector, up.
        p_sole_in_world: (3,) m, origin of the sole; the world's origin is under the foot that stood first.
        covariance: (3, 3) m² of `p_sole_in_world` relative to the previous footprint; inf on the diagonal if the method
            provides none.
        mode: One of `MODES`, or `unknown`.
        probability: Of that mode; 0 if unknown to a method without classes.
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
