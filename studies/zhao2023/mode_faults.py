"""Locomotion-mode prediction under injected faults, on a stair and a ramp: one recording of each per seed.

Poses come from the visual-inertial odometry without faults; its own faults are in `dvio_faults`. Temporary faults begin
before each first step up and down, when the terrain change should be detected.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import CAMERA_POSES
from stridetwin.estimators.locomotion_mode import INSOLES
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.modes.scores import ModeScores, mode_figures
from stridetwin.outputs.truth import true_footprints
from stridetwin.sim.faults.sample_faults import Dropout
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Insole, Odometry
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import InjectedFault, Samples, by_fault, changed, fault_table
from stridetwin.studies.walks import falls, fell_at_s
from stridetwin.studies.zhao2023.mode_walks import MOUNTS, SENSORS, posed, predict, scored, stair_and_ramp

WALKS = ("zhao_stair_15cm", "zhao_ramp_11_8")
SEEDS = range(1000, 1004)
BEFORE_S, LASTS_S = 3.0, 2.0
"""A temporary fault begins this long before a foot first lands beyond a terrain change, and lasts this long, s."""
SEEN, SEEN_M = 0.20, 4.5
SURE = 0.9
_ROTATION_RAD, _TRANSLATION_M = 1.2, (3.0, -2.0, 0.5)
"""From the odometry's old frame to its new one, at each restart."""


def _restarted(begins_s: Sequence[float]) -> Callable[[Samples], Samples]:
    """The odometry is lost at each instant for `LASTS_S`, then starts again in a frame of its own."""

    def inject(samples: Samples) -> Samples:
        for s in samples:
            if isinstance(s, Odometry) and s.topic != CAMERA_POSES:
                since = [s.t_ns * 1e-9 - begin for begin in begins_s if s.t_ns * 1e-9 >= begin]
                if since and since[-1] < LASTS_S:
                    continue
                rotation = Rotation.from_rotvec([0.0, 0.0, len(since) * _ROTATION_RAD])
                q = rotation * Rotation.from_quat(s.q_world_frame, scalar_first=True)
                s = replace(
                    s, p_frame_in_world=rotation.apply(s.p_frame_in_world) + len(since) * np.array(_TRANSLATION_M),
                    q_world_frame=q.as_quat(scalar_first=True),
                )  # fmt: skip
            yield s

    return inject


def _no_force(s: Insole) -> Insole:
    return replace(s, force=np.zeros_like(s.force))


def _upper_part(s: Depth) -> Depth:
    """The camera is pitched too high: only the upper part of the depth image shows ground within range."""
    ground = ((s.depth > 0.0) & (s.depth < SEEN_M)).sum(axis=1).cumsum()
    depth = s.depth.copy()
    depth[int(np.searchsorted(ground, SEEN * ground[-1])) :] = 0.0
    return replace(s, depth=depth)


def faults(mount: str, begins_s: Sequence[float]) -> dict[str, InjectedFault]:
    """By name; temporary faults begin at these instants, s."""
    off = tuple(
        Dropout(topic=f"/{mount}/depth", at_s=at, duration_s=LASTS_S, name=f"off {k}") for k, at in enumerate(begins_s)
    )
    return {
        "none": InjectedFault(words="no fault"),
        "odometry_lost": InjectedFault(
            words=f"odometry lost for {LASTS_S:g} s, then in another frame", samples=_restarted(begins_s)
        ),
        "depth_off": InjectedFault(words=f"no depth for {LASTS_S:g} s", faults=off),
        "insole_dead": InjectedFault(
            words="left insole dead", samples=changed(_no_force, kinds=Insole, topic="/foot_l/insole")
        ),
        "looks_up": InjectedFault(
            words=f"{SEEN:.0%} of the terrain in view, the farthest", samples=changed(_upper_part, kinds=Depth)
        ),
    }


NAMES = {name: fault.words for name, fault in faults("head", ()).items()}
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
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in NAMES}
    fell = []
    for scenario, recording, sole_m in stair_and_ramp(case, WALKS, mount, SENSORS):
        poses = [s for s in posed(recording, mount, "dvio") if isinstance(s, Odometry)]
        for name, fault in faults(mount, begins_s(recording)).items():
            others = recording.samples([*INSOLES, depth_calibration(recording.rig).depth_topic])
            samples = heapq.merge(poses, others, key=lambda s: s.t_ns)
            arriving = fault.inject(samples, recording.rig, case.seed, recording.duration)
            found[name].append(scored(predict(arriving, recording), recording, sole_m)["proposed"].rows())
        if fell_at_s(recording) is not None:
            fell.append(scenario)
    return case.row(mount=mount, fell=fell, faults=found)


def begins_s(recording: Recording) -> list[float]:
    """When a fault begins: before each first step up or down."""
    prints = true_footprints(recording)
    firsts = [b.t_ns * 1e-9 for a, b in pairwise(prints) if a.mode == "LG" != b.mode]
    return [t - BEFORE_S for t in firsts]


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, over all walks."""
    return by_fault(NAMES, results, lambda cases: _figures([row for rows in cases for row in rows]))


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
        *fault_table(NAMES, result["summary"], _COLUMNS, 46),
    ]
