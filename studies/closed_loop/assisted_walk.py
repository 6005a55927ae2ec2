"""A walk with assistance, and its cost to the wearer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.sim.config import SIDES, Exo, TwinConfig
from stridetwin.sim.dynamics.simulate import STEP_S
from stridetwin.sim.dynamics.simulated_walk import Replay, SimulatedWalk
from stridetwin.sim.twin import Twin
from stridetwin.sim.walk import Stance
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array
from stridetwin.studies.closed_loop.assistance_controller import AssistanceController, AssistanceObserver
from stridetwin.studies.closed_loop.environment import (
    WEARER_JOINTS,
    Observer,
    Streams,
    environment,
    torque_limits_nm,
    wearer_joints,
)
from stridetwin.studies.closed_loop.recognition import Recognition, TrueModes

Recogniser = Callable[[Rig, Twin], Recognition]
"""Makes the mode recognition of a walk; from the twin it takes measured geometry, or the truth for comparison."""
_EXO = Exo(mode=1)  # both hips and knees are driven
_SENSED = ("insole", "encoder", "actuator")  # groups of sensors that the controller reads


class WalkResult(NamedTuple):
    """A simulated walk and the twin that walked it."""

    twin: Twin
    walk: SimulatedWalk


def simulate_bare_walk(config: TwinConfig, seed: int) -> WalkResult:
    """Simulates the walk with contacts and rigid shoes, without exoskeleton, sensors and faults."""
    twin = Twin(replace(config, exo=None, sensors=(), physics="dynamic", faults=(), shock=False), seed)
    walk = twin.walk
    assert isinstance(walk, SimulatedWalk)  # dynamic physics gives one
    return WalkResult(twin=twin, walk=walk)


def simulate_assisted_walk(
    config: TwinConfig, seed: int, recogniser: Recogniser | None, sensors: tuple[str, ...] = ()
) -> WalkResult:
    """Simulates the walk in the exoskeleton with all its modules, driven by `AssistanceController`.

    Args:
        config: Configuration of walker and route.
        seed: Seed of the walk.
        recogniser: Makes the mode recognition; None: the motors only compensate their own inertia.
        sensors: Sensor groups besides those of the controller.
    """

    def observer(rig: Rig) -> Observer:
        """The controller's observer, which makes a new recognition for each walk; without one the streams alone."""
        if recogniser is None:
            return Streams(rig)
        # called when a walk begins: the environment, made below, then has its twin
        return AssistanceObserver(rig, lambda: recogniser(rig, env.physics.twin))

    sensor_groups = tuple(dict.fromkeys((*_SENSED, *sensors)))  # each once
    env = environment(replace(config, exo=_EXO), seed, observer=observer, sensors=sensor_groups)
    physics = env.physics
    try:
        step = env.reset()
        controller = AssistanceController(physics.joints, env.action_spec().maximum)
        idle = np.zeros(len(physics.joints))
        while not step.last():  # one step of 10 ms after the other, to the end of the route or a fall
            step = env.step(idle if recogniser is None else controller.torques(step.observation))
        return WalkResult(twin=physics.twin, walk=physics.live.simulation.walk())
    finally:
        physics.close()


def true_modes_of(twin: Twin, wrong: float = 0.0) -> TrueModes:
    """A recognition with the true modes of a walk, in which a share `wrong` of the steps has other modes."""
    # of each foot: touch-down, ns, and mode of each step
    steps = {
        side: [(round(s.t_touch * 1e9), s.mode) for s in _select_landed(twin.reference.steps[side])] for side in SIDES
    }
    # the wrong modes depend on the walk's seed; the key keeps their random numbers apart from others of the walk
    return TrueModes(steps, wrong, np.random.default_rng(np.random.SeedSequence(twin.seed, spawn_key=(2,))))


def compute_costs(result: WalkResult) -> dict[str, dict[str, float]]:
    """Cost of the steps of each mode to the wearer; a step lasts from a foot's touch-down to the other foot's.

    Steps after a fall do not count.

    Returns:
        By mode: `steps`; `work_j`, the wearer's positive work of hips and knees, Σ max(τ ω, 0) dt; `rest_j`, the work
        that would remain if the motors' torque limits reduced it without loss, Σ max(τ ω - τ_max |ω|, 0) dt; `cuff_n`,
        RMS force of thigh and shank cuffs, 0 without exoskeleton.
    """
    walk = result.walk
    torque, speed = wearer_joints(walk)  # (N, 4) N m and rad/s, of hips and knees
    # (N,) W: positive power, and what of it exceeds the torque limits of the motors
    power = np.maximum(torque * speed, 0.0).sum(axis=1)
    rest = np.maximum(torque * speed - torque_limits_nm(WEARER_JOINTS) * np.abs(speed), 0.0).sum(axis=1)
    cuffs = _cuff_force_squared(result)  # (N,) N², mean square of the cuffs' forces
    # of both feet, by touch-down
    steps = sorted((s for side in SIDES for s in _select_landed(walk.steps[side])), key=lambda s: s.t_touch)
    cost_of_mode = {mode: {"steps": 0.0, "work_j": 0.0, "rest_j": 0.0, "cuff_n": 0.0} for mode in MODES}
    end_s = float(walk.t[-1]) if walk.fell_at is None else walk.fell_at
    for step, after in pairwise(steps):
        if after.t_touch > end_s:  # the walk has ended before the other foot's touch-down
            break
        during_step = (walk.t >= step.t_touch) & (walk.t < after.t_touch)
        cost = cost_of_mode[step.mode]
        cost["steps"] += 1.0
        cost["work_j"] += float(power[during_step].sum()) * STEP_S
        cost["rest_j"] += float(rest[during_step].sum()) * STEP_S
        cost["cuff_n"] += float(cuffs[during_step].mean())  # N², mean square of a step
    # the sum of the steps' mean squares becomes the RMS over the steps, N
    for cost in cost_of_mode.values():
        cost["cuff_n"] = float(np.sqrt(cost["cuff_n"] / cost["steps"])) if cost["steps"] else 0.0
    return {mode: cost for mode, cost in cost_of_mode.items() if cost["steps"]}


def _cuff_force_squared(result: WalkResult) -> Array:
    """(N,) N², mean over the cuffs of their squared forces at the walk's N instants; 0 without exoskeleton."""
    t = result.walk.t
    if result.twin.config.exo is None:
        return np.zeros(len(t))
    t_ns = np.round(t * 1e9).astype(np.int64)
    motion = Replay(result.twin.model, result.walk).motion(t_ns)
    # `cuff_force` has the force of each cuff, (N,) N, by name
    return np.asarray(np.mean([np.square(force) for force in motion.cuff_force.values()], axis=0))


def _select_landed(steps: Sequence[Stance]) -> list[Stance]:
    """The steps that land during the walk, without the initial stance."""
    return [s for s in steps if np.isfinite(s.t_touch) and s.t_touch > 0.0]
