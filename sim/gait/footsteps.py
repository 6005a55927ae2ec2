"""From a route's layout to footsteps: where, when and in which manner each foot lands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.sim.body import Wearer
from stridetwin.sim.config import Gait
from stridetwin.sim.gait.curves import widening
from stridetwin.sim.gait.placement import STEEP_RAD, places
from stridetwin.sim.gait.style import Style, level_style
from stridetwin.sim.gait.tempo import Tempo
from stridetwin.sim.gait.timing import timing
from stridetwin.sim.gait_checks import check_gait
from stridetwin.sim.rotation import rot_x, rot_y, rot_z
from stridetwin.sim.route import Layout, Strip
from stridetwin.sim.way import Way
from stridetwin.streams.samples import Array

HALF_STEP_WIDTH_M = 0.060  # the shoes carry housings on their inner sides
TOE_OUT_RAD = 0.09
CLEARANCE_M = 0.018
_SLIDING_M = 0.005  # clearance of a foot that shuffles
_FLAT_SHUFFLE = 0.4  # above this, the foot lands on the whole sole
_LEAD_S = 0.3  # from the end of standing to the first step
SHIFT_S = 0.55  # weight shift from both feet to one, before the first step
SETTLE_S = 0.60  # and back to both after the last step


@dataclass(frozen=True, kw_only=True, eq=False)
class Footstep:
    """One footprint and its time on the ground.

    Attributes:
        foot: `l` or `r`.
        p_foot_in_world: (3,) m, the flat foot's origin.
        R_world_sole: (3, 3) of the flat foot: x along the foot in the ground's plane, z the ground's normal.
        s: Arc length along the way, m.
        heading: Direction of the way there, rad, unwrapped.
        slope: Inclination of the ground along the way, rad, uphill positive.
        rise: Height above the other foot's previous footprint, m.
        fall: Height above the other foot's next footprint, m.
        terrain: level, stair or ramp.
        mode: Locomotion mode of the step that ends here: LG, SA, SD, RA or RD.
        arrival: heel, flat or forefoot: the part that touches down first.
        departure: push, climb or lower: manner of toe-off.
        t_touch: Touch-down, s; -inf for the feet that stand at the start.
        t_off: Toe-off, s; inf for the feet that stand at the end.
        style: Style of the step that ends here.
        clearance_m: Clearance of the sole above the ground on the way here, m.
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
    style: Style
    clearance_m: float = CLEARANCE_M


def plan(layout: Layout, size: Wearer, gait: Gait, rng: np.random.Generator) -> tuple[list[Footstep], float]:
    """Footsteps along the way from s = 0 to the end of the route, and the walk's duration in s.

    The walk starts and ends on both feet. Each sole lies wholly on one strip: step lengths are adapted before an edge.

    Raises:
        ConfigError: A gait that is impossible to walk (the message names field, value and range), or a strip too short
            for a foot.
    """
    check_gait(gait)
    tempo = Tempo.along(layout, size, gait, rng)
    prints = places(layout, size, gait, tempo, rng)
    durations, styles = timing(layout.way, prints, size, gait, tempo, rng)
    touch = gait.stand_s + _LEAD_S + np.cumsum(durations)
    off = touch - durations * [1.0 - float(style.double_support) for style in styles]
    rows = [_Row(foot, 0.0, layout.profile[0], -np.inf, level_style(0.0)) for foot in ("l", "r")]
    rows += [_Row(p.foot, p.s, p.strip, t, style) for p, t, style in zip(prints, touch, styles)]
    steps = []
    for i, row in enumerate(rows):
        following = next((j for j in range(i + 1, len(rows)) if rows[j].foot == row.foot), None)
        t_off = np.inf if following is None else off[following - 2]
        before = rows[i - 1] if i >= 2 else row
        own_before = rows[i - 2] if i >= 2 else row
        after = rows[following] if following is not None else row
        ahead = rows[min(i + 1, len(rows) - 1)]
        steps.append(_footstep(layout.way, row, before, own_before, ahead, after, t_off, rng, gait))
    return steps, float(touch[-1] + SETTLE_S + gait.stand_s)


@dataclass(frozen=True)
class _Row:
    foot: str
    s: float
    strip: Strip
    t_touch: float
    style: Style

    @property
    def z(self) -> float:
        return self.strip.height(self.s, 0.0)


def _footstep(
    way: Way, row: _Row, before: _Row, own_before: _Row, ahead: _Row, after: _Row, t_off: float,
    rng: np.random.Generator, gait: Gait,
) -> Footstep:  # fmt: skip
    slope, heading = row.strip.slope, float(way.heading(row.s))
    rise = row.z - before.z
    risen, next_risen = _riser(before, row), _riser(row, after)
    joined = _riser(own_before, row) if before.strip is row.strip and before.s == row.s else 0.0
    mode = "SA" if risen >= 0.07 else "SD" if risen <= -0.07 else "LG"
    if row.strip.terrain == "ramp":
        mode = "RA" if slope > 0 else "RD"
    steep = slope > STEEP_RAD + 0.05
    flat = risen > 0.02 or joined != 0.0 or steep
    flat |= gait.shuffle > _FLAT_SHUFFLE and risen >= -0.02
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
        arrival="flat" if flat else "forefoot" if risen < -0.02 else "heel",
        departure="climb" if next_risen > 0.02 else "lower" if next_risen < -0.02 else "push",
        t_touch=row.t_touch,
        t_off=t_off,
        style=row.style,
        clearance_m=CLEARANCE_M + gait.shuffle * (_SLIDING_M - CLEARANCE_M),
    )


def _riser(a: _Row, b: _Row) -> float:
    """Height of the riser between two footprints, m; 0 without one, or on a ramp."""
    ramp = "ramp" in (a.strip.terrain, b.strip.terrain)
    return 0.0 if a.strip is b.strip or ramp else b.z - a.z
