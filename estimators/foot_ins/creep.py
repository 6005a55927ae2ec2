"""The slow motion of a shoe in stance: it rolls on, gives way and slides inside. docs/foot_ins.md (20)."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.slope import note_levelled
from stridetwin.streams.algebra.tuples import Vec3, axpy, dot, store_vec3_at, times, vec3_at
from stridetwin.streams.compiled import INNER_KERNEL

_LONGEST_STRIDE_S = 2.0  # a longer stride began with a rest
_LONGEST_S = 1.0  # of a stance in which the shoe creeps; a longer one is that of somebody who stands
_WHOLE_STRIDE_M = 0.2  # a much shorter stride hardly loads the shoe

# entries of `FilterState.creep`: position of the last stance, m; in this stance, velocity of a creep forward by the
# whole stride, m/s, and rate at which it sinks, 1/s; share of both by how quietly it stood at the last sample
PLACE, FORWARD, SINKING, SHARE = 0, 3, 5, 6


@njit(**INNER_KERNEL)
def _find_whole_creep(memory: state.FilterState, t_ns: int) -> Vec3:
    """Velocity of a shoe that creeps forward by its stride (x and y, m/s), and rate of its sinking (1/s), in stance.

    The filter knows them from the stride that led here. A foot that stands for long, or has not stepped yet, is still.

    Args:
        memory: State of the foot.
        t_ns: Time of the sample.
    """
    clock, still = memory.clock, (0.0, 0.0, 0.0)
    since_s = (t_ns - clock[state.T_STOOD]) * 1e-9  # since the foot came to stand last
    if clock[state.CONTACT_PHASE] == state.NEVER_LANDED or since_s <= 0.0:
        return still
    if clock[state.CONTACT_PHASE] == state.STANDING:
        return vec3_at(memory.creep, FORWARD) if since_s < _LONGEST_S else still
    stride = axpy(vec3_at(memory.nominal, state.POSITION), -1.0, vec3_at(memory.creep, PLACE))
    duration_s = min(since_s, _LONGEST_STRIDE_S)
    load = 1.0 - math.exp(-math.sqrt(dot(stride, stride)) / _WHOLE_STRIDE_M)
    return stride[0] / duration_s, stride[1] / duration_s, load / duration_s


@njit(**INNER_KERNEL)
def find_creep(memory: state.FilterState, parameters: KernelParameters, t_ns: int, statistic: float) -> Vec3:
    """Velocity of a shoe that creeps forward by its stride (x and y, m/s), and rate of its sinking (1/s), in stance.

    docs/foot_ins.md (20), in world axes. A foot that stands perfectly still does not creep either.

    Args:
        memory: State of the foot, changed in place.
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
        statistic: Motion statistic at the sample.
    """
    motion = (statistic / parameters.creep_level) ** 2
    memory.creep[SHARE] = motion / (1.0 + motion)
    return times(memory.creep[SHARE], _find_whole_creep(memory, t_ns))


@njit(**INNER_KERNEL)
def creep_velocity(parameters: KernelParameters, creep: Vec3) -> Vec3:
    """Velocity of the sole's stationary point, m/s, world axes, for what `find_creep` returns."""
    forward = parameters.creep_forward_share
    return forward * creep[0], forward * creep[1], -parameters.creep_down_m * creep[2]


@njit(**INNER_KERNEL)
def begin_stance(memory: state.FilterState, parameters: KernelParameters, t_ns: int) -> None:
    """Keeps the creep of a foot that has just come to stand, and the place and time from which its next stride counts.

    By the sinking of this stance, the next stride ends lower than with a shoe that is still: that may be a slope, too.

    Args:
        memory: State of the foot, changed in place. The contact phase is still that before.
        parameters: Parameters of the filter.
        t_ns: Time of the sample.
    """
    creep = _find_whole_creep(memory, t_ns)
    stride_s = min((t_ns - memory.clock[state.T_STOOD]) * 1e-9, _LONGEST_STRIDE_S)
    note_levelled(memory, parameters.creep_down_m * memory.creep[SHARE] * creep[2] * stride_s)
    store_vec3_at(creep, memory.creep, FORWARD)
    store_vec3_at(vec3_at(memory.nominal, state.POSITION), memory.creep, PLACE)
    memory.clock[state.T_STOOD] = t_ns


@njit(**INNER_KERNEL)
def shift_by_creep(memory: state.FilterState, creep: Vec3, sign: float) -> None:
    """Adds `sign` times what creep of size 1 does to the velocity of a stance, to the derivatives by the creep.

    A zero velocity is that of a shoe that creeps. Relative to such a shoe, it does not depend on the creep; so an
    update is made between -1 and 1, and the derivatives change by the gain as those of other considered errors.

    Args:
        memory: State of the foot, changed in place.
        creep: As `find_creep` returns it.
        sign: Factor.
    """
    if memory.considered < 0:
        return
    P, v = memory.covariance, memory.row + state.D_VELOCITY
    by_creep = (creep[0], creep[1], 0.0), (-creep[1], creep[0], 0.0), (0.0, 0.0, -creep[2])  # forward, left, down
    for error in range(3):
        c = memory.considered + state.CREEP_FORWARD + error
        for i in range(3):
            P[c, v + i] += sign * by_creep[error][i]
            P[v + i, c] = P[c, v + i]
