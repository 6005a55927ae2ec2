"""Cost of the exoskeleton for its wearer: mechanical work of hips and knees, and cuff forces, by mode.

`python -m benchmarks.wearer_work [--json] [--seeds 1000 1001 ...] [--scenarios ...] [--modes 0 1 ...]`. The same walk
is simulated forward without exoskeleton and with it; modules stay unpowered. Work is that of the wearer's own joint
torques between the first and the last second of walking, per metre of the path. In people, a load of 9.5 kg adds 3 to
15 %. Walks in which the wearer falls are counted and excluded. With `--physics kinematic` the plan is played and the
torques come from inverse dynamics.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES, Exo
from stridetwin.sim.twin import PHYSICS, Twin
from stridetwin.streams.errors import StrideTwinError

SCENARIOS = ("level_20m", "stair_up_down", "ramp_up_down")
SEEDS = range(1000, 1005)
MODES: dict[str, Exo | None] = {
    "none": None,
    "0": Exo(mode=0),
    "1": Exo(mode=1),
    "2": Exo(mode=2, joints=("hip_l", "hip_r")),
    "3": Exo(mode=3, joints=("hip_l", "knee_l")),
    "4": Exo(mode=4, joints=("hip_l",)),
}
BAND = {"positive_more_pct": (3.0, 15.0), "absolute_more_pct": (3.0, 15.0)}  # of mode 0
_STEADY_S = 1.0
_LABELS = ("scenario", "seed", "mode", "fell")
_RATE_HZ = 250.0


def measure(scenario: str, seed: int, exo: Exo | None, physics: str = "dynamic") -> dict[str, float]:
    """Work per metre, J/m, and cuff forces, N, of one walk.

    Raises:
        StrideTwinError: The walk cannot be planned.
    """
    config = replace(load_scenario(scenario).config, sensors=(), physics=physics, exo=exo)
    twin = Twin(config, seed)
    walk = twin.walk
    steps = [step for side in SIDES for step in walk.steps[side]]
    begin = min(step.t_off for step in steps) + _STEADY_S
    end = max(step.t_touch for step in steps) - _STEADY_S
    t = np.arange(begin, min(end, walk.duration_s), 1.0 / _RATE_HZ)
    t_ns = np.round(t * 1e9).astype(np.int64)
    player = twin.player()
    motion = player.motion(t_ns)
    torque = player.loads(t_ns, motion).joint_torque
    _, speed, _ = walk.state(t)
    names, layout = walk.coordinates.names[6:], walk.coordinates
    q = walk.state(t[[0, -1]])[0]
    way = float(np.linalg.norm(q[1, :3] - q[0, :3]))
    result = {"fell": float(twin.fell_at is not None)}
    total = {"positive": 0.0, "absolute": 0.0}
    for joint in ("hip", "knee"):
        joints = [i for i, name in enumerate(names) if name.startswith(joint)]
        power = torque[:, joints] * speed[:, [layout.dof[i] for i in joints]]
        for how, work in (("positive", np.maximum(power, 0.0)), ("absolute", np.abs(power))):
            result[f"{joint}_{how}_jpm"] = float(work.sum()) / _RATE_HZ / way
            total[how] += result[f"{joint}_{how}_jpm"]
    result |= {f"{how}_jpm": work for how, work in total.items()}
    if exo is not None:
        for part in ("thigh", "shank"):
            force = np.concatenate([motion.cuff_force[f"{part}_{side}"] for side in SIDES])
            result[f"{part}_forward_n"] = float(force.max())
            result[f"{part}_backward_n"] = float(-force.min())
            result[f"{part}_rms_n"] = float(np.sqrt((force**2).mean()))
    return result


def summary(cases: Sequence[dict[str, Any]], scenarios: Sequence[str], modes: Sequence[str]) -> dict[str, Any]:
    """Means over the completed walks, and the cost of each mode relative to the same walks without exoskeleton."""
    table: dict[str, Any] = {}
    for scenario in scenarios:
        table[scenario] = {}
        bare = {c["seed"]: c for c in cases if (c["scenario"], c["mode"], c["fell"]) == (scenario, "none", 0.0)}
        for mode in modes:
            chosen = [c for c in cases if (c["scenario"], c["mode"]) == (scenario, mode)]
            ended = [c for c in chosen if not c["fell"]]
            column = {"walks": float(len(chosen)), "fell": float(len(chosen) - len(ended))}
            if ended:
                column |= {k: float(np.mean([c[k] for c in ended])) for k in ended[0] if k not in _LABELS}
            pairs = [(c, bare[c["seed"]]) for c in ended if c["seed"] in bare]
            for how in ("positive", "absolute") if pairs else ():
                more = [c[f"{how}_jpm"] / without[f"{how}_jpm"] - 1 for c, without in pairs]
                column[f"{how}_more_pct"] = 100 * float(np.mean(more))
            table[scenario][mode] = column
    return table


def main() -> int:
    """Prints means by mode, or one JSON object."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--physics", choices=PHYSICS, default="dynamic")
    parser.add_argument("--modes", nargs="+", default=[m for m in MODES if m != "none"], choices=[*MODES])
    args = parser.parse_args()
    modes, cases = ["none", *(m for m in args.modes if m != "none")], []
    for scenario in args.scenarios:
        for seed in args.seeds:
            for mode in modes:
                try:
                    figures = measure(scenario, seed, MODES[mode], args.physics)
                except StrideTwinError as error:
                    print(f"{scenario}, seed {seed}, mode {mode}: {error}", file=sys.stderr)
                    continue
                cases.append({"scenario": scenario, "seed": seed, "mode": mode} | figures)
    table = summary(cases, args.scenarios, modes)
    if args.json:
        print(json.dumps({"experiment": "wearer_work", "summary": table, "band": BAND, "paper": {}, "cases": cases}))
        return 0
    for scenario, columns in table.items():
        print(scenario)
        print(f"  {'mode':22s}" + "".join(f"{m:>10s}" for m in columns))
        for key in dict.fromkeys(k for column in columns.values() for k in column):
            cells = "".join(f"{format(c[key], '.1f') if key in c else '-':>10s}" for c in columns.values())
            band = f"   mode 0: {BAND[key][0]:g} to {BAND[key][1]:g}" if key in BAND else ""
            print(f"  {key:22s}{cells}{band}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
