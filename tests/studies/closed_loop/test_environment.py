"""The twin as an environment of dm_env."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import dm_env
import numpy as np
import pytest

from stridetwin.sim.config import Exo, Level, Route, TwinConfig
from stridetwin.sim.wearer.exoskeleton import modules
from stridetwin.sim.wearer.own_exo_rig import read_own_exo
from stridetwin.streams.errors import ConfigError
from stridetwin.studies.closed_loop import environment

WALK = TwinConfig(name="short", route=Route(segments=(Level(length_m=1.0),)), physics="dynamic", exo=Exo(mode=1))
SENSORS = ("encoder", "insole")
OWN = Path(__file__).parents[3] / "examples" / "own_exo"


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


@pytest.mark.parametrize("flat", [False, True])
def test_observations_are_as_specified(flat: bool) -> None:
    env = environment(WALK, 3, sensors=SENSORS, flat_observation=flat)
    specs = env.observation_spec()
    shapes = {"foot_l/insole": (4,), "foot_r/insole": (4,), "exo/knee_l/encoder": (1,), "exo/knee_r/encoder": (1,)}
    assert {name: spec.shape for name, spec in specs.items()} == ({"observations": (10,)} if flat else shapes)
    assert {spec.dtype for spec in specs.values()} == {np.dtype(float)}
    for step in (env.reset(), env.step(np.zeros(4))):
        assert step.observation.keys() == specs.keys()
        for name, spec in specs.items():
            spec.validate(step.observation[name])
    env.physics.close()


def test_commands_are_applied_ten_milliseconds_later_and_within_the_limits() -> None:
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


@pytest.mark.parametrize(("seed", "walks"), [(np.int64(3), [3, 3]), ([3, np.int64(4)], [3, 4])])
def test_a_seed_is_any_whole_number_or_one_a_walk(seed: object, walks: list[int]) -> None:
    env = environment(WALK, seed, sensors=SENSORS)  # type: ignore[arg-type]
    seeds = []
    for _ in walks:
        env.reset()
        seeds.append(env.physics.twin.seed)
    assert seeds == walks
    env.physics.close()


def test_an_exhausted_iterable_of_seeds_is_reported() -> None:
    env = environment(WALK, [3], sensors=SENSORS)
    env.reset()
    with pytest.raises(ConfigError, match=r"environment: seed: invalid 'used up': expected .* one per walk"):
        env.reset()


@pytest.mark.parametrize("seed", [-1, 1.5, "3", [], [None]])
def test_what_is_no_seed_is_refused(seed: object) -> None:
    with pytest.raises(ConfigError, match=r"environment: seed: .* expected a whole number from 0 on"):
        environment(WALK, seed, sensors=SENSORS)  # type: ignore[arg-type]


def given_at_first(env: Any, asked: list[float]) -> list[float]:
    """N m of each motor once what is asked is given, over what it gives where nothing is asked."""
    torques = []
    for torque in (np.zeros(len(asked)), np.array(asked)):
        env.reset()
        seen = [env.step(torque).observation for _ in range(2)][-1]
        torques.append([seen[f"exo/{joint}/actuator"][1] for joint in env.physics.joints])
    env.physics.close()
    return list(np.subtract(torques[1], torques[0]))


def own_walk(folder: Path, motors: dict[str, float]) -> TwinConfig:
    """The walk in the example of one's own exoskeleton with other motors, of which each gives so many N m."""
    rig, _, after = (OWN / "my_exo.yaml").read_text(encoding="utf-8").partition("motors:\n")
    entries = ", ".join(f"{joint}: {{torque_max_nm: {most}}}" for joint, most in motors.items())
    (folder / "rig.yaml").write_text(f"{rig}motors: {{{entries}}}\n{after[after.index('ahrs:') :]}", encoding="utf-8")
    return replace(WALK, exo=Exo(user_exo=read_own_exo(OWN / "my_exo.xml", folder / "rig.yaml")))


def test_motors_of_a_custom_exoskeleton_have_a_fixed_order_and_their_own_limits(tmp_path: Path) -> None:
    motors = {"ankle_l": 10, "hip_l": 5, "hip_r": 40, "knee_r": 35, "knee_l": 35}
    env = environment(own_walk(tmp_path, motors), 3, sensors=("actuator",))
    assert env.physics.joints == ("hip_l", "hip_r", "knee_l", "knee_r", "ankle_l")
    torques = env.action_spec()
    assert torques.maximum.tolist() == [5.0, 20.0, 15.0, 15.0, 10.0]
    assert torques.minimum.tolist() == [-5.0, -20.0, -15.0, -15.0, -10.0]
    assert given_at_first(env, [-4.0, 3.0, -2.0, 1.0, 5.0]) == pytest.approx([-4.0, 3.0, -2.0, 1.0, 5.0])


def test_actions_come_in_the_same_order_however_the_scenario_names_its_joints() -> None:
    crossed = replace(WALK, exo=Exo(mode=3, joints=("knee_r", "hip_r")))
    assert list(modules(crossed.exo)) == ["knee_r", "hip_r"]
    env = environment(crossed, 3, sensors=("actuator",))
    assert env.physics.joints == ("hip_r", "knee_r")
    assert env.action_spec().maximum.tolist() == [20.0, 15.0]
    assert given_at_first(env, [7.0, -3.0]) == pytest.approx([7.0, -3.0])


def test_an_own_exoskeleton_without_motors_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"exo: invalid 'no motors': expected motors in .*rig\.yaml"):
        environment(own_walk(tmp_path, {}))


def test_an_exoskeleton_that_powers_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match="exo"):
        environment("level_20m")
