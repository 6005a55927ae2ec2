"""Experiments by name: cases that are kept, gone on with, and laid beside the paper's."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from frail_pool import make_frail

from stridetwin.scenarios.built_in import experiments
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies import experiment as experiment_module
from stridetwin.studies import registry
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.experiment import Experiment, experiment
from stridetwin.studies.registry import ExperimentBatchOptions, run_experiment


def collected(results: list[dict]) -> dict:
    return {"summary": {"sum": sum(r["seed"] for r in results)}, "paper": {}}


@pytest.fixture
def ran(monkeypatch) -> list[int]:
    """Seeds that an experiment named `small` has run."""
    seeds: list[int] = []

    def run_case(case: ExperimentCase) -> dict:
        seeds.append(case.seed)
        return {"seed": case.seed, "physics": case.physics}

    small = Experiment(
        name="small", seeds=tuple(range(5, 9)), run_case=run_case, collect=collected, table=lambda result: []
    )
    monkeypatch.setitem(experiment_module._LOADED, "small", small)
    return seeds


def make_small(seeds, run_case) -> Experiment:
    """An experiment without walks."""
    return Experiment(name="small", seeds=tuple(seeds), run_case=run_case, collect=collected, table=lambda result: [])


def run(folder, **options):
    shares = []
    result = run_experiment(
        "small", ExperimentBatchOptions(folder=folder, **options), lambda _, share: shares.append(share)
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return result


def test_cases_are_kept_and_a_stopped_run_goes_on(tmp_path, ran) -> None:
    assert [c["seed"] for c in run(tmp_path, subset=2)["cases"]] == [5, 6]
    result = run(tmp_path, resume=True)
    assert ran == [5, 6, 7, 8]
    assert result["summary"]["sum"] == 26
    row = json.loads((tmp_path / "seed_7.json").read_text())
    assert len(row.pop("key")) == 16
    assert row == {"seed": 7, "physics": "dynamic"}
    run(tmp_path, subset=1)
    assert ran == [5, 6, 7, 8, 5]


def test_other_seeds_than_the_reported_ones_can_be_asked_for(tmp_path, ran) -> None:
    assert [c["seed"] for c in run(tmp_path, first=2, subset=2)["cases"]] == [2, 3]
    assert ran == [2, 3]


def test_rows_of_another_physics_or_version_are_run_again_and_counted(tmp_path, ran, monkeypatch) -> None:
    run(tmp_path, subset=2)
    stages: list[str] = []

    def resumed(**options):
        stages.clear()
        asked = ExperimentBatchOptions(folder=tmp_path, resume=True, **options)
        return run_experiment("small", asked, lambda stage, _: stages.append(stage))

    assert [c["physics"] for c in resumed(subset=1, physics="kinematic")["cases"]] == ["kinematic"]
    assert ran == [5, 6, 5]
    assert set(stages) == {"small, 1 rows of another version are run again"}
    resumed(subset=3)
    assert ran == [5, 6, 5, 5, 7]
    monkeypatch.setattr(registry, "_sources_digest", lambda *_, **__: "other sources")
    resumed(subset=4)
    assert ran == [5, 6, 5, 5, 7, 5, 6, 7, 8]
    assert set(stages) == {"small, 3 rows of another version are run again"}
    resumed(subset=4)
    assert len(ran) == 9
    assert set(stages) == {"small"}


def test_estimators_of_another_kind_and_unknown_ones_are_refused_with_the_valid_names(tmp_path) -> None:
    for name, estimator, valid in (
        ("shim_table5", "dvio", "expected contact_terrain"),
        ("zhao_closed_loop", "mine", "expected .*dvio"),
        ("jao_simulation", "dvio", "expected none"),
    ):
        with pytest.raises(StrideTwinError, match=f"experiment {name}: invalid estimator '{estimator}': {valid}"):
            run_experiment(name, ExperimentBatchOptions(folder=tmp_path, estimators=(estimator,)), lambda *_: None)


def test_rows_with_other_estimators_have_keys_of_their_own(tmp_path) -> None:
    study = experiment("zhao_closed_loop")
    jobs = [
        registry._make_job(study, ExperimentCase(seed=1, folder=tmp_path, estimators=estimators))
        for estimators in ((), ("dvio",))
    ]
    assert jobs[0].key != jobs[1].key
    assert jobs[0].task.walks_key == jobs[1].task.walks_key


def test_a_row_without_a_key_is_of_another_version(tmp_path, ran) -> None:
    (tmp_path / "seed_5.json").write_text('{"seed": 5, "physics": "dynamic"}')
    run(tmp_path, subset=1, resume=True)
    assert ran == [5]


def test_a_case_of_which_every_worker_dies_is_an_error_and_the_others_are_kept(tmp_path, ran, monkeypatch) -> None:
    with monkeypatch.context() as patch:
        make_frail(patch, lambda task: task.case.seed == 6)
        with pytest.raises(StrideTwinError, match=r"small: seed_6: its worker died; .*; --resume runs it again"):
            run_experiment("small", ExperimentBatchOptions(folder=tmp_path, workers=2), lambda *_: None)
    assert set(ran) == {5, 7, 8}  # a case beside the one that died may have run twice
    finished = len(ran)
    run(tmp_path, resume=True)
    assert ran[finished:] == [6]


def test_one_process_at_a_time_runs_cases_in_a_folder(tmp_path, ran) -> None:
    def run_another(stage: str, share: float) -> None:
        with pytest.raises(StrideTwinError, match="another process runs an experiment there: expected another folder"):
            run_experiment("small", ExperimentBatchOptions(folder=tmp_path), lambda *_: None)

    run_experiment("small", ExperimentBatchOptions(folder=tmp_path, subset=1), run_another)


def test_every_variant_of_an_experiment_has_keys_of_its_own(tmp_path) -> None:
    case = ExperimentCase(seed=1, folder=tmp_path)
    names = ("zhao_generality", "zhao_generality_given_poses", "zhao_generality_shallow", "zhao_view")
    jobs = [registry._make_job(experiment(name), case) for name in names]
    assert len({job.key for job in jobs} | {job.task.walks_key for job in jobs}) == 2 * len(names)


def test_a_recording_of_another_version_is_not_reused(tmp_path, monkeypatch) -> None:
    there: list[bool] = []

    def run_case(case: ExperimentCase) -> dict:
        walk = case.file("_head.mcap")
        there.append(walk.exists())
        walk.touch()
        return {"seed": case.seed}

    only = make_small((1,), run_case)
    monkeypatch.setitem(experiment_module._LOADED, "small", only)
    neighbour = tmp_path / "seed_10_head.mcap"
    neighbour.touch()

    def resumed(*, twin: str, estimators: str) -> bool:
        def digest(module: str, *, with_estimators: bool) -> str:
            return twin + estimators * with_estimators

        monkeypatch.setattr(registry, "_sources_digest", digest)
        ran = len(there)
        run(tmp_path, keep=True, resume=True)
        assert len(there) == ran + 1
        return there[-1]

    assert not resumed(twin="a", estimators="a")
    assert resumed(twin="a", estimators="b")
    assert not resumed(twin="b", estimators="b")
    assert neighbour.exists()


@pytest.mark.parametrize("damaged", [b"", b'{"cut', b"[1]", b"\xff"])
def test_a_damaged_row_is_run_again(tmp_path, monkeypatch, damaged) -> None:
    small = Experiment(
        name="small",
        seeds=(1, 2),
        run_case=lambda case: {"seed": case.seed},
        collect=collected,
        table=lambda result: [],
    )
    monkeypatch.setitem(experiment_module._LOADED, "small", small)
    run(tmp_path)
    (tmp_path / "seed_1.json").write_bytes(damaged)
    assert [c["seed"] for c in run(tmp_path, resume=True)["cases"]] == [1, 2]


@pytest.mark.skipif(sys.platform == "win32", reason="needs fork")
def test_runs_that_are_killed_add_up(tmp_path, monkeypatch) -> None:
    count, rng = 40, np.random.default_rng(0)
    log = tmp_path / "log"

    def run_case(case: ExperimentCase) -> dict:
        with log.open("a") as file:
            file.write(f"{case.seed}\n")
        time.sleep(0.02)
        return {"seed": case.seed, "much": "x" * 100_000}

    slow = Experiment(
        name="small", seeds=tuple(range(count)), run_case=run_case, collect=collected, table=lambda result: []
    )
    monkeypatch.setitem(experiment_module._LOADED, "small", slow)
    options = ExperimentBatchOptions(folder=tmp_path / "rows", resume=True)
    run_experiment("small", replace(options, subset=1), lambda *_: None)  # caches
    killed, done = 0, 1
    for _ in range(6):
        child = os.fork()
        if child == 0:
            with suppress(BaseException):
                run_experiment("small", options, lambda *_: None)
            os._exit(0)
        time.sleep(0.02 + 0.06 * rng.random())
        os.kill(child, signal.SIGKILL)
        killed += os.WIFSIGNALED(os.waitpid(child, 0)[1])
        rows = sorted(options.folder.glob("seed_*.json"))
        assert all(len(json.loads(row.read_text())["much"]) == 100_000 for row in rows)
        assert len(rows) >= done
        done = len(rows)
    assert 0 < done < count
    result = run_experiment("small", options, lambda *_: None)
    assert [c["seed"] for c in result["cases"]] == list(range(count))
    assert len(log.read_text().split()) <= count + killed  # what was done is not done again


def test_every_experiment_is_listed_and_others_are_refused(tmp_path) -> None:
    assert len(experiments()) == 26
    for name in experiments():
        loaded = experiment(name)
        assert loaded.description
        assert loaded.seeds
        assert loaded.module.startswith("stridetwin.studies.")
    with pytest.raises(StrideTwinError, match="jao_loop_126m"):
        run_experiment("magic", ExperimentBatchOptions(folder=tmp_path), lambda *_: None)


def test_the_size_of_what_is_missing_is_said_before_the_start(tmp_path, ran) -> None:
    said: list[str] = []
    run_experiment(
        "small", ExperimentBatchOptions(folder=tmp_path, subset=1), lambda *_: None, lambda text: said.append(text)
    )
    options = ExperimentBatchOptions(folder=tmp_path, resume=True)
    run_experiment("small", options, lambda *_: said.append(f"ran {len(ran)}"), lambda text: said.append(text))
    run_experiment("small", options, lambda *_: None, lambda text: said.append(text))
    assert [text for text in said if not text.startswith("ran")] == [
        "small: 1 case, 1 estimate",
        "small: 3 cases, 3 estimates",
    ]
    assert said.index("small: 3 cases, 3 estimates") < said.index("ran 1")


def test_walks_and_estimates_are_counted_and_the_time_grows_with_both(tmp_path) -> None:
    study = experiment("zhao_generality")

    def size(name, **options):
        cases = ExperimentBatchOptions(folder=tmp_path, physics="kinematic", **options).cases(experiment(name))
        return experiment(name).size(cases), len(cases)

    (few, _), (every, count) = size("zhao_generality", subset=60), size("zhao_generality")
    assert (few.walks, few.estimates, every.walks, every.estimates) == (60, 120, 540, 1080)
    assert every.cpu_s / few.cpu_s == pytest.approx(9, rel=0.2)
    assert every.cpu_s > 3600  # hours, as the terminal says
    assert f"{count} cases: 540 walks" in every.describe(count)
    assert "with 2 processes" in every.describe(count, 2)
    three, _ = size("zhao_baselines")
    assert three.estimates == 3 * three.walks == 180
    assert len(study.seeds) == count
