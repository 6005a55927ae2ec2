"""Who makes the walks: this process, processes beside it, or a Dask cluster. The rows are the same."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from stridetwin.scenarios.campaign.walk import Job, failed, make
from stridetwin.scenarios.processes import processes
from stridetwin.streams.errors import StrideTwinError

_DEATHS = 3
_DIED = "a worker died of it; does memory suffice?"
_WAIT_S = 60


def rows(jobs: Sequence[Job], workers: int, scheduler: str | None) -> Iterator[dict[str, Any]]:
    """Rows as walks get done.

    Args:
        jobs: What is to be made.
        workers: Processes on this machine.
        scheduler: Address of a Dask scheduler, whose workers make the walks instead.

    Raises:
        StrideTwinError: What stops all walks, such as a full disk.
    """
    if not jobs:
        return iter(())
    if scheduler is not None:
        return _clustered(jobs, scheduler)
    return _pooled(jobs, workers) if workers > 1 else map(make, jobs)


def _pooled(jobs: Sequence[Job], workers: int) -> Iterator[dict[str, Any]]:
    """On processes of this machine. Where one dies, the walks of that moment are made anew, each by itself.

    One of which the worker dies again has failed; where that happens one after the other, no walk is to blame.
    """
    left, dead = deque(jobs), list[str]()
    while left:
        running: dict[Future[dict[str, Any]], Job] = {}
        try:
            with processes(workers) as pool:
                while left or running:
                    while left and len(running) < workers:
                        running[pool.submit(make, left[0])] = left[0]
                        left.popleft()
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        row = future.result()
                        del running[future]
                        dead = []
                        yield row
        except BrokenProcessPool:
            names = ", ".join(job.walk.name for job in running.values())
            print(f"stridetwin: warning: a worker died; made anew, each by itself: {names}", file=sys.stderr)
            for job in running.values():
                alone = _alone(job)
                dead = [] if alone is not None else [*dead, job.walk.name]
                if len(dead) == _DEATHS:
                    raise StrideTwinError(
                        f"a worker alone died {_DEATHS} times, of {', '.join(dead)}; does memory suffice for one?"
                    ) from None
                yield alone or failed(job, _DIED)


def _alone(job: Job) -> dict[str, Any] | None:
    """The row of a walk that has a pool of its own; None where its worker died."""
    try:
        with processes(1) as pool:
            return pool.submit(make, job).result()
    except BrokenProcessPool:
        return None


def _clustered(jobs: Sequence[Job], address: str) -> Iterator[dict[str, Any]]:
    """On the workers of a Dask cluster, which all see the campaign's folder; Dask runs anew what a dead worker had."""
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as as_done
    except ModuleNotFoundError as error:
        raise StrideTwinError(
            f"{error.name} is not installed; --scheduler needs Dask: pip install 'stridetwin[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=_WAIT_S, set_as_default=False)
        client.wait_for_workers(1, timeout=_WAIT_S)
    except (OSError, ValueError) as error:
        raise StrideTwinError(f"--scheduler: {address!r}: no scheduler with workers answers there ({error})") from error
    with client:
        asked = {f"{job.walk.name}-{job.key}": job for job in jobs}
        futures = [client.submit(make, job, key=key, pure=False) for key, job in asked.items()]
        for future in as_done(futures, loop=client.loop):
            try:
                row = future.result()
            except KilledWorker:
                row = failed(asked[future.key], _DIED)
            yield row
            future.release()
