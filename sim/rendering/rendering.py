"""The far end of a rendering process: poses in, images out. `sim.rendering.camera_processes` runs it as a program."""

from __future__ import annotations

import os
import pickle
import sys
from typing import IO

import cv2

from stridetwin.sim.rendering.cameras import Cameras


def _serve(asked: IO[bytes], answers: IO[bytes]) -> None:
    cv2.setNumThreads(1)  # the other core has the other process
    with Cameras(*pickle.load(asked)) as rendering:
        while True:
            try:
                due, qpos, uppers = pickle.load(asked)
            except EOFError:
                return
            for image in rendering.frames(due, qpos, uppers):
                pickle.dump(image, answers, protocol=5)
            answers.flush()


if __name__ == "__main__":
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing that a library prints gets between the images
    try:
        _serve(sys.stdin.buffer, out)
    except (BrokenPipeError, KeyboardInterrupt):
        os._exit(0)  # the twin has left: nobody waits for the rest
