"""The posterior of stride time and kind of stride over a grid of hypotheses, compiled (docs/gait_phase.md (2)-(6))."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.gait_phase.template import BINS, N_STRIDE_KINDS
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

CELLS = 80  # number of stride times in the grid
SHORTEST_S, LONGEST_S = 0.5, 2.8
"""Stride times of the first and the last cell of the grid, s."""
LOG_STRIDE = np.linspace(math.log(SHORTEST_S), math.log(LONGEST_S), CELLS)
STRIDE_S = np.exp(LOG_STRIDE)
"""(CELLS,) stride times of the grid, s, equally spaced in their logarithms `LOG_STRIDE`."""
_FREEDOM = 4.0  # of Student's t: single deviations from the template are no outliers to be rejected, but weak evidence
IMPOSSIBLE = -1e4  # log-weight of a hypothesis whose stride time has passed
# Probability of a stride of quite another length, such as the first and the last, and standard deviation of the
# logarithm of its time [tuned on the walks of `GaitPhaseParameters`]. Doubled: such strides are recognised earlier,
# regular ones are less certain.
_IRREGULAR_SHARE, _IRREGULAR_SD = 0.15, 0.15

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)


class Belief(NamedTuple):
    """Log-weights of the hypotheses about the running stride.

    Attributes:
        walk: (N_STRIDE_KINDS, CELLS) that it is of a kind and takes a stride time.
        stand: (1,) that the person has stopped.
    """

    walk: Array
    stand: Array


class Template(NamedTuple):
    """Pitch of the foot over a stride of each kind.

    Attributes:
        mean: (N_STRIDE_KINDS, BINS) pitch rate times stride time, rad per cycle, in the middle of each phase bin.
        variance: (N_STRIDE_KINDS, BINS) of single strides about it, rad².
    """

    mean: Array
    variance: Array


class StrideRatios(NamedTuple):
    """Stride time of each kind over that on level ground.

    Attributes:
        log_mean: (N_STRIDE_KINDS,) logarithm of the ratio.
        variance: (N_STRIDE_KINDS,) of the logarithm between people; what the person's own strides have left of it.
    """

    log_mean: Array
    variance: Array


@njit(**INNER_KERNEL)
def _log_t(deviation: float, variance: float) -> float:
    """Logarithm of the density of Student's t with `_FREEDOM` degrees of freedom, without its constant.

    `deviation` is the difference from the mean, and `variance` the squared scale of the distribution.
    """
    return -0.5 * (_FREEDOM + 1.0) * math.log(1.0 + deviation * deviation / (variance * _FREEDOM)) - 0.5 * math.log(
        variance
    )


def set_prior(
    belief: Belief, log_stride: float, variance: float, stand_share: float, shares: Array, ratios: StrideRatios
) -> None:
    """Sets the hypotheses at a touch-down: docs/gait_phase.md (3).

    Args:
        belief: Overwritten.
        log_stride: Mean logarithm of the person's stride time on level ground.
        variance: Variance of `log_stride` and single strides together.
        stand_share: Probability that the person stops.
        shares: (N_STRIDE_KINDS,) probability of each kind of stride.
        ratios: Stride times of the kinds over those on level ground.
    """
    # squared differences of the grid's logarithms from each kind's expected one
    error2 = np.square(LOG_STRIDE - log_stride - ratios.log_mean[:, None])  # (N_STRIDE_KINDS, CELLS)
    # each kind is a mixture of a narrow normal density of usual strides and a wide one of irregular strides
    narrow = variance + ratios.variance[:, None]
    wide = narrow + _IRREGULAR_SD**2
    regular = (1.0 - _IRREGULAR_SHARE) * np.exp(-0.5 * error2 / narrow) / np.sqrt(narrow)
    irregular = _IRREGULAR_SHARE * np.exp(-0.5 * error2 / wide) / np.sqrt(wide)
    density = shares[:, None] * (regular + irregular) + 1e-30  # a kind without a share has a finite logarithm, too
    belief.walk[:] = np.log(density)
    belief.stand[0] = math.log(density.sum() * stand_share / (1.0 - stand_share))  # standing then has `stand_share`


@_entry_kernel
def weigh_hypotheses(
    belief: Belief, template: Template, since_s: float, share: float, rate: float, noise: float
) -> tuple[float, float, float, float]:
    """Weighs the hypotheses with one pitch rate and takes their means.

    Weights: docs/gait_phase.md (4), (6); means: docs/gait_phase.md (5). A hypothesis whose stride time has passed is
    impossible from then on. The log-weights are shifted so that the largest is 0; a hypothesis that is still possible
    keeps at least half of `IMPOSSIBLE`.

    Args:
        belief: Changed in place.
        template: Pitch rate that each hypothesis expects.
        since_s: Time since the touch-down, s.
        share: Share of an independent observation that the rate counts for: sampling interval over correlation time.
        rate: Pitch rate, rad/s.
        noise: Variance beyond the template's, rad² per cycle².

    Returns:
        Mean and variance of the phase, mean phase rate (1/s), all given that the person walks; and the probability that
        they stand.
    """
    largest = IMPOSSIBLE
    for c in range(N_STRIDE_KINDS):  # kind of stride
        for j in range(CELLS):  # stride time
            phase = since_s / STRIDE_S[j]  # docs/gait_phase.md (2)
            if phase >= 1.0:
                belief.walk[c, j] = IMPOSSIBLE
                continue
            # linear interpolation between the middles of bins i and i + 1; constant beyond the first and the last one
            place = max(phase * BINS - 0.5, 0.0)
            i = min(int(place), BINS - 2)
            part = min(place - i, 1.0)
            mean = template.mean[c, i] * (1.0 - part) + template.mean[c, i + 1] * part
            variance = template.variance[c, i] * (1.0 - part) + template.variance[c, i + 1] * part + noise
            # ln [T t₄(ω T; m, v + v₀)]
            log_density = _log_t(rate * STRIDE_S[j] - mean, variance) + LOG_STRIDE[j]
            belief.walk[c, j] += share * log_density
            largest = max(largest, belief.walk[c, j])
    belief.stand[0] += share * _log_t(rate, noise)  # who stands has a pitch rate of 0
    largest = max(largest, belief.stand[0])
    # sums over the hypotheses that the person walks: weight, and weight times phase, squared phase and phase rate; the
    # total is never 0
    total, phase_sum, square_sum, rate_sum = 1e-300, 0.0, 0.0, 0.0
    for c in range(N_STRIDE_KINDS):
        for j in range(CELLS):
            if belief.walk[c, j] > IMPOSSIBLE:
                belief.walk[c, j] = max(belief.walk[c, j] - largest, 0.5 * IMPOSSIBLE)
                weight, phase = math.exp(belief.walk[c, j]), since_s / STRIDE_S[j]
                total += weight
                phase_sum += weight * phase
                square_sum += weight * phase * phase
                rate_sum += weight / STRIDE_S[j]
    belief.stand[0] = max(belief.stand[0] - largest, 0.5 * IMPOSSIBLE)
    stand = math.exp(belief.stand[0])
    mean_phase = phase_sum / total
    return mean_phase, max(square_sum / total - mean_phase**2, 0.0), rate_sum / total, stand / (stand + total)
