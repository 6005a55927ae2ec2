"""The time that a long batch still takes, on stderr, once its first jobs have shown their speed."""

from __future__ import annotations

import time
from datetime import timedelta

from stridetwin.streams.notices import warn

_LONG_S = 600.0
"""A time left of more than this is announced."""


class Forecast:
    """Announces the time left of a long batch.

    Args:
        size: Size of the batch as text, such as `1000 walks`.
        count: Number of jobs to run.
        resume: How a stopped batch continues, such as `--resume continues`; "" if it does not.
    """

    def __init__(self, size: str, count: int, resume: str) -> None:
        self._size, self._resume = size, resume
        self._left = count  # number of jobs that have not ended
        self._ended = 0  # number of jobs that have ended
        self._start_s = 0.0  # when the first one ended, by the monotonic clock
        self._is_announced = False  # the time left is announced once

    def count_job(self, workers: int) -> None:
        """Notes that a job has ended, and announces the time left once the speed is known.

        Args:
            workers: Number of jobs that run at a time.
        """
        self._ended += 1
        self._left -= 1
        if self._ended == 1:
            self._start_s = time.monotonic()
        # the first job also compiles kernels, so the time is taken from its end on; two more per worker show the speed
        if self._ended == 1 + 2 * workers and not self._is_announced:
            self._is_announced = True
            # mean time per job after the first one, times the jobs left
            left_s = (time.monotonic() - self._start_s) / (self._ended - 1) * self._left
            if left_s > _LONG_S:
                # whole minutes, shown as H:MM:SS
                rounded = timedelta(seconds=60 * round(left_s / 60))
                more = f", and {self._resume}" if self._resume else ""
                warn(f"{self._size}: about {rounded} h left; Ctrl-C stops it{more}")
