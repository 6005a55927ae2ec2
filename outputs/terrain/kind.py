"""Planes, ramps and stairs around the walker."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar, cast

from stridetwin.estimators.base import AnyEstimator, Declaration
from stridetwin.estimators.terrain_map import TerrainMap
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
from stridetwin.outputs.coverage import COVERAGE
from stridetwin.outputs.feeding import Instance
from stridetwin.outputs.terrain.files import LiveTerrain, terrain_document, write_terrain
from stridetwin.outputs.terrain.run import MapCollector, MapRun, SampledMap
from stridetwin.outputs.terrain.scores import SCORES, map_figures
from stridetwin.streams.recording.reader import Recording

if TYPE_CHECKING:
    from rerun import RecordingStream

EvaluatedMap = Evaluated[SampledMap]
"""What was sampled of a map during the walk."""


class TerrainMaps(OutputKind[MapRun, EvaluatedMap]):
    """Maps of the ground, each with planes, ramps and stairs."""

    order: ClassVar[int] = 30
    scores: ClassVar[tuple[Score, ...]] = SCORES
    takes_poses: ClassVar[bool] = True
    options: ClassVar[frozenset[str]] = frozenset({"poses", "mesh"})
    suffix: ClassVar[str] = ".json"

    def collector(
        self, estimator: AnyEstimator, instance: Instance, walk: AlignedWalk | None = None
    ) -> Collector[MapRun]:
        """Collects the map at the end, and samples of it where the truth is known."""
        return MapCollector(instance.declaration.name, cast("TerrainMap", estimator), walk)

    def evaluate(
        self, outputs: Sequence[Output[MapRun]], recording: Recording, alignment: str = "start"
    ) -> list[EvaluatedMap]:
        """The scores of the maps that were sampled beside the truth while they grew; others are left out.

        Args:
            outputs: Maps of each estimator.
            recording: Unused: the samples already have the truth.
            alignment: Unused, for the same reason.
        """
        return [
            Evaluated(
                name=output.name,
                estimates=sampled,
                scores={**map_figures(sampled.scores), COVERAGE.name: 100.0 * sampled.coverage},
            )
            for output in outputs
            if (sampled := output.estimates.sampled) is not None
        ]

    def write(self, output: Output[MapRun], file: Path, options: FileOptions) -> Written:
        """Writes planes and terrains as JSON, the ground as PLY, and meshes on request."""
        terrain_map = output.estimates.terrain_map
        files = write_terrain(terrain_map, file, mesh=options.mesh)
        estimate = terrain_map.estimate
        types = [terrain["type"] for terrain in terrain_document(estimate)["terrains"]] if estimate else []
        counts = ", ".join(f"{types.count(name)} {name}" for name in ("level", "ramp", "stairs"))
        planes = len(estimate.planes) if estimate else 0
        return Written(files=files, rows=planes, lines=[f"{files[0]}: {planes} planes; {counts}"])

    def is_empty(self, output: Output[MapRun]) -> bool:
        """Whether the map is empty because no depth image had a pose."""
        return output.estimates.terrain_map.estimate is None

    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """Lines of JSON, one per new map."""
        return LiveTerrain(file)

    def report(self, evaluations: Sequence[EvaluatedMap], recording: Recording) -> ReportParts:
        """Section with the ground of the first map from above and from the side, its errors, and its scores."""
        from stridetwin.outputs.terrain.figures import terrain_section

        return ReportParts(figures=terrain_section(evaluations[0].estimates, evaluations[0].scores))

    def log_rerun(
        self, rerun: ModuleType, stream: RecordingStream, evaluations: Sequence[EvaluatedMap], recording: Recording
    ) -> None:
        """Logs the ground of the first map, its planes and edges, over time; its snapshots need no recording."""
        from stridetwin.outputs.terrain.rerun import log_ground

        log_ground(rerun, stream, evaluations[0].estimates.snapshots)
