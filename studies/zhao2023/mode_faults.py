"""Locomotion-mode prediction under injected faults.

Poses come from the visual-inertial odometry without faults; its own faults are in `dvio_faults`. Temporary faults begin
before each first step up and down, when the terrain change should be detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators.base import CAMERA_POSES, POSES
from stridetwin.estimators.locomotion_mode import INSOLES
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.modes.scores import ModeRows, ModeScores, mode_figures
from stridetwin.outputs.pose_feed import merge_poses
from stridetwin.outputs.truth import true_footprints
from stridetwin.scenarios.metadata import fault_metadata
from stridetwin.sim.faults.faults import Fault, TimedFault
from stridetwin.streams.pose_restart import restart_poses
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Odometry
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.fault_injection import fault_plans, summarize_by_fault
from stridetwin.studies.result import Collected, FaultRow, Figures, NoPaper
from stridetwin.studies.walks import fell_at_s, record_walk
from stridetwin.studies.zhao2023.mode_walks import (
    predict,
    samples_with_poses,
    score_predictions,
    sole_length_m,
    trajectory,
)

ESTIMATORS = ("dvio", "locomotion_mode", "terrain_map")
"""Estimators whose parameters `--set` changes here."""

FAULT_LEAD_S = 3.0
"""A temporary fault begins this long before a foot first lands beyond a terrain change, s."""
SURE = 0.9  # a wrong prediction with a higher probability is sure and wrong


def run_case(case: ExperimentCase) -> Row:
    """Predicts the modes of all walks of a case by our method, with each fault.

    Returns:
        The case's row with `fell`, the walks that ended by a fall, and `faults`: label to our rows of each walk.
    """
    rows_of_fault: dict[str, list[ModeRows]] = {}
    fell = []
    for walk in case.walks():
        with record_walk(walk, case) as recording:
            # the odometry runs once, without faults; its poses are merged with the faulty samples again
            feed = [s for s in samples_with_poses(recording, walk.config.rig_mount, "dvio") if isinstance(s, Odometry)]
            # poses of the camera's IMU, and of the camera on it
            poses, camera = (trajectory([s for s in feed if s.topic == topic]) for topic in (POSES, CAMERA_POSES))
            statuses = np.array([getattr(s, "status", "") for s in feed if s.topic == POSES])
            topics = [*INSOLES, depth_calibration(recording.rig).depth_topic]  # what the predictor reads besides poses
            times = partial(repeat_fault, times_s=fault_times_s(recording))
            for label, plan in fault_plans(case, recording.rig, recording.duration, times).items():
                # a fault may also restart the odometry, after which its poses are in another frame
                restarted = restart_poses(poses, fault_metadata(plan.planned))
                samples = merge_poses(restarted, recording, topics, camera, statuses)
                predictions = predict(plan.samples(samples), recording)
                rows = score_predictions(predictions, recording, sole_length_m(walk.config))["proposed"].rows()
                rows_of_fault.setdefault(label, []).append(rows)
            if fell_at_s(recording) is not None:
                fell.append(walk.config.name)
    return case.row(fell=fell, faults=rows_of_fault)


def repeat_fault(fault: Fault, times_s: Sequence[float]) -> list[Fault]:
    """A temporary fault once at each of the given times, s; any other fault as it is."""
    if isinstance(fault, TimedFault) and fault.duration_s is not None:
        return [replace(fault, at_s=t, name=f"{fault.full_name} {t:.3f}") for t in times_s]
    return [fault]


def fault_times_s(recording: Recording) -> list[float]:
    """Times at which a temporary fault begins, s: `FAULT_LEAD_S` before each first step up or down."""
    prints = true_footprints(recording)
    # touch-downs of the steps that leave level ground (LG), s
    firsts_s = [after.t_ns * 1e-9 for before, after in pairwise(prints) if before.mode == "LG" and after.mode != "LG"]
    return [t_s - FAULT_LEAD_S for t_s in firsts_s]


def collect(results: list[FaultRow[list[ModeRows]]]) -> Collected[dict[str, Figures], NoPaper]:
    """Figures by fault over all walks."""
    # a case has the rows of several walks
    return summarize_by_fault(results, lambda cases: _fault_figures([row for rows in cases for row in rows]))


def _fault_figures(rows: list[ModeRows]) -> Figures:
    """Figures of the walks with one fault: those of `mode_figures`, and how sure the predictions were.

    The latter are the mean probability of right and of wrong predictions, and numbers of steps: predicted wrongly
    (`wrong`), with more than `SURE` (`sure_and_wrong`), and not predicted (`not_predicted`).
    """
    walks = [ModeScores.of(row) for row in rows]
    steps = [s for w in walks for s in w.steps]
    # probability of the predicted mode, and whether it was right, for the steps that were predicted
    predicted = [(max(s.probabilities), s.is_correct) for s in steps if s.probabilities]
    right = [probability for probability, is_correct in predicted if is_correct]
    wrong = [probability for probability, is_correct in predicted if not is_correct]
    return {
        **mode_figures(walks),
        "probability_right": float(np.mean(right)) if right else None,
        "probability_wrong": float(np.mean(wrong)) if wrong else None,
        "sure_and_wrong": sum(p > SURE for p in wrong),
        "wrong": len(wrong),
        "not_predicted": len(steps) - len(predicted),
    }
