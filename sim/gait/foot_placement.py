"""Footholds along the way: whole soles on the ground, with step lengths adapted before every edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.config import Gait
from stridetwin.sim.gait.tempo import Tempo, paced
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.world.route import RUN_OUT_M, Layout, Strip
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

STEEP_RAD = np.radians(9.0)  # on steeper ramps steps are shorter by `_SHORTER_STEEP` per radian
_SHORTER_STEEP = 2.2
_EDGE_M = 0.01  # between the sole and any edge
_TOE_TO_RISER_M = 0.07
_HEEL_FROM_RISER_M = 0.03
_BEHIND_ON_TREAD_M = 0.022  # going down, the heel stays clear of the riser behind it and the toes overhang the edge
_STOPS_FROM_MPS = 1.2  # faster walkers stop with a shorter last step
_STROLL_STEPS = 9  # on average between two pauses
_PAUSE_S = (0.6, 2.5)
_INTO_PAUSE = 0.35  # of a step: the feet end nearly side by side


@dataclass(frozen=True, kw_only=True)
class Place:
    """A foothold.

    Attributes:
        foot: `l` or `r`.
        s: Arc length along the way, m.
        strip: Strip of ground there.
        pause_s: Time that the walker stands still on both feet after this step, s.
    """

    foot: str
    s: float
    strip: Strip
    pause_s: float = 0.0


def limp(gait: Gait, foot: str) -> float:
    """Relative excess of a foot's step length and step time over the mean."""
    return 1.0 + (gait.asymmetry if foot == "l" else -gait.asymmetry)


def places(layout: Layout, size: Wearer, gait: Gait, tempo: Tempo, rng: np.random.Generator) -> list[Place]:
    """Footholds in order, right foot first, from s = 0 to the end of the route, where the feet end side by side.

    Raises:
        ConfigError: A strip too short for a foot.
    """
    found: list[Place] = []
    for k in range(len(layout.profile)):
        found += _on_strip(layout, k, size, gait, tempo, rng, len(found))
    last = found[-1]
    return [*found, Place(foot=_foot(len(found)), s=last.s, strip=last.strip)]


def _foot(i: int) -> str:
    return "r" if i % 2 == 0 else "l"


def _on_strip(
    layout: Layout, k: int, size: Wearer, gait: Gait, tempo: Tempo, rng: np.random.Generator, first: int
) -> list[Place]:  # fmt: skip
    """Footholds on strip k (none for the two feet that stand at the start); `first` counts those before."""
    profile, strip = layout.profile, layout.profile[k]
    heel, toe = -size.shoe.heel_back_x, size.shoe.toe_tip_x
    last_strip, first_strip = k == len(profile) - 1, strip.s0 < 0.0
    end = strip.s1 - RUN_OUT_M if last_strip else strip.s1
    if strip.s1 <= 0.0:
        return []
    both = gait.stairs == "step_by_step"
    if strip.terrain == "stair":
        # the foot stays clear of the riser, the one in front going up, the one behind going down; a foot longer than
        # the tread overhangs the free edge
        free = 0.8 * (strip.s1 - strip.s0 - heel - toe)
        rising = strip.z0 > profile[k - 1].z1
        ahead, behind = max(free, 1.2 * _EDGE_M), max(free, _BEHIND_ON_TREAD_M)
        s = strip.s1 - ahead - toe if rising else strip.s0 + behind + heel
        return [Place(foot=_foot(first + i), s=s, strip=strip) for i in range(2 if both else 1)]

    def step(s: Array) -> Array:
        steeper = max(abs(strip.slope) - STEEP_RAD, 0)
        return tempo.step(s) * (1.0 if strip.terrain == "level" else 0.92 - _SHORTER_STEEP * steeper)

    def across(s: float) -> float:  # half of the distance that a full step leaves at a bend
        return max((float(tempo.step(s)) - heel - toe) / 2, _EDGE_M)

    riser_before = not first_strip and abs(profile[k - 1].z1 - strip.z0) > 1e-9
    riser_after = not last_strip and abs(profile[k + 1].z0 - strip.z1) > 1e-9
    start = 0.0 if first_strip else strip.s0 + heel + (_HEEL_FROM_RISER_M if riser_before else across(strip.s0))
    if last_strip:
        stop = end
    elif riser_after:
        stop = end - toe - (_TOE_TO_RISER_M if profile[k + 1].z0 > strip.z1 else _EDGE_M)
    else:
        stop = end - toe - across(strip.s1)
    joined = [start] if both and riser_before else []  # the other foot is placed beside the leading one
    led = gait.leading_foot if both and riser_after else None
    if stop < start - 1e-9:
        middle = (strip.s0 + end - toe + heel) / 2
        if end - strip.s0 < heel + toe + 2 * _EDGE_M:
            raise ConfigError(
                "terrain", f"{strip.terrain} at s = {strip.s0:.2f} m", f"{strip.s1 - strip.s0:.2f} m long",
                f"at least {heel + toe + 2 * _EDGE_M:.2f} m, the length of a shoe",
            )  # fmt: skip
        count = len(joined) + 1
        if led is not None and _foot(first + count) != led:
            count += 1
        return [Place(foot=_foot(first + i), s=middle, strip=strip) for i in range(count)]
    lead = 0.7 if first_strip else 0.0  # from standing, the first step is shorter
    along, paces = paced(layout.way, start, stop, step)
    if first_strip:
        count = max(1, round(paces[-1] + 1 - lead))
    else:
        count = max(1, round(paces[-1])) + 1 if paces[-1] > 0.35 else 1
    if led is not None and _foot(first + len(joined) + count) != led:
        count += 1
    feet = [_foot(first + len(joined) + i) for i in range(count)]
    pauses = _pauses(count, strip, gait, rng)
    weights = np.array([limp(gait, foot) for foot in feet]) * np.where(pauses > 0, _INTO_PAUSE, 1.0)
    weights[0] *= lead
    if last_strip:
        weights[-1] *= min(_STOPS_FROM_MPS / gait.speed_mps, 1.0)
    shares = np.cumsum(weights) / weights.sum() if weights.sum() > 0 else np.array([0.5])
    s = np.interp(shares * paces[-1], paces, along)
    if len(s) > 2:
        lengths = np.gradient(s)[1:-1]
        s[1:-1] += np.clip(rng.normal(0.0, gait.step_sd, len(s) - 2), -0.06, 0.06) * lengths
    before = [Place(foot=_foot(first), s=x, strip=strip) for x in joined]
    return before + [Place(foot=f, s=float(x), strip=strip, pause_s=p) for f, x, p in zip(feet, s, pauses.tolist())]


def _pauses(count: int, strip: Strip, gait: Gait, rng: np.random.Generator) -> Array:
    """(count,) s of standing at each foothold of a strip: now and then on the level, away from edges."""
    pauses = np.zeros(count)
    if gait.pattern == "wander" and strip.terrain == "level" and count > 3:
        stands = rng.uniform(size=count) < 1.0 / _STROLL_STEPS
        stands[[0, 1, -2, -1]] = False
        stands[1:] &= ~stands[:-1]
        pauses[stands] = rng.uniform(*_PAUSE_S, size=int(stands.sum()))
    return pauses
