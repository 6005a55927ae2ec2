"""Cameras rendered by two processes beside the twin's own, so that both cores draw.

Software rendering is what a walk with cameras spends its time on. Each process is this module run by the same Python:
it reads the model and its cameras, then chunks of poses, and answers with the finished pictures in order. A picture's
noise depends on seed, topic and time alone, so the number of processes changes no byte.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import IO, Any, Self

import mujoco
import numpy as np

from stridetwin.sim.bystanders import Crowd
from stridetwin.sim.cameras import Cameras
from stridetwin.sim.playback import Motion
from stridetwin.sim.sensor_suite import instants
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Depth, Image

PROCESSES = 2
_PIPE_BYTES = 1 << 20
_AHEAD = 12  # pictures that a process may be ahead of those that are asked for
Due = list[tuple[int, str]]


class CameraProcesses:
    """Renders the cameras of a rig chunk by chunk; a context manager, because processes hang on it.

    Args:
        model: Compiled model.
        cameras: The cameras as they really are; without any no process is started.
        crowd: Bystanders.
        seed: Seed of the walk.
        ideal: No noise.
    """

    def __init__(
        self, model: mujoco.MjModel, cameras: Sequence[CameraCalibration], crowd: Crowd, seed: int, ideal: bool
    ) -> None:  # fmt: skip
        self._cameras = list(cameras)
        self._workers = [_Worker(model, cameras, crowd, seed, ideal) for _ in range(PROCESSES if cameras else 0)]
        self._order: list[tuple[_Worker, int]] = []

    @property
    def pids(self) -> list[int]:
        """Process numbers."""
        return [worker.pid for worker in self._workers]

    def ask(self, motion: Motion, after_ns: int, until_ns: int) -> None:
        """Starts on the pictures after `after_ns` and up to `until_ns`."""
        due: Due = [
            (t, camera.topic) for camera in self._cameras for t in instants(camera.rate_hz, after_ns, until_ns).tolist()
        ]
        due.sort(key=lambda item: item[0])
        shared = [due[i :: len(self._workers)] for i in range(len(self._workers))]
        for worker, own in zip(self._workers, shared):
            rows = motion.rows(np.array([t for t, _ in own], np.int64))
            worker.ask((own, motion.qpos[rows], motion.upper_poses(rows)))
        pictures = {camera.topic: 2 if camera.depth_topic else 1 for camera in self._cameras}
        self._order = [(self._workers[i % len(self._workers)], pictures[topic]) for i, (_, topic) in enumerate(due)]

    def pictures(self) -> Iterator[Image | Depth]:
        """The pictures asked for, in order of time."""
        for worker, count in self._order:
            for _ in range(count):
                yield worker.answer()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.stop()


class _Worker:
    """The near end of one process."""

    def __init__(
        self, model: mujoco.MjModel, cameras: Sequence[CameraCalibration], crowd: Crowd, seed: int, ideal: bool
    ) -> None:  # fmt: skip
        self._stopped = False
        environment = os.environ | {"LP_NUM_THREADS": "0"}  # llvmpipe draws in the process's own thread
        self._process = subprocess.Popen(
            [sys.executable, "-m", "stridetwin.sim.camera_processes"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
        )  # fmt: skip
        _widen(self._ends[1])
        self._answers: queue.Queue[Image | Depth | None] = queue.Queue(_AHEAD)
        self._collecting = threading.Thread(target=self._collect, daemon=True)
        self._collecting.start()
        self.ask((model, list(cameras), crowd, seed, ideal))

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def _ends(self) -> tuple[IO[bytes], IO[bytes]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        return self._process.stdin, self._process.stdout

    def ask(self, what: Any) -> None:
        try:
            pickle.dump(what, self._ends[0], protocol=5)
            self._ends[0].flush()
        except BrokenPipeError as error:
            raise self._gone() from error

    def answer(self) -> Image | Depth:
        picture = self._answers.get()
        if picture is None:
            raise self._gone()
        return picture

    def _collect(self) -> None:
        """Takes pictures as they come, so that one process need not wait for the other's turn."""
        try:
            while not self._stopped:
                self._answers.put(pickle.load(self._ends[1]))
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            self._answers.put(None)

    def _gone(self) -> StrideTwinError:
        return StrideTwinError(
            f"a rendering process ended early (exit code {self._process.wait()}); what it wrote stands above. "
            "Rendering needs EGL or OSMesa: run `make setup`, or leave the cameras out with --no-cameras"
        )

    def stop(self) -> None:
        self._stopped = True
        self._process.kill()  # it holds nothing that needs an orderly end
        self._process.wait()
        while self._collecting.is_alive():  # it may wait for room for what is not wanted any more
            with contextlib.suppress(queue.Empty):
                self._answers.get(timeout=0.05)
        for end in self._ends:
            with contextlib.suppress(BrokenPipeError):
                end.close()


def _widen(pipe: IO[bytes]) -> None:
    """Lets a pipe hold whole pictures: else its two ends wait for each other many times a picture."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # the system's limit is lower: slower, but right
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)


def _serve(asked: IO[bytes], answers: IO[bytes]) -> None:
    model, cameras, crowd, seed, ideal = pickle.load(asked)
    with Cameras(model, cameras, crowd, seed, ideal) as rendering:
        while True:
            try:
                due, qpos, uppers = pickle.load(asked)
            except EOFError:
                return
            for picture in rendering.frames(due, qpos, uppers):
                pickle.dump(picture, answers, protocol=5)
            answers.flush()


if __name__ == "__main__":
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing that a library prints gets between the pictures
    try:
        _serve(sys.stdin.buffer, out)
    except (BrokenPipeError, KeyboardInterrupt):
        os._exit(0)  # the twin has left: nobody waits for the rest
