"""A random search for steps whose mode is predicted wrong with a high probability.

`python -m benchmarks.sure_and_wrong [--first 0] [--count 20] [--families turn ...] [--poses drawn|given|dvio] [--folder
DIR] [--json]`. Each seed draws a person, a gait with or without pauses, a camera, light, a way with turns, and the
ground: stairs, ramps and kerbs in any order. The predictor runs on the walk with the true poses or those of the
odometry. Printed are the share of the steps that are right, of those that are wrong with a probability above 0.9, and a
line for each of the latter. Parameters are tuned on seeds below 1000 alone. `--folder` keeps the recordings for the
next run.
"""

from __future__ import annotations

import math
import tempfile
from argparse import Namespace
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.outputs.modes.scores import ScoredMode
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Gait, Level, Ramp, Segment, Stairs, Turn, TwinConfig
from stridetwin.sim.faults.faults import Fault, FaultPlan
from stridetwin.sim.faults.image_faults import Darkness
from stridetwin.sim.faults.sample_faults import Dropout
from stridetwin.sim.parts.kinds import RgbdPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Sample
from stridetwin.studies.terrain_zoo.kinds import Rng, draw_base_walk
from stridetwin.studies.zhao2023.mode_walks import predict, samples_with_poses, score_predictions, sole_length_m

FAMILIES = ("turn", "pause", "narrow", "dark", "blind", "mixed")
"""What is special about a walk: turns beside stairs, pauses, a narrow noisy depth camera, images without light while
depth stays good, both without light, or some of them."""
SURE = 0.9
"""A prediction of a higher probability is a sure one."""
_NARROW = {"width": 640.0, "height": 483.0, "focal": 614.7}
"""Pixels of an image of 55 x 43 degrees."""
_TRIES = 50
"""Ways that are drawn at most: with turns, some lead over their own stairs."""
_NARROW_RANGE_M, _NARROW_NOISE = 4.0, 2.0
"""Range of the narrow camera, and its noise over that of the standard one."""


@dataclass(frozen=True, kw_only=True)
class SearchWalk:
    """A walk of the search.

    Attributes:
        family: One of `FAMILIES`.
        config: The walk.
        poses: `given` or `dvio`.
        dark_s: Begin and end of the time without light, s; equal if there is none.
        blind: Whether there is no depth in that time either.
    """

    family: str
    config: TwinConfig
    poses: str
    dark_s: tuple[float, float] = (0.0, 0.0)
    blind: bool = False

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Darkness, and no depth either if the walk is blind, in the time without light."""
        begin_s, end_s = self.dark_s
        if begin_s == end_s:
            return ()
        mount, lasts_s = self.config.rig_mount, end_s - begin_s
        dark = Darkness(topic=f"/{mount}/color", at_s=begin_s, duration_s=lasts_s)
        no_depth = Dropout(topic=f"/{mount}/depth", at_s=begin_s, duration_s=lasts_s)
        return (dark, no_depth) if self.blind else (dark,)


def draw_search_walk(family: str, seed: int) -> SearchWalk:
    """Draws a walk of a family; equal seeds give equal walks.

    Args:
        family: One of `FAMILIES`.
        seed: Of the walk.
    """
    rng = np.random.default_rng([seed, FAMILIES.index(family), 50])
    config = draw_base_walk(rng)
    special = set(rng.choice(FAMILIES[:4], 2, replace=False)) if family == "mixed" else {family}
    if "pause" in special:
        config = replace(config, gait=Gait.of_pattern("wander", gaze=config.gait.gaze))
    if "narrow" in special:
        camera = replace(config.fittings["head_camera"], part=narrow_camera())
        config = replace(config, fittings={**config.fittings, "head_camera": camera})
    config = replace(config, name=f"{family}_{seed}", physics="kinematic")
    config = _with_way(config, rng, turns="turn" in special)
    needs_dvio = bool(special & {"dark", "blind"})
    dark_s = (0.0, 0.0)
    if needs_dvio:
        begin_s = float(rng.uniform(0.3, 6.0))
        dark_s = (begin_s, begin_s + float(rng.uniform(3.0, 12.0)))
    poses = "dvio" if needs_dvio or rng.uniform() < 0.5 else "given"
    return SearchWalk(family=family, config=config, poses=poses, dark_s=dark_s, blind="blind" in special)


def narrow_camera() -> RgbdPart:
    """A depth camera of 55 x 43 degrees with a range of 4 m and twice the noise of the standard one."""
    part = load_part("D455")
    assert isinstance(part, RgbdPart)
    depth = replace(part.depth, noise=_NARROW_NOISE * part.depth.noise, range_max=_NARROW_RANGE_M)
    return replace(part, imager=replace(part.imager, **_NARROW), depth=depth)


def _with_way(config: TwinConfig, rng: Rng, *, turns: bool) -> TwinConfig:
    """The walk on the first drawn way that does not cross itself.

    Raises:
        ConfigError: None of `_TRIES` ways does.
    """
    for attempt in range(_TRIES):
        route = replace(config.route, segments=_draw_way(rng, turns=turns))
        try:
            lay_out(route)
        except ConfigError:
            if attempt == _TRIES - 1:
                raise
        else:
            break
    return replace(config, route=route)


def _draw_way(rng: Rng, *, turns: bool) -> tuple[Segment, ...]:
    """Draws level ground, up to two changes of the ground and, if asked for, turns shortly before them."""
    segments: list[Segment] = [Level(length_m=float(rng.uniform(1.5, 3.0)))]
    for _ in range(int(rng.integers(1, 3))):
        if turns:
            on_the_spot = bool(rng.integers(2))
            radius_m = 0.0 if on_the_spot else float(rng.uniform(1.0, 1.6))
            angle_rad = math.radians(float(rng.choice([-1, 1]) * rng.uniform(45, 120)))
            segments += [Turn(angle_rad=angle_rad, radius_m=radius_m), Level(length_m=float(rng.uniform(0.6, 1.6)))]
        segments += [_draw_change(rng), Level(length_m=float(rng.uniform(1.6, 3.0)))]
    return tuple(segments)


def _draw_change(rng: Rng) -> Segment:
    """Draws a stair of two to six risers, a kerb, or a ramp, up or down."""
    down = bool(rng.integers(2))
    kind = str(rng.choice(["stair", "stair", "stair", "kerb", "ramp"]))
    if kind == "ramp":
        angle = math.radians(float(rng.uniform(4.0, 12.0)))
        return Ramp(angle_rad=angle, rise_m=max(0.06, 3.0 * math.tan(angle)), down=down)
    risers = 1 if kind == "kerb" else int(rng.integers(2, 7))
    riser_m = 1e-3 * float(rng.uniform(100, 150) if kind == "kerb" else rng.uniform(130, 200))
    return Stairs(risers=risers, riser_m=riser_m, tread_m=1e-3 * float(rng.uniform(250, 340)), down=down)


class _FaultyRecording(Recording):
    """A recording of a walk, with the faults that the walk has."""

    def __init__(self, path: Path, walk: SearchWalk, seed: int) -> None:
        """Opens the file of a walk; the seed draws the noise of dark images."""
        super().__init__(path)
        self._plan = FaultPlan.of(walk.faults, self.rig, seed, self.duration)

    def samples(self, *arguments: Any, **keywords: Any) -> Iterator[Sample]:
        """Yields the samples in time order, as they arrive with the faults."""
        return self._plan.samples(super().samples(*arguments, **keywords))


def predict_walk(walk: SearchWalk, seed: int, folder: Path) -> list[ScoredMode]:
    """The scored steps of a walk, which is recorded if the folder lacks it.

    Args:
        walk: The walk.
        seed: Its seed.
        folder: Holds the recordings.
    """
    path = folder / f"{walk.config.name}.mcap"
    if not path.exists():
        record(Twin(walk.config, seed), path)
    recording = _FaultyRecording(path, walk, seed)
    samples = samples_with_poses(recording, walk.config.rig_mount, walk.poses)
    predictions = predict(samples, recording, ("proposed",))
    return score_predictions(predictions, recording, sole_length_m(walk.config))["proposed"].steps


def list_wrong_steps(steps: Iterable[ScoredMode]) -> list[dict[str, Any]]:
    """The steps with a wrong mode: time, true and predicted mode, and the probability of the predicted one."""
    return [
        {
            "t_s": step.t_s,
            "true": step.mode,
            "predicted": step.predicted,
            "probability": max(step.probabilities, default=0.0),
            "probabilities": dict(zip(MODES, step.probabilities)),
        }
        for step in steps
        if not step.is_correct
    ]


def measure(arguments: Namespace) -> dict[str, Any]:
    """Runs the walks of the command line; a row for each, and the figures over all of them."""
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(arguments.folder or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for seed in range(arguments.first, arguments.first + arguments.count):
            family = arguments.families[seed % len(arguments.families)]
            walk = draw_search_walk(family, seed)
            if arguments.poses != "drawn":
                walk = replace(walk, poses=arguments.poses)
            steps = predict_walk(walk, seed, folder)
            rows.append(
                {
                    "seed": seed,
                    "family": family,
                    "poses": walk.poses,
                    "steps": len(steps),
                    "wrong": list_wrong_steps(steps),
                }
            )
            if not arguments.json:
                _show_row(rows[-1])
    return {"walks": rows, "summary": summarise(rows)}


def summarise(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Steps, the share of them that are right, the share that are wrong and sure, and the least share of a walk, %."""
    steps = sum(row["steps"] for row in rows)
    wrong = [step for row in rows for step in row["wrong"]]
    sure = sum(step["probability"] > SURE for step in wrong)
    worst = min((1.0 - len(row["wrong"]) / row["steps"] for row in rows if row["steps"]), default=math.nan)
    return {
        "walks": len(rows),
        "steps": steps,
        "right_pct": 100.0 * (1.0 - len(wrong) / max(steps, 1)),
        "sure_and_wrong_pct": 100.0 * sure / max(steps, 1),
        "worst_walk_pct": 100.0 * worst,
    }


def _show_row(row: dict[str, Any]) -> None:
    """Prints a walk, and its wrong steps."""
    counts = f"{row['steps']:4} steps, wrong {len(row['wrong'])}"
    print(f"{row['seed']:5} {row['family']:7} {row['poses']:6} {counts}", flush=True)
    for step in row["wrong"]:
        predicted = step["predicted"] or "-"
        print(f"      {step['t_s']:6.2f} s {step['true']} predicted {predicted} p {step['probability']:.2f}")


def show(figures: dict[str, Any]) -> None:
    """Prints the figures over all walks."""
    for name, value in figures["summary"].items():
        print(f"{name:20} {value:.2f}")


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--first", type=int, default=0, help="seed of the first walk")
    parser.add_argument("--count", type=int, default=20, help="number of walks")
    parser.add_argument(
        "--families", nargs="+", default=FAMILIES, choices=FAMILIES, help="take turns from seed to seed"
    )
    parser.add_argument("--poses", default="drawn", choices=("drawn", "given", "dvio"))
    parser.add_argument("--folder", help="keep the recordings here")
    raise SystemExit(answer(parser, measure, show))
