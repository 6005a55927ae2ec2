"""All cameras of a rig, rendered from the motion."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Self

import mujoco

from stridetwin.sim.noise import Noise
from stridetwin.sim.playback import Motion
from stridetwin.sim.render import SensorView, camera_pose
from stridetwin.sim.sensor_suite import instants
from stridetwin.sim.sensors.picture import CameraModel, DepthModel
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Depth, Image


class Cameras:
    """Renders every camera of the rig; a context manager, because it holds graphics memory.

    Args:
        model: Compiled model.
        rig: The cameras as they really are.
        seed: Seed of the walk.
        ideal: No noise.
    """

    def __init__(self, model: mujoco.MjModel, rig: Rig, seed: int, ideal: bool) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._cameras = list(rig.cameras.values())
        sizes = {(c.width, c.height) for c in self._cameras}
        self._views = {size: SensorView(model, *size) for size in sorted(sizes)}
        self._colour = {c.topic: CameraModel(c.topic, _shape(c), Noise.of_topic(seed, c.topic, ideal)) for c in self._cameras}
        self._depth = {
            c.topic: DepthModel(c.depth_topic, (c.height, c.width), Noise.of_topic(seed, c.depth_topic, ideal))
            for c in self._cameras
            if c.depth_topic
        }

    @property
    def rates(self) -> set[float]:
        """Frame rates, Hz."""
        return {c.rate_hz for c in self._cameras}

    def frames(self, motion: Motion, after_ns: int, until_ns: int) -> Iterator[Image | Depth]:
        """Pictures after `after_ns` and up to `until_ns`, in order of time."""
        due = [
            (t, camera)
            for camera in self._cameras
            for t in instants(camera.rate_hz, after_ns, until_ns).tolist()
        ]
        posed = None
        for t_ns, camera in sorted(due, key=lambda item: item[0]):
            if posed != t_ns:
                self._pose(motion, t_ns)
                posed = t_ns
            view = self._views[camera.width, camera.height]
            pose = camera_pose(self._data, camera)
            if camera.depth_topic:
                rgb, depth = view.frame(self._data, pose, camera.intrinsics)
                yield self._colour[camera.topic].picture(t_ns, rgb)
                yield self._depth[camera.topic].picture(t_ns, depth)
            else:
                yield self._colour[camera.topic].picture(t_ns, view.color(self._data, pose, camera.intrinsics))

    def _pose(self, motion: Motion, t_ns: int) -> None:
        self._data.qpos = motion.qpos[motion.rows(t_ns)]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for view in self._views.values():
            view.close()


def _shape(camera: CameraCalibration) -> tuple[int, ...]:
    """Grey for a shoe's camera, colour where depth goes with it."""
    return (camera.height, camera.width, 3) if camera.depth_topic else (camera.height, camera.width)
