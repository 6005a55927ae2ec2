"""Detects touch-downs from pressure insoles, predicts the next ones, and estimates mean step times and lengths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.streams.samples import Array, Insole

SIDE = {"l": 1.0, "r": -1.0, "": 0.0}
"""Sign of each foot, left positive; 0 if unknown."""
CLIMB = {"RA": 1.0, "RD": -1.0}
"""Sign of each kind of ramp, upward positive."""
STEP_DRIFT = 0.05
"""Random walk of the mean length and time per step, as a share of the step."""
_ASYMMETRY_SD = 0.03
"""Standard deviation between walkers of left steps' excess over the mean, as a share of the step."""
_OUTLIER_SD = 2.0
"""Standard deviations beyond which a step gets less weight in the mean."""
SOON_S = 0.05
"""Shortest predicted time to a landing."""
_CREEP_NPS = 4.0
"""Largest rate at which an insole's zero rises."""
_MIN_SWING_S = 0.12
"""Shortest swing; a foot that returns sooner has not left the ground. Doubled: nothing at swings of 0.4 s."""
_LIFT_SHARE = 0.1
"""A foot whose load falls below this share of its recent largest load has left the ground."""
_PEAK_LOAD_S = 5.0
"""Time constant with which that largest load is forgotten."""
_MAX_FORCE_N = 5000.0
"""A larger load is invalid."""
_BOUNCE_SHARE = 0.6
"""Share of a step time within which a second touch-down of one foot is a bounce."""
_MISSED_STEPS = 1.4
"""Step times after which a second touch-down of one foot implies a missed step of the other."""
_OVER_FOOT_SHARE = 0.6
"""Share of a step time after which the body has passed over the foot."""
_SWING_SHARE = 0.7
"""Share of a step time for which a foot is in the air: 0.4 s of 0.58 s."""
_PAUSE_STEPS = 3.0
"""Usual step times after which a touch-down does not update the rhythm."""


class StepFilter:
    """Estimates the mean of steps of two kinds, such as left and right, and half the difference between the kinds.

    The mean drifts from step to step, and single steps scatter about it.

    Args:
        mean: Prior mean.
        sd: Standard deviation between walkers.
        asymmetry_sd: Standard deviation of half the difference.
        drift: Standard deviation of the mean's change from step to step.
        noise: Standard deviation of a step from the mean.
    """

    def __init__(self, mean: float, sd: float, asymmetry_sd: float, drift: float, noise: float) -> None:
        """Begins with the prior of the mean, and a difference of 0 between the kinds."""
        self._x = np.array([mean, 0.0])  # (2,) mean, and half the difference between the kinds
        self._P = np.diag([sd**2, asymmetry_sd**2])  # covariance of the two
        self._drift, self._noise = drift, noise

    def update(self, kind: float, value: float, value_sd: float = 0.0, sure: float = 1.0) -> None:
        """Updates mean and difference of the kinds with one step: docs/locomotion_mode.md (4).

        It is a Kalman update of the state (mean, half the difference) by `value` = mean + kind · half the difference.
        An outlier, such as a step into a pause, gets less weight. A step that is surely not comparable only adds the
        drift of the mean.

        Args:
            kind: 1 or -1 (`SIDE`, `CLIMB`), 0 if unknown.
            value: Length or time of the step.
            value_sd: Standard deviation of that value.
            sure: Probability that the step is comparable to the others, 0-1.
        """
        self._P[0, 0] += self._drift**2
        if sure <= 0.0:
            return
        J = np.array([1.0, kind])  # derivative of the value by the state
        noise = (self._noise**2 + value_sd**2) / sure
        innovation = value - float(J @ self._x)
        variance = float(J @ self._P @ J) + noise  # of the innovation
        # An outlier, such as a step into a pause or beside an obstacle, gets less weight.
        variance *= max(1.0, innovation**2 / (_OUTLIER_SD**2 * variance))
        gain: Array = self._P @ J / variance
        self._x = self._x + gain * innovation
        self._P = self._P - np.outer(gain, J @ self._P)
        self._P = 0.5 * (self._P + self._P.T)

    def mean(self, kind: float = 0.0) -> float:
        """Expected step of a kind (1 or -1); 0 means of either kind."""
        return float(self._x[0] + kind * self._x[1])

    def sd(self, kind: float = 0.0) -> float:
        """Standard deviation of the expected step of a kind (1 or -1); 0 means of either kind."""
        J = np.array([1.0, kind])
        return math.sqrt(max(float(J @ self._P @ J), 0.0))


def usual_steps(usual: float, settings: Settings) -> StepFilter:
    """A filter of the length or time of left and right steps, before any step is known.

    Its standard deviations are shares of the prior mean `usual`, m or s.
    """
    p = settings.mode
    return StepFilter(
        mean=usual,
        sd=p.step_sd * usual,
        asymmetry_sd=_ASYMMETRY_SD * usual,
        drift=STEP_DRIFT * usual,
        noise=p.step_noise * usual,
    )


FOOT_OF_TOPIC = {"/foot_l/insole": "l", "/foot_r/insole": "r"}


@dataclass
class _Foot:
    """Load of one insole, and whether the foot is down.

    Attributes:
        t_ns: Time of the last sample; -1 before the first.
        least: Recent minimum of the load, N: the insole's zero.
        most: Recent maximum of the load, N.
        down: Whether the foot is down.
        raised_ns: Time of the last lift-off.
    """

    t_ns: int = -1
    least: float = 0.0
    most: float = 0.0
    down: bool = True
    raised_ns: int = 0


class TouchDowns:
    """Detects touch-downs.

    An unloaded insole does not report zero: cells creep and drift. A foot has left the ground when its load has fallen
    near its recent minimum, or, because that is unknown at the start, to a small share of its maximum. It is down again
    when the load has risen from there by `touch_n`. Samples that are late, repeated, not finite or out of range are
    ignored.

    Args:
        settings: Loads, and the shortest swing.
    """

    def __init__(self, settings: Settings) -> None:
        """Begins with both feet down, of which no sample is known."""
        self._p = settings.mode
        self._feet = {foot: _Foot() for foot in FOOT_OF_TOPIC.values()}

    def find_lift_off_ns(self, foot: str) -> int | None:
        """Time at which a foot, `l` or `r`, left the ground; None while it is down, or unknown."""
        state = self._feet.get(foot)
        return None if state is None or state.down else state.raised_ns

    def update(self, sample: Insole) -> str | None:
        """The foot, `l` or `r`, that touches down with this sample, else None.

        A touch-down after too short a swing is not reported: the foot had not left the ground.
        """
        foot = self._feet.get(FOOT_OF_TOPIC.get(sample.topic, ""))  # None for an unknown topic
        load = float(sample.force.sum())
        if foot is None or sample.t_ns <= foot.t_ns or not 0.0 <= load < _MAX_FORCE_N:
            return None
        dt = (sample.t_ns - foot.t_ns) * 1e-9 if foot.t_ns >= 0 else 0.0
        foot.t_ns = sample.t_ns
        foot.least = min(load, foot.least + _CREEP_NPS * dt)  # the zero may creep upwards
        foot.most = max(load, foot.most * math.exp(-dt / _PEAK_LOAD_S))  # the largest load is forgotten in time
        over = load - foot.least  # load above the insole's zero, N
        if foot.down:
            if over < self._p.lift_n or load < _LIFT_SHARE * foot.most:
                foot.down, foot.raised_ns, foot.least = False, sample.t_ns, load
            return None
        if over < self._p.touch_n:
            return None
        foot.down = True
        in_air_s = (sample.t_ns - foot.raised_ns) * 1e-9
        return FOOT_OF_TOPIC[sample.topic] if in_air_s >= _MIN_SWING_S else None


_OTHER = {"l": "r", "r": "l", "": ""}
"""The other foot; "" is an unknown one."""


@dataclass(frozen=True, kw_only=True)
class StepLanding:
    """A touch-down.

    Attributes:
        feet: Feet landed since the last reported one, the latest last; two if one was not detected.
        measurable: Whether the last step can be measured: it and the previous one were both detected, none is missing.
    """

    feet: tuple[str, ...]
    measurable: bool


class StepRhythm:
    """Alternating touch-downs of both feet; a foot without detections is predicted from the other.

    Args:
        settings: Prior of the step time, and number of predicted steps.

    Attributes:
        foot: Foot that touched down last, "" before the first.
        down_ns: Time of that touch-down; -1 before the first.
        step: Number of touch-downs.
    """

    def __init__(self, settings: Settings) -> None:
        """Begins before the first touch-down, with the prior of the step time."""
        self._p = settings.mode
        self._time = usual_steps(self._p.step_s, settings)  # time of a step of either foot, s
        self.foot, self.down_ns, self.step = "", -1, 0
        self._undetected = ""  # foot whose insole did not detect its last step; "" if there is none
        self._inferred = False  # whether the last touch-down was inferred rather than detected
        self._detected_ns = -1  # time of the last detected touch-down

    @property
    def step_s(self) -> float:
        """Expected time of a step, s."""
        return self._time.mean()

    def overdue_foot(self, t_ns: int) -> str | None:
        """The undetected foot that must be down by now, because the other one is about to lift off; else None.

        That is so one step time after the other foot's touch-down.
        """
        waited_s = (t_ns - self.down_ns) * 1e-9
        is_next = bool(self._undetected) and self.foot == _OTHER[self._undetected]
        return self._undetected if is_next and waited_s > self._time.mean() else None

    def is_over_foot(self, t_ns: int) -> bool:
        """Whether the body has passed over the stance foot by now."""
        return self.down_ns >= 0 and (t_ns - self.down_ns) * 1e-9 > _OVER_FOOT_SHARE * self._time.mean()

    def land(self, foot: str, t_ns: int, detected: bool) -> StepLanding | None:
        """Records a touch-down, detected by the foot's insole or inferred from the other foot.

        Two touch-downs of one foot in a row, far enough apart, mean that a step of the other foot was missed: its
        insole counts as not detecting, until it detects again. A detected touch-down after a time that is no pause
        updates the step time.

        Args:
            foot: `l` or `r`.
            t_ns: Time of the touch-down.
            detected: Whether it was detected rather than inferred.

        Returns:
            The landing; None if the foot only bounced.
        """
        # s since the last touch-down of either foot; whether a step of the other foot was missed in between
        elapsed, missed = (t_ns - self.down_ns) * 1e-9, False
        if detected and foot == self._undetected:
            self._undetected = ""
        if foot == self.foot:
            if elapsed < _BOUNCE_SHARE * self._time.mean():
                return None
            missed = elapsed > _MISSED_STEPS * self._time.mean()
        if missed:
            self._undetected = _OTHER[foot]
        first = self.down_ns < 0
        measurable = detected and not (missed or first or self._inferred)
        if detected:
            # An inferred touch-down has no exact time: the time since the last detection is then that of two steps. If
            # a step was missed, the time since the last touch-down is that of two.
            since, steps = (self._detected_ns, 2) if self._inferred else (self.down_ns, 1 + missed)
            seconds = (t_ns - since) * 1e-9
            if not first and seconds < _PAUSE_STEPS * self._p.step_s:
                self._time.update(SIDE["" if self._inferred else foot], seconds / steps)
            self._detected_ns = t_ns
        self._inferred = not detected
        self.foot, self.down_ns, self.step = foot, t_ns, self.step + 1 + missed
        return StepLanding(feet=(_OTHER[foot], foot) if missed else (foot,), measurable=measurable)

    def next_feet(self) -> tuple[str, ...]:
        """`l` or `r` of each coming step; "" while the next foot is unknown."""
        # the other foot first, then alternately
        return tuple(_OTHER[self.foot] if k % 2 == 0 else self.foot for k in range(self._p.steps))

    def swing_end_s(self, raised_ns: int, t_ns: int) -> float:
        """Time until a foot in the air lands, s: after a step time, or after a usual swing if it was raised late."""
        step_end_ns = self.down_ns + 1e9 * self._time.mean() if self.down_ns >= 0 else t_ns
        swing_end_ns = raised_ns + 1e9 * _SWING_SHARE * self._time.mean()
        return max((max(step_end_ns, swing_end_ns) - t_ns) * 1e-9, SOON_S)

    def times(self, feet: Sequence[str], t_ns: int) -> list[tuple[int, float]]:
        """Landing time of each coming step, ns, and its standard deviation, s.

        A landing that is overdue is expected in `SOON_S`.

        Args:
            feet: Foot of each coming step, as from `next_feet`.
            t_ns: Present time.
        """
        landings = []
        at_ns = float(self.down_ns if self.down_ns >= 0 else t_ns)
        variance = 0.0  # of all single steps up to this one, s²
        for foot in feet:
            at_ns = max(at_ns + 1e9 * self._time.mean(SIDE[foot]), t_ns + 1e9 * SOON_S)
            variance += (self._p.step_noise * self._time.mean()) ** 2
            landings.append((int(at_ns), math.sqrt(variance + self._time.sd() ** 2)))
        return landings
