"""Simulated walks: do they stand, what held the root, how the ground pushed, how far feet slip and sink.

Run as `python -m benchmarks.dynamics [--json] [--seeds 1000 1001 ...] [--scenarios ...]`. Each seed walks every
scenario with a person and a speed of its own, drawn from what the project promises; nothing helps at the root.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from benchmarks.gait import motion_at
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES, Gait, Person
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.rotation import matrix_from_quat
from stridetwin.sim.twin import Twin

SCENARIOS = ("level_20m", "stair_up_down", "ramp_up_down")
SPEEDS_MPS = (1.0, 1.3)
_STEADY_S = 1.0  # at both ends of a walk, left out of the forces
_FIRM = 0.10  # of the body weight on a foot from which on it must not slip


def subject(seed: int) -> tuple[Person, float]:
    """A person and a speed of one's own for each seed."""
    rng = np.random.default_rng(seed)
    height = float(rng.uniform(1.58, 1.90))
    person = Person(height_m=height, mass_kg=float(rng.uniform(20.0, 27.0)) * height**2, sex="male")
    return person, float(rng.uniform(*SPEEDS_MPS))


def measure(scenario: str, seed: int) -> dict[str, float]:
    """All figures of one walk."""
    person, speed = subject(seed)
    config = load_scenario(scenario).config
    twin = Twin(replace(config, sensors=(), physics="dynamic", person=person, gait=Gait(speed_mps=speed)), seed)
    started = time.perf_counter()
    walk = twin.walk
    took = time.perf_counter() - started
    assert isinstance(walk, SimulatedWalk)
    weight = 9.81 * float(twin.model.body_subtreemass[0])
    steady = (walk.t > _STEADY_S) & (walk.t < walk.duration_s - _STEADY_S)
    lift = walk.foot_force[:, :, 2] / weight
    residual = np.linalg.norm(walk.torque[:, :3], axis=1) / weight
    t = np.arange(0.0, walk.duration_s, 0.01)
    legs = [i for i, n in enumerate(walk.coordinates.names) if n.startswith(("hip", "knee", "ankle"))]
    tracking = np.degrees(walk.splines(t)[:, legs] - twin.reference.splines(t)[:, legs])
    moved = [
        float(np.linalg.norm(planned.p_foot_in_world - done.p_foot_in_world))
        for side in SIDES for planned, done in zip(twin.reference.steps[side], walk.steps[side])
    ]  # fmt: skip
    return {
        "fell": float(walk.fell_at is not None),
        "residual_mean_pct": 100 * float(residual.mean()),
        "residual_p95_pct": 100 * float(np.quantile(residual, 0.95)),
        "vertical_force_p99_bw": float(np.quantile(lift[steady].sum(1), 0.99)),
        "tracking_rms_deg": float(np.sqrt((tracking**2).mean())),
        "slip_p95_mm": 1e3 * float(np.quantile(_slips(twin, walk), 0.95)),
        "step_moved_max_mm": 1e3 * max(moved),
        "times_real": walk.duration_s / took,
    }


def _slips(twin: Twin, walk: SimulatedWalk) -> list[float]:
    """How far the toe hinge wanders over the ground in each stance while the ball carries firmly, m."""
    weight, slips = 9.81 * float(twin.model.body_subtreemass[0]), []
    hinge = np.array([twin.size.shoe.toe_hinge_x, 0.0, twin.size.shoe.toe_hinge_z])
    for k, side in enumerate(SIDES):
        for step in walk.steps[side]:
            on = (walk.t > step.t_touch) & (walk.t < step.t_off) & (walk.foot_force[:, k, 2] > _FIRM * weight)
            t = walk.t[on]
            t = t[walk.pitch(side, t) > -0.005]
            if len(t) < 20:
                continue
            track = motion_at(twin, t[::10]).tracks[f"foot_{side}"]
            point = track.p_body_in_world + matrix_from_quat(track.q_world_body) @ hinge
            slips.append(float(np.linalg.norm(np.ptp(point[:, :2], axis=0))))
    return slips


def main() -> None:
    """Prints the worst of each figure, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1000, 1005)))
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    args = parser.parse_args()
    cases = [{"scenario": s, "seed": seed} | measure(s, seed) for s in args.scenarios for seed in args.seeds]
    summary = {}
    for scenario in args.scenarios:
        rows = [c for c in cases if c["scenario"] == scenario]
        worst = {"fell": sum, "times_real": min}
        summary[scenario] = {k: worst.get(k, max)(r[k] for r in rows) for k in rows[0] if k not in ("scenario", "seed")}
    if args.json:
        print(json.dumps({"experiment": "dynamics", "summary": summary, "paper": {}, "cases": cases}))
        return
    for scenario, row in summary.items():
        print(f"{scenario}: {len(args.seeds)} walks")
        for key, value in row.items():
            print(f"  {key:24} {value:8.2f}")


if __name__ == "__main__":
    main()
