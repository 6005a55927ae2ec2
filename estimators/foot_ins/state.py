"""State of the filter of one foot, as arrays of fixed size that the compiled kernel changes in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins.kalman import Workspace, workspace
from stridetwin.streams.algebra.tuples import Vec3
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

# Nominal state (22,): position, velocity, quaternion, gyro bias, accelerometer bias, displacement of the stationary
# point of the sole from the end of the lever arm (sensor frame), height of the floor, height drift per metre of path,
# share by which the gyro reads too much across the sole's normal.
POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCEL_BIAS, CONTACT, FLOOR, DRIFT, SCALE = 0, 3, 6, 10, 13, 16, 19, 20, 21
NOMINAL = 22
# Error state (21,): true = nominal + error; that of the attitude is a rotation vector in the world,
# R_true = exp([e]x) R. The others are in the order of the nominal state.
D_POSITION, D_VELOCITY, D_ATTITUDE, D_GYRO_BIAS, D_ACCEL_BIAS, D_CONTACT, D_FLOOR, D_DRIFT = 0, 3, 6, 9, 12, 15, 18, 19
D_SCALE = 20
STATES = 21
REPORTED = 15  # number of them in an estimate

# Clock (14,): last sample, start of the stationary period, start of the alignment, last tracked sample, last sample
# not surely stationary, all in ns; head and fill of the ring; phase; whether the heading is known; whether the lever
# arm is; whether the foot has landed; samples since the beginning of the peak restored with the last sample; when the
# foot came to stand last, in ns.
(
    T_LAST,
    T_STATIONARY,
    T_ALIGN,
    T_KNOWN,
    T_LAST_MOTION,
    T_STANCE,
    HEAD,
    FILL,
    PHASE,
    HEADING_KNOWN,
    LEVER_KNOWN,
    CONTACT_PHASE,
    RESTORED,
    T_STOOD,
) = range(14)
CLOCKS = 14
IGNORED, EMPTY, ALIGNING, NAVIGATING = -1, 0, 1, 2
NEVER_LANDED, SWINGING, STANDING = 0, 1, 2

BY_VELOCITY, BY_FLOOR, BY_RATE = range(3)  # rows of `nis`

START_POSITION_SD = 1e-4  # m; the start defines the world's origin
START_HEADING_SD = 1e-3  # rad; and its heading

SERIES_RAD = 1e-4  # angle below which `exp` uses its series

FILLED = 5  # entries of `filled`
REST = 21  # entries of `rest`
SCALE_ACROSS, SCALE_ALONG, DELAY, CREEP_FORWARD, CREEP_LEFT, CREEP_DOWN = range(6)  # considered errors
CONSIDERED = 6
LEVELLED = 7  # entries of `levelled`
CREEP = 7  # entries of `creep`
STRAIGHT = 23  # entries of `straight`
ALONE = STATES + CONSIDERED  # rows of the covariance of a foot alone
UNLEARNT_VARIANCE, UNLEARNT_TURN, UNLEARNT_POSITION, UNLEARNT_HEIGHT = 0, 1, 2, 5  # entries of `unlearnt`
RING = 64  # samples available to the statistic; 35 ms at 1.8 kHz


class FilterState(NamedTuple):
    """State of the filter of one foot; covariance and error may belong to a larger filter.

    Attributes:
        nominal: (22,) position m, velocity m/s, quaternion world <- sensor, gyro bias rad/s, accelerometer bias m/s²,
            displacement of the contact m, height of the floor m, height drift per metre of path, scale error of the
            gyro.
        covariance: (n, n) of the filter's error state.
        error: (n,) found by updates, but not yet moved into the nominal state.
        row: First of the 21 rows of `covariance` and `error` that are this foot's.
        tilted: (4,) quaternion at the beginning of an alignment.
        start_sd: (2,) standard deviation of the position (m) and of the heading (rad) at the first sample.
        clock: (14,) int64, entries `T_LAST` to `T_STOOD`: times in ns, counts and phases.
        ring_t_ns: (RING,) times of the last samples.
        ring: (RING, 6) rad/s and m/s², angular rate and specific force of the last samples.
        restored: (RING, 10) correction by the last restored peak of position (m), velocity (m/s) and attitude
            (quaternion, world) after each sample, the newest first; rows up to `clock[RESTORED]` are valid.
        force_sum: (2, 4) sum and count of the specific force since the foot has been stationary, and since the
            alignment began.
        lever: (3,) from the sensor to the stationary point, sensor frame, m.
        peak: (1,) slowly decaying peak of the motion statistic.
        norm: (1,) size of the specific force at rest, m/s²; 0 until the alignment.
        floor: (3,) of the steps so far: probability that the last one stayed on its floor; sum of these; sum of the
            squared height differences of the floor, m².
        path: (4,) position of the first sample, m; unknown share of the length of the way from there.
        extreme: (6,) largest magnitude of each channel so far.
        nis: (3, 2) over all updates of a kind (zero velocity, floor, zero rate): sum of the normalised innovation
            squared, per degree of freedom; and their number.
        hidden: (RING, 6) of a peak that is being restored: what was clipped of each sample, the newest first.
        rest: (21,) of the foot's rest, entries in module `rest`: sums over blocks, and what they told of the bias.
        unlearnt: (6,) of errors that are no states: variance of the gyro's bias that no rest has decided on yet,
            (rad/s)²; what a bias of 1 rad/s about the vertical has done so far to the heading, rad, and to the
            position, m (in the plane: entries 2 and 3); variance of the height of a stance, m².
        considered: First of the rows of `covariance` that hold the derivative of every error by each error that is
            considered, but not estimated (module `considered`); -1: there are none.
        considered_sd: (6,) standard deviations of these: scale of the gyro across and along the sole's normal; time by
            which one channel is late, s; creep of a shoe forward and left, as shares of a stride, and down, m.
        levelled: (7,) of heights that a level floor or the drift took away, entries in module `slope`.
        creep: (7,) position of the last stance, m, and how the shoe creeps in this one, entries in module `creep`.
        straight: (23,) of the straight way so far, entries in module `straight`.
        start_s: (1,) time of the first sample, s.
        prior: (7, 7) covariance of gyro bias, accelerometer bias and gyro scale from an earlier recording; 0: none.
        filled: (5,) length (s) and added variance of the line that the rates are on, and the forces; 1 if there was any
            since the last stance.
        work: Workspace of one update of the 21 states.
    """

    nominal: Array
    covariance: Array
    error: Array
    row: int
    tilted: Array
    start_sd: Array
    clock: NDArray[np.int64]
    ring_t_ns: NDArray[np.int64]
    ring: Array
    restored: Array
    force_sum: Array
    lever: Array
    peak: Array
    norm: Array
    floor: Array
    path: Array
    extreme: Array
    nis: Array
    hidden: Array
    rest: Array
    unlearnt: Array
    considered: int
    considered_sd: Array
    levelled: Array
    creep: Array
    straight: Array
    start_s: Array
    prior: Array
    filled: Array
    work: Workspace


def initial_state(
    covariance: Array | None = None, error: Array | None = None, row: int = 0, considered: int = -1
) -> FilterState:
    """State of a foot at the origin without samples: every entry is 0 but for the attitude, the start and the floor.

    Args:
        covariance: (n, n) of the filter that the foot belongs to; None: a filter of this foot alone.
        error: (n,) of that filter.
        row: First of the foot's 21 rows in them.
        considered: First of the rows in `covariance` for considered errors; -1: none. A filter of this foot alone has
            them behind its own.
    """
    nominal = np.zeros(NOMINAL)
    nominal[ATTITUDE] = 1.0
    if covariance is None:
        covariance, error, considered = np.zeros((ALONE, ALONE)), np.zeros(ALONE), STATES
    return FilterState(
        nominal=nominal,
        covariance=covariance,
        error=np.zeros(len(covariance)) if error is None else error,
        row=row,
        tilted=nominal[ATTITUDE : ATTITUDE + 4].copy(),
        start_sd=np.array([START_POSITION_SD, START_HEADING_SD]),
        clock=np.zeros(CLOCKS, np.int64),
        ring_t_ns=np.zeros(RING, np.int64),
        ring=np.zeros((RING, 6)),
        restored=np.zeros((RING, 10)),
        force_sum=np.zeros((2, 4)),
        lever=np.zeros(3),
        peak=np.zeros(1),
        norm=np.zeros(1),
        floor=np.array([1.0, 0.0, 0.0]),
        path=np.zeros(4),
        extreme=np.zeros(6),
        nis=np.zeros((3, 2)),
        hidden=np.zeros((RING, 6)),
        rest=np.zeros(REST),
        unlearnt=np.zeros(6),
        considered=considered,
        considered_sd=np.zeros(CONSIDERED),
        levelled=np.zeros(LEVELLED),
        creep=np.zeros(CREEP),
        straight=np.zeros(STRAIGHT),
        start_s=np.zeros(1),
        prior=np.zeros((7, 7)),
        filled=np.zeros(FILLED),
        work=workspace(len(covariance), STATES),
    )


@njit(**INNER_KERNEL)
def ring_row(memory: FilterState, back: int) -> int:
    """Row of the ring's sample that is `back` samples older than the newest."""
    return (memory.clock[HEAD] - back) % RING


@njit(**INNER_KERNEL)
def rate_of(memory: FilterState, row: int) -> Vec3:
    """Angular rate of the ring's row, rad/s."""
    return memory.ring[row, 0], memory.ring[row, 1], memory.ring[row, 2]


@njit(**INNER_KERNEL)
def force_of(memory: FilterState, row: int) -> Vec3:
    """Specific force of the ring's row, m/s²."""
    return memory.ring[row, 3], memory.ring[row, 4], memory.ring[row, 5]
