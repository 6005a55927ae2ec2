"""Runs one scenario from start to end: walk, record, estimate, score, report."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from stridetwin.outputs.base import FileOptions, KindEvaluations, Scores, scores_by_output
from stridetwin.outputs.parameters import ParameterValues
from stridetwin.run.compile_ahead import compile_ahead
from stridetwin.run.recording import Selection, run_recording
from stridetwin.scenarios.files import stage_files
from stridetwin.scenarios.metadata import InjectedFault, read_injected_faults
from stridetwin.scenarios.record import Progress, make_twin, nominal_sensors, record
from stridetwin.scenarios.scenario_file import Scenario, to_scenario
from stridetwin.scenarios.score_needs import estimators_of, with_sensors_for
from stridetwin.sim.config import TwinConfig
from stridetwin.streams.errors import explain_import_error
from stridetwin.streams.files import to_json
from stridetwin.streams.recording.reader import Recording

Frame = tuple[float, NDArray[np.uint8]]


@dataclass(frozen=True, kw_only=True)
class Run:
    """Output of a run.

    Attributes:
        folder: Folder of the files.
        files: Their names.
        scores: Scores by the name of the output, such as `foot_ins_l`.
    """

    folder: Path
    files: tuple[str, ...]
    scores: dict[str, Scores]


def run_scenario(
    scenario: Scenario | TwinConfig | str | Path,
    seed: int,
    folder: str | Path,
    command: str = "",
    progress: Progress = lambda stage, share: None,
    *,
    film: bool = True,
    backend: str = "",
    only: Collection[str] = (),
    parameters: ParameterValues = MappingProxyType({}),
) -> Run:
    """Simulates a walk, runs the estimators and scores them.

    Args:
        scenario: Walker and route: a scenario, a configuration, a name in the catalogue, or the path of a file.
        seed: Fixes every byte of the recording and of the scores.
        folder: Receives `recording.mcap`, `scores.json`, `report.html`, `run.rrd` (if Rerun is installed), one TUM file
            per path estimator, one table per step estimator, and the final terrain map; all at the end, or none if
            anything fails.
        command: The command that reproduces the report.
        progress: Receives the stage and its progress (0-1).
        film: The report has a film of the walk.
        backend: Of the terrain map, see `Options.backend`.
        only: Estimators or scores that are asked for, see `score_needs.estimators_of`: the walk has no sensors but
            those that they need, and nothing else is estimated. Empty runs all.
        parameters: Values in place of the estimators' own, see `outputs.parameters`; `scores.json` records them.

    Returns:
        The folder with the names of its files, and the scores.

    Raises:
        StrideTwinError: Any usage error.
    """
    scenario = to_scenario(scenario)
    folder = Path(folder)
    with explain_import_error("runs need the simulator and its reports", "twin"):
        from stridetwin.report.images import FPS, HEIGHT, WIDTH, make_film
        from stridetwin.report.rerun_file import rerun_installed, write_rerun
        from stridetwin.report.run_report import ReportData, render_report

    estimators = estimators_of(only) if only else None
    if estimators is not None:
        scenario = with_sensors_for(scenario, estimators)
    with stage_files(folder) as out:
        # the estimators' kernels are compiled while the walk is simulated
        with compile_ahead(*nominal_sensors(scenario.config, seed), estimators):
            twin = make_twin(scenario, seed)
            record(twin, out / "recording.mcap", progress)
        # faults may leave a recording that is refused unless it is read leniently
        recording = Recording(out / "recording.mcap", lenient=bool(scenario.config.faults))
        progress("estimate", 0.0)
        selection = Selection(only=estimators, backend=backend, parameters=parameters)
        of_kinds = []
        # the files of all outputs, and the evaluations of those with a truth
        for kind, outputs in run_recording(recording, selection, progress=progress, in_two_processes=True):
            for output in outputs:
                if not kind.is_empty(output):
                    # `dead_reckoning`: a path's file also has the poses without tracking
                    kind.write(output, out / f"{output.name}{kind.suffix}", FileOptions(dead_reckoning=True))
            if evaluations := kind.evaluate(outputs, recording):
                of_kinds.append(KindEvaluations(kind=kind, evaluations=evaluations))
        scores = scores_by_output(of_kinds)
        document = scores_document(scenario, seed, scores, twin.fell_at, read_injected_faults(recording.metadata))
        if parameters:
            document["parameters"] = {name: dict(values) for name, values in parameters.items()}
        (out / "scores.json").write_text(to_json(document), encoding="utf-8")
        # a generator: without a film nothing is rendered
        frames = _report_frames(twin.film(FPS, WIDTH, HEIGHT), twin.duration_s, progress)
        film_of_walk = make_film(frames, twin.duration_s) if film else None
        progress("report", 0.0)
        data = ReportData(
            scenario=scenario,
            seed=seed,
            duration_s=twin.duration_s,
            total_mass_kg=twin.total_mass_kg,
            command=command,
            recording=recording,
            of_kinds=of_kinds,
            film=film_of_walk,
        )
        (out / "report.html").write_text(render_report(data), encoding="utf-8")
        if rerun_installed():
            progress("rerun", 0.0)
            write_rerun(out / "run.rrd", recording, of_kinds)
        files = tuple(sorted(p.name for p in out.iterdir()))
    return Run(folder=folder, files=files, scores=scores)


def scores_document(
    scenario: Scenario,
    seed: int,
    scores: dict[str, Scores],
    fell_at: float | None,
    faults: Sequence[InjectedFault],
) -> dict[str, object]:
    """The content of `scores.json`: without times of day or file paths, so that equal runs give equal bytes.

    Args:
        scenario: Scenario of the walk.
        seed: Seed of the walk.
        scores: Scores by the name of the output.
        fell_at: When the walker fell, s; None without a fall.
        faults: Injected faults.
    """
    walk: dict[str, object] = {"scenario": scenario.config.name, "seed": seed, "physics": scenario.config.physics}
    if fell_at is not None:
        walk["fell_at_s"] = fell_at
    if faults:
        walk["faults"] = [vars(f) for f in faults]
    return {"recordings": [walk], "estimators": scores}


def _report_frames(frames: Iterator[Frame], duration_s: float, progress: Progress) -> Iterator[Frame]:
    """Yields the frames of the film, each a time in s and an RGB image, after a report of the progress (0-1)."""
    for t, rgb in frames:
        progress("film", t / duration_s)
        yield t, rgb
