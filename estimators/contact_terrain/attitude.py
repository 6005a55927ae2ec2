"""Attitudes of five frames from their AHRS and their gyros' rates.

The tilt error of an AHRS is correlated and grows with motion; its integrated gyro has hardly any error within a step.
The rates therefore propagate each attitude, and the AHRS corrects it slowly: a Kalman filter with one variance per
frame, in which an AHRS sample has a white error of the same power (2 τ σ² / dt).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, AttitudeNoise
from stridetwin.estimators.contact_terrain.ticks import Tick, exp_so3
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent


class _State(NamedTuple):
    """State that compiled code modifies in place: all but R at the last fresh sample, and the time since then."""

    R: Array
    last: Array
    variance: Array
    rate: Array
    since: Array


class Attitudes:
    """Attitudes of back, thighs and feet.

    Args:
        noise: Noise model.

    Attributes:
        R: (5, 3, 3) frame to world.
    """

    def __init__(self, noise: AttitudeNoise = DEFAULTS.attitudes) -> None:
        self._noise, self.R = noise, np.tile(np.eye(3), (5, 1, 1))
        self._state = _State(self.R, self.R.copy(), np.full(5, -1.0), np.zeros((5, 3)), np.zeros(5))

    def update(self, tick: Tick) -> None:
        """Takes a tick; at the start and after a gap, the attitudes are those of the AHRS.

        See docs/contact_terrain.md (6).
        """
        measured = np.concatenate((tick.R_world_base[None], tick.R_world_thigh, tick.R_world_foot))
        _fuse(self._state, self._noise, measured, tick.rate, tick.fresh, tick.dt)


@cached(_HERE)
def _fuse(state: _State, noise: AttitudeNoise, measured: Array, rate: Array, fresh: Array, dt: float) -> None:
    R, last, variance, last_rate, since = state
    for i in range(len(R)):
        since[i] += dt
        if not fresh[i] and variance[i] >= 0.0 and dt > 0.0:
            R[i] = last[i] @ exp_so3(since[i] * last_rate[i])
            variance[i] += noise.lost_sd_rad**2
            continue
        if variance[i] < 0.0 or dt <= 0.0:
            R[i], variance[i] = measured[i], noise.still_sd_rad**2 if variance[i] < 0.0 else noise.moving_sd_rad**2
        else:
            R[i] = last[i] @ exp_so3(0.5 * since[i] * (last_rate[i] + rate[i]))
            variance[i] += noise.drift_rad_per_sqrt_s**2 * since[i]
            share = min(math.sqrt(np.sum(rate[i] * rate[i])) / noise.full_motion_radps, 1.0)
            sd = noise.still_sd_rad + (noise.moving_sd_rad - noise.still_sd_rad) * share
            gain = variance[i] / (variance[i] + 2.0 * noise.correlation_s / since[i] * sd * sd)
            variance[i] *= 1.0 - gain
            R[i] = exp_so3(gain * _log_so3(measured[i] @ np.ascontiguousarray(R[i].T))) @ R[i]
        last[i], last_rate[i], since[i] = R[i], rate[i], 0.0


@cached(_HERE)
def _log_so3(R: Array) -> Array:
    """(3,) rotation vector, rad; for rotations below π."""
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = math.sqrt(np.sum(turn * turn)), 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    return turn if sine < 1e-9 else turn * (math.atan2(sine, cosine) / sine)
