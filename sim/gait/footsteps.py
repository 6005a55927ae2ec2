"""Footsteps of a route's layout: position, landing time and style of each step; and which gaits are possible.

A phase counts the steps, and quantities change smoothly from step to step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from stridetwin.sim.acts import Hesitate, LookBack
from stridetwin.sim.config import GAZES, MAX_ASYMMETRY, PATTERNS, SPEED_RANGE_MPS, STAIRS, SWAY_RANGE_HZ, Gait
from stridetwin.sim.gait.act_steps import act_style, check_acts, perform_acts
from stridetwin.sim.gait.foot_placement import (
    STEEP_RAD,
    Foothold,
    Tempo,
    limp_factor,
    plan_footholds,
    turn_share,
    widening,
)
from stridetwin.sim.gait.hesitation import Hesitation, lengthen_swing
from stridetwin.sim.gait.running import run_style, running_steps
from stridetwin.sim.gait.style import Style, apply_shuffle, level_style, pace, prolong, style_at
from stridetwin.sim.gait.twist import Twist
from stridetwin.sim.kinematics.smooth import smooth_gaussian
from stridetwin.sim.walk import Stance
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.algebra.arrays import rot_x, rot_y, rot_z
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, Strip
from stridetwin.streams.way import Way

# limits of the gaze: its pitch, its yaw to either side, and amplitude and angular rate of its sway
GAZE_PITCH_RANGE_RAD = (-0.6, 0.8)
MAX_GAZE_YAW_RAD = 0.7
MAX_SWAY_RAD, MAX_SWAY_RADPS = 0.7, 5.0


# Timing and places of steps; chosen by hand, except for what the styles prescribe.
_BEFORE_RUN_DOUBLE_SUPPORT = 0.05  # share of a step, of the last walked one before a run
_STAIR_DOUBLE_SUPPORT = 0.18  # share of a step; the same share of the stride is spent on both feet
_DOWNSTAIRS_DOUBLE_SUPPORT = 0.30  # likewise, downstairs, where it takes time to lower the heel
_STAIR_TRANSFER = 0.88  # share of double support in which the load moves, upstairs
_DOWNSTAIRS_TRANSFER = 0.60  # likewise, downstairs
_RAMP_TIME = 1.04  # step time relative to the level
_UPSTAIRS_TIME = 1.16  # relative to `_STAIR_STEP_S`
_DOWNSTAIRS_TIME = 1.04  # likewise
_STAIR_STEP_S = 0.60  # at the preferred speed of 1.2 m/s
_MAX_STAIR_SWING_S = 0.75  # slower climbers stand on both feet for longer
_HIGH_RISER_M = 0.18  # steps over higher ones take longer, in proportion
_TWO_TREADS_TIME = 1.1  # of a step over two treads at a time, relative to one
_MIN_TWO_TREADS_MPS = 1.1  # nobody takes two treads more slowly than at this speed
_PREFERRED_MPS = 1.2  # speed at which `_STAIR_STEP_S` holds
_TIME_BY_LENGTH = 0.45  # growth of the step time with the step length, relative to both
_LENGTH_RANGE = (0.3, 1.3)  # within which it grows
_MIN_FIRST_AND_LAST_TIME = 0.9  # least time of these steps relative to the usual one
_RUN_FIRST_AND_LAST_S = 0.5  # least time of these steps in a run
_MAX_TIME_ERROR = 0.06  # share of a step time, limit of its variability
_SHARED_TIME = (0.2, 0.6, 0.2)  # neighbouring steps share their tempo
_SHARED_SPEED = (0.25, 0.5, 0.25)  # likewise, the speed that determines the style
_SIDE_SD_M = 0.4  # m, lateral SD of a foothold per unit of `Gait.step_sd`
_MAX_SIDE_M = 0.015  # limit of that
_STEEP_TIME_BY_SLOPE = 2.5  # share of a step time per rad beyond `foot_placement.STEEP_RAD`
HALF_STEP_WIDTH_M = 0.060  # the shoes carry housings on their inner sides
TOE_OUT_RAD = 0.09  # of each foot, from the direction of the way
CLEARANCE_M = 0.018  # of the sole in swing
_SLIDING_CLEARANCE_M = 0.005  # likewise, of a foot that shuffles
_FLAT_SHUFFLE = 0.4  # above this shuffle, the foot lands on the whole sole
_LEAD_S = 0.3  # from the end of standing to the first step
WEIGHT_SHIFT_S = 0.55  # weight shift from both feet to one, before the first step
SETTLE_S = 0.60  # and back to both after the last step
_FLATTER = 0.7  # toes-up pitch of the short, quick steps before and after a run, relative to a walker's
RUN_LANDING_S = 0.032
"""Time before a runner's touch-down in which the ground stops the foot."""
_SMOOTHING_S = 0.09  # SD of the filter of what changes from step to step
_RISER_M = 0.02  # lower differences of height are no risers
_STAIR_MODE_M = 0.07  # riser from which a step is SA or SD (Zhao et al. 2023)


def check_gait(gait: Gait) -> None:
    """Rejects a gait that is impossible for the legs or the neck.

    Raises:
        ConfigError: The message names field, value and range.
    """
    slow, fast = SPEED_RANGE_MPS
    up, down = GAZE_PITCH_RANGE_RAD
    gaze, aside = gait.gaze, MAX_GAZE_YAW_RAD
    # amplitudes of the gaze's sway, limits of its frequency, and its highest angular rate, rad/s
    sways = {"yaw": gaze.sway_yaw_rad, "pitch": gaze.sway_pitch_rad}
    seldom, often = SWAY_RANGE_HZ
    fastest = 2 * math.pi * gaze.sway_hz * max(sways.values())
    # name of a field, its value, whether that is valid, and what is valid in words
    for field, value, valid, range_in_words in (
        ("pattern", gait.pattern, gait.pattern in PATTERNS, ", ".join(PATTERNS)),
        ("speed_mps", gait.speed_mps, slow <= gait.speed_mps <= fast, f"{slow}-{fast} m/s"),
        ("stairs", gait.stairs, gait.stairs in STAIRS, ", ".join(STAIRS)),
        ("leading_foot", gait.leading_foot, gait.leading_foot in ("l", "r"), "l, r"),
        ("asymmetry", gait.asymmetry, abs(gait.asymmetry) <= MAX_ASYMMETRY, f"{-MAX_ASYMMETRY} to {MAX_ASYMMETRY}"),
        ("shuffle", gait.shuffle, 0.0 <= gait.shuffle <= 1.0, "0-1"),
        ("shuffle", gait.shuffle, gait.pattern != "run" or gait.shuffle == 0.0, "0 in a run"),
        ("gaze.kind", gaze.kind, gaze.kind in GAZES, ", ".join(GAZES)),
        ("gaze.pitch_rad", gaze.pitch_rad, up <= gaze.pitch_rad <= down, f"{up} to {down} rad, down positive"),
        ("gaze.yaw_rad", gaze.yaw_rad, abs(gaze.yaw_rad) <= aside, f"{-aside} to {aside} rad, left positive"),
        *(
            (f"gaze.sway_{axis}_rad", sway, 0.0 <= sway <= MAX_SWAY_RAD, f"0-{MAX_SWAY_RAD} rad")
            for axis, sway in sways.items()
        ),
        ("gaze.sway_hz", gaze.sway_hz, seldom <= gaze.sway_hz <= often, f"{seldom}-{often} Hz"),
        (
            "gaze.sway_hz",
            gaze.sway_hz,
            fastest <= MAX_SWAY_RADPS,
            f"2 pi times rate and amplitude, the highest angular rate, of up to {MAX_SWAY_RADPS:g} rad/s",
        ),
    ):
        if not valid:
            raise ConfigError("gait", field, value, range_in_words)


def plan_timing(
    way: Way, holds: Sequence[Foothold], size: Wearer, gait: Gait, tempo: Tempo, rng: np.random.Generator
) -> tuple[Array, list[Style]]:
    """Times between touch-downs, and the walking style of each step.

    Args:
        way: The way.
        holds: (N) footholds in order.
        size: Wearer.
        gait: Gait of the person.
        tempo: Speed and step length along the way.
        rng: Draws the errors of the step times.

    Returns:
        (N,) s from the previous touch-down to each touch-down, pauses included, and the N styles.
    """
    rises = _riser_heights(holds)
    without_limp = _step_durations(way, holds, rises, gait, tempo, rng)
    styles = [apply_shuffle(style, gait.shuffle) for style in _step_styles(holds, rises, without_limp, size, gait)]
    for i, hold in enumerate(holds):
        if hold.manner != "walk":
            without_limp[i], styles[i] = hold.time_s, act_style()
        elif isinstance(hold.act, Hesitate) and hold.act.how != "half_steps":
            longer = 1.0 + hold.act.for_s / float(without_limp[i])
            without_limp[i], styles[i] = longer * without_limp[i], lengthen_swing(styles[i], longer)
    durations = without_limp * [limp_factor(gait, hold.foot) for hold in holds]
    # a pause at a foothold delays the next step, and both feet stay on the ground for longer
    pauses = np.array([0.0, *(hold.pause_s for hold in holds[:-1])])
    styles = [prolong(style, 1.0 + pause / t) for style, pause, t in zip(styles, pauses.tolist(), durations.tolist())]
    return durations + pauses, styles


def _riser_heights(holds: Sequence[Foothold]) -> list[float]:
    """Height of the riser of each step, m, up positive; 0 for a step without riser.

    A step that brings one foot beside the other has the riser of the step before: both feet climb the same riser.
    """
    rises = [0.0]  # of the first step
    for i in range(1, len(holds)):
        hold, before = holds[i], holds[i - 1]
        if before.s == hold.s and before.strip is hold.strip and i > 1:
            before = holds[i - 2]  # the place that this foot leaves
        # footholds 1 m apart or more do not count as the two sides of one riser
        rise = 0.0 if hold.s - before.s >= 1.0 else _riser_height(before.strip, hold.strip)
        rises.append(rise if abs(rise) > _RISER_M else 0.0)
    return rises


def _step_durations(
    way: Way, holds: Sequence[Foothold], rises: Sequence[float], gait: Gait, tempo: Tempo, rng: np.random.Generator
) -> Array:
    """(N,) s, durations of the steps without limp and pauses.

    A step over a riser takes `_STAIR_STEP_S` √(1.2 m/s / v) times a factor for up or down, and longer if the riser is
    high. `rises` (N) are the heights of the risers, m, 0 for none. Elsewhere the level step time grows
    with the ratio of the step's length to the usual one, and it is longer in curves and on ramps. A random error of up
    to `_MAX_TIME_ERROR` is added, and neighbouring steps are averaged: people do not change cadence abruptly.
    """
    durations, previous = [], 0.0  # `previous` is the arc length of the foothold before
    for i, (hold, rise) in enumerate(zip(holds, rises)):
        s = hold.s
        middle = (s + previous) / 2
        level_step = tempo.duration(middle)
        if rise:
            speed, high = tempo.stair_speed(s), abs(rise)
            time_factor = _UPSTAIRS_TIME if rise > 0.0 else _DOWNSTAIRS_TIME
            if hold.treads > 1:  # two treads at a time: never slowly, and `high` is then that of one riser
                speed, high = max(speed, _MIN_TWO_TREADS_MPS), high / hold.treads
                time_factor *= _TWO_TREADS_TIME
            duration = _STAIR_STEP_S * np.sqrt(_PREFERRED_MPS / speed) * time_factor * max(high / _HIGH_RISER_M, 1.0)
        else:
            # in a curve, steps are shorter and take longer. The time grows with the length or the turn of a step,
            # relative to the usual ones
            slower = float(tempo.shorter_in_curves(np.array(middle)))
            ratio = max((s - previous) / (float(tempo.step_length(middle)) * slower), turn_share(way, previous, s))
            ratio = np.clip(ratio, *_LENGTH_RANGE)
            ramp = hold.strip.terrain == "ramp"
            steep = max(abs(hold.strip.slope) - STEEP_RAD, 0.0) if ramp else 0.0
            time_factor = (_RAMP_TIME if ramp else 1.0) * (1.0 + _STEEP_TIME_BY_SLOPE * steep) / slower
            duration = level_step * time_factor * (1.0 - _TIME_BY_LENGTH + _TIME_BY_LENGTH * ratio)
        if i == 0 or i == len(holds) - 1:  # from standing, and to standing
            duration = max(duration, _MIN_FIRST_AND_LAST_TIME * level_step)
            if gait.pattern == "run":  # walked, at a walker's tempo
                duration = max(duration, _RUN_FIRST_AND_LAST_S)
        error = np.clip(rng.normal(0.0, gait.step_sd), -_MAX_TIME_ERROR, _MAX_TIME_ERROR)
        durations.append(duration * (1.0 + error))
        previous = s
    # mean of each step and its neighbours, weighted by `_SHARED_TIME`
    return np.convolve(np.pad(durations, 1, mode="edge"), _SHARED_TIME, mode="valid")


def _step_styles(
    holds: Sequence[Foothold], rises: Sequence[float], durations: Array, size: Wearer, gait: Gait
) -> list[Style]:
    """Style of each step by its own speed; steps over risers get the double support and the swing time of stairs.

    Args:
        holds: (N) footholds in order.
        rises: (N) m, height of the riser of each step, 0 for none.
        durations: (N,) s, duration of each step.
        size: Wearer.
        gait: Gait of the person.
    """
    speeds = np.abs(np.diff([0.0, *(hold.s for hold in holds)])) / durations
    speeds = np.convolve(np.pad(speeds, 1, mode="edge"), _SHARED_SPEED, mode="valid")
    styles = []
    for speed, rise, previous_rise, duration in zip(speeds, rises, [0.0, *rises], durations.tolist()):
        style = style_at(pace(speed, size))
        if rise:
            transfer = _STAIR_TRANSFER if rise > 0.0 else _DOWNSTAIRS_TRANSFER
            # the table's style without the changes for slow walkers: along the way, everyone is slow on stairs
            style = replace(level_style(pace(speed, size)), double_support=_STAIR_DOUBLE_SUPPORT, transfer=transfer)
        if previous_rise < 0.0:  # after a step down
            style = replace(style, double_support=max(style.double_support, _DOWNSTAIRS_DOUBLE_SUPPORT))
        if rise:  # a swing longer than the limit is shortened to it, and both feet stay on the ground for longer
            swing = duration * (1.0 - float(style.double_support))
            style = prolong(style, max(swing / _MAX_STAIR_SWING_S, 1.0))
        styles.append(style)
    if gait.pattern == "run":
        is_run = running_steps(rises, [hold.pause_s for hold in holds])
        for i, runs in enumerate(is_run):
            if runs:
                styles[i] = run_style(float(speeds[i]), float(durations[i]), size)
            elif is_run[i + 1 : i + 2] == [True]:  # who is about to fly leaves the ground early: steps are long already
                styles[i] = replace(styles[i], double_support=min(styles[i].double_support, _BEFORE_RUN_DOUBLE_SUPPORT))
            else:
                styles[i] = replace(styles[i], pitch=np.where(styles[i].pitch < 0.0, _FLATTER, 1.0) * styles[i].pitch)
    return styles


@dataclass(frozen=True, kw_only=True)
class SwingVariation:
    """How one swing differs from that of its style (`swing_variability`).

    Attributes:
        push: Factor on the pitch of the foot from the rise of its heel to the middle of the swing.
        toes_rad: Additional pitch of a landing on the heel, toes down positive.
        lift_m: Additional height of the foot in mid-swing.
        landing: Factor on the speed at which the heel lands.
    """

    push: float = 1.0
    toes_rad: float = 0.0
    lift_m: float = 0.0
    landing: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Footstep(Stance):
    """A planned stance, and how the foot comes there and leaves.

    Attributes:
        s: Arc length along the way, m.
        heading: Direction of the way there, rad, unwrapped.
        slope: Inclination of the ground along the way, rad, uphill positive.
        rise: Height above the other foot's previous footprint, m.
        fall: Height above the other foot's next footprint, m.
        arrival: heel, flat or forefoot: the part that touches down first; toe backwards, ball before a turn.
        departure: push, climb or lower: manner of toe-off; back when the foot goes on backwards.
        style: Style of the step that ends here.
        clearance_m: Clearance of the sole above the ground on the way here, m.
        pause_s: Time for which the walker stands still on both feet after this touch-down, s.
        swing: How the swing to here differs from that of the style.
        hesitation: How the swing to here hesitates; None if it does not.
        twist: How the foot turns on its ball; None if it does not.
        look_back: Look over the shoulder that begins at this touch-down; None for none.
        flat_toes: Whether the toes stay flat on the ground until toe-off.
        toes_bend_rad: How much farther than usual they bend before toe-off.
    """

    s: float
    heading: float
    slope: float
    rise: float
    fall: float
    arrival: str
    departure: str
    style: Style
    clearance_m: float = CLEARANCE_M
    pause_s: float = 0.0
    swing: SwingVariation = SwingVariation()
    hesitation: Hesitation | None = None
    twist: Twist | None = None
    look_back: LookBack | None = None
    flat_toes: bool = False
    toes_bend_rad: float = 0.0

    @property
    def rolls_off(self) -> bool:
        """Whether the shoe rolls over its tip before toe-off."""
        return self.departure == "push" and self.twist is None and not (self.flat_toes or self.is_run)

    @property
    def is_run(self) -> bool:
        """Whether a flight precedes this touch-down."""
        return float(self.style.double_support) < 0.0

    @property
    def t_press(self) -> float:
        """When the foot begins to press, s: a runner's sole and heel pad stop the foot until it has touched down."""
        return self.t_touch - RUN_LANDING_S if self.is_run else self.t_touch


def plan_footsteps(
    layout: Layout, size: Wearer, gait: Gait, rng: np.random.Generator, half_width_m: float = np.inf
) -> tuple[list[Footstep], float]:
    """Footsteps along the way from s = 0 to the end of the route, and the walk's duration in s.

    The walk starts and ends on both feet. Each sole lies wholly on one strip: step lengths are adapted before an edge.

    Args:
        layout: Route in the world.
        size: Wearer.
        gait: Gait of the person.
        rng: Draws the variability of the steps.
        half_width_m: Half of the width of the way, m, which the feet do not leave.

    Raises:
        ConfigError: A gait that is impossible to walk (the message names field, value and range), or a strip too short
            for a foot.
    """
    check_gait(gait)
    check_acts(gait)
    tempo = Tempo.along(layout, size, gait, rng)
    holds = plan_footholds(layout, size, gait, tempo, rng)
    if gait.acts:
        holds = perform_acts(holds, gait, layout.way, half_width_m, size.shoe, rng.spawn(1)[0])
    durations, styles = plan_timing(layout.way, holds, size, gait, tempo, rng)
    touch = gait.stand_s + _LEAD_S + np.cumsum(durations)
    # toe-off of the foot that makes each step: its swing is the share 1 − double_support before the touch-down
    off = touch - durations * [1.0 - float(style.double_support) for style in styles]
    # all footprints in order: first the two on which the walker stands
    first = [Foothold(foot=foot, s=0.0, strip=layout.profile[0]) for foot in ("l", "r")]
    rows = [_Row(hold, -np.inf, level_style(0.0)) for hold in first]
    rows += [_Row(hold, t, style) for hold, t, style in zip(holds, touch, styles)]
    steps = []
    for i, row in enumerate(rows):
        # number of the next footprint of the same foot; `off[k]` is the toe-off before row k + 2, after the first two
        following = next((j for j in range(i + 1, len(rows)) if rows[j].foot == row.foot), None)
        t_off = np.inf if following is None else off[following - 2]
        # the feet alternate, except that rows 1 and 2 are both the right foot's: it starts beside the left one, and
        # always takes the first step (`leading_foot` concerns stairs alone)
        before, before_of_foot = (rows[i - 1], rows[i - 2]) if i >= 2 else (row, row)
        after = rows[following] if following is not None else row
        ahead = rows[min(i + 1, len(rows) - 1)]
        steps.append(_footstep(layout.way, row, before, before_of_foot, ahead, after, t_off, rng, gait))
    return steps, float(touch[-1] + SETTLE_S + gait.stand_s)


@dataclass(frozen=True)
class _Row:
    """A footprint with its time and style, before its pose in the world is known.

    Attributes:
        hold: Its foothold.
        t_touch: Touch-down, s; -inf for the feet that stand at the start.
        style: Style of the step that ends here.
    """

    hold: Foothold
    t_touch: float
    style: Style

    @property
    def foot(self) -> str:
        """`l` or `r`."""
        return self.hold.foot

    @property
    def s(self) -> float:
        """Arc length along the way, m."""
        return self.hold.s

    @property
    def strip(self) -> Strip:
        """Strip of ground there."""
        return self.hold.strip

    @property
    def z(self) -> float:
        """Height of the ground on the way there, m."""
        return self.strip.height(self.s, 0.0)


def _footstep(
    way: Way,
    row: _Row,
    before: _Row,
    before_of_foot: _Row,
    ahead: _Row,
    after: _Row,
    t_off: float,
    rng: np.random.Generator,
    gait: Gait,
) -> Footstep:
    """The footstep of a row: its pose in the world, its locomotion mode, and how the foot arrives and leaves.

    Args:
        way: The way.
        row: The footprint.
        before: The footprint before it, of the other foot; for the feet that stand at the start, the footprint itself.
        before_of_foot: The one before that, of the same foot; likewise.
        ahead: The next footprint, of the other foot; at the end, the footprint itself.
        after: The next footprint of the same foot; at the end, likewise.
        t_off: Toe-off, s.
        rng: Draws the lateral error.
        gait: Gait of the person.
    """
    slope, yaw = row.strip.slope, row.hold.yaw_rad
    heading = float(way.heading(row.s))
    # risers, m up, on the step to here and on the foot's next step
    rise_before, rise_after = _riser_height(before.strip, row.strip), _riser_height(row.strip, after.strip)
    # riser since this foot's previous footprint, if the foot is placed beside the other one; otherwise 0
    rise_of_foot = (
        _riser_height(before_of_foot.strip, row.strip) if before.strip is row.strip and before.s == row.s else 0.0
    )
    # a step over a riser of at least `_STAIR_MODE_M` is stair ascent or descent; on a ramp the slope decides
    mode = "SA" if rise_before >= _STAIR_MODE_M else "SD" if rise_before <= -_STAIR_MODE_M else "LG"
    if row.strip.terrain == "ramp":
        mode = "RA" if (slope > 0) == (row.s >= before.s) else "RD"
    # the whole sole lands up a riser, beside the other foot behind a riser, up a steep ramp, and of a shuffling foot
    steep = slope > STEEP_RAD + 0.05  # rad: 3° more than where steps become shorter
    flat = rise_before > _RISER_M or rise_of_foot != 0.0 or steep
    flat |= gait.shuffle > _FLAT_SHUFFLE and rise_before >= -_RISER_M
    flat |= row.hold.manner == "place"
    arrival = "flat" if flat else "forefoot" if rise_before < -_RISER_M else "heel"
    departure = "climb" if rise_after > _RISER_M else "lower" if rise_after < -_RISER_M else "push"
    if row.hold.manner == "back":
        arrival = "toe"
    elif row.hold.manner == "pivot":
        arrival = "ball"
    if after is not row and after.hold.manner == "back":
        departure = "back"
    side = 1.0 if row.foot == "l" else -1.0
    error = np.clip(rng.normal(0.0, _SIDE_SD_M * gait.step_sd), -_MAX_SIDE_M, _MAX_SIDE_M)
    away = side * (HALF_STEP_WIDTH_M + widening(way, before.s, row.s)) + float(error)  # from between the feet
    left = math.cos(yaw) * away + row.hold.left_m
    s = row.s - math.sin(yaw) * away
    # the ground rises by tan(cross slope) per horizontal metre to the left, also where it is inclined along the way
    tilt = math.atan(math.tan(row.strip.cross_slope) * math.cos(slope))
    R_world_ground = rot_z(np.array(heading)) @ rot_y(np.array(-slope)) @ rot_x(np.array(tilt))
    return Footstep(
        foot=row.foot,
        p_foot_in_world=np.array([*way.point(s, left), row.strip.height(s, left)]),
        R_world_sole=R_world_ground @ rot_z(np.array(side * TOE_OUT_RAD + yaw)),
        s=row.s,
        heading=heading + yaw,
        slope=slope,
        rise=row.z - before.z,
        fall=row.z - ahead.z,
        terrain=row.strip.terrain,
        mode=mode,
        arrival=arrival,
        departure=departure,
        # the swing goes over an edge and back to this height: toes that rolled would be in the way
        flat_toes=_riser_height(row.strip, ahead.strip) != 0.0,
        t_touch=row.t_touch,
        t_off=t_off,
        style=row.style,
        clearance_m=CLEARANCE_M + gait.shuffle * (_SLIDING_CLEARANCE_M - CLEARANCE_M),
        pause_s=row.hold.pause_s,
        hesitation=_hesitation(row.hold),
        twist=row.hold.twist,
        look_back=row.hold.act if isinstance(row.hold.act, LookBack) else None,
    )


def _hesitation(hold: Foothold) -> Hesitation | None:
    """How the swing to a foothold hesitates; None if it does not."""
    act = hold.act
    if not isinstance(act, Hesitate) or act.how == "half_steps":
        return None
    return Hesitation(how=act.how, for_s=act.for_s)


def _riser_height(a: Strip, b: Strip) -> float:
    """Height of the risers between a footprint on strip `a` and the next one on strip `b`, m, up positive.

    It is 0 within one strip; `z0` and `z1` are the heights at the beginning and the end of a strip.
    """
    if b.s0 < a.s0:  # backwards
        return b.z1 - a.z0
    return 0.0 if a is b else b.z0 - a.z1


@dataclass(frozen=True, kw_only=True, eq=False)
class Rhythm:
    """The walking steps of both feet in order of time.

    Attributes:
        steps: (K) footsteps with a touch-down.
        begin: (K,) s, when each step begins: the touch-down before it.
        end: (K,) s, its own touch-down.
    """

    steps: Sequence[Footstep]
    begin: Array
    end: Array

    @classmethod
    def of(cls, steps: Mapping[str, Sequence[Footstep]]) -> Rhythm:
        """Rhythm of the footsteps of both feet."""
        all_steps = [s for steps_of_foot in steps.values() for s in steps_of_foot]
        # without the two footprints on which the walker stands at the start
        order = sorted((s for s in all_steps if np.isfinite(s.t_touch)), key=lambda s: s.t_touch)
        end = np.array([s.t_touch for s in order])
        first_off = min(s.t_off for s in all_steps)
        share = float(order[0].style.double_support)
        # the first step has no touch-down before it: it begins such that the first toe-off ends its double support
        begin = np.concatenate([[(first_off - share * end[0]) / (1.0 - share)], end[:-1]])
        return cls(steps=order, begin=begin, end=end)

    def phase(self, t: Array) -> Array:
        """(N,) number of steps made until (N,) uniform s, smooth.

        It is 0 when the first step begins. It goes on for one more step before that and after the last step, and is
        constant beyond.
        """
        knots = np.concatenate([[self.begin[0]], self.end])
        # one more step at each end, so that the slope is that of the steps there
        lead = self.end[0] - self.begin[0], self.end[-1] - self.begin[-1]
        knots = np.concatenate([[knots[0] - lead[0]], knots, [knots[-1] + lead[1]]])
        count = np.arange(-1.0, len(knots) - 1.0)  # number of steps at each knot
        phase = PchipInterpolator(knots, count)(np.clip(t, knots[0], knots[-1]))
        return smooth_gaussian(phase, _SMOOTHING_S, t[1] - t[0])

    def blend(self, t: Array, values: Array, before: float, after: float) -> Array:
        """One value per step as a smooth function of time.

        Args:
            t: (N,) uniform s.
            values: (K,) values, which hold in the middle of their steps.
            before: Value while the walker stands at the start.
            after: Value while the walker stands at the end.

        Returns:
            (N,) linear interpolation of these values, smoothed.
        """
        middle = (self.begin + self.end) / 2
        # `before` holds until half a weight shift before the first step, `after` from half the settling after the last
        knots = np.concatenate([[self.begin[0] - WEIGHT_SHIFT_S / 2], middle, [self.end[-1] + SETTLE_S / 2]])
        linear = np.interp(t, knots, np.concatenate([[before], values, [after]]))
        return smooth_gaussian(linear, _SMOOTHING_S, t[1] - t[0])

    def blend_style(self, t: Array, name: str, standing_value: float, index: int | None = None) -> Array:
        """One field of the steps' styles as a smooth function of time (`blend`).

        Args:
            t: (N,) uniform s.
            name: Field of `Style`.
            standing_value: Its value in quiet stance at both ends.
            index: Entry of a field that is an array.

        Returns:
            (N,) values in the field's unit.
        """
        fields_of_steps = [getattr(step.style, name) for step in self.steps]
        values = np.array([field if index is None else field[index] for field in fields_of_steps])
        return self.blend(t, values, standing_value, standing_value)
