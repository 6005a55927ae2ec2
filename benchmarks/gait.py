"""Consistency of the walk: depth of the soles, skid at landing, slip in stance, joint ranges, landings on stairs.

Run as `python -m benchmarks.gait [--json] [--seeds 1000 1001 ...]`; walks `level_20m`, `stair_up_down`,
`ramp_up_down`, `turns` and `cross_slope` and prints the worst over feet and seeds beside the limit.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

import numpy as np

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES
from stridetwin.sim.gait.foot_path import STOPPING_S
from stridetwin.sim.playback import Motion
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.samples import Array

SCENARIOS = ("level_20m", "stair_up_down", "ramp_up_down", "turns", "cross_slope")
HUMAN_DEG = {"hip_flexion": (-30, 120), "knee_flexion": (0, 140), "ankle_dorsiflexion": (-45, 38)}
FLAT_TOES_RAD = 1e-3
"""Pitch of the toes, relative to the footprint, up to which they count as flat."""
ALLOWED = {"penetration_mm": 5.0, "skid_mm": 10.0, "slip_mm": 2.0}


def motion_at(twin: Twin, t: Array) -> Motion:
    """Motion of a walk at (N,) s."""
    return twin.player().motion(np.round(t * 1e9).astype(np.int64))


def penetration(twin: Twin, side: str) -> float:
    """Deepest point of a sole under the ground at any time, m (negative: never touches)."""
    motion = motion_at(twin, np.arange(0.0, twin.duration_s, 0.004))
    shoe = twin.size.shoe
    foot, toe = motion.tracks[f"foot_{side}"], motion.tracks[f"toe_{side}"]
    R_foot, R_toe = from_quaternion(foot.q_world_body), from_quaternion(toe.q_world_body)
    w = shoe.half_width - 0.004
    rear = [[x, y, 0.0] for x in (shoe.heel_back_x, 0.9 * shoe.toe_hinge_x) for y in (-w, w)]
    front = [[x, 0.0, -shoe.toe_hinge_z] for x in (0.0, shoe.toe_tip_x - shoe.toe_hinge_x)]
    points = [foot.p_body_in_world + R_foot @ np.array(p) for p in rear]
    points += [toe.p_body_in_world + R_toe @ np.array(p) for p in front]
    sole = np.stack(points, 1)
    return float((twin.terrain.height(sole[..., :2]) - sole[..., 2]).max())


def slip(twin: Twin, side: str) -> float:
    """Largest movement along one axis of a loaded pivot in one stance, m.

    Pivots are the heel's edge until the sole is flat, then the toe hinge until the toes roll over their tip, and that
    tip, if they do. It counts from the instant at which the ground has stopped the heel (`skid` is the way until then).
    """
    shoe, worst = twin.size.shoe, 0.0
    for step in twin.walk.steps[side]:
        t = np.arange(max(step.t_touch + STOPPING_S, 0.0) + 1e-3, min(step.t_off, twin.duration_s) - 1e-3, 0.004)
        motion = motion_at(twin, t)
        track, toe = motion.tracks[f"foot_{side}"], motion.tracks[f"toe_{side}"]
        R, R_toe = from_quaternion(track.q_world_body), from_quaternion(toe.q_world_body)
        pitch = twin.walk.pitch(side, t)
        flat_toes = (R_toe @ [1.0, 0.0, 0.0] * step.R_world_sole[:, 2]).sum(1) > -FLAT_TOES_RAD
        heel = track.p_body_in_world + R @ np.array([shoe.heel_back_x, 0.0, 0.0])
        hinge = track.p_body_in_world + R @ np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
        tip = toe.p_body_in_world + R_toe @ [shoe.toe_tip_x - shoe.toe_hinge_x, 0.0, -shoe.toe_hinge_z]
        late = pitch > -1e-4
        for point, on in ((heel, pitch < 1e-4), (hinge, late & flat_toes), (tip, late & step.rolls_off)):
            if on.sum() > 1:
                worst = max(worst, float(np.ptp(point[on], axis=0).max()))
    return worst


def skid(twin: Twin, side: str) -> float:
    """Longest way of a heel along the ground from touch-down until the ground has stopped it, m."""
    touch = np.array([step.t_touch for step in twin.walk.steps[side] if 0.0 < step.t_touch < twin.duration_s - 0.1])
    heel = []
    for t in (touch, touch + STOPPING_S):
        track = motion_at(twin, t).tracks[f"foot_{side}"]
        R = from_quaternion(track.q_world_body)
        heel.append(track.p_body_in_world + R @ np.array([twin.size.shoe.heel_back_x, 0.0, 0.0]))
    return float(np.linalg.norm((heel[1] - heel[0])[:, :2], axis=1).max())


def joint_range_deg(twin: Twin, joint: str) -> tuple[float, float]:
    """Smallest and largest angle of a leg joint over both sides, degrees."""
    values = np.degrees(twin.walk.splines(np.arange(0.0, twin.duration_s, 0.005)))
    columns = [i for i, n in enumerate(twin.walk.coordinates.names) if n in (f"{joint}_l", f"{joint}_r")]
    return float(values[:, columns].min()), float(values[:, columns].max())


def landing_pitch_deg(twin: Twin, mode: str) -> list[float]:
    """Pitch of the sole just after touch-down of every step of a mode, degrees, toes down positive."""
    pitches = []
    for step in (s for steps_of_foot in twin.walk.steps.values() for s in steps_of_foot if s.mode == mode):
        track = motion_at(twin, np.array([step.t_touch + 0.002])).tracks[f"foot_{step.foot}"]
        pitches.append(float(np.degrees(np.arcsin(-from_quaternion(track.q_world_body)[0, 2, 0]))))
    return pitches


def measure(scenario: str, seed: int) -> dict[str, float]:
    """All figures of one walk."""
    twin = Twin(replace(load_scenario(scenario).config, sensors=()), seed)
    row = {
        "penetration_mm": 1e3 * max(penetration(twin, side) for side in SIDES),
        "skid_mm": 1e3 * max(skid(twin, side) for side in SIDES),
        "slip_mm": 1e3 * max(slip(twin, side) for side in SIDES),
    }
    for joint in HUMAN_DEG:
        row[f"{joint}_min_deg"], row[f"{joint}_max_deg"] = joint_range_deg(twin, joint)
    down = landing_pitch_deg(twin, "SD")
    if down:
        row["landing_down_min_deg"], row["landing_down_max_deg"] = min(down), max(down)
    return row


def main() -> None:
    """Prints the worst of each figure, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1000, 1010)))
    args = parser.parse_args()
    cases = [{"scenario": s, "seed": seed} | measure(s, seed) for s in SCENARIOS for seed in args.seeds]
    summary: dict[str, dict[str, float]] = {}
    for scenario in SCENARIOS:
        rows = [c for c in cases if c["scenario"] == scenario]
        summary[scenario] = {
            key: (min if "_min_" in key else max)(row[key] for row in rows)
            for key in rows[0]
            if key.endswith(("_mm", "_deg"))
        }
    if args.json:
        print(json.dumps({"experiment": "gait", "summary": summary, "paper": {}, "cases": cases}))
        return
    for scenario, row in summary.items():
        print(scenario)
        for key, value in row.items():
            print(f"  {key:26} {value:7.2f}" + (f"   allowed {ALLOWED[key]}" if key in ALLOWED else ""))


if __name__ == "__main__":
    main()
