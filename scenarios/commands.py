"""What each command does. Heavy parts are imported where they are needed, so that help comes at once."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import textwrap
from argparse import Namespace
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stridetwin.streams.errors import StrideTwinError

if TYPE_CHECKING:
    from stridetwin.scenarios.baseline import Regression
    from stridetwin.scenarios.scenario_file import Scenario
    from stridetwin.scenarios.scoring import Scores
    from stridetwin.streams.opening import ImportOptions
    from stridetwin.streams.recording import Recording

Progress = Callable[[str, float], None]
ESTIMATORS = {
    "foot_ins": "path of one foot from its IMU alone (zero-velocity updates)",
    "foot_to_foot": "paths of both feet, tied together by what shoe cameras and sonars tell of each other",
    "contact_terrain": "slope, step height and class of each step from an exoskeleton's AHRS, encoders and insoles",
    "dvio": "path of a head- or chest-worn RGB-D camera with IMU",
    "terrain_map": "planes, ramps and stairs around the walker from depth pictures and poses",
    "locomotion_mode": "mode, place and time of the coming steps from depth pictures, poses and insoles",
}
_SHOWN_STEPS = {
    "slope_rmse_deg": "slope °",
    "elevation_rmse_mm": "elevation mm",
    "slope_in_95_pct": "slope in 95 %",
    "elevation_in_95_pct": "elev. in 95 %",
    "classification_accuracy_pct": "class %",
    "unknown_pct": "unknown %",
    "end_error_m": "end m",
    "end_error_pct": "end %",
}
_SHOWN = {
    "end_error_m": "end m",
    "end_error_pct": "end %",
    "end_height_error_m": "height m",
    "ape_rmse_m": "APE RMSE m",
    "rpe_5m_pct": "RPE 5 m %",
    "armse_2d_m": "2-D ARMSE m",
    "nees_position_within_95_pct": "in 95 % bound %",
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command has to say.

    Attributes:
        data: For `--json`.
        lines: For people.
        code: Exit code.
    """

    data: dict[str, Any]
    lines: list[str]
    code: int = 0


def run_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`run`."""
    from stridetwin.scenarios.runner import run_scenario

    scenario = _scenario(arguments)
    folder = arguments.output or Path("runs") / scenario.config.name
    run = run_scenario(
        scenario, arguments.seed, folder, _how_to_repeat(arguments), progress, pictures=not arguments.no_film
    )
    data = {"folder": str(run.folder), "files": list(run.files), "estimators": run.scores}
    report = (run.folder / "report.html").absolute().as_uri()
    return Outcome(data=data, lines=[*score_table(run.scores), "", f"report  {report}", f"files   {folder}/"])


def generate_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`generate`."""
    from stridetwin.scenarios.runner import make_twin, record

    scenario = _scenario(arguments)
    twin = make_twin(scenario, arguments.seed)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    record(twin, arguments.output, progress)
    data = {"recording": str(arguments.output), "duration_s": twin.duration_s, "seed": arguments.seed}
    return Outcome(data=data, lines=[f"{arguments.output}: {twin.duration_s:.1f} s of {scenario.config.name}"])


def list_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`list`."""
    from stridetwin.scenarios.experiments.names import EXPERIMENT_NAMES
    from stridetwin.scenarios.fault_fields import KINDS
    from stridetwin.scenarios.scenario_file import PHYSICS, SENSORS, catalogue, read_scenario
    from stridetwin.sim.parts.library import kind_of, library, part
    from stridetwin.sim.people import PEOPLE

    parts = {name: part(name) for name in library()}
    scenarios = {name: read_scenario(path).description for name, path in catalogue().items()}
    data = {
        "scenarios": scenarios,
        "sensors": list(SENSORS),
        "estimators": ESTIMATORS,
        "experiments": EXPERIMENT_NAMES,
        "parts": {name: {"kind": kind_of(p), "description": p.description} for name, p in parts.items()},
        "faults": sorted(KINDS),
        "physics": list(PHYSICS),
        "people": {name: asdict(person) for name, person in PEOPLE.items()},
    }
    lines = ["Scenarios", *(f"  {n:<16} {words}" for n, words in scenarios.items()), "", "Estimators"]
    lines += [
        *(f"  {n:<16} {words}" for n, words in ESTIMATORS.items()),
        "",
        "Experiments",
        *(f"  {n:<16} {words}" for n, words in EXPERIMENT_NAMES.items()),
        "",
        "Sensors",
        f"  {', '.join(SENSORS)}",
        "",
        "Parts (each has an ideal twin: its name with -ideal)",
        *(f"  {n:<16} {kind_of(p):<11} {p.description}" for n, p in parts.items()),
        "",
        "Faults",
        *textwrap.wrap(", ".join(sorted(KINDS)), 110, initial_indent="  ", subsequent_indent="  "),
        "",
        "People",
        *(f"  {n:<16} {p.sex}, {p.height_m:.3g} m, {p.mass_kg:.3g} kg" for n, p in PEOPLE.items()),
    ]
    return Outcome(data=data, lines=lines)


def export_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`export`."""
    from stridetwin.scenarios.export import export

    recording = _recording(arguments.source, arguments.lenient)
    progress("export", 0.0)
    rows = export(
        recording,
        arguments.format,
        arguments.output,
        frame=arguments.frame,
        camera=arguments.camera,
        storage=arguments.storage,
        stereo_baseline_m=arguments.stereo_baseline,
    )
    data = {"file": str(arguments.output), "format": arguments.format, "rows": sum(rows.values()), "parts": rows}
    return Outcome(data=data, lines=[f"{arguments.output}: {n} rows of {name}" for name, n in rows.items()])


def import_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`import`."""
    from stridetwin.streams.formats.recorded import write_recording

    recording = _imported(arguments)
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


def check_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`check`."""
    from stridetwin.scenarios.check import check_recording, check_table

    progress("check", 0.0)
    arguments.lenient = True  # a check tells all that is wrong, not the first of it
    recording = _imported(arguments, tell=False)
    found = check_recording(recording, lambda share: progress("check", share))
    return Outcome(data=found.data, lines=check_table(found), code=1 if found.spoilt else 0)


def estimate_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`estimate`."""
    from stridetwin.scenarios.estimates import estimate_feet, estimate_foot, foot_filter
    from stridetwin.scenarios.imu_table import TABLES
    from stridetwin.streams.imu_table import read_imu_table
    from stridetwin.streams.tum import write_tum

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
        paths = {arguments.output: estimate_odometry(_imported(arguments), arguments.method, progress).path}
    elif arguments.estimator == "foot_to_foot":
        if arguments.foot:
            raise StrideTwinError("--foot goes with foot_ins; foot_to_foot writes a file for each foot")
        if arguments.lag is not None:
            raise StrideTwinError("--lag goes with foot_ins; foot_to_foot tells each pose at once")
        progress("estimate", 0.0)
        made = estimate_feet(_imported(arguments), arguments.method)
        paths = {_for_foot(arguments.output, e.frame[len("foot_")]): e.path for e in made}
    elif arguments.method != "stridetwin":
        raise StrideTwinError(f"--method {arguments.method} goes with foot_to_foot; valid for foot_ins: stridetwin")
    elif arguments.source.suffix in TABLES:
        paths = {arguments.output: foot_filter(arguments.lag).run(read_imu_table(arguments.source)).trajectory}
    else:
        paths = {arguments.output: estimate_foot(_imported(arguments), arguments.foot or "l", arguments.lag).path}
    for file, path in paths.items():
        write_tum(path, file)
    rows = sum(map(len, paths.values()))
    data = {"file": str(next(iter(paths))), "files": [str(f) for f in paths], "estimator": arguments.estimator}
    lines = [f"{file}: {len(path)} poses" for file, path in paths.items()]
    return Outcome(data=data | {"rows": rows}, lines=lines)


def _estimate_steps(arguments: Namespace, progress: Progress) -> Outcome:
    from stridetwin.scenarios.estimates import estimate_steps
    from stridetwin.scenarios.steps import write_steps

    if arguments.foot:
        raise StrideTwinError("--foot goes with foot_ins; contact_terrain writes the steps of both feet")
    progress("estimate", 0.0)
    made = estimate_steps(_imported(arguments), arguments.method, arguments.exoskeleton)
    write_steps(made, arguments.output)
    file = str(arguments.output)
    data = {"file": file, "files": [file], "estimator": arguments.estimator, "rows": len(made)}
    return Outcome(data=data, lines=[f"{file}: {len(made)} steps"])


def _estimate_terrain(arguments: Namespace, progress: Progress) -> Outcome:
    from stridetwin.scenarios.terrain_files import document, map_recording, write_terrain
    from stridetwin.streams.tum import read_tum

    if arguments.foot:
        raise StrideTwinError("--foot goes with foot_ins; terrain_map looks through the depth camera")
    progress("estimate", 0.0)
    terrain_map = map_recording(_imported(arguments), read_tum(arguments.poses) if arguments.poses else None)
    files = [str(f) for f in write_terrain(terrain_map, arguments.output)]
    found = document(terrain_map.estimate) if terrain_map.estimate else {"planes": [], "terrains": []}
    kinds = [t["type"] for t in found["terrains"]]
    data = {"file": files[0], "files": files, "estimator": arguments.estimator, "rows": len(found["planes"])}
    told = ", ".join(f"{kinds.count(k)} {k}" for k in ("level", "ramp", "stairs"))
    return Outcome(data=data, lines=[f"{files[0]}: {len(found['planes'])} planes; {told}"])


def _estimate_modes(arguments: Namespace, progress: Progress) -> Outcome:
    from stridetwin.scenarios.mode_files import predict_recording, predicted_steps, write_modes
    from stridetwin.streams.tum import read_tum

    if arguments.foot:
        raise StrideTwinError("--foot goes with foot_ins; locomotion_mode tells the steps of both feet")
    progress("estimate", 0.0)
    path = read_tum(arguments.poses) if arguments.poses else None
    rows = predicted_steps(predict_recording(_imported(arguments), arguments.method, path))
    write_modes(rows, arguments.output)
    file = str(arguments.output)
    data = {"file": file, "files": [file], "estimator": arguments.estimator, "rows": len(rows)}
    return Outcome(data=data, lines=[f"{file}: {len(rows)} steps"])


def _for_foot(file: Path, foot: str) -> Path:
    """`path.txt` becomes `path_l.txt`."""
    return file.with_name(f"{file.stem}_{foot}{file.suffix}")


def score_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`score`."""
    from stridetwin.scenarios.baseline import regressions
    from stridetwin.scenarios.estimates import estimates
    from stridetwin.scenarios.evaluate import Estimate, evaluate, summary
    from stridetwin.scenarios.step_scores import evaluate_steps, feeds_steps
    from stridetwin.streams.tum import read_tum

    named = [_named_file(text) for text in arguments.estimate]
    if named and len(arguments.recordings) > 1:
        raise StrideTwinError("--estimate goes with one recording; valid: one RECORDING, or no --estimate")
    baseline = _json_file(arguments.baseline) if arguments.baseline else None
    entries, scores = [], []
    for i, path in enumerate(arguments.recordings):
        progress("score", i / len(arguments.recordings))
        recording = _recording(path, arguments.lenient)
        made = [Estimate(name=n, frame=arguments.frame, path=read_tum(f)) for n, f in named] or estimates(recording)
        steps = not named and feeds_steps(recording)
        if not made and not steps:
            raise StrideTwinError(
                f"{path}: feeds no estimator; valid: a recording with /foot_l/imu or /foot_r/imu, with an "
                "exoskeleton's AHRS, encoders and insoles, or with an RGB-D camera with IMU on head or chest"
            )
        scores.append({r.estimate.name: r.scores for r in evaluate(recording, made, arguments.align)})
        if steps:
            scores[-1]["contact_terrain"] = evaluate_steps(recording).scores
        entries.append({"name": path.stem, "metadata": _public(recording.metadata), "estimators": scores[-1]})
    mean = summary(scores)
    data: dict[str, Any] = {"recordings": entries, "estimators": mean}
    lines, worse = score_table(mean), []
    if baseline is not None:
        worse = regressions(mean, baseline, str(arguments.baseline), arguments.tolerance / 100.0)
        data["regressions"] = [vars(r) for r in worse]
        lines += ["", *_regression_table(worse, arguments.tolerance)]
    return Outcome(data=data, lines=lines, code=1 if worse else 0)


def view_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`view`."""
    from stridetwin.scenarios.estimates import estimates
    from stridetwin.scenarios.evaluate import evaluate, true_frames
    from stridetwin.scenarios.rerun_file import rerun_installed, write_rerun
    from stridetwin.streams.files import whole_file

    if not rerun_installed():
        raise StrideTwinError("rerun is not installed; the viewer needs it: pip install 'stridetwin[view]'")
    recording = _recording(arguments.source, arguments.lenient)
    progress("rerun", 0.0)
    known = true_frames(recording.topics)
    results = evaluate(recording, [e for e in estimates(recording) if e.frame in known])
    target = arguments.output or arguments.source.with_suffix(".rrd")
    with whole_file(target) as file:
        write_rerun(file, recording, results)
    display = sys.platform in ("darwin", "win32") or any(os.environ.get(v) for v in ("DISPLAY", "WAYLAND_DISPLAY"))
    if display:
        subprocess.Popen([sys.executable, "-m", "rerun", str(target)])
    words = "opened in Rerun" if display else f"no display here; on a machine with one: rerun {target}"
    return Outcome(data={"file": str(target), "opened": display}, lines=[f"{target}: {words}"])


def experiment_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`experiment`."""
    from stridetwin.scenarios.experiments.registry import Asked, named, run_experiment

    asked = Asked(
        folder=arguments.output or Path("runs") / arguments.experiment,
        workers=arguments.workers,
        first=arguments.seed,
        subset=arguments.subset,
        physics=arguments.physics,
        resume=arguments.resume,
        keep=arguments.keep,
    )
    result = run_experiment(arguments.experiment, asked, progress)
    return Outcome(data=result, lines=named(arguments.experiment).table(result))


def score_table(scores: dict[str, Scores]) -> list[str]:
    """The main scores as lines of text, one an estimator: those of paths, then those of steps."""
    steps = {name: values for name, values in scores.items() if "slope_rmse_deg" in values}
    paths = {name: values for name, values in scores.items() if name not in steps}
    lines = _score_lines(paths, _SHOWN) if paths or not steps else []
    return [*lines, *([""] if lines and steps else []), *(_score_lines(steps, _SHOWN_STEPS) if steps else [])]


def _score_lines(scores: dict[str, Scores], shown: dict[str, str]) -> list[str]:
    lines = [f"{'estimator':<16}" + "".join(f"{words:>17}" for words in shown.values())]
    for name, values in scores.items():
        cells = (f"{values[k]:>17.3f}" if k in values else f"{'-':>17}" for k in shown)
        lines.append(f"{name:<16}" + "".join(cells))
    return lines


def _regression_table(worse: list[Regression], tolerance: float) -> list[str]:
    if not worse:
        return [f"no score is worse than the baseline by more than {tolerance:g} %"]
    lines = [f"{'worse than the baseline':<44}{'baseline':>12}{'limit':>12}{'now':>12}"]
    for r in worse:
        now = "missing" if r.now is None else f"{r.now:.4f}"
        lines.append(f"{r.estimator + ' ' + r.metric:<44}{r.baseline:>12.4f}{r.limit:>12.4f}{now:>12}")
    return lines


def _scenario(arguments: Namespace) -> Scenario:
    from stridetwin.scenarios.runner import without_cameras
    from stridetwin.scenarios.scenario_file import PHYSICS, load_scenario
    from stridetwin.streams.errors import ConfigError

    scenario = load_scenario(arguments.scenario)
    if arguments.physics is not None:
        if arguments.physics not in PHYSICS:
            raise ConfigError("command line", "--physics", arguments.physics, ", ".join(PHYSICS))
        scenario = replace(scenario, config=replace(scenario.config, physics=arguments.physics))
    return without_cameras(scenario) if arguments.no_cameras else scenario


def _how_to_repeat(arguments: Namespace) -> str:
    words = ["stridetwin", "run", arguments.scenario, "--seed", str(arguments.seed)]
    words += ["--physics", arguments.physics] if arguments.physics else []
    words += ["--no-cameras"] if arguments.no_cameras else []
    words += ["--no-film"] if arguments.no_film else []
    return shlex.join(words)


def _recording(path: Path, lenient: bool, options: ImportOptions | None = None, *, tell: bool = True) -> Recording:
    """A recording, or anything that can be imported; what had to be assumed is told on stderr."""
    from stridetwin.streams.opening import open_any

    recording = open_any(path, lenient, options)
    for words in (*recording.warnings, *map(str, recording.problems)) if tell else ():
        print(f"stridetwin: warning: {path}: {words}", file=sys.stderr)
    return recording


def _imported(arguments: Namespace, *, tell: bool = True) -> Recording:
    from stridetwin.streams.opening import ImportOptions

    options = ImportOptions(
        kind=arguments.kind,
        names=dict(_mapped(text) for text in arguments.map),
        rig=arguments.rig,
        depth_scale=arguments.depth_scale,
    )
    return _recording(arguments.source, arguments.lenient, options, tell=tell)


def _mapped(text: str) -> tuple[str, str]:
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise StrideTwinError(f"--map: {text!r} is not valid; valid: FROM=TO")
    return old, new


def _named_file(text: str) -> tuple[str, Path]:
    name, equals, file = text.partition("=")
    if not (name and equals and file):
        raise StrideTwinError(f"--estimate: {text!r} is not valid; valid: NAME=FILE")
    return name, Path(file)


def _json_file(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise StrideTwinError(f"{path}: is not JSON: {error}") from error


def _public(metadata: Any) -> dict[str, str]:
    return {k: metadata[k] for k in ("scenario", "seed", "physics") if k in metadata}
