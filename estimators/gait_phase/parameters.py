"""Parameters of the gait phase estimator: one set for every person, sensor, rate and terrain."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from stridetwin.streams.errors import check_numbers


@dataclass(frozen=True, kw_only=True)
class GaitPhaseParameters:
    """Values marked [tuned] were chosen on twin walks of seeds below 1000; the others are bounds of human walking."""

    stride_s: float = 1.15
    """Stride time expected of an unknown person, s; the mean of the twin's people at 0.5 to 1.9 m/s. Doubled: the first
    stride is predicted too slow, later ones not."""
    stride_sd: float = 0.2
    """Standard deviation of its logarithm between people and speeds. Doubled: the first stride is less certain."""
    stride_noise: float = 0.025
    """Standard deviation of a stride time's logarithm about the person's current mean. [tuned] Doubled: the phase relies
    more on the pitch rate and less on earlier strides."""
    stride_drift: float = 0.03
    """Change of that mean from stride to stride, in logarithms. [tuned] Doubled: the mean follows a change of pace
    sooner and is noisier."""
    irregular_share: float = 0.15
    """Probability of a stride of quite another length, such as the first and the last. [tuned] Doubled: such strides are
    recognised earlier, regular ones are less certain."""
    irregular_sd: float = 0.15
    """Standard deviation of such a stride time's logarithm. [tuned]"""
    stairs_share: float = 0.04
    """Probability that a stride on the level leads onto a stair up; the same down. [tuned] Doubled: first stair strides
    are recognised earlier, level ones are less certain."""
    stairs_end_share: float = 0.4
    """Probability that a stride on stairs leads off them. [tuned] Doubled: long flights are less certain."""
    stand_share: float = 0.01
    """Probability that a touch-down is the last one before the person stands. Doubled: a stop is recognised earlier."""
    rate_correlation_s: float = 0.15
    """Correlation time of the pitch rate's deviation from the template, s. [tuned] Doubled: the pitch rate counts half."""
    rate_noise_rad: float = 0.4
    """Deviation from the template beyond its learned one, rad per cycle. [tuned] Doubled: stance tells less."""
    template_strides: float = 3.0
    """Number of the person's own strides that the template of all people is worth. [tuned] Doubled: a person's manner is
    learned more slowly."""
    template_memory: float = 20.0
    """Number of strides over which the learned template averages. Doubled: a change of manner is learned more slowly."""
    impact_mps3: float = 800.0
    """Least change of jerk that counts as a touch-down, m/s³; filtered sensors on slow feet reach 1100 (twin, real
    walks). Doubled: soft landings are missed and found later by the quiet stance."""
    impact_share: float = 0.2
    """The same as a share of the person's usual one, for fast feet, which brake in the air. [tuned]"""
    push_off_radps: float = 1.5
    """Pitch rate that a push-off exceeds, rad/s; shuffling feet reach 2. Doubled: short steps are missed."""
    min_swing_s: float = 0.12
    """Least time from the reversal of the pitch rate after push-off to the touch-down, s: the toe's scuff comes before,
    the fastest walkers land after 0.2 s."""
    landing_phase: float = 0.8
    """Phase before which an impact is no touch-down. [tuned]"""
    max_gap_s: float = 0.15
    """After a longer gap in the samples the running stride is not learned from, s: a touch-down may be missing."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0."""
        check_numbers("GaitPhaseParameters", asdict(self))
