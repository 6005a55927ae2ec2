"""A short walk of the twin in its exoskeleton, as samples in order of time, and what can be done to them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import Exoskeleton
from stridetwin.scenarios.exo_geometry import true_geometry
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Ahrs, Footprint, Sample
from stridetwin.studies.shim2019.shim_table5 import simulate_walk


@cache
def level_walk() -> tuple[Exoskeleton, tuple[Sample, ...], tuple[Footprint, ...]]:
    """Geometry, samples and true footprints of 5 m on the level."""
    twin = Twin(
        TwinConfig(name="level", route=Route(segments=(Level(length_m=5.0),)), sensors=("ahrs", "encoder", "insole")), 5
    )
    samples, footprints = simulate_walk(twin)
    return true_geometry(twin.size, twin.rig), tuple(samples), tuple(footprints)


def turned(samples: tuple[Sample, ...], R_new_world: Rotation) -> list[Sample]:
    """The same samples of a world with other axes."""
    return [
        replace(s, q_world_sensor=(R_new_world * _rotation(s)).as_quat(scalar_first=True)) if isinstance(s, Ahrs) else s
        for s in samples
    ]


def remounted(samples: tuple[Sample, ...], topic: str, R_sensor_new: Rotation) -> list[Sample]:
    """The same samples of an AHRS that sits turned."""
    return [
        replace(
            s,
            q_world_sensor=(_rotation(s) * R_sensor_new).as_quat(scalar_first=True),
            angular_rate=R_sensor_new.inv().apply(s.angular_rate),
        )
        if isinstance(s, Ahrs) and s.topic == topic
        else s
        for s in samples
    ]


def dropped(samples: tuple[Sample, ...], share: float, seed: int = 0) -> list[Sample]:
    """What arrives where a share of all packets is lost."""
    kept = np.random.default_rng(seed).random(len(samples)) >= share
    return [s for s, keep in zip(samples, kept) if keep]


def _rotation(sample: Ahrs) -> Rotation:
    return Rotation.from_quat(sample.q_world_sensor, scalar_first=True)
