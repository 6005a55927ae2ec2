"""Sonar from shoe to shoe: what range the other foot would give, and whether an echo can be its.

An ultrasonic ranger answers with the nearest thing in a wide cone, whatever it is: the floor, a stair, somebody else.
Only an echo where the other foot is expected says anything about it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.errors import check_numbers
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Array, Range


@dataclass(frozen=True, kw_only=True)
class SonarParameters:
    """What is believed of a shoe and of a ranger.

    Attributes:
        heel_m: Height of the shoe's axis above the sole, m.
        length_m: The axis reaches from the heel's centre this far forward, m.
        radius_m: Radius of the shoe about that axis, m.
        shape_sd_m: How far a real shoe's surface is from that, m.
        step_m: Step in which the ranger counts (SRF08: 43 mm in its data sheet's ranging mode), m; 0 = none.
        gate: Standard deviations that an echo may be off.
    """

    heel_m: float = 0.040
    length_m: float = 0.125
    radius_m: float = 0.036
    shape_sd_m: float = 0.01
    step_m: float = 0.043
    gate: float = 3.0

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number ≥ 0."""
        values = asdict(self)
        check_numbers("SonarParameters", values, may_be_zero=values)


@dataclass(frozen=True, kw_only=True, eq=False)
class FeetRange:
    """A range as a filter takes it: z = predicted + H δ + noise, δ the shift of the other foot.

    Attributes:
        t_ns: Time of the echo.
        innovation: Measured minus predicted, m.
        H: (3,) derivative of the range by the other foot's position in the sonar's frame: the unit vector to it.
        sd: Standard deviation of the measurement, m.
    """

    t_ns: int
    innovation: float
    H: Array
    sd: float


class FeetSonar:
    """Turns echoes into ranges between the feet.

    Args:
        sonar: The ranger as calibrated; its frame's x axis is the beam's axis.
        parameters: Shoe and gate.

    Raises:
        StrideTwinError: A sonar that does not tell its `beam_rad` or `range_sd_m`.
    """

    def __init__(self, sonar: OtherSensor, parameters: SonarParameters | None = None) -> None:
        self._parameters = p = parameters or SonarParameters()
        self._half_beam = sonar.number("beam_rad") / 2
        # a count is anywhere within its step: variance step² / 12
        self._sd = math.sqrt(sonar.number("range_sd_m") ** 2 + p.shape_sd_m**2 + p.step_m**2 / 12)

    def measure(self, echo: Range, T_sonar_foot: ArrayLike, position_sd_m: float) -> FeetRange | None:
        """The range, where the echo can be the other foot's.

        Args:
            echo: What the ranger says.
            T_sonar_foot: (4, 4) believed pose of the other foot's frame in the sonar's frame, m.
            position_sd_m: How certain its distance is, m.

        Returns:
            None without an echo, where the foot is outside the beam or behind, and where the echo is too near or too
            far to be the foot's: something else was heard.
        """
        p, T = self._parameters, np.asarray(T_sonar_foot, dtype=float)
        if not (math.isfinite(echo.distance) and echo.distance > 0.0 and np.isfinite(T).all()):
            return None
        heel = T[:3, :3] @ np.array([0.0, 0.0, p.heel_m]) + T[:3, 3]
        forward = T[:3, 0] * p.length_m
        along = np.clip(-(heel @ forward) / max(forward @ forward, 1e-12), 0.0, 1.0)
        nearest = heel + along * forward
        away = float(np.linalg.norm(nearest))
        if away <= p.radius_m:
            return None
        off_axis = math.acos(np.clip(nearest[0] / away, -1.0, 1.0))
        if off_axis > self._half_beam + math.asin(p.radius_m / away):
            return None
        innovation = echo.distance - (away - p.radius_m)
        if abs(innovation) > p.gate * math.hypot(self._sd, position_sd_m):
            return None
        return FeetRange(t_ns=echo.t_ns, innovation=innovation, H=nearest / away, sd=self._sd)
