"""Filters the stride time of one leg: its belief about the running stride, and what it has learned of the person."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.estimators.gait_phase.kernel import (
    CELLS,
    IMPOSSIBLE,
    LONGEST_S,
    SHORTEST_S,
    STRIDE_S,
    Belief,
    StrideRatios,
    Template,
    set_prior,
    weigh_hypotheses,
)
from stridetwin.estimators.gait_phase.parameters import GaitPhaseParameters
from stridetwin.estimators.gait_phase.template import (
    AFTER,
    BEFORE,
    BINS,
    LANDINGS,
    LEVEL,
    LOG_RATIO,
    N_STRIDE_KINDS,
    PITCH_RATE,
    PITCH_RATE_SD,
)

# Values marked [tuned] are of the walks of `GaitPhaseParameters`.
# Change of a person's mean stride time from stride to stride, in logarithms [tuned]. Doubled: the mean follows a change
# of pace sooner and is noisier.
_STRIDE_DRIFT = 0.03
# Standard deviation, between people, of the logarithm of a stair stride's time over that of a level one [tuned].
# Doubled: a person's own ratio is learned sooner, the first flight is less certain.
_RATIO_SD = 0.1
# Probability that a stride on stairs leads off them [tuned]. Doubled: strides within long flights are less certain.
_STAIRS_END_SHARE = 0.4
# Number of the person's own strides that the template of all people is worth [tuned], and over which a learned template
# averages. Doubled: a (new) manner of walking is learned half as fast.
_TEMPLATE_STRIDES, _TEMPLATE_MEMORY = 3.0, 20.0
_SAMPLE_S = 0.008  # least interval of the stored pitch rates of a stride
_SAMPLES = int(LONGEST_S / _SAMPLE_S) + 2
_MEASUREMENT_SD = 0.03  # of a stride's logarithm about the person's mean, beyond the drift
_OUTLIER = 9.0  # squared normalised innovation, beyond which a stride counts this much less
_CERTAIN = 0.8  # probability of a kind of stride whose template is learned
# Least probability of each kind of landing, whatever the stride before says [tuned]. Doubled: no difference. 0: a
# landing taken for another kind may make the next stride seem a stop.
_WRONG_SHARE = 0.01
_BIN_CENTERS = (np.arange(BINS) + 0.5) / BINS


class StrideFilter:
    """Phase within the running stride: docs/gait_phase.md (2)-(9).

    Attributes:
        begin_ns: Touch-down that began the running stride, ns; -1 before the first.
        is_regular: Whether the running stride may be learned from: no gap, no stop.
        is_walking: Whether a stride is running.
        phase: Expected phase of the running stride, 0 to 1.
        phase_sd: Standard deviation of the phase.
        rate: Expected phase rate, 1/s.
    """

    def __init__(self, parameters: GaitPhaseParameters) -> None:
        """Begins without a stride, with what is known of all people."""
        self._p = p = parameters
        self.begin_ns, self.is_regular, self.is_walking = -1, False, False
        self.phase = self.phase_sd = self.rate = 0.0
        # mean logarithm of the person's stride time (s) on level ground, and its variance
        self._log_stride, self._variance = math.log(p.stride_s), p.stride_sd**2
        # log-weights of the hypotheses about the running stride, set at each touch-down
        self._belief = Belief(walk=np.zeros((N_STRIDE_KINDS, CELLS)), stand=np.zeros(1))
        self._template = Template(mean=PITCH_RATE.copy(), variance=np.square(PITCH_RATE_SD))
        is_level = (BEFORE == LEVEL) & (AFTER == LEVEL)  # strides on the level are what the ratios relate to
        ratio_variance = np.where(is_level, 0.0, _RATIO_SD**2)
        self._ratios = StrideRatios(log_mean=LOG_RATIO.copy(), variance=ratio_variance)
        # (N_STRIDE_KINDS,) number of strides that each template averages, or is worth
        self._strides = np.full(N_STRIDE_KINDS, _TEMPLATE_STRIDES)
        off, level = _STAIRS_END_SHARE, 1.0 - 2.0 * p.stairs_share
        # (LANDINGS, LANDINGS) probability that a stride from the kind of landing of the row (level, up, down) leads to
        # that of the column
        shares = np.array([[level, p.stairs_share, p.stairs_share], [off, 1.0 - off, 0.0], [off, 0.0, 1.0 - off]])
        # (N_STRIDE_KINDS,) probability of a kind of stride, given where it begins
        self._transition = shares[BEFORE, AFTER]
        self._landing = np.eye(LANDINGS)[LEVEL]  # (LANDINGS,) probability of each kind of the last touch-down
        # stored samples of the running stride: time since its touch-down, s; pitch rate, rad/s; their number
        self._times, self._rates = np.empty(_SAMPLES), np.empty(_SAMPLES)
        self._stored = 0

    @property
    def usual_s(self) -> float:
        """Stride time expected on level ground, s."""
        return math.exp(self._log_stride)

    def begin(self, t_ns: int) -> None:
        """Ends the running stride with a touch-down at `t_ns`, learns from it, and begins the next one.

        Nothing is learned from a stride with a gap or a stop, or one of an impossible duration; the person's stride
        time is then less certain, and the next stride begins on level ground.
        """
        if self.begin_ns >= 0:
            stride_s = (t_ns - self.begin_ns) * 1e-9
            if self.is_regular and self.is_walking and SHORTEST_S <= stride_s < LONGEST_S:
                self._learn(stride_s)
            else:
                self._landing = np.eye(LANDINGS)[LEVEL]  # level for certain
                self._variance = max(self._variance, (0.5 * self._p.stride_sd) ** 2)
        p = self._p
        self.begin_ns, self.is_regular, self.is_walking, self._stored = t_ns, True, True, 0
        # (N_STRIDE_KINDS,) probability of each kind of stride; variance of the logarithm of its time on level ground
        shares, variance = self._landing[BEFORE] * self._transition, self._variance + p.stride_noise**2
        set_prior(self._belief, self._log_stride, variance, p.stand_share, shares, self._ratios)

    def update(self, t_ns: int, interval_s: float, pitch_rate: float) -> None:
        """Updates phase and belief with a pitch rate of the running stride.

        Does nothing while no stride is running. A stride ends without a touch-down when it takes longer than the
        longest stride, or when the person has more likely stopped than not: `is_walking` is then false.

        Args:
            t_ns: Time of the sample.
            interval_s: Time since the sample before, s.
            pitch_rate: rad/s, toes down positive.
        """
        if not self.is_walking:
            return
        p, since_s = self._p, (t_ns - self.begin_ns) * 1e-9
        if since_s >= LONGEST_S:
            self.is_walking = False
            return
        # stored for the template, at intervals above `_SAMPLE_S`
        if self._stored < _SAMPLES and (self._stored == 0 or since_s - self._times[self._stored - 1] > _SAMPLE_S):
            self._times[self._stored], self._rates[self._stored] = since_s, pitch_rate
            self._stored += 1
        # part of an independent observation that this sample is: neighbouring samples deviate alike from the template
        share = min(interval_s, p.max_gap_s) / p.rate_correlation_s
        self.phase, variance, self.rate, stand = weigh_hypotheses(
            self._belief, self._template, since_s, share, pitch_rate, p.rate_noise_rad**2
        )
        self.phase_sd = math.sqrt(variance)
        if stand > 0.5:  # probability that the person has stopped
            self.is_walking = False

    def _learn(self, stride_s: float) -> None:
        """Learns kind, stride time and template from a stride that has ended: docs/gait_phase.md (7)-(9).

        Args:
            stride_s: Duration of the stride, s.
        """
        cell = min(int(np.searchsorted(STRIDE_S, stride_s)), CELLS - 1)
        column = self._belief.walk[:, cell]  # (N_STRIDE_KINDS,) log-weight of each kind, given the stride time
        kind = np.exp(column - column.max())  # (N_STRIDE_KINDS,) probability of each kind, once it sums to 1
        # where all hypotheses of this stride time were as good as impossible, the prior counts too
        kind *= self._landing[BEFORE] * self._transition if column.max() < 0.1 * IMPOSSIBLE else 1.0
        kind = kind / kind.sum()
        ratio_variance = float((kind * self._ratios.variance).sum())
        # docs/gait_phase.md (8): Kalman update of the stride time, and of the ratios of the kinds of stride, all by the
        # difference of the logarithm of the stride time from its mean over the kinds
        innovation = math.log(stride_s) - float((kind * self._ratios.log_mean).sum()) - self._log_stride
        noise = _MEASUREMENT_SD**2
        if innovation**2 > _OUTLIER * (self._variance + ratio_variance + noise):
            noise *= _OUTLIER
        innovation_variance = self._variance + ratio_variance + noise
        self._log_stride += self._variance / innovation_variance * innovation
        self._variance *= 1.0 - self._variance / innovation_variance
        self._variance += _STRIDE_DRIFT**2
        gains = kind * self._ratios.variance / innovation_variance  # (N_STRIDE_KINDS,)
        self._ratios.log_mean[:] += gains * innovation
        self._ratios.variance[:] *= 1.0 - gains
        # docs/gait_phase.md (7): probability of each kind of landing, a sum over the kinds of stride that end with it
        # and at least `_WRONG_SHARE`
        self._landing = np.bincount(AFTER, kind, LANDINGS) * (1.0 - LANDINGS * _WRONG_SHARE) + _WRONG_SHARE
        likely = int(kind.argmax())
        if kind[likely] >= _CERTAIN and self._stored > 1:
            self._learn_template(likely, stride_s)

    def _learn_template(self, kind: int, stride_s: float) -> None:
        """Moves the template of one kind of stride towards the last stride: docs/gait_phase.md (9).

        Args:
            kind: Index of the kind of stride.
            stride_s: Duration of the stride, s; its samples are those stored.
        """
        self._strides[kind] = min(self._strides[kind] + 1.0, _TEMPLATE_MEMORY)
        gain = 1.0 / self._strides[kind]
        stored = slice(self._stored)
        # (BINS,) pitch rate times stride time in the middle of each phase bin, minus the template's
        error = np.interp(_BIN_CENTERS * stride_s, self._times[stored], self._rates[stored]) * stride_s
        error -= self._template.mean[kind]
        # weighted mean and variance with the weight `gain` of the newest stride; `error` is from the mean before it
        self._template.mean[kind] += gain * error
        self._template.variance[kind] += gain * ((1.0 - gain) * np.square(error) - self._template.variance[kind])
