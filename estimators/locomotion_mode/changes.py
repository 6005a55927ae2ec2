"""The next change of the ground ahead: its place, time and kind."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stridetwin.estimators.locomotion_mode.estimate import MODES, NextChange
from stridetwin.estimators.locomotion_mode.foothold import PathAhead
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.rollout import Chain, moments
from stridetwin.estimators.locomotion_mode.segments import BEHIND_M, PLACE_SD_M, Segment, mode_table, segment_under
from stridetwin.estimators.terrain_map import Stairs, TerrainEstimate
from stridetwin.streams.samples import Array

_FLIGHT_MATCH_M, _FLIGHT_COSINE = 0.15, 0.8
"""An edge belongs to a flight that has an edge so near, if the cosine between path and ascent is no smaller."""
_FLIGHT_RISER_SD_M = 0.0025
"""Standard deviation of a flight's riser in addition to the map's."""
_TREAD_SD_SHARE = 0.7
"""Factor on the error of distances between edges of one flight, which share most of their error."""
_TREAD_DOWN_FACTOR = 2.0
"""Factor on the error of descending treads, of which the camera sees only strips."""


def _find_first_change(ground: Sequence[Segment], here: int, mode: str, p: Settings) -> tuple[str, int] | None:
    """Finds the first segment ahead from which on the steps' mode is another one.

    Stairs end at their last edge: the step over it still climbs, the next one does not.

    Args:
        ground: Terrain segments along the path.
        here: Index of the segment under the foot.
        mode: Mode of the steps there.
        p: Dimensions of steps.

    Returns:
        The new mode, and the segment's index; None if the mode stays.
    """
    table = mode_table(ground, p)  # (P, P, 5) probability of each mode of a step from one segment to another
    for k in range(here + 1, len(ground)):
        into = MODES[int(table[k - 1, k].argmax())]  # mode of the step onto segment k
        if into not in (mode, "LG"):
            return into, k
        onward = MODES[int(table[k, k].argmax())]  # mode of steps within it
        if mode in ("SA", "SD"):  # up to the segment beyond the last edge, if that is longer than a tread
            is_last = k + 1 == len(ground) or MODES[int(table[k, k + 1].argmax())] != mode
            if into == mode and is_last and ground[k].length > p.map.max_tread_m:
                return onward, k
        elif into != mode:  # from a ramp to level ground
            return into, k
    return None


def find_next_change(
    estimate: TerrainEstimate | None,
    ground: Sequence[Segment],
    stance: float,
    line: PathAhead,
    chain: Chain,
    s: Array,
    times: Sequence[tuple[float, float]],
    step_m: float,
    step_s: float,
    p: Settings,
) -> NextChange | None:
    """Finds the first change of the ground ahead, and when a foot lands beyond it.

    Args:
        estimate: The map's estimate; None if there is none.
        ground: Terrain segments along the path.
        stance: Position of the stance foot, m along the path.
        line: The path.
        chain: The coming steps.
        s: (S,) m along the path, the cells.
        times: Time until each step lands, and its standard deviation, s.
        step_m: Length of a usual step.
        step_s: Time of a usual step.
        p: Standard deviations.

    Returns:
        None if the known ground does not change.
    """
    if estimate is None:
        return None
    here = segment_under(ground, stance, p)
    first_change = _find_first_change(ground, here, _mode_here(ground, here, p), p)
    if first_change is None:
        return None
    mode, index = first_change
    segment = ground[index]  # the first one beyond the change
    beyond = chain.on[:, index:].sum(axis=1) > 0.5  # (K,) whether each step more likely lands beyond the change
    if beyond.any():
        in_s, in_sd_s = times[int(beyond.argmax())]
    else:
        # usual steps from the last predicted one to the change; the uncertainty grows with the number of all steps
        more = math.ceil(max(0.0, segment.start - moments(chain.density[-1], s)[0]) / step_m)
        in_s, in_sd_s = times[-1][0] + more * step_s, times[-1][1] * (1.0 + more / len(times))
    place = line.origin + segment.start * line.forward
    return NextChange(
        mode=mode,
        p_in_world=place,
        distance=segment.start - BEHIND_M,
        distance_sd=max(segment.start_sd, PLACE_SD_M),
        time_s=in_s,
        time_sd_s=in_sd_s,
        **_read_sizes(mode, segment, estimate, place, line, p),
    )


def _mode_here(ground: Sequence[Segment], here: int, p: Settings) -> str:
    """Mode of steps on the ground under the foot; on a tread, the mode of its stairs.

    Args:
        ground: Terrain segments along the path.
        here: Index of the segment under the foot.
        p: Dimensions of steps.
    """
    segment = ground[here]
    if segment.mode != "LG":
        return segment.mode
    if here > 0 and here + 1 < len(ground):
        behind, ahead = segment.drop, ground[here + 1].drop  # rise of the edges at both ends of the segment, m
        # two risers, both up or both down
        are_stairs = min(abs(behind), abs(ahead)) > p.min_stair_riser_m and behind * ahead > 0
        if are_stairs and segment.length < p.map.max_tread_m:
            return "SA" if behind > 0 else "SD"
    return "LG"


def _read_sizes(
    mode: str, segment: Segment, estimate: TerrainEstimate, place: Array, line: PathAhead, p: Settings
) -> dict[str, float]:
    """Riser and tread, or slope, with standard deviations, of the ground that begins at a place; only known values.

    A ramp has a slope; stairs have a riser, and a tread if a flight is mapped there.

    Args:
        mode: Mode of the first step onto that ground.
        segment: The terrain segment that begins there.
        estimate: The map's estimate.
        place: (2,) m, where the path crosses the edge or slope break.
        line: The path.
        p: Standard deviations.

    Returns:
        Values by attribute of `NextChange`; empty for level ground.
    """
    if mode in ("RA", "RD"):
        return {"slope": segment.slope, "slope_sd": segment.slope_sd}
    if mode not in ("SA", "SD"):
        return {}
    up = mode == "SA"
    flight = _flight_at(estimate, place, line.forward, up)
    if flight is None:  # a single edge
        return {"riser": segment.drop, "riser_sd": math.hypot(p.mode.riser_sd_m, segment.drop_sd)}
    riser_sd, tread_sd = np.sqrt(np.diag(flight.covariance)[:2]).tolist()  # the first two of the flight's five values
    sizes = {"riser": flight.riser if up else -flight.riser, "riser_sd": math.hypot(riser_sd, _FLIGHT_RISER_SD_M)}
    if flight.steps > 1:
        sizes |= {"tread": flight.tread, "tread_sd": _TREAD_SD_SHARE * (1.0 if up else _TREAD_DOWN_FACTOR) * tread_sd}
    return sizes


def _flight_at(estimate: TerrainEstimate, place: Array, forward: Array, up: bool) -> Stairs | None:
    """The flight with the most steps that has an edge at a place; None if there is none.

    Args:
        estimate: The map's estimate.
        place: (2,) m, the place.
        forward: (2,) unit vector of the path.
        up: Whether the path climbs the flight rather than descends it.
    """
    flights = []
    for flight in estimate.stairs:
        cosine = float(flight.up @ forward) * (1.0 if up else -1.0)  # between path and way up, or way down
        away = np.abs(flight.edges - float(flight.up @ place))  # (steps,) m, from each edge
        if cosine >= _FLIGHT_COSINE and (away < _FLIGHT_MATCH_M).any():
            flights.append(flight)
    return max(flights, key=lambda flight: flight.steps, default=None)
