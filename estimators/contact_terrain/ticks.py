"""Joins nine streams into one row per instant: attitudes of the exoskeleton's frames, knee angles and cell forces.

A tick is whole when every stream has brought its sample; the first sample of a later instant closes one that is not. A
late stream is extrapolated for up to `TickParameters.hold_s`: an attitude by its last angular rate, an angle and forces
as they were. A sample that is not finite, that no such sensor gives, or that is not later than the stream's last one
counts as lost. A negative force, of a cell whose zero is low, counts as none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.contact_terrain.geometry import SIDES, Exoskeleton
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, TickParameters
from stridetwin.streams.samples import Ahrs, Array, Encoder, Insole, Sample

_HERE = Path(__file__).parent


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """Samples of all streams at one instant; feet in the order of `SIDES`.

    Attributes:
        t_ns: Time.
        dt: Since the last tick, s; 0 for the first one and after a gap that was not bridged.
        R_world_base: (3, 3) of the back panel, frame 0.
        R_world_thigh: (2, 3, 3) of the thigh's frames.
        R_world_foot: (2, 3, 3) of the last frames.
        rate: (5, 3) rad/s of back, thighs and feet in the axes of their frames.
        knee: (2,) rad, angles of the joints that turn the knees' frames.
        force: (2, 4) N on heel, lateral ball, medial ball and toe.
        fresh: (5,) bool, whether the attitude was measured rather than extrapolated.
    """

    t_ns: int
    dt: float
    R_world_base: Array
    R_world_thigh: Array
    R_world_foot: Array
    rate: Array
    knee: Array
    force: Array
    fresh: Array


class Gather:
    """Collects samples of an exoskeleton into ticks.

    Args:
        exo: Its streams and sensor mounts.
        parameters: Largest delay of a stream, and ranges of valid samples.
    """

    def __init__(self, exo: Exoskeleton, parameters: TickParameters = DEFAULTS.ticks) -> None:
        self._parameters = parameters
        legs = [exo.legs[side] for side in SIDES]
        attitudes = [exo.back, *(leg.thigh for leg in legs), *(leg.foot for leg in legs)]
        self._attitude = {a.topic: (i, a.R_frame_sensor.T) for i, a in enumerate(attitudes)}
        self._encoder = {leg.knee.topic: (i, leg.knee.sign) for i, leg in enumerate(legs)}
        self._insole = {leg.sole.topic: i for i, leg in enumerate(legs)}
        self._last = dict.fromkeys(exo.topics, -1)
        self._R, self._rate = np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3))
        self._knee, self._force = np.zeros(2), np.zeros((2, 4))
        self._open: set[str] = set()
        self._now = self._told = -1

    def add(self, sample: Sample) -> list[Tick]:
        """Takes one sample; returns the ticks that it completes or closes, at most two."""
        if (
            sample.topic not in self._last
            or sample.t_ns <= self._last[sample.topic]
            or not _sane(sample, self._parameters)
        ):
            return []
        made = []
        if self._open and sample.t_ns > self._now + self._parameters.together_s * 1e9:
            made += self._close()
        if not self._open:
            self._now = sample.t_ns
        self._keep(sample)
        if len(self._open) == len(self._last):
            made += self._close()
        return made

    def _keep(self, sample: Sample) -> None:
        match sample:
            case Ahrs():
                i, R_sensor_frame = self._attitude[sample.topic]
                self._R[i] = matrix(sample.q_world_sensor) @ R_sensor_frame
                self._rate[i] = R_sensor_frame.T @ sample.angular_rate
            case Encoder():
                i, sign = self._encoder[sample.topic]
                self._knee[i] = sign * sample.angle
            case Insole():
                self._force[self._insole[sample.topic]] = np.maximum(sample.force, 0.0)
        self._last[sample.topic] = sample.t_ns
        self._open.add(sample.topic)

    def _close(self) -> list[Tick]:
        self._open, fresh = set(), np.ones(5, dtype=bool)
        oldest = min(self._last.values())
        if oldest < 0 or (self._now - oldest) * 1e-9 > self._parameters.hold_s:
            return []
        R = self._R.copy()
        for topic, (i, _) in self._attitude.items():
            late = (self._now - self._last[topic]) * 1e-9
            if late > self._parameters.together_s:
                R[i], fresh[i] = R[i] @ exp_so3(late * self._rate[i]), False
        dt = (self._now - self._told) * 1e-9
        if self._told < 0 or dt > self._parameters.hold_s:
            dt = 0.0
        self._told = self._now
        return [
            Tick(
                t_ns=self._now, dt=dt, R_world_base=R[0], R_world_thigh=R[1:3], R_world_foot=R[3:5],
                rate=self._rate.copy(), knee=self._knee.copy(), force=self._force.copy(), fresh=fresh,
            )
        ]  # fmt: skip


def _sane(sample: Sample, limits: TickParameters) -> bool:
    match sample:
        case Ahrs():
            q, rate = sample.q_world_sensor, sample.angular_rate
            return bool(abs(q @ q - 1.0) < 0.02 and rate @ rate < limits.rate_max_radps**2)
        case Encoder():
            return abs(sample.angle) < 2 * math.pi
        case Insole():
            return bool(np.abs(sample.force).max() < limits.force_max_n)
    return False


@cached(_HERE)
def matrix(q: Array) -> Array:
    """(3, 3) rotation of a quaternion (w, x, y, z)."""
    w, x, y, z = q / np.sqrt(np.sum(q * q))
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@cached(_HERE)
def exp_so3(turn: Array) -> Array:
    """(3, 3) rotation by a rotation vector, rad."""
    angle = math.sqrt(np.sum(turn * turn))
    x, y, z = turn
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.eye(3) + K
    return np.eye(3) + math.sin(angle) / angle * K + (1.0 - math.cos(angle)) / angle**2 * (K @ K)
