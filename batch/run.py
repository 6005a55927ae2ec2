"""Runs a batch: reuses the rows that are there, runs the missing jobs, and stores each row when its job ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic

from stridetwin.batch.executors import BatchOptions, Executor, open_executor
from stridetwin.batch.folder import hold_folder
from stridetwin.batch.forecast import Forecast
from stridetwin.batch.jobs import Failure, Job, RowT, Task, Work
from stridetwin.batch.rows import RowLines, RowStore

Progress = Callable[[str, float], None]
ROWS = "rows.jsonl"
"""File of the rows of `run_batch` in its folder."""


class Batch(Generic[Task, RowT]):
    """Jobs, and the rows that they have already.

    Args:
        jobs: The jobs; those with equal keys are run once.
        store: Rows of earlier runs, and the place for new ones; None keeps none.
        resume: Reuses the rows of earlier runs.
        update_row: From a job and its stored row to its current row, or None if it must be run again.

    Attributes:
        results: By key of a job: its row, or, after `run`, the `Failure` that it has instead.
        missing: Jobs without a row.
        outdated: Number of missing jobs with a row that is damaged or of another version.
    """

    def __init__(
        self,
        jobs: Sequence[Job[Task]],
        store: RowStore[RowT] | None,
        *,
        resume: bool = True,
        update_row: Callable[[Job[Task], RowT], RowT | None] = lambda job, row: row,
    ) -> None:
        self._jobs, self._store = jobs, store
        self.results: dict[str, RowT | Failure] = {}
        self.missing: list[Job[Task]] = []
        self.outdated = 0
        unique = {job.key: job for job in jobs}  # jobs with equal keys have equal rows, so one of them runs
        self._count = len(unique)  # number of rows that the batch needs
        for job in unique.values():
            stored = store.read(job) if store is not None and resume else None
            row = None if stored is None else update_row(job, stored)
            if row is not None:
                self.results[job.key] = row
                continue
            self.missing.append(job)
            # it has a row, but one that is damaged, of another version, or to be made again
            self.outdated += bool(resume and store is not None and store.has_any(job))

    def run(
        self,
        work: Work[Task, RowT],
        executor: Executor,
        progress: Callable[[float], None],
        forecast: Forecast | None = None,
    ) -> list[RowT | Failure]:
        """Runs the missing jobs.

        Args:
            work: How their rows are made.
            executor: Where they run.
            progress: Receives the share of jobs with a result (0-1).
            forecast: Announces the time left.

        Returns:
            The result of each job, in order: its row, or a `Failure`, which is not stored.

        Raises:
            StrideTwinError: An error that affects all jobs. Rows of finished jobs are stored.
        """
        progress(self._share)
        for job, result in executor.run(work, _groups_of(self.missing)):  # in the order in which groups end
            self.results[job.key] = result
            if self._store is not None and not isinstance(result, Failure):
                self._store.write(job, result)
            if forecast is not None:
                forecast.count_job(executor.workers)
            progress(self._share)
        return [self.results[job.key] for job in self._jobs]

    def run_with(
        self, options: BatchOptions, work: Work[Task, RowT], stage: str, progress: Progress, resume: str
    ) -> list[RowT | Failure]:
        """Runs the missing jobs on an executor that is opened for them, and announces the time left.

        Args:
            options: Number of workers, or the scheduler; the folder is not used here.
            work: How the rows are made.
            stage: What runs, for progress and forecast.
            progress: Receives the stage and its progress (0-1).
            resume: How a stopped batch continues, such as `--resume continues`; "" if it does not.

        Returns:
            The result of each job, in order: its row, or a `Failure`, which is not stored.

        Raises:
            StrideTwinError: An error that affects all jobs. Rows of finished jobs are stored.
        """
        forecast = Forecast(f"{stage}: {len(self._jobs)} jobs", len(self.missing), resume)
        with open_executor(options.workers, options.scheduler) as executor:
            return self.run(work, executor, lambda share: progress(stage, share), forecast)

    @property
    def _share(self) -> float:
        """Share of the jobs that have a result, 0-1; jobs with equal keys count as one."""
        return len(self.results) / self._count if self._count else 1.0


def _groups_of(jobs: Iterable[Job[Task]]) -> list[list[Job[Task]]]:
    """Collects the jobs by their groups, in the order of each group's first job.

    A job without a group, "", is in one of its own, whose key is the job's number.
    """
    groups: dict[str | int, list[Job[Task]]] = {}
    for i, job in enumerate(jobs):
        groups.setdefault(job.group or i, []).append(job)
    return list(groups.values())


def run_batch(
    jobs: Sequence[Job[Task]], work: Work[Task, RowT], options: BatchOptions, stage: str, progress: Progress
) -> list[RowT | Failure]:
    """Runs jobs, such as every variant of an estimator on every walk, to rows in a folder, and reuses its rows.

    Jobs that share costly work, such as the recording of one walk, have the same `Job.group`: `work.run` gets their
    tasks together. Equal jobs give equal bytes of the folder's `rows.jsonl`, for any number of processes or a cluster.

    Args:
        jobs: The jobs.
        work: How their rows are made.
        options: Folder and workers.
        stage: What runs, for progress.
        progress: Receives the stage and its progress (0-1).

    Returns:
        The row of each job, in order, or a `Failure`, which the next run repeats.

    Raises:
        StrideTwinError: Another process uses the folder, or an error that affects all jobs. Finished rows are kept.
    """
    file = options.folder / ROWS
    with hold_folder(options.folder, file.exists) as unfinished:
        store: RowLines[RowT] = RowLines(file, unfinished)
        results = Batch(jobs, store).run_with(options, work, stage, progress, "the same command continues")
        # the file has the order of the jobs, not that in which they ended
        store.sort([job.key for job in jobs])
    return results
