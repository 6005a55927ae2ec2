"""Simulated walks: falls, force at the root, contact forces, slip and penetration of the feet, computing time.

Run as `python -m benchmarks.dynamics [--json] [--seeds 1000 1001 ...] [--suites plain assist ...] [--workers 2]`.
Each seed has its own person and speed. `plain` walks every terrain supported by the ground alone; `assist` the same
with the soft assist; `disturbed` the level and the stairs with each disturbance and with all, and the assist;
`unaided` the same without it; `pushes` pushes and missteps without it; `turns` turns and a loop with the assist;
`pauses` a stroll of the scenario's own person that stops and sets off again about ten times, without it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.gait import motion_at
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import (
    SIDES,
    Dynamics,
    Gait,
    Level,
    Misstep,
    Person,
    Push,
    Ramp,
    Route,
    Segment,
    Stairs,
    TwinConfig,
)
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

SPEEDS_MPS = (0.6, 1.4)
_WALK_S = 16.0  # of walking on the level; with standing, start and stop at least 20 s
_ENDS: tuple[Segment, Segment] = (Level(length_m=3.0), Level(length_m=3.0))
_RAMP_RAD = math.radians(14.0)
TERRAINS: dict[str, tuple[Segment, ...]] = {
    "level": (),
    "stair_up": (Stairs(risers=14),),
    "stair_down": (Stairs(risers=14, down=True),),
    "ramp_up": (Ramp(angle_rad=_RAMP_RAD, rise_m=2.0),),
    "ramp_down": (Ramp(angle_rad=_RAMP_RAD, rise_m=2.0, down=True),),
}
DISTURBANCES: dict[str, Dynamics] = {
    "mass": Dynamics(mass_error=0.05),
    "noise": Dynamics(torque_noise=0.1),
    "floor": Dynamics(floor_offset_m=-0.008),
    "friction": Dynamics(friction=0.5),
    "all": Dynamics(mass_error=0.05, torque_noise=0.1, floor_offset_m=-0.008, friction=0.5),
}
PUSHES: dict[str, Dynamics] = {
    "push_left": Dynamics(pushes=(Push(at_s=8.0, left_n=100.0),)),
    "push_forward": Dynamics(pushes=(Push(at_s=8.0, forward_n=100.0),)),
    "misstep": Dynamics(missteps=(Misstep(at_s=8.0, forward_m=0.05, left_m=0.02),)),
}
ALLOWED = {
    "plain": {"fell": 0, "slip_p95_mm": 5, "penetration_mm": 4, "force_max_bw": 1.6},
    "assist": {"fell": 0, "root_mean_pct": 1, "root_p95_pct": 3, "root_torque_p95_pct": 0.3},
    "disturbed": {"fell": 0, "root_mean_pct": 2, "root_p95_pct": 5, "root_max_pct": 10},
    "unaided": {},
    "pushes": {},
    "turns": {"fell": 0, "root_mean_pct": 3},
    "pauses": {"fell": 0},
}
_LABORATORY_HZ = 10.0  # low pass of the moments, as of laboratories
_STEADY_S = 1.0  # excluded from the forces at both ends of a walk
_FIRM = 0.10  # load on a foot, share of the body weight, above which it must not slip


@dataclass(frozen=True, kw_only=True)
class Case:
    """One walk of a suite."""

    suite: str
    name: str
    seed: int
    config: TwinConfig


def subject(seed: int) -> tuple[Person, float]:
    """The person and the speed of a seed."""
    rng = np.random.default_rng(seed)
    height = float(rng.uniform(1.58, 1.90))
    person = Person(height_m=height, mass_kg=float(rng.uniform(20.0, 27.0)) * height**2, sex="male")
    return person, float(rng.uniform(*SPEEDS_MPS))


def cases(suite: str, seed: int) -> Iterator[Case]:
    """The walks of a suite for one seed."""
    person, speed = subject(seed)
    common = {"person": person, "gait": Gait(speed_mps=speed), "sensors": (), "physics": "dynamic"}

    def of(terrain: str, dynamics: Dynamics, name: str) -> Case:
        middle = TERRAINS[terrain] or (Level(length_m=max(1.0, _WALK_S * speed - 6.0)),)
        route = Route(segments=(_ENDS[0], *middle, _ENDS[1]))
        return Case(
            suite=suite, name=name, seed=seed, config=TwinConfig(name=name, route=route, dynamics=dynamics, **common)
        )

    aided = suite in ("assist", "disturbed")
    if suite in ("plain", "assist"):
        for terrain in TERRAINS:
            yield of(terrain, Dynamics(assist=aided), terrain)
    elif suite in ("disturbed", "unaided"):
        for terrain in ("level", "stair_up", "stair_down"):
            for name, dynamics in DISTURBANCES.items():
                yield of(terrain, replace(dynamics, assist=aided), f"{terrain}_{name}")
    elif suite == "pushes":
        for name, dynamics in PUSHES.items():
            yield of("level", dynamics, f"level_{name}")
    elif suite == "pauses":
        stroll = replace(load_scenario("dvio_wander").config, sensors=(), physics="dynamic")
        yield Case(suite=suite, name="dvio_wander", seed=seed, config=stroll)
    else:
        for name in ("turns", "jao_loop_126m"):
            config = replace(load_scenario(name).config, dynamics=Dynamics(assist=True), **common)
            yield Case(suite=suite, name=name, seed=seed, config=config)


def measure(case: Case) -> dict[str, float]:
    """All figures of one walk; only `unplanned` if the planner finds no solution for the legs."""
    started = time.process_time()
    try:
        twin = Twin(case.config, case.seed)
    except StrideTwinError:
        return {"unplanned": 1.0}
    planned = time.process_time()
    walk = twin.walk
    took = time.process_time() - planned
    assert isinstance(walk, SimulatedWalk)
    weight = NOMINAL_GRAVITY_MPS2 * float(twin.model.body_subtreemass[0])
    lift = walk.loads.force[:, :, 2].sum(1) / weight
    help_force, help_torque = root_help(twin, walk)
    steady = (walk.t > _STEADY_S) & (walk.t < walk.duration_s - _STEADY_S)
    figures = {
        "unplanned": 0.0,
        "fell": float(walk.fell_at is not None),
        "root_mean_pct": float(help_force.mean()),
        "root_p95_pct": float(np.quantile(help_force, 0.95)),
        "root_max_pct": float(help_force.max()),
        "root_torque_p95_pct": float(np.quantile(help_torque, 0.95)),
        "times_real": walk.duration_s / took,
        "times_real_with_plan": walk.duration_s / (took + planned - started),
    }
    if walk.fell_at is not None:
        return figures
    figures |= {
        "force_p99_bw": float(np.quantile(lift[steady], 0.99)),
        "force_max_bw": float(lift[steady].max()),
        "slip_p95_mm": 1e3 * float(np.quantile(slips(twin, walk), 0.95)),
        "penetration_mm": 1e3 * penetration(twin, walk),
    }
    if case.name == "level":
        figures |= greatest_moments(twin, walk)
    return figures


def greatest_moments(twin: Twin, walk: SimulatedWalk) -> dict[str, float]:
    """Greatest moments of the left leg (hip and knee extension, plantar flexion) in its mean stride, N m/kg."""
    low_pass = butter(2, _LABORATORY_HZ / (0.5 / float(walk.t[1] - walk.t[0])), output="sos")
    greatest = {}
    for name in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        dof = int(twin.model.joint(f"{name}_l").dofadr[0])
        moment = sosfiltfilt(low_pass, -walk.torque[:, dof] / float(twin.model.body_subtreemass[0]))
        steps = walk.steps["l"][2:-1]
        strides = [np.interp(np.linspace(a.t_touch, b.t_touch, 51), walk.t, moment) for a, b in pairwise(steps)]
        greatest[f"{name.split('_')[0]}_moment_Nm_kg"] = float(np.mean(strides, axis=0).max())
    return greatest


def root_help(twin: Twin, walk: SimulatedWalk) -> tuple[Array, Array]:
    """(N,) force at the root, % of the body weight, and (N,) torque, % of the body weight x 1 m."""
    percent = 100 / (NOMINAL_GRAVITY_MPS2 * float(twin.model.body_subtreemass[0]))
    force, torque = (np.linalg.norm(walk.torque[:, k : k + 3], axis=1) * percent for k in (0, 3))
    return force, torque


def slips(twin: Twin, walk: SimulatedWalk) -> list[float]:
    """How far the toe hinge slips on the ground in each stance while the ball is firmly loaded, m."""
    weight, slips_m = NOMINAL_GRAVITY_MPS2 * float(twin.model.body_subtreemass[0]), []
    hinge = np.array([twin.size.shoe.toe_hinge_x, 0.0, twin.size.shoe.toe_hinge_z])
    for k, side in enumerate(SIDES):
        for step in walk.steps[side]:
            on = (walk.t > step.t_touch) & (walk.t < step.t_off) & (walk.loads.force[:, k, 2] > _FIRM * weight)
            t = walk.t[on]
            t = t[walk.pitch(side, t) > -0.005]
            if len(t) < 20:
                continue
            track = motion_at(twin, t).tracks[f"foot_{side}"]
            p = track.p_body_in_world + from_quaternion(track.q_world_body) @ hinge
            slips_m.append(float(np.linalg.norm(np.ptp(p, axis=0))))
    return slips_m


def penetration(twin: Twin, walk: SimulatedWalk) -> float:
    """Deepest point of a flat foot's heel and hinge below the actual floor, m."""
    floor = (twin.config.dynamics or Dynamics()).floor_offset_m
    motion, deepest = motion_at(twin, np.arange(0.0, walk.duration_s, 0.005)), 0.0
    for side in SIDES:
        track, shoe = motion.tracks[f"foot_{side}"], twin.size.shoe
        R = from_quaternion(track.q_world_body)
        for x in (shoe.heel_back_x, shoe.toe_hinge_x):
            p = track.p_body_in_world + R @ np.array([x, 0.0, 0.0])
            deepest = max(deepest, float((twin.terrain.height(p[:, :2]) + floor - p[:, 2]).max()))
    return deepest


def summed(rows: list[dict[str, float]]) -> dict[str, float]:
    """Numbers of walks and falls, and the worst of every other figure."""
    how = {"unplanned": sum, "fell": sum, "times_real": min, "times_real_with_plan": min}
    keys = dict.fromkeys(key for row in rows for key in row)
    return {"walks": len(rows)} | {k: how.get(k, max)([r[k] for r in rows if k in r]) for k in keys}


def _words(row: dict[str, float]) -> str:
    return ", ".join(f"{k} {v:.4g}" for k, v in row.items())


def main() -> None:
    """Prints the worst of each figure beside its limit, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1000, 1020)))
    parser.add_argument("--suites", nargs="+", choices=list(ALLOWED), default=list(ALLOWED))
    parser.add_argument("--names", nargs="+", help="of the walks in the suites; default: all")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    todo = [c for suite in args.suites for seed in args.seeds for c in cases(suite, seed)]
    todo = [c for c in todo if args.names is None or c.name in args.names]
    with get_context("spawn").Pool(args.workers) as pool:
        done = []
        for case, row in zip(todo, pool.imap(measure, todo)):
            print(f"{case.suite} {case.name} {case.seed}: {_words(row)}", file=sys.stderr, flush=True)
            done.append(row)
    summary: dict[str, dict[str, dict[str, float]]] = {}
    for suite in args.suites:
        names = dict.fromkeys(c.name for c in todo if c.suite == suite)
        summary[suite] = {
            name: summed([r for c, r in zip(todo, done) if (c.suite, c.name) == (suite, name)]) for name in names
        }
    if args.json:
        rows = [{"suite": c.suite, "name": c.name, "seed": c.seed} | r for c, r in zip(todo, done)]
        print(json.dumps({"experiment": "dynamics", "summary": summary, "paper": {}, "cases": rows}))
        return
    for suite, walks in summary.items():
        print(f"{suite}; allowed: {', '.join(f'{k} {v}' for k, v in ALLOWED[suite].items()) or 'reported only'}")
        for name, row in walks.items():
            print(f"  {name}: {_words(row)}")


if __name__ == "__main__":
    main()
