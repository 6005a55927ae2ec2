"""From a route's layout to footsteps: where each foot lands, when, and in which manner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.body import Wearer
from stridetwin.sim.config import Gait
from stridetwin.sim.gait.curves import paced, speed_share, turned, widening
from stridetwin.sim.rotation import rot_x, rot_y, rot_z
from stridetwin.sim.route import RUN_OUT_M, Layout, Strip
from stridetwin.sim.way import Way
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

HALF_STEP_WIDTH_M = 0.060  # the shoes carry housings on their inner sides
TOE_OUT_RAD = 0.09
WALK_RATIO_M_S = 0.345  # step length / cadence (0.42 m / (step/s) in Sekiya & Nagasaki 1998), shorter in an exoskeleton
DOUBLE_SUPPORT = 0.18  # share of a step; the same share of the stride is spent on both feet
_EDGE_M = 0.01  # between the sole and any edge
_TOE_TO_RISER_M = 0.07
_HEEL_FROM_RISER_M = 0.03
_STEP_TIME = {"level": 1.0, "ramp": 1.04, "up": 1.16, "down": 1.04}
SHIFT_S = 0.55  # from both feet onto one, before the first step
SETTLE_S = 0.60  # and back onto both after the last
_STAIR_STEP_S = 0.60  # at the preferred speed of 1.2 m/s
_STEEP_RAD = np.radians(9.0)  # on steeper ramps steps are shorter by `_SHORTER_STEEP` a radian
_SHORTER_STEEP = 2.2
_HIGH_RISER_M = 0.18  # steps over higher ones take longer, in proportion
_SHARP_TURN = 0.5  # of the sharpest turn a step: from here on feet come down flat


@dataclass(frozen=True, kw_only=True, eq=False)
class Footstep:
    """One footprint and its time on the ground.

    Attributes:
        foot: `l` or `r`.
        p_foot_in_world: (3,) m, the flat foot's origin.
        R_world_sole: (3, 3) of the flat foot: x along the foot in the ground's plane, z the ground's normal.
        s: Arc length along the way, m.
        heading: Direction of the way there, rad, not wrapped.
        slope: Inclination of the ground along the way, rad, uphill positive.
        rise: Height above the other foot's print before, m.
        fall: Height above the other foot's print after, m.
        terrain: level, stair or ramp.
        mode: Locomotion mode of the step that ends here: LG, SA, SD, RA or RD.
        arrival: heel, flat or forefoot: what touches down first.
        departure: push, climb or lower: how the foot leaves.
        t_touch: Touch-down, s; -inf for the feet that stand at the start.
        t_off: Toe-off, s; inf for the feet that stand at the end.
    """

    foot: str
    p_foot_in_world: Array
    R_world_sole: Array
    s: float
    heading: float
    slope: float
    rise: float
    fall: float
    terrain: str
    mode: str
    arrival: str
    departure: str
    t_touch: float
    t_off: float


def step_length(gait: Gait, height_m: float) -> float:
    """Preferred step length on level ground, m, from the walk ratio."""
    return float(np.sqrt(WALK_RATIO_M_S * gait.speed_mps) * height_m / 1.75)


def plan(
    layout: Layout, size: Wearer, gait: Gait, height_m: float, rng: np.random.Generator
) -> tuple[list[Footstep], float]:
    """Footsteps along the way from s = 0 to the end of the route, and the walk's duration in s.

    The walk starts and ends on both feet. Soles lie wholly on one strip each: step lengths are adapted before an edge.

    Raises:
        ConfigError: Speed out of range, or a strip too short for a foot.
    """
    if not 0.4 <= gait.speed_mps <= 1.6:
        raise ConfigError("gait", "speed_mps", gait.speed_mps, "0.4-1.6")
    nominal = step_length(gait, height_m)
    way, profile = layout.way, layout.profile
    places = [p for k in range(len(profile)) for p in _places(layout, k, size, nominal, gait, rng)]
    places.append(places[-1])  # the last step closes up beside the foot before
    feet = ["r" if i % 2 == 0 else "l" for i in range(len(places))]
    touch, off = _times(way, places, gait, nominal, rng)
    rows = [_Row("l", 0.0, profile[0], -np.inf), _Row("r", 0.0, profile[0], -np.inf)]
    rows += [_Row(f, s, strip, t) for f, (s, strip), t in zip(feet, places, touch)]
    steps = []
    for i, row in enumerate(rows):
        following = next((j for j in range(i + 1, len(rows)) if rows[j].foot == row.foot), None)
        t_off = np.inf if following is None else off[following - 2]
        before = rows[i - 1] if i >= 2 else row
        after = rows[following] if following is not None else row
        ahead = rows[min(i + 1, len(rows) - 1)]
        steps.append(_footstep(way, row, before, ahead, after, t_off, rng, gait))
    return steps, float(touch[-1] + SETTLE_S + gait.stand_s)


@dataclass(frozen=True)
class _Row:
    foot: str
    s: float
    strip: Strip
    t_touch: float

    @property
    def z(self) -> float:
        return self.strip.height(self.s, 0.0)


def _places(
    layout: Layout, k: int, size: Wearer, nominal: float, gait: Gait, rng: np.random.Generator
) -> list[tuple[float, Strip]]:
    """Arc lengths of the footprints on strip k (none for the two feet that stand at the start)."""
    profile, strip = layout.profile, layout.profile[k]
    heel, toe = -size.shoe.heel_back_x, size.shoe.toe_tip_x
    last_strip = k == len(profile) - 1
    end = strip.s1 - RUN_OUT_M if last_strip else strip.s1
    if strip.s1 <= 0.0:
        return []
    if strip.terrain == "stair":
        # the foot keeps away from the riser, the one ahead going up, the one behind going down; a foot longer than
        # the tread hangs over the free edge
        gap = max(0.8 * (strip.s1 - strip.s0 - heel - toe), 1.2 * _EDGE_M)
        rising = strip.z0 > profile[k - 1].z1
        return [(strip.s1 - gap - toe if rising else strip.s0 + gap + heel, strip)]
    first_strip = strip.s0 < 0.0
    step = nominal * (
        1.0 if strip.terrain == "level" else 0.92 - _SHORTER_STEEP * max(abs(strip.slope) - _STEEP_RAD, 0)
    )
    across = max((nominal - heel - toe) / 2, _EDGE_M)  # half of what a full step leaves free at a bend
    riser_before = not first_strip and abs(profile[k - 1].z1 - strip.z0) > 1e-9
    riser_after = not last_strip and abs(profile[k + 1].z0 - strip.z1) > 1e-9
    start = 0.0 if first_strip else strip.s0 + heel + (_HEEL_FROM_RISER_M if riser_before else across)
    if last_strip:
        stop = end
    elif riser_after:
        stop = end - toe - (_TOE_TO_RISER_M if profile[k + 1].z0 > strip.z1 else _EDGE_M)
    else:
        stop = end - toe - across
    if stop < start - 1e-9:
        middle = (strip.s0 + end - toe + heel) / 2
        if end - strip.s0 < heel + toe + 2 * _EDGE_M:
            raise ConfigError(
                "terrain", f"{strip.terrain} at s = {strip.s0:.2f} m", f"{strip.s1 - strip.s0:.2f} m long",
                f"at least {heel + toe + 2 * _EDGE_M:.2f} m, the length of a shoe",
            )  # fmt: skip
        return [(middle, strip)]
    lead = 0.7 if first_strip else 0.0  # from standing, the first step is shorter
    along, paces = paced(layout.way, start, stop, step)
    if first_strip:
        count = max(1, round(paces[-1] + 1 - lead))
        shares = (np.arange(count) + lead) / (count - 1 + lead)
    else:
        count = max(1, round(paces[-1])) + 1 if paces[-1] > 0.35 else 1
        shares = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
    places = np.interp(shares * paces[-1], paces, along)
    if len(places) > 2:
        lengths = np.gradient(places)[1:-1]
        places[1:-1] += np.clip(rng.normal(0.0, gait.step_sd, len(places) - 2), -0.06, 0.06) * lengths
    return [(float(s), strip) for s in places]


def _times(
    way: Way, places: Sequence[tuple[float, Strip]], gait: Gait, nominal: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Touch-down of each footprint and the toe-off before it, s."""
    level_step = nominal / gait.speed_mps
    stair_step = _STAIR_STEP_S * np.sqrt(1.2 / gait.speed_mps)
    durations, previous = [], (0.0, places[0][1])
    for i, (s, strip) in enumerate(places):
        rise = strip.z0 - previous[1].z1
        if strip is not previous[1] and abs(rise) > 0.02 and (s - previous[0]) < 1.0:
            duration = stair_step * _STEP_TIME["up" if rise > 0 else "down"] * max(abs(rise) / _HIGH_RISER_M, 1.0)
        else:
            slower = float(np.sqrt(speed_share(way, np.array((s + previous[0]) / 2))))
            ratio = np.clip(max((s - previous[0]) / (nominal * slower), turned(way, previous[0], s)), 0.3, 1.3)
            pace = _STEP_TIME["ramp" if strip.terrain == "ramp" else "level"] / slower
            duration = level_step * pace * (0.55 + 0.45 * ratio)
        if i == 0 or i == len(places) - 1:
            duration = max(duration, 0.9 * level_step)
        durations.append(duration * (1.0 + np.clip(rng.normal(0.0, gait.step_sd), -0.06, 0.06)))
        previous = (s, strip)
    # neighbouring steps share their tempo: nobody switches cadence from one step to the next
    smooth = np.convolve(np.pad(durations, 1, mode="edge"), [0.2, 0.6, 0.2], mode="valid")
    touch = gait.stand_s + 0.3 + np.cumsum(smooth)
    before = np.concatenate([[gait.stand_s + 0.3], touch[:-1]])
    return touch, before + DOUBLE_SUPPORT * smooth


def _footstep(
    way: Way, row: _Row, before: _Row, ahead: _Row, after: _Row, t_off: float, rng: np.random.Generator, gait: Gait
) -> Footstep:
    slope, heading = row.strip.slope, float(way.heading(row.s))
    rise, next_rise = row.z - before.z, after.z - row.z
    across_riser = row.strip is not before.strip and row.strip.terrain != "ramp" and before.strip.terrain != "ramp"
    next_riser = after.strip is not row.strip and after.strip.terrain != "ramp" and row.strip.terrain != "ramp"
    up, down = across_riser and rise > 0.02, across_riser and rise < -0.02
    mode = "SA" if across_riser and rise >= 0.07 else "SD" if across_riser and rise <= -0.07 else "LG"
    if row.strip.terrain == "ramp":
        mode = "RA" if slope > 0 else "RD"
    steep = slope > _STEEP_RAD + 0.05
    side = 1.0 if row.foot == "l" else -1.0
    wider = widening(way, before.s, row.s)
    left = side * (HALF_STEP_WIDTH_M + wider) + float(np.clip(rng.normal(0.0, 0.4 * gait.step_sd), -0.015, 0.015))
    R_world_ground = rot_z(np.array(heading)) @ rot_y(np.array(-slope)) @ rot_x(np.array(row.strip.cross_slope))
    return Footstep(
        foot=row.foot,
        p_foot_in_world=np.array([*way.point(row.s, left), row.strip.height(row.s, left)]),
        R_world_sole=R_world_ground @ rot_z(np.array(side * TOE_OUT_RAD)),
        s=row.s,
        heading=heading,
        slope=slope,
        rise=rise,
        fall=row.z - ahead.z,
        terrain=row.strip.terrain,
        mode=mode,
        arrival="flat" if up or steep or turned(way, before.s, row.s) > _SHARP_TURN else "forefoot" if down else "heel",
        departure="climb"
        if next_riser and next_rise > 0.02
        else "lower"
        if next_riser and next_rise < -0.02
        else "push",
        t_touch=row.t_touch,
        t_off=t_off,
    )
