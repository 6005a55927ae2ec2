"""Pitch of everybody's feet over a stride, and stride times on stairs.

From kinematic twin walks of seeds 0 to 99: people of 1.52 to 1.93 m, 0.5 to 1.9 m/s, level ground, turns, stairs and
ramps. `python -m tools.fit_gait_phase` fits them again; it differs in the last digit of some values.
"""

from __future__ import annotations

import numpy as np

LANDINGS = 3
"""Kinds of landing that end a stride: on level ground or a ramp, on a stair upwards, on a stair downwards."""
LEVEL, UP, DOWN = range(LANDINGS)
BINS = 40
_MEANS = (
    "4.1 2.2 0.4 -0.2 -0.2 -0.1 -0.0 0.0 0.0 0.0 0.0 0.1 0.1 0.2 0.3 0.5 0.6 0.8 1.1 1.4 "
    "2.1 3.3 4.9 6.3 7.0 5.9 2.0 -1.8 -4.0 -5.0 -6.0 -6.8 -6.7 -5.5 -3.7 -2.8 -3.6 -3.6 0.1 4.0",
    "1.4 -0.1 -0.7 -0.3 -0.1 0.0 0.0 0.0 0.0 0.0 0.1 0.1 0.2 0.2 0.3 0.4 0.6 0.8 1.2 1.9 "
    "3.0 4.1 5.1 5.6 5.4 4.1 2.4 1.1 0.3 -0.7 -1.8 -2.8 -3.9 -5.1 -5.0 -3.8 -2.8 -2.2 -1.8 -1.6",
    "1.1 -0.6 -2.3 -3.7 -3.6 -1.4 -0.0 0.0 0.0 0.0 0.1 0.3 0.7 1.1 1.4 1.7 2.1 2.4 2.6 2.6 "
    "2.4 2.3 2.1 2.0 2.3 2.8 2.6 1.1 -2.6 -5.8 -5.7 -4.5 -2.4 -0.4 0.7 2.4 3.7 3.8 1.6 -0.7",
)
_SDS = (
    "2.0 1.4 0.9 0.9 0.9 0.6 0.2 0.1 0.1 0.1 0.2 0.3 0.4 0.6 0.7 0.8 0.9 0.9 0.9 1.2 "
    "1.6 2.2 2.6 2.6 2.7 3.6 4.9 4.9 3.1 2.4 2.2 1.9 1.5 1.2 1.3 1.6 1.8 1.2 0.6 1.2",
    "3.9 2.1 0.8 0.4 0.2 0.1 0.1 0.1 0.1 0.2 0.2 0.4 0.5 0.7 0.7 0.6 0.5 0.5 0.7 1.1 "
    "1.1 1.0 0.8 0.7 1.2 1.9 1.8 1.0 0.6 0.7 0.6 0.3 0.4 0.2 0.6 0.7 0.3 0.2 0.2 0.1",
    "3.6 2.7 2.4 3.0 3.0 1.3 0.2 0.1 0.1 0.2 0.5 0.8 1.3 1.5 1.4 1.3 1.0 0.7 0.7 0.7 "
    "0.7 0.8 1.1 1.5 1.7 2.0 3.3 3.7 2.8 1.6 1.6 1.9 1.5 0.7 0.7 0.5 0.2 0.6 0.6 0.1",
)
PITCH_RATE = np.array([row.split() for row in _MEANS], dtype=float)
"""(LANDINGS, BINS) mean pitch rate of the foot times stride time, rad per cycle, toes down positive."""
PITCH_RATE_SD = np.array([row.split() for row in _SDS], dtype=float)
"""(LANDINGS, BINS) its standard deviation between people, speeds and strides."""
LOG_RATIO = np.array([[0.01, 0.23, 0.15], [0.12, 0.29, 0.0], [0.1, 0.0, 0.2]])
"""(LANDINGS, LANDINGS) logarithm of a stride time over that on level ground, from one landing (row) to the next."""
