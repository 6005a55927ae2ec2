"""`estimate`: runs one estimator on a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

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
from stridetwin.cli.recording import imported, table_request
from stridetwin.estimators import registry
from stridetwin.estimators.base import Declaration, Options, PathEstimate
from stridetwin.streams.errors import ConfigError, StrideTwinError

if TYPE_CHECKING:
    from stridetwin.outputs.base import AnyKind, Output
    from stridetwin.outputs.feeding import EstimatorClass
    from stridetwin.streams.samples import Block, Imu


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
        option("foot_to_foot, contact_terrain, dvio, locomotion_mode: algorithm (default proposed).", "NAME"),
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
    from stridetwin.outputs.base import FileOptions, part_file
    from stridetwin.outputs.registry import kind_of

    estimator_class = registry.estimator(arguments.estimator)
    kind = kind_of(estimator_class.declaration)
    _check_kind_options(arguments, kind)
    options = options_of(
        estimator_class.declaration,
        foot=arguments.foot,
        lag_s=arguments.lag,
        method=arguments.method,
        backend=arguments.backend,
        exoskeleton=arguments.exoskeleton,
    )
    outputs, notes = _run(arguments, estimator_class, kind, options, progress)
    file_options = FileOptions(mesh=arguments.mesh, dead_reckoning=arguments.dead_reckoning)
    written = [kind.write(output, part_file(arguments.output, output.part), file_options) for output in outputs]
    files = [str(file) for of_output in written for file in of_output.files]
    rows = sum(of_output.rows for of_output in written)
    data: dict[str, Any] = {"file": files[0], "files": files, "estimator": arguments.estimator, "rows": rows}
    if notes.poses:
        data["poses"] = notes.poses
    lines = [*notes.before, *(line for of_output in written for line in of_output.lines)]
    return Outcome(data=data, lines=[*lines, notes.poses] if notes.poses else lines)


@dataclass(frozen=True, kw_only=True)
class _Notes:
    """What to say about the input: lines before those of the files, and the poses that were used; "" without any."""

    before: list[str] = field(default_factory=list)
    poses: str = ""


def _check_kind_options(arguments: EstimateOptions, kind: AnyKind) -> None:
    """Refuses options that the kind of output does not take."""
    given = {"mesh": arguments.mesh, "poses": arguments.poses is not None, "exoskeleton": arguments.exoskeleton}
    for option_name, is_given in given.items():
        if is_given and option_name not in kind.options:
            raise StrideTwinError(f"--{option_name} goes with {_estimators_of_kinds_with(option_name)}")
    if arguments.imu is not None and "imu" not in kind.options:
        raise StrideTwinError("--imu goes with foot_ins and an IMU table")


def _estimators_of_kinds_with(option_name: str) -> str:
    from stridetwin.outputs.registry import kinds

    names = {name for name, kind in kinds().items() if option_name in kind.options}
    return goes_with(lambda declaration: declaration.kind in names)


def _run(
    arguments: EstimateOptions, estimator_class: EstimatorClass, kind: AnyKind, options: Options, progress: Progress
) -> tuple[list[Output[Any]], _Notes]:
    """The outputs of the estimator on what the arguments name."""
    from stridetwin.outputs.chosen_poses import choose_poses
    from stridetwin.outputs.feeding import check_topics, instance_for
    from stridetwin.outputs.pose_feed import replay

    if (from_table := _run_on_table(arguments, estimator_class, options)) is not None:
        return from_table
    if arguments.imu is not None:
        raise StrideTwinError("--imu goes with foot_ins and an IMU table")
    progress("estimate", 0.0)
    recording = imported(arguments)
    instance = instance_for(estimator_class, recording, options)
    if not kind.takes_poses:
        return kind.run(instance, recording, progress), _Notes()
    check_topics(instance, recording)
    poses = choose_poses(recording, arguments.poses)
    instances = [(kind, instance.with_poses_of(poses.frame))]
    ((_, outputs),) = replay(instances, recording, poses.path, poses.camera, progress=progress)
    return outputs, _Notes(poses=poses.description)


def options_of(
    declaration: Declaration,
    *,
    foot: str | None,
    method: str | None,
    backend: str | None,
    exoskeleton: Path | None,
    lag_s: float | None = None,
) -> Options:
    """The options of an estimator for the arguments of `estimate` or `live`; None for one that is not given.

    Args:
        declaration: The estimator's.
        foot: Foot of an estimator that runs per foot.
        method: Name of an algorithm.
        backend: Library of the terrain map.
        exoskeleton: File with the exoskeleton's geometry.
        lag_s: Seconds of the future that smooth each pose.

    Raises:
        StrideTwinError: The estimator has no such option or method.
    """
    if foot and not declaration.per_foot:
        raise StrideTwinError(f"--foot goes with {goes_with(lambda d: d.per_foot)}")
    if lag_s is not None and not declaration.smooths:
        raise StrideTwinError(f"--lag goes with {goes_with(lambda d: d.smooths)}")
    if method is not None and method not in declaration.methods:
        words = goes_with(lambda d: method in d.methods)
        where = f"--method {method} goes with {words}" if words else f"invalid --method {method}"
        valid = ", ".join(declaration.methods)
        raise StrideTwinError(f"{where}: expected {valid}")
    if backend is not None and backend not in declaration.backends:
        raise StrideTwinError(f"--backend goes with {goes_with(lambda d: backend in d.backends)}")
    return Options(
        method=method or declaration.methods[0],
        foot=foot or "l",
        lag_s=lag_s,
        backend=backend or "",
        exoskeleton=exoskeleton,
    )


def goes_with(choose: Callable[[Declaration], bool]) -> str:
    """Names of the chosen estimators."""
    from stridetwin.outputs.registry import estimators

    return ", ".join(name for name, estimator_class in estimators().items() if choose(estimator_class.declaration))


def _run_on_table(
    arguments: EstimateOptions, estimator_class: EstimatorClass, options: Options
) -> tuple[list[Output[Any]], _Notes] | None:
    """The path of an estimator that reads IMU tables, from a table; None if it reads none, or the source is none."""
    from stridetwin.cli.table_imu import AUTO, described, rig_of_table
    from stridetwin.outputs.base import Output
    from stridetwin.streams.formats.opening import recognise

    follow_block = getattr(estimator_class, "follow_block", None)
    has_layout = bool(arguments.rig or arguments.map or arguments.kind)
    if follow_block is None or has_layout or recognise(arguments.source) != "table":
        return None
    block = _table(arguments, options.foot)
    rig = rig_of_table(arguments.imu or AUTO, block, options.foot)
    path = PathEstimate(name=arguments.estimator, frame="", path=follow_block(block, options, rig))
    lines = [] if rig is None else [described(imu) for imu in rig.imus.values()]
    return [Output(name=arguments.estimator, estimates=path)], _Notes(before=lines)


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
