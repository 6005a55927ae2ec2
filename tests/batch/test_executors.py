"""Jobs on processes that die, on workers with other versions, and in groups: the same rows wherever they run."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from frail_pool import make_frail
from local_cluster import open_cluster

from stridetwin.batch.executors import open_executor
from stridetwin.batch.jobs import Failure, Job, Work, content_key, one_by_one
from stridetwin.batch.run import Batch
from stridetwin.streams.errors import StrideTwinError

DIED = Failure("its worker died; it may have run out of memory")


def versions():
    return {"sources": "one"}


def versions_by_process():
    return {"sources": str(os.getpid())}


def square(task):
    return {"square": task * task}


def with_ids(tasks):
    for task in tasks:
        yield {"task": task, "process": os.getpid(), "tasks": len(tasks)}


def die_once(task):
    """Kills its process, unless an earlier one has died of the same task."""
    mark = Path(task)
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"name": mark.name}


def refuse(task):
    raise StrideTwinError(f"the disk is full at {task}")


SQUARES = Work(run=one_by_one(square), versions=versions)


def jobs_of(tasks, group=lambda task: ""):
    return [Job(name=f"job_{task}", key=content_key(task), task=task, group=group(task)) for task in tasks]


def run(jobs, work=SQUARES, **options):
    with open_executor(**options) as executor:
        return Batch(jobs, None).run(work, executor, lambda share: None)


@pytest.fixture(scope="module")
def cluster():
    with open_cluster() as local:
        yield {"scheduler": local.scheduler_address}


@pytest.fixture(params=["process", "pool", "cluster"])
def where(request):
    """Options of each executor."""
    if request.param == "cluster":
        return request.getfixturevalue("cluster")
    return {"workers": {"process": 1, "pool": 2}[request.param]}


def test_results_are_in_the_order_of_the_jobs_wherever_they_run(where):
    assert run(jobs_of([3, 1, 2, 5]), **where) == [{"square": n} for n in (9, 1, 4, 25)]
    assert run([], **where) == []


def test_jobs_with_the_same_key_run_once(where):
    rows = run(jobs_of([3, 3, 2]), Work(run=with_ids, versions=versions), **where)
    assert rows[0] is rows[1]
    assert [row["task"] for row in rows] == [3, 3, 2]


def test_a_group_runs_on_one_worker_in_order(where):
    rows = run(
        jobs_of(range(6), lambda n: "even" if n % 2 == 0 else ""), Work(run=with_ids, versions=versions), **where
    )
    assert [row["task"] for row in rows] == list(range(6))
    assert len({row["process"] for row in rows[::2]}) == 1
    assert [row["tasks"] for row in rows] == [3, 1] * 3


def test_an_error_that_concerns_all_jobs_stops_the_batch(where):
    with pytest.raises(StrideTwinError, match="the disk is full at 1"):
        run(jobs_of([1]), Work(run=one_by_one(refuse), versions=versions), **where)


def test_workers_of_another_version_stop_the_batch(cluster):
    for options in ({"workers": 2}, cluster):
        with pytest.raises(StrideTwinError, match=r"other versions: sources \d+; expected: the same on every worker"):
            run(jobs_of([1, 2]), Work(run=one_by_one(square), versions=versions_by_process), **options)


@pytest.mark.parametrize("options", ["pool", "cluster"])
def test_the_job_of_a_killed_worker_is_repeated(options, cluster, tmp_path, capsys):
    tasks = [str(tmp_path / name) for name in ("a", "b", "c")]
    for task in tasks[:2]:
        Path(task).touch()
    jobs = [Job(name=Path(task).name, key=task, task=task) for task in tasks]
    where = cluster if options == "cluster" else {"workers": 2}
    assert run(jobs, Work(run=one_by_one(die_once), versions=versions), **where) == [{"name": n} for n in "abc"]
    if options == "pool":
        assert "a worker died; repeated, each in its own process: " in capsys.readouterr().err


def test_a_job_of_which_every_worker_dies_has_failed_and_the_others_run(monkeypatch, capsys):
    sizes = make_frail(monkeypatch, lambda task: task == 2)
    assert run(jobs_of(range(6)), workers=2) == [DIED if n == 2 else {"square": n * n} for n in range(6)]
    assert sizes[0] == sizes[-1] == 2
    assert "a worker died; repeated, each in its own process: job_2" in capsys.readouterr().err


def test_workers_that_die_of_every_job_stop_the_batch(monkeypatch):
    make_frail(monkeypatch, lambda task: True)
    with pytest.raises(StrideTwinError, match="a single worker died 3 times, on job_0, job_1, job_2; it may have run"):
        run(jobs_of(range(6)), workers=2)


def test_a_group_of_which_every_worker_dies_has_failed_as_a_whole(monkeypatch, capsys):
    make_frail(monkeypatch, lambda task: task == 2)
    rows = run(jobs_of(range(5), lambda n: "even" if n % 2 == 0 else "odd"), workers=2)
    assert rows == [DIED, {"square": 1}, DIED, {"square": 9}, DIED]
    assert "each in its own process: job_0 and 2 more" in capsys.readouterr().err


def test_an_address_without_scheduler_is_one_error(monkeypatch):
    pytest.importorskip("distributed")
    from stridetwin.batch import executors

    monkeypatch.setattr(executors, "_TIMEOUT_S", 0.2)
    with pytest.raises(StrideTwinError, match=r"--scheduler: 'tcp://127.0.0.1:9': no scheduler with workers there"):
        run(jobs_of([1]), scheduler="tcp://127.0.0.1:9")
