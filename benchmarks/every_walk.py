"""Every terrain of the catalogue in every pattern: can the walk be planned, and does the walker reach the end?

Run as `python -m benchmarks.every_walk [--json] [--physics dynamic [--assist]] [--terrains NAME ...]
[--manners NAME ...]`; prints one line per combination: ok, why it was refused, when the walker fell, or which limit it
exceeds (soles in the ground, slip; mean assist force at the root above 3 % of the body weight). The exit code is 1 if a
combination is not ok. All combinations take a night.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.dynamics import root_help
from benchmarks.gait import ALLOWED, penetration, slip
from stridetwin.scenarios.scenario_file import PHYSICS, catalogue, load_scenario
from stridetwin.sim.config import SIDES, Dynamics, Gait, Gaze
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError

MANNERS: dict[str, Gait] = {
    "wander": Gait.of_pattern("wander", gaze=Gaze(kind="wandering")),
    "walk": Gait.of_pattern("walk"),
    "jog": Gait.of_pattern("jog"),
    "slow": Gait(speed_mps=0.3, gaze=Gaze(kind="terrain")),
    "fast": Gait(speed_mps=2.1),
    "step_by_step": Gait(speed_mps=0.7, stairs="step_by_step"),
    "two_at_a_time": Gait(stairs="two_at_a_time"),
    "limp": Gait(speed_mps=0.8, asymmetry=0.2),
    "shuffle": Gait(speed_mps=0.35, shuffle=1.0),
}
HELP_MEAN_PCT = 3.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of one combination.

    Attributes:
        verdict: ok, refused, fell or wrong.
        why: Reason, if it is not ok.
        duration_s: Length of the walk.
        help_mean_pct: Mean force of the assist at the root, % of the body weight; None for a walk that was not
            simulated with it. `help_p95_pct` and `help_max_pct` likewise.
        wall_s: Wall-clock time of the computation.
    """

    terrain: str
    manner: str
    verdict: str
    why: str
    duration_s: float
    help_mean_pct: float | None = None
    help_p95_pct: float | None = None
    help_max_pct: float | None = None
    wall_s: float


def walk(terrain: str, manner: str, physics: str, dynamics: Dynamics | None, seed: int) -> Outcome:
    """Computes one combination, without sensors."""
    config = replace(
        load_scenario(terrain).config, gait=MANNERS[manner], physics=physics, dynamics=dynamics, sensors=()
    )
    began, duration, given = time.perf_counter(), 0.0, {}
    try:
        twin = Twin(config, seed)
        duration = twin.duration_s
        given = _help(twin)
        verdict, why = _judge(twin, given)
    except StrideTwinError as error:
        verdict, why = "refused", str(error)
    return Outcome(
        terrain=terrain,
        manner=manner,
        verdict=verdict,
        why=why,
        duration_s=duration,
        wall_s=time.perf_counter() - began,
        **given,
    )


def _help(twin: Twin) -> dict[str, float]:
    """Force of the assist, % of the body weight."""
    walk = twin.walk
    if not isinstance(walk, SimulatedWalk) or not (twin.config.dynamics and twin.config.dynamics.assist):
        return {}
    force, _ = root_help(twin, walk)
    return {
        "help_mean_pct": float(force.mean()),
        "help_p95_pct": float(np.quantile(force, 0.95)),
        "help_max_pct": float(force.max()),
    }


def _judge(twin: Twin, given: dict[str, float]) -> tuple[str, str]:
    if twin.fell_at is not None:
        return "fell", f"at {twin.fell_at:.1f} s"
    if given.get("help_mean_pct", 0.0) > HELP_MEAN_PCT:
        return "wrong", f"help {given['help_mean_pct']:.1f} % of the body weight, allowed {HELP_MEAN_PCT:g}"
    if twin.config.physics == "dynamic":  # real contacts sink in and slip: see benchmarks.dynamics
        return "ok", ""
    figures = {
        "penetration_mm": 1e3 * max(penetration(twin, side) for side in SIDES),
        "slip_mm": 1e3 * max(slip(twin, side) for side in SIDES),
    }
    wrong = [f"{name} {value:.2f}, allowed {ALLOWED[name]}" for name, value in figures.items() if value > ALLOWED[name]]
    return ("wrong", "; ".join(wrong)) if wrong else ("ok", "")


def main() -> int:
    """Prints one line per combination, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--physics", choices=PHYSICS, default="kinematic")
    parser.add_argument("--assist", action="store_true", help="with the soft assist at the root")
    parser.add_argument("--terrains", nargs="+", choices=list(catalogue()), default=list(catalogue()), metavar="NAME")
    parser.add_argument("--manners", nargs="+", choices=list(MANNERS), default=list(MANNERS), metavar="NAME")
    parser.add_argument("--seed", type=int, default=1000)
    args = parser.parse_args()
    if args.assist and args.physics != "dynamic":
        parser.error("--assist needs --physics dynamic")
    dynamics, outcomes = Dynamics(assist=True) if args.assist else None, []
    for terrain in args.terrains:
        for manner in args.manners:
            outcome = walk(terrain, manner, args.physics, dynamics, args.seed)
            outcomes.append(outcome)
            if not args.json:
                line = f"{outcome.verdict:8}{outcome.duration_s:7.1f} s {outcome.wall_s:6.1f} s  {outcome.why}"
                if outcome.help_mean_pct is not None:
                    line += f"  help mean {outcome.help_mean_pct:.2f} %, p95 {outcome.help_p95_pct:.2f} %"
                print(f"{terrain:20} {manner:14}{line}", flush=True)
    counts = {v: sum(o.verdict == v for o in outcomes) for v in ("ok", "refused", "fell", "wrong")}
    if args.json:
        cases: list[dict[str, Any]] = [vars(o) for o in outcomes]
        print(json.dumps({"experiment": "every_walk", "summary": {args.physics: counts}, "paper": {}, "cases": cases}))
    else:
        print("  ".join(f"{name} {count}" for name, count in counts.items()))
    return int(counts["ok"] < len(outcomes))


if __name__ == "__main__":
    sys.exit(main())
