"""Whether a sample that comes is one that the estimator can take: of its topic's kind, a picture of the rig's size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Depth, Image, Sample

_KIND = "of another kind than the estimator takes: such samples are left out"
_SIZE = "of another size than the rig tells: such pictures are left out"
_COLOUR = "in colour where the estimator takes grey: such pictures are left out"


class Fit:
    """Holds samples against what is told of their topics; counts those that do not fit.

    Args:
        takes: The kind of sample that the estimator takes of each topic.
        rig: Tells the sizes of pictures. Cameras on feet look at boards in grey.

    Attributes:
        other_kind: Samples of another kind, by topic.
        other_size: Pictures of another size or form, by topic.
    """

    def __init__(self, takes: Mapping[str, type[Sample]], rig: Rig) -> None:
        self._takes = takes
        self._cameras: dict[str, CameraCalibration] = {}
        for camera in rig.cameras.values():
            self._cameras |= {camera.topic: camera, camera.depth_topic: camera}
        self.other_kind: Counter[str] = Counter()
        self.other_size: Counter[str] = Counter()

    def wrong(self, sample: Sample) -> tuple[str, str] | None:
        """What is wrong with a sample of one of the topics, in general and in this case; None where it fits."""
        topic, kind = sample.topic, self._takes[sample.topic]
        if not isinstance(sample, kind):
            self.other_kind[topic] += 1
            return _KIND, f"{type(sample).__name__} and not {kind.__name__}"
        camera = self._cameras.get(topic)
        if camera is None or not isinstance(sample, Image | Depth):
            return None
        height, width, *channels = (sample.pixels if isinstance(sample, Image) else sample.depth).shape
        if (height, width) != (camera.height, camera.width):
            self.other_size[topic] += 1
            return _SIZE, f"{width} × {height} and not {camera.width} × {camera.height}"
        if channels and camera.mount.body.startswith("foot"):
            self.other_size[topic] += 1
            return _COLOUR, f"{channels[0]} channels"
        return None
