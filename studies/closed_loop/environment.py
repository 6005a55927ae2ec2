"""A simulated walk as `dm_control.rl.control` and `dm_env` drive it.

An action is the torque command of each motor, at 100 Hz; the motor applies it 10 ms later. The wearer follows the
scenario's route and knows the motors' torques: their own joint torques are what tracking needs in addition.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from itertools import chain, repeat
from typing import Any, Protocol, SupportsIndex

import numpy as np
from dm_control.rl import control
from dm_env import specs

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES, TwinConfig
from stridetwin.sim.dynamics.drive import PERIOD_S
from stridetwin.sim.dynamics.simulate import STEP_S
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.live import LiveTwin
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.exoskeleton import modules
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Sample
from stridetwin.studies.closed_loop.plan_cache import cache_plans

HIP_NM, KNEE_NM = 20.0, 15.0
"""Torque limits of hips and knees of the built-in exoskeleton, N m; an exoskeleton of the user's has its own."""
WEARER_JOINTS = tuple(f"{joint}_flexion_{side}" for joint in ("hip", "knee") for side in SIDES)
"""The wearer's own joints whose work is counted: both hips, then both knees, left first."""
_ORDER = ("hip", "knee", "ankle")  # of the joints among the actions
_OBSERVED = {
    "insole": (4, ("force",)),
    "ahrs": (7, ("q_world_sensor", "angular_rate")),
    "encoder": (1, ("angle",)),
    "interaction": (2, ("force",)),
    "actuator": (3, ("torque_command", "torque", "speed")),
}
"""By kind of sensor: the size of its observation, and the attributes of a sample that make it."""
SENSORS = tuple(_OBSERVED)
"""Groups of sensors of the walk, unless others are asked for: those that can be observed."""


class WalkPhysics(control.Physics):
    """Walks in sequence, each with the next seed.

    Args:
        config: Walker and route; with an exoskeleton.
        seeds: Of the walks; a repeated seed is not planned again.

    Attributes:
        joints: Powered joints, in the order of actions: hips, knees, ankles, then others by name; left first.
        max_torque_nm: (n,) torque limit of each, N m; of an exoskeleton of the user's, those of its rig file.
        samples: Samples that arrived in the last step.
        rig: The nominal sensor rig of the first walk, as estimators read it.

    Raises:
        ConfigError: No joint is powered, a seed is invalid, or no seed is left.
    """

    def __init__(self, config: TwinConfig, seeds: Iterator[int]) -> None:
        """Sets joints, limits and rig; the first walk is only planned in `reset`."""
        powered = {} if config.exo is None else modules(config.exo)  # motors by joint
        if not powered:
            raise _no_power_error(config)
        self.joints = tuple(sorted(powered, key=_rank))
        motor_limits = np.array([powered[joint].torque_max_nm for joint in self.joints])
        is_own = config.exo is not None and config.exo.user_exo is not None
        self.max_torque_nm = motor_limits if is_own else np.minimum(torque_limits_nm(self.joints), motor_limits)
        self._driven = [self.joints.index(joint) for joint in powered]  # for each motor, the number of its action
        first = next(seeds)  # for the rig; it is put back as the seed of the first walk
        self._config, self._seeds = config, chain((first,), seeds)
        self.rig: Rig = sensor_rig(config).nominal(first)
        self._plan, self._plan_control = cache_plans()
        self._twin: Twin | None = None  # of the current walk; used again for the same seed
        self._live: LiveTwin | None = None
        self._walking = ExitStack()  # closes the current walk
        self._torque = np.zeros(len(self.joints))  # last action, N m, in the order of `joints`
        self.samples: list[Sample] = []

    @property
    def live(self) -> LiveTwin:
        """The current walk, which advances step by step.

        Raises:
            RuntimeError: No walk has begun.
        """
        if self._live is None:
            raise RuntimeError("no walk has begun: call reset first")
        return self._live

    @property
    def twin(self) -> Twin:
        """The twin of the current walk."""
        assert self._twin is not None
        return self._twin

    def reset(self) -> None:
        """Starts the next walk: the wearer stands on both soles."""
        self.close()
        seed = next(self._seeds)
        if self._twin is None or seed != self._twin.seed:
            self._twin = Twin(self._config, seed, plan=self._plan, plan_control=self._plan_control)
        self._torque = np.zeros(len(self.joints))
        # the motors read the last action at each of their steps, in their own order, whatever the joints' angles
        self._live = self._walking.enter_context(LiveTwin(self._twin, lambda angle: self._torque[self._driven]))
        self._live.advance(0.0)
        self.samples = []

    def after_reset(self) -> None:
        """Does nothing; `dm_control` requires the method."""

    def close(self) -> None:
        """Ends the walk and the processes that render its images."""
        self._walking.close()
        self._live = None

    def set_control(self, control: Array) -> None:
        """Sets the torque commands of the next step, (n,) N m, in the order of `joints`."""
        self._torque = np.array(control, float)

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances the walk by some time steps of `STEP_S`; `samples` then holds the samples that arrived meanwhile."""
        self.samples = self.live.advance(self.live.simulation.time_s + n_sub_steps * STEP_S)

    def time(self) -> float:
        """Time since the start of the walk, s."""
        return self.live.simulation.time_s

    def timestep(self) -> float:
        """Time step of the simulation, s."""
        return STEP_S

    def power(self, seconds: float) -> Array:
        """Power of the wearer's own hips and knees in the last N time steps, (N, 4) W in the order of `WEARER_JOINTS`.

        Args:
            seconds: How long these time steps take together.
        """
        torque, speed = wearer_joints(self.live.simulation.recent(seconds))
        return torque * speed


def wearer_joints(walk: SimulatedWalk) -> tuple[Array, Array]:
    """Torques and speeds of the wearer's own hips and knees in each of the N time steps of a walk.

    Returns:
        (N, 4) N m and (N, 4) rad/s, in the order of `WEARER_JOINTS`.
    """
    _, speed = walk.position_velocity(walk.t)
    names = walk.coordinates.names[6:]  # the hinges, without the six coordinates of the root
    # column of each joint in torques and speeds, (4,)
    dof = [int(walk.coordinates.dof[names.index(joint)]) for joint in WEARER_JOINTS]
    return np.asarray(walk.torque[:, dof]), np.asarray(speed[:, dof])


def torque_limits_nm(joints: Sequence[str]) -> Array:
    """(n,) torque limits of the built-in exoskeleton's joints by name, N m, before the motors' own limits."""
    return np.array([HIP_NM if joint.startswith("hip") else KNEE_NM for joint in joints])


def _rank(joint: str) -> tuple[int, str]:
    """Sort key of a joint among the actions: hips, knees, ankles, then others; by name within each."""
    name = joint.rpartition("_")[0]
    return _ORDER.index(name) if name in _ORDER else len(_ORDER), joint


def _no_power_error(config: TwinConfig) -> ConfigError:
    """The error of a walk without a powered joint; it names what the walk has instead, and what is expected."""
    value, valid = "none", "an exoskeleton in a mode that powers joints (1-4)"
    if config.exo is not None:
        value = f"mode {config.exo.mode}"
        if config.exo.user_exo is not None:
            value, valid = "no motors", f"motors in {config.exo.user_exo.rig}"
    return ConfigError(config.name, "exo", value, valid)


def _walk_seeds(seed: Any) -> Iterator[int]:
    """Yields the seeds of consecutive walks; each is checked when its walk is due.

    Args:
        seed: One seed for all walks, or an iterable with one per walk; at a walk for which it has none left, the error
            of an invalid seed is raised.
    """
    try:
        seeds = iter(seed)
    except TypeError:  # no iterable
        seeds = repeat(seed)
    # after the last seed of an iterable comes a text, which `_check_seed` refuses
    return map(_check_seed, chain(seeds, repeat("used up")))


def _check_seed(value: object) -> int:
    """The seed as a whole number from 0 on; raises ConfigError for anything else."""
    with suppress(TypeError):  # of a value that only seems to be an index
        if isinstance(value, SupportsIndex) and (seed := operator.index(value)) >= 0:
            return seed
    valid = "a whole number from 0 on, or an iterable of them with one per walk"
    raise ConfigError("environment", "seed", value, valid)


class Observer(Protocol):
    """Turns samples into observations of a controller; it knows the nominal rig and no truth."""

    def reset(self) -> None:
        """Starts a walk; forgets the samples of the previous one."""
        ...

    def update(self, samples: Iterable[Sample]) -> None:
        """Processes the samples that arrived, in time order."""
        ...

    def observation(self) -> dict[str, Array]:
        """The current observation: arrays by name, always of the same names and shapes."""
        ...


class Streams:
    """The latest value of each sensor of the exoskeleton, NaN before the first sample.

    By topic, without the leading slash: encoders (1,) rad; insoles (4,) N; AHRS (7,) quaternion and rad/s; interaction
    (2,) N; actuators (3,) torque command and torque, N m, and speed, rad/s.

    Args:
        rig: The sensors.
    """

    def __init__(self, rig: Rig) -> None:
        self._kind = {topic: sensor.kind for topic, sensor in rig.others.items() if sensor.kind in _OBSERVED}
        Streams.reset(self)

    def reset(self) -> None:
        """Starts a walk: all values are NaN."""
        sizes = {kind: size for kind, (size, _) in _OBSERVED.items()}
        self._latest = {topic: np.full(sizes[kind], np.nan) for topic, kind in self._kind.items()}

    def update(self, samples: Iterable[Sample]) -> None:
        """Keeps the values of the samples that arrived, in time order."""
        for sample in samples:
            if sample.topic in self._kind:
                _, names = _OBSERVED[self._kind[sample.topic]]
                self._latest[sample.topic] = np.hstack([getattr(sample, name) for name in names]).astype(float)

    def observation(self) -> dict[str, Array]:
        """The latest value of each sensor, by topic without the leading slash."""
        return {topic.lstrip("/"): value.copy() for topic, value in self._latest.items()}


class Assistance(control.Task):
    """Assistance: the reward is minus the wearer's positive work of hips and knees, J.

    Args:
        observer: The controller's observations; None: the streams of the exoskeleton's sensors.
        rig: Of the walk.
    """

    def __init__(self, observer: Observer | None, rig: Rig) -> None:
        self.observer: Observer = observer or Streams(rig)

    def initialize_episode(self, physics: WalkPhysics) -> None:
        """Starts a walk: resets the observer."""
        self.observer.reset()

    def action_spec(self, physics: WalkPhysics) -> specs.BoundedArray:
        """Bounds of an action: (n,) torques, N m, flexion positive, in the order of the physics' `joints`."""
        return specs.BoundedArray(
            physics.max_torque_nm.shape, float, -physics.max_torque_nm, physics.max_torque_nm, name="torque_nm"
        )

    def before_step(self, action: Array, physics: WalkPhysics) -> None:
        """Clips torques to the limits; refuses values that are not finite."""
        torque = np.asarray(action, float)
        if torque.shape != physics.max_torque_nm.shape or not np.isfinite(torque).all():
            raise ConfigError("action", "torque_nm", torque, f"{len(physics.max_torque_nm)} finite numbers")
        physics.set_control(np.clip(torque, -physics.max_torque_nm, physics.max_torque_nm))

    def after_step(self, physics: WalkPhysics) -> None:
        """Passes the samples that arrived to the observer."""
        self.observer.update(physics.samples)

    def get_observation(self, physics: WalkPhysics) -> dict[str, Array]:
        """The observer's observation; the environment also derives its specification from it."""
        return self.observer.observation()

    def get_reward(self, physics: WalkPhysics) -> float:
        """Minus the wearer's positive work of hips and knees in the last step, J: never above 0."""
        # W at the time steps of one control step, (N, 4), summed over joints and time; times the time step it is J
        return -float(np.maximum(physics.power(PERIOD_S), 0.0).sum()) * STEP_S

    def get_termination(self, physics: WalkPhysics) -> float | None:
        """Discount at the end of a walk: 0 after a fall, 1 at the end of the route; None while it goes on."""
        simulation = physics.live.simulation
        if not simulation.is_over:
            return None
        return 0.0 if simulation.fell_at is not None else 1.0


def environment(
    scenario: str | TwinConfig,
    seed: int | Iterable[int] = 0,
    *,
    observer: Callable[[Rig], Observer] | None = None,
    sensors: tuple[str, ...] = SENSORS,
    flat_observation: bool = False,
) -> control.Environment:
    """The walk of a scenario as an environment with a step of 10 ms.

    Args:
        scenario: Name in the catalogue, path of a file, or a configuration; with an exoskeleton in a mode that powers
            joints, or one of the user's own with motors. It is simulated with contacts, without faults, on rigid shoes.
        seed: Of every walk; or an iterable with one seed per walk.
        observer: Makes the observer from the rig; None: the streams of the exoskeleton's sensors.
        sensors: Sensor groups of the walk.
        flat_observation: One vector, `observations`, of all observations in alphabetical order of their names.

    Raises:
        ConfigError: The walk is infeasible, no joint is powered, a seed is invalid, or, in `reset`, no seed is left.
    """
    config = scenario if isinstance(scenario, TwinConfig) else load_scenario(scenario).config
    config = replace(config, physics="dynamic", sensors=sensors, faults=(), shock=False)
    physics = WalkPhysics(config, _walk_seeds(seed))
    task = Assistance(None if observer is None else observer(physics.rig), physics.rig)
    return control.Environment(physics, task, control_timestep=PERIOD_S, flat_observation=flat_observation)
