"""All that the filter remembers, as arrays of fixed size that the compiled kernel changes in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

# Nominal state (16,): position, velocity, quaternion, gyro bias, accelerometer bias.
POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCEL_BIAS = 0, 3, 6, 10, 13
# Error state (15,): true = nominal + error; that of the attitude is a rotation vector in the world,
# R_true = exp([e]x) R.
D_POSITION, D_VELOCITY, D_ATTITUDE, D_GYRO_BIAS, D_ACCEL_BIAS = 0, 3, 6, 9, 12
STATES = 15

# Clock (9,): last sample, since when the foot stands still, since when the filter aligns, last sample that it
# tracked, all in ns; head and fill of the ring; phase; is the heading known, is the lever arm.
T_LAST, T_STILL, T_ALIGN, T_KNOWN, HEAD, FILL, PHASE, HEADED, LEVERED = range(9)
IGNORED, EMPTY, ALIGNING, TRACKING = -1, 0, 1, 2

RING = 64  # samples that the statistic can look back on; 35 ms at 1.8 kHz


class Memory(NamedTuple):
    """Everything the filter remembers.

    Attributes:
        nominal: (16,) position m, velocity m/s, quaternion world <- sensor, gyro bias rad/s, accelerometer
            bias m/s².
        covariance: (15, 15) of the error state.
        clock: (9,) int64, see the constants above.
        ring_t_ns: (RING,) times of the last samples.
        ring: (RING, 6) their angular rate and specific force.
        force_sum: (2, 4) sum and count of the specific force since the foot stands still, and since the
            filter aligns.
        lever: (3,) from the sensor to the point that stands still, sensor frame, m.
        peak: (1,) peak of the motion statistic, slowly forgotten.
        extreme: (6,) largest magnitude of each channel so far.
    """

    nominal: Array
    covariance: Array
    clock: NDArray[np.int64]
    ring_t_ns: NDArray[np.int64]
    ring: Array
    force_sum: Array
    lever: Array
    peak: Array
    extreme: Array


def blank() -> Memory:
    """Memory of a filter that has seen no sample and stands at the origin."""
    nominal = np.zeros(16)
    nominal[ATTITUDE] = 1.0
    return Memory(
        nominal=nominal,
        covariance=np.zeros((STATES, STATES)),
        clock=np.zeros(9, np.int64),
        ring_t_ns=np.zeros(RING, np.int64),
        ring=np.zeros((RING, 6)),
        force_sum=np.zeros((2, 4)),
        lever=np.zeros(3),
        peak=np.zeros(1),
        extreme=np.zeros(6),
    )
