"""A job of a batch, the function that makes its row, and what runs it on a worker."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from stridetwin.streams.errors import StrideTwinError

Task = TypeVar("Task")
ResultT = TypeVar("ResultT")
Row = dict[str, object]
"""A row of any kind, as JSON holds it: figures by name."""
RowT = TypeVar("RowT", bound=Mapping[str, object])
"""The rows of one kind of job: `Row`, or a `TypedDict` that names their keys."""


@dataclass(frozen=True, kw_only=True)
class Job(Generic[Task]):
    """One job of a batch, whose result is one row.

    Attributes:
        name: Name for people and for its row's file.
        key: Digest of everything that determines its row (`content_key`); jobs with equal keys have equal rows.
        task: What is to be done; can be pickled.
        group: Jobs with the same group run on one worker, one after the other, and share what their function keeps
            between them, such as a simulated walk. A job without group runs alone.
    """

    name: str
    key: str
    task: Task
    group: str = ""


@dataclass(frozen=True)
class Failure:
    """What a job without a row has instead.

    It concerns this job alone, is not stored, and a later run tries the job again.

    Attributes:
        reason: Why the job has failed.
    """

    reason: str


@dataclass(frozen=True, kw_only=True)
class Work(Generic[Task, ResultT]):
    """The function that makes rows from tasks on a worker, and the versions of its code; can be pickled.

    Attributes:
        run: From the tasks of one group to a row or a `Failure` each, in order. An exception stops the whole batch.
        versions: Versions of the code that determine a row; every worker must have the same.
    """

    run: Callable[[Sequence[Task]], Iterable[ResultT | Failure]]
    versions: Callable[[], Mapping[str, str]]


def one_by_one(
    function: Callable[[Task], ResultT | Failure],
) -> Callable[[Sequence[Task]], Iterable[ResultT | Failure]]:
    """Makes `Work.run` from a function of one task; it pickles if the function does."""
    return partial(map, function)


def content_key(*content: object) -> str:
    """Digest of everything that determines a row (inputs, options, versions of the code): 16 hexadecimal digits.

    Args:
        *content: What determines the row; JSON must be able to hold it.
    """
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def run_group(work: Work[Task, ResultT], expected: Mapping[str, str], tasks: Sequence[Task]) -> list[ResultT | Failure]:
    """Runs the tasks of one group on a worker, and returns a result for each, in order.

    Args:
        work: The function that makes rows, and the versions of its code on this worker.
        expected: Versions of the code where the batch was started.
        tasks: Tasks of the group.

    Raises:
        StrideTwinError: The worker has other versions of the code than those expected.
    """
    versions = work.versions()
    if versions != expected:
        differing = ", ".join(f"{name} {versions[name]}" for name in versions if versions[name] != expected.get(name))
        raise StrideTwinError(f"a worker has other versions: {differing}; expected: the same on every worker")
    return list(work.run(tasks))
