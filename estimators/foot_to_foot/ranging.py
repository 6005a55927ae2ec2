"""Sonar update: the distance between the two shoes."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import D_ATTITUDE, D_POSITION, STATES
from stridetwin.estimators.foot_ins.strapdown import correct
from stridetwin.estimators.foot_ins.zero_velocity import normalized_innovation
from stridetwin.estimators.foot_to_foot.parameters import PairParameters
from stridetwin.estimators.foot_to_foot.rewind import cross, rewind
from stridetwin.estimators.foot_to_foot.state import ALL_STATES, ECHOES, Pair, inject_all
from stridetwin.estimators.foot_to_foot.vision import UNUSED


@njit(**INSIDE)
def sonar_update(
    pair: Pair, foot: KernelParameters, parameters: PairParameters, sonar: int, t_ns: int, distance: float
) -> float:
    """Update with the distance between the two IMUs from a sonar's echo.

    See docs/foot_to_foot.md (9).

    The published system uses the positions alone. Here the attitudes at both ends enter too, and the sonar is used only
    if the other shoe has not been observed for `sonar_after_s`: an echo comes from some part of it, always with the
    same sign, so all within `observation_correlation_s` share one error. Most echoes of a real walk are from the floor
    or from things beyond: those too far from the predicted distance are rejected.

    Args:
        pair: Changed in place.
        foot: Parameters of the foot with the sonar.
        parameters: Parameters of both feet.
        sonar: Foot that carries the sonar.
        t_ns: Time of the echo.
        distance: m, from the sonar to the reflecting point of the other foot.

    Returns:
        Length of the innovation in standard deviations, or UNUSED.
    """
    if not parameters.published and (t_ns - pair.seen.max()) * 1e-9 < parameters.sonar_after_s:
        return UNUSED
    other = 1 - sonar
    a = rewind(pair.feet[sonar], foot.gravity_mps2, t_ns, parameters.max_delay_s)
    b = rewind(pair.feet[other], foot.gravity_mps2, t_ns, parameters.max_delay_s)
    arm_a, arm_b = a.R @ pair.sonars[sonar], b.R @ pair.echoes[other]
    d = b.p + arm_b - a.p - arm_a
    size = math.sqrt(d @ d)
    if not (a.known and b.known and size > 0.0):
        return UNUSED
    to = np.ascontiguousarray((d / (size * parameters.range_sd_m)).reshape(1, 3))
    H = np.zeros((1, ALL_STATES))
    of_a, of_b = STATES * sonar, STATES * other
    H[:, of_a + D_POSITION : of_a + D_POSITION + 3] = -to
    H[:, of_b + D_POSITION : of_b + D_POSITION + 3] = to
    if not parameters.published:
        H[:, of_a + D_ATTITUDE : of_a + D_ATTITUDE + 3] = cross(to, arm_a)
        H[:, of_b + D_ATTITUDE : of_b + D_ATTITUDE + 3] = -cross(to, arm_b)
    z = np.array([(distance - size) / parameters.range_sd_m])
    length = normalized_innovation(pair.covariance, H, z)
    if parameters.published:
        used, inflation = abs(distance - size) < parameters.max_range_misfit_m, 1.0
    else:
        echo_s = min(max((t_ns - pair.heard[sonar]) * 1e-9, 1e-3), parameters.observation_correlation_s)
        used, inflation = length < parameters.range_gate, math.sqrt(parameters.observation_correlation_s / echo_s)
    if not used:
        return UNUSED
    pair.heard[sonar] = t_ns
    pair.nis[ECHOES, 0] += length**2
    pair.nis[ECHOES, 1] += 1.0
    correct(pair.covariance, pair.error, 0, H[0] / inflation, z[0] / inflation, 1.0)
    inject_all(pair)
    return length
