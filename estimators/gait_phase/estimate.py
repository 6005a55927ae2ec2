"""What the gait phase estimator returns after each sample."""

from __future__ import annotations

from dataclasses import dataclass

UNKNOWN_PHASE_SD = 12.0**-0.5
"""Standard deviation of a phase of which nothing is known: uniform between 0 and 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseEstimate:
    """Gait phase of one leg after one sample.

    Attributes:
        t_ns: Time of the sample, ns.
        phase: Share of the gait cycle since the last touch-down of the foot, in [0, 1); 0 if not `walking`.
        phase_sd: Standard deviation of `phase`, as a share of the cycle; `UNKNOWN_PHASE_SD` if not `walking`.
        rate: Expected phase rate, 1/s: one over the time of the running stride; 0 if not `walking`.
        walking: Whether a stride is running: the foot has touched down after a swing and the person has not stopped.
        swing: Whether the foot is in the air: from where its pitch rate reverses after push-off (about 4 % of the cycle
            after toe-off) until it touches down.
        touch_down_ns: Time of the last touch-down, ns, which `phase` counts from; -1 before the first one.
    """

    t_ns: int
    phase: float
    phase_sd: float
    rate: float
    walking: bool
    swing: bool
    touch_down_ns: int
