"""Running: short stances with a flight between them, at a cadence that hardly depends on the speed.

A slow run is a bounce on springy legs. Its step frequency is near that of the bouncing body, about 2.65 Hz at any speed
below 3 m/s (Cavagna, Franzetti, Heglund & Willems 1988, J. Physiol. 399:81-92), so that its steps are short. The force
of the ground is half a sine over each stance (Morin, Dalleau, Kyröläinen, Jeannin & Belli 2005, J. Appl. Biomech.
21:167-180), and nothing in the flight: the height of the body follows from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stridetwin.sim.gait.style import Style, leg_length, level_style, pace
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

_STEP_HZ, _LEG_M = 2.65, 0.92  # step frequency of a person with that leg, hip centre to sole
_FLIGHT, _FLIGHT_PACE, _FLIGHT_BY_PACE = 0.10, 0.40, 0.6  # share of a step, at that dimensionless speed, and its growth
_FLIGHT_RANGE = (0.05, 0.30)
_FLAT_AFTER = 0.07  # share of a step from touch-down until the foot is flat
_HEEL_OFF_BEFORE = 0.37  # share of a step from heel-off to toe-off; 0.11 s in recorded runs
_RISE = (0.09, 0.30, 0.64)  # pitch at the inner `style.RISE_KNOTS`: the angular rate grows evenly
# Pitch at `style.SWING_KNOTS`, rad, at the dimensionless speed `_PITCH_PACE`: integrals of the angular rates of the
# recorded runs of `foot_imu_vicon` (1.4 to 2.3 m/s), the largest 2 % smaller for the range of the ankle; it grows with
# the root of speed.
_PITCH = (0.90, 1.22, 1.30, 1.19, 0.92, 0.42, -0.09, -0.30, -0.31)
_PITCH_PACE, _PITCH_RANGE = 0.60, (0.8, 1.15)
_TILT_RAD = 0.10  # less forward lean of the pelvis than the fastest walk has at its push-off
_BENT = 0.98  # height of the pelvis, leg lengths: the knees stay bent
_SWING_PACE = 0.55  # of the walking style whose swing a run has
_HARMONICS = 3  # of `Style.height`
_FINE = 512  # instants of a step at which its force is sampled
_WALKED = 2  # steps at each end of a run that are walked: nobody flies out of a stand


def run_step_s(size: Wearer) -> float:
    """Duration of a running step, s; as of a pendulum it grows with the root of the leg's length."""
    return float(np.sqrt(leg_length(size) / _LEG_M) / _STEP_HZ)


def flight_share(pace_: float) -> float:
    """Share of a running step in which no foot is on the ground, at a dimensionless speed."""
    return float(np.clip(_FLIGHT + _FLIGHT_BY_PACE * (pace_ - _FLIGHT_PACE), *_FLIGHT_RANGE))


def bounce(flight: float) -> Array:
    """(6,) cosine and sine of the first three harmonics of the body's height over a step, in units of g T².

    The step begins with a touch-down. The force of the ground in body weights is π / (2 (1 − f)) sin(π φ / (1 − f)) in
    the stance, φ < 1 − f, and 0 in the flight f, so that its mean is 1. Twice integrated, a harmonic k of the force has
    the factor −1 / (2 π k)².

    Args:
        flight: Share f of the step in which no foot is on the ground.
    """
    phase = np.arange(_FINE) / _FINE
    stance = 1.0 - flight
    force = np.where(phase < stance, np.pi / (2.0 * stance) * np.sin(np.pi * phase / stance), 0.0)
    terms = []
    for k in range(1, _HARMONICS + 1):
        angle = 2.0 * np.pi * k * phase
        terms += [
            2.0 * float(np.mean(force * wave)) / -((2.0 * np.pi * k) ** 2) for wave in (np.cos(angle), np.sin(angle))
        ]
    return np.array(terms)


def run_style(speed_mps: float, duration_s: float, size: Wearer) -> Style:
    """Style of a running step: the swing of a fast walk, a flight, and a bounce on bent knees.

    Args:
        speed_mps: Speed of the step.
        duration_s: Its duration.
        size: Wearer.
    """
    pace_ = pace(speed_mps, size)
    flight = flight_share(pace_)
    style = level_style(_SWING_PACE)
    height = NOMINAL_GRAVITY_MPS2 * duration_s**2 / leg_length(size) * bounce(flight)
    return replace(
        style,
        double_support=-flight,
        flat_after=_FLAT_AFTER,
        heel_off_before=_HEEL_OFF_BEFORE,
        rise=np.array(_RISE),
        forward=np.zeros_like(style.forward),
        pitch=np.clip(np.sqrt(pace_ / _PITCH_PACE), *_PITCH_RANGE) * np.array(_PITCH),
        height=np.append(_BENT, height),
        tilt=_TILT_RAD,
    )


def running_steps(rises: Sequence[float], pauses: Sequence[float]) -> list[bool]:
    """Which steps of a run are run: not those at its ends, beside risers, and into and out of a pause.

    Args:
        rises: (N,) m, height of the riser of each step, 0 for none.
        pauses: (N,) s, for which the walker stands still after each step.
    """
    walked = np.array(rises) != 0.0
    walked[:_WALKED] = walked[-_WALKED:] = True
    stops = np.flatnonzero(np.array(pauses) > 0.0)
    near = {i + k for i in np.flatnonzero(walked) for k in (-1, 0, 1)} | {i + k for i in stops for k in (0, 1)}
    return [i not in near for i in range(len(rises))]
