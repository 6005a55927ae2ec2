"""From the terrain's profile to footsteps: where each foot lands, when, and in which manner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.sim.body import Wearer
from stridetwin.sim.config import Gait
from stridetwin.sim.route import RUN_OUT_M, Strip
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Footstep:
    """One footprint and its time on the ground.

    Attributes:
        foot: `l` or `r`.
        p_foot_in_world: (3,) m, the flat foot's origin.
        yaw: Heading of the foot, rad.
        slope: Inclination of the ground along x, rad, uphill positive.
        terrain: level, stair or ramp.
        mode: Locomotion mode of the step that ends here: LG, SA, SD, RA or RD.
        arrival: heel, flat or forefoot: what touches down first.
        departure: push, climb or lower: how the foot leaves.
        t_touch: Touch-down, s; -inf for the feet that stand at the start.
        t_off: Toe-off, s; inf for the feet that stand at the end.
    """

    foot: str
    p_foot_in_world: Array
    yaw: float
    slope: float
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
    profile: Sequence[Strip], size: Wearer, gait: Gait, height_m: float, rng: np.random.Generator
) -> tuple[list[Footstep], float]:
    """Footsteps along the profile from x = 0 to the end of the route, and the walk's duration in s.

    The walk starts and ends on both feet. Soles lie wholly on one strip each: step lengths are adapted before an edge.

    Raises:
        ConfigError: Speed out of range, or a strip too short for a foot.
    """
    if not 0.4 <= gait.speed_mps <= 1.6:
        raise ConfigError("gait", "speed_mps", gait.speed_mps, "0.4-1.6")
    nominal = step_length(gait, height_m)
    places = [p for k in range(len(profile)) for p in _places(profile, k, size, nominal, gait, rng)]
    places.append(places[-1])  # the last step closes up beside the foot before
    feet = ["r" if i % 2 == 0 else "l" for i in range(len(places))]
    touch, off = _times(places, gait, nominal, rng)
    rows = [_Row("l", 0.0, profile[0], -np.inf), _Row("r", 0.0, profile[0], -np.inf)]
    rows += [_Row(f, x, s, t) for f, (x, s), t in zip(feet, places, touch)]
    steps = []
    for i, row in enumerate(rows):
        following = next((j for j in range(i + 1, len(rows)) if rows[j].foot == row.foot), None)
        t_off = np.inf if following is None else off[following - 2]
        before = rows[i - 1] if i >= 2 else row
        after = rows[following] if following is not None else row
        steps.append(_footstep(row, before, after, t_off, rng, gait))
    return steps, float(touch[-1] + SETTLE_S + gait.stand_s)


@dataclass(frozen=True)
class _Row:
    foot: str
    x: float
    strip: Strip
    t_touch: float

    @property
    def z(self) -> float:
        return self.strip.z0 + _tangent(self.strip) * (self.x - self.strip.x0)


def _tangent(strip: Strip) -> float:
    return (strip.z1 - strip.z0) / (strip.x1 - strip.x0)


def _places(
    profile: Sequence[Strip], k: int, size: Wearer, nominal: float, gait: Gait, rng: np.random.Generator
) -> list[tuple[float, Strip]]:
    """X of the footprints on strip k (none for the two feet that stand at the start)."""
    strip = profile[k]
    heel, toe = -size.shoe.heel_back_x, size.shoe.toe_tip_x
    last_strip = k == len(profile) - 1
    end = strip.x1 - RUN_OUT_M if last_strip else strip.x1
    if strip.x1 <= 0.0:
        return []
    if strip.terrain == "stair":
        # the foot keeps away from the riser, the one ahead going up, the one behind going down; a foot longer than
        # the tread hangs over the free edge
        gap = max(0.8 * (strip.x1 - strip.x0 - heel - toe), 1.2 * _EDGE_M)
        rising = strip.z0 > profile[k - 1].z1
        return [(strip.x1 - gap - toe if rising else strip.x0 + gap + heel, strip)]
    first_strip = strip.x0 < 0.0
    step = nominal * (1.0 if strip.terrain == "level" else 0.92)
    across = max((nominal - heel - toe) / 2, _EDGE_M)  # half of what a full step leaves free at a bend
    riser_before = not first_strip and abs(profile[k - 1].z1 - strip.z0) > 1e-9
    riser_after = not last_strip and abs(profile[k + 1].z0 - strip.z1) > 1e-9
    start = 0.0 if first_strip else strip.x0 + heel + (_HEEL_FROM_RISER_M if riser_before else across)
    if last_strip:
        stop = end
    elif riser_after:
        stop = end - toe - (_TOE_TO_RISER_M if profile[k + 1].z0 > strip.z1 else _EDGE_M)
    else:
        stop = end - toe - across
    if stop < start - 1e-9:
        middle = (strip.x0 + end - toe + heel) / 2
        if end - strip.x0 < heel + toe + 2 * _EDGE_M:
            raise ConfigError(
                "terrain", f"{strip.terrain} at x = {strip.x0:.2f} m", f"{strip.x1 - strip.x0:.2f} m long",
                f"at least {heel + toe + 2 * _EDGE_M:.2f} m, the length of a shoe",
            )  # fmt: skip
        return [(middle, strip)]
    lead = 0.7 if first_strip else 0.0  # from standing, the first step is shorter
    if first_strip:
        count = max(1, round((stop - start) / step + 1 - lead))
        spacing = (stop - start) / (count - 1 + lead)
        xs = start + spacing * (np.arange(count) + lead)
    else:
        count = max(1, round((stop - start) / step)) + 1 if stop - start > 0.35 * step else 1
        xs = np.linspace(start, stop, count) if count > 1 else np.array([(start + stop) / 2])
    if len(xs) > 2:
        xs[1:-1] += np.clip(rng.normal(0.0, gait.step_sd, len(xs) - 2), -0.06, 0.06) * step
    return [(float(x), strip) for x in xs]


def _times(
    places: Sequence[tuple[float, Strip]], gait: Gait, nominal: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Touch-down of each footprint and the toe-off before it, s."""
    level_step = nominal / gait.speed_mps
    stair_step = _STAIR_STEP_S * np.sqrt(1.2 / gait.speed_mps)
    durations, previous = [], (0.0, places[0][1])
    for i, (x, strip) in enumerate(places):
        rise = strip.z0 - previous[1].z1
        if strip is not previous[1] and abs(rise) > 0.02 and (x - previous[0]) < 1.0:
            duration = stair_step * _STEP_TIME["up" if rise > 0 else "down"]
        else:
            ratio = np.clip((x - previous[0]) / nominal, 0.3, 1.3)
            duration = level_step * _STEP_TIME["ramp" if strip.terrain == "ramp" else "level"] * (0.55 + 0.45 * ratio)
        if i == 0 or i == len(places) - 1:
            duration = max(duration, 0.9 * level_step)
        durations.append(duration * (1.0 + np.clip(rng.normal(0.0, gait.step_sd), -0.06, 0.06)))
        previous = (x, strip)
    # neighbouring steps share their tempo: nobody switches cadence from one step to the next
    smooth = np.convolve(np.pad(durations, 1, mode="edge"), [0.2, 0.6, 0.2], mode="valid")
    touch = gait.stand_s + 0.3 + np.cumsum(smooth)
    before = np.concatenate([[gait.stand_s + 0.3], touch[:-1]])
    return touch, before + DOUBLE_SUPPORT * smooth


def _footstep(row: _Row, before: _Row, after: _Row, t_off: float, rng: np.random.Generator, gait: Gait) -> Footstep:
    slope = float(np.arctan(_tangent(row.strip)))
    rise, next_rise = row.z - before.z, after.z - row.z
    across_riser = row.strip is not before.strip and row.strip.terrain != "ramp" and before.strip.terrain != "ramp"
    next_riser = after.strip is not row.strip and after.strip.terrain != "ramp" and row.strip.terrain != "ramp"
    up, down = across_riser and rise > 0.02, across_riser and rise < -0.02
    mode = "SA" if across_riser and rise >= 0.07 else "SD" if across_riser and rise <= -0.07 else "LG"
    if row.strip.terrain == "ramp":
        mode = "RA" if slope > 0 else "RD"
    side = 1.0 if row.foot == "l" else -1.0
    y = side * HALF_STEP_WIDTH_M + float(np.clip(rng.normal(0.0, 0.4 * gait.step_sd), -0.015, 0.015))
    return Footstep(
        foot=row.foot,
        p_foot_in_world=np.array([row.x, y, row.z]),
        yaw=side * TOE_OUT_RAD,
        slope=slope,
        terrain=row.strip.terrain,
        mode=mode,
        arrival="flat" if up else "forefoot" if down else "heel",
        departure="climb"
        if next_riser and next_rise > 0.02
        else "lower"
        if next_riser and next_rise < -0.02
        else "push",
        t_touch=row.t_touch,
        t_off=t_off,
    )
