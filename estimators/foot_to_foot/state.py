"""State of the filter of two feet: two one-foot memories over one covariance, and the mounts of cameras and boards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins.kalman import MEASUREMENTS, Workspace, workspace
from stridetwin.estimators.foot_ins.stance import inject
from stridetwin.estimators.foot_ins.state import CONSIDERED, SERIES_RAD, STATES, FilterState, initial_state
from stridetwin.streams.algebra.matrices import clear
from stridetwin.streams.algebra.tuples import exp, multiply, normalized, quaternion_at, store_quaternion_at, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

FEET = ("l", "r")

# Error state (74,): 21 of the left foot, 21 of the right, then 6 of each mount: camera left, camera right, board left,
# board right, then the clocks of camera left and right, then 3 of each gyro's scale. A mount's error is position (m),
# rotation vector (rad), both in the axes of its foot's IMU: R_true = exp([e]x) R. A clock's is the offset to add to
# image times, s; a scale's, the relative error by which a gyro's axis reads too much.
MOUNTS = 2 * STATES
CAMERA, BOARD = 0, 2  # first mount of a kind; the right foot's follows
CLOCKS = MOUNTS + 4 * 6
SCALES = CLOCKS + 2
ALL_STATES = SCALES + 2 * 3

NEVER = -(2**62)  # ns, a time before all samples
OBSERVATIONS, ECHOES = 0, 1  # rows of what is known of their innovations


class BoardWorkspace(NamedTuple):
    """Arrays of the measurement of one image, which is reduced to the pose of the board.

    Attributes:
        covariance: (6, 6) of the predicted pose, position (m) and rotation vector (rad), camera axes.
        triangle: (7, 7) R of the QR decomposition of the rays' derivatives by the pose, and innovations.
        row: (7,) that is added to the triangle.
        moved: (2, 6) estimated minus predicted pose; and its last change.
        reduced: Workspace of the measurement of the pose.
    """

    covariance: Array
    triangle: Array
    row: Array
    moved: Array
    reduced: Workspace


def board_workspace() -> BoardWorkspace:
    """An empty workspace for one image at a time."""
    m = MEASUREMENTS
    return BoardWorkspace(
        covariance=np.zeros((m, m)),
        triangle=np.zeros((m + 1, m + 1)),
        row=np.zeros(m + 1),
        moved=np.zeros((2, m)),
        reduced=workspace(m, m),
    )


class Pair(NamedTuple):
    """State of the filter of both feet.

    Attributes:
        feet: Left and right; their covariance and error are views of the two below.
        covariance: (80, 80) of the errors of all states; behind them, six rows of what the considered errors have done
            (`foot_ins.considered`): one and the same creep of both shoes.
        error: (80,) found by updates, but not yet moved into the nominal states.
        mounts: (4, 7) position (m) and quaternion of camera left, camera right, board left, board right, each in its
            foot's IMU.
        late: (2,) offset to add to the times of each camera's images, s.
        scales: (2, 3) relative error by which each axis of a foot's gyro reads too much.
        sonars: (2, 3) each foot's sonar, in its IMU, m; it is taken for the point that reflects the other's.
        earth: (3,) rotation rate of the Earth in world axes, rad/s.
        seen: (2,) int64, time of the newest observation used of each camera, ns.
        heard: (2,) int64, time of the newest echo used of each sonar, ns.
        nis: (2, 2) of observations and of echoes: sum of the normalised innovation squared, per degree of freedom; and
            number of updates.
        work: Workspace of one update of all states.
        board: Workspace of one image.
    """

    feet: tuple[FilterState, FilterState]
    covariance: Array
    error: Array
    mounts: Array
    late: Array
    scales: Array
    sonars: Array
    earth: Array
    seen: NDArray[np.int64]
    heard: NDArray[np.int64]
    nis: Array
    work: Workspace
    board: BoardWorkspace


def blank_pair(
    mounts: Array, mount_variance: Array, clock_variance: float, scale_variance: float, sonars: Array, earth: Array
) -> Pair:
    """State of two feet without samples.

    Args:
        mounts: (4, 7) position (m) and quaternion of camera left, camera right, board left, board right, each in its
            foot's IMU.
        mount_variance: (4, 6) m² and rad², variances of position and rotation of each mount.
        clock_variance: Variance of the offset of each camera's clock, s².
        scale_variance: Variance of the relative scale error of each gyro axis.
        sonars: (2, 3) each foot's sonar in its IMU, m.
        earth: (3,) rotation rate of the Earth in world axes, rad/s.
    """
    n = ALL_STATES + CONSIDERED  # rows: behind the states, those of the errors that are considered of both feet
    covariance, error = np.zeros((n, n)), np.zeros(n)
    # the states after the feet's, which have variance 0 until they align: mounts, clocks, scales
    i = np.arange(MOUNTS, ALL_STATES)
    covariance[i, i] = np.r_[mount_variance.ravel(), [clock_variance] * 2, [scale_variance] * 6]
    left, right = (initial_state(covariance, error, f * STATES, considered=ALL_STATES) for f in range(2))
    return Pair(
        feet=(left, right),
        covariance=covariance,
        error=error,
        mounts=np.array(mounts, dtype=float),
        late=np.zeros(2),
        scales=np.zeros((2, 3)),
        sonars=np.array(sonars, dtype=float),
        earth=np.array(earth, dtype=float),
        seen=np.full(2, NEVER),
        heard=np.full(2, NEVER),
        nis=np.zeros((2, 2)),
        work=workspace(n, ALL_STATES),
        board=board_workspace(),
    )


@njit(**INNER_KERNEL)
def inject_all(pair: Pair) -> None:
    """Adds the error found so far to the nominal state of feet, mounts, clocks and scales, and sets it to 0, in place.

    A row of `pair.mounts` is position (entries 0-2, m) and quaternion (3-6); its six errors are position and rotation.
    """
    for foot in range(2):
        inject(pair.feet[foot])
    error = pair.error
    for i in range(4):  # camera left, camera right, board left, board right; o: first of the mount's six errors
        mount, o = pair.mounts[i], MOUNTS + 6 * i
        for k in range(3):
            mount[k] += error[o + k]
        rotation = exp(vec3_at(error, o + 3), SERIES_RAD)
        store_quaternion_at(normalized(multiply(rotation, quaternion_at(mount, 3))), mount, 3)
    for foot in range(2):
        pair.late[foot] += error[CLOCKS + foot]
        for k in range(3):
            pair.scales[foot, k] += error[SCALES + 3 * foot + k]
    clear(error)


class Events(NamedTuple):
    """Samples of every kind in the order in which the filter takes them.

    Attributes:
        kind: (N,) int8, IMU, OBSERVATION, RELATIVE or RANGE.
        t_ns: (N,) int64, times.
        foot: (N,) int8; of an aid, the foot that carries the camera or the sonar.
        row: (N,) int64 of the event in the arrays of its kind.
        rate: (I, 3) rad/s, angular rate of each IMU sample.
        force: (I, 3) m/s², specific force of each.
        points: (S, M, 3) board points of each observation, board frame, m; only the first `numbers` are valid.
        rays: (S, M, 2) normalised image coordinates of the points.
        numbers: (S,) int64, how many points each observation has.
        ray_sd: (S, M) standard deviation of each coordinate of a ray.
        relative: (L, 3) position of the other foot's IMU in this foot's, m.
        relative_sd: (L,) standard deviation on each axis, m.
        distance: (D,) m, distance of each echo.
    """

    kind: NDArray[np.int8]
    t_ns: NDArray[np.int64]
    foot: NDArray[np.int8]
    row: NDArray[np.int64]
    rate: Array
    force: Array
    points: Array
    rays: Array
    numbers: NDArray[np.int64]
    ray_sd: Array
    relative: Array
    relative_sd: Array
    distance: Array


IMU, OBSERVATION, RELATIVE, RANGE = range(4)
