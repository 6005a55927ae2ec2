"""A route laid out along x: the strips that its segments become."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stridetwin.sim.config import Level, Ramp, Route, Segment, Stairs
from stridetwin.streams.errors import ConfigError

LEAD_IN_M = 2.0
RUN_OUT_M = 2.0
RISER_RANGE_M = (0.02, 0.25)
TREAD_MIN_M = 0.2
RAMP_MAX_RAD = math.radians(20.0)
WIDTH_MIN_M = 0.8


@dataclass(frozen=True, kw_only=True)
class Strip:
    """One flat or sloping piece of the way, across its whole width.

    Attributes:
        x0: Where it begins, m.
        x1: Where it ends, m.
        z0: Height at x0, m.
        z1: Height at x1, m.
        terrain: level, stair or ramp.
    """

    x0: float
    x1: float
    z0: float
    z1: float
    terrain: str


def lay_out(route: Route) -> tuple[Strip, ...]:
    """Strips of a route, in order of x.

    Args:
        route: Segments along +x, from x = 0 at height 0.

    Returns:
        Strips from `LEAD_IN_M` behind the start to `RUN_OUT_M` beyond the end; where one's z1 differs from
        the next one's z0 there is a riser.

    Raises:
        ConfigError: A segment that cannot be built or walked; the message names field, value and range.
    """
    _check(route)
    strips = [Strip(x0=-LEAD_IN_M, x1=0.0, z0=0.0, z1=0.0, terrain="level")]
    x, z = 0.0, 0.0
    for segment in (*route.segments, Level(length_m=RUN_OUT_M)):
        pieces, x, z = _lay(segment, x, z)
        for strip in pieces:
            _append(strips, strip)
    return tuple(strips)


def _append(strips: list[Strip], strip: Strip) -> None:
    """Adds a strip, joined to the last one where both are one level of the same class."""
    last = strips[-1]
    if last.terrain == strip.terrain and last.z0 == last.z1 == strip.z0 == strip.z1:
        strips[-1] = Strip(x0=last.x0, x1=strip.x1, z0=last.z0, z1=strip.z1, terrain=last.terrain)
    else:
        strips.append(strip)


def _lay(segment: Segment, x: float, z: float) -> tuple[list[Strip], float, float]:
    """Strips of one segment that begins at (x, z), and where the next one begins."""
    match segment:
        case Level(length_m=length):
            end = x + length
            return [Strip(x0=x, x1=end, z0=z, z1=z, terrain="level")], end, z
        case Ramp(angle_rad=angle, rise_m=rise, down=down):
            end, top = x + rise / math.tan(angle), z - rise if down else z + rise
            return [Strip(x0=x, x1=end, z0=z, z1=top, terrain="ramp")], end, top
        case Stairs(risers=risers, riser_m=riser, tread_m=tread, down=down):
            step = -riser if down else riser
            treads = [
                Strip(
                    x0=x + i * tread, x1=x + (i + 1) * tread, z0=z + (i + 1) * step, z1=z + (i + 1) * step,
                    terrain="stair",
                )
                for i in range(risers - 1)
            ]  # fmt: skip
            return treads, x + (risers - 1) * tread, z + risers * step


def _check(route: Route) -> None:
    """Refuses what cannot be built or walked."""
    _demand("width_m", route.width_m, route.width_m >= WIDTH_MIN_M, f"at least {WIDTH_MIN_M} m")
    for i, segment in enumerate(route.segments):
        at = f"segments[{i}]"
        match segment:
            case Level(length_m=length):
                _demand(f"{at}.length_m", length, length > 0, "more than 0 m")
            case Ramp(angle_rad=angle, rise_m=rise):
                in_range = 0 < angle <= RAMP_MAX_RAD + 1e-9
                _demand(f"{at}.angle_rad", angle, in_range, f"above 0 up to {RAMP_MAX_RAD:.4f} rad (20 deg)")
                _demand(f"{at}.rise_m", rise, rise > 0, "more than 0 m (`down` tells the direction)")
            case Stairs(risers=risers, riser_m=riser, tread_m=tread):
                low, high = RISER_RANGE_M
                _demand(
                    f"{at}.risers",
                    risers,
                    isinstance(risers, int) and risers >= 1,
                    "a whole number from 1 on",
                )
                _demand(f"{at}.riser_m", riser, low - 1e-9 <= riser <= high + 1e-9, f"{low} to {high} m")
                _demand(f"{at}.tread_m", tread, tread >= TREAD_MIN_M, f"at least {TREAD_MIN_M} m")
                after = route.segments[i + 1 : i + 2]
                landing = not any(isinstance(s, Stairs) for s in after)
                _demand(f"segments[{i + 1}]", after, landing, "a level or a ramp after stairs, for the last riser")


def _demand(field: str, value: object, valid: bool, range_in_words: str) -> None:
    if not valid:
        raise ConfigError("route", field, value, range_in_words)
