"""Differences between the swings of one person, and between people.

No two swings of a person are alike: the push-off, the height of the foot, the pitch of the landing and its speed vary
from stride to stride, and their means from person to person.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stridetwin.sim.config import Gait
from stridetwin.sim.gait.footsteps import CLEARANCE_M, Footstep, SwingVariation

# Standard deviations between the strides of a person whose steps vary as usual, and between people. Those of strides
# are chosen for the SD of toe clearance (2-4 mm) and heel height (4-5 mm) and the CV of the angular rates (4-5 %) of
# `dual_foot_walk` (`benchmarks.people_feet`).
_USUAL_STEP_SD = 0.015  # `Gait.step_sd` of such a person
_MAX_SCALE = 2.0  # of people whose steps vary more
_STRIDE_PUSH, _STRIDE_TOES_RAD, _STRIDE_LIFT_M, _STRIDE_CLEARANCE_M, _STRIDE_LANDING = 0.040, 0.015, 0.003, 0.0025, 0.12
_PERSON_PUSH, _PERSON_TOES_RAD, _PERSON_LIFT_M, _PERSON_LANDING = 0.015, 0.010, 0.002, 0.10
_BEND_BY_PUSH_RAD = 0.5  # more bend of the toes before toe-off, per relative strength of the push
_LIMIT = 2.0  # of each deviation, in standard deviations
_MIN_CLEARANCE = 0.5  # of the usual clearance
_SHARED = 0.3  # of the landing's speed in its logarithm: a hard push-off lands harder


def set_down_softly(steps: Sequence[Footstep]) -> list[Footstep]:
    """The footsteps with heels that come to rest before they touch the ground, and toes flat on it until they leave.

    Use it for a walk that is simulated: the simulated body has rigid legs, on which a landing at a person's speed is a
    blow of several body weights, and its feet reach their speed of landing themselves; on the edge of a tip it would
    slip.
    """
    return [replace(step, swing=replace(step.swing, landing=0.0), flat_toes=True) for step in steps]


def vary_swings(steps: Sequence[Footstep], gait: Gait, rng: np.random.Generator) -> list[Footstep]:
    """The footsteps with swings that differ from each other; places and times stay the same.

    Args:
        steps: Footsteps of both feet.
        gait: Gait of the person; swings vary in proportion to its `step_sd`.
        rng: Draws the person, then each swing.
    """
    scale = min(gait.step_sd / _USUAL_STEP_SD, _MAX_SCALE)
    # (4,) deviations of the person and (K, 5) of the strides, in standard deviations
    person = np.clip(rng.standard_normal(4), -_LIMIT, _LIMIT)
    strides = scale * np.clip(rng.standard_normal((len(steps), 5)), -_LIMIT, _LIMIT)
    varied = []
    for step, (push, toes, lift, clearance, landing) in zip(steps, strides.tolist()):
        low = step.clearance_m / CLEARANCE_M  # how low this person's feet swing, relative to others
        speed = _STRIDE_LANDING * (np.sqrt(1.0 - _SHARED**2) * landing + _SHARED * push) + _PERSON_LANDING * person[3]
        swing = SwingVariation(
            push=1.0 + _STRIDE_PUSH * push + _PERSON_PUSH * float(person[0]),
            toes_rad=_STRIDE_TOES_RAD * toes + _PERSON_TOES_RAD * float(person[1]),
            lift_m=low * (_STRIDE_LIFT_M * lift + _PERSON_LIFT_M * float(person[2])),
            landing=float(np.exp(speed)),
        )
        higher = max(1.0 + _STRIDE_CLEARANCE_M / CLEARANCE_M * clearance, _MIN_CLEARANCE)
        varied.append(replace(step, swing=swing, clearance_m=higher * step.clearance_m))
    following: dict[str, Footstep] = {}  # next step of each foot
    for i in reversed(range(len(varied))):  # who pushes harder bends the toes farther before they roll over their tip
        step = varied[i]
        if step.foot in following:
            push = following[step.foot].swing.push
            varied[i] = replace(step, toes_bend_rad=_BEND_BY_PUSH_RAD * (push - 1.0))
        following[step.foot] = step
    return varied
