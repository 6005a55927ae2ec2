"""Estimators in an installed package of their own take part in every command, without a change to StrideTwin."""

import importlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from live_bridge import alive, sent

from stridetwin.cli.main import main
from stridetwin.estimators import registry
from stridetwin.outputs.path.run import pose_of
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Pose
from tests.small_camera import write_small_camera

PACKAGE = Path(__file__).parent / "example_package"
NAMES = {"gravity_foot_l", "gravity_foot_r"}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder into which pip has installed the package."""
    folder = tmp_path_factory.mktemp("example")
    shutil.copytree(PACKAGE, folder / "source")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(folder / "site")]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(folder / "source")], check=True)
    return folder / "site"


@pytest.fixture
def installed(site, monkeypatch):
    """This process as one that finds the package."""
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", str(site))  # of the processes that it starts
    yield
    for name in ("stridetwin_example", "stridetwin_example_ground"):
        sys.modules.pop(name, None)
    importlib.invalidate_caches()


def printed(capsys, *words):
    capsys.readouterr()
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_without_the_package_there_is_no_such_estimator():
    assert "gravity_foot" not in registry.names()
    with pytest.raises(ConfigError, match="gravity_foot"):
        registry.estimator("gravity_foot")


def test_list_and_estimate_and_live(installed, seen, tmp_path, capsys):
    assert printed(capsys, "list")["estimators"]["gravity_foot"] == "Attitude of one foot from gravity alone"
    path = tmp_path / "path.txt"
    printed(capsys, "estimate", "gravity_foot", seen, "--foot", "r", "-o", path)
    assert len(read_tum(path)) == Recording(seen).topics["/foot_r/imu"].count
    alive(["gravity_foot", "--foot", "r", "-o", tmp_path / "live.txt"], sent(seen, "--topic", "/foot_r/imu"))
    assert (tmp_path / "live.txt").read_bytes() == path.read_bytes()


def test_run_and_score_and_the_gate(installed, simulator, tmp_path, capsys):
    folder = tmp_path / "walk"
    scores = printed(capsys, "run", "level_20m", "--no-cameras", "--no-film", "--seed", "3", "-o", folder)["estimators"]
    assert set(scores) >= NAMES | {"foot_ins_l", "foot_to_foot_r"}
    assert (folder / "gravity_foot_l.txt").is_file()
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert "left, gravity_foot" in report
    assert "Gravity: the attitude of a foot that stands." in report

    baseline = tmp_path / "baseline.json"
    scored = printed(capsys, "score", folder / "recording.mcap")
    assert {name: scored["estimators"][name] for name in NAMES} == {name: scores[name] for name in NAMES}
    for name in NAMES:
        for entry in (scored["estimators"], scored["recordings"][0]["estimators"]):
            entry[name] = entry[name] | {"ape_rmse_m": entry[name]["ape_rmse_m"] / 2}
    baseline.write_text(json.dumps(scored), encoding="utf-8")
    capsys.readouterr()
    assert main(["score", str(folder / "recording.mcap"), "--baseline", str(baseline), "--json"]) == 1
    worse = json.loads(capsys.readouterr().out)["regressions"]
    assert {line["estimator"] for line in worse} == NAMES


def test_a_map_and_a_mode_predictor_take_part(installed, tmp_path, capsys):
    assert {"flat_ground", "steady_steps"} <= printed(capsys, "list")["estimators"].keys()
    scenario = tmp_path / "few_steps.yaml"
    scenario.write_text(
        "description: A few steps\nterrain: [{level: {length_m: 1.5}}]\ngait: {stand_s: 0.5}\n"
        "physics: kinematic\n"
        "sensors: {foot_imu: true, insole: true, head_camera: {part: small_camera.yaml, rate_hz: 10}, sonar: false,\n"
        "          foot_camera: false, ahrs: false, encoder: false, interaction: false, actuator: false}\n"
    )
    write_small_camera(tmp_path / "small_camera.yaml")
    folder = tmp_path / "walk"
    scores = printed(capsys, "run", scenario, "--no-film", "-o", folder)["estimators"]
    assert scores["flat_ground"]["completeness_pct"] > 0.0
    assert scores["flat_ground"]["accuracy_rmse_mm"] < 500.0
    assert scores["steady_steps"]["accuracy_pct"] == 100.0
    assert {"terrain_map", "locomotion_mode"} <= scores.keys()
    files = {"flat_ground": ("flat_ground.json", "flat_ground.ply"), "steady_steps": ("steady_steps.csv",)}
    assert all((folder / name).is_file() for names in files.values() for name in names)

    recording = folder / "recording.mcap"
    for name, (first, *_) in files.items():
        output = tmp_path / first
        assert printed(capsys, "estimate", name, recording, "-o", output)["estimator"] == name
        assert output.stat().st_size > 0
    assert json.loads((tmp_path / "flat_ground.json").read_text())["terrains"][0]["type"] == "level"

    scored = printed(capsys, "score", recording)["estimators"]
    assert {name: scored[name] for name in files} == {name: scores[name] for name in files}


def install(folder, entry_point, monkeypatch):
    """A package that offers an estimator, where this process finds it."""
    info = folder / "broken-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[stridetwin.estimators]\n{entry_point}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(folder))


def test_an_entry_point_that_is_no_estimator_is_named(tmp_path, monkeypatch):
    install(tmp_path / "a", "broken = json:dumps", monkeypatch)
    with pytest.raises(StrideTwinError, match="broken = json:dumps"):
        registry.estimator("broken")


def test_two_packages_that_offer_an_estimator_of_one_name_are_refused(tmp_path, monkeypatch):
    install(tmp_path / "b", "dvio = json:dumps", monkeypatch)
    with pytest.raises(StrideTwinError, match="dvio: two packages offer it"):
        registry.names()


def test_what_is_no_pose_is_refused():
    pose = Pose(t_ns=5, p_frame_in_world=np.zeros(3), rotation=np.array([1.0, 0.0, 0.0, 0.0]))
    assert pose_of(None) is None
    assert pose_of(pose) is pose
    assert pose_of(SimpleNamespace(pose=pose)) is pose
    for estimate in (3, SimpleNamespace(t_ns=5, p_frame_in_world=np.zeros(3))):
        with pytest.raises(StrideTwinError, match=r"expected stridetwin\.streams\.trajectory\.Pose"):
            pose_of(estimate)


def test_no_module_outside_its_package_names_an_estimator():
    """Only studies are about one estimator, and the help of two commands gives examples."""
    literal = re.compile(rf"""["']({"|".join(registry.names())})["'_]""")
    files = [
        f
        for part in ("batch", "sim", "scenarios", "outputs", "run", "gate", "report", "cli")
        for f in (Path(__file__).parents[2] / part).rglob("*.py")
    ]
    assert len(files) > 100
    assert [f.name for f in files if literal.search(f.read_text(encoding="utf-8"))] == []
