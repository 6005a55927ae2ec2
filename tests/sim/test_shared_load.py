"""How two feet share what a motion needs from the ground."""

from __future__ import annotations

import numpy as np

from stridetwin.sim.playback import split_wrench
from stridetwin.streams.algebra.arrays import cross
from stridetwin.streams.samples import Array

_WEIGHT_N = 700.0
_HIP_HEIGHT_M = 0.9


def _split(shares: Array, ahead_m: Array) -> tuple[Array, Array]:
    """Shares of the left foot and shift of the centres of pressure, m, (N,), for a zero-moment point off the plan.

    The left foot stands 0.6 m in front of the right one; the zero-moment point is `ahead_m` in front of the planned
    one.
    """
    n = len(shares)
    planned = {"l": np.tile([0.6, 0.1, 0.0], (n, 1)), "r": np.tile([0.0, -0.1, 0.0], (n, 1))}
    by_foot = {"l": shares, "r": 1.0 - shares}
    middle = sum(by_foot[foot][:, None] * planned[foot] for foot in planned)
    origin = np.tile([0.3, 0.0, _HIP_HEIGHT_M], (n, 1))
    force = np.tile([40.0, -15.0, _WEIGHT_N], (n, 1))
    torque = cross(middle + ahead_m[:, None] * np.array([1.0, 0.0, 0.0]) - origin, force)
    loads, left_force, left_torque = split_wrench(force, torque, origin, by_foot, planned, planned)
    assert np.abs(left_force).max() < 1e-9
    assert np.abs(left_torque).max() < 1e-9
    return loads["l"].force[:, 2] / _WEIGHT_N, (loads["l"].cop - planned["l"])[:, 0]


def test_load_moves_to_the_front_foot_before_a_centre_of_pressure_leaves_its_sole() -> None:
    shares, ahead = np.array([0.1, 0.3, 0.5, 0.7, 0.9]), np.full(5, 0.06)
    moved, shift = _split(shares, ahead)
    assert np.all(moved > shares)
    assert np.all(np.abs(shift) < 0.015)
    moved, shift = _split(shares, -ahead)
    assert np.all(moved < shares)
    assert np.all(np.abs(shift[1:-1]) < 0.015)


def test_a_foot_alone_bears_all_and_takes_the_whole_shift() -> None:
    moved, shift = _split(np.array([1.0, 0.0]), np.array([0.02, 0.02]))
    np.testing.assert_allclose(moved, [1.0, 0.0])
    np.testing.assert_allclose(shift, 0.02, atol=1e-12)


def test_no_foot_pulls_at_the_ground_and_shares_change_smoothly() -> None:
    shares = np.linspace(0.0, 1.0, 2001)
    for ahead_m in (-0.3, -0.05, 0.05, 0.3):
        moved, _ = _split(shares, np.full(2001, ahead_m))
        assert np.all((moved >= 0.0) & (moved <= 1.0))
        assert np.abs(np.diff(moved[20:-20])).max() < 0.01
