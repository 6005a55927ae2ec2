"""One estimator in live operation: samples in, rows out, and the files of `estimate` at the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from stridetwin.estimators import registry
from stridetwin.estimators.base import Options
from stridetwin.outputs.feeding import EstimatorClass
from stridetwin.outputs.pose_feed import OdometryDriven
from stridetwin.outputs.registry import kind_of
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Depth, Image, Imu, Sample

EstimatorRow = tuple[str, str | None]
"""The estimator that has just processed the sample, and its estimate as a row; None without a new estimate."""
_KIND = "of another kind than the estimator reads: such samples are left out"
_SIZE = "of another size than in the rig: such images are left out"
_COLOUR = "in colour where the estimator reads grey: such images are left out"


@dataclass(frozen=True, kw_only=True)
class Request:
    """The estimator of a live run, and where its estimates go.

    Attributes:
        estimator: Its name.
        options: Its options, without the metadata, which come from the senders.
        output: File to write; None writes none.
        estimator_class: Class of an estimator that is not installed; None takes the installed one of the name.
        warms_up: Whether a trial of the estimator takes synthetic samples first, so that it compiles its functions.
    """

    estimator: str
    options: Options = field(default_factory=Options)
    output: Path | None = None
    estimator_class: EstimatorClass | None = None
    warms_up: bool = True

    def load(self) -> EstimatorClass:
        """The class of the estimator."""
        return registry.estimator(self.estimator) if self.estimator_class is None else self.estimator_class


class Chain:
    """An estimator, behind an odometry if its kind takes poses, and its rows.

    Args:
        request: The estimator and its file.
        rig: Calibration.
        metadata: Texts of the senders.

    Attributes:
        takes: The accepted kind of sample by topic.

    Raises:
        StrideTwinError: The rig lacks what the estimator needs; the message names it.
    """

    def __init__(self, request: Request, rig: Rig, metadata: Mapping[str, str]) -> None:
        """Builds the estimator and, if its kind takes poses, an odometry before it."""
        estimator_class = request.load()
        options = replace(request.options, metadata=metadata, source="hello")
        self._name, kind = estimator_class.declaration.name, kind_of(estimator_class.declaration)
        # odometry and estimator together; None for an estimator that takes no poses
        self._driven: OdometryDriven | None = None
        self.takes: dict[str, type[Sample]]
        if kind.takes_poses:
            self._driven = OdometryDriven(rig, estimator_class, options)
            self._estimator, self.takes = self._driven.estimator, self._driven.takes
        else:
            streams = [s for s in estimator_class.streams(rig, options) if s.live]
            for stream in streams:
                if stream.required and stream.kind is Imu:
                    rig.imu(stream.topic)  # raises an error if the rig has none
            self._estimator = estimator_class(rig, options=options)
            self.takes = {s.topic: s.kind for s in streams}
        self._output = kind.live_output(estimator_class.declaration, request.output)

    def update(self, sample: Sample) -> Iterator[EstimatorRow]:
        """Processes a sample that `takes` allows.

        Yields:
            A row each time an estimator has finished with the sample: the odometry, if there is one, then the
                estimator.
        """
        if self._driven is not None and self._driven.feeds_odometry(sample):
            pose = self._driven.update_odometry(sample)
            yield self._driven.odometry, None if pose is None else ""  # its poses are not shown as rows
        if self._driven is None or self._driven.feeds_estimator(sample):
            yield self._name, self._output.add(self._estimator.update(sample))

    def finish(self) -> dict[Path, int]:
        """Writes the files of the estimator; returns the number of rows by file."""
        return self._output.finish(self._estimator)

    def abandon(self) -> None:
        """Ends without writing: existing files stay unchanged."""
        self._output.abandon()


class InputCheck:
    """Checks samples against what the rig says of their topics, before an estimator gets them.

    Args:
        takes: The accepted kind of sample by topic.
        rig: Provides the image sizes. Foot cameras observe boards in grey.
    """

    def __init__(self, takes: Mapping[str, type[Sample]], rig: Rig) -> None:
        """Notes the camera of each topic of images and depth."""
        self._takes = takes
        self._cameras: dict[str, CameraCalibration] = {}
        for camera in rig.cameras.values():
            self._cameras |= {camera.topic: camera, camera.depth_topic: camera}

    def find_problem(self, sample: Sample) -> tuple[str, str, str] | None:
        """Finds what is wrong with a sample of an accepted topic.

        Returns:
            The problem in general, in this case, and the name under which such samples are counted; None if the sample
            fits.
        """
        kind, camera = self._takes[sample.topic], self._cameras.get(sample.topic)
        if not isinstance(sample, kind):
            return _KIND, f"{type(sample).__name__}, not {kind.__name__}", "other_kind"
        if camera is None or not isinstance(sample, Image | Depth):  # only images can be of a wrong size
            return None
        height, width, *channels = (sample.pixels if isinstance(sample, Image) else sample.depth).shape
        if (height, width) != (camera.height, camera.width):
            return _SIZE, f"{width} × {height}, not {camera.width} × {camera.height}", "other_size"
        if channels and camera.mount.body.startswith("foot"):
            return _COLOUR, f"{channels[0]} channels", "other_size"
        return None
