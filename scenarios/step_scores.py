"""What steps that were told come to beside the true ones: errors, honesty of the deviations, classes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stridetwin.estimators import registry
from stridetwin.estimators.base import STEPS
from stridetwin.estimators.contact_terrain import UNKNOWN, StepEstimate
from stridetwin.scenarios.footprints import FOOTPRINTS
from stridetwin.scenarios.pipeline import Found, fed
from stridetwin.scenarios.pipeline import steps as steps_of
from stridetwin.scenarios.scoring import Scores
from stridetwin.scenarios.steps import ScoredStep, displacement_errors, false_steps, score_steps
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class StepResult:
    """An estimator of steps on one recording.

    Attributes:
        estimates: What was told, one a step.
        steps: Beside the truth.
        scores: See `step_scores`; and `false_pct`, of all steps that were told, those that are none.
    """

    estimates: list[StepEstimate]
    steps: list[ScoredStep]
    scores: Scores


def evaluate_every_step(recording: Recording) -> dict[str, StepResult]:
    """Every estimator of steps that the recording feeds, by name; none without the truth of its footprints.

    Raises:
        RecordingError: As `evaluate_steps`.
    """
    if FOOTPRINTS not in recording.topics:
        return {}
    every = registry.estimators(STEPS)
    return {name: evaluate_steps(recording, found) for name, found in every.items() if fed(found, recording)}


def evaluate_steps(recording: Recording, found: Found) -> StepResult:
    """Runs the default method of an estimator of steps on a recording that feeds it, and scores it.

    Raises:
        RecordingError: Not one of its steps is a step of the truth.
    """
    made = steps_of(found, recording)
    footprints = list(recording.block(FOOTPRINTS))
    steps = score_steps(footprints, made)
    if not any(s.seen for s in steps):
        name = found.declaration.name
        raise RecordingError(f"{recording.path}: {name} matched none of the {len(steps)} true steps")
    false_pct = 100.0 * false_steps(footprints, made) / len(made)
    return StepResult(estimates=made, steps=steps, scores={**step_scores(steps), "false_pct": false_pct})


def step_scores(steps: Sequence[ScoredStep]) -> Scores:
    """Every score of one walk, of whose steps one was seen at least.

    Returns:
        `slope_rmse_deg`, `elevation_rmse_mm`, `slope_in_95_pct`, `elevation_in_95_pct`; of all steps, missed ones
        too, `classification_accuracy_pct`, `unknown_pct`, `missed_pct`; `{d,h,y}_rmse_mm`, the error of the whole
        displacement over the number of steps, along the world's x, z and y; `end_error_m`, `end_error_pct`, from the
        first footprint seen to the last; `steps`.
    """
    figures = step_figures(steps, displacement_errors(steps, ""))
    seen = [s for s in steps if s.seen]
    places, told = np.array([s.place for s in seen]), np.array([s.told_place for s in seen])
    end = float(np.linalg.norm((told[-1] - told[0]) - (places[-1] - places[0])))
    way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    left_out = ("slope_mean_deg", "elevation_mean_mm", "steps_missed")
    return {
        **{k: float(v) for k, v in figures.items() if k not in left_out},
        "unknown_pct": percent(s.told_mode == UNKNOWN for s in steps),
        "missed_pct": percent(not s.seen for s in steps),
        "end_error_m": end,
        **({"end_error_pct": 100.0 * end / way} if way > 0.0 else {}),
    }


def step_figures(
    steps: Sequence[ScoredStep], places: Sequence[tuple[float, float, float]]
) -> dict[str, float]:  # fmt: skip
    """RMS and mean errors of the steps that were seen, classes of all of them.

    Args:
        steps: Of any walks.
        places: Errors of displacements a step, m; `displacement_errors`. Without any their RMS is left out.
    """
    seen = [s for s in steps if s.seen]
    slope = np.degrees([s.slope_error for s in seen])
    elevation = 1e3 * np.array([s.elevation_error for s in seen])
    figures = {
        "slope_rmse_deg": _rms(slope),
        "slope_mean_deg": float(slope.mean()) if len(slope) else 0.0,
        "elevation_rmse_mm": _rms(elevation),
        "elevation_mean_mm": float(elevation.mean()) if len(elevation) else 0.0,
        **_inside(seen),
        "classification_accuracy_pct": percent(s.told_mode == s.mode for s in steps),
        "steps": len(steps),
        "steps_missed": len(steps) - len(seen),
    }
    if len(places):
        d, h, y = (_rms(1e3 * np.array(axis)) for axis in zip(*places))
        figures |= {"d_rmse_mm": d, "h_rmse_mm": h, "y_rmse_mm": y}
    return figures


def _inside(seen: Sequence[ScoredStep]) -> dict[str, float]:
    """Share of errors inside the 95 % interval; nothing where the method tells none."""
    slope = [abs(s.slope_error) < 1.96 * s.slope_sd for s in seen if s.slope_sd is not None]
    elevation = [abs(s.elevation_error) < 1.96 * s.elevation_sd for s in seen if s.elevation_sd is not None]
    if not slope or not elevation:
        return {}
    return {"slope_in_95_pct": percent(slope), "elevation_in_95_pct": percent(elevation)}


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def percent(right: Iterable[Any]) -> float:
    """Share of what is true, %; 0 of nothing."""
    answers = list(right)
    return 100.0 * sum(map(bool, answers)) / len(answers) if answers else 0.0
