"""Says how long a placement takes: its size before it starts, and the time left from its first walks."""

from __future__ import annotations

import sys
import time
from datetime import timedelta

from stridetwin.studies.placement.free import grid_size
from stridetwin.studies.placement.problem_file import Problem

_MANY_RECORDED, _MANY_POSED = 500, 50_000  # walks that are announced beforehand: some seconds, some 15 ms each
_LONG_S = 600.0  # time left that is announced


def places_of(problem: Problem) -> int:
    """Number of places that are measured, with the unchanged one; in a search at most."""
    return 1 + (grid_size(problem.knobs) if problem.search is None else problem.search.budget)


class Forecast:
    """Warns of a long placement, on stderr.

    Args:
        problem: The placement.
        found: Number of walks that an earlier run has measured.
        workers: Number of walks at a time.
    """

    def __init__(self, problem: Problem, found: int, workers: int) -> None:
        places, walks = places_of(problem), len(problem.bases) * len(problem.seeds)
        self._left = max(places * walks - found, 0)
        # Of the first walk the kernels are compiled; of two per worker the rate is known.
        self._known_from, self._done, self._begun_s = 1 + 2 * workers, 0, 0.0
        self.size = f"{places} places on {walks} walk{'s' if walks > 1 else ''}"
        is_posed = all(score.geometric for score in problem.scores)
        if self._left > (_MANY_POSED if is_posed else _MANY_RECORDED):
            _warn(f"{self.size}: {self._left} walks to measure; a coarser step, fewer seeds or a search take less")

    def measured(self) -> None:
        """Notes that one more walk has been measured at one place."""
        self._done, self._left = self._done + 1, self._left - 1
        if self._done == 1:
            self._begun_s = time.monotonic()
        if self._done == self._known_from:
            left_s = (time.monotonic() - self._begun_s) / (self._done - 1) * self._left
            if left_s > _LONG_S:
                rounded = timedelta(seconds=60 * round(left_s / 60))
                _warn(f"{self.size}: about {rounded} h left; Ctrl-C stops it, and --resume continues")


def _warn(text: str) -> None:
    print(f"stridetwin: warning: {text}", file=sys.stderr)
