"""Pinned numbers of planned footsteps, of the truth, and of the exoskeleton's sensors: see `tests.pinned`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Level, Person, Ramp, Route, Segment, Stairs, Turn, TwinConfig
from stridetwin.sim.gait.footsteps import Footstep, plan_footsteps
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Block
from tests.pinned import SAME_RATES, assert_pinned, columns

EVERY_NS = 500_000_000
STAIRS: tuple[Segment, ...] = (
    Level(length_m=2.5),
    Stairs(risers=4, riser_m=0.19),
    Level(length_m=1.5),
    Stairs(risers=3, down=True),
    Level(length_m=1.5),
)
WALKS: dict[str, tuple[tuple[Segment, ...], Gait]] = {
    "stairs": (STAIRS, Gait()),
    "step_by_step": (STAIRS, Gait(speed_mps=0.7, stairs="step_by_step", leading_foot="l")),
    "two_at_a_time": (STAIRS, Gait(stairs="two_at_a_time")),
    "deep_stairs": ((Level(length_m=2.0), Stairs(risers=3, tread_m=0.9), Level(length_m=2.0)), Gait()),
    "steep_ramps": (
        (
            Level(length_m=2.0),
            Ramp(angle_rad=0.2, rise_m=0.4),
            Ramp(angle_rad=0.08, rise_m=0.2, down=True),
            Level(length_m=2.0, cross_slope_rad=0.05),
            Level(length_m=1.0),
        ),
        Gait(asymmetry=0.1),
    ),
    "turns": (
        (
            Level(length_m=2.0),
            Turn(angle_rad=1.6, radius_m=1.0),
            Turn(angle_rad=-1.0, radius_m=0.0),
            Level(length_m=2.0),
        ),
        Gait.of_pattern("jog"),
    ),
    "wander": ((Level(length_m=9.0),), Gait.of_pattern("wander")),
    "shuffle": ((Level(length_m=2.0), Stairs(risers=1, riser_m=0.03), Level(length_m=2.0)), Gait(shuffle=0.8)),
}


def twin_of(segments: tuple[Segment, ...], gait: Gait) -> Twin:
    config = TwinConfig(name="pinned", route=Route(segments=segments), sensors=(), person=Person(), gait=gait)
    return Twin(config, 11)


@pytest.fixture(scope="module")
def usual() -> Twin:
    return twin_of((Level(length_m=3.0),), Gait())


@pytest.mark.parametrize("name", WALKS)
def test_footsteps(name: str, usual: Twin, num_regression: Any) -> None:
    segments, gait = WALKS[name]
    layout = usual.terrain.from_route(Route(segments=segments)).layout
    steps, duration = plan_footsteps(layout, usual.size, gait, np.random.default_rng(3))
    rows = [_finite(step) for step in steps]
    assert_pinned(num_regression, columns(rows) | {"duration_s": np.array([duration])})


def _finite(step: Footstep) -> Footstep:
    """A step without the infinite times of standing."""
    return replace(step, t_touch=max(step.t_touch, -1.0), t_off=min(step.t_off, 1e3))


def test_truth_and_sensors_of_the_exoskeleton(num_regression: Any) -> None:
    short = (Level(length_m=2.0), Stairs(risers=2), Level(length_m=1.0), Ramp(angle_rad=0.15, rise_m=0.2))
    route = Route(segments=(*short, Level(length_m=1.0)))
    config = load_scenario("shim_stairs").config
    sensors = tuple(s for s in config.sensors if "camera" not in s)  # images change no other sensor
    config = replace(config, physics="kinematic", route=route, sensors=sensors)
    found: dict[str, list[Any]] = {}
    for items in Twin(config, 11).blocks():
        for item in items:
            if item.topic.startswith(("/truth", "/exo")):
                found.setdefault(item.topic, []).extend(_now_and_then(item) if isinstance(item, Block) else [item])
    table = {f"{topic}.{name}": rows for topic in found for name, rows in columns(found[topic]).items()}
    assert_pinned(num_regression, table, SAME_RATES)


def _now_and_then(block: Block[Any]) -> Iterable[dict[str, Any]]:
    """Its rows at every half second."""
    for i in np.flatnonzero(block.t_ns % EVERY_NS == 0):
        yield {name: np.asarray(values[i], float).ravel() for name, values in block.columns.items()}
