"""What the exoskeleton's sensors and links are off by, learnt from footprints that lie in one plane.

The state holds constant offsets (`chain`). A step brings its vector from footprint to footprint and the slopes of both,
each with a derivative by the offsets and an error of its own. Consecutive footprints mostly lie in one plane: then the
new one is as high as the slopes say, and both slopes are one. How likely that is follows from the figures themselves;
with that share the step corrects the offsets, and they correct it (a probabilistic data association, Bar-Shalom & Tse
1975).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.contact_terrain.chain import BACK, KNEE, LENGTH, OFFSETS, SAG
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

TURN_SD, KNEE_SD, LENGTH_SD, SAG_SD = math.radians(0.6), math.radians(0.3), 0.003, 0.006
TURN_WALK = math.radians(0.05)
"""rad a step, by which an attitude's offset changes."""
VECTOR_SD = np.array([0.006, 0.006, 0.002])
"""Of a step's vector, m: slack of the heel's holder, soft soles."""
CLIMB_SHARE = 0.04
"""Of the height climbed, by which holder and cuffs give under the leg that lifts its wearer."""
SLOPE_SD, SLOPE_SHARE = math.radians(0.32), 0.06
"""Of one foot's slope: a foot is never exactly flat, and the steeper the ground, the more its holder gives."""
PLANE_SD, PARALLEL_SD = 0.002, math.radians(0.2)
"""How far floors are from planes."""
ONE_PLANE = 0.85
"""Share of steps whose footprint lies in the plane of the one before."""
PLANE_SPREAD = 0.25 * math.radians(15.0)
"""m rad, over which the others spread: steps of up to 0.25 m, turns of the ground by up to 15°."""
LEVEL, LEVEL_SD, LEVEL_SPREAD = 0.6, math.radians(0.2), math.radians(30.0)
"""Share of footprints on level ground, how level that is, and over what the slopes of the others spread."""
_PLANE_NOISE, _LEVEL_NOISE = np.array([PLANE_SD, PARALLEL_SD]) ** 2, np.array([LEVEL_SD**2])


@dataclass(frozen=True, kw_only=True, eq=False)
class StepFigures:
    """A step as measured, with derivatives by the offsets.

    Attributes:
        vector: (3,) m, from the sole before to this one, world.
        J_vector: (3, OFFSETS).
        slopes: (2,) rad, of this foot and the one before in their directions.
        J_slopes: (2, OFFSETS).
        sd: (5,) standard deviations of vector and slopes beside the offsets'.
    """

    vector: Array
    J_vector: Array
    slopes: Array
    J_slopes: Array
    sd: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """What is believed after a step.

    Attributes:
        values: (5,) vector, m, and slopes, rad.
        covariance: (5, 5).
        one_plane: Probability that both footprints lie in one plane.
        offsets: (OFFSETS,).
        P: (OFFSETS, OFFSETS) covariance of the offsets.
    """

    values: Array
    covariance: Array
    one_plane: float
    offsets: Array
    P: Array


class Offsets:
    """The offsets as they are believed after the last step that is over."""

    def __init__(self) -> None:
        sd = np.empty(OFFSETS)
        sd[BACK:KNEE], sd[KNEE:LENGTH], sd[LENGTH:SAG], sd[SAG] = TURN_SD, KNEE_SD, LENGTH_SD, SAG_SD
        self._x, self._P = np.zeros(OFFSETS), np.diag(sd**2)
        self._walk = np.zeros(OFFSETS)
        self._walk[BACK:KNEE] = TURN_WALK**2

    def judge(self, step: StepFigures, *, start: bool = False) -> Belief:
        """What a step and the offsets say of each other; the offsets stay as they are.

        Args:
            step: As measured.
            start: It is no step but how both feet stand at the start.
        """
        n = OFFSETS
        H = np.zeros((5, n + 5))
        H[:, :n] = np.vstack([step.J_vector, step.J_slopes])
        H[:, n:] = np.eye(5)
        z = np.concatenate([self._x, np.zeros(5)])
        P = np.zeros((n + 5, n + 5))
        P[:n, :n] = self._P + np.diag(self._walk)
        P[n:, n:] = np.diag(step.sd**2)
        measured = np.concatenate([step.vector, step.slopes])
        for row in (3, 4) if start else (3,):
            z, P, _ = _update(z, P, H[row : row + 1], -measured[row : row + 1], _LEVEL_NOISE, LEVEL, LEVEL_SPREAD)
        A = _one_plane(measured)
        z, P, likely = _update(z, P, A @ H, -_apart(measured), _PLANE_NOISE, ONE_PLANE, PLANE_SPREAD)
        return Belief(
            values=measured + H @ z, covariance=H @ P @ H.T, one_plane=likely, offsets=z[:n], P=P[:n, :n]
        )  # fmt: skip

    def learn(self, belief: Belief) -> None:
        """Takes what a step that is over has taught."""
        self._x, self._P = belief.offsets, belief.P


def _apart(m: Array) -> Array:
    """(2,) how far a footprint is above the plane of the one before, m, and how much it is turned, rad.

    See docs/contact_terrain.md (8).
    """
    distance = math.hypot(m[0], m[1])
    return np.array([m[2] - distance * math.tan(0.5 * (m[3] + m[4])), m[3] - m[4]])


def _one_plane(m: Array) -> Array:
    """(2, 5) derivative of `_apart`."""
    distance, mean = math.hypot(m[0], m[1]), 0.5 * (m[3] + m[4])
    along = -math.tan(mean) / max(distance, 1e-6) * m[:2]
    by_slope = -0.5 * distance / math.cos(mean) ** 2
    return np.array([[along[0], along[1], 1.0, by_slope, by_slope], [0.0, 0.0, 0.0, 1.0, -1.0]])


@cached(_HERE)
def _update(
    z: Array, P: Array, H: Array, y: Array, noise: Array, prior: float, spread: float
) -> tuple[Array, Array, float]:  # fmt: skip
    """Kalman update by y = H z + noise that holds with a prior probability, and with which one in the end.

    See docs/contact_terrain.md (9), (10).

    Args:
        z: (n,) state.
        P: (n, n) its covariance.
        H: (m, n).
        y: (m,).
        noise: (m,) variances.
        prior: Probability that it holds.
        spread: Volume over which y spreads where it does not.
    """
    PH = P @ H.T
    S = H @ PH + np.diag(noise)
    innovation = y - H @ z
    inverse = np.linalg.inv(S)
    gain = PH @ inverse
    density = math.exp(-0.5 * innovation @ inverse @ innovation) / math.sqrt(np.linalg.det(2.0 * math.pi * S))
    share = prior * density / (prior * density + (1.0 - prior) / spread)
    move = gain @ innovation
    P = P - share * gain @ PH.T + share * (1.0 - share) * np.outer(move, move)
    return z + share * move, 0.5 * (P + P.T), share  # rounding that is not symmetric would grow from step to step
