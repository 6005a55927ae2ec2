"""Contribution of an exoskeleton's legs: modes of coming steps from the camera, from the legs, and from both.

A stair and a ramp are walked once per seed in the exoskeleton, and evaluated in light and in darkness, where images
have no depth from the first step up on. Poses come from the visual-inertial odometry with light in both cases. The legs
alone (`contact_terrain`) know a step only after it: they predict that the next one is like the last.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypedDict

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators.base import PROPOSED
from stridetwin.estimators.contact_terrain import ContactTerrain, StepEstimate
from stridetwin.outputs.modes.scores import ModeFigures, ModeRows, ModeScores, mode_figures
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.outputs.truth import true_footprints
from stridetwin.scenarios.exo_geometry import exo_from_recording
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Sample
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.result import CaseRow, Collected, LabelledFigures, NoPaper, Result
from stridetwin.studies.walks import fell_at_s, record_walk
from stridetwin.studies.zhao2023.mode_walks import predict, samples_with_poses, score_predictions, sole_length_m

ESTIMATORS = ("contact_terrain", "dvio", "locomotion_mode", "terrain_map")
"""Estimators whose parameters `--set` changes here."""

LIGHTS = ("light", "dark")
"""Light of an evaluation: as recorded, or dark from the first step up on."""
BY = ("camera", "both", "legs")
"""Sources of the modes. The first two run the predictor; the legs alone only repeat the mode of the last step."""
_BY_PREDICTOR = BY[:2]
_WORDS = {
    "light": "in the light",
    "dark": "dark from the first step up on",
    "camera": "camera",
    "both": "camera and legs",
    "legs": "legs alone",
}


class FusionRow(CaseRow):
    """The row of a case.

    Attributes:
        fell: Names of the walks that ended by a fall.
        predicted: By light and source of the modes, the rows of each walk.
        legs: Of every step, the true mode, that of the previous step, and the prediction by the legs alone.
    """

    fell: list[str]
    predicted: dict[str, dict[str, list[ModeRows]]]
    legs: list[tuple[str, str, str]]


class FusionSummary(TypedDict):
    """Figures over all walks.

    Attributes:
        light: In the light, by source of the modes.
        dark: In the dark, by source of the modes.
        legs: Of the legs alone, which the light does not change: `steps`, `accuracy_pct`, `transition_accuracy_pct`.
    """

    light: dict[str, ModeFigures]
    dark: dict[str, ModeFigures]
    legs: dict[str, float]


def run_case(case: ExperimentCase) -> Row:
    """Predicts the modes of all walks of a case, in light and in darkness.

    Returns:
        The case's row with `fell`, the walks that ended by a fall; `predicted`: light to `camera` and `both` to the
        rows of each walk; and `legs`: true mode, that of the previous step, and the legs' prediction, for every step.
    """
    predicted_rows: dict[str, dict[str, list[ModeRows]]] = {light: {by: [] for by in _BY_PREDICTOR} for light in LIGHTS}
    legs: list[tuple[str, str, str]] = []
    fell = []
    for walk in case.walks():
        with record_walk(walk, case) as recording:
            # what the predictor reads: poses of the odometry, depth and insoles; and the steps that the legs estimate
            feed = list(samples_with_poses(recording, walk.config.rig_mount, "dvio"))
            steps = leg_steps(recording)
            for light in LIGHTS:
                samples = feed if light == "light" else list(_darken(feed, _first_up_ns(recording)))
                for by in _BY_PREDICTOR:
                    inputs: list[Sample | StepEstimate] = [*samples, *(steps if by == "both" else ())]
                    inputs.sort(key=lambda s: s.t_ns)
                    predictions = predict(inputs, recording, ("proposed",))
                    scores = score_predictions(predictions, recording, sole_length_m(walk.config))
                    predicted_rows[light][by].append(scores["proposed"].rows())
            legs += _predict_like_last(recording, steps)
            if fell_at_s(recording) is not None:
                fell.append(walk.config.name)
    return case.row(fell=fell, predicted=predicted_rows, legs=legs)


def leg_steps(recording: Recording) -> list[StepEstimate]:
    """All step estimates from the legs, in time order."""
    exo = exo_from_recording(recording)
    legs = ContactTerrain(recording.rig, exoskeleton=exo, **parameter_keywords(ContactTerrain, PROPOSED))
    return [step for s in recording.samples(list(exo.topics)) if (step := legs.update(s)) is not None]


def _first_up_ns(recording: Recording) -> int:
    """Time of the touch-down of the first step up a stair (SA) or ramp (RA), ns; each of these walks has one."""
    return next(f.t_ns for f in true_footprints(recording) if f.mode in ("SA", "RA"))


def _darken(samples: Iterable[Sample], since_ns: int) -> Iterator[Sample]:
    """Passes on the samples, with empty depth images (depth 0) from a time on."""
    for sample in samples:
        if isinstance(sample, Depth) and sample.t_ns >= since_ns:
            yield replace(sample, depth=np.zeros_like(sample.depth))
        else:
            yield sample


def _predict_like_last(recording: Recording, steps: list[StepEstimate]) -> list[tuple[str, str, str]]:
    """Predicts each step of a walk by the legs alone: it is like the last step that they had estimated before it.

    Args:
        recording: The walk, with the truth.
        steps: All step estimates from the legs, in time order.

    Returns:
        For each true step: its true mode, that of the previous step, and the predicted one; level (LG) where no step
        came before.
    """
    t_ns = np.array([s.t_ns for s in steps])
    predictions = []
    before = "LG"  # mode of the previous step
    for footprint in true_footprints(recording)[2:]:  # without the two initial ones
        last = int(np.searchsorted(t_ns, footprint.t_ns)) - 1  # number of the last estimate before touch-down
        predictions.append((footprint.mode, before, steps[last].mode if last >= 0 else "LG"))
        before = footprint.mode
    return predictions


def collect(results: list[FusionRow]) -> Collected[FusionSummary, NoPaper]:
    """Figures by light and by source over all walks; no paper has such a table."""
    light, dark = (
        {
            by: mode_figures([ModeScores.of(walk) for row in results for walk in row["predicted"][name][by]])
            for by in _BY_PREDICTOR
        }
        for name in LIGHTS
    )
    # scored steps of all walks, and the legs' prediction of each
    camera_steps = [s for r in results for w in r["predicted"]["light"]["camera"] for s in ModeScores.of(w).steps]
    predicted = [mode for r in results for _, _, mode in r["legs"]]
    # for each step, whether the legs' prediction is one of the modes that count as right, as for the camera, and
    # whether the step is a transition: its mode differs from that of the previous step
    right = [(mode in s.allowed, s.is_transition) for s, mode in zip(camera_steps, predicted, strict=True)]
    right_transitions = [is_right for is_right, is_transition in right if is_transition]
    legs = {
        "steps": len(predicted),
        "accuracy_pct": 100.0 * float(np.mean([is_right for is_right, _ in right])),
        "transition_accuracy_pct": 100.0 * float(np.mean(right_transitions)),
    }
    return {"summary": {"light": light, "dark": dark, "legs": legs}, "paper": {}}


def rows(result: Result[FusionSummary, NoPaper, FusionRow]) -> list[LabelledFigures]:
    """Figures by light and source, for the table."""
    summary = result["summary"]
    by_light: list[LabelledFigures] = [
        (f"{_WORDS[light]}, {_WORDS[by]}", figures[by])
        for light, figures in (("light", summary["light"]), ("dark", summary["dark"]))
        for by in _BY_PREDICTOR
    ]
    return [*by_light, (_WORDS["legs"], summary["legs"])]
