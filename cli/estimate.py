"""`estimate`: runs one estimator on a recording, or on a table whose IMU is measured, named or unknown."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from stridetwin.cli.commands import EstimateOptions
from stridetwin.cli.options import NO_FILE, Outcome, Progress
from stridetwin.cli.recording import open_source, table_request
from stridetwin.estimators import registry
from stridetwin.estimators.base import Declaration, Options, PathEstimate
from stridetwin.outputs.base import AnyKind, FileOptions, Output, part_file
from stridetwin.outputs.feeding import EstimatorClass, Instance, check_topics, instance_for
from stridetwin.outputs.parameters import ParameterValues, check_used, parse_parameters, with_parameters
from stridetwin.outputs.pose_feed import default_odometry, replay
from stridetwin.outputs.registry import estimators, kind_of
from stridetwin.scenarios.camera_report import report_cameras
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.imu_table import read_imu_tables
from stridetwin.streams.formats.measured_calibration import measure_imu
from stridetwin.streams.formats.opening import imu_topic, is_table, print_warnings
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Imu

AUTO, UNKNOWN = "auto", "none"


def estimate_command(arguments: EstimateOptions, progress: Progress) -> Outcome:
    """Runs `estimate`: one estimator on a recording or an IMU table, and writes its estimates to files.

    An estimator that takes poses gets those of `--poses` or, without it, those of the default odometry.

    Returns:
        The files and their number of rows.
    """
    estimator_class = registry.estimator(arguments.estimator)
    kind = kind_of(estimator_class.declaration)
    _check_kind_options(arguments, kind)
    parameters = parse_parameters(arguments.parameters)
    estimates_poses = kind.takes_poses and arguments.poses is None
    running = [arguments.estimator]
    if estimates_poses:  # then the odometry that supplies the poses runs, too
        running.append(default_odometry().declaration.name)
    check_used(parameters, running)
    options = options_of(
        estimator_class.declaration,
        foot=arguments.foot,
        lag_s=arguments.lag,
        calibration_from=arguments.calibration_from,
        method=arguments.method,
        backend=arguments.backend,
        exoskeleton=arguments.exoskeleton,
    )
    outputs, lines, poses = _run_on_source(arguments, estimator_class, kind, options, parameters, progress)
    for output in outputs:
        if isinstance(output.estimates, PathEstimate):
            print_warnings(output.name, output.estimates.notes)
    file_options = FileOptions(mesh=arguments.mesh, dead_reckoning=arguments.dead_reckoning)
    written = [kind.write(output, part_file(arguments.output, output.part), file_options) for output in outputs]
    files = [str(file) for of_output in written for file in of_output.files]
    rows = sum(of_output.rows for of_output in written)
    data: dict[str, Any] = {"file": files[0], "files": files, "estimator": arguments.estimator, "rows": rows}
    lines += [line for of_output in written for line in of_output.lines]
    if parameters:
        data["parameters"] = parameters
    if poses:
        data["poses"] = poses
        lines.append(poses)
    return Outcome(data=data, lines=lines)


_Run = tuple[list[Output[Any]], list[str], str]
"""Outputs; lines on the input, before those of the files; and the poses that were used, "" without any."""


def _check_kind_options(arguments: EstimateOptions, kind: AnyKind) -> None:
    """Refuses options that are only valid for other kinds of output.

    Raises:
        StrideTwinError: An option is not valid for the estimator.
    """
    given = {"mesh": arguments.mesh, "poses": arguments.poses is not None, "exoskeleton": arguments.exoskeleton}
    if wrong := next((name for name, is_given in given.items() if is_given and name not in kind.options), ""):
        raise StrideTwinError(f"--{wrong} is only valid for {estimators_that(lambda d: wrong in kind_of(d).options)}")
    if arguments.trajectory != NO_OPTIONS and arguments.poses in (None, "truth"):
        raise StrideTwinError(f"{NO_FILE} --poses FILE")
    if arguments.imu is not None and "imu" not in kind.options:
        raise StrideTwinError("--imu is only valid for foot_ins and an IMU table")


def _run_on_source(
    arguments: EstimateOptions,
    estimator_class: EstimatorClass,
    kind: AnyKind,
    options: Options,
    parameters: ParameterValues,
    progress: Progress,
) -> _Run:
    """Runs the estimator on the table or recording that the arguments name.

    Args:
        arguments: The command line.
        estimator_class: Class of the estimator.
        kind: Its kind of output.
        options: Its options.
        parameters: Values of `--set` by name.
        progress: Receives the stage and its progress (0-1).

    Raises:
        StrideTwinError: The source cannot be read, or lacks what the estimator needs.
    """
    from stridetwin.outputs.chosen_poses import choose_poses

    if (from_table := _run_on_table(arguments, estimator_class, options, parameters)) is not None:
        return from_table
    if arguments.imu is not None:
        raise StrideTwinError("--imu is only valid for foot_ins and an IMU table")
    progress("estimate", 0.0)
    recording = open_source(arguments)
    instance = with_parameters(instance_for(estimator_class, recording, options), parameters)
    report_cameras(recording, _list_used(instance, arguments, kind), lenient=arguments.lenient)
    if not kind.takes_poses:
        return kind.run(instance, recording, progress), [], ""
    check_topics(instance, recording)
    poses = choose_poses(recording, arguments.poses, parameters, arguments.trajectory)
    instances = [(kind, instance.with_poses_of(poses.frame))]
    # one instance gives one pair of kind and outputs
    ((_, outputs),) = replay(instances, recording, poses.path, poses.camera, progress=progress, statuses=poses.statuses)
    return outputs, [], poses.description


def _list_used(instance: Instance, arguments: EstimateOptions, kind: AnyKind) -> set[str]:
    """Topics of the streams that an estimator takes, and those of the odometry that supplies its poses."""
    used = {stream.topic for stream in instance.streams}
    if kind.takes_poses and arguments.poses is None:
        mounts = {topic.split("/")[1] for topic in used if topic.count("/") > 1}
        used |= {f"/{mount}/color" for mount in mounts}
    return used


def options_of(
    declaration: Declaration,
    *,
    foot: str | None,
    method: str | None,
    backend: str | None,
    exoskeleton: Path | None,
    lag_s: float | None = None,
    calibration_from: Path | None = None,
) -> Options:
    """The options of an estimator from the arguments of `estimate` or `live`, where None means that one is not given.

    Args:
        declaration: The estimator's.
        foot: Foot of an estimator that runs per foot.
        method: Name of an algorithm.
        backend: Library of the terrain map.
        exoskeleton: File with the exoskeleton's geometry.
        lag_s: Seconds of the future that smooth each pose.
        calibration_from: File with what an earlier estimate learnt of the sensor.

    Raises:
        StrideTwinError: The estimator has no such option or method.
    """
    if foot and not declaration.per_foot:
        raise StrideTwinError(f"--foot is only valid for {estimators_that(lambda d: d.per_foot)}")
    if lag_s is not None and not declaration.smooths:
        raise StrideTwinError(f"--lag is only valid for {estimators_that(lambda d: d.smooths)}")
    if calibration_from is not None and not declaration.recalls:
        raise StrideTwinError(f"--calibration-from is only valid for {estimators_that(lambda d: d.recalls)}")
    if method is not None and method not in declaration.methods:
        estimators_with_it = estimators_that(lambda d: method in d.methods)
        where = (
            f"--method {method} is only valid for {estimators_with_it}"
            if estimators_with_it
            else f"invalid --method {method}"
        )
        valid = ", ".join(declaration.methods)
        raise StrideTwinError(f"{where}: expected {valid}")
    if backend is not None and backend not in declaration.backends:
        raise StrideTwinError(f"--backend is only valid for {estimators_that(lambda d: backend in d.backends)}")
    return Options(
        method=method or declaration.methods[0],
        foot=foot or "l",
        lag_s=lag_s,
        calibration_from=calibration_from,
        backend=backend or "",
        exoskeleton=exoskeleton,
    )


def estimators_that(choose: Callable[[Declaration], bool]) -> str:
    """Names of the estimators whose declaration `choose` accepts, as text for messages."""
    return ", ".join(name for name, estimator_class in estimators().items() if choose(estimator_class.declaration))


def _run_on_table(
    arguments: EstimateOptions, estimator_class: EstimatorClass, options: Options, parameters: ParameterValues
) -> _Run | None:
    """Runs an estimator that reads IMU tables (it has `estimate_block`) on a table.

    A table with options that describe streams (`--rig`, `--map`, `--as`) is read as a recording instead.

    Args:
        arguments: The command line.
        estimator_class: Class of the estimator.
        options: Its options.
        parameters: Values of `--set` by name.

    Returns:
        Its path; None if the estimator reads no tables or the source is no table.
    """
    estimate_block = getattr(estimator_class, "estimate_block", None)
    has_layout = bool(arguments.rig or arguments.map or arguments.kind)
    if estimate_block is None or has_layout or not is_table(arguments.source, table_request(arguments)):
        return None
    block = _read_imu(arguments, options.foot)
    rig = _rig_of_table(arguments.imu or AUTO, block, options.foot)
    # the estimator's parameters with those of `--set`; None without any, then `estimate_block` takes its defaults
    values = with_parameters(
        Instance(estimator_class=estimator_class, options=options, streams=()), parameters
    ).parameters
    more = {} if values is None else {"parameters": values}
    path = replace(estimate_block(block, options, rig, **more), name=arguments.estimator)
    if missing := len(block) - len(path.path):
        print_warnings(arguments.source, [f"no pose at {missing} of {len(block)} samples, where none can be trusted"])
    lines = [] if rig is None else [_describe_imu(imu) for imu in rig.imus.values()]
    return [Output(name=arguments.estimator, estimates=path)], lines, ""


def _read_imu(arguments: EstimateOptions, foot: str) -> Block[Imu]:
    """Reads the IMU of a table, or that of a foot (`l` or `r`) if the table has several.

    Raises:
        StrideTwinError: The table cannot be read, or has several IMUs and none of them is the foot's.
    """
    notes = Notes(arguments.source, lenient=False)
    imus = read_imu_tables(arguments.source, table_request(arguments), notes)
    print_warnings(arguments.source, notes.warnings)
    if len(imus) == 1:
        return next(iter(imus.values()))
    by_topic = {imu_topic(name): block for name, block in imus.items()}
    if (topic := f"/foot_{foot}/imu") not in by_topic:
        raise ConfigError(arguments.source, "sensors", ", ".join(imus), f"one for {topic}: --map NAME={topic}")
    return by_topic[topic]


def _rig_of_table(choice: str, block: Block[Imu], foot: str) -> Rig | None:
    """A rig with the IMU of a table on a foot.

    Args:
        choice: `AUTO` measures the calibration from the samples; the name of a part takes that of its data sheet;
            `UNKNOWN` gives no rig.
        block: All samples.
        foot: `l` or `r`.

    Returns:
        The rig; None for `UNKNOWN`.

    Raises:
        StrideTwinError: No IMU of that name.
    """
    if choice == UNKNOWN:
        return None
    topic, body = f"/foot_{foot}/imu", f"foot_{foot}"
    imu = measure_imu(block, topic, body) if choice == AUTO else _nominal_calibration(choice, topic, body)
    return Rig(imus={topic: imu})


def _describe_imu(imu: ImuCalibration) -> str:
    """One line on what is known of an IMU: rate and noise, and bias and limits if they are known (0 is unknown)."""
    known = [f"{imu.rate_hz:.0f} Hz"]
    if imu.gyroscope_noise_density and imu.accelerometer_noise_density:
        known.append(
            f"noise {math.degrees(imu.gyroscope_noise_density):.2g} °/s/√Hz and "
            f"{imu.accelerometer_noise_density:.2g} m/s²/√Hz"
        )
    else:
        known.append("noise not known, as the sensor never rests")
    if imu.gyroscope_bias_sd:
        known.append(f"gyro bias {math.degrees(imu.gyroscope_bias_sd):.2g} °/s")
    if imu.gyroscope_range:
        known.append(f"gyro limit {math.degrees(imu.gyroscope_range):.0f} °/s")
    if imu.accelerometer_range:
        known.append(f"accelerometer limit {imu.accelerometer_range:.0f} m/s²")
    return f"IMU {imu.part or 'as measured'}: {', '.join(known)}"


def _nominal_calibration(name: str, topic: str, body: str) -> ImuCalibration:
    """The calibration of a part by its data sheet.

    Raises:
        StrideTwinError: No IMU of the catalogue has this name.
    """
    from stridetwin.sim.choices import part_files
    from stridetwin.sim.parts.kinds import ImuPart
    from stridetwin.sim.parts.library import load_part
    from stridetwin.sim.sensors.standard_rig import nominal_imu

    imus = [n for n in part_files() if isinstance(load_part(n), ImuPart)]
    if name not in imus:
        raise StrideTwinError(f"invalid --imu {name}: expected {AUTO}, {UNKNOWN}, {', '.join(imus)}")
    imu_part = load_part(name)
    assert isinstance(imu_part, ImuPart)
    return nominal_imu(topic, imu_part, Mount(body=body))
