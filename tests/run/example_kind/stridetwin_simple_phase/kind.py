"""Gait phase by time alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from stridetwin.estimators.base import Declaration, Estimator
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import (
    DESCRIPTIVE,
    Collector,
    FileOptions,
    LiveOutput,
    Output,
    OutputKind,
    ReportParts,
    Score,
    Scores,
    Written,
)
from stridetwin.outputs.csv_tables import csv_row, write_table
from stridetwin.outputs.feeding import Instance
from stridetwin.outputs.truth import FOOTPRINTS, true_footprints
from stridetwin.pages.html import boxes, section
from stridetwin.pages.plot import INK, PALETTE, Plot
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Footprint, Sample
from stridetwin_simple_phase.estimator import Phase

COLUMNS = ("t_s", "phase")
LONGEST_STRIDE_S = 2.5


@dataclass(frozen=True, kw_only=True)
class FootPhases:
    """All phases of one foot."""

    foot: str
    phases: list[Phase]


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluatedPhases:
    """Estimated phases beside the true ones, (N,) each, between true touch-downs."""

    name: str
    scores: Scores
    t_s: np.ndarray
    estimated: np.ndarray
    true: np.ndarray


class PhaseCollector(Collector[FootPhases]):
    """Every phase."""

    def __init__(self, name: str, foot: str) -> None:
        self._output = Output(name=f"{name}_{foot}", estimates=FootPhases(foot=foot, phases=[]))

    def add(self, sample: Sample, estimate: Any) -> None:
        """Keeps a phase."""
        if estimate is not None:
            self._output.estimates.phases.append(estimate)

    def outputs(self) -> list[Output[FootPhases]]:
        """One output per foot."""
        return [self._output]


class LivePhases(LiveOutput):
    """One row per sample."""

    def __init__(self, file: Path | None) -> None:
        self._file, self._rows = file, list[tuple[str, ...]]()

    def add(self, estimate: Phase | None) -> str | None:
        """Time and phase."""
        if estimate is None:
            return None
        self._rows.append(cells(estimate))
        return csv_row(self._rows[-1])

    def finish(self, estimator: Estimator) -> dict[Path, int]:
        """Writes the table."""
        if self._file is None:
            return {}
        write_table(COLUMNS, self._rows, self._file)
        return {self._file: len(self._rows)}


class SimplePhases(OutputKind[FootPhases, EvaluatedPhases]):
    """Gait phases of the legs."""

    order: ClassVar[int] = 900
    scores: ClassVar[tuple[Score, ...]] = (
        Score(name="simple_phase_rmse_pct", heading="phase RMS %", label="Phase, RMS error", unit="%"),
        Score(name="simple_phase_samples", scale=DESCRIPTIVE),
    )

    def collector(
        self, estimator: Estimator, instance: Instance, walk: AlignedWalk | None = None
    ) -> Collector[FootPhases]:
        """Keeps every phase."""
        return PhaseCollector(instance.declaration.name, instance.options.foot)

    def has_truth(self, recording: Recording) -> bool:
        """Whether there are true footprints."""
        return FOOTPRINTS in recording.topics

    def evaluate(
        self, outputs: Sequence[Output[FootPhases]], recording: Recording, alignment: str = "start"
    ) -> list[EvaluatedPhases]:
        """RMS error of the phase, around the circle, between true touch-downs."""
        footprints = true_footprints(recording)
        return [evaluate_phases(output, footprints) for output in outputs]

    def write(self, output: Output[FootPhases], file: Path, options: FileOptions) -> Written:
        """Writes a table."""
        rows = [cells(phase) for phase in output.estimates.phases]
        write_table(COLUMNS, rows, file)
        return Written(files=[file], rows=len(rows), lines=[f"{file}: {len(rows)} phases"])

    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """One row per sample."""
        return LivePhases(file)

    def report(self, evaluations: Sequence[EvaluatedPhases], recording: Recording) -> ReportParts:
        """The phases over time."""
        plot = Plot(
            title="Gait phase by time", x=(0.0, recording.duration), y=(0.0, 1.0), x_label="time, s", y_label="phase"
        )
        for evaluation, color in zip(evaluations, PALETTE):
            plot.line(evaluation.t_s, evaluation.true, INK, label="truth")
            plot.line(evaluation.t_s, evaluation.estimated, color, label=evaluation.name)
        return ReportParts(figures=section("Simple gait phase", "From the foot IMUs.", boxes([plot.html()]), "stack"))


def cells(phase: Phase) -> tuple[str, ...]:
    """A phase as a row of `COLUMNS`."""
    return f"{phase.t_ns * 1e-9:.4f}", f"{phase.phase:.4f}"


def evaluate_phases(output: Output[FootPhases], footprints: Sequence[Footprint]) -> EvaluatedPhases:
    """The phases of one foot beside the true ones."""
    landed = np.array([f.t_ns for f in footprints[2:] if f.foot == output.estimates.foot])
    t = np.array([p.t_ns for p in output.estimates.phases])
    estimated = np.array([p.phase for p in output.estimates.phases])
    true = np.full(len(t), np.nan)
    for a, b in pairwise(landed.tolist()):
        if b - a < LONGEST_STRIDE_S * 1e9:
            inside = (t >= a) & (t < b)
            true[inside] = (t[inside] - a) / (b - a)
    known = np.isfinite(true)
    error = (estimated[known] - true[known] + 0.5) % 1.0 - 0.5
    scores = {"simple_phase_samples": float(known.sum())}
    if known.any():
        scores["simple_phase_rmse_pct"] = float(100.0 * np.sqrt(np.mean(error**2)))
    return EvaluatedPhases(
        name=output.name, scores=scores, t_s=t[known] * 1e-9, estimated=estimated[known], true=true[known]
    )
