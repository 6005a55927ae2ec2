"""Worker processes: each computes with one thread, and none outlives this process."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import TypeVar

from stridetwin.streams.errors import StrideTwinError

A = TypeVar("A")
B = TypeVar("B")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes; jobs that have not started when it closes are dropped."""
    with _one_thread_each():
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_with_parent)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


def mapped(act: Callable[[A], B], jobs: Sequence[A], workers: int) -> Iterator[B]:
    """Results in the order of the jobs, computed here or in worker processes.

    Raises:
        StrideTwinError: A worker died.
    """
    if workers == 1 or len(jobs) < 2:
        yield from map(act, jobs)
        return
    with _worker_deaths_reported(workers), processes(workers) as pool:
        yield from pool.map(act, jobs)


def as_done(act: Callable[[A], B], jobs: Sequence[A], workers: int) -> Iterator[tuple[A, B]]:
    """Jobs and their results in order of completion; otherwise as `mapped`."""
    if workers == 1 or len(jobs) < 2:
        yield from ((job, act(job)) for job in jobs)
        return
    with _worker_deaths_reported(workers), processes(workers) as pool:
        running = {pool.submit(act, job): job for job in jobs}
        for future in as_completed(running):
            yield running[future], future.result()


@contextmanager
def _worker_deaths_reported(workers: int) -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool:
        raise StrideTwinError(
            f"a worker process died; memory may be too small for {workers} at a time. Run it again with fewer "
            "--workers; commands with --resume continue where they stopped"
        ) from None


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Worker processes compute with one thread unless the user sets otherwise."""
    missing = [name for name in _THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(missing, "1"))
    try:
        yield
    finally:
        for name in missing:
            del os.environ[name]


def _end_with_parent() -> None:
    """A worker ends with the process that started it in every case, and prints nothing when it is stopped."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        connection.wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
