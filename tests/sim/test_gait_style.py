"""The level walk is a human one: curves within the norms, smooth loads, steps that grow with speed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import gait_norms
from stridetwin.sim.config import Level, Person
from stridetwin.sim.gait.foot_placement import level_step_length
from stridetwin.sim.gait.style import Style, level_style
from stridetwin.sim.kinematics.smooth import bump, soft_ease
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.body import fit_wearer


def level(speed_mps: float, person: Person) -> Twin:
    return gait_norms.walk((Level(length_m=8.0),), person, speed_mps, exo=False, simulated=False, seed=7)


@pytest.mark.parametrize("person", list(gait_norms.BODIES.values()), ids=list(gait_norms.BODIES))
def test_level_walk_is_human(person: Person) -> None:
    row = gait_norms.level_case(level(1.1, person), {}).figures
    for joint in gait_norms.ANGLES:
        assert row[f"{joint}_2sd_pct"] == 100.0, joint
        assert row[f"{joint}_1sd_pct"] >= 70.0, joint
    for key in ("peak1_bw", "valley_bw", "peak2_bw", "double_support_pct", "clearance_mm"):
        low, high = gait_norms.LEVEL_BANDS[key]
        assert low <= row[key] <= high, key


def test_planned_pressure_stays_on_what_touches_the_ground() -> None:
    """On the heel's edge while the toes are up, under the flat sole, ahead of the hinge while the heel is up."""
    twin = level(1.2, Person())
    plan, shoe = twin.reference, twin.size.shoe
    for k, side in enumerate("lr"):
        for step in plan.steps[side]:
            t = np.arange(max(step.t_touch, 0.0), min(step.t_off, plan.duration_s), 0.005)
            share, cop = plan.loads(t)[:, 4 * k], plan.loads(t)[:, 4 * k + 1 : 4 * k + 4]
            x, pitch = ((cop - step.p_foot_in_world) @ step.R_world_sole)[:, 0], plan.pitch(side, t)
            on = share > 0.05
            assert np.all(np.abs(x - shoe.heel_back_x)[on & (pitch < -5e-4)] < 0.006)
            assert np.all(x[on & (pitch > 5e-4)] > shoe.toe_hinge_x - 0.001)
            assert np.all((x[on] > shoe.heel_back_x - 0.003) & (x[on] < shoe.toe_tip_x))


def test_stance_is_exactly_flat_between_landing_and_heel_off() -> None:
    plan = level(1.2, Person()).reference
    for side in "lr":
        for step in plan.steps[side]:
            if np.isfinite(step.t_touch) and np.isfinite(step.t_off):
                t = np.linspace(step.t_touch, step.t_off, 400)
                assert (plan.pitch(side, t) == 0.0).mean() > 0.1


@given(st.floats(0.0, 1.0))
def test_style_goes_to_a_vector_and_back(pace: float) -> None:
    x = level_style(pace).to_vector()
    assert np.array_equal(Style.from_vector(x).to_vector(), x)


@given(st.floats(0.06, 2.0), st.floats(1.5, 1.95))
def test_faster_people_take_longer_and_quicker_steps(speed_mps: float, height_m: float) -> None:
    size = fit_wearer(Person(height_m=height_m))
    slow, fast = level_step_length(speed_mps, size), level_step_length(1.05 * speed_mps, size)
    assert fast > slow
    assert 1.05 * speed_mps / fast > speed_mps / slow


def test_soft_steps_rest_at_both_ends() -> None:
    s = np.linspace(0.0, 1.0, 2001)
    for curve, ends in ((soft_ease(s), (0.0, 1.0)), (bump(s), (0.0, 0.0))):
        assert (curve[0], curve[-1]) == pytest.approx(ends)
        second = np.diff(curve, n=2) * 2000**2
        assert abs(second[0]) < 0.05
        assert abs(second[-1]) < 0.05
    assert bump(np.array([0.5]))[0] == 1.0
