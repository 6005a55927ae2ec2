"""A look back: head and chest turn over the shoulder, stay there, and return.

The head turns on the pelvis by at most 85°, of which the chest takes 0.27: 62° are left for the neck and 23° for the
trunk, less than what people reach (neck 70° to a side at 30 years, 60° at 70: Youdas et al. 1992, Phys Ther 72:770-780;
thoracolumbar spine 35-40°: Gregersen & Lucas 1967, J Bone Joint Surg Am 49:247-262). The eyes do the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stridetwin.sim.acts import LookBack
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

CHEST_SHARE = 0.27
"""Of the head's turn."""

# Chosen by hand.
_MOVE_S, _MOVE_S_PER_RAD = 0.30, 0.32  # time in which the head turns, and more for a larger turn
_CHEST_LONGER = 1.35  # time of the chest's turn, relative to the head's
_DELAY_S = 0.15  # from the touch-down to the first movement
_APART_S = 0.2  # at least, between two looks


def looking_time(act: LookBack) -> float:
    """Time from the touch-down until the head is back, s."""
    return _DELAY_S + act.for_s + 2.0 * _CHEST_LONGER * _move_s(act)


def turn_back(looks: Sequence[tuple[float, LookBack]], t: Array) -> tuple[Array, Array, Array]:
    """Rotations of looks back.

    Args:
        looks: Each with the time of the touch-down at which it begins, s; in order of time.
        t: (N,) s.

    Returns:
        (N,) rad, yaw of the head and of the chest, left positive; (N,) share of looking back, 0-1, which replaces the
        usual gaze.

    Raises:
        ConfigError: A look begins before the one before it is over.
    """
    head, chest, share = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    over = -np.inf
    for t_touch, act in looks:
        if t_touch < over:
            raise ConfigError("gait", "acts.at_m", act.at_m, "a place where the look back before it is over")
        over = t_touch + looking_time(act) + _APART_S
        move = _move_s(act)
        begin = t_touch + _DELAY_S
        end = begin + move + act.for_s
        angle = act.head_rad * (1.0 if act.to == "left" else -1.0)
        looking = ease((t - begin) / move) - ease((t - end) / move)
        slower = _CHEST_LONGER * move
        head += angle * looking
        share += looking
        chest += CHEST_SHARE * angle * (ease((t - begin) / slower) - ease((t - end) / slower))
    return head, chest, share


def _move_s(act: LookBack) -> float:
    """Time in which the head turns, s."""
    return _MOVE_S + _MOVE_S_PER_RAD * act.head_rad
