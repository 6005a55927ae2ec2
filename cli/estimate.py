"""`estimate`: runs one estimator on a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from stridetwin.cli.options import (
    BackendOption,
    EstimatorArguments,
    ImportableOptions,
    Outcome,
    Progress,
    one_of,
    option,
    output_option,
    switch,
)
from stridetwin.cli.recording import imported, table_request
from stridetwin.estimators import registry
from stridetwin.estimators.base import MAP, MODES, PATH, STEPS, Declaration, Options, PathEstimate, current_name
from stridetwin.streams.errors import ConfigError, StrideTwinError

if TYPE_CHECKING:
    from stridetwin.pipeline.run import Found
    from stridetwin.streams.samples import Block, Imu


@dataclass(frozen=True, kw_only=True)
class Written:
    """What an estimator wrote.

    Attributes:
        files: Its files, the requested one first.
        rows: Rows in them.
        lines: Messages about them.
        poses: The poses that it used; "" if it uses none.
    """

    files: list[Path]
    rows: int
    lines: list[str]
    poses: str = ""


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(ImportableOptions):
    """Run one estimator on a recording or an IMU table."""

    estimator: Annotated[
        str,
        typer.Argument(
            metavar="ESTIMATOR",
            help="foot_ins: IMU of one foot; foot_to_foot: both feet, with cameras and sonars if recorded; "
            "contact_terrain: exoskeleton; dvio: RGB-D camera with IMU on head or chest; "
            "terrain_map: depth camera and poses; locomotion_mode: these and insoles.",
            **one_of(registry.names()),
        ),
    ]
    foot: Annotated[Literal["l", "r"] | None, option("foot_ins: foot of a recording (default l).")] = None
    lag: Annotated[float | None, option("foot_ins: smooth each pose with the next S seconds, up to 10.", "S")] = None
    imu: Annotated[
        str | None,
        option(
            "foot_ins, IMU table: auto reads noise, gyro bias and range from the samples (default); none assumes any "
            "consumer IMU; or the name of a part.",
            "NAME",
        ),
    ] = None
    method: Annotated[
        str | None,
        option(
            "foot_to_foot, contact_terrain, dvio, locomotion_mode: algorithm (default proposed).", "NAME", current_name
        ),
    ] = None
    poses: Annotated[
        str | None,
        option(
            "terrain_map, locomotion_mode: TUM trajectory of the depth camera's optical frame, or `truth` for the "
            "recording's true poses (default: those that dvio estimates).",
            "FILE",
        ),
    ] = None
    backend: BackendOption = None
    mesh: Annotated[
        bool, switch("--mesh", "terrain_map: write the ground as a .glb; with open3d also all surfaces, _mesh.ply.")
    ] = False
    dead_reckoning: Annotated[
        bool, switch("--dead-reckoning", "dvio: also write poses without tracking: on the IMU alone, or lost.")
    ] = False
    exoskeleton: Annotated[
        Path | None, option("contact_terrain: geometry, where the recording provides none.", "FILE")
    ] = None
    output: Annotated[
        Path,
        output_option(
            "TUM trajectory to write, or .csv with status and covariance (foot_to_foot: _l and _r are added); "
            "contact_terrain, locomotion_mode: table, .csv; terrain_map: .json, and a .ply beside it."
        ),
    ]


def estimate_command(arguments: EstimateOptions, progress: Progress) -> Outcome:
    """`estimate`."""
    found = registry.estimator(arguments.estimator)
    if arguments.mesh and found.declaration.kind != MAP:
        raise StrideTwinError(f"--mesh goes with {goes_with(lambda d: d.kind == MAP)}")
    if arguments.poses and found.declaration.kind not in (MAP, MODES):
        raise StrideTwinError(f"--poses goes with {goes_with(lambda d: d.kind in (MAP, MODES))}")
    if arguments.imu is not None and found.declaration.kind != PATH:
        raise StrideTwinError("--imu goes with foot_ins and an IMU table")
    if arguments.exoskeleton and found.declaration.kind != STEPS:
        raise StrideTwinError(f"--exoskeleton goes with {goes_with(lambda d: d.kind == STEPS)}")
    options = options_of(arguments, found.declaration)
    write = {PATH: _paths, STEPS: _steps, MAP: _terrain, MODES: _modes}[found.declaration.kind]
    made = write(arguments, found, options, progress)
    files = [str(file) for file in made.files]
    data: dict[str, Any] = {"file": files[0], "files": files, "estimator": arguments.estimator, "rows": made.rows}
    if made.poses:
        data["poses"] = made.poses
    return Outcome(data=data, lines=[*made.lines, made.poses] if made.poses else made.lines)


def options_of(arguments: EstimatorArguments, declaration: Declaration) -> Options:
    """The request of the arguments of `estimate` or `live`.

    Raises:
        StrideTwinError: The estimator has no such option or method.
    """
    lag_s = getattr(arguments, "lag", None)
    if arguments.foot and not declaration.per_foot:
        raise StrideTwinError(f"--foot goes with {goes_with(lambda d: d.per_foot)}")
    if lag_s is not None and not declaration.smooths:
        raise StrideTwinError(f"--lag goes with {goes_with(lambda d: d.smooths)}")
    if arguments.method is not None and arguments.method not in declaration.methods:
        words = goes_with(lambda d: arguments.method in d.methods)
        where = f"--method {arguments.method} goes with {words}" if words else f"invalid --method {arguments.method}"
        valid = ", ".join(declaration.methods)
        raise StrideTwinError(f"{where}: expected {valid}")
    if arguments.backend is not None and arguments.backend not in declaration.backends:
        raise StrideTwinError(f"--backend goes with {goes_with(lambda d: arguments.backend in d.backends)}")
    method, foot = arguments.method or declaration.methods[0], arguments.foot or "l"
    backend = arguments.backend or ""
    return Options(method=method, foot=foot, lag_s=lag_s, backend=backend, exoskeleton=arguments.exoskeleton)


def goes_with(choose: Callable[[Declaration], bool]) -> str:
    """Names of the chosen estimators."""
    return ", ".join(name for name, found in registry.estimators().items() if choose(found.declaration))


def _paths(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.cli.table_imu import AUTO, described, rig_of_table
    from stridetwin.pipeline.live_chain import part_file
    from stridetwin.pipeline.path_files import write_path
    from stridetwin.pipeline.run import paths
    from stridetwin.streams.formats.opening import recognise

    about: list[str] = []
    follow_block, parts = getattr(found, "follow_block", None), found.declaration.parts
    is_given = bool(arguments.rig or arguments.map or arguments.kind)
    if follow_block is not None and not is_given and recognise(arguments.source) == "table":
        block = _table(arguments, options.foot)
        rig = rig_of_table(arguments.imu or AUTO, block, options.foot)
        path = follow_block(block, options, rig)
        made = {arguments.output: PathEstimate(name=arguments.estimator, frame="", path=path)}
        about = [] if rig is None else [described(imu) for imu in rig.imus.values()]
    else:
        if arguments.imu is not None:
            raise StrideTwinError("--imu goes with foot_ins and an IMU table")
        estimates = paths(found, imported(arguments), options, progress)
        made = {part_file(arguments.output, parts.get(e.frame, "")): e for e in estimates}
    written = [write_path(path, file, dead_reckoning=arguments.dead_reckoning) for file, path in made.items()]
    lines = [*about, *(line for _, line in written)]
    return Written(files=list(made), rows=sum(rows for rows, _ in written), lines=lines)


def _table(arguments: EstimateOptions, foot: str) -> Block[Imu]:
    """The IMU of a table, or that of a foot if it has several."""
    from stridetwin.streams.formats.imu_table import read_imu_tables
    from stridetwin.streams.formats.opening import imu_topic, warn_of
    from stridetwin.streams.recording.index import Notes

    notes = Notes(arguments.source, lenient=False)
    imus = read_imu_tables(arguments.source, table_request(arguments), notes)
    warn_of(arguments.source, notes.warnings)
    if len(imus) == 1:
        return next(iter(imus.values()))
    by_topic = {imu_topic(name): block for name, block in imus.items()}
    if (topic := f"/foot_{foot}/imu") not in by_topic:
        raise ConfigError(arguments.source, "sensors", ", ".join(imus), f"one for {topic}: --map NAME={topic}")
    return by_topic[topic]


def _steps(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.pipeline.run import steps
    from stridetwin.pipeline.step_files import write_steps

    progress("estimate", 0.0)
    made = steps(found, imported(arguments), options)
    write_steps(made, arguments.output)
    return Written(files=[arguments.output], rows=len(made), lines=[f"{arguments.output}: {len(made)} steps"])


def _terrain(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.pipeline.poses import chosen_poses
    from stridetwin.pipeline.run import mapped
    from stridetwin.pipeline.terrain_files import document, write_terrain

    progress("estimate", 0.0)
    recording = imported(arguments)
    poses = chosen_poses(found, recording, options, arguments.poses)
    terrain_map = mapped(found, recording, replace(options, poses_of=poses.frame), poses.path, poses.camera)
    files = write_terrain(terrain_map, arguments.output, mesh=arguments.mesh)
    known = document(terrain_map.estimate) if terrain_map.estimate else {"planes": [], "terrains": []}
    kinds = [t["type"] for t in known["terrains"]]
    words = ", ".join(f"{kinds.count(k)} {k}" for k in ("level", "ramp", "stairs"))
    lines = [f"{files[0]}: {len(known['planes'])} planes; {words}"]
    return Written(files=files, rows=len(known["planes"]), lines=lines, poses=poses.words)


def _modes(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.pipeline.poses import chosen_poses
    from stridetwin.pipeline.run import predicted
    from stridetwin.pipeline.step_files import predicted_steps, write_modes

    progress("estimate", 0.0)
    recording = imported(arguments)
    poses = chosen_poses(found, recording, options, arguments.poses)
    own = replace(options, poses_of=poses.frame)
    rows = predicted_steps(predicted(found, recording, own, poses.path, poses.camera))
    write_modes(rows, arguments.output)
    lines = [f"{arguments.output}: {len(rows)} steps"]
    return Written(files=[arguments.output], rows=len(rows), lines=lines, poses=poses.words)
