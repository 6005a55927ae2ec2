"""What the prediction of locomotion modes makes of faults: a stair and a ramp, walked once a seed, spoilt anew.

Poses come from the visual-inertial odometry, which sees none of the faults: it has its own table (`dvio_faults`). What
passes goes wrong before each first step up and down, when the change ought to be seen.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.locomotion_mode import INSOLES
from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.mode_walks import SENSORS, posed, scored, tell
from stridetwin.scenarios.experiments.odometry_walks import recorded
from stridetwin.scenarios.experiments.spoilt import Samples, Spoilt
from stridetwin.scenarios.experiments.walks import falls, fell_at_s
from stridetwin.scenarios.footprints import true_footprints
from stridetwin.scenarios.mode_figures import mode_figures
from stridetwin.scenarios.mode_score import ModeScores
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.scenarios.terrain_files import depth_camera
from stridetwin.sim.body import wearer
from stridetwin.sim.config import Gait, Gaze
from stridetwin.sim.sample_faults import Dropout
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Depth, Insole, Odometry

WALKS = ("zhao_stair_15cm", "zhao_ramp_11_8")
MOUNTS = ("head", "chest")
SEEDS = range(1000, 1004)
BEFORE_S, LASTS_S = 3.0, 2.0
"""How long before a foot first lands beyond a change a fault begins, and how long it lasts."""
SEEN, SEEN_M = 0.20, 4.5
SURE = 0.9
_TURN_RAD, _SHIFT_M = 1.2, (3.0, -2.0, 0.5)
"""From the odometry's old frame to its new one, each time that it begins anew."""


def _begun_anew(begins_s: Sequence[float]) -> Callable[[Samples], Samples]:
    """No poses for a while, each time; those that come then are in a frame of their own."""

    def spoil(samples: Samples) -> Samples:
        for s in samples:
            if isinstance(s, Odometry):
                since = [s.t_ns * 1e-9 - begin for begin in begins_s if s.t_ns * 1e-9 >= begin]
                if since and since[-1] < LASTS_S:
                    continue
                turn = Rotation.from_rotvec([0.0, 0.0, len(since) * _TURN_RAD])
                q = turn * Rotation.from_quat(s.q_world_frame, scalar_first=True)
                s = replace(
                    s, p_frame_in_world=turn.apply(s.p_frame_in_world) + len(since) * np.array(_SHIFT_M),
                    q_world_frame=q.as_quat(scalar_first=True),
                )  # fmt: skip
            yield s

    return spoil


def _dead_insole(samples: Samples) -> Samples:
    for s in samples:
        if isinstance(s, Insole) and s.topic == "/foot_l/insole":
            s = replace(s, force=np.zeros_like(s.force))
        yield s


def _looks_up(samples: Samples) -> Samples:
    """Of the ground within reach the upper part of the picture alone is seen: the camera looks too high."""
    for s in samples:
        if isinstance(s, Depth):
            ground = ((s.depth > 0.0) & (s.depth < SEEN_M)).sum(axis=1).cumsum()
            rows = int(np.searchsorted(ground, SEEN * ground[-1]))
            depth = s.depth.copy()
            depth[rows:] = 0.0
            s = replace(s, depth=depth)
        yield s


def faults(mount: str, begins_s: Sequence[float]) -> dict[str, Spoilt]:
    """By name; what passes begins at these instants."""
    off = tuple(
        Dropout(topic=f"/{mount}/depth", at_s=at, duration_s=LASTS_S, name=f"off {k}") for k, at in enumerate(begins_s)
    )
    return {
        "none": Spoilt(words="nothing wrong"),
        "odometry_lost": Spoilt(
            words=f"odometry lost for {LASTS_S:g} s, then in another frame", samples=_begun_anew(begins_s)
        ),
        "depth_off": Spoilt(words=f"no depth for {LASTS_S:g} s", faults=off),
        "insole_dead": Spoilt(words="left insole dead", samples=_dead_insole),
        "looks_up": Spoilt(words=f"{SEEN:.0%} of the terrain in view, the farthest", samples=_looks_up),
    }


NAMES = {name: spoilt.words for name, spoilt in faults("head", ()).items()}


def run_case(case: Case) -> dict[str, Any]:
    """Both walks, spoilt in every way.

    Returns:
        `seed`, `physics`, `mount`, `fell`, and `faults`: name to the rows of each walk.
    """
    mount = MOUNTS[case.seed % len(MOUNTS)]
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in NAMES}
    fell = []
    for scenario in WALKS:
        config = replace(
            load_scenario(scenario).config, sensors=SENSORS, physics=case.physics, exo=None, rig_mount=mount,
            gait=Gait(gaze=Gaze(kind="wandering")),
        )  # fmt: skip
        sole_m = wearer(config.person, with_exo=False).body.shoe_length_m
        with recorded(config, case, f"{mount}_{config.name}") as recording:
            poses = [s for s in posed(recording, mount, "dvio") if isinstance(s, Odometry)]
            for name, spoilt in faults(mount, begins_s(recording)).items():
                others = recording.samples([*INSOLES, depth_camera(recording.rig).depth_topic])
                samples = heapq.merge(poses, others, key=lambda s: s.t_ns)
                arriving = spoilt.arriving(samples, recording.rig, case.seed, recording.duration)
                found[name].append(scored(tell(arriving, recording), recording, sole_m)["proposed"].rows())
            if fell_at_s(recording) is not None:
                fell.append(config.name)
    return {"seed": case.seed, "physics": case.physics, "mount": mount, "fell": fell, "faults": found}


def begins_s(recording: Recording) -> list[float]:
    """When a fault begins: before each first step up or down."""
    prints = true_footprints(recording)
    firsts = [b.t_ns * 1e-9 for a, b in pairwise(prints) if a.mode == "LG" != b.mode]
    return [t - BEFORE_S for t in firsts]


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, over all walks; nothing of the paper's, which has no faults."""
    return {"summary": {n: _figures([w for r in results for w in r["faults"][n]]) for n in NAMES}, "paper": {}}


def _figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """`mode_figures`, and how sure what was told is.

    Returns:
        Besides those: `probability_right` and `probability_wrong`, means of the told modes'; `wrong`, `sure_and_wrong`
        and `untold`, numbers of steps: told wrongly, and with more than `SURE`, and not told of.
    """
    walks = [ModeScores.of(row) for row in rows]
    steps = [s for w in walks for s in w.steps]
    told = [(max(s.probabilities), s.right) for s in steps if s.probabilities]
    right, wrong = ([p for p, right in told if right is which] for which in (True, False))
    return {
        **mode_figures(walks),
        "probability_right": float(np.mean(right)) if right else None,
        "probability_wrong": float(np.mean(wrong)) if wrong else None,
        "sure_and_wrong": sum(p > SURE for p in wrong),
        "wrong": len(wrong),
        "untold": len(steps) - len(told),
    }


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text."""
    lines = [
        f"{len(result['cases'])} walks each of {' and '.join(WALKS)}; p: told probability of the mode that was told",
        falls(result["cases"]),
        f"{'':<46}{'steps':>6}{'right %':>9}{'transitions %':>15}{'lead s':>8}{'5 %':>6}{'p right':>9}{'p wrong':>9}"
        f"{'wrong':>7}{f'p > {SURE:g}':>9}{'untold':>8}{'cal. error':>12}",
    ]
    for name, words in NAMES.items():
        of = result["summary"][name]
        lines.append(
            f"{words:<46}{of['steps']:>6}{of['accuracy_pct']:>9.1f}{of['transition_accuracy_pct']:>15.1f}"
            f"{of['lead_time_s']['median']:>8.1f}{of['lead_time_s']['p5']:>6.1f}{_cell(of['probability_right'])}"
            f"{_cell(of['probability_wrong'])}{of['wrong']:>7}{of['sure_and_wrong']:>9}{of['untold']:>8}"
            f"{of['calibration_error']:>12.3f}"
        )
    return lines


def _cell(value: float | None) -> str:
    return f"{'-':>9}" if value is None else f"{value:>9.3f}"
