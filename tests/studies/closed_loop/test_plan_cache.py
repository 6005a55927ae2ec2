"""A walk is planned once, whatever process asks for it again."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
import pytest

from stridetwin.sim.config import Exo, Level, Route, TwinConfig
from stridetwin.sim.dynamics.plan import plan_control
from stridetwin.sim.gait.reference import plan_reference
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.own_exo_rig import read_own_exo
from stridetwin.studies.closed_loop import plan_cache
from stridetwin.studies.closed_loop.environment import environment

WALK = TwinConfig(
    name="short",
    route=Route(segments=(Level(length_m=0.5),)),
    physics="dynamic",
    exo=Exo(mode=1),
    sensors=("encoder",),
    shock=False,
)


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the functions that plan, in the order of the calls."""
    calls = []
    for function in (plan_reference, plan_control):

        def counted(*arguments: object, _function: object = function) -> object:
            calls.append(_function.__name__)  # type: ignore[attr-defined]
            return _function(*arguments)  # type: ignore[operator]

        counted.__name__ = function.__name__
        monkeypatch.setattr(plan_cache, function.__name__, counted)
    return calls


def walked(config: TwinConfig, seed: int, folder: Path) -> np.ndarray:
    plan, control = plan_cache.cache_plans(folder)
    twin = Twin(config, seed, plan=plan, plan_control=control)
    return np.concatenate([twin.reference.splines.c.ravel(), twin.control_plan.q.ravel()])


def test_a_plan_is_found_again_and_is_the_same(tmp_path: Path, planned: list[str], capsys) -> None:
    plain = Twin(WALK, 3)
    first, again = walked(WALK, 3, tmp_path), walked(WALK, 3, tmp_path)
    assert planned == ["plan_reference", "plan_control"]
    assert np.array_equal(first, again)
    assert np.array_equal(first[: plain.reference.splines.c.size], plain.reference.splines.c.ravel())
    assert capsys.readouterr().err.count("planning the motion") == 1


def test_another_seed_or_walk_is_planned_anew(tmp_path: Path, planned: list[str]) -> None:
    walked(WALK, 3, tmp_path)
    walked(WALK, 4, tmp_path)
    walked(replace(WALK, person=replace(WALK.person, height_m=1.6)), 3, tmp_path)
    assert planned.count("plan_reference") == 3


def test_files_of_the_same_content_share_a_plan_wherever_they_are(tmp_path: Path) -> None:
    example, keys = Path(__file__).parents[3] / "examples" / "own_exo", []
    for folder in ("a", "b"):
        shutil.copytree(example, tmp_path / folder)
        own = read_own_exo(tmp_path / folder / "my_exo.xml", tmp_path / folder / "my_exo.yaml")
        config = replace(WALK, exo=Exo(user_exo=own))
        keys.append((joblib.hash(plan_cache._without_paths(config)), joblib.hash(config)))
    assert keys[0][0] == keys[1][0]
    assert keys[0][1] != keys[1][1]
    other = replace(WALK, exo=Exo(user_exo=replace(own, encoders=())))
    assert joblib.hash(plan_cache._without_paths(other)) != keys[0][0]


def test_the_environment_plans_through_it(tmp_path: Path, planned: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_cache, "user_cache_path", lambda name: tmp_path)
    for _ in range(2):
        env = environment(WALK, 3, sensors=("encoder",))
        env.reset()
        env.physics.close()
    assert planned == ["plan_reference", "plan_control"]
    assert (tmp_path / "plans").is_dir()
