"""One scenario from start to end: walk, record, estimate, score, tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.evaluation.evaluate import evaluate
from stridetwin.evaluation.path_scores import Scores
from stridetwin.evaluation.step_scores import evaluate_every_step
from stridetwin.evaluation.terrain_ahead import Ahead, all_estimates
from stridetwin.pipeline.mode_files import predicted_steps, write_modes
from stridetwin.pipeline.step_files import write_steps
from stridetwin.pipeline.terrain_files import write_terrain
from stridetwin.scenarios import injected
from stridetwin.scenarios.files import json_text, staged
from stridetwin.scenarios.record import Progress, make_twin, record
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.streams.formats.tum import write_tum
from stridetwin.streams.recording.reader import Recording

Frame = tuple[float, NDArray[np.uint8]]


@dataclass(frozen=True, kw_only=True)
class Run:
    """What a run leaves behind.

    Attributes:
        folder: Where the files are.
        files: Their names.
        scores: Estimator to scores.
    """

    folder: Path
    files: tuple[str, ...]
    scores: dict[str, Scores]


def run_scenario(
    scenario: Scenario,
    seed: int,
    folder: Path,
    command: str = "",
    progress: Progress = lambda stage, share: None,
    *,
    pictures: bool = True,
) -> Run:
    """Walks, estimates and scores in one go.

    Args:
        scenario: Who walks where.
        seed: Fixes every byte of the recording and of the scores.
        folder: Gets `recording.mcap`, `scores.json`, `report.html`, `run.rrd` (where there is Rerun), a TUM
            file an estimator of paths, a table an estimator of steps, and the last of the terrain map; all of them at
            the end, none of them if anything fails.
        command: How a reader of the report makes it again.
        progress: Told the stage and how far it is (0-1).
        pictures: The report shows a film, and the views of the cameras that are on.

    Raises:
        StrideTwinError: Anything that the user can put right.
    """
    from stridetwin.report.film import FPS, HEIGHT, WIDTH, make_film
    from stridetwin.report.rerun_file import rerun_installed, write_rerun
    from stridetwin.report.run_report import Story, render_report

    twin = make_twin(scenario, seed)
    with staged(folder) as out:
        record(twin, out / "recording.mcap", progress)
        recording = Recording(out / "recording.mcap", lenient=bool(scenario.config.faults))
        progress("estimate", 0.0)
        made, ahead = all_estimates(recording, progress)
        results = evaluate(recording, made)
        for result in results:
            write_tum(result.estimate.path, out / f"{result.estimate.name}.txt")
        scores = {r.estimate.name: r.scores for r in results}
        steps = evaluate_every_step(recording)
        for name, result_of_steps in steps.items():
            write_steps(result_of_steps.estimates, out / f"{name}.csv")
            scores[name] = result_of_steps.scores
        if ahead is not None:
            scores |= ahead.scores
            write_ahead_files(ahead, out)
        faults = injected.from_metadata(recording.metadata)
        document = scores_document(scenario, seed, scores, twin.fell_at, faults)
        (out / "scores.json").write_text(json_text(document), encoding="utf-8")
        film = None
        if pictures:
            film = make_film(_told(twin.film(FPS, WIDTH, HEIGHT), twin.duration_s, progress), twin.duration_s)
        progress("report", 0.0)
        story = Story(
            description=scenario.description,
            config=scenario.config,
            seed=seed,
            duration_s=twin.duration_s,
            command=command,
            recording=recording,
            results=results,
            steps=next(iter(steps.values()), None),
            film=film,
            ahead=ahead,
        )
        (out / "report.html").write_text(render_report(story), encoding="utf-8")
        if rerun_installed():
            progress("rerun", 0.0)
            write_rerun(out / "run.rrd", recording, results, ahead)
        files = tuple(sorted(p.name for p in out.iterdir()))
    return Run(folder=folder, files=files, scores=scores)


def write_ahead_files(ahead: Ahead, folder: Path) -> None:
    """Of each estimator a row a step as it was last predicted, or the map as it was at the end."""
    for name, estimates in ahead.predicted.items():
        write_modes(predicted_steps(estimates), folder / f"{name}.csv")
    for name, terrain_map in ahead.maps.items():
        if terrain_map.estimate is not None:
            write_terrain(terrain_map, folder / f"{name}.json")


def scores_document(
    scenario: Scenario,
    seed: int,
    scores: dict[str, Scores],
    fell_at: float | None = None,
    faults: Sequence[injected.Injected] = (),
) -> dict[str, object]:
    """What `scores.json` holds: no times of day, no paths, so that equal runs give equal bytes."""
    walk: dict[str, object] = {"scenario": scenario.config.name, "seed": seed, "physics": scenario.config.physics}
    if fell_at is not None:
        walk["fell_at_s"] = fell_at
    if faults:
        walk["faults"] = [vars(f) for f in faults]
    return {
        "recordings": [walk],
        "estimators": scores,
    }


def _told(frames: Iterator[Frame], duration_s: float, progress: Progress) -> Iterator[Frame]:
    for t, rgb in frames:
        progress("film", t / duration_s)
        yield t, rgb
