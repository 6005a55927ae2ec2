"""Which foot is on the ground since when, and when the next ones land."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from stridetwin.estimators.locomotion_mode.footsteps import SIDE, StepFilter
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters

_OTHER = {"l": "r", "r": "l", "": ""}
SOON_S = 0.05
"""No coming step is told to land sooner."""


@dataclass(frozen=True, kw_only=True)
class Landing:
    """A touch-down.

    Attributes:
        feet: Those that have landed since the last one that was told, the latest last: two where one was not heard.
        after: Whether it lets the last step be measured: it and the one before it were both heard, none was left out.
    """

    feet: tuple[str, ...]
    after: bool


class Rhythm:
    """Touch-downs of both feet in turn; a foot of which nothing is heard any more is led along by the other.

    Args:
        parameters: Step time of someone of whom nothing is known.
    """

    def __init__(self, parameters: LocomotionModeParameters) -> None:
        self._p = p = parameters
        shares = p.step_sd, p.asymmetry_sd, p.step_drift, p.step_noise
        self._time = StepFilter(p.step_s, *(share * p.step_s for share in shares))
        self.foot, self.down_ns, self.step = "", -1, 0
        self._silent = ""  # foot whose insole has told nothing of its last step
        self._guessed, self._heard_ns = False, -1  # whether no insole told of the last touch-down; when one last did

    @property
    def step_s(self) -> float:
        """Expected time of a step, s."""
        return self._time.mean

    def overdue(self, t_ns: int) -> str | None:
        """The foot of which nothing is heard where it must be down by now: the other one is about to be lifted."""
        waited = (t_ns - self.down_ns) * 1e-9
        there = bool(self._silent) and self.foot == _OTHER[self._silent] and waited > self._time.mean
        return self._silent if there else None

    def over_foot(self, t_ns: int) -> bool:
        """Whether the body has passed over the standing foot by now."""
        return self.down_ns >= 0 and (t_ns - self.down_ns) * 1e-9 > self._p.over_foot_share * self._time.mean

    def land(self, foot: str, t_ns: int, heard: bool) -> Landing | None:
        """A foot touches down.

        Args:
            foot: `l` or `r`.
            t_ns: When.
            heard: Whether its insole tells so.

        Returns:
            None where it only bounced.
        """
        elapsed, missed = (t_ns - self.down_ns) * 1e-9, False
        if heard and foot == self._silent:
            self._silent = ""
        if foot == self.foot:
            if elapsed < self._p.bounce_share * self._time.mean:
                return None
            missed = elapsed > self._p.missed_steps * self._time.mean
        if missed:
            self._silent = _OTHER[foot]
        first = self.down_ns < 0
        after = heard and not (missed or first or self._guessed)
        if heard:
            since, steps = (self._heard_ns, 2) if self._guessed else (self.down_ns, 1 + missed)
            seconds = (t_ns - since) * 1e-9
            if not first and seconds < self._p.pause_steps * self._p.step_s:
                self._time.update(SIDE["" if self._guessed else foot], seconds / steps)
            self._heard_ns = t_ns
        self._guessed = not heard
        self.foot, self.down_ns, self.step = foot, t_ns, self.step + 1 + missed
        return Landing(feet=(_OTHER[foot], foot) if missed else (foot,), after=after)

    def coming(self) -> tuple[str, ...]:
        """Feet of the coming steps."""
        return tuple(_OTHER[self.foot] if k % 2 == 0 else self.foot for k in range(self._p.steps))

    def times(self, feet: Sequence[str], t_ns: int) -> list[tuple[int, float]]:
        """When each coming step lands, ns, and its deviation, s."""
        found = []
        at = float(self.down_ns if self.down_ns >= 0 else t_ns)
        variance = 0.0
        for foot in feet:
            at = max(at + 1e9 * self._time.of(SIDE[foot]), t_ns + 1e9 * SOON_S)
            variance += (self._p.step_noise * self._time.mean) ** 2
            found.append((int(at), math.sqrt(variance + self._time.sd**2)))
        return found
