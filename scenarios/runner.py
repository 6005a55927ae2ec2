"""One scenario from start to end: walk, record, estimate, score, tell."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios import exo_geometry, ground, injected
from stridetwin.scenarios.estimates import estimates
from stridetwin.scenarios.evaluate import evaluate
from stridetwin.scenarios.files import json_text, staged
from stridetwin.scenarios.scenario_file import CAMERAS, Scenario
from stridetwin.scenarios.scoring import Scores
from stridetwin.scenarios.step_scores import evaluate_steps, feeds_steps
from stridetwin.scenarios.steps import write_steps
from stridetwin.sim.fault_plan import check_times, plan_faults
from stridetwin.sim.faults import arrivals
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording import Recording, RecordingWriter
from stridetwin.streams.samples import Block, Sample
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
    """Lets the twin walk and writes what arrives of what its sensors say, and the truth, as one recording.

    Raises:
        ConfigError: A fault that begins after the walk's end.
    """
    config = twin.config
    metadata = {
        "scenario": config.name,
        "seed": str(twin.seed),
        "physics": config.physics,
        "person_height_m": f"{config.person.height_m:g}",
        "person_mass_kg": f"{config.person.mass_kg:g}",
        ground.KEY: ground.to_text(twin.terrain.layout),
        **exo_geometry.metadata(twin),
    }
    if twin.fell_at is None:
        check_times(config.name, config.faults, twin.duration_s)
    else:
        metadata["fell_at_s"] = f"{twin.fell_at:g}"
    planned = plan_faults(config.faults, twin.rig, twin.seed, twin.duration_s)
    if planned:
        metadata[injected.KEY] = injected.to_text(planned)
    with RecordingWriter(path, twin.rig, metadata) as writer:
        for arrival in arrivals(_sensed(twin, progress), planned):
            writer.write(arrival.item, arrival.log_ns)


def _sensed(twin: Twin, progress: Progress) -> Iterator[Block[Any] | Sample]:
    t_ns = 0
    for blocks in twin.blocks():
        for item in blocks:
            last = item.t_ns if isinstance(item.t_ns, int) else item.t_ns[-1:].max(initial=0)
            t_ns = max(t_ns, int(last))
            yield item
        progress("walk", t_ns / 1e9 / twin.duration_s)


def run_scenario(
    scenario: Scenario, seed: int, folder: Path, command: str, progress: Progress, *, pictures: bool = True
) -> Run:
    """Walks, estimates and scores in one go.

    Args:
        scenario: Who walks where.
        seed: Fixes every byte of the recording and of the scores.
        folder: Gets `recording.mcap`, `scores.json`, `report.html`, `run.rrd` (where there is Rerun), a TUM
            file an estimator of paths and a table of steps; all of them at the end, none of them if anything fails.
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
        recording = Recording(out / "recording.mcap", lenient=bool(scenario.config.faults))
        progress("estimate", 0.0)
        results = evaluate(recording, estimates(recording))
        for result in results:
            write_tum(result.estimate.path, out / f"{result.estimate.name}.txt")
        scores = {r.estimate.name: r.scores for r in results}
        steps = evaluate_steps(recording) if feeds_steps(recording) else None
        if steps is not None:
            write_steps(steps.estimates, out / "contact_terrain.csv")
            scores["contact_terrain"] = steps.scores
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
            steps=steps,
            film=film,
        )
        (out / "report.html").write_text(render_report(story), encoding="utf-8")
        if rerun_installed():
            progress("rerun", 0.0)
            write_rerun(out / "run.rrd", recording, results)
        files = tuple(sorted(p.name for p in out.iterdir()))
    return Run(folder=folder, files=files, scores=scores)


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
