"""`check`, `import`, `export` and `view`: checks, converts and shows recordings."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from stridetwin.cli.commands import CheckOptions, ExportOptions, ImportCommandOptions, ViewOptions
from stridetwin.cli.options import ImportableOptions, Outcome, Progress
from stridetwin.outputs.truth import true_frames, true_path
from stridetwin.scenarios.camera_report import report_cameras
from stridetwin.scenarios.check import check_recording, check_table
from stridetwin.scenarios.files import stage_files
from stridetwin.streams.errors import ConfigError, StrideTwinError, explain_import_error, install_hint
from stridetwin.streams.files import atomic_file
from stridetwin.streams.formats.euroc import write_euroc
from stridetwin.streams.formats.imu_columns import parse_mapping
from stridetwin.streams.formats.imu_text import TableRequest
from stridetwin.streams.formats.mcap_export import write_recording, write_rosbag2
from stridetwin.streams.formats.opening import ImportOptions, open_with_warnings
from stridetwin.streams.formats.opensim_export import write_opensim
from stridetwin.streams.formats.sample_table import write_sample_table
from stridetwin.streams.formats.tum import write_tum
from stridetwin.streams.formats.tum_rgbd import write_tum_rgbd
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Image
from stridetwin.streams.validation import suggest


def open_source(arguments: ImportableOptions, *, reports: bool = True) -> Recording:
    """Opens the source that a command's options name, as they say, and prints what was assumed on stderr.

    Args:
        arguments: Options of the command.
        reports: Whether the assumptions are printed.

    Raises:
        StrideTwinError: The source cannot be read or (unless `--lenient`) would corrupt an estimate.
    """
    options = ImportOptions(
        kind=arguments.kind,
        names=dict(_parse_map(text) for text in arguments.map),
        rig=arguments.rig,
        depth_scale=arguments.depth_scale,
        table=table_request(arguments),
    )
    return open_with_warnings(arguments.source, arguments.lenient, options, reports=reports)


def table_request(arguments: ImportableOptions) -> TableRequest:
    """What the options `--columns` and `--rate` say about a table: names of its columns, and its rate, Hz."""
    columns = parse_mapping(arguments.columns) if arguments.columns else {}
    return TableRequest(columns=columns, rate_hz=arguments.rate)


def _parse_map(text: str) -> tuple[str, str]:
    """The two names in a `--map FROM=TO`.

    Raises:
        StrideTwinError: The text has another form.
    """
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise StrideTwinError(f"--map: invalid {text!r}: expected FROM=TO")
    return old, new


DEFAULT_FRAME = "foot_l/imu"
TRAJECTORY_SUFFIXES = (".txt", ".tum")


def export_command(arguments: ExportOptions, progress: Progress) -> Outcome:
    """Runs `export`: writes a file, or a new or empty folder that appears complete or not at all."""
    recording, output = open_with_warnings(arguments.source, arguments.lenient), arguments.output
    progress("export", 0.0)
    frame = (arguments.frame or DEFAULT_FRAME).lstrip("/")
    is_trajectory = arguments.frame is not None or output.suffix in TRAJECTORY_SUFFIXES
    if arguments.format == "table":
        rows = _write_table(recording, output, frame)
    elif arguments.format == "tum" and is_trajectory:
        truth = true_path(recording, frame).poses
        write_tum(truth, output)
        rows = {frame: len(truth)}
    elif output.exists() and not (output.is_dir() and not any(output.iterdir())):  # neither new nor an empty folder
        raise ConfigError("export", "-o", str(output), "a folder that is new or empty")
    else:
        with stage_files(output) as folder:
            rows = _write_folder(recording, folder, arguments)
    data = {"file": str(output), "format": arguments.format, "rows": sum(rows.values()), "parts": rows}
    return Outcome(data=data, lines=[f"{output}: {n} rows of {name}" for name, n in rows.items()])


def _write_folder(recording: Recording, folder: Path, arguments: ExportOptions) -> dict[str, int]:
    """Writes a recording into a folder in the format of the options; returns the number of rows by what they are."""
    match arguments.format:
        case "euroc":
            return write_euroc(recording, folder, arguments.camera, arguments.stereo_baseline)
        case "rosbag2":
            return write_rosbag2(recording, folder, arguments.output.name, arguments.storage)
        case "opensim":
            return write_opensim(recording, folder, arguments.model)
        case _:
            return write_tum_rgbd(recording, folder, arguments.camera)


def _write_table(recording: Recording, output: Path, frame: str) -> dict[str, int]:
    """Writes the samples of one stream without images as a table.

    Args:
        recording: The recording.
        output: File to write, `.csv` or `.npz`.
        frame: Name of the stream: its topic, with or without the first slash.

    Returns:
        Number of rows, by the name of the stream.

    Raises:
        ConfigError: There is no such stream, or the suffix is another one.
    """
    names = sorted(topic.strip("/") for topic, info in recording.topics.items() if info.kind not in (Image, Depth))
    name = frame.strip("/")
    if name not in names:
        raise ConfigError("export", "--frame", frame, f"a stream of {recording.path}: {suggest(name, names) or 'none'}")
    block = recording.block(f"/{name}")
    write_sample_table(output, block)
    return {name: len(block)}


def import_command(arguments: ImportCommandOptions, progress: Progress) -> Outcome:
    """Runs `import`: writes any source as a recording of ours, and lists its topics, assumptions and problems."""
    recording = open_source(arguments)
    contradictions = report_cameras(recording, list(recording.topics), lenient=arguments.lenient)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    write_recording(recording, arguments.output, lambda share: progress("import", share))
    topics = {t: {"kind": i.kind.__name__, "samples": i.count} for t, i in sorted(recording.topics.items())}
    data = {
        "recording": str(arguments.output),
        "kind": recording.metadata.get("imported_from", "stridetwin"),
        "duration_s": recording.duration,
        "topics": topics,
        "unread": recording.unread,
        "warnings": [*recording.warnings, *contradictions],
        "problems": [str(p) for p in recording.problems],
    }
    lines = [f"{arguments.output}: {recording.duration:.1f} s of {data['kind']}"]
    lines += [f"  {t:<34} {i['kind']:<14} {i['samples']:>8}" for t, i in topics.items()]
    unread = {t: kind for t, kind in sorted(recording.unread.items()) if not t.endswith("/camera_info")}
    lines += [f"  {t:<34} not read: {kind}" for t, kind in unread.items()]
    lines += [f"  left out: {p}" for p in recording.problems]
    return Outcome(data=data, lines=lines)


def check_command(arguments: CheckOptions, progress: Progress) -> Outcome:
    """Runs `check`: reports every problem of a recording; the exit code is 1 if one invalidates estimates."""
    progress("check", 0.0)
    recording = open_source(replace(arguments, lenient=True), reports=False)  # a check reports every problem
    verdict = check_recording(recording, lambda share: progress("check", share))
    return Outcome(data=verdict.data, lines=check_table(verdict), code=0 if verdict.is_valid else 1)


def view_command(arguments: ViewOptions, progress: Progress) -> Outcome:
    """Runs `view`: writes a recording with its estimates for Rerun and opens it, or plays a walk in MuJoCo's viewer.

    Without a display, the file is written only, and the output says how to open it elsewhere.

    Raises:
        StrideTwinError: An option does not fit, the viewer is not installed, or the recording cannot be read.
    """
    if arguments.mujoco:
        if arguments.output is not None:
            raise ConfigError("view", "-o", str(arguments.output), "no -o with --mujoco, which writes nothing")
        if arguments.lenient:
            raise ConfigError("view", "--lenient", True, "no --lenient with --mujoco, which reads a scenario")
        from stridetwin.cli.scene import play_walk

        return play_walk(str(arguments.source), arguments.seed or 0, progress)
    if arguments.seed is not None:
        raise ConfigError("view", "--seed", arguments.seed, "no --seed, as a recording has its own")
    with explain_import_error("the viewer needs it", "view"):
        from stridetwin.report.rerun_file import rerun_installed, write_rerun
    from stridetwin.run.recording import Selection, evaluate_recording

    if not rerun_installed():
        raise StrideTwinError(f"rerun is not installed; the viewer needs it: {install_hint('view')}")
    recording = open_with_warnings(arguments.source, arguments.lenient)
    report_cameras(recording, list(recording.topics), lenient=True)
    progress("rerun", 0.0)
    selection = Selection(frames=frozenset(true_frames(recording.topics)))
    of_kinds = list(evaluate_recording(recording, selection, progress=progress, in_two_processes=True))
    target = arguments.output or arguments.source.with_suffix(".rrd")
    with atomic_file(target) as file:
        write_rerun(file, recording, of_kinds)
    # on Linux one of these variables names the display
    has_display = sys.platform in ("darwin", "win32") or any(os.environ.get(v) for v in ("DISPLAY", "WAYLAND_DISPLAY"))
    if has_display:  # the viewer runs on after this command
        subprocess.Popen([sys.executable, "-m", "rerun", str(target)])
    state = "opened in Rerun" if has_display else f"no display here; on a machine with one: rerun {target}"
    return Outcome(data={"file": str(target), "opened": has_display}, lines=[f"{target}: {state}"])
