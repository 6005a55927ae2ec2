"""From the entry `motion` of a configuration to a fitted walk, and to the configuration that it implies."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from stridetwin.sim.config import Motion, Person, Route, TwinConfig
from stridetwin.sim.motion.fit import FittedWalk, fit_markers
from stridetwin.sim.motion.loop import loop_walk
from stridetwin.sim.motion.marker_sets import MarkerPlace
from stridetwin.sim.motion.read import read_markers
from stridetwin.streams.errors import ConfigError

_OWN_SD_M = 0.02  # scatter of places in the user's own table


def load_motion(motion: Motion, person: Person, route: Route | None) -> FittedWalk:
    """Fits a wearer to a recording; equal requests for an unchanged file are answered from memory.

    Args:
        motion: The recording.
        person: Height, mass and sex.
        route: The terrain; None to find it.

    Raises:
        ConfigError: A file that cannot be read, or markers that do not suffice.
    """
    path = Path(motion.file)
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        raise ConfigError("motion", "file", motion.file, "an existing file") from None
    return _load(motion, person, route, changed)


@lru_cache(maxsize=4)
def _load(motion: Motion, person: Person, route: Route | None, changed: int) -> FittedWalk:
    """`load_motion` for a file as it was at a time of change, ns."""
    path = Path(motion.file)
    places = {name: MarkerPlace(body=body, place_m=place, sd_m=_OWN_SD_M) for name, body, place in motion.places}
    fitted = fit_markers(read_markers(path), person, places or motion.markers, route)
    return fitted if motion.duration_s is None else loop_walk(fitted, motion.duration_s, motion.file)


def apply_motion(config: TwinConfig) -> tuple[TwinConfig, FittedWalk]:
    """The configuration with the person and the terrain of its recorded motion, and that motion.

    Raises:
        ConfigError: Physics or gait that a recording cannot have.
    """
    motion = config.motion
    assert motion is not None
    if config.physics != "kinematic":
        raise ConfigError(
            config.name,
            "physics",
            config.physics,
            "kinematic: a recorded motion has no plan that a simulated walker could follow",
        )
    if config.gait != type(config.gait)():
        raise ConfigError(config.name, "gait", config.gait.pattern, "no gait: the motion is recorded")
    # lengths are fitted anew, so that a configuration that has them already gives the same walk
    person = replace(config.person, segments=None, shoe_m=None)
    fitted = load_motion(motion, person, None if motion.finds_terrain else config.route)
    route = config.route
    if motion.finds_terrain:
        found = fitted.ground.route
        route = replace(route, segments=found.segments, width_m=max(route.width_m, found.width_m))
    return replace(config, person=fitted.person, route=route), fitted
