"""Steps measured by an exoskeleton's legs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode import LocomotionMode
from stridetwin.estimators.locomotion_mode.foothold import extrapolate_ground, measure_step, step_likelihood
from stridetwin.estimators.locomotion_mode.segments import Segment, mode_table
from stridetwin.streams.samples import Depth
from tests.estimators.locomotion_mode import walker
from tests.estimators.locomotion_mode.test_next_steps import P, S, foot_at, ground
from tests.estimators.terrain_map.scenes import RIG

WIDTH_M = 0.12


def step(k, place, height=0.0, mode="LG", *, before=0.0, turn=0.4):
    """Step k of somebody who walks at an angle through the legs' own world."""
    left = WIDTH_M / 2 * (1 if k % 2 else -1)
    along, aside = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    return StepEstimate(
        t_ns=0,
        step=k,
        foot="rl"[k % 2],
        slope=0.0,
        elevation=height - before,
        slope_sd=0.005,
        elevation_sd=0.005,
        normal=np.array([0.0, 0.0, 1.0]),
        p_sole_in_world=np.array([*(place * along + left * aside), height]),
        covariance=np.diag([1e-4, 1e-4, 1e-4]),
        mode=mode,
        probability=1.0,
    )


def test_a_step_is_as_long_as_it_goes_ahead_and_not_aside():
    made = measure_step([step(1, 0.0), step(2, 0.6), step(3, 1.2)])
    assert made is not None
    assert made.length == pytest.approx(0.6)
    assert made.length_sd == pytest.approx(0.01)


@pytest.mark.parametrize(
    "predicted",
    [
        [step(1, 0.0), step(2, 0.6)],
        [step(1, 0.0), step(2, 0.6), step(4, 1.8)],
        [step(1, 0.0), step(2, 0.6), replace(step(3, 1.2), elevation_sd=math.inf)],
    ],
)
def test_an_incomplete_step_is_no_measurement(predicted):
    assert measure_step(predicted) is None


def test_a_riser_under_the_feet_identifies_their_side_of_an_edge():
    """The foot was measured to rise by 15 cm: it stands beyond the edge, where the camera could not say."""
    made = measure_step([step(1, 0.0), step(2, 0.5), step(3, 0.9, 0.15, "SA")])
    assert made is not None
    stair = ground((2.0, 0.15))
    before, unsure = foot_at(1.62), np.exp(-0.5 * ((S - 2.0) / 0.05) ** 2)
    after = unsure * step_likelihood(made, S, stair, before)
    assert after[S > 2.0].sum() > 0.95 * after.sum()
    level = replace(made, elevation=0.0)
    after = unsure * step_likelihood(level, S, stair, before)
    assert after[S < 2.0].sum() > 0.95 * after.sum()


def test_unobserved_ground_continues_as_measured():
    up = measure_step([step(1, 0.0), step(2, 0.28, 0.15, "SA"), step(3, 0.56, 0.30, "SA", before=0.15)])
    assert up is not None
    stairs = extrapolate_ground(up, 1.0, P)
    assert [p.drop for p in stairs[1:]] == pytest.approx([0.15] * (len(stairs) - 1))
    assert np.diff([p.start for p in stairs[1:]]) == pytest.approx(0.28)
    assert mode_table(stairs, P)[0, 1].argmax() == 1
    ramp = extrapolate_ground(replace(up, mode="RD", slope=-0.2, elevation=-0.1), 1.0, P)
    assert len(ramp) == 1
    assert isinstance(ramp[0], Segment)
    assert (ramp[0].mode, ramp[0].slope) == ("RD", -0.2)


def test_in_the_dark_stairs_continue():
    """Without any depth, the next steps are predicted to climb once two treads were measured, and not before."""
    mode = LocomotionMode(RIG)
    prints, predicted = walker.footprints(), {}
    high = np.cumsum([walker.RISER * (m == "SA") for _, _, _, m in prints])
    felt_ns = [round(t * 1e9) + 250_000_000 for t, *_ in prints]
    for sample in walker.samples():
        while felt_ns and felt_ns[0] <= sample.t_ns:
            k = len(prints) - len(felt_ns)
            _, place, foot, kind = prints[k]
            before = high[k - 1] if k else 0.0
            estimate = mode.update(
                replace(step(k + 1, place, high[k], kind, before=before), foot=foot, t_ns=felt_ns.pop(0))
            )
            if estimate is not None:
                predicted[estimate.step] = estimate.steps[0].mode
        if isinstance(sample, Depth):
            sample = replace(sample, depth=np.zeros_like(sample.depth))
        estimate = mode.update(sample)
        if estimate is not None:
            predicted[estimate.step] = estimate.steps[0].mode
    by_step = [predicted[k] for k in range(1, len(prints))]  # of the step after k
    assert by_step[:5] == ["LG"] * 5
    assert by_step[7:9] == ["SA", "SA"]
