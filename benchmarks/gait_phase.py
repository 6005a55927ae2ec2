"""Gait phase from one foot IMU on twin walks of many people, speeds and terrains, and its speed.

`python -m benchmarks.gait_phase [--json] [--seeds FIRST COUNT] [--physics kinematic|dynamic] [--terrains level ...]`.
Each terrain is walked once per seed; the seed draws the person, the pace, the manner of walking, the terrain's
dimensions, and the sensor with its mount. Both legs are scored (`evaluation/phase_scores.py`). Errors are RMS over all
samples of all walks.

With `--real` it reads recorded walks (`real_walks`): strides between detected touch-downs stand for the true ones
there, and the markers of `dual_foot_walk` check the touch-downs.
"""

from __future__ import annotations

import math
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command, show_summary
from benchmarks.real_walks import MarkerWalk, data_folder, imu_block, load_loop, load_markers, load_stairs, load_vicon
from stridetwin.estimators.base import Options
from stridetwin.estimators.gait_phase import GaitPhase, GaitPhaseParameters, PhaseEstimate
from stridetwin.outputs.gait_phase.scores import (
    LONGEST_STRIDE_S,
    LONGEST_STRIDE_SHARE,
    PhaseSeries,
    Stride,
    find_touch_downs,
    match_touch_downs,
    phase_errors,
    phase_scores,
    to_phase_series,
    true_strides,
)
from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Footprint, Imu

TERRAINS = ("level", "turns", "stairs", "ramps", "mixed")
SEEDS = (1000, 20)
FEET = ("l", "r")
_STREAM = 77  # of random numbers, so that these walks are of no other benchmark
_REST_RADPS, _SWING_MPS, _LANDED_MPS = 0.3, 2.0, 0.6
_MIN_TOUCH_DOWNS = 4
_GROUPS = ("steady", "level", "ramp", "stairs", "all")


@dataclass(frozen=True, kw_only=True, eq=False)
class FootWalk:
    """One foot in one walk: its rig, its samples, and its true strides."""

    foot: str
    rig: Rig
    imu: Block[Imu]
    strides: list[Stride]


def draw_terrain(rng: np.random.Generator, name: str) -> list[dict[str, Any]]:
    """Terrain of a scenario file with random dimensions, one of `TERRAINS`."""

    def level(shortest_m: float, longest_m: float) -> dict[str, Any]:
        return {"level": {"length_m": round(float(rng.uniform(shortest_m, longest_m)), 1)}}

    def stairs(direction: str) -> dict[str, Any]:
        risers, riser_mm, tread_mm = int(rng.integers(3, 9)), int(rng.uniform(130, 190)), int(rng.uniform(260, 340))
        return {"stairs": {"risers": risers, "riser_mm": riser_mm, "tread_mm": tread_mm, "direction": direction}}

    def ramp(direction: str) -> dict[str, Any]:
        angle_deg, rise_m = round(float(rng.uniform(4, 14)), 1), round(float(rng.uniform(0.3, 0.8)), 2)
        return {"ramp": {"angle_deg": angle_deg, "rise_m": rise_m, "direction": direction}}

    def turn(angle_deg: float, radius_m: float) -> dict[str, Any]:
        return {"turn": {"angle_deg": angle_deg, "radius_m": radius_m}}

    if name == "level":
        return [level(10, 25)]
    if name == "turns":
        return [level(3, 6), turn(-90, 3), level(2, 5), turn(90, 1.5), level(3, 6)]
    if name in ("stairs", "ramps"):
        climb, landing_m = (stairs, (1.5, 4)) if name == "stairs" else (ramp, (2, 4))
        segments = [climb("up"), level(*landing_m), climb("down")]
        if rng.random() < 0.3:
            segments.reverse()
        return [level(3, 6), *segments, level(3, 6)]
    return [
        level(3, 6),
        stairs("up"),
        level(2, 4),
        ramp("down"),
        level(3, 5),
        ramp("up"),
        level(2, 4),
        stairs("down"),
        level(3, 5),
    ]


def draw_walk(terrain: str, seed: int, physics: str = "kinematic") -> dict[str, Any]:
    """A scenario file of one random person on one kind of terrain: 0.5 to 1.9 m/s, with the foot IMUs alone."""
    rng = np.random.default_rng([_STREAM, seed])
    sex = ("male", "female")[int(rng.integers(2))]
    height_m = float(np.clip(rng.normal(1.77 if sex == "male" else 1.64, 0.07), 1.52, 1.93))
    bmi = float(np.clip(rng.normal(24.5, 3), 19, 32))
    gait: dict[str, Any] = {
        "speed_mps": round(float(rng.uniform(0.5, 1.9)), 2),
        "step_sd": round(float(np.exp(rng.uniform(math.log(0.01), math.log(0.04)))), 3),
        "stand_s": round(float(rng.uniform(1, 2)), 2),
    }
    manner = rng.random()
    if manner < 0.2:
        gait["asymmetry"] = 0.08 if manner < 0.1 else -0.08
    if rng.random() < 0.08:
        gait["shuffle"] = 0.5
    if rng.random() < 0.08:
        gait |= {"pattern": "wander", "speed_mps": min(gait["speed_mps"], 1.0)}
    sensor: dict[str, Any] = {}
    if rng.random() < 0.4:
        sensor["part"] = "MPU-9250"
    if rng.random() < 0.3:
        sensor |= {"position_mm": [60, 0, 85], "rotation_deg": [0, 25, 0]}
    elif rng.random() < 0.3:
        sensor["rotation_deg"] = [float(rng.uniform(-limit, limit)) for limit in (10, 30, 20)]
    node: dict[str, Any] = {
        "description": "A random walk",
        "terrain": draw_terrain(rng, terrain),
        "person": {
            "height_m": round(height_m, 3),
            "mass_kg": round(min(110.0, max(45.0, bmi * height_m**2)), 1),
            "sex": sex,
        },
        "gait": gait,
        "physics": physics,
        "sensors": {"foot_imu": sensor},
    }
    if rng.random() < 0.5:
        node["exo"] = "none"
    return node


def simulate(terrain: str, seed: int, physics: str = "kinematic") -> list[FootWalk]:
    """Both feet of one walk.

    Raises:
        StrideTwinError: The twin refuses the terrain for this person.
    """
    config = scenario_of(draw_walk(terrain, seed, physics), Path(f"{terrain}.yaml")).config
    twin = Twin(replace(config, sensors=("foot_imu",)), seed)
    footprints: list[Footprint] = []
    blocks: dict[str, list[Block[Any]]] = {f"/foot_{foot}/imu": [] for foot in FEET}
    for chunk in twin.blocks():
        for item in chunk:
            if isinstance(item, Footprint):
                footprints.append(item)
            elif isinstance(item, Block) and item.topic in blocks:
                blocks[item.topic].append(item)
    return [
        FootWalk(
            foot=foot,
            rig=twin.rig,
            imu=_join(blocks[f"/foot_{foot}/imu"]),
            strides=true_strides(footprints, foot),
        )
        for foot in FEET
    ]


def _join(parts: Sequence[Block[Any]]) -> Block[Any]:
    columns = {name: np.concatenate([b.columns[name] for b in parts]) for name in parts[0].columns}
    return replace(parts[0], t_ns=np.concatenate([b.t_ns for b in parts]), columns=columns)


def estimate(walk: FootWalk, parameters: GaitPhaseParameters | None = None) -> list[PhaseEstimate]:
    """Estimates after each usable sample of one foot."""
    estimator = GaitPhase(walk.rig, options=Options(foot=walk.foot), parameters=parameters)
    estimates = (estimator.update(sample) for sample in walk.imu)
    return [e for e in estimates if e is not None]


def to_series(estimates: Sequence[PhaseEstimate]) -> PhaseSeries:
    """The estimates as columns; scores do not depend on the foot."""
    return to_phase_series(list(estimates), "l")


def errors_by_group(series: PhaseSeries, strides: Sequence[Stride]) -> Iterator[tuple[str, Array]]:
    """Errors of each counted stride under each group that it belongs to."""
    for stride in strides:
        if not stride.is_pause:
            errors, _ = phase_errors(series, stride)
            yield stride.terrain, errors
            yield "all", errors
            if stride.is_steady:
                yield "steady", errors


def measure(seeds: Sequence[int], physics: str, terrains: Sequence[str]) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    cases: list[dict[str, Any]] = []
    pooled: dict[str, dict[str, list[Array]]] = {}
    samples, elapsed_s = 0, 0.0
    for terrain in terrains:
        for seed in seeds:
            try:
                feet = simulate(terrain, seed, physics)
            except StrideTwinError as error:
                print(f"{terrain} {seed}: {error}", file=sys.stderr)
                continue
            for walk in feet:
                begin = time.perf_counter()
                estimates = estimate(walk)
                elapsed_s, samples = elapsed_s + time.perf_counter() - begin, samples + len(walk.imu)
                series = to_series(estimates)
                cases.append(
                    {"terrain": terrain, "seed": seed, "foot": walk.foot, **phase_scores(series, walk.strides)}
                )
                for group, errors in errors_by_group(series, walk.strides):
                    pooled.setdefault(terrain, {}).setdefault(group, []).append(errors)
                    pooled.setdefault("all walks", {}).setdefault(group, []).append(errors)
    summary = {
        name: summarize(groups, [c for c in cases if name in ("all walks", c["terrain"])])
        for name, groups in pooled.items()
    }
    return {
        "experiment": "gait_phase",
        "physics": physics,
        "seeds": list(seeds),
        "summary": summary,
        "us_per_sample": 1e6 * elapsed_s / max(samples, 1),
        "cases": cases,
    }


def foot_mount(imu: Block[Imu]) -> Array:
    """(3, 3) rotation from sensor to foot axes, by gravity at rest and the horizontal axis that rotates most."""
    rate, force = imu.columns["angular_rate"], imu.columns["specific_force"]
    up = np.median(force[np.linalg.norm(rate, axis=1) < _REST_RADPS], axis=0)
    up /= np.linalg.norm(up)
    horizontal = rate - np.outer(rate @ up, up)
    left = np.linalg.eigh(horizontal.T @ horizontal)[1][:, -1]
    left -= up * (left @ up)
    left /= np.linalg.norm(left)
    pitch_rate = rate @ left
    if np.percentile(pitch_rate, 99.5) < -np.percentile(pitch_rate, 0.5):  # push-off is faster than the swing
        left = -left
    return np.stack([np.cross(left, up), left, up])


def real_foot(imu: Block[Imu]) -> FootWalk:
    """A recorded foot IMU, whose true strides are unknown."""
    topic, mount = "/foot_l/imu", np.eye(4)
    mount[:3, :3] = foot_mount(imu)
    calibration = ImuCalibration(
        topic=topic,
        part="unknown",
        rate_hz=1e9 / float(np.median(np.diff(imu.t_ns))),
        mount=Mount(body="foot_l", T_body_sensor=mount),
        gyroscope_noise_density=0.0,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=0.0,
        accelerometer_random_walk=0.0,
    )
    return FootWalk(foot="l", rig=Rig(imus={topic: calibration}), imu=imu, strides=[])


def detected_strides(series: PhaseSeries) -> list[Stride]:
    """Strides between detected touch-downs, which stand for the true ones of a recorded walk."""
    touch_downs_ns = find_touch_downs(series)
    durations = np.diff(touch_downs_ns)
    longest_ns = min(1e9 * LONGEST_STRIDE_S, LONGEST_STRIDE_SHARE * float(np.median(durations)))
    return [
        Stride(begin_ns=begin, end_ns=end, is_pause=end - begin > longest_ns)
        for begin, end in pairwise(touch_downs_ns.tolist())
    ]


def heel_strikes(walk: MarkerWalk) -> Array:
    """(S,) s: where the heel's marker, after a swing, has slowed down to 0.6 m/s."""
    heel = np.where(np.isfinite(walk.heel), walk.heel, 0.0)
    speed = np.linalg.norm(np.gradient(heel, walk.t, axis=0), axis=1)
    strikes = []
    for i in np.flatnonzero((speed[:-1] > _SWING_MPS) & (speed[1:] <= _SWING_MPS)):
        slow = np.flatnonzero(speed[i : i + 25] < _LANDED_MPS)
        strikes += [walk.t[i + slow[0]]] if len(slow) else []
    return np.array(strikes)


def measure_real(folder: Path) -> dict[str, Any]:
    """Figures of the recorded walks, in the form of an experiment's JSON."""
    markers = load_markers(folder)
    walks = {f"dual_foot_walk {walk.name}": walk.imu for walk in markers}
    walks |= {walk.name: walk.imu for walk in load_vicon(folder)}
    walks |= {"ngimu loop": load_loop(folder)}
    walks |= {f"stair up {side}": imu for side, imu in load_stairs(folder).items()}
    for file in sorted((folder / "foot_imu_corners").glob("*.npz")):
        with np.load(file) as d:
            walks[file.stem] = imu_block(d["t"], d["gyro"], d["accel"])
    summary = {}
    for name, imu in walks.items():
        series = to_series(estimate(real_foot(imu)))
        touch_downs_ns = find_touch_downs(series)
        if len(touch_downs_ns) < _MIN_TOUCH_DOWNS:
            summary[name] = {"touch_downs": float(len(touch_downs_ns))}
            continue
        durations_s = np.diff(touch_downs_ns) * 1e-9
        scores = phase_scores(series, detected_strides(series))
        summary[name] = {
            "touch_downs": float(len(touch_downs_ns)),
            **{f"stride_p{q}_s": float(np.percentile(durations_s, q)) for q in (5, 50, 95)},
            **{key: scores[key] for key in ("rmse_pct", "p95_pct", "within_95_pct", "not_walking_pct")},
        }
    for walk in markers:
        row = summary[f"dual_foot_walk {walk.name}"]
        strikes = heel_strikes(walk)
        touch_downs_ns = find_touch_downs(to_series(estimate(real_foot(walk.imu))))
        pairs = match_touch_downs(touch_downs_ns, 1e9 * strikes)
        errors = np.array([1e-6 * touch_downs_ns[i] - 1e3 * strikes[j] for i, j in pairs])
        row |= {"strikes": float(len(strikes)), "matched": float(len(pairs))}
        row |= {"strike_error_mean_ms": float(errors.mean()), "strike_error_sd_ms": float(errors.std())}
    return {"experiment": "gait_phase_real", "summary": summary}


def summarize(groups: Mapping[str, Sequence[Array]], cases: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Pooled RMS errors by group, % of the cycle, and means or sums of the other scores over legs."""

    def mean(name: str) -> float:
        values = [case[name] for case in cases if name in case]
        return float(np.mean(values)) if values else math.nan

    def pooled_rms(group: str) -> float:
        return 100.0 * float(np.sqrt(np.mean(np.square(np.concatenate(groups[group])))))

    return {
        "walks": len({(case["terrain"], case["seed"]) for case in cases}),
        "strides": sum(case.get("strides", 0) for case in cases),
        **{f"rmse_{name}_pct": pooled_rms(name) for name in _GROUPS if name in groups},
        **{name: mean(name) for name in ("within_95_pct", "touch_down_error_ms", "touch_down_bias_ms")},
        **{name: sum(case.get(name, 0) for case in cases) for name in ("missed", "extra")},
    }


def show(result: dict[str, Any]) -> None:
    """Prints one row per terrain, or the figures of each recorded walk."""
    if "us_per_sample" not in result:
        show_summary(24, "8.2f")(result)
        return
    names = [*(f"rmse_{name}_pct" for name in _GROUPS), "within_95_pct", "touch_down_error_ms"]
    heads = ["steady", "level", "ramp", "stairs", "all", "in 95", "down ms"]
    print(f"{'walks on':12s} {'walks':>6s} {'strides':>8s} " + " ".join(f"{h:>8s}" for h in heads) + "   missed extra")
    for name, row in result["summary"].items():
        values = " ".join(f"{row[n]:8.2f}" if n in row else f"{'-':>8s}" for n in names)
        events = f"{row['missed']:8.0f} {row['extra']:5.0f}"
        print(f"{name:12s} {row['walks']:6.0f} {row['strides']:8.0f} {values} {events}")
    print(f"{result['us_per_sample']:.0f} us per sample")


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=SEEDS, metavar=("FIRST", "COUNT"), help="seeds (1000 20)")
    parser.add_argument("--physics", choices=("kinematic", "dynamic"), default="kinematic", help="of the twin")
    parser.add_argument("--terrains", nargs="+", choices=TERRAINS, default=TERRAINS, help="all by default")
    parser.add_argument("--real", action="store_true", help="the recorded walks")
    return answer(parser, _run, show)


def _run(arguments: Namespace) -> dict[str, Any]:
    if not arguments.real:
        first, count = arguments.seeds
        return measure(range(first, first + count), arguments.physics, arguments.terrains)
    folder = data_folder()
    if folder is None:
        raise StrideTwinError("no recorded walks: set STRIDETWIN_DATA to their folder")
    return measure_real(folder)


if __name__ == "__main__":
    sys.exit(main())
