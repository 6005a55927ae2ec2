"""Executors of a batch: this process, a pool of processes, or a Dask cluster. All give the same rows."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

from stridetwin.batch.jobs import Failure, Job, ResultT, Task, Work, run_group
from stridetwin.batch.processes import open_pool
from stridetwin.streams.errors import StrideTwinError, explain_import_error
from stridetwin.streams.notices import warn

_MAX_DEATHS = 3  # groups in a row whose worker died; then the batch stops
_DIED = Failure("its worker died; it may have run out of memory")
_TIMEOUT_S = 60  # for the connection to a scheduler, and for its first worker


@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """Options that every batch has.

    Attributes:
        folder: Output folder; a cluster's workers must see it under the same path.
        workers: Number of processes on this machine.
        scheduler: Address of a Dask scheduler, whose workers run the jobs instead.
    """

    folder: Path
    workers: int = 1
    scheduler: str | None = None


class Executor:
    """Runs jobs one after the other in this process; subclasses run several at a time elsewhere.

    Attributes:
        workers: Number of jobs at a time.
    """

    workers = 1

    def run(
        self, work: Work[Task, ResultT], groups: Sequence[Sequence[Job[Task]]]
    ) -> Iterator[tuple[Job[Task], ResultT | Failure]]:
        """Runs the groups of jobs in this process, one after the other.

        Args:
            work: How rows are made.
            groups: Jobs; those of a group run together.

        Yields:
            Each job with its result, in the order in which the groups end.

        Raises:
            StrideTwinError: An error that affects all jobs, such as a full disk, or workers that die one after another.
        """
        for group in groups:
            yield from zip(group, work.run([job.task for job in group]))


@contextmanager
def open_executor(workers: int = 1, scheduler: str | None = None) -> Iterator[Executor]:
    """Opens the executor of these options; it starts processes, or connects to the scheduler, when the first job runs.

    Args:
        workers: Number of processes; 1 runs the jobs in this process.
        scheduler: Address of a Dask scheduler, which then runs the jobs.
    """
    with ExitStack() as resources:
        if scheduler is not None:
            yield _Cluster(scheduler, resources)
        else:
            yield _Pool(workers, resources) if workers > 1 else Executor()


class _Pool(Executor):
    """Runs groups on processes of this machine.

    When one dies, the running groups are repeated, each in a process of its own. The jobs of a group whose worker dies
    again have failed; after three such groups in a row the batch stops.
    """

    def __init__(self, workers: int, resources: ExitStack) -> None:
        """Sets the number of processes; the pool, opened at the first run, is closed with `resources`."""
        self.workers, self._resources = workers, resources
        self._pool: ProcessPoolExecutor | None = None

    def run(
        self, work: Work[Task, ResultT], groups: Sequence[Sequence[Job[Task]]]
    ) -> Iterator[tuple[Job[Task], ResultT | Failure]]:
        """Runs the groups on several processes; jobs and results come in the order in which the groups end.

        If a process dies, its whole pool is lost. The groups that were running are then repeated one by one, each in a
        process of its own, and a new pool takes the remaining groups. The pool stays open for the next call.

        Raises:
            StrideTwinError: An error that affects all jobs, or the third group in a row whose worker dies.
        """
        versions = work.versions()  # of the code, the same for every worker
        waiting = deque(groups)  # groups that have not started
        failed_groups: list[str] = []  # names of the last groups in a row whose worker also died in the repetition
        while waiting:
            running: dict[Future[list[ResultT | Failure]], Sequence[Job[Task]]] = {}  # groups in the pool
            try:
                self._pool = self._pool or self._resources.enter_context(open_pool(self.workers))
                while waiting or running:
                    while waiting and len(running) < self.workers:
                        tasks = [job.task for job in waiting[0]]
                        # a group leaves `waiting` only after `submit`, which fails if the pool has died meanwhile
                        running[self._pool.submit(run_group, work, versions, tasks)] = waiting[0]
                        waiting.popleft()
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        results = future.result()  # one per job of the group
                        failed_groups = []
                        yield from zip(running.pop(future), results)
            except BrokenProcessPool:  # from `submit` or `result`: a process of the pool died
                self._resources.close()
                self._pool = None
                names = ", ".join(map(_name_of, running.values()))
                warn(f"a worker died; repeated, each in its own process: {names}")
                for group in running.values():
                    repeated_results = _run_alone(work, versions, group)  # None: its worker died again
                    failed_groups = [] if repeated_results is not None else _add_failed_group(failed_groups, group)
                    yield from zip(group, repeated_results or [_DIED] * len(group))


def _run_alone(
    work: Work[Task, ResultT], versions: Mapping[str, str], group: Sequence[Job[Task]]
) -> Sequence[ResultT | Failure] | None:
    """Runs a group in a process of its own; returns its results, or None if that process died.

    Args:
        work: How rows are made.
        versions: Versions of the code that the process must have.
        group: Jobs that run together.
    """
    try:
        with open_pool(1) as pool:
            return pool.submit(run_group, work, versions, [job.task for job in group]).result()
    except BrokenProcessPool:
        return None


def _add_failed_group(failed_groups: Sequence[str], group: Sequence[Job[Task]]) -> list[str]:
    """Adds the name of a group whose worker died to the names of those before it in a row, and returns them all.

    Raises:
        StrideTwinError: It is the third one.
    """
    names = [*failed_groups, _name_of(group)]
    if len(names) == _MAX_DEATHS:
        raise StrideTwinError(
            f"a single worker died {_MAX_DEATHS} times, on {', '.join(names)}; it may have run out of memory"
        )
    return names


def _name_of(group: Sequence[Job[Task]]) -> str:
    """Name of a group in messages: its first job's, and how many more jobs it has."""
    return group[0].name if len(group) == 1 else f"{group[0].name} and {len(group) - 1} more"


class _Cluster(Executor):
    """Runs groups on the workers of a Dask scheduler, which repeats the groups of a dead worker."""

    def __init__(self, address: str, resources: ExitStack) -> None:
        """Sets the scheduler's address; the connection, made at the first run, is closed with `resources`."""
        self._address, self._resources = address, resources
        self._client: Any = None

    def run(
        self, work: Work[Task, ResultT], groups: Sequence[Sequence[Job[Task]]]
    ) -> Iterator[tuple[Job[Task], ResultT | Failure]]:
        """Runs the groups on the scheduler's workers; jobs and results come in the order in which the groups end.

        Raises:
            StrideTwinError: An error that affects all jobs, the third group in a row whose worker dies, or no
                scheduler.
        """
        if not groups:
            return
        client, versions = self._connect(), work.versions()
        failed_groups: list[str] = []  # names of the last groups in a row whose worker died
        from distributed import KilledWorker, as_completed

        run = uuid4().hex  # another run on the same cluster may have a job of the same name
        # groups by the keys of Dask's tasks
        by_key = {f"{group[0].name}-{run}-{i}": group for i, group in enumerate(groups)}
        # `pure=False`: Dask must not take the result of an earlier task with equal arguments
        futures = [
            client.submit(run_group, work, versions, [job.task for job in group], key=key, pure=False)
            for key, group in by_key.items()
        ]
        for future in as_completed(futures, loop=client.loop):
            group = by_key[future.key]
            try:
                results: Sequence[ResultT | Failure] = future.result()
                failed_groups = []
            except KilledWorker:
                failed_groups = _add_failed_group(failed_groups, group)
                results = [_DIED] * len(group)
            yield from zip(group, results)
            future.release()  # frees the result on the cluster

    def _connect(self) -> Any:
        """The client of the scheduler, which connects at the first call and sets `workers` to the cluster's threads.

        Raises:
            StrideTwinError: Dask is not installed, or no scheduler with workers answers within a minute.
        """
        if self._client is not None:  # an earlier call has connected
            return self._client
        with explain_import_error("--scheduler needs Dask", "cluster"):
            from distributed import Client
        try:
            client = Client(self._address, timeout=_TIMEOUT_S, set_as_default=False)
            client.wait_for_workers(1, timeout=_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise StrideTwinError(
                f"--scheduler: {self._address!r}: no scheduler with workers there ({error})"
            ) from error
        self._client = self._resources.enter_context(client)
        self.workers = max(sum(client.nthreads().values()), 1)
        return self._client
