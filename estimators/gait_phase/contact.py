"""Detects touch-downs of a foot from impacts, and its swings from the pitch rate."""

from __future__ import annotations

import math

from stridetwin.estimators.gait_phase.parameters import GaitPhaseParameters
from stridetwin.estimators.gait_phase.stride import StrideFilter
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

Vec3 = tuple[float, float, float]
# Values marked [tuned] are of the walks of `GaitPhaseParameters`.
_SWING_RATE_RADPS = 1.0  # a foot that swings forward pitches up faster than this
_MAX_STEP_S = 0.05  # a change of force over a longer sampling interval gives no jerk
_PEAK_S = 0.12  # an impact's peak follows within this time
_CLIPPED_SHARE = 0.97  # of the range, from which on an axis counts as clipped
_REST_S = 0.15  # a foot that has rested for so long is on the ground for certain
_LANDING_S = 0.06  # time from a soft touch-down until the foot rests
# a foot rests while its pitch rate, and the difference of its specific force from gravity, are no larger
_REST_RATE_RADPS, _REST_FORCE_MPS2 = 0.5, 1.5
_LANDING_PHASE = 0.8  # before which an impact is a knock [tuned]. Larger: strides that are unexpectedly short end late
_FIRST_IMPACT_MPS3 = 6000.0  # usual impact of a person of whom none is known
_IMPACT_MEMORY = 0.3  # weight of the newest impact in the person's usual one
_SWING_RAD = 0.25  # least upward rotation of a foot that swings; a foot that is put aside rotates less
_SWING_SHARE = 0.5  # of the swing's fastest rotation, beyond which the foot still swings and an impact is a knock
_TOE_OFF_SHARE = 0.68  # of the stride, from the touch-down until the pitch rate reverses


class ContactDetector:
    """Touch-downs and swings of one foot: docs/gait_phase.md (1).

    Args:
        parameters: Thresholds.
        force_range_mps2: Largest measurable specific force, m/s²; 0 if unknown.

    Attributes:
        is_swing: The pitch rate has reversed after push-off, and the foot has not touched down since.
    """

    def __init__(self, parameters: GaitPhaseParameters, force_range_mps2: float = 0.0) -> None:
        """Begins with a foot on the ground, of which no sample is known; a force range of 0 is unknown."""
        self._p = parameters
        # magnitude from which on an axis counts as clipped, m/s²
        self._clipped_mps2 = _CLIPPED_SHARE * force_range_mps2 if force_range_mps2 > 0.0 else math.inf
        self.is_swing = False
        self._force: Vec3 = (0.0, 0.0, 0.0)  # specific force of the last sample, m/s²
        self._jerk = [math.nan] * 3  # of the last interval by axis; NaN next to a gap or a limit
        self._consecutive = 0  # number of samples in a row without a gap before them
        self._is_pushing = False  # the foot pitches down fast enough for a push-off
        # time of the last reversal of the pitch rate, the last touch-down and the last sample not at rest; -1 before
        self._reversal_ns = self._touch_down_ns = self._moved_ns = -1
        self._swing_rate = self._swing_rad = 0.0  # fastest (rad/s) and total (rad) upward rotation since the reversal
        self._log_usual_impact = math.log(_FIRST_IMPACT_MPS3)  # mean logarithm of the person's impacts, m/s³
        self._impact = 0.0  # m/s³, largest since the touch-down; 0 once it has entered that mean

    def update(self, t_ns: int, interval_s: float, pitch_rate: float, force: Vec3, stride: StrideFilter) -> int | None:
        """Takes one sample; returns the time of a touch-down, ns, or None.

        In a swing, a foot touches down with an impact that is large enough and not too early or, if it lands softly,
        shortly before it comes to rest. A touch-down in between two swings that was missed is reported late.

        Args:
            t_ns: Time of the sample.
            interval_s: Time since the sample before, s; 0 for the first.
            pitch_rate: Angular rate about the foot's y axis, rad/s, toes down positive.
            force: (3,) m/s², specific force.
            stride: The filter of the running stride.
        """
        impact = self._update_jerk(interval_s, force)  # m/s³
        excess = abs(math.hypot(*force) - STANDARD_GRAVITY_MPS2)  # m/s²; little while the foot rests
        if abs(pitch_rate) > _REST_RATE_RADPS or excess > _REST_FORCE_MPS2:
            self._moved_ns = t_ns
        self._learn_impact(t_ns, impact)
        missed_ns = self._detect_reversal(t_ns, pitch_rate, stride)
        if missed_ns is not None:
            return missed_ns
        if not self.is_swing:
            return None
        self._swing_rad += max(-pitch_rate, 0.0) * interval_s
        self._swing_rate = max(self._swing_rate, -pitch_rate)
        if (t_ns - self._reversal_ns) * 1e-9 < self._p.min_swing_s:  # too early for a touch-down
            return None
        threshold = max(self._p.impact_mps3, self._p.impact_share * math.exp(self._log_usual_impact))  # m/s³
        # an impact early in the stride, before the foot has rotated up, or while it still does so fast is a knock
        is_due = not stride.is_walking or stride.phase >= _LANDING_PHASE
        is_due &= self._swing_rad > _SWING_RAD and pitch_rate > -_SWING_SHARE * self._swing_rate
        if impact > threshold and is_due:
            self._impact = impact
            return self._end_swing(t_ns - round(0.5e9 * interval_s))  # in the middle of the interval
        if (t_ns - self._moved_ns) * 1e-9 > _REST_S:  # a soft touch-down, `_LANDING_S` before the foot began to rest
            return self._end_swing(self._moved_ns - round(1e9 * _LANDING_S))
        return None

    def _end_swing(self, t_ns: int) -> int:
        """Ends the swing by a touch-down at `t_ns`; returns that time or, if that is later, the swing's begin, ns."""
        self.is_swing = self._is_pushing = False
        self._touch_down_ns = max(t_ns, self._reversal_ns)
        return self._touch_down_ns

    def _update_jerk(self, interval_s: float, force: Vec3) -> float:
        """Takes one force; returns by how much the jerk has changed since the interval before, m/s³; 0 after a gap.

        It is s_k of docs/gait_phase.md (1), the length of the vector over the axes. An axis at its limit in one of the
        samples is left out. Force and jerk are stored for the next sample.

        Args:
            interval_s: Time since the sample before, s.
            force: (3,) m/s², specific force.
        """
        is_near = 0.0 < interval_s <= _MAX_STEP_S
        self._consecutive = self._consecutive + 1 if is_near else 0
        square = 0.0
        for axis in range(3):
            now, before = force[axis], self._force[axis]
            is_clipped = max(abs(now), abs(before)) >= self._clipped_mps2
            # where an axis enters or leaves its limit, its jerk changes without any impact
            jerk = (now - before) / interval_s if is_near and not is_clipped else math.nan
            change = jerk - self._jerk[axis]
            self._jerk[axis] = jerk
            if self._consecutive > 1 and not math.isnan(change):
                square += change * change
        self._force = force
        return math.sqrt(square)

    def _learn_impact(self, t_ns: int, impact: float) -> None:
        """Follows the impact of the last touch-down to its peak, which then enters the mean of the person's impacts.

        The peak is the largest change of the jerk within `_PEAK_S` of a touch-down. The mean is one of logarithms.

        Args:
            t_ns: Time of the sample.
            impact: Change of the jerk in this sample, m/s³.
        """
        if self._impact == 0.0:  # no impact since the touch-down that is not averaged yet
            return
        self._impact = max(self._impact, impact)
        if (t_ns - self._touch_down_ns) * 1e-9 > _PEAK_S:
            self._log_usual_impact += _IMPACT_MEMORY * (math.log(self._impact) - self._log_usual_impact)
            self._impact = 0.0

    def _detect_reversal(self, t_ns: int, pitch_rate: float, stride: StrideFilter) -> int | None:
        """Follows the pitch rate through push-off and its reversal, which begins the swing.

        Push-off is a fast rotation toes down, the reversal a rotation toes up after it. A push-off counts only from a
        quarter of a usual stride (in a swing: from a half) after the last touch-down or reversal on.

        Args:
            t_ns: Time of the sample.
            pitch_rate: Angular rate about the foot's y axis, rad/s, toes down positive.
            stride: The filter of the running stride.

        Returns:
            Likely time of a touch-down that was missed, ns, if a swing begins although the last one has not ended;
            else None.
        """
        last_ns = max(self._touch_down_ns, self._reversal_ns)
        waiting_share = 0.5 if self.is_swing else 0.25  # of a usual stride, in which nothing is a push-off
        # whether enough time has passed for a push-off
        is_armed = last_ns < 0 or (t_ns - last_ns) * 1e-9 > waiting_share * stride.usual_s
        if is_armed and pitch_rate > self._p.push_off_radps:
            self._is_pushing = True
        # a foot that pivots in a turn may swing without pushing off
        is_pivot = is_armed and not self.is_swing and pitch_rate < -self._p.push_off_radps
        if not is_pivot and (not self._is_pushing or pitch_rate > -_SWING_RATE_RADPS):
            return None
        self._swing_rate, self._swing_rad = -pitch_rate, 0.0
        has_missed = self.is_swing and stride.begin_ns >= 0  # this swing begins although the last one has not ended
        self.is_swing, self._is_pushing, self._reversal_ns = True, False, t_ns
        if not has_missed:
            return None
        # the usual time from a touch-down to the reversal before now, but not before the last event
        return max(t_ns - round(1e9 * _TOE_OFF_SHARE * stride.usual_s), last_ns)
