"""Two feet in closed form that stride identically for ever, and what ideal sensors on them measure.

The world's axes are north, west and up. In stance a foot does not move at all, as the simulation of Jao, Wang,
Shkel 2020 has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins.parameters import FootInsParameters
from stridetwin.sim.gait.smooth import ease, ease_rate
from stridetwin.sim.sensors.strapdown import increments
from stridetwin.sim.track import Track
from stridetwin.streams.samples import Array

EARTH_RATE = 7.292115e-5  # rad/s


@dataclass(frozen=True, kw_only=True)
class SteadyWalk:
    """How both feet walk.

    Attributes:
        strides: Of each foot.
        stride_m: Length of a stride.
        stride_s: Time of a stride.
        swing_share: Share of it that the foot moves.
        separation_m: From the right foot's line to the left's.
        stand_s: Both stand for so long before the left foot starts, and after the right has landed.
        heel_rise_m: Height of the heel at its highest.
        heel_off_rad: Largest pitch of the foot, toes down, early in swing.
        toes_up_rad: Largest pitch the other way, before it lands.
        latitude_rad: Of the place.
        gravity_mps2: As the filters assume it.
    """

    strides: int = 100
    stride_m: float = 1.54
    stride_s: float = 1.07
    swing_share: float = 0.55
    separation_m: float = 0.20
    stand_s: float = 0.15
    heel_rise_m: float = 0.18
    heel_off_rad: float = 0.6
    toes_up_rad: float = 0.25
    latitude_rad: float = math.radians(33.64)
    gravity_mps2: float = FootInsParameters().gravity_mps2

    @property
    def duration_s(self) -> float:
        """From the first instant to the last."""
        return 2 * self.stand_s + (self.strides + 0.5) * self.stride_s

    @property
    def earth_rate_in_world(self) -> Array:
        """(3,) rad/s."""
        return EARTH_RATE * np.array([math.cos(self.latitude_rad), 0.0, math.sin(self.latitude_rad)])

    def foot(self, foot: str, t_ns: NDArray[np.int64]) -> Track:
        """Track of a foot's frame (on the sole under the heel).

        The right foot starts half a stride ahead, and half a stride's time later.

        Args:
            foot: `l` or `r`.
            t_ns: (N,) instants.
        """
        half = 0.5 * (foot == "r")
        strides = (t_ns * 1e-9 - self.stand_s) / self.stride_s - half
        k = np.clip(np.floor(strides), 0, self.strides - 1)
        u = np.clip((strides - k) / self.swing_share, 0.0, 1.0)
        per_s = 1.0 / (self.swing_share * self.stride_s)
        advance, advance_rate = ease(u), ease_rate(u)
        lift, lift_rate = _bump(u, 0.0, 1.0)
        heel_off, heel_off_rate = _bump(u, 0.0, 0.6)
        toes_up, toes_up_rate = _bump(u, 0.45, 1.0)
        side = np.full_like(u, self.separation_m / 2 if foot == "l" else -self.separation_m / 2)
        still = np.zeros_like(u)
        pitch = self.heel_off_rad * heel_off - self.toes_up_rad * toes_up
        turn = (self.heel_off_rad * heel_off_rate - self.toes_up_rad * toes_up_rate) * per_s
        return Track(
            t_ns=t_ns,
            p_body_in_world=np.column_stack([self.stride_m * (k + half + advance), side, self.heel_rise_m * lift]),
            q_world_body=Rotation.from_rotvec(np.column_stack([still, pitch, still])).as_quat(scalar_first=True),
            v_body_in_world=np.column_stack(
                [self.stride_m * advance_rate * per_s, still, self.heel_rise_m * lift_rate * per_s]
            ),
            w_body=np.column_stack([still, turn, still]),
        )

    def inertial(self, sensor: Track) -> tuple[Array, Array]:
        """(N - 1, 3) mean rates (rad/s) and forces (m/s²) that an ideal sensor has, the Earth's turning included.

        Args:
            sensor: Track of the IMU at the N ends and starts of its intervals.
        """
        down = np.array([0.0, 0.0, -self.gravity_mps2])
        dt, rate, force = increments(sensor[:1], sensor[1:], down)
        to_sensor = (sensor.rotation[:-1] * Rotation.from_rotvec(0.5 * dt[:, None] * rate)).inv()
        velocity = 0.5 * (sensor.v_body_in_world[:-1] + sensor.v_body_in_world[1:])
        earth = self.earth_rate_in_world
        return rate + to_sensor.apply(earth), force + to_sensor.apply(2.0 * np.cross(earth, velocity))


def _bump(u: Array, start: float, end: float) -> tuple[Array, Array]:
    """From 0 to 1 and back over u in start..end, smooth to the second derivative, and the derivative."""
    x = np.clip((u - start) / (end - start), 0.0, 1.0)
    hill = 4.0 * x * (1.0 - x)
    return hill**3, 12.0 * hill**2 * (1.0 - 2.0 * x) / (end - start)
