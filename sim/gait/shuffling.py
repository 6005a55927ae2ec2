"""A shuffle in place: small steps of both feet on the spot, as of people who wait."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stridetwin.sim.acts import ShuffleInPlace
from stridetwin.sim.gait.foot_placement import Foothold

# Chosen by hand.
_STEP_S = 0.60  # time of one step, on average
_STEP_LOG_SD = 0.08  # SD of its logarithm
_ALONG_SD_M, _ASIDE_SD_M, _YAW_SD_RAD = 0.022, 0.006, np.radians(4.0)  # of the places of the feet
_LIMIT = 1.5  # of each deviation, in standard deviations


def place_shuffling_steps(act: ShuffleInPlace, hold: Foothold, rng: np.random.Generator) -> list[Foothold]:
    """Footholds of small steps near the foothold `hold`, the last two beside each other where the walker stood before.

    Args:
        act: The act.
        hold: Foothold before it.
        rng: Draws times and places of the steps.
    """
    feet = [hold.other_foot, hold.foot]
    count = 2 * max(round(act.for_s / _STEP_S / 2), 1)
    steps = []
    for i in range(count):
        along, aside, yaw, time = np.clip(rng.standard_normal(4), -_LIMIT, _LIMIT).tolist()
        wanders = float(i < count - 2)
        steps.append(
            replace(
                hold,
                foot=feet[i % 2],
                s=hold.s + wanders * _ALONG_SD_M * along,
                left_m=hold.left_m + wanders * _ASIDE_SD_M * aside,
                yaw_rad=wanders * _YAW_SD_RAD * yaw,
                manner="place",
                time_s=_STEP_S * float(np.exp(_STEP_LOG_SD * time)),
                act=None,
                pause_s=0.0,
            )
        )
    return steps
