"""Executors of a campaign: this process, a pool of processes, or a Dask cluster. All give the same rows."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from stridetwin.scenarios.campaign.walk import Job, failed, make
from stridetwin.scenarios.processes import processes
from stridetwin.streams.errors import StrideTwinError, needing

_DEATHS = 3
_DIED = "its worker died; it may have run out of memory"
_WAIT_S = 60


def rows(jobs: Sequence[Job], workers: int, scheduler: str | None) -> Iterator[dict[str, Any]]:
    """Rows, in the order in which walks finish, from processes on this machine or the workers of a Dask scheduler.

    Raises:
        StrideTwinError: An error that affects all walks, such as a full disk.
    """
    if not jobs:
        return iter(())
    if scheduler is not None:
        return _clustered(jobs, scheduler)
    return _pooled(jobs, workers) if workers > 1 else map(make, jobs)


def _pooled(jobs: Sequence[Job], workers: int) -> Iterator[dict[str, Any]]:
    """On processes of this machine. When one dies, the running walks are repeated, each in a process of its own.

    A walk whose worker dies again has failed; after `_DEATHS` such walks in a row the campaign stops.
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
            print(f"stridetwin: warning: a worker died; repeated, each in its own process: {names}", file=sys.stderr)
            for job in running.values():
                alone = _alone(job)
                dead = [] if alone is not None else [*dead, job.walk.name]
                if len(dead) == _DEATHS:
                    raise StrideTwinError(
                        f"a single worker died {_DEATHS} times, on {', '.join(dead)}; it may have run out of memory"
                    ) from None
                yield alone or failed(job, _DIED)


def _alone(job: Job) -> dict[str, Any] | None:
    """The row of a walk in a pool of its own; None where its worker died."""
    try:
        with processes(1) as pool:
            return pool.submit(make, job).result()
    except BrokenProcessPool:
        return None


def _clustered(jobs: Sequence[Job], address: str) -> Iterator[dict[str, Any]]:
    """On the workers of a Dask cluster that share the campaign's folder; Dask repeats the walks of a dead worker."""
    with needing("--scheduler needs Dask", "cluster"):
        from distributed import Client, KilledWorker
        from distributed import as_completed as as_done
    try:
        client = Client(address, timeout=_WAIT_S, set_as_default=False)
        client.wait_for_workers(1, timeout=_WAIT_S)
    except (OSError, ValueError) as error:
        raise StrideTwinError(f"--scheduler: {address!r}: no scheduler with workers there ({error})") from error
    with client:
        by_key = {f"{job.walk.name}-{job.key}": job for job in jobs}
        futures = [client.submit(make, job, key=key, pure=False) for key, job in by_key.items()]
        for future in as_done(futures, loop=client.loop):
            try:
                row = future.result()
            except KilledWorker:
                row = failed(by_key[future.key], _DIED)
            yield row
            future.release()
