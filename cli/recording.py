"""`check`, `import`, `export` and `view`: checks, converts and shows recordings."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from stridetwin.cli.options import ImportableOptions, Outcome, Progress, SourceOptions, option, positive, switch, whole
from stridetwin.cli.scene import play_walk
from stridetwin.streams.errors import ConfigError, StrideTwinError

if TYPE_CHECKING:
    from stridetwin.streams.formats.imu_text import TableRequest
    from stridetwin.streams.recording.reader import Recording


def imported(arguments: ImportableOptions, *, reports: bool = True) -> Recording:
    """`opened`, with the options of a command."""
    from stridetwin.streams.formats.opening import ImportOptions, opened

    options = ImportOptions(
        kind=arguments.kind,
        names=dict(_mapped(text) for text in arguments.map),
        rig=arguments.rig,
        depth_scale=arguments.depth_scale,
        table=table_request(arguments),
    )
    return opened(arguments.source, arguments.lenient, options, reports=reports)


def table_request(arguments: ImportableOptions) -> TableRequest:
    """What the arguments say about a table."""
    from stridetwin.streams.formats.imu_columns import parsed_mapping
    from stridetwin.streams.formats.imu_text import TableRequest

    columns = parsed_mapping(arguments.columns) if arguments.columns else {}
    return TableRequest(columns=columns, rate_hz=arguments.rate)


def _mapped(text: str) -> tuple[str, str]:
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise StrideTwinError(f"--map: invalid {text!r}: expected FROM=TO")
    return old, new


DEFAULT_FRAME = "foot_l/imu"
TRAJECTORY_SUFFIXES = (".txt", ".tum")


def export(
    recording: Recording,
    form: str,
    output: Path,
    *,
    frame: str | None = None,
    camera: str | None = None,
    storage: str = "mcap",
    stereo_baseline_m: float | None = None,
    model: str = "rajagopal",
) -> dict[str, int]:
    """Writes a recording in another format: a file, or a new or empty folder that appears complete or not at all.

    `tum` with a frame, or a file name that ends in .txt or .tum, is a trajectory; otherwise an RGB-D folder.

    Returns:
        Rows written, by kind.

    Raises:
        StrideTwinError: The recording lacks what the format needs, or the output exists.
    """
    from stridetwin.outputs.truth import true_path
    from stridetwin.scenarios.files import staged
    from stridetwin.streams.formats.euroc import write_euroc
    from stridetwin.streams.formats.mcap_export import write_rosbag2
    from stridetwin.streams.formats.opensim_export import write_opensim
    from stridetwin.streams.formats.tum import write_tum
    from stridetwin.streams.formats.tum_rgbd import write_tum_rgbd

    if form == "table":
        return _table(recording, output, frame or DEFAULT_FRAME)
    if form == "tum" and (frame is not None or output.suffix in TRAJECTORY_SUFFIXES):
        frame = frame or DEFAULT_FRAME
        truth = true_path(recording, frame).poses
        write_tum(truth, output)
        return {frame: len(truth)}
    writers: dict[str, Callable[[Path], dict[str, int]]] = {
        "euroc": lambda folder: write_euroc(recording, folder, camera, stereo_baseline_m),
        "tum": lambda folder: write_tum_rgbd(recording, folder, camera),
        "rosbag2": lambda folder: write_rosbag2(recording, folder, output.name, storage),
        "opensim": lambda folder: write_opensim(recording, folder, model),
    }
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise ConfigError("export", "-o", str(output), "a folder that is new or empty")
    with staged(output) as folder:
        return writers[form](folder)


def _table(recording: Recording, output: Path, frame: str) -> dict[str, int]:
    from stridetwin.streams.formats.imu_table import write_imu_table

    imus = sorted(t.strip("/") for t in recording.rig.imus if t in recording.topics)
    if frame not in imus:
        raise StrideTwinError(f"{recording.path}: no IMU {frame!r}; it has {', '.join(imus) or 'none'}")
    block = recording.block(f"/{frame}")
    write_imu_table(output, block)
    return {frame: len(block)}


@dataclass(frozen=True, kw_only=True)
class ExportOptions(SourceOptions):
    """Write a recording in another tool's format."""

    format: Annotated[
        Literal["euroc", "tum", "rosbag2", "opensim", "table"],
        typer.Option(help="Format; tum: path of a frame (FILE.txt) or RGB-D folder; table: IMU."),
    ]
    frame: Annotated[
        str | None, typer.Option(help="tum, table: frame of the path or the IMU, such as pelvis (default foot_l/imu).")
    ] = None
    camera: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="euroc, tum: camera (default the first with depth).")
    ] = None
    stereo_baseline: Annotated[
        float | None,
        typer.Option(parser=positive, metavar="M", help="euroc: render a right camera at this distance from depth."),
    ] = None
    storage: Annotated[Literal["mcap", "sqlite3"], typer.Option(help="rosbag2: storage.")] = "mcap"
    model: Annotated[Literal["rajagopal", "gait2392"], typer.Option(help="opensim: names and signs of this model.")] = (
        "rajagopal"
    )
    output: Annotated[Path, typer.Option("-o", "--output", metavar="PATH", help="File or folder to write.")]


@dataclass(frozen=True, kw_only=True)
class ImportCommandOptions(ImportableOptions):
    """Convert another tool's recording into one of ours."""

    output: Annotated[Path, typer.Option("-o", "--output", metavar="RECORDING", help="Recording to write (.mcap).")]


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ImportableOptions):
    """Validate a recording; exit 1 if a problem would invalidate estimates."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions(SourceOptions):
    """Open a recording in Rerun, or play a walk in MuJoCo's viewer."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING|SCENARIO",
            help="Recording, or anything that `import` reads; with --mujoco a scenario.",
            show_default=False,
        ),
    ]
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Rerun file to write (default beside the recording)."),
    ] = None
    mujoco: Annotated[bool, switch("--mujoco", "Play the walk of a scenario in MuJoCo's viewer.")] = False
    seed: Annotated[int | None, option("--mujoco: seed of the walk (default 0).", "N", whole)] = None


def export_command(arguments: ExportOptions, progress: Progress) -> Outcome:
    """`export`."""
    from stridetwin.streams.formats.opening import opened

    recording = opened(arguments.source, arguments.lenient)
    progress("export", 0.0)
    rows = export(
        recording,
        arguments.format,
        arguments.output,
        frame=arguments.frame,
        camera=arguments.camera,
        storage=arguments.storage,
        stereo_baseline_m=arguments.stereo_baseline,
        model=arguments.model,
    )
    data = {"file": str(arguments.output), "format": arguments.format, "rows": sum(rows.values()), "parts": rows}
    return Outcome(data=data, lines=[f"{arguments.output}: {n} rows of {name}" for name, n in rows.items()])


def import_command(arguments: ImportCommandOptions, progress: Progress) -> Outcome:
    """`import`."""
    from stridetwin.streams.formats.mcap_export import write_recording

    recording = imported(arguments)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    write_recording(recording, arguments.output, lambda share: progress("import", share))
    topics = {t: {"kind": i.kind.__name__, "samples": i.count} for t, i in sorted(recording.topics.items())}
    data = {
        "recording": str(arguments.output),
        "kind": recording.metadata.get("imported_from", "stridetwin"),
        "duration_s": recording.duration,
        "topics": topics,
        "unread": recording.unread,
        "warnings": recording.warnings,
        "problems": [str(p) for p in recording.problems],
    }
    lines = [f"{arguments.output}: {recording.duration:.1f} s of {data['kind']}"]
    lines += [f"  {t:<34} {i['kind']:<14} {i['samples']:>8}" for t, i in topics.items()]
    unread = {t: kind for t, kind in sorted(recording.unread.items()) if not t.endswith("/camera_info")}
    lines += [f"  {t:<34} not read: {kind}" for t, kind in unread.items()]
    lines += [f"  left out: {p}" for p in recording.problems]
    return Outcome(data=data, lines=lines)


def check_command(arguments: CheckOptions, progress: Progress) -> Outcome:
    """`check`."""
    from stridetwin.scenarios.check import check_recording, check_table

    progress("check", 0.0)
    recording = imported(replace(arguments, lenient=True), reports=False)  # a check reports every problem
    found = check_recording(recording, lambda share: progress("check", share))
    return Outcome(data=found.data, lines=check_table(found), code=0 if found.is_valid else 1)


def view_command(arguments: ViewOptions, progress: Progress) -> Outcome:
    """`view`."""
    if arguments.mujoco:
        if arguments.output is not None:
            raise ConfigError("view", "-o", str(arguments.output), "no -o with --mujoco, which writes nothing")
        if arguments.lenient:
            raise ConfigError("view", "--lenient", True, "no --lenient with --mujoco, which reads a scenario")
        return play_walk(str(arguments.source), arguments.seed or 0, progress)
    if arguments.seed is not None:
        raise ConfigError("view", "--seed", arguments.seed, "no --seed, as a recording has its own")
    from stridetwin.outputs.truth import true_frames
    from stridetwin.report.rerun_file import rerun_installed, write_rerun
    from stridetwin.run.recording import Selection, evaluate_recording
    from stridetwin.streams.files import whole_file
    from stridetwin.streams.formats.opening import opened

    if not rerun_installed():
        raise StrideTwinError("rerun is not installed; the viewer needs it: pip install 'stridetwin[view]'")
    recording = opened(arguments.source, arguments.lenient)
    progress("rerun", 0.0)
    selection = Selection(frames=frozenset(true_frames(recording.topics)))
    of_kinds = list(evaluate_recording(recording, selection, progress=progress, in_two_processes=True))
    target = arguments.output or arguments.source.with_suffix(".rrd")
    with whole_file(target) as file:
        write_rerun(file, recording, of_kinds)
    display = sys.platform in ("darwin", "win32") or any(os.environ.get(v) for v in ("DISPLAY", "WAYLAND_DISPLAY"))
    if display:
        subprocess.Popen([sys.executable, "-m", "rerun", str(target)])
    words = "opened in Rerun" if display else f"no display here; on a machine with one: rerun {target}"
    return Outcome(data={"file": str(target), "opened": display}, lines=[f"{target}: {words}"])
