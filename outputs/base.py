"""The contract of a kind of output, which is all that commands, gate, live and report know of it.

A kind of output (a path, steps, a terrain map, the modes of coming steps, ...) is one package with everything about it:
how it is run on a recording, its files, its scores with labels, units and scales, its figures, and its row in `live`.
A package offers a kind as a subclass of `OutputKind` under the entry point group `stridetwin.outputs`; an estimator
names it in `Declaration.kind`. `docs/output_kinds.md` adds one step by step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

from stridetwin.estimators.base import AnyEstimator, Declaration, Progress
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.feeding import Instance, start
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Sample

if TYPE_CHECKING:
    from rerun import RecordingStream

Scores = dict[str, float]
"""The scores of one output of one walk, by name; an undefined score is left out."""
SCALES = ERROR, LEAD, SHARE, BAD_SHARE, CLAIM, DESCRIPTIVE = (
    "error",
    "lead",
    "share",
    "bad_share",
    "claim",
    "descriptive",
)
"""How a score changes for the worse: an error grows; a lead time or a share of what is right shrinks; a share of what
is wrong grows; a claim, such as NEES, is an error relative to the reported covariance; the rest describes the walk."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Declaration of one score: its name, how the gate compares it, and how tables show it.

    Attributes:
        name: As in `scores.json`, with its unit as suffix, such as `end_error_m`.
        scale: One of `SCALES`: how the gate compares it.
        signed: Its sign has a meaning, so that means over walks are compared by the absolute values of each walk.
        heading: Its column in the table that `score` and `run` print; "" leaves it out.
        label: Its row in the table of the report; "" leaves it out.
        unit: Shown after the label.
        digits: Decimals in the report.
    """

    name: str
    scale: str = ERROR
    signed: bool = False
    heading: str = ""
    label: str = ""
    unit: str = ""
    digits: int = 2


E = TypeVar("E")
EstimateT = TypeVar("EstimateT")
V = TypeVar("V", bound="Evaluation")


@dataclass(frozen=True, kw_only=True, eq=False)
class Output(Generic[E]):
    """What one estimator gave for one recording, before it is scored.

    Attributes:
        name: In scores and files: the estimator's name, with a part such as `foot_ins_l`.
        estimates: As the kind defines it.
        part: Suffix of the file if one instance of the estimator gives several outputs, such as `l`; else "".
    """

    name: str
    estimates: E
    part: str = ""


class Evaluation(Protocol):
    """An output beside the truth: its name, its scores, and what the kind's figures need."""

    @property
    def name(self) -> str:
        """Name of the output."""

    @property
    def scores(self) -> Scores:
        """Scores of the output, by name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluated(Generic[E]):
    """An evaluation of a kind whose figures need no more than the estimates.

    Attributes:
        name: Name of the output.
        estimates: The estimates, or each true value with its estimate.
        scores: The scores that the kind declares.
    """

    name: str
    estimates: E
    scores: Scores


class Collector(ABC, Generic[E]):
    """Collects the outputs of one estimator while the samples of a recording are replayed."""

    @abstractmethod
    def add(self, sample: Sample, estimate: object) -> None:
        """Takes a sample and what the estimator's `update` returned for it; called for every sample in time order."""

    @abstractmethod
    def outputs(self) -> list[Output[E]]:
        """The outputs of the whole recording.

        Raises:
            StrideTwinError: The estimator gave none.
        """


class EveryEstimate(Collector[E], Generic[E, EstimateT]):
    """Every estimate of an estimator that gives one output.

    Args:
        name: Of the output.
        estimate_type: What the estimator's `update` returns.
        pack: Turns the list of the estimates, in time order, into what the kind keeps of them.
    """

    def __init__(self, name: str, estimate_type: type[EstimateT], pack: Callable[[list[EstimateT]], E]) -> None:
        self._name, self._type, self._pack = name, estimate_type, pack
        self._estimates: list[EstimateT] = []

    def add(self, sample: Sample, estimate: object) -> None:
        """Keeps an estimate; anything else, such as None, is left out."""
        if isinstance(estimate, self._type):
            self._estimates.append(estimate)

    def outputs(self) -> list[Output[E]]:
        """The only output, with all estimates as `pack` turns them into what the kind keeps."""
        return [Output(name=self._name, estimates=self._pack(self._estimates))]


class LiveOutput(ABC):
    """The rows of one estimator in `live`, and its file at the end."""

    @abstractmethod
    def add(self, estimate: object) -> str | None:
        """Takes what `update` returned; returns a row of text, or None without a new estimate."""

    @abstractmethod
    def finish(self, estimator: AnyEstimator) -> dict[Path, int]:
        """Writes the files, if any was requested; returns the number of rows of each."""

    def abandon(self) -> None:  # noqa: B027 (most have nothing to undo)
        """Leaves existing files as they are, after a failure."""


@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """What the user asks of the files of an output.

    Attributes:
        mesh: `terrain`: write the ground as a mesh, too.
        dead_reckoning: `path`: write poses without tracking, too.
    """

    mesh: bool = False
    dead_reckoning: bool = False


@dataclass(frozen=True, kw_only=True)
class Written:
    """What was written of an output.

    Attributes:
        files: Its files, the requested one first.
        rows: Number of rows in them.
        lines: One message per file, or for all.
    """

    files: list[Path]
    rows: int
    lines: list[str]


@dataclass(frozen=True, kw_only=True)
class ReportParts:
    """HTML sections of a report, "" where there is nothing to show.

    Attributes:
        chips: A few words each, for the head of the page.
        summary: Few figures, at the top of the page.
        figures: Figures of the walk.
        details: Figures for who develops the estimator, which only the page of `score --report` shows.
        scores: Table of all scores, at the end.
    """

    chips: tuple[str, ...] = ()
    summary: str = ""
    figures: str = ""
    details: str = ""
    scores: str = ""


class OutputKind(ABC, Generic[E, V]):
    """A kind of output. `list` shows the first line of the docstring of its module.

    Attributes:
        order: Place among the kinds in scores, reports and lists.
        scores: Its scores, in the order in which tables show them.
        takes_poses: Its estimators are fed with the poses of an odometry (`POSES`).
        options: Options of `estimate` and `live` that only estimators of some kinds take: `poses`, `mesh`,
            `exoskeleton`, `imu`.
        suffix: Suffix of the file that `run` writes.
    """

    order: ClassVar[int] = 100
    scores: ClassVar[tuple[Score, ...]] = ()
    takes_poses: ClassVar[bool] = False
    options: ClassVar[frozenset[str]] = frozenset()
    suffix: ClassVar[str] = ".csv"

    @abstractmethod
    def collector(self, estimator: AnyEstimator, instance: Instance, walk: AlignedWalk | None = None) -> Collector[E]:
        """Makes a collector for one estimator.

        Args:
            estimator: The running estimator; some kinds read its state.
            instance: The class and options that it was built from.
            walk: For an estimator that takes poses, these beside the truth; None where there is no truth.
        """

    def run(self, instance: Instance, recording: Recording, progress: Progress | None = None) -> list[Output[E]]:
        """Builds an estimator for a recording and feeds it all samples in time order.

        Estimators of kinds that take poses are not run here, but all together by `pose_feed.replay`.

        Args:
            instance: The estimator with its options.
            recording: With the topics that the estimator needs.
            progress: Receives the stage and its progress (0-1), where a kind reports it.

        Raises:
            StrideTwinError: A topic or calibration is missing, or the estimator gives no estimate.
        """
        estimator, samples = start(instance, recording)
        collector = self.collector(estimator, instance)
        for sample in samples:
            collector.add(sample, estimator.update(sample))
        return collector.outputs()

    def has_truth(self, recording: Recording) -> bool:
        """Whether a recording has the truth without which nothing of this kind is run for scores."""
        return True

    @abstractmethod
    def evaluate(self, outputs: Sequence[Output[E]], recording: Recording, alignment: str = "start") -> list[V]:
        """The outputs beside the truth of their recording, with scores.

        Args:
            outputs: Of one recording.
            recording: With the truth.
            alignment: Of paths with the truth, see `alignment.align`.

        Raises:
            StrideTwinError: The truth or an estimate is invalid, or the truth is too short.
        """

    def is_empty(self, output: Output[E]) -> bool:
        """Whether an output holds nothing that could be written."""
        return False

    @abstractmethod
    def write(self, output: Output[E], file: Path, options: FileOptions) -> Written:
        """Writes an output to a file, and to others of the same name if the kind has several.

        Raises:
            StrideTwinError: There is nothing to write, or a library that writes it is not installed.
        """

    @abstractmethod
    def live_output(self, declaration: Declaration, file: Path | None) -> LiveOutput:
        """Makes what formats the estimates of one estimator as rows in `live`.

        It writes a file only if one is given.
        """

    def report(self, evaluations: Sequence[V], recording: Recording) -> ReportParts:
        """What a report shows of all outputs of this kind, at least one."""
        return ReportParts()

    def rerun_views(self, evaluations: Sequence[V]) -> dict[str, tuple[str, str]]:
        """The views that the Rerun file shows for this kind.

        Returns:
            By the path of the logged entity, such as `error_mm`: the type of the view, `text` or `series` (curves over
            time), and its title. Empty if the kind needs no view of its own.
        """
        return {}

    def log_rerun(
        self, rerun: ModuleType, stream: RecordingStream, evaluations: Sequence[V], recording: Recording
    ) -> None:
        """Adds all outputs of this kind, at least one, to a stream of the module `rerun`.

        Args:
            rerun: The module, which is imported only where a Rerun file is written.
            stream: The stream.
            evaluations: The outputs.
            recording: Their recording.
        """


AnyKind = OutputKind[Any, Any]
"""A kind whose estimates only it knows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KindEvaluations:
    """The evaluated outputs of one kind on one recording.

    Attributes:
        kind: The kind.
        evaluations: Its evaluations, one per output.
    """

    kind: AnyKind
    evaluations: list[Any] = field(default_factory=list)


def scores_by_output(of_kinds: Sequence[KindEvaluations]) -> dict[str, Scores]:
    """The scores of every output of all kinds, by the output's name."""
    evaluations = [evaluation for of_kind in of_kinds for evaluation in of_kind.evaluations]
    return {evaluation.name: evaluation.scores for evaluation in evaluations}


def part_file(file: Path, part: str) -> Path:
    """The file of one part of an output: for the part `l`, `path.txt` becomes `path_l.txt`.

    Args:
        file: The file that was requested.
        part: Suffix of the part; "" leaves the file as it is.
    """
    return file.with_name(f"{file.stem}_{part}{file.suffix}") if part else file
