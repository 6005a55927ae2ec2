"""Speed of the walker along the way, and footholds: whole soles on the ground, steps adapted before every edge.

Curves are walked slower, with shorter, wider steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.acts import Act, Hesitate
from stridetwin.sim.config import Gait, Stop
from stridetwin.sim.gait.running import run_step_s
from stridetwin.sim.gait.style import leg_length, pace, shuffle_step_share, walk_growth
from stridetwin.sim.gait.twist import Twist
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.world.route import RUN_OUT_M
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, Strip
from stridetwin.streams.way import Way

_PLANNING_M = 0.005  # distance between the arc lengths at which steps are counted
_GRID_M = 0.1  # distance between those at which the speed is planned


# Speed and step length; chosen by hand where no source is named.
_MAX_TURN_PER_STEP_RAD = np.radians(30.0)  # largest change of heading in one step
_STRAIGHT_RADIUS_M = 3.0  # radius from which a curve is walked at full speed
_MIN_SPEED_SHARE = 0.4  # share of the speed, in the tightest curve
_WIDER_M = 0.045  # on each side at the sharpest turn, so that the outer foot does not tread on the inner one
_STEP_AT_PACE_1 = 1.05  # leg lengths, by the walk ratio: 0.66 m at 1.2 m/s for a person of 1.75 m
_BRISK_MPS = 1.2  # speed limit near standing, on ramps and in tight bends
_TO_RISER_MPS = 0.9  # speed limit where stairs begin and end: their steps are slow
_TIGHT_RADIUS_M = 2.0  # radius of a tight bend
_MAX_ACCELERATION_MPS2 = 0.5  # largest acceleration
_MAX_STAIR_MPS = 1.6  # speed limit for the cadence on stairs
_RUN_FROM_STAND_MPS = 1.4  # speed limit of a run near standing
_RUN_IN_BENDS_MPS = 1.7  # likewise, in tight bends
_RUN_ACCELERATION_MPS2 = 1.5  # largest acceleration of a run
_MIN_SHUFFLE_STEP_S = 0.48  # shortest step at full shuffle
_STROLL_SPEED_SD = 0.20  # speed of a stroll: SD as a fraction
_STROLL_SPEED_M = 2.0  # distance over which it changes


def speed_share(way: Way, s: Array) -> Array:
    """(...) speed in a curve relative to a straight way: (r / 3 m)^(1/3), from 0.4 to 1 (Hicheur et al. 2005)."""
    radius = 1.0 / np.maximum(np.abs(way.curvature(s)), 1e-6)  # m; very large on a straight way
    return np.clip(np.cbrt(radius / _STRAIGHT_RADIUS_M), _MIN_SPEED_SHARE, 1.0)


def turn_share(way: Way, s0: float, s1: float) -> float:
    """Change of heading between two arc lengths, as a share of the largest change that one step makes."""
    return abs(float(way.heading(s1) - way.heading(s0))) / _MAX_TURN_PER_STEP_RAD


def widening(way: Way, s0: float, s1: float) -> float:
    """Additional lateral distance of a foot from the way, m, for a turn between the arc lengths `s0` and `s1`, m.

    It is in proportion to the turn, up to `_WIDER_M` for the largest turn of one step.
    """
    return _WIDER_M * min(turn_share(way, s0, s1), 1.0)


def count_steps(
    way: Way, start: float, stop: float, step: Callable[[Array], Array], shorter: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Number of steps along the way, as a function of the arc length.

    It integrates the steps per metre, 1 / (`step(s)` `shorter(s)`), and at least as many as keep the turn of each step
    below the largest one.

    Args:
        way: The way.
        start: First arc length, m.
        stop: Last arc length, m.
        step: Step length, m, on a straight way at (N,) arc lengths.
        shorter: Step length there relative to that of a straight way.

    Returns:
        (N,) m, arc lengths from `start` to `stop`, and (N,) steps from `start` to each, which are fractional.
    """
    s = np.linspace(start, stop, 2 + int((stop - start) / _PLANNING_M))
    middle = (s[1:] + s[:-1]) / 2
    steps_to_turn = np.abs(way.curvature(middle)) / _MAX_TURN_PER_STEP_RAD  # fewest steps per metre for the turn
    density = np.maximum(1.0 / (step(middle) * shorter(middle)), steps_to_turn)
    return s, np.concatenate([[0.0], np.cumsum(density * np.diff(s))])


@dataclass(frozen=True, kw_only=True, eq=False)
class Tempo:
    """Speed and step length along the way.

    Attributes:
        size: Wearer.
        gait: Gait of the person.
        slow: (K,) arc lengths with a speed limit `most`: the start, the end, stairs, ramps and tight bends.
        most: (K,) m/s, the speed limits.
        grid: (N,) m, arc lengths of `share`.
        share: (N,) speed relative to the preferred one.
        way: The way.
    """

    size: Wearer
    gait: Gait
    slow: Array
    most: Array
    grid: Array
    share: Array
    way: Way

    @classmethod
    def along(cls, layout: Layout, size: Wearer, gait: Gait, rng: np.random.Generator) -> Tempo:
        """Plans the tempo of one walk; only a wandering walk uses random numbers.

        Args:
            layout: Route in the world.
            size: Wearer.
            gait: Gait of the person.
            rng: Draws the wobble of a wandering walker's speed.
        """
        profile = layout.profile
        end = profile[-1].s1 - RUN_OUT_M
        # arc lengths on stairs and ramps, and those of the risers, where one strip ends lower or higher than the next
        uneven = [np.arange(strip.s0, strip.s1 + _GRID_M, _GRID_M) for strip in profile if strip.terrain != "level"]
        risers = [a.s1 for a, b in pairwise(profile) if a.z1 != b.z0]
        grid = np.arange(0.0, end + _GRID_M, _GRID_M)
        tight = grid[np.abs(layout.way.curvature(grid)) > 1.0 / _TIGHT_RADIUS_M]
        # places with a speed limit; the limit of the first ones, the risers, is lower
        slow = np.concatenate([risers, [0.0, end], tight, *uneven])
        most = np.full(len(slow), _BRISK_MPS)
        if gait.pattern == "run":
            most[:] = np.where(np.isin(slow, tight), _RUN_IN_BENDS_MPS, _RUN_FROM_STAND_MPS)
        most[: len(risers)] = _TO_RISER_MPS
        share = np.ones_like(grid)
        if gait.pattern == "wander":
            smoothing = _STROLL_SPEED_M / _GRID_M
            wobble = gaussian_filter1d(rng.standard_normal(len(grid)), smoothing, mode="reflect")
            # `wobble` over its SD, which is 1 / √(2 √π `smoothing`) after a Gaussian filter of white noise; the SD of
            # these values alone would be too small on a short way
            share = np.exp(_STROLL_SPEED_SD * wobble * np.sqrt(2.0 * np.sqrt(np.pi) * smoothing))
        return cls(size=size, gait=gait, slow=slow, most=most, grid=grid, share=share, way=layout.way)

    def speed(self, s: Array | float) -> Array:
        """(...) m/s, planned speed on a straight way at (...) arc lengths.

        It is the preferred speed, but never above √(v² + 2 a d) at a distance d from a place with the speed limit v.
        """
        away = np.abs(np.asarray(s, dtype=float)[..., None] - self.slow)  # (..., K) m, distance to each limited place
        acceleration = _RUN_ACCELERATION_MPS2 if self.gait.pattern == "run" else _MAX_ACCELERATION_MPS2
        most = np.sqrt(np.min(self.most**2 + 2 * acceleration * away, axis=-1))
        return np.minimum(self.gait.speed_mps * np.interp(s, self.grid, self.share), most)

    def stair_speed(self, s: float) -> float:
        """Speed that sets the cadence on stairs at `s`, m/s: the preferred one, at most `_MAX_STAIR_MPS`."""
        return min(self.gait.speed_mps * float(np.interp(s, self.grid, self.share)), _MAX_STAIR_MPS)

    def step_length(self, s: Array | float) -> Array:
        """(...) m, step length on a straight level way at (...) arc lengths."""
        if self.gait.pattern == "run":
            return self.speed(s) * run_step_s(self.size)
        return level_step_length(self.speed(s), self.size) * shuffle_step_share(self.gait.shuffle)

    def shorter_in_curves(self, s: Array) -> Array:
        """(...) step length in curves relative to that on a straight way; runners only turn, within their steps."""
        return np.ones_like(s) if self.gait.pattern == "run" else np.sqrt(speed_share(self.way, s))

    def duration(self, s: float) -> float:
        """Duration of one step on straight level ground at arc length `s`, in seconds; a shuffle has a lower limit."""
        return max(float(self.step_length(s) / self.speed(s)), _MIN_SHUFFLE_STEP_S * self.gait.shuffle)


def level_step_length(speed_mps: Array | float, size: Wearer) -> Array:
    """(...) m, preferred step length on level ground at (...) m/s.

    It grows with the root of speed, and faster below a dimensionless speed of 0.2 (sources in `style.walk_growth`).
    """
    return _STEP_AT_PACE_1 * walk_growth(np.asarray(speed_mps) * pace(1.0, size)) * leg_length(size)


# Footholds; chosen by hand.
STEEP_RAD = np.radians(9.0)  # on steeper ramps steps are shorter
_STEEP_LENGTH_BY_SLOPE = 2.2  # share of a step per rad beyond
_EDGE_M = 0.01  # between the sole and any edge
_TOE_TO_RISER_M = 0.07  # before stairs that lead up
_TREAD_SHARE = 0.8  # of the free part of a tread, between the foot and the riser
_MIN_TOE_TO_RISER_UP_M = 0.012  # going up, least distance of the toes from the next riser
_HEEL_FROM_RISER_M = 0.03  # behind it, on a tread or a landing
_HEEL_BEHIND_DOWN_M = 0.022  # going down, the heel stays clear of the riser and the toes overhang the edge
_INNER_EDGE_M = 0.15  # from the way to the inner edge of the inner foot, at its toes, in a bend
_MAX_ONE_PACE_TREAD = 1.25  # tread that is crossed in one pace, level steps
_MIN_SECOND_FOOTPRINT_M = 0.2  # least room on a tread for a second footprint
_MAX_TWO_TREADS_RISE = 0.36  # highest rise of a step over two treads, leg lengths
_MAX_TWO_TREADS_DEPTH = 0.64  # greatest depth of these treads together, leg lengths
_RAMP_STEP = 0.92  # step length relative to the level
_FIRST_STEP = 0.7  # likewise, from standing
_MIN_EXTRA_STEP = 0.35  # share of a step from which another one is made
_MAX_LENGTH_ERROR = 0.06  # share of a step length, limit of its variability
_SHORT_STOP_MPS = 1.2  # faster walkers stop with a shorter last step
_STROLL_STEPS = 9  # on average between two pauses
_PAUSE_RANGE_S = (0.6, 2.5)  # shortest and longest pause
_HESITATING_STEP = 0.6  # of a step: who hesitates is slower before it, too
_STEP_INTO_PAUSE = 0.35  # of a step: the feet end nearly side by side


@dataclass(frozen=True, kw_only=True)
class Foothold:
    """A foothold: a place along the way for one foot.

    Attributes:
        foot: `l` or `r`.
        s: Arc length along the way, m.
        strip: Strip of ground there.
        pause_s: Time that the walker stands still on both feet after this step, s.
        treads: How many treads the step to here goes up or down at a time.
        left_m: Distance of the middle between the feet to the left of the way, m.
        yaw_rad: Direction of the walker relative to the way, rad, left positive.
        manner: How the step to here is made: `walk`; `place`, flat and on the spot; `back`; or `pivot`, onto the ball.
        time_s: Duration of the step of an act, s; 0 for a step of walking.
        twist: How the foot turns on its ball here; None if it does not.
        act: What the walker does here; None to walk on.
    """

    foot: str
    s: float
    strip: Strip
    pause_s: float = 0.0
    treads: int = 1
    left_m: float = 0.0
    yaw_rad: float = 0.0
    manner: str = "walk"
    time_s: float = 0.0
    twist: Twist | None = None
    act: Act | None = None

    @property
    def other_foot(self) -> str:
        """The foot of the next step, `l` or `r`."""
        return "l" if self.foot == "r" else "r"


def limp_factor(gait: Gait, foot: str) -> float:
    """Factor on step length and step time of a foot: 1 + asymmetry for `l`, 1 − asymmetry for `r`."""
    return 1.0 + (gait.asymmetry if foot == "l" else -gait.asymmetry)


def plan_footholds(layout: Layout, size: Wearer, gait: Gait, tempo: Tempo, rng: np.random.Generator) -> list[Foothold]:
    """Footholds in order, right foot first, from s = 0 to the end of the route, where the feet end side by side.

    Args:
        layout: Route in the world.
        size: Wearer.
        gait: Gait of the person.
        tempo: Speed and step length along the way.
        rng: Draws pauses and errors of the step length.

    Raises:
        ConfigError: A strip too short for a foot, or a stop beyond the end of the route.
    """
    end = layout.profile[-1].s1 - RUN_OUT_M
    for name, entries in (("stops", gait.stops), ("acts", gait.acts)):
        for entry in entries:
            if entry.at_m >= end:
                raise ConfigError("gait", f"{name}.at_m", entry.at_m, f"less than {end:.2f} m, the length of the way")
    holds: list[Foothold] = []
    shorter = [act for act in gait.acts if act.shortens]
    stops: list[Stop | Act] = sorted([*gait.stops, *shorter], key=lambda stop: stop.at_m)  # those still ahead
    skipped = [False] * len(layout.profile)  # whether no foot is placed on a strip
    if gait.stairs == "two_at_a_time":
        skipped = _find_skipped_strips(layout.profile, size)
    for k in range(len(layout.profile)):
        if skipped[k]:
            continue
        here = [stop for stop in stops if stop.at_m < layout.profile[k].s1]
        new = _plan_on_strip(layout, k, size, gait, tempo, rng, len(holds), here)
        stops = stops[len(here) :]
        if k and skipped[k - 1]:
            new[0] = replace(new[0], treads=2)  # the step to here goes over the skipped tread
        holds += new
    last = holds[-1]  # the other foot ends beside it
    return [*holds, Foothold(foot=_foot_of_step(len(holds)), s=last.s, strip=last.strip)]


def _foot_of_step(i: int) -> str:
    """Foot of step i, `r` or `l`; the right foot makes the first one."""
    return "r" if i % 2 == 0 else "l"


def _plan_on_strip(
    layout: Layout,
    k: int,
    size: Wearer,
    gait: Gait,
    tempo: Tempo,
    rng: np.random.Generator,
    first: int,
    stops: Sequence[Stop | Act],
) -> list[Foothold]:
    """Footholds on one strip of ground, in order.

    A stair tread that is too short for two footprints gets one foot, or both if the walker climbs step by step. On
    other strips the steps between the first and the last possible place are equally long, except for the limp, for
    shorter steps at the start, at the end and into pauses, and for a random error.

    Args:
        layout: Route in the world.
        k: Number of the strip in the profile.
        size: Wearer.
        gait: Gait of the person.
        tempo: Speed and step length along the way.
        rng: Draws pauses and errors of the step length.
        first: Number of footholds before this strip, which decides the foot.
        stops: Stops on this strip, and acts for which the walker stops.

    Returns:
        The footholds; none on the strip behind the start, where the two feet already stand.

    Raises:
        ConfigError: The strip is shorter than a shoe, or has no room for an act.
    """
    # a strip reaches from the arc length `s0` to `s1`, and from the height `z0` to `z1`
    profile, strip = layout.profile, layout.profile[k]
    heel, toe = -size.shoe.heel_back_x, size.shoe.toe_tip_x  # m, from the foot's origin back and forward, both positive
    last_strip, first_strip = k == len(profile) - 1, strip.s0 < 0.0  # the walk starts at s = 0, on the first one
    end = strip.s1 - RUN_OUT_M if last_strip else strip.s1
    if strip.s1 <= 0.0:
        return []  # behind the start
    both = gait.stairs == "step_by_step"  # both feet are placed on each tread
    # a tread too short for a second footprint behind the first one
    if strip.terrain == "stair" and strip.s1 - strip.s0 < max(
        _MAX_ONE_PACE_TREAD * float(tempo.step_length(strip.s0)), heel + toe + _MIN_SECOND_FOOTPRINT_M
    ):
        rising, bend = strip.z0 > profile[k - 1].z1, float(layout.way.curvature(0.5 * (strip.s0 + strip.s1)))
        feet = [_foot_of_step(first + i) for i in range(2 if both else 1)]
        # where the stair winds, the foot with the narrower tread decides
        s = _position_on_tread(strip, rising, heel, toe, min(_inner_depth_share(f, bend) for f in feet))
        return _place_beside(feet, s, strip, stops)

    def step(s: Array) -> Array:
        """(N,) m, step length on this strip at (N,) arc lengths; shorter on ramps."""
        share = _RAMP_STEP - _STEEP_LENGTH_BY_SLOPE * max(abs(strip.slope) - STEEP_RAD, 0)
        return tempo.step_length(s) * (share if strip.terrain == "ramp" else 1.0)

    def edge_gap(s: float) -> float:
        """Distance from a change of slope at `s` to the sole, m: half of what a full step is longer than a sole."""
        return max((float(tempo.step_length(s)) - heel - toe) / 2, _EDGE_M)

    # whether the strip begins and ends at a riser; then the first and the last possible place of a foot
    riser_before = not first_strip and abs(profile[k - 1].z1 - strip.z0) > 1e-9
    riser_after = not last_strip and abs(profile[k + 1].z0 - strip.z1) > 1e-9
    start = 0.0 if first_strip else strip.s0 + heel + (_HEEL_FROM_RISER_M if riser_before else edge_gap(strip.s0))
    if last_strip:
        last_place = end
    elif riser_after:
        last_place = end - toe - (_TOE_TO_RISER_M if profile[k + 1].z0 > strip.z1 else _EDGE_M)
    else:
        last_place = end - toe - edge_gap(strip.s1)
    beside = [start] if both and riser_before else []  # the other foot is placed beside the leading one
    leading_foot = gait.leading_foot if both and riser_after else None
    if last_place < start - 1e-9:  # room for the sole alone, without the usual distances from both ends
        middle = (strip.s0 + end - toe + heel) / 2
        if end - strip.s0 < heel + toe + 2 * _EDGE_M:
            raise ConfigError(
                "terrain",
                f"{strip.terrain} at s = {strip.s0:.2f} m",
                f"{strip.s1 - strip.s0:.2f} m long",
                f"at least {heel + toe + 2 * _EDGE_M:.2f} m, the length of a shoe",
            )
        count = len(beside) + 1
        # one more step in place, if the next strip would otherwise not begin with the leading foot
        if leading_foot is not None and _foot_of_step(first + count) != leading_foot:
            count += 1
        return _place_beside([_foot_of_step(first + i) for i in range(count)], middle, strip, stops)
    # number of steps, and their relative lengths; the first foothold is at `start`, but where the walker already stands
    # there, it is a shorter step away
    first_length = _FIRST_STEP if first_strip else 0.0
    # arc lengths, and (fractional) number of steps from `start` to each
    along, paces = count_steps(layout.way, start, last_place, step, tempo.shorter_in_curves)
    # number of footholds: on the first strip one for every step, the first of which is shorter; on others one for the
    # start and one for every step, if there is room for a step
    if first_strip:
        count = max(1, round(paces[-1] + 1 - first_length))
    else:
        count = max(1, round(paces[-1])) + 1 if paces[-1] > _MIN_EXTRA_STEP else 1
    if strip.terrain != "stair":
        count += len(stops)  # the steps into a stop and out of it are together as long as one
    if leading_foot is not None and _foot_of_step(first + len(beside) + count) != leading_foot:
        count += 1  # so that the next strip begins with the leading foot
    feet = [_foot_of_step(first + len(beside) + i) for i in range(count)]
    pauses = _draw_pauses(count, strip, gait, rng)
    weights = np.array([limp_factor(gait, foot) for foot in feet]) * np.where(pauses > 0, _STEP_INTO_PAUSE, 1.0)
    weights[0] *= first_length
    if last_strip:
        weights[-1] *= min(_SHORT_STOP_MPS / gait.speed_mps, 1.0)  # fast walkers stop with a shorter step
    places = _share_out(weights, paces, along)
    acts: dict[int, Act] = {}  # by number of the foothold
    for stop in stops:
        # a step into the stop and one out of it lie on the strip, if it has room for both
        i = min(max(int(np.searchsorted(places, stop.at_m)), 1), max(count - 2, 0))
        if isinstance(stop, Stop):
            pauses[i] += stop.for_s
        else:
            i = _foothold_of_act(stop, strip, feet, i)
            acts[i] = stop
        if isinstance(stop, Hesitate):
            if strip.terrain != "stair" and count > 2:
                weights[max(i - 1, 0) : i + 1] *= _HESITATING_STEP
            continue
        if strip.terrain != "stair" and count > 2:
            weights[i : i + 2] *= _STEP_INTO_PAUSE, _FIRST_STEP
    places = _share_out(weights, paces, along)
    if len(places) > 2:  # random errors of all places but the first and the last
        lengths = np.gradient(places)[1:-1]  # m, length of the steps around each place
        max_error = _MAX_LENGTH_ERROR
        places[1:-1] += np.clip(rng.normal(0.0, gait.step_sd, len(places) - 2), -max_error, max_error) * lengths
    before = [Foothold(foot=_foot_of_step(first), s=x, strip=strip) for x in beside]
    return before + [
        Foothold(foot=f, s=float(x), strip=strip, pause_s=p, act=acts.get(i))
        for i, (f, x, p) in enumerate(zip(feet, places, pauses.tolist()))
    ]


def _foothold_of_act(act: Act, strip: Strip, feet: Sequence[str], i: int) -> int:
    """Number of the foothold at which an act begins: the i-th, or a neighbour from which the other foot leads.

    Args:
        act: The act.
        strip: Strip of ground there.
        feet: Feet of the footholds on it.
        i: Number of the foothold where the walker would stop.

    Raises:
        ConfigError: The act does not fit the strip.
    """
    if isinstance(act, Hesitate):
        return i
    if act.level_alone and strip.terrain != "level":
        raise ConfigError("gait", "acts.at_m", act.at_m, f"a place on level ground for {act.kind}")
    if feet[i] == act.leading_foot:
        i += 1 if i + 1 <= len(feet) - 2 else -1
    if not 1 <= i <= len(feet) - 2:
        valid = f"a place with two steps before and after it on the same {strip.terrain} for {act.kind}"
        raise ConfigError("gait", "acts.at_m", act.at_m, valid)
    return i


def _place_beside(feet: Sequence[str], s: float, strip: Strip, stops: Sequence[Stop | Act]) -> list[Foothold]:
    """Footholds of steps at one place of a strip, at the arc length `s`, m; all stops are made after the last one.

    Raises:
        ConfigError: The walker cannot do an act there.
    """
    last: Act | None = None  # of the last foot
    for act in stops:
        if isinstance(act, Hesitate):
            last = act
        elif isinstance(act, Act):
            valid = f"a place with two steps before and after it on the same {strip.terrain} for {act.kind}"
            raise ConfigError("gait", "acts.at_m", act.at_m, valid)
    pauses = [0.0] * (len(feet) - 1) + [sum(stop.for_s for stop in stops if isinstance(stop, Stop))]
    acts = [None] * (len(feet) - 1) + [last]
    return [
        Foothold(foot=foot, s=s, strip=strip, pause_s=pause, act=act) for foot, pause, act in zip(feet, pauses, acts)
    ]


def _share_out(weights: Array, paces: Array, along: Array) -> Array:
    """(N,) m, arc lengths of the footholds of a strip whose steps have the (N,) relative lengths `weights`.

    They are shares of the number of steps, which is not proportional to the distance: `paces` (K) are the numbers of
    steps to the arc lengths `along` (K), m. The only foothold of a strip, with the weight 0, is in the middle.
    """
    shares = np.cumsum(weights) / weights.sum() if weights.sum() > 0 else np.array([0.5])
    return np.interp(shares * paces[-1], paces, along)


def _inner_depth_share(foot: str, curvature: float) -> float:
    """Depth of a tread at the inner edge of a foot, relative to the middle of the way, where the stair winds.

    It is 1 on a straight stair and under the outer foot. `curvature` is that of the way, 1/m, left positive.
    """
    return 1.0 - max(curvature if foot == "l" else -curvature, 0.0) * _INNER_EDGE_M


def _position_on_tread(strip: Strip, rising: bool, heel: float, toe: float, narrower: float) -> float:
    """Arc length of a foot on a tread, clear of the riser: the one in front going up, the one behind going down.

    A foot longer than the tread overhangs the free edge. The tread reaches from the arc length `s0` to `s1`.

    Args:
        strip: The tread.
        rising: Whether the stair leads up.
        heel: From the foot's origin back to the heel's edge, m.
        toe: From the foot's origin forward to the toe tip, m.
        narrower: Depth of the tread at the foot, relative to the middle of the way.
    """
    heel, toe = heel / narrower, toe / narrower  # measured along the middle of the way
    gap = _TREAD_SHARE * (strip.s1 - strip.s0 - heel - toe)  # m, wanted between foot and riser; negative for no room
    if rising:
        return strip.s1 - max(gap, _MIN_TOE_TO_RISER_UP_M) - toe
    return strip.s0 + max(gap, _HEEL_BEHIND_DOWN_M) + heel


def _find_skipped_strips(profile: Sequence[Strip], size: Wearer) -> list[bool]:
    """Whether a walker who climbs two treads at a time places no foot on a strip, for each strip of the profile.

    A tread is skipped if the steps before and behind it lead up, and both together are low and short enough for the
    leg.
    """
    leg, skipped = leg_length(size), [False] * len(profile)
    for k in range(1, len(profile) - 1):
        before, strip, beyond = profile[k - 1 : k + 2]
        # heights z0 and z1 are those at the beginning and the end of a strip
        up = before.z1 < strip.z0 and strip.z1 < beyond.z0
        low = beyond.z0 <= before.z1 + _MAX_TWO_TREADS_RISE * leg
        short = 2.0 * (strip.s1 - strip.s0) <= _MAX_TWO_TREADS_DEPTH * leg  # two treads of this depth
        skipped[k] = strip.terrain == "stair" and not skipped[k - 1] and up and low and short
    return skipped


def _draw_pauses(count: int, strip: Strip, gait: Gait, rng: np.random.Generator) -> Array:
    """(count,) s of standing at each foothold of a strip.

    A wandering walker stands still now and then, on the level and away from edges; other walkers never do.
    """
    pauses = np.zeros(count)
    if gait.pattern == "wander" and strip.terrain == "level" and count > 3:
        stands = rng.uniform(size=count) < 1.0 / _STROLL_STEPS
        stands[[0, 1, -2, -1]] = False  # not near the ends of the strip
        stands[1:] &= ~stands[:-1]  # not at two footholds in a row
        pauses[stands] = rng.uniform(*_PAUSE_RANGE_S, size=int(stands.sum()))
    return pauses
