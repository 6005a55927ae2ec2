"""A twin that walks in lockstep with its consumers: samples are delivered as it walks, and its motors can be driven.

Sensors read the simulation as they read a finished walk, through splines and filters, so that samples lag an instant by
a few milliseconds. Uppers of shoes and sensor mounts are rigid here: their vibration and slip is planned for whole
walks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import numpy as np

from stridetwin.sim import truth
from stridetwin.sim.dynamics.drive import ControlLaw
from stridetwin.sim.dynamics.simulate import MARGIN_S, Simulation
from stridetwin.sim.dynamics.simulated_walk import Replay
from stridetwin.sim.rendering.camera_processes import CameraProcesses
from stridetwin.sim.sensors.model import instants
from stridetwin.sim.sensors.suite import SensorSuite
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Sample

LATENCY_S = 0.008
"""Delay from an instant to its samples, besides the time of an image; more with an IMU of narrow bandwidth."""
_WINDOW_S = 0.1  # motion before the samples that the filters need


class LiveTwin:
    """A walk that is simulated and sensed step by step; a context manager if cameras are worn.

    Args:
        twin: Wearer, route and sensors.
        law: Control law that replaces the scenario's drive of the exoskeleton.

    Attributes:
        simulation: The walk.

    Raises:
        ConfigError: The walk is kinematic (`physics: kinematic`), or has faults, which are planned for whole walks.
    """

    def __init__(self, twin: Twin, law: ControlLaw | None = None) -> None:
        """Checks the scenario, and starts the simulation and the sensors at the beginning of the walk.

        `law` maps the angles of the powered joints to motor torques; None keeps the scenario's drive.
        """
        config = twin.config
        if config.physics != "dynamic":
            raise ConfigError(config.name, "physics", config.physics, "dynamic, for a live walk")
        if config.faults:
            raise ConfigError(config.name, "faults", f"{len(config.faults)} of them", "none, for a live walk")
        self._twin, self.simulation = twin, twin.simulation(law)
        self._suite = SensorSuite(
            twin.sensor_rig, twin.terrain, twin.crowd, twin.seed, gravity_mps2=config.gravity_mps2
        )
        self._cameras = CameraProcesses(
            twin.model, twin.sensor_rig, twin.crowd, twin.seed, processes=1, light=twin.light
        )
        self._latency_s = max(LATENCY_S, self._suite.latency_s + MARGIN_S)
        # Hz, rates at which the motion of the whole body is needed: sensors, cameras and ground truth
        self._rates = self._suite.rates | {c.rate_hz for c in twin.rig.cameras.values()} | {truth.RATE_HZ}
        self._open = ExitStack()
        self._delivered_ns = -1  # samples up to this instant have been returned

    def __enter__(self) -> Self:
        self._open.enter_context(self._cameras)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def advance(self, until_s: float) -> list[Sample]:
        """Simulates up to a time, or to the end; returns the samples that have arrived by then, in order of stamps.

        Samples arrive later than their instants by the latency of sensors and splines. Each is returned once, by the
        first call after its arrival.

        Args:
            until_s: Time of the walk, s.
        """
        while self.simulation.time_s < until_s and not self.simulation.is_over:
            self.simulation.step()
        until_ns = math.floor((self.simulation.time_s - self._latency_s) * 1e9)  # true time of the latest samples
        if until_ns <= self._delivered_ns:
            return []  # nothing new has arrived
        after_ns = self._delivered_ns
        self._delivered_ns = until_ns
        return sorted(self._read_samples(self.simulation, after_ns, until_ns), key=lambda sample: sample.t_ns)

    def _read_samples(self, simulation: Simulation, after_ns: int, until_ns: int) -> Iterable[Sample]:
        """Samples of all sensors, from the latest part of the simulation; in no particular order.

        Args:
            simulation: The walk so far.
            after_ns: True time after which the samples are taken.
            until_ns: True time up to which they are taken.
        """
        # part of the walk that is played: long enough for the samples, and for the motion before them that filters need
        window_s = max(_WINDOW_S, (until_ns - after_ns) * 1e-9 + _WINDOW_S)
        player = Replay(self._twin.model, simulation.recent(window_s + self._latency_s + MARGIN_S))
        t_ns = np.unique(np.concatenate([instants(rate, after_ns, until_ns) for rate in self._rates]))
        loads_ns = instants(truth.RATE_HZ, after_ns, until_ns)
        if not len(t_ns):
            return  # no sensor has a sample in this time
        motion = player.motion(t_ns)
        images = self._cameras.request(motion, after_ns, until_ns)
        loads = player.loads(loads_ns, motion)
        for block in self._suite.read(player, motion, loads, after_ns, until_ns):
            yield from block
        yield from images
