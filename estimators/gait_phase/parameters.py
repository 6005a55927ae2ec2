"""Parameters of the gait phase estimator: one set for every person, sensor, rate and terrain.

Numbers that no user needs are constants of the modules that use them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from stridetwin.streams.errors import check_numbers


@dataclass(frozen=True, kw_only=True)
class GaitPhaseParameters:
    """Values marked [tuned] were chosen on kinematic twin walks of seeds 0 to 99; the others bound human walking.

    None is sensitive: half or double a [tuned] value changes RMS errors by at most a tenth on level ground, and by a
    sixth on stairs.
    """

    stride_s: float = 1.15
    """Stride time expected of an unknown person on level ground, s; the mean of people at 0.5 to 1.9 m/s. Doubled: the
    first stride is predicted too slow, later ones are not."""
    stride_sd: float = 0.2
    """Standard deviation of the logarithm of the stride time between people and speeds. Doubled: the first
    stride is less certain."""
    stride_noise: float = 0.025
    """Standard deviation of the logarithm of single stride times about the person's mean. [tuned] Doubled: the phase
    follows the pitch rate more, and earlier strides less."""
    stairs_share: float = 0.04
    """Probability that a stride on the level leads onto a stair up, and that it leads onto one down. [tuned]
    Doubled: the first strides onto stairs are recognised earlier, level ones are less certain."""
    stand_share: float = 0.01
    """Probability that the person stops after a touch-down. Doubled: a stop is recognised some 20 ms earlier."""
    rate_correlation_s: float = 0.15
    """Correlation time of the pitch rate's deviation from the template, s. [tuned] Doubled: the pitch rate counts half,
    and first strides onto stairs are recognised later."""
    rate_noise_rad: float = 0.4
    """Standard deviation of the pitch rate times stride time that is added to the template's, rad. [tuned] Doubled:
    small differences in stance count less."""
    impact_mps3: float = 800.0
    """Least change of the jerk that counts as an impact, m/s³: sensors that filter reach 400 to 600 in the swing and
    2000 at landings (real walks). Doubled: soft landings are found only when the foot rests, 0.1 s late."""
    impact_share: float = 0.15
    """Least such change as a share of the person's usual impact. [tuned] Doubled: the brakes of a fast foot
    in the air are no impacts, landings softer than usual are found late."""
    push_off_radps: float = 1.5
    """Pitch rate that a push-off exceeds, rad/s; shuffling feet reach 2. Doubled: short steps are missed."""
    min_swing_s: float = 0.12
    """Least time from the reversal of the pitch rate after push-off to the touch-down, s; the fastest walkers take 0.2.
    Doubled: their touch-downs are found late."""
    max_gap_s: float = 0.15
    """After a longer gap in the samples nothing is learned from the running stride, s, as a touch-down may be missing.
    Doubled: a wrong stride time may be learned."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0."""
        check_numbers("GaitPhaseParameters", asdict(self))
