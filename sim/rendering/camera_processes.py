"""Cameras rendered by two processes beside the twin's own, so that both cores draw.

Software rendering takes most of the time of a walk with cameras. Each process runs `sim.rendering.rendering` with the
same Python: it reads the model and its sensors, then chunks of poses, and returns the images in order. The noise of an
image depends on seed, topic and time alone. This side sets the exposure where the gain follows from the previous image.
So the number of processes changes no byte.
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
from collections.abc import Iterator
from dataclasses import replace
from types import TracebackType
from typing import IO, Any, Self

import mujoco
import numpy as np

from stridetwin.sim.noise import Noise
from stridetwin.sim.playback import Motion
from stridetwin.sim.rendering.cameras import Due, Patch, board_seen_by, follows, sensor_of
from stridetwin.sim.sensors.model import Stamps, instants
from stridetwin.sim.sensors.mount_slip import MountSlips
from stridetwin.sim.sensors.standard_rig import SensorRig
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Depth, Image

PROCESSES = 2
_PIPE_BYTES = 1 << 20
_DRAWING = {"GALLIVM_PERF": "brilinear,rho_approx"}  # llvmpipe: textures in two thirds of the time, alike to the eye
_AHEAD = 48  # pictures that a process may be ahead of those that are asked for
_COST_BOARD, _COST_WHOLE = 1.0, 5.0  # of a picture with nothing but the board's surroundings, and of a whole one


class CameraProcesses:
    """Renders the cameras of a rig chunk by chunk; a context manager, because processes hang on it.

    Args:
        model: Compiled model.
        sensor_rig: The sensors as they really are; without any camera no process is started.
        crowd: Bystanders.
        seed: Seed of the walk.
        mount_slips: What holds the cameras.
        processes: How many; None: `PROCESSES`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sensor_rig: SensorRig,
        crowd: Crowd,
        seed: int,
        mount_slips: MountSlips | None = None,
        processes: int | None = None,
    ) -> None:
        self._cameras = list(sensor_rig.rig.cameras.values())
        self._seen = {c.topic: board_seen_by(sensor_rig, c.topic) for c in self._cameras}
        count = (processes or PROCESSES) if self._cameras else 0
        what = _pickled((model, sensor_rig, crowd, seed, mount_slips)) if count else b""
        self._workers = [_Worker(what) for _ in range(count)]
        self._dealer = _Dealer(sensor_rig, len(self._workers))
        self._sensors = {
            c.topic: sensor_of(sensor_rig, c.topic, seed) for c in self._cameras if follows(sensor_rig, c.topic)
        }
        self._stamps = {
            c.topic: Stamps(sensor_rig.sensors[c.topic].clock, c.rate_hz, Noise.of_topic(seed, f"{c.topic}#clock"))
            for c in self._cameras
        }

    @property
    def pids(self) -> list[int]:
        """Process numbers."""
        return [worker.pid for worker in self._workers]

    def ask(self, motion: Motion, after_ns: int, until_ns: int) -> Iterator[Image | Depth]:
        """Starts on the pictures after `after_ns` and up to `until_ns`.

        Returns:
            They, in order of time and with their clocks' stamps, to be taken before those that are asked for next.
        """
        due: list[Due] = []
        stamps: dict[tuple[str, int], int] = {}
        for camera in self._cameras:
            t_ns = instants(camera.rate_hz, after_ns, until_ns)
            stamps |= {
                (camera.topic, t): s for t, s in zip(t_ns.tolist(), self._stamps[camera.topic].of(t_ns).tolist())
            }
            board = self._seen[camera.topic]
            twist = np.zeros((len(t_ns), 2, 6))
            for i, body in enumerate([camera.mount.body, *([board.mount.body] if board else [])]):
                track = motion.carrier(body)[motion.rows(t_ns)]
                twist[:, i] = np.hstack([track.v_body_in_world, track.w_body])
            due += [Due(t_ns=t, topic=camera.topic, twist=w) for t, w in zip(t_ns.tolist(), twist)]
        due.sort(key=lambda item: item.t_ns)
        whose = [self._dealer.worker_for(item.topic) for item in due]
        for i, worker in enumerate(self._workers):
            own = [item for item, at in zip(due, whose) if at == i]
            rows = motion.rows(np.array([item.t_ns for item in own], np.int64))
            worker.ask(_pickled((own, motion.qpos[rows], motion.upper_poses(rows))))
        pictures = {camera.topic: 2 if camera.depth_topic else 1 for camera in self._cameras}
        order = [(self._workers[i], pictures[item.topic], stamps[item.topic, item.t_ns]) for i, item in zip(whose, due)]
        return self._answers(order)

    def _answers(self, order: list[tuple[_Worker, int, int]]) -> Iterator[Image | Depth]:
        for worker, count, stamp in order:
            for _ in range(count):
                picture = worker.answer()
                if isinstance(picture, Image) and picture.topic in self._sensors:
                    pixels = self._sensors[picture.topic].exposed(picture.t_ns, picture.pixels)
                    picture = replace(picture, pixels=pixels)
                if stamp >= 0:
                    yield picture if stamp == picture.t_ns else replace(picture, t_ns=stamp)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.stop()


class _Dealer:
    """Deals pictures out so that the processes have as much to do as each other."""

    def __init__(self, sensor_rig: SensorRig, workers: int) -> None:
        self._load, self._cost = [0.0] * max(workers, 1), {}
        for topic, camera in sensor_rig.rig.cameras.items():
            board_alone = sensor_rig.sensors[topic].sensor_config.frames == "board" and not camera.depth_topic
            self._cost[topic] = _COST_BOARD if board_alone else _COST_WHOLE

    def worker_for(self, topic: str) -> int:
        chosen = self._load.index(min(self._load))
        self._load[chosen] += self._cost[topic]
        return chosen


class _Worker:
    """The near end of one process."""

    def __init__(self, what: bytes) -> None:
        self._stopped = False
        environment = _DRAWING | os.environ | {"LP_NUM_THREADS": "0"}  # llvmpipe draws in the process's own thread
        self._process = subprocess.Popen(
            [sys.executable, "-m", "stridetwin.sim.rendering.rendering"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
        )  # fmt: skip
        _widen(self._ends[1])
        self._answers: queue.Queue[Image | Depth | Patch | None] = queue.Queue(_AHEAD)
        self._asked: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._send, self._collect)]
        for thread in self._threads:
            thread.start()
        self.ask(what)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def _ends(self) -> tuple[IO[bytes], IO[bytes]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        return self._process.stdin, self._process.stdout

    def ask(self, what: bytes) -> None:
        self._asked.put(what)

    def answer(self) -> Image | Depth:
        picture = self._answers.get()
        if picture is None:
            raise self._gone()
        return picture.image() if isinstance(picture, Patch) else picture

    def _send(self) -> None:
        """Passes on what is asked as the process takes it: it may still be starting."""
        with contextlib.suppress(OSError, ValueError):  # it has gone; who waits for its answers is told so
            for what in iter(self._asked.get, None):
                self._ends[0].write(what)
                self._ends[0].flush()

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
        self._asked.put(None)
        while any(thread.is_alive() for thread in self._threads):  # one may wait for room for what nobody wants now
            with contextlib.suppress(queue.Empty):
                self._answers.get(timeout=0.05)
        for end in self._ends:
            with contextlib.suppress(BrokenPipeError):
                end.close()


def _pickled(what: Any) -> bytes:
    return pickle.dumps(what, protocol=5)


def _widen(pipe: IO[bytes]) -> None:
    """Lets a pipe hold whole pictures: else its two ends wait for each other many times a picture."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # the system's limit is lower: slower, but right
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
