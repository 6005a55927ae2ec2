"""Estimators of the ground ahead on samples as they come: odometry leads the map, the map the prediction of modes."""

from __future__ import annotations

from stridetwin.estimators.dvio import MOUNTS, Dvio, DvioEstimate
from stridetwin.estimators.dvio.estimate import LOST
from stridetwin.estimators.dvio.parameters import named
from stridetwin.estimators.locomotion_mode import LocomotionMode, ModeEstimate
from stridetwin.estimators.terrain_map import TerrainEstimate, TerrainMap
from stridetwin.scenarios.mode_files import INSOLES
from stridetwin.scenarios.terrain_files import depth_camera, matrix_sample, seen_from
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Insole, Sample


class LedOdometry:
    """Visual-inertial odometry of the first camera with IMU on head or chest.

    Args:
        rig: What is known of the sensors.
        method: See `estimators.dvio.METHODS`.

    Attributes:
        mount: `head` or `chest`.
        topics: What it takes.

    Raises:
        StrideTwinError: The rig does not feed it; says what is missing.
    """

    def __init__(self, rig: Rig, method: str = "proposed") -> None:
        there = [m for m in MOUNTS if f"/{m}/color" in rig.cameras and f"/{m}/imu" in rig.imus]
        if not there:
            wanted = " or ".join(f"/{m}/color and /{m}/imu" for m in MOUNTS)
            raise StrideTwinError(f"the rig feeds no dvio; valid: one with {wanted}")
        self.mount, parameters = there[0], named(method)
        has_depth = rig.cameras[f"/{self.mount}/color"].depth_topic != ""
        streams = ("imu", "color", "depth") if has_depth else ("imu", "color")
        self.topics: tuple[str, ...] = tuple(f"/{self.mount}/{stream}" for stream in streams)
        self._filter = Dvio(rig, mount=self.mount, parameters=parameters)

    def update(self, sample: Sample) -> DvioEstimate | None:
        """As `Dvio.update`; other topics' samples tell nothing."""
        return self._filter.update(sample) if sample.topic in self.topics else None


class LedAhead:
    """Odometry, map and, where asked, prediction.

    Args:
        rig: What is known of the sensors.
        method: See `estimators.locomotion_mode.METHODS`; None: the map alone.

    Attributes:
        topics: What it takes.
        ground: The map.

    Raises:
        StrideTwinError: The rig does not feed it; says what is missing.
    """

    def __init__(self, rig: Rig, method: str | None = "proposed") -> None:
        self._odometry = LedOdometry(rig)
        mount, camera = self._odometry.mount, depth_camera(rig)
        if (wanted := f"/{mount}/depth") != camera.depth_topic:
            raise StrideTwinError(f"the rig's first depth is {camera.depth_topic}; valid: {wanted}")
        seat = seen_from(rig.imu(f"/{mount}/imu").mount, camera)
        self._depth = camera.depth_topic
        self.ground = TerrainMap(rig, mount=seat, topic=camera.depth_topic)
        self._modes = None if method is None else LocomotionMode(self.ground, camera, mount=seat, method=method)
        self.topics = self._odometry.topics + (INSOLES if self._modes is not None else ())

    def pose(self, sample: Sample) -> DvioEstimate | None:
        """The odometry takes a sample, and leads the others to where it is; first of the two."""
        pose = self._odometry.update(sample)
        if pose is not None and pose.health != LOST:
            (self._modes or self.ground).update(matrix_sample(pose.t_ns, pose.T_world_imu))
        return pose

    def looks(self, sample: Sample) -> bool:
        """Whether map or prediction takes a sample."""
        return (isinstance(sample, Insole) and self._modes is not None) or (
            isinstance(sample, Depth) and sample.topic == self._depth
        )

    def look(self, sample: Sample) -> ModeEstimate | TerrainEstimate | None:
        """Map or prediction takes a sample; what it tells of the ground ahead, or of the coming steps."""
        return (self._modes or self.ground).update(sample) if self.looks(sample) else None
