"""A kind of output in an installed package of its own takes part in every command, without a change to StrideTwin."""

import csv
import importlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from live_bridge import alive, sent

from stridetwin.cli.main import main

PACKAGE = Path(__file__).parent / "example_kind"
NAMES = {"phase_by_time_l", "phase_by_time_r"}
SCENARIO = """description: Level steps
terrain: [{level: {length_m: 5}}]
sensors: [foot_imu]
physics: kinematic
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder into which pip has installed the package."""
    folder = tmp_path_factory.mktemp("example")
    shutil.copytree(PACKAGE, folder / "source")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(folder / "site")]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(folder / "source")], check=True)
    return folder / "site"


@pytest.fixture(scope="module")
def installed(site):
    """This process as one that finds the package; once for all tests, as the loaded kinds are kept, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        patch.setenv("PYTHONPATH", str(site), prepend=":")  # of the processes that it starts
        yield
    for name in [n for n in sys.modules if n.startswith("stridetwin_simple_phase")]:
        sys.modules.pop(name)
    importlib.invalidate_caches()


def printed(capsys, *words):
    capsys.readouterr()
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def rows(file):
    with file.open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """A walk of a few steps with the IMUs of the feet alone."""
    file = tmp_path_factory.mktemp("scenario") / "level_steps.yaml"
    file.write_text(SCENARIO, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def walked(installed, scenario, tmp_path_factory):
    """Folder of one `stridetwin run`."""
    folder = tmp_path_factory.mktemp("walk")
    assert main(["run", str(scenario), "--no-film", "--seed", "3", "-o", str(folder)]) == 0
    return folder


def test_it_is_listed_estimated_and_live(walked, tmp_path, capsys):
    recording = walked / "recording.mcap"
    listed = printed(capsys, "list")
    assert listed["outputs"]["simple_phase"] == "Gait phase by time alone"
    assert listed["estimators"]["phase_by_time"].startswith("Gait phase by time alone")
    file = tmp_path / "phases.csv"
    printed(capsys, "estimate", "phase_by_time", recording, "--foot", "r", "-o", file)
    assert {0.0 <= float(row["phase"]) <= 1.0 for row in rows(file)} == {True}
    alive(["phase_by_time", "--foot", "r", "-o", tmp_path / "live.csv"], sent(recording, "--topic", "/foot_r/imu"))
    assert (tmp_path / "live.csv").read_bytes() == file.read_bytes()


def test_it_is_run_scored_reported_and_gated(walked, tmp_path, capsys):
    scores = json.loads((walked / "scores.json").read_text(encoding="utf-8"))["estimators"]
    assert scores.keys() >= NAMES | {"foot_ins_l"}
    assert all(0.0 < scores[name]["simple_phase_rmse_pct"] < 25.0 for name in NAMES)
    assert all(len(rows(walked / f"{name}.csv")) > 300 for name in NAMES)
    report = (walked / "report.html").read_text(encoding="utf-8")
    assert "Simple gait phase" in report

    scored = printed(capsys, "score", walked / "recording.mcap", "--only", "phase_by_time")
    assert scored["estimators"] == {name: scores[name] for name in NAMES}
    capsys.readouterr()
    assert main(["score", str(walked / "recording.mcap"), "--only", "phase_by_time_l"]) == 0
    assert "phase RMS %" in capsys.readouterr().out

    for name in NAMES:
        for of_walk in (scored["estimators"], scored["recordings"][0]["estimators"]):
            of_walk[name] = of_walk[name] | {"simple_phase_rmse_pct": of_walk[name]["simple_phase_rmse_pct"] / 2}
    baseline = tmp_path / "baseline.json"
    baseline.write_text(json.dumps(scored), encoding="utf-8")
    capsys.readouterr()
    assert main(["score", str(walked / "recording.mcap"), "--baseline", str(baseline), "--json"]) == 1
    worse = json.loads(capsys.readouterr().out)["regressions"]
    assert {(line["estimator"], line["metric"]) for line in worse} == {(n, "simple_phase_rmse_pct") for n in NAMES}


def test_a_study_compares_it(installed, scenario, tmp_path, capsys):
    study = scenario.with_name("study.yaml")
    study.write_text(
        "study: Phase by time\nscenarios: [level_steps.yaml]\nseeds: 2\nmethods: {mine: {estimator: phase_by_time}}\n"
        "scores: [simple_phase_rmse_pct]\n",
        encoding="utf-8",
    )
    printed(capsys, "experiment", study, "-o", tmp_path / "out")
    walks = rows(tmp_path / "out" / "study.csv")
    assert len(walks) == 2
    assert all(0.0 < float(walk["value"]) < 25.0 for walk in walks)
    assert "simple_phase_rmse_pct" in (tmp_path / "out" / "study.html").read_text(encoding="utf-8")
