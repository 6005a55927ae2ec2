"""Estimates offsets of the exoskeleton's sensors and links from consecutive footprints in one plane.

The state holds constant offsets (`leg`). A step gives the vector between the footprints and both slopes, each with a
derivative by the offsets and its own error. Consecutive footprints mostly lie in one plane: then the height follows
from the slopes, and both slopes are equal. The probability of this follows from the measurements. With that weight the
step and the offsets correct each other (probabilistic data association, Bar-Shalom & Tse 1975).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.estimators.contact_terrain.leg import BACK, KNEE, LENGTH, OFFSETS, SAG
from stridetwin.estimators.contact_terrain.parameters import ContactTerrainParameters
from stridetwin.streams.algebra.matrices import multiply, transposed
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent
_ROTATION_WALK_RAD = math.radians(0.05)  # change of an attitude's offset from step to step; hand-chosen on tuning walks
# Volume over which the residuals of steps off the plane are spread: 0.25 m times 15° of slope change (buildings).
_PLANE_SPREAD_M_RAD = 0.25 * math.radians(15.0)
# "Doubled" is as in `ContactTerrainParameters`.
# Share of steps whose footprint lies in the plane of the one before; hand-chosen. At half its distance from 1: no
# difference.
_ONE_PLANE_SHARE = 0.85
_LEVEL_SHARE = 0.6  # of footprints on level ground; hand-chosen. At half its distance from 1: 0.129°
# Unevenness of floors in slope; hand-chosen. Doubled: 0.127°, standard deviation 0.19°.
_PARALLEL_SD_RAD = math.radians(0.2)
# Tolerance of the length of a thigh or shank; hand-chosen on tuning walks. Doubled: no difference.
_SEGMENT_LENGTH_SD_M = 0.003
_LEVEL_SD_RAD = math.radians(0.2)  # standard deviation of the slope of level ground; hand-chosen
_LEVEL_SPREAD_RAD = math.radians(30.0)  # range over which the slopes of other ground are spread (buildings)
_UPRIGHT_SHARE = 0.7  # of footprints on ground that does not tilt sideways; hand-chosen on tuning walks
_TILT_SPREAD_RAD = math.radians(20.0)  # range over which the tilts of other ground are spread (paths, car parks)
_VALUES = 6  # values of a step: vector x, y, z, slopes of this foot and the previous one, tilt of the ground sideways
_TILT = 5  # place of the tilt among them


@dataclass(frozen=True, kw_only=True, eq=False)
class StepFigures:
    """A step as measured, with derivatives by the offsets.

    Attributes:
        vector: (3,) m, from the previous sole to this one, world.
        J_vector: (3, OFFSETS) derivative of `vector`.
        slopes: (2,) rad, of this foot and the previous one in their directions.
        J_slopes: (2, OFFSETS) derivative of `slopes`.
        tilt: Weighted mean of the rolls of both soles, rad, the left side up positive.
        J_tilt: (OFFSETS,) derivative of `tilt`.
        left: (2,) horizontal unit vector to the left of the mean direction of both feet, world.
        turned: (2,) sine of the angle by which this foot, and the previous one, points to the left of that direction.
        sd: (6,) standard deviations of vector, slopes and tilt beyond what the offsets cause.
    """

    vector: Array
    J_vector: Array
    slopes: Array
    J_slopes: Array
    tilt: float
    J_tilt: Array
    left: Array
    turned: Array
    sd: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """The estimate after a step.

    Attributes:
        values: (6,) corrected step: vector x, y, z from the previous sole, m, world axes; slope under this and the
            previous foot, rad; tilt of the ground sideways, rad.
        covariance: (6, 6) covariance of `values`.
        offsets: (OFFSETS,) rad and m, the offsets (`leg`).
        P: (OFFSETS, OFFSETS) covariance of the offsets.
    """

    values: Array
    covariance: Array
    offsets: Array
    P: Array


class Offsets:
    """The estimated offsets after the last completed step.

    Args:
        parameters: Prior of offsets and ground.
        sag_sd_m: Standard deviation of a loaded heel's sag in its holder.
    """

    def __init__(self, parameters: ContactTerrainParameters, sag_sd_m: float) -> None:
        """Begins with offsets of 0 and their prior covariance; `sag_sd_m` is that of a loaded heel's sag, m."""
        p = parameters
        # variances of a footprint's height over the previous one's plane, m², and of their difference in slope, rad²
        self._plane_noise = np.array([p.plane_sd_m, _PARALLEL_SD_RAD]) ** 2
        self._level_noise = np.array([_LEVEL_SD_RAD**2])  # variance of the slope of level ground, rad²
        # prior standard deviation of each offset: rotations of all five attitudes, knees, lengths, sag
        sd = np.empty(OFFSETS)
        sd[BACK:KNEE], sd[KNEE:LENGTH] = p.mount_rotation_sd_rad, p.knee_zero_sd_rad
        sd[LENGTH:SAG], sd[SAG] = _SEGMENT_LENGTH_SD_M, sag_sd_m
        walk = np.zeros(OFFSETS)
        walk[BACK:KNEE] = _ROTATION_WALK_RAD**2
        self._walk = np.diag(walk)  # covariance of the offsets' change from step to step: only the rotations change
        # The state of `posterior` and its covariance: the offsets and, after them, the errors of a step's values. The
        # errors are 0 here, as each step has new ones. Their variances, and the columns of the offsets in H, are those
        # of the step, and 0 here.
        size = OFFSETS + _VALUES
        self._z, self._P = np.zeros(size), np.zeros((size, size))
        self._H = np.eye(_VALUES, size, OFFSETS)  # zeros, then an identity in the columns of the errors
        self._P[:OFFSETS, :OFFSETS] = np.diag(sd**2) + self._walk

    def posterior(self, step: StepFigures, *, start: bool = False) -> Posterior:
        """Combines a step with the offsets; the stored offsets do not change.

        The state z holds the n offsets and, after them, the six errors of the step's values. H, (6, n + 6), maps it to
        the corrections of the values. Hypotheses correct it one after the other, each with its probability: level
        ground under this foot; at the start also under the other; ground that does not tilt sideways; both footprints
        in one plane. Each says that the measured value plus its correction is 0, so the value with its sign changed is
        the measurement.

        Args:
            step: The step as measured.
            start: Whether it is the pair of feet at the start rather than a step.
        """
        n, z, P, H = OFFSETS, self._z, self._P.copy(), self._H.copy()
        H[:3, :n], H[3:_TILT, :n], H[_TILT, :n] = step.J_vector, step.J_slopes, step.J_tilt
        np.fill_diagonal(P[n:, n:], step.sd**2)
        measured = np.array([*step.vector, *step.slopes, step.tilt])
        for row in (3, 4) if start else (3,):  # rows of the slopes of this foot and the previous one
            level = np.zeros((1, _VALUES))  # a foot that points aside rises along its axis where the ground tilts
            level[0, row], level[0, _TILT] = 1.0, -step.turned[row - 3]
            z, P, _ = _update(z, P, level @ H, -level @ measured, self._level_noise, _LEVEL_SHARE, _LEVEL_SPREAD_RAD)
        at = slice(_TILT, _TILT + 1)
        z, P, _ = _update(z, P, H[at], -measured[at], self._level_noise, _UPRIGHT_SHARE, _TILT_SPREAD_RAD)
        A = _plane_residual_jacobian(measured, step)  # (2, 6), so A H is the residual's derivative by the state
        z, P, _ = _update(
            z, P, A @ H, -_plane_residual(measured, step), self._plane_noise, _ONE_PLANE_SHARE, _PLANE_SPREAD_M_RAD
        )
        return Posterior(values=measured + H @ z, covariance=H @ P @ H.T, offsets=z[:n], P=P[:n, :n])

    def store(self, posterior: Posterior) -> None:
        """Stores the offsets estimated with a completed step; the attitudes' offsets may change until the next one."""
        self._z[:OFFSETS] = posterior.offsets
        self._P[:OFFSETS, :OFFSETS] = posterior.P + self._walk


def _plane_residual(m: Array, step: StepFigures) -> Array:
    """(2,) height of a footprint above the plane of the previous one, m, and the difference of their slopes, rad.

    docs/contact_terrain.md (8). In one plane both are 0; the slopes of feet that point aside differ by its tilt.

    Args:
        m: (6,) values of a step, as in `Posterior`.
        step: The step as measured, of which the directions count.
    """
    distance, aside = math.hypot(m[0], m[1]), float(step.left @ m[:2])
    rise = distance * math.tan(0.5 * (m[3] + m[4])) + aside * math.tan(m[_TILT])
    return np.array([m[2] - rise, m[3] - m[4] - (step.turned[0] - step.turned[1]) * m[_TILT]])


def _plane_residual_jacobian(m: Array, step: StepFigures) -> Array:
    """(2, 6) derivative of the height above the plane, and of the difference in slope, by the values of a step.

    Both are those of `_plane_residual`, which has the arguments.
    """
    distance, mean_slope, tilt = math.hypot(m[0], m[1]), 0.5 * (m[3] + m[4]), m[_TILT]
    # derivatives of the height by x, y and either slope; the limit is for footprints at one place
    by_x, by_y = -math.tan(mean_slope) / max(distance, 1e-6) * m[:2] - math.tan(tilt) * step.left
    by_slope = -0.5 * distance / math.cos(mean_slope) ** 2
    by_tilt = -float(step.left @ m[:2]) / math.cos(tilt) ** 2
    turned = step.turned[0] - step.turned[1]
    return np.array([[by_x, by_y, 1.0, by_slope, by_slope, by_tilt], [0.0, 0.0, 0.0, 1.0, -1.0, -turned]])


@entry_kernel(_HERE)
def _update(
    z: Array, P: Array, H: Array, y: Array, noise: Array, prior: float, spread: float
) -> tuple[Array, Array, float]:
    """Kalman update by an equation y = H z + noise that may not hold: docs/contact_terrain.md (9), (10).

    The probability that it holds follows from its prior and from how well y fits. The result is the mean and covariance
    of the mixture of the updated state, with that probability, and the unchanged one.

    Args:
        z: (n,) state.
        P: (n, n) its covariance.
        H: (m, n) derivative of the measurement, m = 1 or 2.
        y: (m,) measurement.
        noise: (m,) its variances.
        prior: Probability that the equation holds, before the measurement.
        spread: Volume over which y is distributed if it does not hold.

    Returns:
        (n,) state and (n, n) covariance afterwards; the probability that the equation holds, given y.
    """
    n, m = P.shape[0], H.shape[0]
    PH = multiply(P, transposed(H))
    S = multiply(H, PH)
    innovation, inverse = np.empty(m), np.empty((m, m))
    for i in range(m):
        S[i, i] += noise[i]
        innovation[i] = y[i]
        for j in range(n):
            innovation[i] -= H[i, j] * z[j]
    determinant = S[0, 0]  # of S (m, m), the innovation's covariance; its inverse follows in closed form
    inverse[0, 0] = 1.0 / S[0, 0]
    if m == 2:
        determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
        inverse[0, 0], inverse[0, 1] = S[1, 1] / determinant, -S[0, 1] / determinant
        inverse[1, 0], inverse[1, 1] = -S[1, 0] / determinant, S[0, 0] / determinant
    gain = multiply(PH, inverse)
    squared = 0.0
    for i in range(m):
        for j in range(m):
            squared += innovation[i] * inverse[i, j] * innovation[j]
    density = math.exp(-0.5 * squared) / math.sqrt((2.0 * math.pi) ** m * determinant)
    probability = prior * density / (prior * density + (1.0 - prior) / spread)  # that the equation holds, given y
    move, moved, updated = np.zeros(n), np.empty(n), np.empty((n, n))
    for i in range(n):
        for j in range(m):
            move[i] += gain[i, j] * innovation[j]
        moved[i] = z[i] + probability * move[i]
    explained = multiply(gain, transposed(PH))
    for i in range(n):
        for j in range(n):  # the mean of both halves: asymmetric rounding errors would grow from step to step
            updated[i, j] = (
                0.5 * (P[i, j] + P[j, i] - probability * (explained[i, j] + explained[j, i]))
                + probability * (1.0 - probability) * move[i] * move[j]
            )
    return moved, updated, probability
