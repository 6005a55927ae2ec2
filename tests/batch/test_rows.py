"""Stores of rows: what is kept, what is run again, and whose bytes do not depend on the order of the work."""

from __future__ import annotations

import json

import pytest

from stridetwin.batch.executors import BatchOptions, open_executor
from stridetwin.batch.folder import hold_folder, read_request, write_request
from stridetwin.batch.forecast import Forecast
from stridetwin.batch.jobs import Failure, Job, Work, content_key, one_by_one
from stridetwin.batch.rows import RowFiles, RowLines
from stridetwin.batch.run import Batch, run_batch
from stridetwin.streams.errors import StrideTwinError


def job(name, version="1"):
    return Job(name=name, key=f"{name}-{version}", task=name)


@pytest.fixture
def run(tmp_path):
    """Runs jobs in this process and returns the names of those that have run."""

    def run(jobs, store, failing=(), **options):
        ran = []

        def work(task):
            ran.append(task)
            return Failure("no reason") if task in failing else {"b": task, "a": 1}

        with open_executor() as executor:
            Batch(jobs, store, **options).run(Work(run=one_by_one(work), versions=dict), executor, lambda share: None)
        return ran

    return run


def stores(folder):
    return RowFiles(folder, folder, is_sorted=False), RowLines(folder / "rows.jsonl", folder)


def test_rows_are_kept_until_their_key_changes(tmp_path, run):
    for i in range(2):
        assert run([job("x"), job("y")], stores(tmp_path)[i]) == ["x", "y"]
        assert run([job("y"), job("z")], stores(tmp_path)[i]) == ["z"]
        assert run([job("x"), job("y", "2")], stores(tmp_path)[i]) == ["y"]
        assert run([job("x")], stores(tmp_path)[i], resume=False) == ["x"]


def test_the_row_of_a_failed_job_is_not_kept(tmp_path, run):
    for store in stores(tmp_path):
        assert run([job("x"), job("y")], store, failing=["x"]) == ["x", "y"]
        assert run([job("x"), job("y")], store) == ["x"]


def test_files_have_the_keys_in_their_order_or_sorted(tmp_path, run):
    for is_sorted, text in ((False, '{"key": "x-1", "b": "x", "a": 1}'), (True, '{"a": 1, "b": "x", "key": "x-1"}')):
        run([job("x")], RowFiles(tmp_path, tmp_path, is_sorted=is_sorted), resume=False)
        assert (tmp_path / "x.json").read_text() == text


@pytest.mark.parametrize("damaged", [b"", b'{"cut', b"[1]", b"3", b"\xff", b'{"a": 1}'])
def test_damaged_files_count_as_outdated(tmp_path, damaged):
    (tmp_path / "x.json").write_bytes(damaged)
    batch = Batch([job("x"), job("y")], RowFiles(tmp_path, tmp_path, is_sorted=False))
    assert ([j.name for j in batch.missing], batch.outdated) == (["x", "y"], 1)


@pytest.mark.parametrize("damaged", [b'{"cut', b"\xff", b"[1]\n"])
def test_lines_are_read_up_to_a_half_one_which_goes_with_the_next_row(tmp_path, run, damaged):
    file = tmp_path / "rows.jsonl"
    run([job("x")], RowLines(file, tmp_path))
    whole = file.read_bytes()
    file.write_bytes(whole + damaged)
    assert len(RowLines(file, tmp_path)) == 1
    assert file.read_bytes() == whole + damaged
    run([job("y")], RowLines(file, tmp_path))
    assert [json.loads(line)["b"] for line in file.read_text().splitlines()] == ["x", "y"]


def test_sorted_lines_do_not_depend_on_the_order_of_the_work(tmp_path, run):
    run([job("old")], RowLines(tmp_path / "rows.jsonl", tmp_path))
    store = RowLines(tmp_path / "rows.jsonl", tmp_path)
    run([job("y"), job("x")], store)
    store.sort(["x-1", "y-1", "missing"])
    assert [json.loads(line)["key"] for line in (tmp_path / "rows.jsonl").read_text().splitlines()] == [
        "x-1",
        "y-1",
        "old-1",
    ]
    assert run([job("z")], store) == ["z"]
    assert (tmp_path / "rows.jsonl").read_text().endswith('{"key": "z-1", "b": "z", "a": 1}\n')


def test_a_folder_is_held_by_one_and_left_without_unfinished_files(tmp_path):
    folder = tmp_path / "out"
    (folder / ".unfinished-old").mkdir(parents=True)
    with hold_folder(folder, lambda: False, "expected another") as unfinished:
        assert [path.name for path in folder.iterdir()] == [".unfinished"]
        (unfinished / "half").touch()
        with (
            pytest.raises(StrideTwinError, match="out: expected another"),
            hold_folder(folder, bool, "expected another"),
        ):
            pass
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("has_rows", [False, True])
def test_a_new_folder_of_a_refused_run_goes_unless_it_has_rows(tmp_path, has_rows):
    with pytest.raises(StrideTwinError), hold_folder(tmp_path / "out", lambda: has_rows):
        raise StrideTwinError("refused")
    assert (tmp_path / "out").exists() is has_rows


def test_a_request_is_read_as_it_was_written(tmp_path):
    assert read_request(tmp_path) is None
    write_request(tmp_path, {"seed": 1})
    assert read_request(tmp_path) == {"seed": 1}
    (tmp_path / "request.json").write_text("{")
    assert read_request(tmp_path) is None


def test_the_time_left_is_announced_once_if_it_is_long(monkeypatch, capsys):
    from stridetwin.batch import forecast

    for seconds, said in (
        (40.0, "1000 walks: about 5:33:00 h left; Ctrl-C stops it, and --resume continues"),
        (1.0, ""),
    ):
        now = iter((0.0, 2 * seconds))
        monkeypatch.setattr(forecast.time, "monotonic", lambda now=now: next(now))
        left = Forecast("1000 walks", 502, "--resume continues")
        for _ in range(7):
            left.count_job(workers=1)
        assert capsys.readouterr().err == (f"stridetwin: warning: {said}\n" if said else "")


def test_variants_of_a_walk_share_its_recording_and_have_rows_of_their_own(tmp_path):
    recorded = []

    def score(tasks):
        recorded.append(tasks[0][0])  # once for all variants of a walk
        for walk, variant in tasks:
            yield {"walk": walk, "variant": variant}

    def rows_of(variants):
        pairs = [(walk, variant) for walk in ("level", "stairs") for variant in variants]
        jobs = [Job(name="-".join(pair), key=content_key(pair), task=pair, group=pair[0]) for pair in pairs]
        options = BatchOptions(folder=tmp_path / "out")
        rows = run_batch(jobs, Work(run=score, versions=dict), options, "study", lambda stage, share: None)
        assert [(row["walk"], row["variant"]) for row in rows] == pairs

    rows_of(["published", "proposed"])
    assert recorded == ["level", "stairs"]
    rows_of(["published", "proposed"])
    assert recorded == ["level", "stairs"]
    rows_of(["published", "proposed", "ablated"])
    assert recorded == ["level", "stairs"] * 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["rows.jsonl"]
