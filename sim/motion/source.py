"""From the entry `motion` of a configuration to a fitted walk, and to the configuration that it implies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from stridetwin.sim.config import Motion, Person, Route, TwinConfig
from stridetwin.sim.motion.amass import read_amass
from stridetwin.sim.motion.bvh import read_bvh
from stridetwin.sim.motion.fit import FittedWalk, fit_markers, fit_segments
from stridetwin.sim.motion.loop import loop_walk
from stridetwin.sim.motion.marker_sets import MarkerPlace
from stridetwin.sim.motion.opensim import read_opensim
from stridetwin.sim.motion.read import read_markers, read_number_table
from stridetwin.sim.motion.segments import SegmentMotion
from stridetwin.sim.wearer.anthropometry import anthropometry
from stridetwin.streams.errors import ConfigError

ANGLE_FORMATS = {".mot": "opensim", ".sto": "opensim", ".bvh": "bvh", ".npz": "amass"}
"""Format of joint angles by the suffix of the file."""
_OWN_SD_M = 0.02  # scatter of places in the user's own table


def load_motion(motion: Motion, person: Person, route: Route | None) -> FittedWalk:
    """Fits a wearer to a recording; equal requests for an unchanged file are answered from memory.

    Args:
        motion: The recording.
        person: Height, mass and sex; with joint angles, also lengths that are known.
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


def angle_format(motion: Motion) -> str | None:
    """Format of the joint angles of a recording; None for markers.

    Raises:
        ConfigError: The file's name is that of another format than the one that is given, or markers are given.
    """
    path = Path(motion.file)
    suffix = (Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix).lower()
    kind = ANGLE_FORMATS.get(suffix)
    if motion.angles is not None and kind != motion.angles:
        valid = ", ".join(name for name, fmt in ANGLE_FORMATS.items() if fmt == motion.angles)
        raise ConfigError("motion", "angles", f"{motion.angles} in {path.name}", f"a file {valid}")
    if kind is not None and (motion.markers is not None or motion.places):
        raise ConfigError("motion", "markers", path.name, "no markers with a file of joint angles")
    return kind


@lru_cache(maxsize=4)
def _load(motion: Motion, person: Person, route: Route | None, changed: int) -> FittedWalk:
    """`load_motion` for a file as it was at a time of change, ns."""
    path = Path(motion.file)
    kind = angle_format(motion)
    if kind is not None:
        fitted = fit_segments(_READERS[kind](path, person), person, route)
    else:
        places = {name: MarkerPlace(body=body, place_m=place, sd_m=_OWN_SD_M) for name, body, place in motion.places}
        # the lengths follow from the markers
        fitted = fit_markers(
            read_markers(path), replace(person, segments=None, shoe_m=None), places or motion.markers, route
        )
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
    route = config.route
    given_route = None if motion.finds_terrain else route
    # lengths are fitted to the person that was given: a configuration that has them already gives the same walk
    given, person = motion.given_person, config.person
    if given is not None and load_motion(_bare(motion), given, given_route).person == person:
        person = given
    fitted = load_motion(_bare(motion), person, given_route)
    if motion.finds_terrain:
        found_route = fitted.ground.route
        route = replace(route, segments=found_route.segments, width_m=max(route.width_m, found_route.width_m))
    motion = replace(motion, given_person=person, fitted_s=fitted.duration_s)
    return replace(config, person=fitted.person, route=route, motion=motion), fitted


def _bare(motion: Motion) -> Motion:
    """The motion as a scenario has it, by which its fit is remembered."""
    return replace(motion, given_person=None, fitted_s=None)


def _read_opensim(path: Path, person: Person) -> SegmentMotion:
    """Joint angles of a `.mot` or `.sto` file."""
    return read_opensim(read_number_table(path), person)


def _read_bvh(path: Path, person: Person) -> SegmentMotion:
    """Joints of a `.bvh` file."""
    return read_bvh(path, _leg_m(person))


def _read_amass(path: Path, person: Person) -> SegmentMotion:
    """Poses of an `.npz` file."""
    return read_amass(path, _leg_m(person))


def _leg_m(person: Person) -> float:
    """Length of thigh and shank that is usual for a person, m."""
    body = anthropometry(replace(person, segments=None))
    return body.thigh_m + body.shank_m


_READERS: dict[str, Callable[[Path, Person], SegmentMotion]] = {
    "opensim": _read_opensim,
    "bvh": _read_bvh,
    "amass": _read_amass,
}
