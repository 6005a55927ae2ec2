"""`estimate`: one estimator on a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from stridetwin.scenarios.commands.options import METHODS, ImportableOptions, one_of
from stridetwin.scenarios.commands.outcome import Outcome, Progress
from stridetwin.scenarios.commands.source import imported
from stridetwin.streams.errors import StrideTwinError

ESTIMATORS = {
    "foot_ins": "path of one foot from its IMU alone (zero-velocity updates)",
    "foot_to_foot": "paths of both feet, tied together by what shoe cameras and sonars tell of each other",
    "contact_terrain": "slope, step height and class of each step from an exoskeleton's AHRS, encoders and insoles",
    "dvio": "path of a head- or chest-worn RGB-D camera with IMU",
    "terrain_map": "planes, ramps and stairs around the walker from depth pictures and poses",
    "locomotion_mode": "mode, place and time of the coming steps from depth pictures, poses and insoles",
}


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
            **one_of(tuple(ESTIMATORS)),
        ),
    ]
    foot: Annotated[Literal["l", "r"] | None, typer.Option(help="foot_ins: foot of a recording (default l).")] = None
    lag: Annotated[
        float | None,
        typer.Option(metavar="S", help="foot_ins: smooth each pose with the next S seconds, up to 10."),
    ] = None
    method: Annotated[
        str,
        typer.Option(help="foot_to_foot, contact_terrain, dvio, locomotion_mode: algorithm.", **one_of(METHODS)),
    ] = "stridetwin"
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="terrain_map, locomotion_mode: TUM trajectory of the depth camera's optical frame "
            "(default: poses of the recording).",
        ),
    ] = None
    mesh: Annotated[bool, typer.Option("--mesh", help="terrain_map: write the ground as a .glb as well.")] = False
    exoskeleton: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="contact_terrain: geometry, where the recording provides none."),
    ] = None
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="TUM trajectory to write (foot_to_foot: _l and _r are added); contact_terrain, locomotion_mode: "
            "table, .csv; terrain_map: .json, and a .ply beside it.",
        ),
    ]


def estimate_command(arguments: EstimateOptions, progress: Progress) -> Outcome:
    """`estimate`."""
    from stridetwin.scenarios.estimates import estimate_feet, estimate_foot, foot_filter
    from stridetwin.scenarios.imu_table import TABLES
    from stridetwin.streams.imu_table import read_imu_table
    from stridetwin.streams.tum import write_tum

    if arguments.mesh and arguments.estimator != "terrain_map":
        raise StrideTwinError("--mesh goes with terrain_map, which writes the ground")
    if arguments.estimator == "contact_terrain":
        return _estimate_steps(arguments, progress)
    if arguments.estimator == "terrain_map":
        return _estimate_terrain(arguments, progress)
    if arguments.estimator == "locomotion_mode":
        return _estimate_modes(arguments, progress)
    if arguments.estimator == "dvio":
        from stridetwin.scenarios.odometry import estimate_odometry

        if arguments.foot or arguments.lag is not None:
            raise StrideTwinError("--foot and --lag go with foot_ins; dvio tells one path, each pose at once")
        paths = {arguments.output: estimate_odometry(imported(arguments), arguments.method, progress).path}
    elif arguments.estimator == "foot_to_foot":
        if arguments.foot:
            raise StrideTwinError("--foot goes with foot_ins; foot_to_foot writes a file for each foot")
        if arguments.lag is not None:
            raise StrideTwinError("--lag goes with foot_ins; foot_to_foot tells each pose at once")
        progress("estimate", 0.0)
        made = estimate_feet(imported(arguments), arguments.method)
        paths = {_for_foot(arguments.output, e.frame[len("foot_")]): e.path for e in made}
    elif arguments.method != "stridetwin":
        raise StrideTwinError(f"--method {arguments.method} goes with foot_to_foot; valid for foot_ins: stridetwin")
    elif arguments.source.suffix in TABLES and not (arguments.rig or arguments.map or arguments.kind):
        paths = {arguments.output: foot_filter(arguments.lag).run(read_imu_table(arguments.source)).trajectory}
    else:
        paths = {arguments.output: estimate_foot(imported(arguments), arguments.foot or "l", arguments.lag).path}
    for file, path in paths.items():
        write_tum(path, file)
    rows = sum(map(len, paths.values()))
    data = {"file": str(next(iter(paths))), "files": [str(f) for f in paths], "estimator": arguments.estimator}
    lines = [f"{file}: {len(path)} poses" for file, path in paths.items()]
    return Outcome(data=data | {"rows": rows}, lines=lines)


def _estimate_steps(arguments: EstimateOptions, progress: Progress) -> Outcome:
    from stridetwin.scenarios.estimates import estimate_steps
    from stridetwin.scenarios.steps import write_steps

    if arguments.foot:
        raise StrideTwinError("--foot goes with foot_ins; contact_terrain writes the steps of both feet")
    progress("estimate", 0.0)
    made = estimate_steps(imported(arguments), arguments.method, arguments.exoskeleton)
    write_steps(made, arguments.output)
    file = str(arguments.output)
    data = {"file": file, "files": [file], "estimator": arguments.estimator, "rows": len(made)}
    return Outcome(data=data, lines=[f"{file}: {len(made)} steps"])


def _estimate_terrain(arguments: EstimateOptions, progress: Progress) -> Outcome:
    from stridetwin.scenarios.terrain_files import document, map_recording, write_terrain
    from stridetwin.streams.tum import read_tum

    if arguments.foot:
        raise StrideTwinError("--foot goes with foot_ins; terrain_map looks through the depth camera")
    progress("estimate", 0.0)
    terrain_map = map_recording(imported(arguments), read_tum(arguments.poses) if arguments.poses else None)
    files = [str(f) for f in write_terrain(terrain_map, arguments.output, mesh=arguments.mesh)]
    found = document(terrain_map.estimate) if terrain_map.estimate else {"planes": [], "terrains": []}
    kinds = [t["type"] for t in found["terrains"]]
    data = {"file": files[0], "files": files, "estimator": arguments.estimator, "rows": len(found["planes"])}
    told = ", ".join(f"{kinds.count(k)} {k}" for k in ("level", "ramp", "stairs"))
    return Outcome(data=data, lines=[f"{files[0]}: {len(found['planes'])} planes; {told}"])


def _estimate_modes(arguments: EstimateOptions, progress: Progress) -> Outcome:
    from stridetwin.scenarios.mode_files import predict_recording, predicted_steps, write_modes
    from stridetwin.streams.tum import read_tum

    if arguments.foot:
        raise StrideTwinError("--foot goes with foot_ins; locomotion_mode tells the steps of both feet")
    progress("estimate", 0.0)
    path = read_tum(arguments.poses) if arguments.poses else None
    rows = predicted_steps(predict_recording(imported(arguments), arguments.method, path))
    write_modes(rows, arguments.output)
    file = str(arguments.output)
    data = {"file": file, "files": [file], "estimator": arguments.estimator, "rows": len(rows)}
    return Outcome(data=data, lines=[f"{file}: {len(rows)} steps"])


def _for_foot(file: Path, foot: str) -> Path:
    """`path.txt` becomes `path_l.txt`."""
    return file.with_name(f"{file.stem}_{foot}{file.suffix}")
