"""Who makes the walks: this process, processes beside it, or a Dask cluster. The rows are the same."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from stridetwin.scenarios.campaign.walk import Job, make
from stridetwin.scenarios.processes import processes
from stridetwin.streams.errors import StrideTwinError

_DEATHS = 3
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
    """On processes of this machine. Where one of them dies, the others' walks go on anew."""
    left, deaths = {job.walk.name: job for job in jobs}, 0
    while left:
        try:
            with processes(workers) as pool:
                running = [pool.submit(make, job) for job in left.values()]
                for future in as_completed(running):
                    row = future.result()
                    del left[row["walk"]]
                    deaths = 0
                    yield row
        except BrokenProcessPool:
            deaths += 1
            if deaths == _DEATHS:
                raise StrideTwinError(
                    f"a worker died {_DEATHS} times before its walk was done; does memory suffice for {workers}?"
                ) from None


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
        futures = [client.submit(make, job, key=f"{job.walk.name}-{job.key}", pure=False) for job in jobs]
        try:
            for future in as_done(futures, loop=client.loop):
                yield future.result()
                future.release()
        except KilledWorker as error:
            raise StrideTwinError(f"workers of the cluster die before a walk is done: {error}") from error
