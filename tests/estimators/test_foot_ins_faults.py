"""The one-foot filter under the faults that a walk can be given: it stays finite, and loses no more than it must."""

from __future__ import annotations

import numpy as np
import pytest
from foot_motion import ADIS16485, LEFT_FOOT, Walk, walk
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.estimators.foot_ins import FootIns, FootInsPath, StartPose
from stridetwin.sim.faults.faults import Fault, arrivals, plan_faults
from stridetwin.sim.faults.sample_faults import Dropout, Freeze, Late, Nan, OutOfOrder, Repeat, Saturation
from stridetwin.streams.recording.ros_samples import block_of
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu
from tests.estimators.imu_faults import IMU_FAULTS, TOPIC

WALK = walk(calibration=ADIS16485, rng=np.random.default_rng(1))


def under(truth: Walk, *faults: Fault, seed: int = 0) -> tuple[Block[Imu], FootInsPath]:
    """What arrives of a walk's samples, in the order of arrival, and the path that the filter makes of it."""
    rig = Rig(imus={TOPIC: ADIS16485})
    planned = plan_faults(faults, rig, seed, truth.t_ns[-1] * 1e-9)
    arrived = block_of([sample for a in arrivals([truth.imu], planned) for sample in a.item])
    start = StartPose(p_imu_in_world=truth.p_imu_in_world[0], q_world_imu=truth.q_world_imu[0])
    return arrived, FootIns(LEFT_FOOT, start=start).run(arrived)


def end_error(truth: Walk, path: FootInsPath) -> float:
    """Share of the way."""
    end = path.trajectory.p_frame_in_world[-1] - truth.p_imu_in_world[-1]
    return float(np.linalg.norm(end)) / truth.distance


# The share of the way that each may cost at the end: a 120 Hz filter that loses a tenth of a second of a swing has
# to guess how far the foot went in it.
@pytest.mark.parametrize(
    ("fault", "share"),
    [
        (Dropout(topic=TOPIC, rate_per_min=60, duration_s=0.02), 0.02),
        (Dropout(topic=TOPIC, rate_per_min=12, duration_s=0.1), 0.05),
        (Repeat(topic=TOPIC, rate_per_min=60, duration_s=0.2), 0.01),
        (Late(topic=TOPIC, rate_per_min=30, duration_s=0.5, delay_s=1.0), 0.01),
        (Nan(topic=TOPIC, rate_per_min=60, duration_s=0.02), 0.02),
        (Saturation(topic=TOPIC, at_s=0, fraction=1.0), 0.05),
        (Freeze(topic=TOPIC, rate_per_min=12, duration_s=0.03), 0.05),
    ],
    ids=lambda v: v.full_name if isinstance(v, Fault) else "",
)
def test_a_fault_costs_no_more_than_it_must(fault: Fault, share: float) -> None:
    _, path = under(WALK, fault)
    assert end_error(WALK, path) < share


def test_samples_that_come_twice_or_late_cost_nothing() -> None:
    plain = under(WALK)[1].trajectory.p_frame_in_world
    for fault in (Repeat(topic=TOPIC, at_s=0), Late(topic=TOPIC, rate_per_min=30, duration_s=0.5)):
        np.testing.assert_array_equal(under(WALK, fault)[1].trajectory.p_frame_in_world, plain)


def test_a_sample_that_was_overtaken_is_left_out() -> None:
    arrived, path = under(WALK, OutOfOrder(topic=TOPIC, at_s=5.0, duration_s=1.0))
    assert (np.diff(arrived.t_ns) < 0).sum() == 60
    assert len(path.trajectory) == len(arrived) - 60
    assert (np.diff(path.trajectory.t_ns) > 0).all()


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    faults=IMU_FAULTS,
)
def test_under_any_faults_the_estimate_is_finite_and_moves_on(seed: int, faults: list[Fault]) -> None:
    arrived, path = under(WALK, *faults, seed=seed)
    assert np.isfinite(path.trajectory.p_frame_in_world).all()
    assert np.isfinite(path.trajectory.q_world_frame).all()
    assert np.isfinite(path.trajectory.covariance).all()
    assert (np.diff(path.trajectory.t_ns) > 0).all()
    assert set(path.trajectory.t_ns.tolist()) <= set(arrived.t_ns.tolist())
