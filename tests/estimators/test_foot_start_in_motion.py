"""Recordings that begin in the middle of a walk: the first stance aligns, and two feet are apart at the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from foot_motion import ADIS16485

from benchmarks.real_walks import imu_block
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Block, Imu
from stridetwin.studies.jao2020.jao_simulation import JaoSimulation, SteadyWalk
from tests.streams.foot_imu import STANCE_S, STRIDES, SWING_S, simulate_foot

_RIGHT = replace(ADIS16485, topic="/foot_r/imu", mount=Mount(body="foot_r"))


def _begin_in_swing() -> tuple[Block[Imu], float]:
    """Samples from the middle of the first swing on, of a foot that rocks in its stances; time of the first stance."""
    t, force, rate = simulate_foot()
    rocking = 0.15 * np.sin(2 * np.pi * 4.0 * t)[:, None] * [1.0, 0.7, 0.3]
    begin = 2.0 + 0.5 * SWING_S
    rows = t >= begin
    return imu_block(t[rows] - begin, (rate + rocking)[rows], force[rows]), 0.5 * SWING_S


def test_the_first_stance_aligns_although_it_is_less_quiet_than_standing() -> None:
    block, stance_s = _begin_in_swing()
    path = FootIns().run(block)
    aligned_s = 1e-9 * (path.trajectory.t_ns[path.aligned.argmax()] - block.t_ns[0])
    assert stance_s < aligned_s < stance_s + STANCE_S
    p = path.trajectory.p_frame_in_world
    way = np.linalg.norm((p[-1] - p[path.aligned.argmax()])[:2])
    t, force, rate = simulate_foot()
    whole = np.linalg.norm(FootIns().run(imu_block(t, rate, force)).trajectory.p_frame_in_world[-1][:2])
    assert abs(way - whole * (STRIDES - 1) / STRIDES) < 0.03 * whole


def test_two_feet_that_stop_one_after_the_other_began_anywhere() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 3.0, 1.0 / 200.0)
    gravity = np.tile([0.0, 0.0, 9.81], (len(t), 1))
    shape, moves = gravity.shape, (t < 1.0)[:, None]
    still = imu_block(t, 1e-4 * rng.standard_normal(shape), gravity)
    jolts = moves * rng.standard_normal((2, *shape))
    moving = imu_block(t, 3.0 * jolts[0], gravity + 5.0 * jolts[1])
    spreads = {}
    for name, left in (("still", still), ("moving", moving)):
        feet = FootToFoot(Rig(imus={"/foot_l/imu": ADIS16485, "/foot_r/imu": _RIGHT}))
        imus = {"l": replace(left, topic="/foot_l/imu"), "r": replace(still, topic="/foot_r/imu")}
        covariance = feet.run(imus)["r"].trajectory.covariance[-1]
        spreads[name] = np.sqrt(covariance[0, 0])
    assert spreads["still"] < 0.2
    assert 1.0 < spreads["moving"] < 2.0  # a second at the speed of a wearer who walks on


@pytest.mark.parametrize("skipped_s", [0.8, 1.2, 1.6])
def test_an_image_puts_the_feet_together_that_began_apart(skipped_s: float) -> None:
    """The paper's walk from the middle of a swing on: its feet end as far apart as they do."""
    simulation = JaoSimulation(SteadyWalk(strides=6))
    rng = np.random.default_rng(3)
    imus, aids = simulation.inertial(rng)[0], simulation.aiding_measurements(rng)
    begin_ns = min(aid.t_ns for aid in aids) + round(1e9 * skipped_s)
    kept = {foot: block[block.t_ns >= begin_ns] for foot, block in imus.items()}
    paths = FootToFoot(simulation.rig).run(kept, [aid for aid in aids if aid.t_ns >= begin_ns])
    ends = {foot: path.trajectory.p_frame_in_world[-1] for foot, path in paths.items()}
    truth = {foot: -simulation.end_error(foot, np.zeros(3)) for foot in ends}
    apart, truly_apart = ends["l"] - ends["r"], truth["l"] - truth["r"]
    assert abs(np.linalg.norm(apart) - np.linalg.norm(truly_apart)) < 0.03
