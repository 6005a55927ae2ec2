"""`estimate`: runs one estimator on a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from stridetwin.cli.options import (
    BackendOption,
    ImportableOptions,
    Outcome,
    Progress,
    one_of,
    option,
    output_option,
    switch,
)
from stridetwin.cli.recording import imported
from stridetwin.estimators import registry
from stridetwin.estimators.base import MAP, MODES, PATH, STEPS, Declaration, Options, current_name
from stridetwin.streams.errors import StrideTwinError

if TYPE_CHECKING:
    from stridetwin.cli.bridge import LiveOptions
    from stridetwin.pipeline.run import Found
    from stridetwin.streams.trajectory import Trajectory

Written = tuple[list[Path], int, list[str]]
"""Files, rows, and messages about them."""


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
        Path | None,
        option(
            "terrain_map, locomotion_mode: TUM trajectory of the depth camera's optical frame "
            "(default: poses of the recording).",
            "FILE",
        ),
    ] = None
    backend: BackendOption = None
    mesh: Annotated[
        bool, switch("--mesh", "terrain_map: write the ground as a .glb; with open3d also all surfaces, _mesh.ply.")
    ] = False
    exoskeleton: Annotated[
        Path | None, option("contact_terrain: geometry, where the recording provides none.", "FILE")
    ] = None
    output: Annotated[
        Path,
        output_option(
            "TUM trajectory to write (foot_to_foot: _l and _r are added); contact_terrain, locomotion_mode: "
            "table, .csv; terrain_map: .json, and a .ply beside it."
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
    files, rows, lines = write(arguments, found, options, progress)
    data = {"file": str(files[0]), "files": [str(f) for f in files], "estimator": arguments.estimator, "rows": rows}
    return Outcome(data=data, lines=lines)


def options_of(arguments: EstimateOptions | LiveOptions, declaration: Declaration) -> Options:
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
    from stridetwin.pipeline.run import paths
    from stridetwin.streams.formats.imu_table import TABLES, read_imu_table
    from stridetwin.streams.formats.tum import write_tum

    about: list[str] = []
    follow_block, parts = getattr(found, "follow_block", None), found.declaration.parts
    is_table = arguments.source.suffix in TABLES and not (arguments.rig or arguments.map or arguments.kind)
    if follow_block is not None and is_table:
        block = read_imu_table(arguments.source)
        rig = rig_of_table(arguments.imu or AUTO, block, options.foot)
        made = {arguments.output: follow_block(block, options, rig)}
        about = [] if rig is None else [described(imu) for imu in rig.imus.values()]
    else:
        if arguments.imu is not None:
            raise StrideTwinError("--imu goes with foot_ins and an IMU table")
        estimates = paths(found, imported(arguments), options, progress)
        made = {part_file(arguments.output, parts.get(e.frame, "")): e.path for e in estimates}
    for file, path in made.items():
        write_tum(path, file)
    about += [f"{file}: {len(path)} poses" for file, path in made.items()]
    return list(made), sum(map(len, made.values())), about


def _steps(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.pipeline.run import steps
    from stridetwin.pipeline.step_files import write_steps

    progress("estimate", 0.0)
    made = steps(found, imported(arguments), options)
    write_steps(made, arguments.output)
    return [arguments.output], len(made), [f"{arguments.output}: {len(made)} steps"]


def _terrain(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.pipeline.run import mapped
    from stridetwin.pipeline.terrain_files import document, write_terrain

    progress("estimate", 0.0)
    terrain_map = mapped(found, imported(arguments), options, _given(arguments))
    files = write_terrain(terrain_map, arguments.output, mesh=arguments.mesh)
    known = document(terrain_map.estimate) if terrain_map.estimate else {"planes": [], "terrains": []}
    kinds = [t["type"] for t in known["terrains"]]
    words = ", ".join(f"{kinds.count(k)} {k}" for k in ("level", "ramp", "stairs"))
    return files, len(known["planes"]), [f"{files[0]}: {len(known['planes'])} planes; {words}"]


def _modes(arguments: EstimateOptions, found: Found, options: Options, progress: Progress) -> Written:
    from stridetwin.pipeline.run import predicted
    from stridetwin.pipeline.step_files import predicted_steps, write_modes

    progress("estimate", 0.0)
    rows = predicted_steps(predicted(found, imported(arguments), options, _given(arguments)))
    write_modes(rows, arguments.output)
    return [arguments.output], len(rows), [f"{arguments.output}: {len(rows)} steps"]


def _given(arguments: EstimateOptions) -> Trajectory | None:
    """The poses of `--poses`."""
    from stridetwin.streams.formats.tum import read_tum

    return read_tum(arguments.poses) if arguments.poses else None
