"""Gait phase of each leg: 0 % at its touch-down, 100 % at the next one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar

from stridetwin.estimators.base import AnyEstimator, Declaration
from stridetwin.estimators.gait_phase import PhaseEstimate
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import (
    Collector,
    EveryEstimate,
    FileOptions,
    LiveOutput,
    Output,
    OutputKind,
    ReportParts,
    Score,
    Written,
)
from stridetwin.outputs.csv_tables import write_output_table
from stridetwin.outputs.feeding import Instance
from stridetwin.outputs.gait_phase.files import COLUMNS, LivePhases, phase_rows
from stridetwin.outputs.gait_phase.scores import (
    SCORES,
    EvaluatedPhases,
    PhaseSeries,
    phase_scores,
    to_phase_series,
    true_strides,
)
from stridetwin.outputs.rerun_curves import log_curves
from stridetwin.outputs.truth import FOOTPRINTS, true_footprints
from stridetwin.streams.recording.reader import Recording

if TYPE_CHECKING:
    from rerun import RecordingStream


class GaitPhases(OutputKind[PhaseSeries, EvaluatedPhases]):
    """Gait phases of the legs, one table per leg."""

    order: ClassVar[int] = 50
    scores: ClassVar[tuple[Score, ...]] = SCORES

    def collector(
        self, estimator: AnyEstimator, instance: Instance, walk: AlignedWalk | None = None
    ) -> Collector[PhaseSeries]:
        """Collects every phase of the instance's foot; neither the estimator's state nor a walk is needed."""
        foot = instance.options.foot
        return EveryEstimate(f"{instance.declaration.name}_{foot}", PhaseEstimate, partial(to_phase_series, foot=foot))

    def has_truth(self, recording: Recording) -> bool:
        """Whether the recording has true footprints."""
        return FOOTPRINTS in recording.topics

    def evaluate(
        self, outputs: Sequence[Output[PhaseSeries]], recording: Recording, alignment: str = "start"
    ) -> list[EvaluatedPhases]:
        """Scores each leg's phases against its true strides.

        Args:
            outputs: Phases of each leg.
            recording: The recording with the true footprints.
            alignment: Unused: a phase has no position that would have to be aligned with the truth.

        Returns:
            One evaluation per leg. A leg without a stride that counts has no scores and is left out.
        """
        footprints, evaluations = true_footprints(recording), []
        for output in outputs:
            strides = true_strides(footprints, output.estimates.foot)
            scores = phase_scores(output.estimates, strides)
            if scores:
                evaluations.append(
                    EvaluatedPhases(name=output.name, estimates=output.estimates, strides=strides, scores=scores)
                )
        return evaluations

    def write(self, output: Output[PhaseSeries], file: Path, options: FileOptions) -> Written:
        """Writes a table of `COLUMNS`, one row per sample."""
        return write_output_table(COLUMNS, phase_rows(output.estimates), file, "phases")

    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """Rows of `COLUMNS`, one per sample."""
        return LivePhases(COLUMNS, file)

    def report(self, evaluations: Sequence[EvaluatedPhases], recording: Recording) -> ReportParts:
        """Section with phase over time, error over the cycle, and scores of every leg."""
        from stridetwin.outputs.gait_phase.figures import phase_section

        return ReportParts(figures=phase_section(evaluations))

    def rerun_views(self, evaluations: Sequence[EvaluatedPhases]) -> dict[str, tuple[str, str]]:
        """A view of the phases over time."""
        return {"phase": ("series", "gait phase")}

    def log_rerun(
        self, rerun: ModuleType, stream: RecordingStream, evaluations: Sequence[EvaluatedPhases], recording: Recording
    ) -> None:
        """Logs the phase of each leg over time as `phase/NAME`; the evaluations need no recording."""
        for evaluation in evaluations:
            series = evaluation.estimates
            log_curves(rerun, stream, f"phase/{evaluation.name}", series.t_ns, series.phase[:, None], ("",))
