"""`experiment`, study files, `place` and `score` on a Dask cluster whose workers may be killed: bytes, resuming."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from local_cluster import open_cluster

from stridetwin.batch.executors import BatchOptions
from stridetwin.cli.main import main
from stridetwin.gate import walk_scores
from stridetwin.gate.walk_scores import jobs_of, score_walks
from stridetwin.studies import experiment as experiment_module
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.experiment import Experiment
from stridetwin.studies.placement.problem_file import read_problem
from stridetwin.studies.placement.run import PlacementOptions, run_placement
from stridetwin.studies.registry import ExperimentBatchOptions, run_experiment

pytest.importorskip("mujoco")

STEPS = {
    "description": "a few steps",
    "terrain": [{"level": {"length_m": 0.5}}],
    "gait": {"stand_s": 0.5},
    "sensors": ["foot_imu", "insole"],
}


@pytest.fixture(scope="module")
def cluster():
    with open_cluster() as local:
        yield local


def contents(folder: Path) -> dict[str, bytes]:
    """Every file by name; none is hidden."""
    assert not [p for p in folder.rglob(".*")]
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


class KillsOne:
    """A listener of progress, which kills a worker of the cluster after the first result."""

    def __init__(self, cluster) -> None:
        self.shares: list[float] = []
        self.killed: list[int] = []
        self._cluster = cluster

    def __call__(self, stage: str, share: float) -> None:
        self.shares.append(share)
        if share > 0 and not self.killed:
            self.killed.append(next(iter(self._cluster.workers.values())).pid)
            os.kill(self.killed[0], signal.SIGKILL)


def run_case(case: ExperimentCase) -> dict:
    """A row of numbers that depend on the seed; kills its process once if the folder's neighbour `kill` says so."""
    kill = case.folder.parent / f"kill_{case.seed}"
    if kill.exists():
        kill.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    rates = np.random.default_rng(case.seed).standard_normal(100 + case.seed)
    return case.row(samples=len(rates), largest_rate=float(np.abs(rates).max()))


def test_an_experiment_survives_a_killed_worker_and_resumes(cluster, tmp_path, monkeypatch):
    collect = lambda rows: {"summary": {"samples": sum(r["samples"] for r in rows)}, "paper": {}}  # noqa: E731
    small = Experiment(
        name="small", seeds=tuple(range(5, 9)), run_case=run_case, collect=collect, table=lambda result: []
    )
    monkeypatch.setitem(experiment_module._LOADED, "small", small)
    result = run_experiment("small", ExperimentBatchOptions(folder=tmp_path / "one"), lambda *_: None)
    (tmp_path / "kill_6").touch()
    options = ExperimentBatchOptions(folder=tmp_path / "cluster", scheduler=cluster.scheduler_address, resume=True)
    assert run_experiment("small", options, lambda *_: None) == result
    assert not (tmp_path / "kill_6").exists()
    assert contents(tmp_path / "cluster") == contents(tmp_path / "one")
    (tmp_path / "cluster" / "seed_7.json").write_text("{")
    shares: list[float] = []
    assert run_experiment("small", options, lambda _, share: shares.append(share)) == result
    assert shares == [0.75, 1.0]
    assert contents(tmp_path / "cluster") == contents(tmp_path / "one")


def test_a_study_file_gives_the_same_bytes(cluster, tmp_path, capsys):
    (tmp_path / "steps.yaml").write_text(yaml.safe_dump(STEPS))
    study = {
        "study": "A few steps",
        "scenarios": ["steps.yaml"],
        "seeds": 2,
        "methods": {"usual": {"estimator": "foot_ins"}},
        "scores": ["end_error_m"],
    }
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump(study))
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["experiment", str(path), "-o", str(one)]) == 0
    assert main(["experiment", str(path), "--scheduler", cluster.scheduler_address, "-o", str(two)]) == 0
    assert contents(one) == contents(two)
    assert json.loads((one / "study.json").read_text())["failed"] == []


def test_a_placement_survives_a_killed_worker_and_resumes(cluster, tmp_path):
    (tmp_path / "steps.yaml").write_text(yaml.safe_dump(STEPS | {"sensors": ["foot_imu", "foot_camera"]}))
    problem = {
        "placement": "Parts",
        "scenarios": ["steps.yaml"],
        "seeds": 2,
        "free": {"sensors.foot_imu.part": {"choice": ["ADIS16485", "MPU-9250"]}},
        "scores": ["foot_ins.end_error_m", "foot_weight_g", "visibility_pct"],
    }
    path = tmp_path / "parts.yaml"
    path.write_text(yaml.safe_dump(problem))
    problem = read_problem(path)
    result = run_placement(problem, PlacementOptions(folder=tmp_path / "one"), lambda *_: None)
    assert {"foot_ins.end_error_m", "visibility_pct"} < set(result["table"][0]["scores"])
    folder = tmp_path / "cluster"
    on_cluster = {"folder": folder, "scheduler": cluster.scheduler_address}
    listener = KillsOne(cluster)
    assert run_placement(problem, PlacementOptions(**on_cluster), listener) == result
    assert len(listener.killed) == 1
    assert contents(folder) == contents(tmp_path / "one")
    rows = (folder / "rows.jsonl").read_text().splitlines(keepends=True)
    (folder / "rows.jsonl").write_text("".join(rows[1:-2]) + rows[-1][:30])
    assert run_placement(problem, PlacementOptions(**on_cluster, resume=True), lambda *_: None) == result
    assert contents(folder) == contents(tmp_path / "one")


def test_recordings_are_scored_as_in_one_process_though_a_worker_is_killed(cluster, tmp_path, monkeypatch, capsys):
    (tmp_path / "steps.yaml").write_text(yaml.safe_dump(STEPS))
    (tmp_path / "few.yaml").write_text(yaml.safe_dump({"campaign": "Few", "walks": 3, "scenarios": ["steps.yaml"]}))
    monkeypatch.chdir(tmp_path)
    assert main(["generate", "few.yaml", "-o", "few"]) == 0
    capsys.readouterr()
    command = ["score", "few", "--only", "foot_ins", "--json"]
    assert main(command) == 0
    one = capsys.readouterr().out
    assert main([*command, "--scheduler", cluster.scheduler_address]) == 0
    assert capsys.readouterr().out == one
    assert set(json.loads(one)["estimators"]) == {"foot_ins_l", "foot_ins_r"}
    jobs = jobs_of([Path("few")], lenient=False, only=frozenset(["foot_ins"]))
    options, listener = BatchOptions(folder=Path("kept"), scheduler=cluster.scheduler_address), KillsOne(cluster)
    assert score_walks(jobs, options, listener, is_kept=True) == json.loads(one)["recordings"]
    assert len(listener.killed) == 1
    rows = Path("kept/rows.jsonl").read_text().splitlines(keepends=True)
    Path("kept/rows.jsonl").write_text("".join(rows[1:]))
    shares: list[float] = []
    assert (
        score_walks(jobs, options, lambda _, share: shares.append(share), is_kept=True) == json.loads(one)["recordings"]
    )
    assert shares == [pytest.approx(2 / 3), 1.0]
    assert Path("kept/rows.jsonl").read_text() == "".join(rows)
    monkeypatch.setattr(walk_scores, "score_walk", None)
    assert main([*command, "--resume", "kept"]) == 0
    assert capsys.readouterr().out == one
    assert main([*command[:2], "--resume", "kept", "--estimator", "a=b:C"]) == 2
    assert "--resume is only valid for built-in estimators" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["experiment", "jao_simulation"], ["place", "foot_imu"], ["score", "x.mcap"]])
def test_either_workers_or_a_scheduler(command, capsys):
    assert main([*command, "--workers", "2", "--scheduler", "localhost:8786"]) == 2
    assert "--workers: invalid 2: expected either --workers or --scheduler" in capsys.readouterr().err
    assert main([*command, "--scheduler", "nope"]) == 2
    assert "--scheduler: invalid 'nope': expected HOST:PORT or PROTOCOL://HOST:PORT" in capsys.readouterr().err
