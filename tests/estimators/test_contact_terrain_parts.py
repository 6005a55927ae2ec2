"""Parts of the ground below an exoskeleton's feet, each against plain arithmetic."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import footfall
from stridetwin.estimators.contact_terrain.footfall import CellLoads, Footfall, contact_point
from stridetwin.estimators.contact_terrain.offsets import OFFSETS
from stridetwin.estimators.contact_terrain.proposed import DoubleSupport, _normal


def test_the_load_is_above_the_least_of_the_last_strides():
    loads = CellLoads()
    at_rest, air = np.array([100.0, 50.0, 30.0, 20.0]), np.array([5.0, 7.0, 1.0, 20.0])
    for _ in range(3):
        np.testing.assert_array_equal(loads.update(at_rest, 0.1, 0.5), at_rest)  # nothing is known of an unloaded cell
    np.testing.assert_array_equal(loads.update(air, 2.0, 0.3), air)
    np.testing.assert_array_equal(loads.update(air + 1.0, 2.0, 0.3), air + 1.0)  # 0.6 s is no stride yet
    np.testing.assert_allclose(loads.update(at_rest, 2.0, 0.1), at_rest - air)
    np.testing.assert_allclose(loads.update(at_rest + 1.0, 0.1, 0.1), at_rest + 1.0 - air)
    assert loads.alive.tolist() == [True, True, False, False]
    # a foot that rotates no more than at rest takes no time of a stride, and its readings are no minimum
    np.testing.assert_allclose(loads.update(np.zeros(4), 1.0, 9.0), np.minimum(-air, 0.0), atol=1e-12)
    np.testing.assert_allclose(loads.update(at_rest, 0.1, 0.1), at_rest - air)
    # a foot in the air that has crept starts anew from its readings
    loads.update(np.full(4, 33.0), 0.1, 0.1)
    loads.empty()
    np.testing.assert_allclose(loads.update(np.full(4, 43.0), 0.1, 0.1), np.full(4, 10.0))


def test_a_cell_is_alive_by_loads_of_three_strides_and_not_longer():
    loads = CellLoads()
    low, high = np.array([0.0, 0.0, 100.0, 0.0]), np.array([41.0, 39.0, 100.0, 41.0])  # the third is stuck
    loads.update(high, 0.1, 0.1)
    for k in range(3):
        loads.update(low, 2.0, 0.7)
        assert loads.alive[0] == (k < 2), k
        assert not loads.alive[1:3].any()


def pitched(angle, turn=0.3):
    """A sole pitched nose up by an angle."""
    return (Rotation.from_euler("z", turn) * Rotation.from_euler("y", -angle)).as_matrix()


def test_a_footfall_is_the_weighted_mean_of_its_flat_attitudes():
    fall, expected, free_weight = Footfall(3, True), np.zeros((2, 3)), 0.0
    for angle, rate, alone, free in (
        (0.05, 0.0, True, True),
        (0.06, 0.2, True, True),
        (0.055, 0.1, False, True),
        (0.06, 0.0, True, False),
        (0.06, 0.59, False, False),
    ):
        R = pitched(angle)
        weight = (1.0 if alone else 0.05) / (1.0 + (rate / 0.2) ** 2)
        free_weight += weight if free else 0.0
        weight *= 1.0 if free else 0.02
        expected += weight * R.T[[0, 2]]
        assert fall.add(R, rate, True, alone, free)
        np.testing.assert_allclose([fall.forward, fall.up], expected, rtol=1e-12)
    assert fall.ticks == 5
    assert not fall.flat
    up = expected[1] / np.linalg.norm(expected[1])
    forward = expected[0] - (expected[0] @ up) * up
    forward /= np.linalg.norm(forward)
    np.testing.assert_allclose(fall.R_world_sole(), np.column_stack([forward, np.cross(up, forward), up]), atol=1e-12)
    assert fall.strained == pytest.approx(max(0.0, 1.0 - free_weight / 1.0))
    assert fall.weight == pytest.approx(np.linalg.norm(expected[1]), rel=1e-3)
    few = Footfall(1, False)
    assert few.strained == 1.0
    few.add(pitched(0.0), 0.4, True, True, True)
    assert few.strained == pytest.approx(0.8)


def test_a_foot_is_not_flat_unloaded_rotating_or_with_a_rising_heel():
    fall = Footfall(1, True)
    assert not fall.add(pitched(0.05), 0.0, False, True, True)
    assert not fall.add(pitched(0.05), 0.61, True, True, True)
    assert fall.add(pitched(0.05), 0.6, True, True, True)
    assert not fall.add(pitched(0.05 - math.radians(1.51)), 0.0, True, True, True)
    assert fall.add(pitched(0.05 - math.radians(1.49)), 0.0, True, True, True)
    assert not fall.add(pitched(0.05 - math.radians(1.51)), 0.0, True, True, True)  # still against the highest
    for _ in range(4):
        assert fall.flat == (fall.ticks >= 6)
        fall.add(pitched(0.05), 0.0, True, True, True)
    assert fall.flat


def test_the_axes_of_a_sole_from_sums_that_are_not_orthogonal():
    rng = np.random.default_rng(0)
    up, forward = 3.0 * rng.normal(size=3), rng.normal(size=3)
    R = footfall._rotation_from_axes(forward, up)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 2], up / np.linalg.norm(up))
    assert R[:, 0] @ forward > 0.0
    assert R[:, 1] @ forward == pytest.approx(0.0, abs=1e-12)


def test_the_fixed_contact_is_the_heels_edge_or_the_toe_hinge():
    sole = SimpleNamespace(heel_x=-0.05, hinge_x=0.15, hinge_z=0.02)
    np.testing.assert_array_equal(contact_point(sole, True), [-0.05, 0.0, 0.0])
    np.testing.assert_array_equal(contact_point(sole, False), [0.15, 0.0, 0.02])


def test_the_mean_of_double_support_and_its_spread():
    rng = np.random.default_rng(0)
    support = DoubleSupport()
    weights, vectors, J = rng.uniform(0.1, 1.0, 5), rng.normal(size=(5, 3)), rng.normal(size=(5, 3, OFFSETS))
    for k in range(5):
        support.add(weights[k], vectors[k], J[k], free=k != 2)
    share = weights / weights.sum()
    vector, slopes = support.mean()
    np.testing.assert_allclose(vector, share @ vectors)
    np.testing.assert_allclose(slopes, np.einsum("k,kij->ij", share, J))
    assert (support.weight, support.strained) == pytest.approx((weights.sum(), weights[2]))
    variance = share @ (vectors - share @ vectors) ** 2
    np.testing.assert_allclose(support.spread(), np.sqrt([variance[:2].mean()] * 2 + [variance[2]]))


@pytest.mark.parametrize("slope", [0.0, 0.2, -0.3])
def test_the_normal_of_the_ground_is_up_across_its_slope_and_keeps_the_soles_roll(slope):
    R = pitched(0.1)
    normal = _normal(R, slope)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    heading = R[:2, 0] / np.linalg.norm(R[:2, 0])
    uphill = np.array([*(math.cos(slope) * heading), math.sin(slope)])
    assert normal @ uphill == pytest.approx(0.0, abs=1e-12)
    assert normal @ R[:, 1] == pytest.approx(0.0, abs=1e-12)
    assert normal[2] > 0.9
