"""Scenarios: YAML files that define the walker, the walk and the sensors; `scenario_model` has their fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stridetwin.scenarios.built_in import catalogue as catalogue
from stridetwin.scenarios.scenario_model import ScenarioFile
from stridetwin.sim.config import PHYSICS as PHYSICS
from stridetwin.sim.config import Level, Motion, Route, Segment, Stairs, TwinConfig
from stridetwin.sim.faults.faults import check_faults
from stridetwin.sim.sensors.standard_rig import EXO_GROUPS, standard_rig
from stridetwin.sim.world.mesh_terrain import MeshWay, mesh_terrain
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.errors import ConfigError, ConfigFileError, Missing, StrideTwinError, check_type
from stridetwin.streams.validation import suggest, validate
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml

SENSORS: tuple[str, ...] = TwinConfig.sensors
CAMERAS = ("foot_camera", "head_camera")
"""Groups of sensors with images."""
# keys of a file that are fields of the route, and of the configuration
_OF_ROUTE = ("width_m", "scenery", "texture", "light", "light_changes", "bystanders", "things", "unevenness_m")
_OF_CONFIG = ("person", "exo", "gait", "physics", "dynamics", "rig_mount", "ideal", "shock", "faults", "site")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A named walk: its purpose in one line, the configuration of the twin, and notes for the user."""

    description: str
    config: TwinConfig
    notes: tuple[str, ...] = ()


def to_scenario(scenario: Scenario | TwinConfig | str | Path) -> Scenario:
    """A scenario from what a caller has of it, for functions that take any of these.

    Args:
        scenario: A scenario, the configuration of a walk, a name in the catalogue, or the path of a file.

    Raises:
        ConfigError: It is of another type, or a value in the file is invalid.
        StrideTwinError: Unknown scenario; the message lists the known ones.
    """
    if isinstance(scenario, Scenario):
        return scenario
    if isinstance(scenario, TwinConfig):
        return Scenario(description=scenario.name, config=scenario)
    check_type("scenario", "", scenario, (str, Path), "a Scenario, a TwinConfig, a name in the catalogue or a path")
    return load_scenario(scenario)


def load_scenario(name: str | Path) -> Scenario:
    """Reads a scenario by its name in the catalogue, or from a YAML file.

    Args:
        name: Name of the catalogue, or path of a file (with a suffix or a separator in it).

    Raises:
        StrideTwinError: Unknown scenario; the message lists the known ones.
        ConfigError: An invalid value.
    """
    check_type("load_scenario", "name", name, (str, Path), "a name in the catalogue or a path")
    name, known = str(name), catalogue()
    if name in known:
        return read_scenario(known[name])
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.parent != Path("."):
        return read_scenario(path)
    raise StrideTwinError(f"invalid scenario {name!r}: expected {suggest(name, known)}, or the path of a .yaml file")


def read_scenario(path: str | Path) -> Scenario:
    """Reads one scenario file.

    Raises:
        ConfigError: An invalid value; the message names file, field, value and what is valid.
        StrideTwinError: The file cannot be read.
    """
    check_type("read_scenario", "path", path, (str, Path), "the path of a .yaml file")
    return scenario_of(read_yaml(path, most_values=LARGEST_FILE_VALUES), Path(path))


def scenario_of(node: object, path: Path) -> Scenario:
    """The scenario that plain data describe.

    Args:
        node: Contents of a scenario file.
        path: Origin of the data: it names the scenario, and the user's own parts are searched in its folder.

    Raises:
        ConfigError: An invalid value; the message names file, field, value and what is valid.
    """
    file = validate(ScenarioFile, node, path, context={"folder": path.parent})
    if file.terrain is None and file.motion is None:
        raise ConfigError(path, "terrain", Missing(), "segments, or a mesh; only a recorded motion shows its terrain")
    recording: Any = file.motion
    motion: Motion | None = None if recording is None else replace(recording, finds_terrain=file.terrain is None)
    # as long as the terrain is not found, a level stands for it
    terrain: Any = file.terrain or (
        Level(length_m=1.0),
    )  # a tuple of segments, or a mesh, from which the segments are found
    notes: tuple[str, ...] = ()
    if isinstance(terrain, MeshWay):
        terrain, summary = mesh_terrain(terrain, file.width_m)
        notes = (summary,)
    route = Route(segments=terrain, **{name: getattr(file, name) for name in _OF_ROUTE})
    values: dict[str, Any] = {name: getattr(file, name) for name in _OF_CONFIG}
    if "sensors" in file.model_fields_set:
        values |= {"sensors": file.sensors.groups, "fittings": file.sensors.configs}
    config = TwinConfig(name=path.stem, route=route, motion=motion, **values)
    if motion is not None:
        if "gait" in file.model_fields_set:
            raise ConfigError(path, "gait", file.gait.pattern, "no gait, as the motion is recorded")
        if config.physics != "kinematic":
            valid = "kinematic, as a recorded motion has no plan that a simulated walker could follow"
            raise ConfigError(path, "physics", config.physics, valid)
        if route.unevenness_m:
            valid = "0, as the soles of a recorded motion are pinned to a level floor, risers and ramps"
            raise ConfigError(path, "unevenness_mm", 1e3 * route.unevenness_m, valid)
        from stridetwin.sim.motion.source import apply_motion  # MuJoCo, so imported when it is needed

        config, _ = apply_motion(config)
    # each call raises all errors of its checks together; the second one lays out route and rig, which needs what the
    # first one checks
    _run_checks(
        lambda: _check_order(path, route.segments),
        lambda: _check_physics(path, config),
        lambda: _check_exo_groups(path, config, file.sensors.paths),
    )
    _run_checks(lambda: _check_things(path, route), lambda: check_faults(path, config.faults, standard_rig(config)))
    return Scenario(description=file.description, config=config, notes=notes)


def _run_checks(*checks: Callable[[], None]) -> None:
    """Runs all checks and raises their errors together."""
    errors: list[StrideTwinError] = []
    for check in checks:
        try:
            check()
        except StrideTwinError as error:
            errors.append(error)
    if errors:
        raise errors[0] if len(errors) == 1 else ConfigFileError(errors)


def _check_things(path: Path, route: Route) -> None:
    """Refuses objects that do not fit on the route.

    Raises:
        ConfigError: The place of an object is invalid; the error names the key of the file, `terrain`, for `segments`.
    """
    from stridetwin.sim.world.obstacles import check_things  # compiled functions, so imported when it is needed

    try:
        check_things(route.things, lay_out(route), route.width_m)
    except ConfigError as error:
        raise ConfigError(path, error.field.replace("segments", "terrain"), error.value, error.valid) from error


def _check_physics(path: Path, config: TwinConfig) -> None:
    """Refuses settings of the dynamics in a scenario that is not simulated forward.

    Raises:
        ConfigError: The scenario has them.
    """
    if config.dynamics is not None and config.physics != "dynamic":
        raise ConfigError(path, "physics", config.physics, "dynamic, as the scenario has dynamics")


def _check_order(path: Path, segments: tuple[Segment, ...]) -> None:
    """Refuses segments that cannot follow each other, and a walk that does not begin and end on level ground.

    Raises:
        ConfigError: The first or the last segment is not level, a stair follows a stair without a landing, or the last
            segment is tilted sideways.
    """
    for i, segment in enumerate(segments):
        kind = type(segment).__name__.lower()
        if i in (0, len(segments) - 1) and kind != "level":
            raise ConfigError(path, f"terrain[{i}]", kind, "level (a walk starts and ends on level ground)")
        if i and kind == "stairs" and isinstance(segments[i - 1], Stairs):
            raise ConfigError(path, f"terrain[{i}]", kind, "level, ramp (stairs must end at a landing)")
    last = segments[-1]
    if isinstance(last, Level) and last.cross_slope_rad != 0.0:
        at = f"terrain[{len(segments) - 1}].level.cross_slope_deg"
        raise ConfigError(path, at, round(math.degrees(last.cross_slope_rad), 6), "0 (a walk ends on level ground)")


def _check_exo_groups(path: Path, config: TwinConfig, paths: dict[str, str]) -> None:
    """Raises ConfigError for sensors of an exoskeleton that the scenario does not have.

    Args:
        path: The scenario file.
        config: Its configuration.
        paths: Key path of each group of sensors that the file names.
    """
    for name, at in paths.items():
        if config.exo is None and name in EXO_GROUPS:
            valid = ", ".join(n for n in SENSORS if n not in EXO_GROUPS) + ", as the scenario has no exoskeleton"
            raise ConfigError(path, at, name, valid)
