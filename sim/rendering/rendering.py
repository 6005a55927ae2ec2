"""A rendering process, run as a program by `sim.rendering.camera_processes`: frames and poses in, images out."""

from __future__ import annotations

import os
import pickle
import sys
from typing import IO

import cv2

from stridetwin.sim.rendering.cameras import Cameras


def _serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answers batches of frames until the requests end.

    The first pickled object has the arguments of `Cameras`. Every further one has the frames of a batch, the
    generalised position at each, and the pose of each shoe's upper. The answers are the pickled images, one by one.
    """
    cv2.setNumThreads(1)  # the other core has the other process
    with Cameras(*pickle.load(requests)) as cameras:
        while True:
            try:
                due, qpos, uppers = pickle.load(requests)
            except EOFError:
                return
            for image in cameras.frames(due, qpos, uppers):
                pickle.dump(image, answers, protocol=5)
            answers.flush()


if __name__ == "__main__":
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing that a library prints gets between the images
    try:
        _serve(sys.stdin.buffer, out)
    except (BrokenPipeError, KeyboardInterrupt):
        os._exit(0)  # the twin has ended: nobody waits for the rest
