"""The twin as an environment of dm_env."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import dm_env
import numpy as np
import pytest

from stridetwin.scenarios.closed_loop import environment
from stridetwin.sim.config import Exo, Level, Route, TwinConfig
from stridetwin.streams.errors import ConfigError

WALK = TwinConfig(
    name="short", route=Route(segments=(Level(length_m=1.0),)), physics="dynamic", exo=Exo(mode=1),
)  # fmt: skip
SENSORS = ("encoder", "insole")


def test_a_walk_is_an_episode_of_valid_steps() -> None:
    env = environment(WALK, 3, sensors=SENSORS)
    torques, seen = env.action_spec(), env.observation_spec()
    assert torques.shape == (4,)
    assert np.array_equal(torques.maximum, [20.0, 20.0, 15.0, 15.0])
    step = env.reset()
    assert step.step_type == dm_env.StepType.FIRST
    work, steps = 0.0, 0
    while not step.last():
        step = env.step(np.zeros(4))
        for name, spec in seen.items():
            spec.validate(step.observation[name])
        assert step.reward <= 0.0
        work -= step.reward
        steps += 1
    assert step.discount == 1.0
    assert steps * env.control_timestep() == pytest.approx(env.physics.live.simulation.time_s, abs=0.02)
    assert 5.0 < work < 400.0  # J: he starts and stops within a metre
    assert all(np.isfinite(value).all() for value in step.observation.values())
    assert env.reset().step_type == dm_env.StepType.FIRST


def test_what_is_asked_is_given_ten_milliseconds_later_and_within_the_limits() -> None:
    env = environment(WALK, 3, sensors=("actuator",))

    def given(hip_nm: float) -> np.ndarray:
        """Torque of the left hip's motor, which carries its rotor and friction besides."""
        env.reset()
        asked = np.array([hip_nm, 0.0, 0.0, -5.0])
        return np.array([env.step(asked).observation["exo/hip_l/actuator"][1] for _ in range(20)])

    none, most = given(0.0), given(20.0)
    assert np.array_equal(given(50.0), most, equal_nan=True)
    assert np.nanmax(np.abs(most - none)) > 15.0
    with pytest.raises(ConfigError, match="finite"):
        env.step(np.array([np.nan, 0.0, 0.0, 0.0]))


def test_the_example_of_the_documentation_runs() -> None:
    page = (Path(__file__).parents[3] / "docs" / "closed_loop.md").read_text(encoding="utf-8")
    example = page.split("```python\n")[1].split("```")[0]
    assert "length_m=1.0" in example
    names: dict[str, object] = {}
    exec(example.replace("while not step.last():", "for _ in range(30):"), names)
    step = names["step"]
    assert isinstance(step, dm_env.TimeStep)
    assert step.reward <= 0.0


def test_equal_seeds_give_equal_walks_and_others_do_not() -> None:
    def loads(env: dm_env.Environment) -> np.ndarray:
        env.reset()
        return np.array([env.step(np.zeros(4)).observation["foot_l/insole"] for _ in range(30)])

    same = environment(WALK, 3, sensors=SENSORS)
    assert np.array_equal(loads(same), loads(same), equal_nan=True)
    other = environment(WALK, count(3), sensors=SENSORS)
    assert not np.array_equal(loads(other), loads(other), equal_nan=True)


def test_an_exoskeleton_that_powers_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match="exo"):
        environment("level_20m")
