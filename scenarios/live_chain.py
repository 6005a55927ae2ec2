"""The estimators as they run live: samples in, what each makes of them out, and at the end the files of `estimate`."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import ContactTerrain, StepEstimate, parse_exoskeleton, read_exoskeleton
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.estimators.terrain_map import TerrainEstimate
from stridetwin.scenarios.estimates import FEET
from stridetwin.scenarios.exo_geometry import KEY
from stridetwin.scenarios.leading import LedAhead, LedOdometry
from stridetwin.scenarios.live_paths import LivePath
from stridetwin.scenarios.mode_files import MadeSteps, PredictedStep, mode_cells, write_modes
from stridetwin.scenarios.steps import step_cells, write_steps
from stridetwin.scenarios.terrain_files import document, write_terrain
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Ahrs, Depth, Encoder, Image, Imu, Insole, Range, Sample

_KINDS: dict[str, type[Sample]] = {"imu": Imu, "color": Image, "depth": Depth, "insole": Insole}
Done = tuple[str, str | None]
"""Which estimator has just taken the sample, and what it tells, None where it tells nothing."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What is to run.

    Attributes:
        estimator: Its name.
        method: See the estimators.
        foot: `l` or `r`, for `foot_ins`.
        exoskeleton: File of its geometry; None takes what the sender tells.
        output: File to write; None writes none.
    """

    estimator: str
    method: str = "proposed"
    foot: str = "l"
    exoskeleton: Path | None = None
    output: Path | None = None


class Chain(Protocol):
    """One or more estimators, one feeding the next.

    Attributes:
        takes: The kind of sample that it takes of each topic.
    """

    takes: dict[str, type[Sample]]

    def update(self, sample: Sample) -> Iterator[Done]:
        """Takes a sample that `takes` allows; yields each time an estimator is done with it."""

    def finish(self) -> dict[Path, int]:
        """Writes what is to be written; returns rows by file."""

    def abandon(self) -> None:
        """Leaves the files as they were."""


def chain_of(asked: Asked, rig: Rig, metadata: Mapping[str, str]) -> Chain:
    """The chain of an estimator.

    Args:
        asked: Which.
        rig: What is known of the hardware.
        metadata: Texts that the senders told.

    Raises:
        StrideTwinError: The rig does not feed it; says what is missing.
    """
    if asked.estimator == "foot_ins":
        return _OneFoot(asked, rig)
    if asked.estimator == "foot_to_foot":
        return _BothFeet(asked, rig)
    if asked.estimator == "contact_terrain":
        return _Steps(asked, metadata)
    if asked.estimator == "dvio":
        return _Odometry(asked, rig, asked.method)
    return _Ahead(asked, rig)


class _OneFoot:
    """`foot_ins`."""

    def __init__(self, asked: Asked, rig: Rig) -> None:
        topic = f"/foot_{asked.foot}/imu"
        self.takes: dict[str, type[Sample]] = {topic: Imu}
        self._filter = FootIns(rig.imu(topic))
        self._path = LivePath(asked.output)

    def update(self, sample: Sample) -> Iterator[Done]:
        assert isinstance(sample, Imu)
        estimate = self._filter.update(sample)
        if estimate is None:
            yield "foot_ins", None
        else:
            yield "foot_ins", self._path.add(estimate.t_ns, estimate.p_imu_in_world, estimate.q_world_imu)

    def finish(self) -> dict[Path, int]:
        self._path.finish()
        return _files(self._path)

    def abandon(self) -> None:
        self._path.abandon()


class _BothFeet:
    """`foot_to_foot`, with the shoe cameras and sonars of the rig."""

    def __init__(self, asked: Asked, rig: Rig) -> None:
        imus = [f"/foot_{foot}/imu" for foot in FEET]
        for topic in imus:
            rig.imu(topic)
        cameras = [c.topic for c in rig.cameras.values() if c.mount.body in ("foot_l", "foot_r")]
        sonars = [s.topic for s in rig.others.values() if s.kind == "range" and s.mount.body in ("foot_l", "foot_r")]
        self.takes: dict[str, type[Sample]] = {
            **dict.fromkeys(imus, Imu), **dict.fromkeys(cameras, Image), **dict.fromkeys(sonars, Range)
        }  # fmt: skip
        self._filter = FootToFoot(rig, method=asked.method)
        out = asked.output
        self._paths = {f: LivePath(out and out.with_name(f"{out.stem}_{f}{out.suffix}")) for f in FEET}

    def update(self, sample: Sample) -> Iterator[Done]:
        assert isinstance(sample, Imu | Image | Range)
        estimate = self._filter.update(sample)
        line = None
        if estimate is not None and isinstance(sample, Imu):
            foot = self._filter.foot_of(sample)
            own = estimate.feet[foot]
            line = f"{foot} {self._paths[foot].add(own.t_ns, own.p_imu_in_world, own.q_world_imu)}"
        yield "foot_to_foot", line

    def finish(self) -> dict[Path, int]:
        for path in self._paths.values():
            path.finish()
        return _files(*self._paths.values())

    def abandon(self) -> None:
        for path in self._paths.values():
            path.abandon()


class _Steps:
    """`contact_terrain`."""

    def __init__(self, asked: Asked, metadata: Mapping[str, str]) -> None:
        if asked.exoskeleton is not None:
            exo = read_exoskeleton(asked.exoskeleton)
        elif KEY in metadata:
            exo = parse_exoskeleton(metadata[KEY], f"hello: {KEY}")
        else:
            raise StrideTwinError("nobody tells the geometry of an exoskeleton; give its file: --exoskeleton FILE")
        self.takes: dict[str, type[Sample]] = {exo.back.topic: Ahrs}
        for leg in exo.legs.values():
            self.takes |= {leg.thigh.topic: Ahrs, leg.foot.topic: Ahrs, leg.knee.topic: Encoder, leg.sole.topic: Insole}
        self._filter, self._output = ContactTerrain(exo, asked.method), asked.output
        self._last: dict[int, StepEstimate] = {}

    def update(self, sample: Sample) -> Iterator[Done]:
        estimate = self._filter.update(sample)
        if estimate is not None and estimate.step > 0:
            self._last[estimate.step] = estimate
            yield "contact_terrain", _csv(step_cells(estimate))
        else:
            yield "contact_terrain", None

    def finish(self) -> dict[Path, int]:
        if self._output is None:
            return {}
        write_steps([self._last[step] for step in sorted(self._last)], self._output)
        return {self._output: len(self._last)}

    def abandon(self) -> None:
        pass


class _Odometry:
    """`dvio`."""

    def __init__(self, asked: Asked, rig: Rig, method: str) -> None:
        self._filter = LedOdometry(rig, method)
        self.takes = _named(self._filter.topics)
        self._path = LivePath(asked.output)

    def update(self, sample: Sample) -> Iterator[Done]:
        estimate = self._filter.update(sample)
        if estimate is None:
            yield "dvio", None
        else:
            T = estimate.T_world_imu
            q = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
            yield "dvio", self._path.add(estimate.t_ns, T[:3, 3], q)

    def finish(self) -> dict[Path, int]:
        self._path.finish()
        return _files(self._path)

    def abandon(self) -> None:
        self._path.abandon()


class _Ahead:
    """`terrain_map` and `locomotion_mode`, led by the poses of `dvio`."""

    def __init__(self, asked: Asked, rig: Rig) -> None:
        self._ahead = LedAhead(rig, asked.method if asked.estimator == "locomotion_mode" else None)
        self._name, self._output, self.takes = asked.estimator, asked.output, _named(self._ahead.topics)
        self._steps, self._made = MadeSteps(), list[PredictedStep]()

    def update(self, sample: Sample) -> Iterator[Done]:
        if not isinstance(sample, Insole):
            yield "dvio", None if self._ahead.pose(sample) is None else ""
        if self._ahead.looks(sample):
            yield self._name, self._told(self._ahead.look(sample))

    def _told(self, estimate: ModeEstimate | TerrainEstimate | None) -> str | None:
        if estimate is None:
            return None
        if isinstance(estimate, TerrainEstimate):
            return json.dumps(document(estimate), allow_nan=False)
        if (made := self._steps.add(estimate)) is not None:
            self._made.append(made)
        coming = PredictedStep(estimate=estimate, step=estimate.steps[0], steady_s=self._steps.steady_s(estimate))
        return _csv(mode_cells(coming))

    def finish(self) -> dict[Path, int]:
        if self._output is None:
            return {}
        if self._name == "locomotion_mode":
            write_modes(self._made, self._output)
            return {self._output: len(self._made)}
        files = write_terrain(self._ahead.ground, self._output)
        known = self._ahead.ground.estimate
        return {file: len(known.planes) if known else 0 for file in files}

    def abandon(self) -> None:
        pass


def _named(topics: Sequence[str]) -> dict[str, type[Sample]]:
    """Kinds by the last part of the topics' names, as those of head and chest have it."""
    return {topic: _KINDS[topic.rpartition("/")[2]] for topic in topics}


def _files(*paths: LivePath) -> dict[Path, int]:
    return {path.file: path.rows for path in paths if path.file is not None}


def _csv(cells: Sequence[str]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()
