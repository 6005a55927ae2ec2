"""Walking backwards: back along the way, over edges where footholds are, and forwards again to where it began.

The foot lands on its toes, lowers the heel while the body comes over it, and leaves with the heel last, nearly as
walking forwards in reverse (Winter, Pluck & Yang 1989, J Mot Behav 21:291-305).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from stridetwin.sim.acts import Backwards
from stridetwin.sim.gait.foot_placement import Foothold
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.terrain_truth import Strip
from stridetwin.streams.way import Way

# Chosen by hand, after the shorter and slower strides of people who walk backwards (Laufer 2005, J Gerontol A
# 60:627-632; Winter et al. 1989).
_LONGEST_M = 0.42  # of one step
_STEP_S = 0.64  # time of one step
_OVER_EDGE_S = 1.05  # likewise, over a riser
_TURN_ROUND_S = 0.4  # of standing before the first step, and at least before walking forwards again
_FORWARD_STEP_M = 0.55  # about, of the steps with which the walker returns
_MAX_BEND_RAD = 0.02  # of the way along which a walker goes backwards


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A place for a foot along the way.

    Attributes:
        s: Arc length, m.
        strip: Strip of ground there.
    """

    s: float
    strip: Strip


def place_backward_steps(act: Backwards, earlier: Sequence[Foothold], here: Foothold, way: Way) -> list[Foothold]:
    """Footholds of walking backwards and of the way forwards again to the last of the `earlier` footholds.

    Args:
        act: The act.
        earlier: Footholds of walking up to that at which it begins, in order; at least two.
        here: The last of them with the walker's place beside the way.
        way: The way.

    Raises:
        ConfigError: The way there is too short, or bends.
    """
    hold = earlier[-1]
    if act.for_m > hold.s:
        raise ConfigError("gait", "acts.for_m", act.for_m, f"at most {hold.s:.2f} m, back to the start of the way")
    if abs(float(way.heading(hold.s) - way.heading(hold.s - act.for_m))) > _MAX_BEND_RAD:
        raise ConfigError("gait", "acts.for_m", act.for_m, "less, so that the way there is straight")
    runs = _runs(earlier)
    back, reached = _go_back(runs, hold.s - act.for_m)
    forward = _go_forward(runs[reached:], back[-1].s, hold, earlier)
    # the rear foot closes up first if the next step leads over an edge, or if the feet would not alternate after it
    closes = back[0].strip is not hold.strip
    count = closes + len(back) + 1 + len(forward)
    if count % 2 and not closes:
        closes = True
    elif count % 2:  # one more step forwards, on the spot
        forward = [_Place(s=back[-1].s, strip=back[-1].strip), *forward]
    steps: list[Foothold] = []

    def add(place: _Place, manner: str) -> None:
        """Appends a step of the foot whose turn it is, whose last place is that of the foothold before the last."""
        before = [*earlier[-2:], *steps][-2]
        over_edge = before.strip is not place.strip
        time_s = 0.0 if manner == "walk" else _OVER_EDGE_S if over_edge else _STEP_S
        step = replace(here, foot=before.foot, s=place.s, strip=place.strip, manner=manner, time_s=time_s)
        steps.append(replace(step, pause_s=0.0, act=None, twist=None))

    if closes:
        add(_Place(s=hold.s, strip=hold.strip), "place")
    for place in [*back, back[-1]]:
        add(place, "back")
    steps[-1] = replace(steps[-1], pause_s=max(act.for_s, _TURN_ROUND_S))
    for place in forward:
        add(place, "walk")
    return steps


def stand_before(hold: Foothold) -> Foothold:
    """The foothold at which a walker stands for a moment before walking backwards."""
    return replace(hold, pause_s=hold.pause_s + _TURN_ROUND_S)


def _runs(earlier: Sequence[Foothold]) -> list[tuple[Strip, float, float]]:
    """Each strip on the way so far, with the first and the last place for a foot on it, m; the first one is 0."""
    runs: list[tuple[Strip, float, float]] = []
    for hold in earlier:
        if runs and runs[-1][0] is hold.strip:
            runs[-1] = (hold.strip, runs[-1][1], max(runs[-1][2], hold.s))
        else:
            runs.append((hold.strip, hold.s if runs else 0.0, hold.s))
    return runs


def _go_back(runs: Sequence[tuple[Strip, float, float]], goal_m: float) -> tuple[list[_Place], int]:
    """Places of the steps backwards to about the arc length `goal_m`, m, and the number of the run that they reach."""
    k, now = len(runs) - 1, runs[-1][2]
    places: list[_Place] = []
    while True:
        strip, first, _ = runs[k]
        end = max(goal_m, first)
        places += _divide(now, end, strip, math.ceil((now - end) / _LONGEST_M - 1e-9))
        if k == 0 or goal_m > 0.5 * (first + runs[k - 1][2]):
            break
        k -= 1
        strip, _, now = runs[k]
        places.append(_Place(s=now, strip=strip))
    if not places:
        places = [_Place(s=now, strip=strip)]
    return places, k


def _go_forward(
    runs: Sequence[tuple[Strip, float, float]], start_m: float, hold: Foothold, earlier: Sequence[Foothold]
) -> list[_Place]:
    """Places of the steps from the arc length `start_m`, m, on the first of the runs to the foothold `hold`."""
    strip, _, last = runs[0]
    places = _divide(start_m, last, strip, max(round((last - start_m) / _FORWARD_STEP_M), int(last - start_m > 0.05)))
    later = {id(run[0]) for run in runs[1:]}
    return places + [_Place(s=h.s, strip=h.strip) for h in earlier if id(h.strip) in later and h.s <= hold.s]


def _divide(start_m: float, end_m: float, strip: Strip, count: int) -> list[_Place]:
    """The ends of `count` equal steps between two arc lengths of a strip, m."""
    return [_Place(s=start_m + (end_m - start_m) * (i + 1) / count, strip=strip) for i in range(count)]
