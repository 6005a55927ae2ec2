"""Attitudes of five frames from what their AHRS tell and their gyros' rates.

An AHRS's tilt errs by a correlated error that grows with motion; its gyro, integrated from one tick to the next, hardly
errs at all within a step. So the rates carry each attitude and the AHRS pulls it back slowly: a Kalman filter of one
variance a frame, in which a told attitude weighs like a white error of the same power (2 τ σ² / dt).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.contact_terrain.ticks import Tick, exp_so3
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

STILL_SD = math.radians(0.15)
MOVING_SD = math.radians(0.9)
"""Standard deviation of an AHRS's tilt at rest and in full motion."""
FULL_MOTION_RADPS = 2.0
CORRELATION_S = 2.0
DRIFT = math.radians(0.03)
"""rad/√s, by which an integrated rate goes astray: noise, bias, scale."""


LOST_SD = math.radians(0.15)
"""What a lost sample hides of a limb in motion."""


class Attitudes:
    """Attitudes of back, thighs and feet.

    Attributes:
        R: (5, 3, 3) frame to world.
    """

    def __init__(self) -> None:
        self.R = np.tile(np.eye(3), (5, 1, 1))
        self._last = self.R.copy()  # at the last fresh sample, with its rate and the time since then
        self._rate, self._since = np.zeros((5, 3)), np.zeros(5)
        self._variance = np.full(5, -1.0)

    def update(self, tick: Tick) -> None:
        """Takes a tick; after a gap, and at first, the attitudes are as told. See docs/contact_terrain.md (6)."""
        told = np.concatenate((tick.R_world_base[None], tick.R_world_thigh, tick.R_world_foot))
        _fuse(self.R, self._last, self._variance, self._rate, self._since, told, tick.rate, tick.fresh, tick.dt)


@cached(_HERE)
def _fuse(
    R: Array, last: Array, variance: Array, last_rate: Array, since: Array, told: Array, rate: Array,
    fresh: Array, dt: float,
) -> None:  # fmt: skip
    for i in range(len(R)):
        since[i] += dt
        if not fresh[i] and variance[i] >= 0.0 and dt > 0.0:
            R[i] = last[i] @ exp_so3(since[i] * last_rate[i])
            variance[i] += LOST_SD**2
            continue
        if variance[i] < 0.0 or dt <= 0.0:
            R[i], variance[i] = told[i], STILL_SD**2 if variance[i] < 0.0 else MOVING_SD**2
        else:
            R[i] = last[i] @ exp_so3(0.5 * since[i] * (last_rate[i] + rate[i]))
            variance[i] += DRIFT**2 * since[i]
            share = min(math.sqrt(np.sum(rate[i] * rate[i])) / FULL_MOTION_RADPS, 1.0)
            sd = STILL_SD + (MOVING_SD - STILL_SD) * share
            gain = variance[i] / (variance[i] + 2.0 * CORRELATION_S / since[i] * sd * sd)
            variance[i] *= 1.0 - gain
            R[i] = exp_so3(gain * _log_so3(told[i] @ np.ascontiguousarray(R[i].T))) @ R[i]
        last[i], last_rate[i], since[i] = R[i], rate[i], 0.0


@cached(_HERE)
def _log_so3(R: Array) -> Array:
    """(3,) rotation vector, rad; for turns below π."""
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = math.sqrt(np.sum(turn * turn)), 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    return turn if sine < 1e-9 else turn * (math.atan2(sine, cosine) / sine)
