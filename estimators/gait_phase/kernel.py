"""The posterior of stride time and landing over a grid of hypotheses, compiled (docs/gait_phase.md (2)-(6))."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.gait_phase.template import BINS, LANDINGS
from stridetwin.streams.samples import Array

CELLS = 80
SHORTEST_S, LONGEST_S = 0.5, 2.8
"""Stride times of the first and the last cell of the grid, s."""
LOG_STRIDE = np.linspace(math.log(SHORTEST_S), math.log(LONGEST_S), CELLS)
STRIDE_S = np.exp(LOG_STRIDE)
_FREEDOM = 4.0  # of Student's t: single deviations from the template are no outliers to be rejected, but weak evidence
IMPOSSIBLE = -1e4

_called = cached(Path(__file__).parent, llvm_level=1)


class Belief(NamedTuple):
    """Log-weights of the hypotheses about the running stride.

    Attributes:
        walk: (LANDINGS, CELLS) that it ends in a landing of a kind after a stride time.
        stand: (1,) that the person has stopped.
    """

    walk: Array
    stand: Array


class Template(NamedTuple):
    """Pitch of the foot over a stride, by the landing that ends it.

    Attributes:
        mean: (LANDINGS, BINS) pitch rate times stride time, rad per cycle, in the middle of each bin of the phase.
        variance: (LANDINGS, BINS) of single strides about it, rad².
    """

    mean: Array
    variance: Array


class StrideRatios(NamedTuple):
    """Stride time over that on level ground, from one landing (row) to the next (column).

    Attributes:
        log_mean: (LANDINGS, LANDINGS) its logarithm.
        variance: (LANDINGS, LANDINGS) of the logarithm between people; what the person's own strides have left of it.
    """

    log_mean: Array
    variance: Array


class PriorSettings(NamedTuple):
    """What is known of a stride when it begins.

    Attributes:
        log_stride: Mean logarithm of the person's stride time on level ground.
        variance: Of `log_stride` and single strides together.
        irregular_share: Weight of the second, wide normal distribution.
        irregular_variance: Added to `variance` there.
        stand_share: Probability that the person stops.
    """

    log_stride: float
    variance: float
    irregular_share: float
    irregular_variance: float
    stand_share: float


class RateSample(NamedTuple):
    """A pitch rate within a stride.

    Attributes:
        since_s: Time since the touch-down, s.
        weight: Its share of an independent observation: sampling interval over correlation time.
        rate: Pitch rate, rad/s.
        noise: Variance beyond the template's, rad² per cycle².
    """

    since_s: float
    weight: float
    rate: float
    noise: float


@njit(**INSIDE)
def _log_t(deviation: float, variance: float) -> float:
    """Logarithm of Student's t density, without its constant."""
    return -0.5 * (_FREEDOM + 1.0) * math.log(1.0 + deviation * deviation / (variance * _FREEDOM)) - 0.5 * math.log(
        variance
    )


@_called
def set_prior(belief: Belief, settings: PriorSettings, transition: Array, ratios: StrideRatios) -> None:
    """Sets the hypotheses at a touch-down, docs/gait_phase.md (3).

    Args:
        belief: Overwritten.
        settings: Of the stride time.
        transition: (LANDINGS, LANDINGS) joint probability of this touch-down's landing (row) and the next one's.
        ratios: Of the stride times between them.
    """
    total = 0.0
    for c in range(LANDINGS):
        for j in range(CELLS):
            density = 1e-30
            for k in range(LANDINGS):
                error = LOG_STRIDE[j] - settings.log_stride - ratios.log_mean[k, c]
                narrow = settings.variance + ratios.variance[k, c]
                wide = narrow + settings.irregular_variance
                density += transition[k, c] * (
                    (1.0 - settings.irregular_share) * math.exp(-0.5 * error * error / narrow) / math.sqrt(narrow)
                    + settings.irregular_share * math.exp(-0.5 * error * error / wide) / math.sqrt(wide)
                )
            total += density
            belief.walk[c, j] = math.log(density)
    belief.stand[0] = math.log(total * settings.stand_share / (1.0 - settings.stand_share))


@_called
def weigh(belief: Belief, template: Template, sample: RateSample) -> tuple[float, float, float, float]:
    """Weighs the hypotheses with one pitch rate, docs/gait_phase.md (4), (6), and takes their means (5).

    Returns:
        Mean and variance of the phase, mean phase rate (1/s), all given that the person walks; and the probability that
        they stand.
    """
    largest = IMPOSSIBLE
    for c in range(LANDINGS):
        for j in range(CELLS):
            phase = sample.since_s / STRIDE_S[j]
            if phase >= 1.0:
                belief.walk[c, j] = IMPOSSIBLE
                continue
            place = max(phase * BINS - 0.5, 0.0)
            i = min(int(place), BINS - 2)
            share = min(place - i, 1.0)
            mean = template.mean[c, i] * (1.0 - share) + template.mean[c, i + 1] * share
            variance = template.variance[c, i] * (1.0 - share) + template.variance[c, i + 1] * share + sample.noise
            log_density = _log_t(sample.rate * STRIDE_S[j] - mean, variance) + LOG_STRIDE[j]
            belief.walk[c, j] += sample.weight * log_density
            largest = max(largest, belief.walk[c, j])
    belief.stand[0] += sample.weight * _log_t(sample.rate, sample.noise)
    largest = max(largest, belief.stand[0])
    total, phase_sum, square_sum, rate_sum = 1e-300, 0.0, 0.0, 0.0
    for c in range(LANDINGS):
        for j in range(CELLS):
            if belief.walk[c, j] > IMPOSSIBLE:
                belief.walk[c, j] = max(belief.walk[c, j] - largest, 0.5 * IMPOSSIBLE)
                weight, phase = math.exp(belief.walk[c, j]), sample.since_s / STRIDE_S[j]
                total += weight
                phase_sum += weight * phase
                square_sum += weight * phase * phase
                rate_sum += weight / STRIDE_S[j]
    belief.stand[0] = max(belief.stand[0] - largest, 0.5 * IMPOSSIBLE)
    stand = math.exp(belief.stand[0])
    mean_phase = phase_sum / total
    return mean_phase, max(square_sum / total - mean_phase**2, 0.0), rate_sum / total, stand / (stand + total)
