"""False-positive test: short level walks, each with a trap that resembles a stair or ramp, from rendered images on.

Poses come from the visual-inertial odometry on the same images. Every step of every walk is LG, also those over a kerb
of 4 cm. Seeds alternate between head and chest.
"""

from __future__ import annotations

from collections import Counter
from typing import TypedDict

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators.locomotion_mode import METHODS, MODES, ModeEstimate
from stridetwin.outputs.modes.scores import ModeScores
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.result import CaseRow, Collected, Figures, LabelledFigures, NoPaper, Result
from stridetwin.studies.walks import fell_at_s, record_walk
from stridetwin.studies.zhao2023.mode_walks import predict, samples_with_poses, score_predictions, sole_length_m

ESTIMATORS = ("dvio", "locomotion_mode", "terrain_map")
"""Estimators whose parameters `--set` changes here."""


class TrapRow(TypedDict):
    """A method on the walk past one trap.

    Attributes:
        steps: Rows of its steps (`ScoredMode`).
        alarms_pct: Share of the estimates that predict a terrain change, or a step in another mode than LG, %.
    """

    steps: list[dict[str, object]]
    alarms_pct: float


class TrapsRow(CaseRow):
    """The row of a case.

    Attributes:
        fell: Traps on whose walks the walker fell.
        traps: By trap and method, what came of the walk.
    """

    fell: list[str]
    traps: dict[str, dict[str, TrapRow]]


TrapSummary = dict[str, dict[str, Figures]]
"""Figures by method and trap."""


def run_case(case: ExperimentCase) -> Row:
    """Predicts the modes of one walk per trap.

    Returns:
        The case's row with `fell`, the traps on whose walks the walker fell, and `traps`: trap to method to `steps` and
        `alarms_pct` (`TrapRow`).
    """
    figures_of_trap: dict[str, dict[str, TrapRow]] = {}
    fell = []
    for walk in case.walks():
        trap = walk.labels["trap"]
        with record_walk(walk, case) as recording:
            # poses from the odometry (`dvio`), predictions by each of `METHODS`
            predictions = predict(samples_with_poses(recording, walk.config.rig_mount, "dvio"), recording)
            scores = score_predictions(predictions, recording, sole_length_m(walk.config))
            if fell_at_s(recording) is not None:
                fell.append(trap)
        figures_of_trap[trap] = {
            m: {"steps": scores[m].rows()["steps"], "alarms_pct": _alarm_share_pct(predictions.estimates[m])}
            for m in METHODS
        }
    return case.row(fell=fell, traps=figures_of_trap)


def _alarm_share_pct(estimates: list[ModeEstimate]) -> float:
    """Share of the estimates that predict a terrain change or a step in another mode than LG, %."""
    wrong = sum(e.change is not None or any(s.mode != "LG" for s in e.steps) for e in estimates)
    return 100.0 * wrong / max(len(estimates), 1)


def collect(results: list[TrapsRow]) -> Collected[TrapSummary, NoPaper]:
    """Figures by method and trap over all walks; the paper has no such table."""
    return {
        # a row has trap, then method; the summary has method, then trap, each with the rows of all cases
        "summary": {
            m: {trap: _trap_figures([r["traps"][trap][m] for r in results]) for trap in results[0]["traps"]}
            for m in METHODS
        },
        "paper": {},
    }


def _trap_figures(walks: list[TrapRow]) -> Figures:
    """Figures of one method on one trap over walks.

    Returns:
        `steps`, their number; `accuracy_pct`; `predicted`, number of steps by predicted mode, with "" for steps without
        prediction; `none`, the number of the latter; `least_probability` of the true mode of any step; `alarms_pct`,
        mean over the walks.
    """
    steps = [step for w in walks for step in ModeScores.of({"steps": w["steps"], "approaches": []}).steps]
    predicted = Counter(s.predicted for s in steps)
    # of the true mode, for the steps that were predicted
    probabilities = [s.probabilities[MODES.index(s.mode)] for s in steps if s.probabilities]
    return {
        "steps": len(steps),
        "accuracy_pct": 100.0 * sum(s.is_correct for s in steps) / max(len(steps), 1),
        "predicted": {m: predicted[m] for m in (*MODES, "")},
        "none": predicted[""],
        "least_probability": min(probabilities, default=None),
        "alarms_pct": float(np.mean([w["alarms_pct"] for w in walks])),
    }


def rows(result: Result[TrapSummary, NoPaper, TrapsRow]) -> list[LabelledFigures]:
    """Figures by trap, for the table: ours, and the published method's accuracy."""
    ours, published = (result["summary"][m] for m in METHODS)  # `METHODS` names ours first
    return [(trap, {**ours[trap], "published": published[trap]["accuracy_pct"]}) for trap in ours]
