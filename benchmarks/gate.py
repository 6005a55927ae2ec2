"""Sensitivity of the gate: it must detect injected regressions on the same walks, and pass unchanged code on new ones.

`python -m benchmarks.gate [--seed 1000] [--walks 30] [--fresh 20] [--group 15] [--folder runs/gate] [--json]` generates
walks of ten seconds without cameras (`benchmarks.speed.campaign`) from this seed on, scores `foot_ins` and
`contact_terrain` on them as they are, and

- with each of `REGRESSIONS` on the same `--walks` walks: a regression is detected if the gate calls its estimator
  worse. Its size is measured by the composite of its errors, and by their means, over these walks.
- unchanged on `--fresh` groups of `--group` other walks: anything that the gate calls worse is a false alarm.

The widest 95 % interval of a relative change over all of these comparisons is given as the factor between its ends.

Walks and scores stay in the folder and are reused by the next run.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from benchmarks.speed.campaign import write_campaign
from stridetwin.estimators import foot_ins
from stridetwin.estimators.base import Options
from stridetwin.estimators.contact_terrain import ContactTerrain
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.gate.compare import Comparison, Rules, compare_scores
from stridetwin.gate.metric_policy import OVERALL
from stridetwin.gate.score_table import ScoreTable, document_of, mean_scores, table_of
from stridetwin.outputs.feeding import instance_for
from stridetwin.outputs.path.evaluate import evaluate
from stridetwin.outputs.steps.kind import Steps
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate
from stridetwin.scenarios.campaign.walk import ACCEPTED
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Ahrs, Block, Encoder, Sample

FOOT, STEPS = "foot_ins", "contact_terrain"
Columns = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Regression:
    """A regression of an estimator.

    Attributes:
        name: Short description.
        estimator: FOOT or STEPS.
        imu: Changes the columns of a foot's IMU, possibly in place.
        sample: Changes a sample of the exoskeleton.
        parameters: Factors of the filter's parameters.
        source: A line of the filter's sources, and its replacement.
    """

    name: str
    estimator: str = FOOT
    imu: Callable[[Columns, np.random.Generator], None] | None = None
    sample: Callable[[Sample, np.random.Generator], Sample] | None = None
    parameters: Mapping[str, float] | None = None
    source: tuple[str, str, str] | None = None


def noise(column: str, sd: float) -> Callable[[Columns, np.random.Generator], None]:
    def act(columns: Columns, rng: np.random.Generator) -> None:
        columns[column] += rng.normal(0.0, sd, columns[column].shape)

    return act


def drift(column: str, *end: float) -> Callable[[Columns, np.random.Generator], None]:
    """Adds a bias that grows over the walk."""

    def act(columns: Columns, rng: np.random.Generator) -> None:
        columns[column] += np.linspace(0.0, 1.0, len(columns[column]))[:, None] * np.array(end)

    return act


def scale(column: str, factor: float) -> Callable[[Columns, np.random.Generator], None]:
    def act(columns: Columns, rng: np.random.Generator) -> None:
        columns[column] *= factor

    return act


def late(column: str, share: float) -> Callable[[Columns, np.random.Generator], None]:
    """Delays a column by a share of a sample."""

    def act(columns: Columns, rng: np.random.Generator) -> None:
        x = columns[column]
        x[1:] = (1.0 - share) * x[1:] + share * x[:-1].copy()

    return act


def rounded(column: str, step: float) -> Callable[[Columns, np.random.Generator], None]:
    def act(columns: Columns, rng: np.random.Generator) -> None:
        columns[column] = np.round(columns[column] / step) * step

    return act


def held(share: float) -> Callable[[Columns, np.random.Generator], None]:
    """Replaces some samples by the previous ones."""

    def act(columns: Columns, rng: np.random.Generator) -> None:
        again = np.flatnonzero(rng.random(len(columns["angular_rate"])) < share)
        again = again[again > 0]
        for x in columns.values():
            x[again] = x[again - 1]

    return act


def limited(column: str, most: float) -> Callable[[Columns, np.random.Generator], None]:
    def act(columns: Columns, rng: np.random.Generator) -> None:
        np.clip(columns[column], -most, most, out=columns[column])

    return act


def knee(offset: float = 0.0, sd: float = 0.0, factor: float = 1.0) -> Callable[[Sample, np.random.Generator], Sample]:
    def act(sample: Sample, rng: np.random.Generator) -> Sample:
        if not isinstance(sample, Encoder):
            return sample
        return replace(sample, angle=factor * sample.angle + offset + float(rng.normal(0.0, sd) if sd else 0.0))

    return act


def turning(factor: float) -> Callable[[Sample, np.random.Generator], Sample]:
    def act(sample: Sample, rng: np.random.Generator) -> Sample:
        return replace(sample, angular_rate=factor * sample.angular_rate) if isinstance(sample, Ahrs) else sample

    return act


GYRO, FORCE = "angular_rate", "specific_force"
REGRESSIONS = (
    Regression(name="gyro noise", imu=noise(GYRO, 0.015)),
    Regression(name="force noise", imu=noise(FORCE, 0.04)),
    Regression(name="gyro coarse", imu=rounded(GYRO, 0.018)),
    Regression(name="force coarse", imu=rounded(FORCE, 0.15)),
    Regression(name="gyro bias drifts", imu=drift(GYRO, 0.0, 0.016, 0.016)),
    Regression(name="gyro scale", imu=scale(GYRO, 1.01)),
    Regression(name="force scale", imu=scale(FORCE, 1.01)),
    Regression(name="gyro late", imu=late(GYRO, 0.5)),
    Regression(name="force late", imu=late(FORCE, 0.5)),
    Regression(name="force clipped", imu=limited(FORCE, 47.0)),
    Regression(name="samples held", imu=held(0.015)),
    Regression(name="stands too rarely", parameters={"stationary_level": 0.6, "stationary_share": 0.6}),
    Regression(name="trusts standing too little", parameters={"stationary_speed_mps": 2.3}),
    Regression(name="trusts standing too much", parameters={"stationary_speed_mps": 0.2}),
    Regression(name="trusts standing too often", parameters={"stationary_correlation_s": 0.1}),
    Regression(name="contact wanders too little", parameters={"contact_sd_m": 0.2}),
    Regression(name="trusts the gyro too little", parameters={"gyro_noise_radps_rthz": 6.0}),
    Regression(
        name="trusts the force too much",
        parameters={"accel_motion_noise_per_rthz": 0.35, "accel_jerk_noise_s_rthz": 0.35},
    ),
    Regression(name="rests too rarely", parameters={"rest_level": 0.55}),
    Regression(name="lever arm of the wrong sign", parameters={"lever_arm_m": -0.1}),
    Regression(
        name="Jacobian of the contact of the wrong sign",
        source=(
            "stance.py",
            "D_CONTACT + i, matvec(whitening, cross(w, axes[i])",
            "D_CONTACT + i, matvec(whitening, cross(axes[i], w)",
        ),
    ),
    Regression(name="knee off", estimator=STEPS, sample=knee(offset=0.006)),
    Regression(name="knee noise", estimator=STEPS, sample=knee(sd=0.012)),
    Regression(name="knee scale", estimator=STEPS, sample=knee(factor=1.01)),
    Regression(name="rates too small", estimator=STEPS, sample=turning(0.998)),
)


class Spoilt:
    """A recording with some samples replaced."""

    def __init__(self, recording: Recording, how: Regression) -> None:
        self._recording, self._how = recording, how

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def block(self, topic: str) -> Block[Any]:
        """A topic's samples."""
        block = self._recording.block(topic)
        if self._how.imu is None or topic.startswith("/truth/"):
            return block
        columns = {name: column.copy() for name, column in block.columns.items()}
        self._how.imu(columns, np.random.default_rng([len(block), *topic.encode()]))
        return replace(block, columns=columns)

    def samples(self, topics: Iterable[str]) -> Iterator[Sample]:
        """Samples of some topics."""
        rng = np.random.default_rng(1)
        for sample in self._recording.samples(topics):
            yield sample if self._how.sample is None else self._how.sample(sample, rng)


def injected(how: Regression) -> type[FootIns]:
    """The filter of one foot, with the regression."""
    kind: Any = FootIns if how.source is None else _mutant(how)

    class Injected(kind):  # type: ignore[misc]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            for name, factor in (how.parameters or {}).items():
                value = getattr(self._parameters, name)
                self._parameters = self._parameters.copy()
                self._parameters[name] = factor * value

    return Injected


_FOLDER = Path(tempfile.gettempdir()) / "stridetwin-gate-mutants"


def _mutant(how: Regression) -> Any:
    """The filter with one line of its sources changed: a package of its own, compiled in its folder."""
    assert how.source is not None
    name = "mutant_" + re.sub(r"\W", "_", how.name)
    folder = _FOLDER / name
    file, old, new = how.source
    origin = Path(str(foot_ins.__file__)).parent
    folder.mkdir(parents=True, exist_ok=True)
    for source in origin.glob("*.py"):
        text = source.read_text().replace("stridetwin.estimators.foot_ins", name)
        if source.name == file:
            assert text.count(old) == 1, f"{file} no longer has {old!r}"
            text = text.replace(old, new)
        place = folder / source.name
        if not place.is_file() or place.read_text() != text:
            place.write_text(text)
    if str(_FOLDER) not in sys.path:
        sys.path.insert(0, str(_FOLDER))
    return import_module(name).FootIns


def scores_of(path: Path, how: Regression | None, cached: dict[Path, Recording]) -> dict[str, dict[str, float]]:
    """Scores of the estimators on a walk; with a regression, only those of the affected estimator."""
    if path not in cached:
        cached.clear()
        cached[path] = Recording(path)
    asked: Any = cached[path] if how is None else Spoilt(cached[path], how)
    scores: dict[str, dict[str, float]] = {}
    if how is None or how.estimator == FOOT:
        kind = injected(how or Regression(name="none"))
        estimates = [estimate for foot in "lr" for estimate in kind.follow(asked, Options(foot=foot))]
        scores = {r.estimate.name: r.scores for r in evaluate(cached[path], estimates)}
    if how is None or how.estimator == STEPS:
        (output,) = Steps().run(instance_for(ContactTerrain, asked), asked)
        scores[STEPS] = Steps().evaluate([output], asked)[0].scores
    return scores


def table(paths: Sequence[Path], how: Regression | None, folder: Path) -> list[dict[str, Any]]:
    """Rows of `score --json`; those in the folder are reused."""
    name = "as_it_is" if how is None else re.sub(r"\W", "_", f"{how.name}")
    file = folder / "scores" / f"{name}.jsonl"
    file.parent.mkdir(exist_ok=True)
    there = {}
    if file.is_file():
        there = {row["name"]: row for row in map(json.loads, file.read_text().splitlines())}
    cached: dict[Path, Recording] = {}
    for path in paths:
        key = f"{path.parents[1].name}/{path.stem}"
        if key not in there:
            there[key] = {"name": key, "sha256": key, "estimators": scores_of(path, how, cached)}
            with file.open("a") as out:
                out.write(json.dumps(there[key]) + "\n")
    return [there[f"{path.parents[1].name}/{path.stem}"] for path in paths]


def as_table(rows: Sequence[dict[str, Any]], names: Iterable[str] | None = None) -> ScoreTable:
    rows = [
        {**row, "estimators": {n: s for n, s in row["estimators"].items() if names is None or n in names}}
        for row in rows
    ]
    return table_of(document_of(rows, mean_scores(row["estimators"] for row in rows)), "")


def walks(folder: Path, seed: int, count: int) -> list[Path]:
    """Recordings of the given number of accepted walks of a campaign with a seed; existing ones are reused."""
    (folder / "campaign").mkdir(parents=True, exist_ok=True)
    options = CampaignOptions(folder=folder / f"walks_{seed}", subset=count, seed=seed)
    done = generate(write_campaign(folder / "campaign"), options, lambda *_: None)
    return [options.folder / w["recording"] for w in done.manifest["walks"] if w["status"] == ACCEPTED]


def measure(arguments: Namespace) -> dict[str, Any]:
    """Detected regressions and false alarms."""
    folder, rules = arguments.folder, Rules()
    same = walks(folder, arguments.seed, arguments.walks)
    as_it_is = table(same, None, folder)
    cases: list[dict[str, Any]] = []
    widest = 1.0
    for how in REGRESSIONS:
        comparison = _against(as_it_is, table(same, how, folder), rules)
        widest = max(widest, _widest(comparison))
        (size,) = (line for line in comparison.lines if line.metric == OVERALL)
        cases.append(
            {
                "injected": how.name,
                "estimator": how.estimator,
                "found": bool(comparison.regressions),
                "overall_pct": size.change,
                "interval_pct": [size.low, size.high],
                "by": [f"{line.metric} {line.change:+.1f}" for line in comparison.regressions],
            }
        )
    summary: dict[str, dict[str, float]] = {
        "injected": {
            "regressions": len(cases),
            "walks": len(same),
            "found": sum(case["found"] for case in cases),
        }
    }
    fresh = walks(folder, arguments.seed + 1, arguments.fresh * arguments.group) if arguments.fresh else []
    groups = [fresh[i : i + arguments.group] for i in range(0, len(fresh) - arguments.group + 1, arguments.group)]
    comparisons = [_against(as_it_is, table(group, None, folder), rules) for group in groups]
    summary["intervals"] = {"widest_factor": max([widest, *map(_widest, comparisons)])}
    alarms = [comparison.regressions for comparison in comparisons]
    if groups:
        summary["unchanged"] = {
            "groups": len(groups),
            "walks": arguments.group,
            "alarms": sum(map(bool, alarms)),
        }
        shown = [[f"{line.estimator} {line.metric}" for line in worse_lines] for worse_lines in alarms]
        cases.append({"unchanged": shown})
    return {"experiment": "gate", "summary": summary, "paper": {}, "cases": cases}


def _widest(comparison: Comparison) -> float:
    """The largest factor between the ends of a relative change's interval."""
    ends = [(line.low, line.high) for line in comparison.lines if not line.in_points]
    return max(
        ((100.0 + high) / (100.0 + low) for low, high in ends if low is not None and high is not None), default=1.0
    )


def _against(baseline: Sequence[dict[str, Any]], now: Sequence[dict[str, Any]], rules: Rules) -> Comparison:
    names = {name for row in now for name in row["estimators"]}
    return compare_scores(as_table(now), as_table(baseline, names), rules)


def show(result: dict[str, Any]) -> None:
    """Prints the figures."""
    for case in result["cases"]:
        if "injected" in case:
            low, high = case["interval_pct"]
            outcome = "found    " if case["found"] else "NOT FOUND"
            shown = f"{case['overall_pct']:+6.1f} % ({low:+.1f} to {high:+.1f})"
            print(f"{case['injected']:<42}{outcome} {shown:<28}", "; ".join(case["by"]))
        else:
            print(*(f"fresh walks, false alarms: {'; '.join(shown)}" for shown in case["unchanged"] if shown), sep="\n")
    for name, figures in result["summary"].items():
        print(name, *(f"{key} {value:g}" for key, value in figures.items()), sep=", ")


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the baseline's campaign; the next: fresh walks"
    )
    parser.add_argument("--walks", type=int, default=30, metavar="N", help="walks of baseline and of each regression")
    parser.add_argument("--fresh", type=int, default=20, metavar="N", help="groups of fresh walks")
    parser.add_argument("--group", type=int, default=30, metavar="N", help="walks of a fresh group")
    parser.add_argument("--folder", type=Path, default=Path("runs/gate"), metavar="DIR", help="walks and scores")
    sys.exit(answer(parser, measure, show))
