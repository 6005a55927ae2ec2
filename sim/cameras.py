"""Cameras of a rig, rendered from the motion."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.bystanders import Crowd
from stridetwin.sim.crowd_bodies import pose as pose_crowd
from stridetwin.sim.noise import Noise
from stridetwin.sim.render import SensorView, camera_pose
from stridetwin.sim.rig_bodies import UPPERS
from stridetwin.sim.sensors.picture import CameraModel, DepthModel
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Depth, Image


class Cameras:
    """Renders some cameras; a context manager, because it holds graphics memory.

    Args:
        model: Compiled model.
        cameras: The cameras as they really are.
        crowd: Bystanders.
        seed: Seed of the walk.
        ideal: No noise.
    """

    def __init__(
        self, model: mujoco.MjModel, cameras: Sequence[CameraCalibration], crowd: Crowd, seed: int, ideal: bool
    ) -> None:  # fmt: skip
        self._model = model = copy.copy(model)  # the uppers of the shoes are moved in it
        self._data, self._crowd = mujoco.MjData(model), crowd
        self._cameras = {c.topic: c for c in cameras}
        sizes = {(c.width, c.height) for c in cameras}
        self._views = {size: SensorView(model, *size) for size in sorted(sizes)}
        self._colour = {c.topic: CameraModel(c.topic, _shape(c), Noise.of_topic(seed, c.topic, ideal)) for c in cameras}
        self._depth = {
            c.topic: DepthModel(c.depth_topic, (c.height, c.width), Noise.of_topic(seed, c.depth_topic, ideal))
            for c in cameras
            if c.depth_topic
        }

    def frames(
        self, due: Sequence[tuple[int, str]], qpos: Array, uppers: Mapping[str, Array] | None = None
    ) -> Iterator[Image | Depth]:
        """Pictures in the order asked for.

        Args:
            due: Time in ns and topic of every frame, in order of time.
            qpos: (len(due), nq) generalised position at each.
            uppers: (len(due), 7) pose of the shoes' uppers by foot; where none, they lie on the feet.
        """
        posed = None
        for i, ((t_ns, topic), pose) in enumerate(zip(due, qpos)):
            if posed != t_ns:
                for foot, on_foot in (uppers or {}).items():
                    body = self._model.body(UPPERS[foot])
                    body.pos, body.quat = on_foot[i, :3], on_foot[i, 3:]
                self._data.qpos = pose
                pose_crowd(self._model, self._data, self._crowd, 1e-9 * t_ns)
                mujoco.mj_kinematics(self._model, self._data)
                mujoco.mj_camlight(self._model, self._data)
                posed = t_ns
            yield from self._frame(t_ns, self._cameras[topic])

    def _frame(self, t_ns: int, camera: CameraCalibration) -> Iterator[Image | Depth]:
        view, T_world_camera = self._views[camera.width, camera.height], camera_pose(self._data, camera)
        rgb: NDArray[np.uint8]
        if camera.depth_topic:
            rgb, depth = view.frame(self._data, T_world_camera, camera.intrinsics)
            yield self._colour[camera.topic].picture(t_ns, rgb)
            yield self._depth[camera.topic].picture(t_ns, depth)
        else:
            rgb = view.color(self._data, T_world_camera, camera.intrinsics)
            yield self._colour[camera.topic].picture(t_ns, rgb)

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
