"""Pitch of the feet over time: how each foot lands, lies flat, lifts its heel, leaves and swings.

On the level it follows the style of the step; over risers and on steep ramps it depends on the terrain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.gait.style import RISE_KNOTS, SWING_KNOTS, Style
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.streams.samples import Array

_PITCH_GRID_S = 0.004  # between the instants at which the pitch is smoothed
_LANDING_KNOTS = 3  # of the style's swing knots: the last ones belong to the landing, the others to the toe-off


# How the pitch depends on risers and slopes; chosen by hand for the ankle angles listed in `docs/design.md`.
#
# Higher risers and steeper ramps than the usual ones bend the knee and tilt the shank farther: the heel stays up for
# longer. Uphill the rear foot lifts the body: its heel rises earlier, and is higher at toe-off.
_USUAL_RISER_M = 0.155  # of the stairs whose ankle angles are listed
_USUAL_FALL_M = 0.095  # of a step on a ramp
_USUAL_SLOPE_RAD = 0.16  # of the ramps whose ankle angles are listed
_HEEL_OFF_BY_RISER = 3.0  # 1/m, longer time from heel-off to toe-off, per m beyond the usual riser
_HEEL_OFF_BY_FALL = 12.0  # 1/m, likewise, per m beyond the usual fall
_HEEL_OFF_BY_SLOPE = 2.5  # 1/rad, likewise, per rad beyond the usual slope
_PUSH_BY_RISE = 1.5  # rad/m, additional pitch at toe-off
_PUSH_BY_SLOPE = 0.9  # rad/rad, likewise, uphill
_EARLY_BY_SLOPE = 3.5  # 1/rad, earlier rise of the heel uphill
_TIPTOE_BY_RISE = 2.4  # rad/m, additional pitch at the landing on a high riser
_TIPTOE_BY_SLOPE = 1.8  # rad/rad, likewise, on a steep slope
_MIN_HEEL_FIRST_RAD = 0.03  # least toe-up pitch of a landing on the heel
_HIGH_RISE_M = 0.255  # of one step; on a higher one the foot stays on its ball until the body is over it
_HIGH_TIPTOE_RAD = 0.42  # additional pitch at that landing
_HIGH_LOWERING = (0.6, 0.95)  # share of that time, share of the pitch at touch-down
FLAT_BY = 0.6  # share of stance by which the foot is flat at the latest
_PITCH_SMOOTHING_S = 0.020  # SD of the Gaussian filter
_SETTLING_S = 0.04  # from the end of the landing to a sole that lies exactly flat


@dataclass(frozen=True, kw_only=True)
class Landing:
    """Landing of a foot; pitch in rad, toes down positive.

    Attributes:
        before: Knots (share of swing, pitch) before touch-down.
        touch: Pitch at touch-down.
        flat_after: Time until the foot is flat, as a share of the step's duration.
        lowering: Knots (share of that time, share of the pitch at touch-down) on the ground.
    """

    before: tuple[tuple[float, float], ...]
    touch: float
    flat_after: float
    lowering: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class ToeOff:
    """Toe-off of a foot; pitch in rad, toes down positive.

    Attributes:
        heel_off_before: Time from heel-off to toe-off, as a share of the step's duration.
        rise: Knots (share of that time, share of the pitch at toe-off).
        off: Pitch at toe-off.
        swing: Knots (share of swing, pitch) after toe-off.
    """

    heel_off_before: float
    rise: tuple[tuple[float, float], ...]
    off: float
    swing: tuple[tuple[float, float], ...]


LEAST_EDGE_M = 0.05  # lower differences of height are no edges for a foot that goes back or backwards
# knots of a swing backwards over an edge, (share of swing, pitch): the foot hangs from a bent leg
_BACK_UP_TIPTOE_RAD = 0.30  # additional pitch at a landing backwards and up
_BACK_OVER_EDGE = ((0.16, 0.02), (0.34, 0.22), (0.52, 0.28))
# knots of the rise of a heel: share of the time from heel-off to toe-off, share of the pitch at toe-off
_RISE = ((0.0, 0.0), (0.30, 0.05), (0.55, 0.20), (0.80, 0.55), (1.0, 1.0))
# Going down, the knee bends under the body until the ankle reaches its limit: then the heel has to rise quickly.
_LOWERING_RISE = ((0.0, 0.0), (0.16, 0.10), (0.30, 0.30), (0.42, 0.45), (0.60, 0.60), (0.80, 0.75), (1.0, 1.0))
_LANDINGS = {
    "flat": Landing(before=((0.72, 0.35), (0.88, 0.18)), touch=0.10, flat_after=0.16),
    # the calf lowers the heel slowly, while the load moves to the toes
    "forefoot": Landing(
        before=((0.78, 0.44), (0.90, 0.60)),
        touch=0.57,
        flat_after=0.26,
        lowering=((0.3, 0.87), (0.55, 0.66), (0.78, 0.33)),
    ),
}
# Walking backwards, the calf lowers the heel while the body comes over the foot, and the heel leaves last.
_LANDINGS["toe"] = Landing(
    before=((0.72, 0.12), (0.88, 0.25)),
    touch=0.27,
    flat_after=0.36,
    lowering=((0.3, 0.80), (0.6, 0.40), (0.8, 0.15)),
)
# on the ball until the turn is made, for longer than the step takes
_LANDINGS["ball"] = Landing(
    before=((0.72, 0.10), (0.88, 0.18)), touch=0.20, flat_after=1.37, lowering=((0.5, 0.90), (0.82, 0.75))
)
_TOE_OFFS = {
    "climb": ToeOff(heel_off_before=0.42, rise=_RISE, off=0.52, swing=((0.16, 0.85), (0.34, 0.90), (0.52, 0.75))),
    "lower": ToeOff(
        heel_off_before=0.48,
        rise=_LOWERING_RISE,
        off=0.70,
        swing=((0.16, 0.92), (0.30, 0.60), (0.50, 0.28), (0.63, 0.28)),
    ),
    "back": ToeOff(heel_off_before=0.26, rise=_RISE, off=-0.17, swing=((0.16, -0.13), (0.34, -0.03), (0.52, 0.04))),
}


def plan_pitch(steps: Sequence[Footstep], t_end: float) -> Callable[[Array], Array]:
    """Pitch of one foot against the ground, rad, toes down positive, as a smooth function of (N,) s.

    The pitch passes through knots: it is 0 while the sole is flat, rises from heel-off to toe-off, follows the swing,
    and returns to 0 after touch-down. A monotone cubic (PCHIP) through the knots is smoothed by a Gaussian; on a flat
    foot what smoothing leaves is faded out.

    Args:
        steps: The footsteps of this foot, in order.
        t_end: End of the walk, s.
    """
    flat = -10.0  # s, since when the foot is flat on its present footprint
    knots: list[tuple[float, float]] = [(flat, 0.0)]  # (s, pitch)
    flats: list[tuple[float, float]] = []  # (first, last instant) with a flat foot, for each footprint
    for a, b in pairwise(steps):  # from one footprint of this foot to its next one
        swing, duration = b.t_touch - a.t_off, step_time(a, b)
        toe_off, landing = _toe_off(a, b.style), _landing(b)
        heel_off = toe_off.heel_off_before * duration  # s, from heel-off to toe-off
        lowers = a.departure == "lower"
        # beyond the usual riser, fall and slope, the heel rises for longer before toe-off. `a.fall`: how much lower the
        # other foot's next footprint is; `b.rise`: how much higher this foot's next one is than the other foot's
        usual_fall, by_fall = (_USUAL_RISER_M, _HEEL_OFF_BY_RISER) if lowers else (_USUAL_FALL_M, _HEEL_OFF_BY_FALL)
        fall, rise = max(a.fall - usual_fall, 0.0), max(b.rise - _USUAL_RISER_M, 0.0)
        climb = max(-a.fall - _USUAL_RISER_M, 0.0)  # the other foot's next footprint is this much higher than usual
        # uphill where the foot leaves, or downhill where it lands
        steep = max(a.slope - _USUAL_SLOPE_RAD, -b.slope - _USUAL_SLOPE_RAD, 0.0)
        # the heel stays down for at least a tenth of the time from the flat foot to toe-off
        heel_off = min(heel_off * (1.0 + by_fall * fall + _HEEL_OFF_BY_SLOPE * steep), 0.9 * (a.t_off - flat))
        # additional pitch at the landing on a high riser or a steep slope, rad
        high = b.rise > _HIGH_RISE_M
        tiptoe = _HIGH_TIPTOE_RAD if high else _TIPTOE_BY_RISE * rise
        if b.arrival == "flat":
            tiptoe += _TIPTOE_BY_SLOPE * max(b.slope - _USUAL_SLOPE_RAD, 0.0)
        backs_up = b.arrival == "toe" and b.p_foot_in_world[2] - a.p_foot_in_world[2] > LEAST_EDGE_M
        if backs_up:  # the body is still in front of the foot, and comes up over its ball
            tiptoe = _BACK_UP_TIPTOE_RAD
        # uphill the heel rises earlier, and higher at toe-off
        uphill = max(a.slope, 0.0)
        push, early = _PUSH_BY_SLOPE * uphill, 1.0 / (1.0 + _EARLY_BY_SLOPE * uphill)
        off = b.swing.push * (toe_off.off + _PUSH_BY_RISE * climb + push)
        flats.append((flat, a.t_off - heel_off))
        # knots from heel-off (u = 0) to toe-off (u = 1); the exponent below 1 lets the heel rise earlier
        knots += [(a.t_off + (u - 1.0) * heel_off, share**early * off) for u, share in toe_off.rise]
        # uphill the sole comes down nearly parallel to the slope, because the ankle cannot raise the toes farther
        slope_pitch = min(max(b.slope, 0.0), -landing.touch - _MIN_HEEL_FIRST_RAD) if landing.touch < 0.0 else 0.0
        swing_knots, landing_knots = tuple((u, b.swing.push * x) for u, x in toe_off.swing), landing.before
        if a.departure == "back" and abs(a.p_foot_in_world[2] - b.p_foot_in_world[2]) > LEAST_EDGE_M:
            swing_knots = _BACK_OVER_EDGE
        if a.departure == "push" and b.arrival == "flat":  # toes that swing up would have to go down again at once
            swing_knots, landing_knots = tuple((u, max(angle, landing.touch)) for u, angle in swing_knots), ()
        if b.hesitation is not None:
            swing_knots, landing_knots = _delay(swing_knots, b, swing), _delay(landing_knots, b, swing)
        knots += [(a.t_off + u * swing, angle + tiptoe) for u, angle in swing_knots]
        knots += [(a.t_off + u * swing, angle + slope_pitch + tiptoe) for u, angle in landing_knots]
        # the sole comes down from the pitch of the landing until it lies flat
        flat = b.t_touch + min((landing.flat_after + tiptoe) * duration, FLAT_BY * (b.t_off - b.t_touch))
        touch, lowering_time = landing.touch + slope_pitch + tiptoe, flat - b.t_touch
        lowering = (_HIGH_LOWERING,) if high or backs_up else landing.lowering
        knots.append((b.t_touch, touch))
        knots += [(b.t_touch + u * lowering_time, k * touch) for u, k in lowering]
        knots.append((flat, 0.0))
    knots.append((t_end + 10.0, 0.0))
    flats.append((flat, t_end + 10.0))
    knot_times, knot_pitches = np.array(knots).T
    grid = np.arange(-1.0, t_end + 1.0, _PITCH_GRID_S)
    raw = PchipInterpolator(knot_times, knot_pitches)(grid)
    smoothed = gaussian_filter1d(raw, _PITCH_SMOOTHING_S / _PITCH_GRID_S, truncate=5.0)
    spline = make_interp_spline(grid, smoothed, k=5)
    first, last = np.array(flats).T  # (K,) s, first and last instant with a flat foot

    def pitch(t: Array) -> Array:
        """(N,) rad at (N,) s: the smoothed pitch, faded out while the sole is flat."""
        i = np.searchsorted(first, t, side="right") - 1  # the last stance whose flat part has begun
        lying = ease((t - first[i]) / _SETTLING_S) * ease((last[i] - t) / _SETTLING_S)
        return spline(t) * (1.0 - lying)  # fades out the pitch that smoothing leaves on a flat foot

    return pitch


def _delay(knots: tuple[tuple[float, float], ...], step: Footstep, swing_s: float) -> tuple[tuple[float, float], ...]:
    """Knots (share of swing, pitch) of the swing to `step`, which takes `swing_s` seconds as it hesitates."""
    if step.hesitation is None:
        return knots
    later = step.hesitation.share_at(np.array([u for u, _ in knots]), swing_s)
    return tuple((u, angle) for u, (_, angle) in zip(later.tolist(), knots))


def step_time(a: Footstep, b: Footstep) -> float:
    """Duration of the step from one footprint of a foot to its next, both feet on the ground included, s.

    It follows from the time of swing, which is the share 1 − `double_support` of the step.
    """
    return (b.t_touch - a.t_off) / (1.0 - float(b.style.double_support))


def _landing(step: Footstep) -> Landing:
    """Landing of the foot on the footprint `step`: on the heel in the step's own style, otherwise by the terrain."""
    if step.arrival != "heel":
        return _LANDINGS[step.arrival]
    style = step.style
    knots = list(zip(SWING_KNOTS, style.pitch.tolist()))  # (share of swing, pitch); the last one is touch-down
    before = tuple((u, angle + step.swing.toes_rad) for u, angle in knots[-_LANDING_KNOTS:-1])
    touch = min(knots[-1][1] + step.swing.toes_rad, -_MIN_HEEL_FIRST_RAD)
    return Landing(before=before, touch=touch, flat_after=float(style.flat_after))


def _toe_off(step: Footstep, style: Style) -> ToeOff:
    """Toe-off of the foot from the footprint `step`.

    With a push it has the `style` of the step that it begins; otherwise it depends on the terrain alone.
    """
    if step.departure != "push":
        return _TOE_OFFS[step.departure]
    knots = list(zip(SWING_KNOTS, style.pitch.tolist()))  # (share of swing, pitch); the first one is toe-off
    return ToeOff(
        heel_off_before=float(style.heel_off_before),
        rise=tuple(zip(RISE_KNOTS, [0.0, *style.rise.tolist(), 1.0])),  # 0 at heel-off, 1 at toe-off
        off=knots[0][1],
        swing=tuple(knots[1:-_LANDING_KNOTS]),
    )
