"""Locomotion-mode prediction under injected faults, on a stair and a ramp: one recording of each per seed.

Poses come from the visual-inertial odometry without faults; its own faults are in `dvio_faults`. Temporary faults begin
before each first step up and down, when the terrain change should be detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from stridetwin.estimators.base import CAMERA_POSES, POSES
from stridetwin.estimators.locomotion_mode import INSOLES
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.modes.scores import ModeScores, mode_figures
from stridetwin.outputs.pose_feed import merge_poses
from stridetwin.outputs.truth import true_footprints
from stridetwin.scenarios.metadata import fault_metadata
from stridetwin.sim.faults.faults import Fault, TimedFault
from stridetwin.streams.pose_restart import restart_poses
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Odometry
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import FaultCase, by_fault, fault_table, read_cases
from stridetwin.studies.walks import falls, fell_at_s
from stridetwin.studies.zhao2023.mode_walks import MOUNTS, SENSORS, posed, predict, scored, stair_and_ramp, trajectory

WALKS = ("zhao_stair_15cm", "zhao_ramp_11_8")
SEEDS = range(1000, 1004)
BEFORE_S = 3.0
"""A temporary fault begins this long before a foot first lands beyond a terrain change, s."""
SURE = 0.9


FAULTS = read_cases(__file__)
_COLUMNS = (
    ("steps", 6, "{steps}"),
    ("correct %", 11, "{accuracy_pct:.1f}"),
    ("transitions %", 15, "{transition_accuracy_pct:.1f}"),
    ("lead s", 8, "{lead_time_s[median]:.1f}"),
    ("5 %", 6, "{lead_time_s[p5]:.1f}"),
    ("p correct", 11, "{probability_right:.3f}"),
    ("p wrong", 9, "{probability_wrong:.3f}"),
    ("wrong", 7, "{wrong}"),
    (f"p > {SURE:g}", 9, "{sure_and_wrong}"),
    ("none", 6, "{not_predicted}"),
    ("cal. error", 12, "{calibration_error:.3f}"),
)


def run_case(case: Case) -> dict[str, Any]:
    """Both walks, with each fault.

    Returns:
        `seed`, `physics`, `mount`, `fell`, and `faults`: name to the rows of each walk.
    """
    mount = MOUNTS[case.seed % len(MOUNTS)]
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in FAULTS}
    fell = []
    for scenario, recording, sole_m in stair_and_ramp(case, WALKS, mount, SENSORS):
        feed = [s for s in posed(recording, mount, "dvio") if isinstance(s, Odometry)]
        poses, camera = (trajectory([s for s in feed if s.topic == topic]) for topic in (POSES, CAMERA_POSES))
        topics = [*INSOLES, depth_calibration(recording.rig).depth_topic]
        for name, fault in FAULTS.items():
            plan = repeat(fault, begins_s(recording)).plan(recording.rig, case.seed, recording.duration)
            samples = merge_poses(restart_poses(poses, fault_metadata(plan.planned)), recording, topics, camera)
            predictions = predict(plan.samples(samples), recording)
            found[name].append(scored(predictions, recording, sole_m)["proposed"].rows())
        if fell_at_s(recording) is not None:
            fell.append(scenario)
    return case.row(mount=mount, fell=fell, faults=found)


def repeat(case: FaultCase, begins_s: Sequence[float]) -> FaultCase:
    """The case with its temporary faults at each of these instants, s."""
    faults: list[Fault] = []
    for fault in case.faults:
        if isinstance(fault, TimedFault) and fault.duration_s is not None:
            faults += [replace(fault, at_s=t, name=f"{fault.own_name} {t:.3f}") for t in begins_s]
        else:
            faults.append(fault)
    return replace(case, faults=tuple(faults))


def begins_s(recording: Recording) -> list[float]:
    """When a fault begins: before each first step up or down."""
    prints = true_footprints(recording)
    firsts = [b.t_ns * 1e-9 for a, b in pairwise(prints) if a.mode == "LG" != b.mode]
    return [t - BEFORE_S for t in firsts]


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, over all walks."""
    return by_fault(FAULTS, results, lambda cases: _figures([row for rows in cases for row in rows]))


def _figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """`mode_figures`, and the predicted probabilities.

    Also the mean probability of right and of wrong predictions, and numbers of steps: predicted wrongly (`wrong`), with
    more than `SURE` (`sure_and_wrong`), and not predicted (`not_predicted`).
    """
    walks = [ModeScores.of(row) for row in rows]
    steps = [s for w in walks for s in w.steps]
    predicted = [(max(s.probabilities), s.right) for s in steps if s.probabilities]
    right, wrong = ([p for p, right in predicted if right is which] for which in (True, False))
    return {
        **mode_figures(walks),
        "probability_right": float(np.mean(right)) if right else None,
        "probability_wrong": float(np.mean(wrong)) if wrong else None,
        "sure_and_wrong": sum(p > SURE for p in wrong),
        "wrong": len(wrong),
        "not_predicted": len(steps) - len(predicted),
    }


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text."""
    return [
        f"{len(result['cases'])} walks each of {' and '.join(WALKS)}; p: probability of the predicted mode",
        falls(result["cases"]),
        *fault_table(FAULTS, result["summary"], _COLUMNS, 46),
    ]
