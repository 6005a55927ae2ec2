"""Shoes bend at the toes, then roll over their tip before they leave the ground."""

from __future__ import annotations

import numpy as np
import pytest

from stridetwin.sim.config import Gait, Level, Person, Route, TwinConfig
from stridetwin.sim.gait.foot_path import toe_roll
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.samples import Array

_MOST_BEND_DEG = 30.0  # of people's toes in push-off


def _walk(physics: str = "kinematic") -> Twin:
    return Twin(
        TwinConfig(
            name="toes",
            route=Route(segments=(Level(length_m=6.0),)),
            person=Person(),
            gait=Gait(speed_mps=1.2),
            exo=None,
            physics=physics,
            sensors=(),
        ),
        5,
    )


@pytest.fixture(scope="module")
def walk() -> Twin:
    return _walk()


def _inner_steps(twin: Twin) -> list[Footstep]:
    return [s for steps in twin.reference.steps.values() for s in steps[1:-1]]


def _tip_and_hinge(twin: Twin, step: Footstep, t: Array) -> tuple[Array, Array]:
    """(N, 3) m in the world, lower front edge of the toes and axis of their hinge."""
    shoe = twin.size.shoe
    toe = twin.player().motion(np.round(t * 1e9).astype(np.int64)).tracks[f"toe_{step.foot}"]
    tip = np.array([shoe.toe_tip_x - shoe.toe_hinge_x, 0.0, -shoe.toe_hinge_z])
    return toe.p_body_in_world + from_quaternion(toe.q_world_body) @ tip, toe.p_body_in_world


def test_toes_bend_first_and_the_rest_of_the_pitch_lifts_them(walk: Twin) -> None:
    step = _inner_steps(walk)[0]
    pitch = np.linspace(-0.3, 1.3, 1601)
    roll = toe_roll(step, pitch, np.full(len(pitch), step.t_off))
    bend = np.maximum(pitch, 0.0) - roll
    assert np.all(roll[pitch < 0.2] == 0.0)
    assert np.all(np.diff(roll) >= 0.0)
    assert np.all(np.diff(bend) >= -1e-12)
    assert 20.0 < np.degrees(bend.max()) < _MOST_BEND_DEG
    assert np.abs(np.diff(roll, 2)).max() < 1e-5  # no kink: a bounded second derivative


def test_the_tip_rests_until_toe_off_while_the_ball_rises(walk: Twin) -> None:
    rises, bends = [], []
    for step in _inner_steps(walk):
        t = np.linspace(step.t_off - 0.10, step.t_off - 1e-3, 30)
        tip, hinge = _tip_and_hinge(walk, step, t)
        assert np.ptp(tip, axis=0).max() < 1e-3
        rises.append(hinge[-1, 2] - hinge[0, 2])
        bend = np.degrees(walk.reference.splines(t))[
            :, walk.reference.coordinates.names.index(f"toe_extension_{step.foot}")
        ]
        bends.append(bend.max())
    assert min(rises) >= 0.0
    assert np.median(rises) > 0.015
    assert np.median(bends) < _MOST_BEND_DEG
    assert max(bends) < 1.2 * _MOST_BEND_DEG  # of the hardest push


def test_nothing_jumps_at_toe_off(walk: Twin) -> None:
    for step in _inner_steps(walk):
        t = step.t_off + np.linspace(-0.02, 0.02, 41)
        for point in _tip_and_hinge(walk, step, t):
            speed = np.diff(point, axis=0) / (t[1] - t[0])
            assert np.abs(np.diff(speed, axis=0)).max() / (t[1] - t[0]) < 80.0  # m/s²


def test_toes_of_simulated_walkers_stay_flat() -> None:
    twin = _walk("dynamic")
    steps = [s for side in twin.reference.steps.values() for s in side]
    assert not any(step.rolls_off for step in steps)
