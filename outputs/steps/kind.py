"""Slope, height and class of each step."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from stridetwin.estimators.base import AnyEstimator, Declaration
from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import (
    Collector,
    Evaluated,
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
from stridetwin.outputs.steps.files import STEP_COLUMNS, LiveSteps, step_cells
from stridetwin.outputs.steps.scores import SCORES, ScoredStep, false_steps, score_steps, step_scores
from stridetwin.outputs.truth import FOOTPRINTS, true_footprints
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Sample


class StepCollector(Collector[list[StepEstimate]]):
    """Collects the last estimate of each step; step 0, at which the person stands, is left out."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._last: dict[int, StepEstimate] = {}

    def add(self, sample: Sample, estimate: object) -> None:
        """Keeps the estimate of a step in the place of an earlier one."""
        if isinstance(estimate, StepEstimate) and estimate.step > 0:
            self._last[estimate.step] = estimate

    def outputs(self) -> list[Output[list[StepEstimate]]]:
        """The only output: the last estimate of each step, in order."""
        return [Output(name=self._name, estimates=[self._last[step] for step in sorted(self._last)])]


EvaluatedSteps = Evaluated[list[ScoredStep]]
"""Every true step, with its estimate."""


class Steps(OutputKind[list[StepEstimate], EvaluatedSteps]):
    """Steps estimated from the legs, one table of them."""

    order: ClassVar[int] = 20
    scores: ClassVar[tuple[Score, ...]] = SCORES
    options: ClassVar[frozenset[str]] = frozenset({"exoskeleton"})

    def collector(
        self, estimator: AnyEstimator, instance: Instance, walk: AlignedWalk | None = None
    ) -> Collector[list[StepEstimate]]:
        """Collects the last estimate of each step."""
        return StepCollector(instance.declaration.name)

    def has_truth(self, recording: Recording) -> bool:
        """Whether the recording has true footprints."""
        return FOOTPRINTS in recording.topics

    def evaluate(
        self, outputs: Sequence[Output[list[StepEstimate]]], recording: Recording, alignment: str = "start"
    ) -> list[EvaluatedSteps]:
        """The steps beside the true footprints.

        Args:
            outputs: Steps of each estimator.
            recording: The recording with the true footprints.
            alignment: Unused: slopes, heights and displacements need no common origin, and a wrong heading counts as
                an error.

        Raises:
            RecordingError: None of the steps of an output matches a true step.
        """
        footprints, evaluations = true_footprints(recording), []
        for output in outputs:
            steps = score_steps(footprints, output.estimates)
            if not any(step.is_matched for step in steps):
                raise RecordingError(f"{recording.path}: {output.name} matched none of the {len(steps)} true steps")
            # there are estimates, as some steps match one
            false_pct = 100.0 * false_steps(footprints, output.estimates) / len(output.estimates)
            scores = {**step_scores(steps), "false_pct": false_pct}
            evaluations.append(Evaluated(name=output.name, estimates=steps, scores=scores))
        return evaluations

    def write(self, output: Output[list[StepEstimate]], file: Path, options: FileOptions) -> Written:
        """Writes a table of `STEP_COLUMNS`, one row per step."""
        return write_output_table(STEP_COLUMNS, [step_cells(step) for step in output.estimates], file, "steps")

    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """Rows of `STEP_COLUMNS`, one per estimate."""
        return LiveSteps(STEP_COLUMNS, file)

    def report(self, evaluations: Sequence[EvaluatedSteps], recording: Recording) -> ReportParts:
        """Section with the planes under the feet from the side and the path from above, of the first estimator."""
        from stridetwin.outputs.steps.figures import step_section

        return ReportParts(figures=step_section(evaluations[0].estimates, evaluations[0].scores, recording))
