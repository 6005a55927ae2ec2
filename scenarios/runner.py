"""One scenario from start to end: walk, record, estimate, score, tell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios import ground
from stridetwin.scenarios.evaluate import Result, estimates, evaluate
from stridetwin.scenarios.files import json_text, staged
from stridetwin.scenarios.scenario_file import CAMERAS, Scenario
from stridetwin.scenarios.scoring import Scores
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording import Recording, RecordingWriter
from stridetwin.streams.tum import write_tum

if TYPE_CHECKING:
    from stridetwin.sim.twin import Twin

Progress = Callable[[str, float], None]
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


def make_twin(scenario: Scenario, seed: int) -> Twin:
    """The twin of a scenario.

    Raises:
        StrideTwinError: The simulator is not installed.
    """
    try:
        from stridetwin.sim.twin import Twin
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "stridetwin":
            raise
        raise StrideTwinError(
            f"{error.name} is not installed; walks need the simulator: pip install 'stridetwin[twin]'"
        ) from error
    return Twin(scenario.config, seed)


def without_cameras(scenario: Scenario) -> Scenario:
    """The scenario with every camera off."""
    sensors = tuple(s for s in scenario.config.sensors if s not in CAMERAS)
    return replace(scenario, config=replace(scenario.config, sensors=sensors))


def record(twin: Twin, path: Path, progress: Progress) -> None:
    """Lets the twin walk and writes what its sensors say, and the truth, as one recording."""
    config = twin.config
    metadata = {
        "scenario": config.name,
        "seed": str(twin.seed),
        "physics": config.physics,
        "person_height_m": f"{config.person.height_m:g}",
        "person_mass_kg": f"{config.person.mass_kg:g}",
        ground.KEY: ground.to_text(twin.terrain.layout),
    }
    if twin.fell_at is not None:
        metadata["fell_at_s"] = f"{twin.fell_at:g}"
    t_ns = 0
    with RecordingWriter(path, twin.rig, metadata) as writer:
        for blocks in twin.blocks():
            for item in blocks:
                writer.write(item)
                last = item.t_ns if isinstance(item.t_ns, int) else item.t_ns[-1:].max(initial=0)
                t_ns = max(t_ns, int(last))
            progress("walk", t_ns / 1e9 / twin.duration_s)


def run_scenario(
    scenario: Scenario, seed: int, folder: Path, command: str, progress: Progress, *, pictures: bool = True
) -> Run:
    """Walks, estimates and scores in one go.

    Args:
        scenario: Who walks where.
        seed: Fixes every byte of the recording and of the scores.
        folder: Gets `recording.mcap`, `scores.json`, `report.html`, `run.rrd` (where there is Rerun) and a
            TUM file an estimator; all of them at the end, none of them if anything fails.
        command: How a reader of the report makes it again.
        progress: Told the stage and how far it is (0-1).
        pictures: The report shows a film, and the views of the cameras that are on.

    Raises:
        StrideTwinError: Anything that the user can put right.
    """
    from stridetwin.scenarios.film import FPS, HEIGHT, WIDTH, make_film
    from stridetwin.scenarios.report import Story, render_report
    from stridetwin.scenarios.rerun_file import rerun_installed, write_rerun

    twin = make_twin(scenario, seed)
    with staged(folder) as out:
        record(twin, out / "recording.mcap", progress)
        recording = Recording(out / "recording.mcap")
        progress("estimate", 0.0)
        results = evaluate(recording, estimates(recording))
        for result in results:
            write_tum(result.estimate.path, out / f"{result.estimate.name}.txt")
        scores = {r.estimate.name: r.scores for r in results}
        document = scores_document(scenario, seed, results, twin.fell_at)
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
            film=film,
        )
        (out / "report.html").write_text(render_report(story), encoding="utf-8")
        if rerun_installed():
            progress("rerun", 0.0)
            write_rerun(out / "run.rrd", recording, results)
        files = tuple(sorted(p.name for p in out.iterdir()))
    return Run(folder=folder, files=files, scores=scores)


def scores_document(
    scenario: Scenario, seed: int, results: list[Result], fell_at: float | None = None
) -> dict[str, object]:
    """What `scores.json` holds: no times of day, no paths, so that equal runs give equal bytes."""
    walk = {"scenario": scenario.config.name, "seed": seed, "physics": scenario.config.physics}
    return {
        "recordings": [walk if fell_at is None else walk | {"fell_at_s": fell_at}],
        "estimators": {r.estimate.name: r.scores for r in results},
    }


def _told(frames: Iterator[Frame], duration_s: float, progress: Progress) -> Iterator[Frame]:
    for t, rgb in frames:
        progress("film", t / duration_s)
        yield t, rgb
