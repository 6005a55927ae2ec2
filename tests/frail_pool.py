"""A pool of processes that die of some tasks, and take with them what the other processes work on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import Any


class FrailPool:
    """In place of `ProcessPoolExecutor`; runs the others in this process.

    Attributes:
        is_deadly: Whether a worker dies of a task.
        sizes: Number of processes of each pool.
    """

    is_deadly: Callable[[Any], bool] = staticmethod(lambda task: False)
    sizes: list[int] = []  # noqa: RUF012

    def __init__(self, workers: int, **_: object) -> None:
        self._is_dead = False
        FrailPool.sizes.append(workers)

    def submit(self, run: Callable, work: object, versions: object, tasks: Sequence[Any]) -> Future:
        self._is_dead |= any(FrailPool.is_deadly(task) for task in tasks)
        future: Future = Future()
        if self._is_dead:
            future.set_exception(BrokenProcessPool())
        else:
            future.set_result(run(work, versions, tasks))
        return future

    def shutdown(self, **_: object) -> None:
        pass


def make_frail(monkeypatch, is_deadly: Callable[[Any], bool]) -> list[int]:
    """Lets the workers of every pool die of some tasks; returns the list of the pools' sizes."""
    from stridetwin.batch import processes

    monkeypatch.setattr(processes, "ProcessPoolExecutor", FrailPool)
    monkeypatch.setattr(FrailPool, "is_deadly", staticmethod(is_deadly))
    monkeypatch.setattr(FrailPool, "sizes", [])
    return FrailPool.sizes
