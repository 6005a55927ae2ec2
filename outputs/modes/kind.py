"""Mode, place and time of the coming steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from stridetwin.estimators.base import AnyEstimator, Declaration
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import (
    Collector,
    Evaluated,
    EveryEstimate,
    FileOptions,
    LiveOutput,
    Output,
    OutputKind,
    ReportParts,
    Score,
    Written,
)
from stridetwin.outputs.coverage import COVERAGE, compute_covered_share
from stridetwin.outputs.csv_tables import write_output_table
from stridetwin.outputs.feeding import Instance
from stridetwin.outputs.modes.files import MODE_COLUMNS, LiveModes, find_completed_steps, mode_cells
from stridetwin.outputs.modes.scores import SCORES, ModeScores, score_modes, scores_of_walk
from stridetwin.outputs.truth import walking_span_ns
from stridetwin.streams.recording.reader import Recording

if TYPE_CHECKING:
    from rerun import RecordingStream


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeRun:
    """The result of a predictor of modes on a recording.

    Attributes:
        estimates: All predictions in time order.
        walk: The walk beside the truth; None without a truth.
    """

    estimates: list[ModeEstimate]
    walk: AlignedWalk | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluatedModes(Evaluated[list[ModeEstimate]]):
    """Predicted steps, in time order, beside the true ones.

    Attributes:
        modes: Every true step and terrain change, with its prediction.
        walk: The walk beside the truth.
    """

    modes: ModeScores
    walk: AlignedWalk


class Modes(OutputKind[ModeRun, EvaluatedModes]):
    """Modes, places and times of coming steps, one table row per step."""

    order: ClassVar[int] = 40
    scores: ClassVar[tuple[Score, ...]] = SCORES
    takes_poses: ClassVar[bool] = True
    options: ClassVar[frozenset[str]] = frozenset({"poses"})

    def collector(
        self, estimator: AnyEstimator, instance: Instance, walk: AlignedWalk | None = None
    ) -> Collector[ModeRun]:
        """Collects every prediction, with the walk beside the truth; the estimator's own state is not needed."""

        def pack(estimates: list[ModeEstimate]) -> ModeRun:
            """The estimates with the walk beside the truth."""
            return ModeRun(estimates=estimates, walk=walk)

        return EveryEstimate(instance.declaration.name, ModeEstimate, pack)

    def evaluate(
        self, outputs: Sequence[Output[ModeRun]], recording: Recording, alignment: str = "start"
    ) -> list[EvaluatedModes]:
        """Scores the predictions against the true footprints and terrain.

        Args:
            outputs: Predictions of each estimator; those without a truth are left out.
            recording: Unused: each output has the truth in its walk.
            alignment: Unused: each output's walk has its own alignment, one per instant.
        """
        evaluations = []
        for output in outputs:
            walk, estimates = output.estimates.walk, output.estimates.estimates
            if walk is not None:
                modes = score_modes(walk.footprints, estimates, walk.alignment, walk.layout, walk.sole_m)
                t_ns = np.array([estimate.t_ns for estimate in estimates], np.int64)
                covered = compute_covered_share(t_ns, *walking_span_ns(walk.footprints))
                scores = {**scores_of_walk(modes), COVERAGE.name: 100.0 * covered}
                evaluations.append(
                    EvaluatedModes(name=output.name, estimates=estimates, modes=modes, walk=walk, scores=scores)
                )
        return evaluations

    def write(self, output: Output[ModeRun], file: Path, options: FileOptions) -> Written:
        """Writes a table of `MODE_COLUMNS` with the last prediction of each step."""
        rows = [mode_cells(step) for step in find_completed_steps(output.estimates.estimates)]
        return write_output_table(MODE_COLUMNS, rows, file, "steps")

    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """Rows of `MODE_COLUMNS` with the next step, one per prediction."""
        return LiveModes(file)

    def report(self, evaluations: Sequence[EvaluatedModes], recording: Recording) -> ReportParts:
        """Section with the steps of the first estimator from above, modes over time, lead times, and its scores."""
        from stridetwin.outputs.modes.figures import mode_section

        first = evaluations[0]
        return ReportParts(figures=mode_section(first.estimates, first.modes, first.walk, first.scores))

    def rerun_views(self, evaluations: Sequence[EvaluatedModes]) -> dict[str, tuple[str, str]]:
        """Views of the prediction as text and of the probabilities of the next step; none without estimates."""
        if not any(evaluation.estimates for evaluation in evaluations):
            return {}
        return {"modes/predicted": ("text", "prediction"), "modes/probability": ("series", "next step")}

    def log_rerun(
        self, rerun: ModuleType, stream: RecordingStream, evaluations: Sequence[EvaluatedModes], recording: Recording
    ) -> None:
        """Logs the true and the predicted footprints, and the modes, of the first estimator; it needs no recording."""
        from stridetwin.outputs.modes.rerun import log_modes

        log_modes(rerun, stream, evaluations[0].estimates, evaluations[0].walk)
