"""Path of a foot or a camera: poses of one frame over a walk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar

from stridetwin.estimators.base import AnyEstimator, Declaration, PathEstimate, Progress
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import Collector, FileOptions, LiveOutput, Output, OutputKind, ReportParts, Score, Written
from stridetwin.outputs.feeding import Instance
from stridetwin.outputs.path.evaluate import Result, evaluate
from stridetwin.outputs.path.files import LivePaths, write_path
from stridetwin.outputs.path.run import PathCollector, run_paths
from stridetwin.outputs.path.scores import SCORES
from stridetwin.streams.recording.reader import Recording

if TYPE_CHECKING:
    from rerun import RecordingStream


class Paths(OutputKind[PathEstimate, Result]):
    """Paths of a foot or of a camera, one TUM trajectory each."""

    order: ClassVar[int] = 10
    scores: ClassVar[tuple[Score, ...]] = SCORES
    options: ClassVar[frozenset[str]] = frozenset({"imu"})
    suffix: ClassVar[str] = ".txt"

    def collector(
        self, estimator: AnyEstimator, instance: Instance, walk: AlignedWalk | None = None
    ) -> Collector[PathEstimate]:
        """Collects the poses, one path per frame."""
        return PathCollector(instance, instance.options.source)

    def run(
        self, instance: Instance, recording: Recording, progress: Progress | None = None
    ) -> list[Output[PathEstimate]]:
        """Runs an instance on a recording, by `follow` where the estimator has it."""
        return run_paths(instance, recording, progress)

    def evaluate(
        self, outputs: Sequence[Output[PathEstimate]], recording: Recording, alignment: str = "start"
    ) -> list[Result]:
        """Aligns the paths with the true ones and scores them with `SCORES`."""
        return evaluate(recording, [output.estimates for output in outputs], alignment)

    def write(self, output: Output[PathEstimate], file: Path, options: FileOptions) -> Written:
        """Writes a TUM trajectory, or a table if the file ends in `.csv`, and what was learnt of the sensor."""
        rows, line = write_path(output.estimates, file, dead_reckoning=options.dead_reckoning)
        files = [file]
        if (write_calibration := output.estimates.write_calibration) is not None:
            files.append(file.with_name(f"{file.stem}.calibration.json"))
            write_calibration(files[-1])
        return Written(files=files, rows=rows, lines=[line])

    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """Rows of a TUM trajectory, prefixed with the part if there are several."""
        return LivePaths(declaration, file)

    def report(self, evaluations: Sequence[Result], recording: Recording) -> ReportParts:
        """Figures in short, plan and side views, errors over time, and all scores of every path."""
        from stridetwin.outputs.path import report

        return ReportParts(
            chips=(report.describe_distance(evaluations),),
            summary=report.score_cards(evaluations),
            figures=report.path_figures(evaluations, recording),
            details=report.consistency_section(evaluations),
            scores=report.scores_section(evaluations),
        )

    def rerun_views(self, evaluations: Sequence[Result]) -> dict[str, tuple[str, str]]:
        """A view of the position errors over time."""
        return {"error_mm": ("series", "position error, mm")}

    def log_rerun(
        self, rerun: ModuleType, stream: RecordingStream, evaluations: Sequence[Result], recording: Recording
    ) -> None:
        """Logs the true and the estimated paths as lines, and the errors over time; it needs no recording."""
        from stridetwin.outputs.path.rerun import log_paths

        log_paths(rerun, stream, evaluations)
