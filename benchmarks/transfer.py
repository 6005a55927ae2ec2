"""Does a verdict on the twin hold on people? Variants of the foot INS and published detectors, ranked on both.

`python -m benchmarks.transfer [--json] [--cache DIR] [--workers 2] [--seed 1] [--walks 30] [--causes] [--data DIR]`.
People: the walks of `foot_imu_vicon`, or those in the folder of `--data`. Twin: the campaign in
`benchmarks/transfer_walks`, one foot of each walk in turn. The filter gets no calibration on either side, and the
score is pyshoe's 2-D ARMSE. docs/transfer.md has the method. Walks with seeds below 1000 (`--seed 0`) are for work on
the twin; those of `--seed 1` and above judge it.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from benchmarks import real_walks
from benchmarks.command import answer, command
from benchmarks.foot_ins_twin import join_blocks
from stridetwin.batch.processes import open_pool
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters, ZeroVelocityDetector
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.campaign.campaign_file import read_campaign
from stridetwin.scenarios.campaign.named_files import SCENARIOS, copy_files
from stridetwin.scenarios.campaign.plan import Extra, PlannedWalk, plan_walks
from stridetwin.scenarios.campaign.walk import walk_versions
from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array, Block, Imu

CAMPAIGN = Path(__file__).parent / "transfer_walks" / "campaign.yaml"
FEET = ("l", "r")  # of the walks in turn
BASE = "base"
CHANGED = 0.05  # a change of more than this share counts
_FACTORS = {
    "lever_arm_m": (0.0, 1.5),
    "contact_sd_m": (0.0,),
    "lever_sd_m": (0.0,),
    "stationary_speed_mps": (0.1, 10.0, 100.0),
    "stationary_level": (0.1, 0.3, 3.0, 10.0),
    "stationary_share": (0.1, 10.0),
    "gyro_noise_radps_rthz": (0.2, 5.0),
    "accel_noise_mps2_rthz": (0.1, 10.0),
    "accel_motion_noise_per_rthz": (0.0, 5.0),
    "accel_jerk_noise_s_rthz": (0.0,),
    "stationary_correlation_s": (10.0,),
    "window_s": (3.0, 8.0),
    "rest_level": (0.0,),
    "gyro_bias_sd_radps": (10.0, 0.1),
    "innovation_gate": (10.0,),
    "path_scale_sd": (0.0,),
}
_VALUES: dict[str, dict[str, float]] = {
    "no limits": {"limit_share": 1.0, "clipped_share": 1.0, "impact_excess": 0.0},
    "stationary_power = 1": {"stationary_power": 1.0},
}
_THRESHOLDS = {  # within the ranges in which pyshoe searches the best one for each walk
    "shoe": (1e7, 3e7, 8.5e7, 2e8, 5e8),
    "ared": (0.1, 0.25, 0.55, 1.0, 2.0),
    "amvd": (0.1, 0.3, 1.0, 2.0),
    "mbgtd": (0.1, 0.3, 1.0),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class FootWalk:
    """Samples of one foot, and the true path (N, 3) m of its sensor at their times."""

    name: str
    imu: Block[Imu]
    truth: Array


Filter = Callable[[], FootIns]


def our_variants() -> dict[str, Filter]:
    """31 sets of parameters of the foot INS, the present one first."""
    usual = FootInsParameters()
    variants: dict[str, FootInsParameters] = {BASE: usual}
    for name, factors in _FACTORS.items():
        for factor in factors:
            variants[f"{name} x {factor:g}"] = replace(usual, **{name: factor * getattr(usual, name)})
    variants |= {name: replace(usual, **values) for name, values in _VALUES.items()}
    return {name: partial(FootIns, parameters=parameters) for name, parameters in variants.items()}


def published_variants() -> dict[str, Filter]:
    """The published detectors at a range of thresholds, in the filter of nine states."""
    return {
        f"{method} < {threshold:g}": partial(FootIns, detector=ZeroVelocityDetector(method=method, threshold=threshold))
        for method, thresholds in _THRESHOLDS.items()
        for threshold in thresholds
    }


def reference_of(variant: str) -> str:
    """The variant that a change is measured from: ours, or the published detector at its usual threshold."""
    method = variant.partition(" < ")[0]
    if method not in _THRESHOLDS:
        return BASE
    return f"{method} < {ZeroVelocityDetector(method=method).level:g}"


def score_walks(make_filter: Filter, walks: Iterable[FootWalk]) -> list[float]:
    """2-D ARMSE of a filter on each walk, m."""
    return [real_walks.armse(make_filter().run(w.imu).trajectory.p_frame_in_world, w.truth) for w in walks]


def people_walks(folder: Path) -> list[FootWalk]:
    """The recorded walks in `foot_imu_vicon` of a folder, or in the folder itself."""
    inside = folder if (folder / "foot_imu_vicon").is_dir() else folder.parent
    name = "foot_imu_vicon" if inside == folder else folder.name
    return [FootWalk(name=w.name, imu=w.imu, truth=w.truth) for w in real_walks.load_vicon(inside, name)]


def _without_errors(config: TwinConfig) -> TwinConfig:
    return _with_foot_imu(config, ideal=True)


def _with_foot_imu(config: TwinConfig, **changes: Any) -> TwinConfig:
    """The configuration with another foot IMU."""
    fitted = replace(config.fittings.get("foot_imu", SensorConfig()), **changes)
    return replace(config, fittings={**config.fittings, "foot_imu": fitted})


CAUSES: dict[str, Callable[[TwinConfig], TwinConfig]] = {
    "ideal sensor": _without_errors,
    "consumer parts": lambda config: _with_foot_imu(config, population="consumer"),
    "rigid shoe": lambda config: replace(config, shock=False),
    "ideal sensor, rigid shoe": lambda config: replace(_without_errors(config), shock=False),
    "sensor at the heel": lambda config: _with_foot_imu(config, position_m=(-0.030, 0.042, 0.060)),
    "sensor at the instep": lambda config: _with_foot_imu(config, position_m=(0.110, 0.0, 0.085)),
}
"""What is replaced on the twin, one thing at a time; motion and seeds stay."""


def simulate(planned: PlannedWalk, foot: str, folder: Path, change: Callable[[TwinConfig], TwinConfig]) -> FootWalk:
    """One foot of a planned walk.

    Args:
        planned: The walk.
        foot: `l` or `r`.
        folder: Of the campaign's own files.
        change: What is replaced in its configuration.
    """
    config = scenario_of(planned.scenario, folder / SCENARIOS / f"{planned.name}.yaml").config
    twin = Twin(change(replace(config, sensors=("foot_imu",))), planned.seed)
    chunks = [{b.topic: b for b in chunk if isinstance(b, Block)} for chunk in twin.blocks()]
    topic = f"/foot_{foot}/imu"
    imu, odometry = (join_blocks([c[name] for c in chunks]) for name in (topic, f"/truth{topic}/odometry"))
    path = TruePath.of(odometry)
    truth = np.column_stack([np.interp(imu.t_ns, path.t_ns, path.p_frame_in_world[:, i]) for i in range(3)])
    return FootWalk(name=planned.name, imu=imu, truth=truth)


def twin_walk(job: tuple[PlannedWalk, str], cause: str, cache: Path | None) -> FootWalk:
    """One foot of a planned walk, from the cache if it has this walk of this code.

    Args:
        job: The walk, and `l` or `r`.
        cause: Of `CAUSES`; "" for the walk as planned.
        cache: Folder of simulated walks; None simulates it.
    """
    planned, foot = job
    described = [planned.scenario, planned.seed, foot, cause, sorted(walk_versions().items()), _files_text()]
    digest = hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]
    file = None if cache is None else cache / f"{planned.name}_{digest}.npz"
    if file is not None and file.is_file():
        with np.load(file) as stored:
            imu = real_walks.imu_block(stored["t_ns"] * 1e-9, stored["rate"], stored["force"])
            return FootWalk(name=planned.name, imu=replace(imu, t_ns=stored["t_ns"]), truth=stored["truth"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / SCENARIOS).mkdir()
        copy_files(folder, read_campaign(CAMPAIGN).user_files)
        walk = simulate(planned, foot, folder, CAUSES.get(cause, lambda config: config))
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        rate, force = walk.imu.columns["angular_rate"], walk.imu.columns["specific_force"]
        np.savez(file, t_ns=walk.imu.t_ns, rate=rate, force=force, truth=walk.truth)
    return walk


def _files_text() -> str:
    """Contents of the campaign's own files, which the scenarios only name."""
    return "".join(path.read_text(encoding="utf-8") for path in sorted(CAMPAIGN.parent.glob("*.yaml")))


def rank_correlation(people: Mapping[str, float], twin: Mapping[str, float]) -> float:
    """Spearman's rank correlation over the variants of the first."""
    return float(spearmanr([*people.values()], [twin[name] for name in people])[0])


def count_signs(people: Mapping[str, float], twin: Mapping[str, float]) -> tuple[int, int]:
    """Changes of more than `CHANGED` on people, and how many of them go the same way on the twin."""
    changed = same = 0
    for variant, error in people.items():
        reference = reference_of(variant)
        on_people, on_twin = error / people[reference] - 1.0, twin[variant] / twin[reference] - 1.0
        if variant != reference and abs(on_people) > CHANGED:
            changed += 1
            same += on_people * on_twin > 0.0
    return changed, same


def compare_sides(people: Mapping[str, Sequence[float]], twin: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Level, rank and signs of all variants of people beside those of the twin.

    Args:
        people: 2-D ARMSE of each walk by variant, m.
        twin: Likewise.
    """
    groups = {"ours": [v for v in people if reference_of(v) == BASE]}
    groups |= {"published": [v for v in people if v not in groups["ours"]], "all": [*people]}
    figures: dict[str, Any] = {"level": {}, "rank": {}, "signs": {}}
    usual = [v for v in people if v == reference_of(v)]
    for how, value in (("mean", np.mean), ("median", np.median)):
        of_people = {v: float(value(e)) for v, e in people.items()}
        of_twin = {v: float(value(e)) for v, e in twin.items()}
        figures["level"][how] = {v: of_twin[v] / of_people[v] for v in usual}
        for group, names in groups.items():
            ours, theirs = {v: of_people[v] for v in names}, {v: of_twin[v] for v in names}
            figures["rank"][f"{group}, {how}s"] = rank_correlation(ours, theirs)
            figures["signs"][f"{group}, {how}s"] = count_signs(ours, theirs)
    return figures


def compare_halves(people: Mapping[str, Sequence[float]], rounds: int = 200) -> dict[str, float]:
    """How well people tell of other people: rank and share of equal signs of random halves of the walks, in the mean.

    More than that cannot be asked of a twin that is compared with as few walks as a half has.

    Args:
        people: 2-D ARMSE of each walk by variant, m.
        rounds: How often the walks are divided.
    """
    rng, count = np.random.default_rng(0), len(next(iter(people.values())))
    each: dict[str, list[float]] = {}
    for _ in range(rounds):
        order = rng.permutation(count)
        one, other = ({v: [e[i] for i in rows] for v, e in people.items()} for rows in np.array_split(order, 2))
        figures = compare_sides(one, other)
        for name, rho in figures["rank"].items():
            each.setdefault(f"rank, {name}", []).append(rho)
        for name, (changed, same) in figures["signs"].items():
            each.setdefault(f"signs, {name}", []).append(same / max(changed, 1))
    return {name: float(np.mean(values)) for name, values in each.items()}


def recorded_walks(arguments: Namespace) -> list[FootWalk]:
    """The recorded walks that the arguments of `parser_of_walks` name.

    Raises:
        StrideTwinError: There are none.
    """
    folder = Path(arguments.data) if arguments.data else real_walks.data_folder()
    if folder is None:
        raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds foot_imu_vicon")
    return people_walks(folder)


def twin_jobs(seed: int, walks: int) -> list[tuple[PlannedWalk, str]]:
    """The first walks of the campaign with a seed, and the foot that is simulated of each."""
    campaign = replace(read_campaign(CAMPAIGN), seed=seed, walks=walks)
    return [(planned, FEET[i % 2]) for i, planned in enumerate(plan_walks(campaign, Extra()))]


@contextmanager
def workers(arguments: Namespace) -> Iterator[Callable[..., Iterable[Any]]]:
    """`map`, over as many processes as the arguments of `parser_of_walks` say."""
    if arguments.workers == 1:
        yield map
        return
    with open_pool(arguments.workers) as pool:
        yield pool.map


def measure(arguments: Namespace) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    recorded, jobs = recorded_walks(arguments), twin_jobs(arguments.seed, arguments.walks)
    variants = our_variants() | published_variants()
    causes = ("", *CAUSES) if arguments.causes else ("",)
    with workers(arguments) as run:
        twins = {c: [*run(partial(twin_walk, cause=c, cache=arguments.cache), jobs)] for c in causes}
        people = dict(zip(variants, run(partial(score_walks, walks=recorded), variants.values())))
        rows, summary = {}, {}
        for cause, walks in twins.items():
            errors = dict(zip(variants, run(partial(score_walks, walks=walks), variants.values())))
            summary[cause or "twin"] = compare_sides(people, errors)
            rows[cause or "twin"] = errors
    cases = [
        {"variant": v, "people_m": _mean_and_median(people[v])}
        | {f"{cause}_m": _mean_and_median(errors[v]) for cause, errors in rows.items()}
        for v in variants
    ]
    halves = compare_halves(people)
    return {"experiment": "transfer", "summary": summary, "halves": halves, "paper": {}, "cases": cases}


def _mean_and_median(errors: Sequence[float]) -> tuple[float, float]:
    return float(np.mean(errors)), float(np.median(errors))


def show(result: dict[str, Any]) -> None:
    """Prints one row per variant, mean and median of each side in m, and the verdict below."""
    sides = [key for key in result["cases"][0] if key != "variant"]
    print(f"{'2-D ARMSE, mean and median, m':36}" + "".join(f"{side.removesuffix('_m'):>26}" for side in sides))
    for case in result["cases"]:
        cells = "".join(f"{case[side][0]:>17.4f} {case[side][1]:8.4f}" for side in sides)
        print(f"{case['variant']:36}{cells}")
    for cause, figures in result["summary"].items():
        print(f"\n{cause}")
        for how, levels in figures["level"].items():
            text = ", ".join(f"{variant} {ratio:.2f}" for variant, ratio in levels.items())
            print(f"  level ({how}s), twin over people: {text}")
        print("  rank correlation: " + ", ".join(f"{group} {rho:.2f}" for group, rho in figures["rank"].items()))
        signs = ", ".join(f"{group} {same} of {changed}" for group, (changed, same) in figures["signs"].items())
        print(f"  changes above {CHANGED:.0%} with the same sign: {signs}")
    halves = ", ".join(f"{name} {value:.2f}" for name, value in result["halves"].items())
    print(f"\npeople beside other people (random halves of the walks): {halves}")


def parser_of_walks(doc: str | None) -> ArgumentParser:
    """The command line of a benchmark on the recorded walks and on those of the campaign."""
    parser = command(doc)
    parser.add_argument("--cache", type=Path, help="folder that keeps the simulated samples")
    parser.add_argument("--workers", type=int, choices=(1, 2), default=1, help="processes")
    parser.add_argument("--seed", type=int, default=1, help="of the campaign; 0 for work on the twin")
    parser.add_argument("--walks", type=int, default=30, help="of the twin")
    parser.add_argument("--data", help="folder of other recorded walks, or that holds foot_imu_vicon")
    return parser


def main() -> int:
    """Command line."""
    parser = parser_of_walks(__doc__)
    parser.add_argument("--causes", action="store_true", help="also replace one thing at a time on the twin")
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
