"""Scale errors of the gyros as states.

They are unobservable from one foot alone, because it rotates back in every step. They are observable from two feet that
observe each other, because these rotate at different times. Unmodelled, the error appears as a longer or shorter step
(Titterton & Weston 2004, 12.3: a scale error affects the attitude as a bias of its own size times the rate does).
"""

from __future__ import annotations

from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.algebra import rotation_matrix
from stridetwin.estimators.foot_ins.state import ATTITUDE, D_ATTITUDE, PHASE, T_LAST, TRACKING
from stridetwin.estimators.foot_to_foot.state import SCALES, Pair
from stridetwin.streams.samples import Array


@njit(**INSIDE)
def apply_gyro_scale(pair: Pair, foot: int, rate: Array, t_ns: int, max_gap_s: float) -> None:
    """Propagates the scale error into the attitude error over the interval that ends at `t_ns`: δθ -= R diag(ω) δs dt.

    See docs/foot_to_foot.md (8).

    Args:
        pair: Its covariance is changed in place.
        foot: Foot with the gyro.
        rate: (3,) rad/s, sensor frame.
        t_ns: Of the sample.
        max_gap_s: After a longer gap the foot is aligned again, and nothing is done here.
    """
    memory = pair.feet[foot]
    dt = (t_ns - memory.clock[T_LAST]) * 1e-9
    s, a = SCALES + 3 * foot, memory.row + D_ATTITUDE
    if memory.clock[PHASE] != TRACKING or not 0.0 < dt <= max_gap_s or pair.covariance[s, s] == 0.0:
        return
    D = rotation_matrix(memory.nominal[ATTITUDE : ATTITUDE + 4]) * (rate * dt)
    _turned(pair.covariance, a, s, D)
    _turned(pair.covariance.T, a, s, D)


@njit(**INSIDE)
def _turned(M: Array, a: int, s: int, D: Array) -> None:
    """Attitude rows from `a` on minus D times the scale rows from `s` on, in place."""
    for j in range(M.shape[1]):
        s0, s1, s2 = M[s, j], M[s + 1, j], M[s + 2, j]
        for i in range(3):
            M[a + i, j] -= D[i, 0] * s0 + D[i, 1] * s1 + D[i, 2] * s2
