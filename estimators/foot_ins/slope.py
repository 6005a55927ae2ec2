"""Gentle slopes, which one foot takes for its own drift: docs/foot_ins.md, "Gentle slopes"."""

from __future__ import annotations

import math

from numba import njit

from stridetwin.estimators.foot_ins import state
from stridetwin.streams.algebra.matrices import clear
from stridetwin.streams.compiled import INNER_KERNEL

_WINDOW_M = 40.0  # way over which the grade is the mean
_SLOPE_SHARE = 0.25  # probability that the ground is a gentle slope
_SLOPE_SD = 0.03  # its grade
_DRIFT_SD = 0.0125  # height that a foot drifts per metre [real walks: 1.26 % RMS]
_UNEVEN_M2_PER_M = 1e-4  # variance that uneven ground adds to a rise, per metre of way

# entries of `FilterState.levelled`: rise taken for drift since the last step, and over the window, m; way over the
# window, m; rise before the window that may have been a slope, m; position of the last step, m (two entries); standard
# deviation of the height by what may have been a slope, m
STEP, RISE, WAY, EARLIER, PLACE, HEIGHT_SD = 0, 1, 2, 3, 4, 6


@njit(**INNER_KERNEL)
def note_levelled(memory: state.FilterState, rise: float) -> None:
    """Notes a rise (m) that the filter took for an error, by a level floor or as drift per metre."""
    memory.levelled[STEP] += rise


@njit(**INNER_KERNEL)
def finish_levelled_step(memory: state.FilterState, is_first: bool) -> None:
    """Takes the rise of one step, and its way, into the sums over the window.

    Args:
        memory: State of the foot, changed in place.
        is_first: Whether the foot stands for the first time after an alignment.
    """
    levelled, x = memory.levelled, memory.nominal
    if is_first:
        earlier = levelled[EARLIER] + math.sqrt(_slope_probability(memory)) * levelled[RISE]
        clear(levelled)
        levelled[EARLIER] = earlier
    else:
        way = math.hypot(x[state.POSITION] - levelled[PLACE], x[state.POSITION + 1] - levelled[PLACE + 1])
        left = math.exp(-way / _WINDOW_M)  # share of the sums that stays in the window
        levelled[EARLIER] += math.sqrt(_slope_probability(memory)) * (1.0 - left) * levelled[RISE]
        levelled[RISE] = left * levelled[RISE] + levelled[STEP]
        levelled[WAY] = left * levelled[WAY] + way
        levelled[STEP] = 0.0
    levelled[PLACE], levelled[PLACE + 1] = x[state.POSITION], x[state.POSITION + 1]
    # the mixture of slope and drift has the height's error `rise` with the probability p: its mean square is p rise²
    levelled[HEIGHT_SD] = abs(levelled[EARLIER] + math.sqrt(_slope_probability(memory)) * levelled[RISE])


@njit(**INNER_KERNEL)
def _slope_probability(memory: state.FilterState) -> float:
    """Probability that what was levelled within the window is a slope, by Bayes' rule.

    The grade, rise by way, is that of a slope with the standard deviation `_SLOPE_SD`, or a drift with `_DRIFT_SD`.
    """
    rise, way = memory.levelled[RISE], memory.levelled[WAY]
    if way <= 0.0:
        return 0.0
    grade2, uneven2 = (rise / way) ** 2, _UNEVEN_M2_PER_M / way
    drift2, slope2 = _DRIFT_SD**2 + uneven2, _DRIFT_SD**2 + _SLOPE_SD**2 + uneven2
    odds = math.sqrt(drift2 / slope2) * math.exp(0.5 * grade2 * (1.0 / drift2 - 1.0 / slope2))
    return odds * _SLOPE_SHARE / (odds * _SLOPE_SHARE + 1.0 - _SLOPE_SHARE)
