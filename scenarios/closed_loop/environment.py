"""A simulated walk as `dm_control.rl.control` and `dm_env` drive it.

An action is the torque that each motor is to give, asked a hundred times a second and given 10 ms later. The wearer
walks the scenario's way and knows what the motors do: his own torque is what tracking still needs.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from itertools import repeat
from typing import Any

import numpy as np
from dm_control.rl import control
from dm_env import specs

from stridetwin.scenarios.closed_loop.observers import Observer, Streams
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.actuation import modules
from stridetwin.sim.config import SIDES, TwinConfig
from stridetwin.sim.dynamics.drive import PERIOD_S
from stridetwin.sim.dynamics.simulate import STEP_S
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.live import LiveTwin
from stridetwin.sim.standard_rig import sensor_rig
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array

HIP_NM, KNEE_NM = 20.0, 15.0
"""The most that is given to hips and to other joints, N m; to none more than its motor gives."""
SENSORS = ("insole", "ahrs", "encoder", "interaction", "actuator")
HELPED = tuple(f"{joint}_flexion_{side}" for joint in ("hip", "knee") for side in SIDES)
_ORDER = ("hip", "knee", "ankle")
_SEEDS = "a whole number from 0 on, or an iterable of them with one for each walk"


class WalkPhysics(control.Physics):
    """One walk after the other, each with the next seed.

    Args:
        config: Who walks where; with an exoskeleton.
        seeds: Of the walks; a seed that stays is not planned again.

    Attributes:
        joints: The powered ones, in the order of actions: hips, knees, ankles, then others by name; left first.
        most: (n,) N m, the most that is given to each of them.
        rig: The sensors as estimators are told of them, of the first walk.

    Raises:
        ConfigError: Nothing is powered, or a seed is none, or there are no more of them.
    """

    def __init__(self, config: TwinConfig, seeds: Iterator[int]) -> None:
        mounted = {} if config.exo is None else modules(config.exo)
        if not mounted:
            raise _unpowered(config)
        self.joints = tuple(sorted(mounted, key=_rank))
        self.most = np.minimum(most_nm(self.joints), [mounted[joint].torque_max_nm for joint in self.joints])
        self._driven = [self.joints.index(joint) for joint in mounted]  # in the order in which motors are asked
        self._config, self._seeds = config, seeds
        self._seed = self._next_seed()
        self.rig: Rig = sensor_rig(config).nominal(self._seed)
        self._twin: Twin | None = None
        self._live: LiveTwin | None = None
        self._walking = ExitStack()
        self._torque = np.zeros(len(self.joints))
        self.samples: list[Any] = []

    @property
    def live(self) -> LiveTwin:
        """The walk that goes on."""
        if self._live is None:
            raise RuntimeError("no walk has begun: call reset first")
        return self._live

    @property
    def twin(self) -> Twin:
        """Who walks it."""
        assert self._twin is not None
        return self._twin

    def reset(self) -> None:
        """Begins the next walk: the wearer stands on his soles."""
        self.close()
        if self._twin is None:
            self._twin = Twin(self._config, self._seed)
        else:
            seed = self._next_seed()
            if seed != self._twin.seed:
                self._twin = Twin(self._config, seed)
        self._torque = np.zeros(len(self.joints))
        self._live = self._walking.enter_context(LiveTwin(self._twin, lambda angle: self._torque[self._driven]))
        self._live.advance(0.0)
        self.samples = []

    def _next_seed(self) -> int:
        seed: Any = next(self._seeds, "used up")
        number = -1
        with suppress(TypeError):
            number = operator.index(seed)
        if number < 0:
            raise ConfigError("environment", "seed", seed, _SEEDS)
        return number

    def after_reset(self) -> None:
        """Nothing is left to do."""

    def close(self) -> None:
        """Ends the walk, and the processes that draw its pictures."""
        self._walking.close()
        self._live = None

    def set_control(self, control: Array) -> None:
        """The torques that are asked for next, N m, in the order of `joints`."""
        self._torque = np.array(control, float)

    def step(self, n_sub_steps: int = 1) -> None:
        """Walks on; `samples` are those that have arrived."""
        self.samples = self.live.advance(self.live.simulation.time_s + n_sub_steps * STEP_S)

    def time(self) -> float:
        """How long the walk has gone on, s."""
        return self.live.simulation.time_s

    def timestep(self) -> float:
        """Of the simulation, s."""
        return STEP_S

    def power(self, seconds: float) -> Array:
        """(N, 4) W of the wearer's own hips and knees (`HELPED`) in each step of the last time."""
        torque, speed = helped_joints(self.live.simulation.recent(seconds))
        return torque * speed


def helped_joints(walk: SimulatedWalk) -> tuple[Array, Array]:
    """(N, 4) N m and rad/s of the wearer's own hips and knees (`HELPED`) in each step of a walk."""
    _, speed = walk.moving(walk.t)
    names = walk.coordinates.names[6:]
    dof = [int(walk.coordinates.dof[names.index(joint)]) for joint in HELPED]
    return np.asarray(walk.torque[:, dof]), np.asarray(speed[:, dof])


def most_nm(joints: Sequence[str]) -> Array:
    """(n,) N m, the most that is given to joints by their names, if their motors give as much."""
    return np.array([HIP_NM if joint.startswith("hip") else KNEE_NM for joint in joints])


def _rank(joint: str) -> tuple[int, str]:
    """Where a joint comes among actions."""
    name = joint.rpartition("_")[0]
    return _ORDER.index(name) if name in _ORDER else len(_ORDER), joint


def _unpowered(config: TwinConfig) -> ConfigError:
    told, valid = "none", "an exoskeleton in a mode that powers joints (1-4)"
    if config.exo is not None:
        told = f"mode {config.exo.mode}"
        if config.exo.own is not None:
            told, valid = "no motors", f"motors in {config.exo.own.rig}"
    return ConfigError(config.name, "exo", told, valid)


def _seeds(seed: Any) -> Iterator[Any]:
    """One seed for ever, or one after the other."""
    with suppress(TypeError):
        return repeat(operator.index(seed))
    with suppress(TypeError):
        return iter(seed)
    raise ConfigError("environment", "seed", seed, _SEEDS)


class Assistance(control.Task):
    """To help: the reward is the wearer's positive work of hips and knees, J, less than none.

    Args:
        observer: What the controller sees; None: the streams of the exoskeleton's sensors.
        rig: Of the walk.
    """

    def __init__(self, observer: Observer | None, rig: Rig) -> None:
        self.observer: Observer = observer or Streams(rig)

    def initialize_episode(self, physics: WalkPhysics) -> None:
        """A walk begins."""
        self.observer.reset()

    def action_spec(self, physics: WalkPhysics) -> specs.BoundedArray:
        """(n,) N m, flexion positive, in the order of the physics' `joints`."""
        return specs.BoundedArray(physics.most.shape, float, -physics.most, physics.most, name="torque_nm")

    def before_step(self, action: Array, physics: WalkPhysics) -> None:
        """What is beyond the limits is given as the limit; what is not finite is refused."""
        torque = np.asarray(action, float)
        if torque.shape != physics.most.shape or not np.isfinite(torque).all():
            raise ConfigError("action", "torque_nm", torque, f"{len(physics.most)} finite numbers")
        physics.set_control(np.clip(torque, -physics.most, physics.most))

    def after_step(self, physics: WalkPhysics) -> None:
        """Takes what has arrived."""
        self.observer.update(physics.samples)

    def get_observation(self, physics: WalkPhysics) -> dict[str, Array]:
        """As the observer tells; the environment takes their specification from it, flat where it is to be."""
        return self.observer.observation()

    def get_reward(self, physics: WalkPhysics) -> float:
        """J, never above 0."""
        return -float(np.maximum(physics.power(PERIOD_S), 0.0).sum()) * STEP_S

    def get_termination(self, physics: WalkPhysics) -> float | None:
        """0 after a fall, 1 at the end of the way, None on it."""
        simulation = physics.live.simulation
        return None if not simulation.over else 0.0 if simulation.fell_at is not None else 1.0


def environment(
    scenario: str | TwinConfig, seed: int | Iterable[int] = 0, *, observer: Callable[[Rig], Observer] | None = None,
    sensors: tuple[str, ...] = SENSORS, flat_observation: bool = False,
) -> control.Environment:  # fmt: skip
    """The walk of a scenario as an environment with a step of 10 ms.

    Args:
        scenario: Name in the catalogue, path of a file, or a configuration; with an exoskeleton in a mode that powers
            joints, or one of the user's own with motors. It is simulated with contacts, without faults, on rigid shoes.
        seed: Of every walk; or one seed a walk, of which there have to be enough.
        observer: Makes from the rig what the controller sees; None: the streams of the exoskeleton's sensors.
        sensors: Groups of sensors that are worn.
        flat_observation: One vector, `observations`, of all in the alphabetical order of their names.

    Raises:
        ConfigError: It cannot be walked, or powers nothing; a seed that is none, or, in `reset`, no more of them.
    """
    config = scenario if isinstance(scenario, TwinConfig) else load_scenario(scenario).config
    config = replace(config, physics="dynamic", sensors=sensors, faults=(), shock=False)
    physics = WalkPhysics(config, _seeds(seed))
    task = Assistance(None if observer is None else observer(physics.rig), physics.rig)
    return control.Environment(physics, task, control_timestep=PERIOD_S, flat_observation=flat_observation)
