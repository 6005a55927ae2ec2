"""The plugin in a test session of its own."""

import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path

import stridetwin.estimators.foot_ins
import stridetwin.evaluation.evaluate
import stridetwin.evaluation.gate.own_estimators
import stridetwin.report.runner
import stridetwin.scenarios.record
import stridetwin.scenarios.scenario_file  # noqa: F401
from stridetwin.sim import parts

PLUGIN = "stridetwin.evaluation.gate.pytest_plugin"
TEST = """
from types import SimpleNamespace

from stridetwin.estimators.foot_ins import FootIns
from stridetwin.sim.config import Level, Route, TwinConfig


class Mine:
    topics = ("/foot_l/imu",)

    def __init__(self, rig):
        self.filter = FootIns(rig)

    def update(self, sample):
        e = self.filter.update(sample)
        p, q = e.pose.p_frame_in_world, e.pose.q_world_frame
        return SimpleNamespace(t_ns=e.t_ns, p_frame_in_world=p, q_world_frame=q)


def test_accuracy(stridetwin_scenario, stridetwin_score):
    walk = stridetwin_scenario("level_20m", seed=3)
    scores = stridetwin_score(walk, Mine(walk.rig), frame="foot_l/imu")
    assert scores["end_error_m"] < 0.1


def test_a_walk_is_made_once(stridetwin_scenario):
    walk = stridetwin_scenario("level_20m", seed=3)
    assert walk is stridetwin_scenario("level_20m", seed=3)
    assert "/head/color" not in walk.topics


def test_a_walk_may_be_given_in_other_ways(stridetwin_scenario):
    level = {"terrain": [{"level": {"length_m": 6}}], "sensors": {"foot_imu": "my_imu.yaml"}}
    assert stridetwin_scenario(level).metadata["scenario"] == "scenario"
    assert stridetwin_scenario(level).metadata["seed"] == "0"
    config = TwinConfig(name="mine", route=Route(segments=(Level(length_m=5.0),)))
    assert stridetwin_scenario(config).metadata["scenario"] == "mine"
"""


def test_five_lines_test_an_estimator(pytester, monkeypatch, simulator):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # an installed package brings it, too
    pytester.makepyfile(TEST)
    (pytester.path / "my_imu.yaml").write_bytes((Path(str(files(parts))) / "MPU-9250.yaml").read_bytes())
    pytester.runpytest_inprocess("-p", PLUGIN, "-p", "no:cacheprovider").assert_outcomes(passed=3)


def test_the_plugin_costs_nothing_until_it_is_used():
    code = (
        f"import sys, time, pytest; before = set(sys.modules); t = time.perf_counter(); import {PLUGIN}\n"
        "new = {m.split('.')[0] for m in set(sys.modules) - before}\n"
        "assert not new & {'numpy', 'mujoco', 'scipy', 'numba', 'yaml'}, new\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_pytest_finds_the_plugin_by_its_entry_point():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {"stridetwin": PLUGIN}
