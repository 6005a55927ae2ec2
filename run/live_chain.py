"""Estimators in live operation: samples in, estimates out, and the files of `estimate` at the end."""

from __future__ import annotations

import csv
import io
import json
import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TextIO

from stridetwin.estimators import registry
from stridetwin.estimators.base import MAP, PATH, STEPS, Options
from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.outputs.feeding import Found, Led, pose_of
from stridetwin.outputs.steps.files import (
    CompletedSteps,
    PredictedStep,
    mode_cells,
    step_cells,
    write_modes,
    write_steps,
)
from stridetwin.outputs.terrain.files import document, write_terrain
from stridetwin.streams.files import partial_path
from stridetwin.streams.formats.tum import seconds
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Depth, Image, Imu, Sample
from stridetwin.streams.trajectory import Pose

Done = tuple[str, str | None]
"""The estimator that has just processed the sample, and its estimate as a row; None without a new estimate."""
_KIND = "of another kind than the estimator reads: such samples are left out"
_SIZE = "of another size than in the rig: such images are left out"
_COLOUR = "in colour where the estimator reads grey: such images are left out"


@dataclass(frozen=True, kw_only=True)
class Request:
    """The estimator to run.

    Attributes:
        estimator: Its name.
        options: See `Options`; the metadata comes from the senders.
        output: File to write; None writes none.
    """

    estimator: str
    options: Options = field(default_factory=Options)
    output: Path | None = None


class Chain(ABC):
    """One or more estimators, each feeding the next.

    Attributes:
        takes: The accepted kind of sample by topic.
    """

    takes: dict[str, type[Sample]]

    @abstractmethod
    def update(self, sample: Sample) -> Iterator[Done]:
        """Processes a sample that `takes` allows; yields each time an estimator has finished with it."""

    @abstractmethod
    def finish(self) -> dict[Path, int]:
        """Writes the files; returns rows by file."""

    def abandon(self) -> None:  # noqa: B027 (most have nothing to undo)
        """Leaves existing files unchanged."""


def chain_of(request: Request, rig: Rig, metadata: Mapping[str, str]) -> Chain:
    """The chain of an estimator.

    Raises:
        StrideTwinError: The rig lacks what the estimator needs; the message names it.
    """
    found = registry.estimator(request.estimator)
    options = replace(request.options, metadata=metadata, source="hello")
    kinds: dict[str, Callable[[Found, Rig, Options, Path | None], Chain]] = {PATH: _Paths, STEPS: _Steps}
    return kinds.get(found.declaration.kind, _Ahead)(found, rig, options, request.output)


def _built(found: Found, rig: Rig, options: Options) -> tuple[Any, dict[str, type[Sample]]]:
    """An estimator, and the kind of sample that it takes by topic."""
    streams = [s for s in found.streams(rig, options) if s.live]
    for stream in streams:
        if stream.required and stream.kind is Imu:
            rig.imu(stream.topic)
    return found(rig, options=options), {s.topic: s.kind for s in streams}


class _Paths(Chain):
    """An estimator of paths: one row per pose, prefixed with the part's name if it estimates several parts."""

    def __init__(self, found: Found, rig: Rig, options: Options, output: Path | None) -> None:
        self._name, self._parts = found.declaration.name, found.declaration.parts
        self._estimator, self.takes = _built(found, rig, options)
        files = {part: part_file(output, part) if output else None for part in self._parts.values() or ("",)}
        self._paths = {part: _LivePath(file) for part, file in files.items()}

    def update(self, sample: Sample) -> Iterator[Done]:
        pose, line = pose_of(self._estimator.update(sample)), None
        if pose is not None:
            part = self._parts.get(pose.frame, "")
            line = f"{part} {self._paths[part].add(pose)}".lstrip()
        yield self._name, line

    def finish(self) -> dict[Path, int]:
        for path in self._paths.values():
            path.finish()
        return {path.file: path.rows for path in self._paths.values() if path.file is not None}

    def abandon(self) -> None:
        for path in self._paths.values():
            path.abandon()


def part_file(file: Path, part: str) -> Path:
    """`path.txt` becomes `path_l.txt`."""
    return file.with_name(f"{file.stem}_{part}{file.suffix}") if part else file


class _Steps(Chain):
    """An estimator of steps: one row per estimate."""

    def __init__(self, found: Found, rig: Rig, options: Options, output: Path | None) -> None:
        self._name, self._output = found.declaration.name, output
        self._estimator, self.takes = _built(found, rig, options)
        self._last: dict[int, StepEstimate] = {}

    def update(self, sample: Sample) -> Iterator[Done]:
        estimate, line = self._estimator.update(sample), None
        if estimate is not None and estimate.step > 0:
            self._last[estimate.step] = estimate
            line = _csv(step_cells(estimate))
        yield self._name, line

    def finish(self) -> dict[Path, int]:
        if self._output is None:
            return {}
        write_steps([self._last[step] for step in sorted(self._last)], self._output)
        return {self._output: len(self._last)}


class _Ahead(Chain):
    """An estimator of the ground ahead, on the poses of an odometry: one row per predicted step, or a map as JSON."""

    def __init__(self, found: Found, rig: Rig, options: Options, output: Path | None) -> None:
        self._led = Led(rig, found, options)
        self._name, self._kind, self._output = found.declaration.name, found.declaration.kind, output
        self.takes = self._led.takes
        self._steps, self._predicted = CompletedSteps(), list[PredictedStep]()

    def update(self, sample: Sample) -> Iterator[Done]:
        if self._led.feeds_odometry(sample):
            yield self._led.odometry, None if self._led.lead(sample) is None else ""
        if self._led.feeds_estimator(sample):
            yield self._name, self._row(self._led.update(sample))

    def _row(self, estimate: Any) -> str | None:
        if estimate is None:
            return None
        if self._kind == MAP:
            return json.dumps(document(estimate), allow_nan=False)
        if (done := self._steps.add(estimate)) is not None:
            self._predicted.append(done)
        next_step = PredictedStep(estimate=estimate, step=estimate.steps[0], steady_s=self._steps.steady_s(estimate))
        return _csv(mode_cells(next_step))

    def finish(self) -> dict[Path, int]:
        if self._output is None:
            return {}
        if self._kind != MAP:
            write_modes(self._predicted, self._output)
            return {self._output: len(self._predicted)}
        files, known = write_terrain(self._led.estimator, self._output), self._led.estimator.estimate
        return {file: len(known.planes) if known else 0 for file in files}


class _LivePath:
    """One trajectory in the format of `write_tum`, row by row; the file appears when it is finished.

    Args:
        file: File to write; None only formats the rows.

    Attributes:
        rows: Number of rows so far.
    """

    def __init__(self, file: Path | None) -> None:
        self.file, self.rows = file, 0
        self._out: TextIO | None = None if file is None else partial_path(file).open("w", encoding="ascii")

    def add(self, pose: Pose) -> str:
        """Adds a pose; returns its row."""
        w, x, y, z = pose.q_world_frame.tolist()
        row = f"{seconds(pose.t_ns)} {' '.join(f'{v:.9g}' for v in (*pose.p_frame_in_world.tolist(), x, y, z, w))}"
        if self._out is not None:
            self._out.write(row + "\n")
        self.rows += 1
        return row

    def finish(self) -> None:
        """Moves the file to its final place."""
        if self._out is not None and self.file is not None:
            self._out.close()
            os.replace(partial_path(self.file), self.file)

    def abandon(self) -> None:
        """Leaves an existing file unchanged."""
        if self._out is not None and self.file is not None:
            self._out.close()
            partial_path(self.file).unlink(missing_ok=True)


class Fit:
    """Checks samples against what is known of their topics; counts those that do not match.

    Args:
        takes: The accepted kind of sample by topic.
        rig: Provides the image sizes. Foot cameras observe boards in grey.

    Attributes:
        other_kind: Samples of another kind, by topic.
        other_size: Images of another size or format, by topic.
    """

    def __init__(self, takes: Mapping[str, type[Sample]], rig: Rig) -> None:
        self._takes = takes
        self._cameras: dict[str, CameraCalibration] = {}
        for camera in rig.cameras.values():
            self._cameras |= {camera.topic: camera, camera.depth_topic: camera}
        self.other_kind: Counter[str] = Counter()
        self.other_size: Counter[str] = Counter()

    def wrong(self, sample: Sample) -> tuple[str, str] | None:
        """The problem of a sample of an accepted topic, in general and in this case; None if it matches."""
        topic, kind = sample.topic, self._takes[sample.topic]
        if not isinstance(sample, kind):
            self.other_kind[topic] += 1
            return _KIND, f"{type(sample).__name__}, not {kind.__name__}"
        camera = self._cameras.get(topic)
        if camera is None or not isinstance(sample, Image | Depth):
            return None
        height, width, *channels = (sample.pixels if isinstance(sample, Image) else sample.depth).shape
        if (height, width) != (camera.height, camera.width):
            self.other_size[topic] += 1
            return _SIZE, f"{width} × {height}, not {camera.width} × {camera.height}"
        if channels and camera.mount.body.startswith("foot"):
            self.other_size[topic] += 1
            return _COLOUR, f"{channels[0]} channels"
        return None


def _csv(cells: Sequence[str]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()
