"""Cameras rendered by two processes beside the twin's own, so that both cores draw.

Software rendering takes most of the time of a walk with cameras. A thread per process gives it batches of frames and
reads the images back. The processes are programs of their own (`sim.rendering.rendering`), because those of
`ProcessPoolExecutor` would run the user's main script again. The noise of an image depends on seed, topic and time
alone, and this side sets the exposure where the gain follows from the previous image: so the number of processes
changes no byte.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from queue import SimpleQueue
from types import TracebackType
from typing import IO, Self

import mujoco
import numpy as np

from stridetwin.sim.noise import Noise
from stridetwin.sim.playback import Motion
from stridetwin.sim.rendering.cameras import FrameRequest, Patch, board_seen_by, has_auto_exposure, make_image_sensor
from stridetwin.sim.sensors.model import Stamps, instants
from stridetwin.sim.sensors.mount_slip import MountSlips
from stridetwin.sim.sensors.standard_rig import SensorRig
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.sim.world.light import LightCourse
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array, Depth, Image

PROCESSES = 2  # rendering processes of a walk with cameras
_PIPE_BYTES = 1 << 20  # size of a pipe's buffer
_DRAWING = {"GALLIVM_PERF": "brilinear,rho_approx"}  # llvmpipe: textures in two thirds of the time, alike to the eye
_BATCH = 6  # frames that a process renders between two requests
_BATCHES = 16  # batches that are in progress or waiting to be taken
_Poses = tuple[list[FrameRequest], Array, dict[str, Array]]
"""What a process needs for a batch: the frames, MuJoCo's coordinates at each, and the pose of each shoe's upper."""


class CameraProcesses:
    """Renders the cameras of a rig chunk by chunk; a context manager, because processes hang on it.

    Args:
        model: Compiled model.
        sensor_rig: The sensors with their true calibration; without any camera no process is started.
        crowd: Bystanders.
        seed: Seed of the walk.
        mount_slips: Slips of the camera mounts.
        processes: Number of processes; None: `PROCESSES`.
        light: Course of the light during the walk.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sensor_rig: SensorRig,
        crowd: Crowd,
        seed: int,
        mount_slips: MountSlips | None = None,
        processes: int | None = None,
        light: LightCourse | None = None,
    ) -> None:
        """Starts the processes; the scene is sent to each before its first batch."""
        self._cameras = list(sensor_rig.rig.cameras.values())
        # by topic of the camera: the board that it sees, or None
        self._boards = {c.topic: board_seen_by(sensor_rig, c.topic) for c in self._cameras}
        count = (processes or PROCESSES) if self._cameras else 0
        # arguments of `Cameras` for the processes
        scene = pickle.dumps((model, sensor_rig, crowd, seed, mount_slips, light), protocol=5) if count else b""
        self._workers = [_Worker(scene) for _ in range(count)]
        self._idle: SimpleQueue[_Worker] = SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(max(count, 1))
        # batches in order of time: those not yet submitted, with their numbers of images, and those in progress
        self._waiting: deque[tuple[_Poses, int]] = deque()
        self._running: deque[Future[list[Image | Depth | Patch]]] = deque()
        # image sensors of the cameras with automatic exposure, which this process applies in order of time
        self._sensors = {
            c.topic: make_image_sensor(sensor_rig, c.topic, seed, light)
            for c in self._cameras
            if has_auto_exposure(sensor_rig, c.topic)
        }
        # by topic: stamps of the camera's clock
        self._stamps = {
            c.topic: Stamps(sensor_rig.sensors[c.topic].clock, c.rate_hz, Noise.of_topic(seed, f"{c.topic}#clock"))
            for c in self._cameras
        }

    @property
    def pids(self) -> list[int]:
        """Process numbers."""
        return [worker.pid for worker in self._workers]

    def request(self, motion: Motion, after_ns: int, until_ns: int) -> Iterator[Image | Depth]:
        """Starts to render the images after `after_ns` and up to `until_ns`.

        Args:
            motion: Motion at the instants of all images.
            after_ns: True time.
            until_ns: True time.

        Returns:
            The images in order of time with the stamps of their clocks; take them before those of the next request.
        """
        due: list[FrameRequest] = []
        # by topic and true time; also of the depth images, whose topic is "" for a camera without depth
        stamps: dict[tuple[str, int], int] = {}
        for camera in self._cameras:
            t_ns = instants(camera.rate_hz, after_ns, until_ns)
            stamped = zip(t_ns.tolist(), self._stamps[camera.topic].stamp(t_ns).tolist())
            stamps |= {(topic, t): stamp for t, stamp in stamped for topic in (camera.topic, camera.depth_topic)}
            # (N, 2, 6) velocities of the bodies that carry the camera and the board; 0 without a board
            board = self._boards[camera.topic]
            twist = np.zeros((len(t_ns), 2, 6))
            for i, body in enumerate([camera.mount.body, *([board.mount.body] if board else [])]):
                track = motion.carrier(body)[motion.rows(t_ns)]
                twist[:, i] = np.hstack([track.v_body_in_world, track.w_body])
            due += [FrameRequest(t_ns=t, topic=camera.topic, twist=w) for t, w in zip(t_ns.tolist(), twist)]
        due.sort(key=lambda item: item.t_ns)
        images = {camera.topic: 2 if camera.depth_topic else 1 for camera in self._cameras}  # per frame, by topic
        batches = [due[i : i + _BATCH] for i in range(0, len(due), _BATCH)]
        for batch in batches:
            rows = motion.rows(np.array([item.t_ns for item in batch], np.int64))
            poses = (batch, motion.qpos[rows], motion.upper_poses(rows))
            self._waiting.append((poses, sum(images[item.topic] for item in batch)))
        self._submit()
        return self._collect(len(batches), stamps)

    def _submit(self) -> None:
        """Keeps a bounded number of batches in progress."""
        while self._waiting and len(self._running) < _BATCHES:
            self._running.append(self._threads.submit(self._render, *self._waiting.popleft()))

    def _render(self, poses: _Poses, count: int) -> list[Image | Depth | Patch]:
        """The `count` images of one batch, from the next idle process; runs in a thread of the pool."""
        worker = self._idle.get()
        try:
            return worker.images(poses, count)
        finally:
            self._idle.put(worker)

    def _collect(self, batches: int, stamps: dict[tuple[str, int], int]) -> Iterator[Image | Depth]:
        """Images of the next batches in order of time, exposed where that depends on earlier images, and stamped.

        Args:
            batches: Number of batches.
            stamps: Stamp of each image by topic and true time; negative: before the recording, so it is dropped.
        """
        for _ in range(batches):
            rendered = self._running.popleft().result()
            self._submit()
            for image in rendered:
                stamp = stamps[image.topic, image.t_ns]
                if isinstance(image, Patch):  # the rendered part of an otherwise empty image
                    image = image.image()
                if isinstance(image, Image) and image.topic in self._sensors:
                    image = replace(image, pixels=self._sensors[image.topic].expose(image.t_ns, image.pixels))
                if stamp >= 0:  # an image whose stamp is the true time needs no copy
                    yield image if stamp == image.t_ns else replace(image, t_ns=stamp)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:  # a thread that waits for a process then fails, so that the pool can end
            worker.stop()
        self._threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.close()


class _Worker:
    """This side of one process; one thread at a time uses it.

    Args:
        scene: Pickled arguments of `Cameras`, which are sent before the first batch.
    """

    def __init__(self, scene: bytes) -> None:
        """Starts the process; `scene` is the pickled tuple of the arguments of `Cameras`."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "stridetwin.sim.rendering.rendering"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=_DRAWING | os.environ | {"LP_NUM_THREADS": "0"},  # llvmpipe draws in the process's own thread
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers, self._scene = self._process.stdin, self._process.stdout, scene
        _enlarge_buffer(self._answers)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def images(self, poses: _Poses, count: int) -> list[Image | Depth | Patch]:
        """The `count` images of a batch of frames.

        Raises:
            StrideTwinError: The process has ended.
        """
        try:
            self._requests.write(self._scene)  # before the first batch; empty afterwards
            self._scene = b""
            pickle.dump(poses, self._requests, protocol=5)
            self._requests.flush()
            return [pickle.load(self._answers) for _ in range(count)]
        except (EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
            raise StrideTwinError(
                f"a rendering process ended early (exit code {self._process.wait()}); its own message is above. "
                "Rendering needs EGL or OSMesa: run `make setup`, or leave the cameras out with --no-cameras"
            ) from error

    def stop(self) -> None:
        """Ends the process; it holds nothing that needs an orderly end. A thread that waits for it fails."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Closes the pipes of a process that has ended."""
        for pipe in (self._requests, self._answers):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


def _enlarge_buffer(pipe: IO[bytes]) -> None:
    """Lets a pipe hold whole images, so that its two ends do not wait for each other many times per image."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # the system's limit is lower: slower, but right
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
