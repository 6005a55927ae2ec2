"""Checks of what can be built and walked, segment by segment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import assert_never

from stridetwin.sim.config import (
    LIGHT_RANGE,
    MAX_BYSTANDERS,
    MAX_LANES,
    SCENERIES,
    TEXTURES,
    THINGS,
    Lanes,
    Level,
    Ramp,
    Route,
    Segment,
    Stairs,
    Turn,
)
from stridetwin.streams.errors import ConfigError

RISER_RANGE_M = (0.02, 0.25)
MIN_TREAD_M = 0.2
MAX_WINDING_RAD = math.radians(270.0)  # turn of a whole stair
MAX_WINDER_RAD = math.radians(30.0)  # turn of one of its treads
MIN_POLE_M = 0.1  # from the centre of its turn to the treads
MAX_RAMP_RAD = math.radians(20.0)
MAX_CROSS_SLOPE_RAD = math.radians(5.0)
MIN_TURN_RADIUS_M = 1.0
MAX_TURN_RAD = math.radians(360.0)
MIN_LEVEL_BY_TURN_M = 0.5  # length of a level beside a turn
MIN_WIDTH_M = 0.8  # of the way
PASSING_WIDTH_M = 1.6  # of a way on whose stairs and ramps bystanders pass
_TINY = 1e-9  # tolerance for rounding


def check_segments(route: Route) -> None:
    """Rejects routes that cannot be built or walked.

    Raises:
        ConfigError: The message names field, value and range.
    """
    _require("width_m", route.width_m, route.width_m >= MIN_WIDTH_M, f"at least {MIN_WIDTH_M} m")
    _require("scenery", route.scenery, route.scenery in SCENERIES, ", ".join(SCENERIES))
    _require("texture", route.texture, route.texture in TEXTURES, ", ".join(TEXTURES))
    dark, bright = LIGHT_RANGE
    _require("light", route.light, dark <= route.light <= bright, f"{dark}-{bright}, 1 is daylight")
    few = isinstance(route.bystanders, int) and 0 <= route.bystanders <= MAX_BYSTANDERS
    _require("bystanders", route.bystanders, few, f"a whole number, 0-{MAX_BYSTANDERS}")
    for i, thing in enumerate(route.things):
        _require(f"things[{i}].kind", thing.kind, thing.kind in THINGS, ", ".join(THINGS))
        through = thing.kind != "door" or not route.bystanders
        _require("bystanders", route.bystanders, through, "0, as nobody beside the walker fits through a door")
    # bystanders need room to pass on uneven ground
    uneven = any(isinstance(s, Stairs | Ramp | Lanes) for s in route.segments)
    wide = not (route.bystanders and uneven) or route.width_m >= PASSING_WIDTH_M - _TINY
    valid = f"at least {PASSING_WIDTH_M} m, for bystanders to pass on stairs and ramps"
    _require("width_m", route.width_m, wide, valid)
    _check_chain(route.segments, "segments")
    for i, segment in enumerate(route.segments):
        neighbours = [(k, route.segments[k]) for k in (i - 1, i + 1) if 0 <= k < len(route.segments)]
        if isinstance(segment, Turn):
            for k, neighbour in neighbours:
                _check_beside_turn(f"segments[{k}]", neighbour)
        if isinstance(segment, Stairs) and segment.turn_rad:
            _check_winding(segment, f"segments[{i}]", route.width_m)
        if isinstance(segment, Lanes):
            for k, neighbour in neighbours:
                level = isinstance(neighbour, Level) and neighbour.cross_slope_rad == 0.0
                _require(
                    f"segments[{k}]", _kind(neighbour), level, "a level without cross slope before and after lanes"
                )


def _check_chain(segments: Sequence[Segment], name: str) -> None:
    """Rejects segments of a route or of a lane with invalid values, or in an invalid order."""
    for i, segment in enumerate(segments):
        at = f"{name}[{i}]"
        match segment:
            case Level(length_m=length, cross_slope_rad=cross):
                _require(f"{at}.length_m", length, length > 0, "more than 0 m")
                _check_cross_slope(cross, at)
            case Ramp(angle_rad=angle, rise_m=rise, cross_slope_rad=cross):
                _check_cross_slope(cross, at)
                limit = f"above 0 up to {MAX_RAMP_RAD:.4f} rad (20 deg)"
                _require(f"{at}.angle_rad", angle, 0 < angle <= MAX_RAMP_RAD + _TINY, limit)
                _require(f"{at}.rise_m", rise, rise > 0, "more than 0 m (`down` gives the direction)")
            case Stairs():
                _check_stairs(segment, at)
                landing = not any(isinstance(s, Stairs) for s in segments[i + 1 : i + 2])  # no stairs directly after
                _require(f"{name}[{i + 1}]", "stairs", landing, "a level or a ramp after stairs, for the last riser")
            case Turn(angle_rad=angle, radius_m=radius):
                valid = f"up to {MAX_TURN_RAD:.4f} rad (360 deg) either way, but not 0"
                _require(f"{at}.angle_rad", angle, 0 < abs(angle) <= MAX_TURN_RAD + _TINY, valid)
                valid = f"0 (on the spot), or at least {MIN_TURN_RADIUS_M} m"
                _require(f"{at}.radius_m", radius, radius == 0 or radius >= MIN_TURN_RADIUS_M, valid)
            case Lanes(lanes=lanes, walk=walk):
                _require(f"{at}.lanes", len(lanes), 2 <= len(lanes) <= MAX_LANES, f"2-{MAX_LANES} lanes")
                _require(f"{at}.walk", walk, 0 <= walk < len(lanes), f"0-{len(lanes) - 1}, the existing lanes")
                for k, lane in enumerate(lanes):
                    straight = bool(lane) and all(isinstance(s, Level | Stairs | Ramp) for s in lane)
                    _require(f"{at}.lanes[{k}]", lane, straight, "level, stairs and ramps")
                    _check_chain(lane, f"{at}.lanes[{k}]")
                    for m, part in enumerate(lane):  # the landing beside it belongs to all lanes
                        if isinstance(part, Stairs):
                            radius = part.edge_radius_m
                            _require(f"{at}.lanes[{k}][{m}].edge_radius_m", radius, radius == 0, "0 m")
                            _require(f"{at}.lanes[{k}][{m}].turn_rad", part.turn_rad, part.turn_rad == 0, "0 rad")
            case _:
                assert_never(segment)  # so that types show a new kind of segment without a check


def _check_cross_slope(cross: float, at: str) -> None:
    """Rejects a tilt sideways, rad, that is too steep."""
    limit = f"up to {MAX_CROSS_SLOPE_RAD:.4f} rad (5 deg) either way"
    _require(f"{at}.cross_slope_rad", cross, abs(cross) <= MAX_CROSS_SLOPE_RAD + _TINY, limit)


def _check_stairs(stairs: Stairs, at: str) -> None:
    """Rejects stairs with invalid risers, treads or edges."""
    low, high = RISER_RANGE_M
    risers, heights = stairs.risers, stairs.heights_m
    _require(f"{at}.risers", risers, isinstance(risers, int) and risers >= 1, "a whole number from 1 on")
    _require(f"{at}.riser_m", heights, len(heights) == risers, f"one height, or one for each of {risers} risers")
    for height in heights:
        _require(f"{at}.riser_m", height, low - _TINY <= height <= high + _TINY, f"{low} to {high} m")
    _require(f"{at}.tread_m", stairs.tread_m, stairs.tread_m >= MIN_TREAD_M, f"at least {MIN_TREAD_M} m")
    radius, is_solid = stairs.edge_radius_m, not (stairs.nosing_m or stairs.open_risers)
    _require(f"{at}.edge_radius_m", radius, 0 <= radius <= min(heights) + _TINY, "0 m up to the lowest riser")
    _require(f"{at}.edge_radius_m", radius, is_solid or radius == 0, "0 m with nosings or open risers")


def _check_winding(stairs: Stairs, at: str, width: float) -> None:
    """Rejects a winding stair that turns too far, or whose treads would meet at its pole."""
    turn, treads = abs(stairs.turn_rad), stairs.risers - 1
    _require(f"{at}.risers", stairs.risers, treads >= 2, "3 or more risers of a stair that winds")
    _require(
        f"{at}.turn_rad", stairs.turn_rad, turn <= MAX_WINDING_RAD + _TINY, "up to 4.7124 rad (270 deg) either way"
    )
    valid = f"up to {MAX_WINDER_RAD:.4f} rad (30 deg) per tread"
    _require(f"{at}.turn_rad", stairs.turn_rad, turn <= treads * MAX_WINDER_RAD + _TINY, valid)
    _require(f"{at}.open_risers", stairs.open_risers, not stairs.open_risers, "false on a stair that winds")
    slope = stairs.tread_slope_rad
    _require(f"{at}.tread_slope_rad", slope, slope == 0.0, "0 rad on a stair that winds")
    # twice the radius of the middle of the way, less the pole
    widest = 2.0 * (treads * stairs.tread_m / turn - MIN_POLE_M)
    valid = f"up to {widest:.2f} m, so that the treads of its winding stairs do not meet at the pole"
    _require("width_m", width, bool(width <= widest + _TINY), valid)


def _check_beside_turn(at: str, segment: Segment) -> None:
    """Rejects a segment next to a turn that is neither a turn nor a level of sufficient length."""
    suits = isinstance(segment, Turn) or (
        isinstance(segment, Level)
        and segment.cross_slope_rad == 0.0
        and segment.length_m >= MIN_LEVEL_BY_TURN_M - _TINY
    )
    valid = f"a turn, or a level of at least {MIN_LEVEL_BY_TURN_M} m without cross slope, beside a turn"
    _require(at, _kind(segment), suits, valid)


def _kind(segment: Segment) -> str:
    """Name of a segment's kind in scenario files."""
    return type(segment).__name__.lower()


def _require(field: str, value: object, valid: bool, range_in_words: str) -> None:
    """Raises ConfigError for a field of the route unless its value is valid; `range_in_words` says what would be."""
    if not valid:
        raise ConfigError("route", field, value, range_in_words)
