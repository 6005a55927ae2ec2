"""The scale of the accelerometer from the size of gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.estimators.dvio import Dvio, DvioMethod, DvioParameters
from stridetwin.estimators.dvio.force_scale import estimate_scale_error
from stridetwin.streams.samples import Imu
from tests.estimators.dvio.test_dvio import errors
from tests.estimators.dvio.wall import Wall, rig, swaying


def test_a_small_excess_is_a_bias_and_a_large_one_a_scale():
    excess = np.linspace(0.0, 0.6, 61)
    error = np.array([estimate_scale_error(x, 9.81, 0.1, 0.0) for x in excess])
    first = int(np.flatnonzero(error)[0])
    assert 0.15 < excess[first] < 0.25  # two standard deviations of the bias
    assert (error[:first] == 0.0).all()
    # the expectation of the scale, given the bias' own spread: 0.03² / (0.03² + 0.0102²)
    np.testing.assert_allclose(error[first:], excess[first:] / 9.81 * 0.896, rtol=0.01)


@pytest.mark.parametrize("excess", [0.03, 0.3, 0.5])
def test_the_sign_of_the_excess_is_that_of_the_scale(excess):
    assert estimate_scale_error(-excess, 9.81, 0.1, 0.0) == -estimate_scale_error(excess, 9.81, 0.1, 0.0)


def test_a_part_of_uncertain_bias_or_scale_needs_a_larger_excess():
    assert estimate_scale_error(0.25, 9.81, 0.1, 0.0) > 0.0
    assert estimate_scale_error(0.25, 9.81, 0.2, 0.0) == 0.0
    assert estimate_scale_error(0.25, 9.81, 0.1, 0.02) == 0.0


@pytest.mark.parametrize("scale", [0.97, 1.03])
def test_a_force_that_is_three_per_cent_off_is_found_at_rest(scale):
    wall = Wall(swaying, 8.0, seed=8)
    samples = [replace(s, specific_force=s.specific_force * scale) if isinstance(s, Imu) else s for s in wall.samples()]
    off = {}
    for corrects in (True, False):
        calibration = "all" if corrects else "mount_and_clock"
        odometry = Dvio(rig(), parameters=DvioParameters(method=DvioMethod(calibration=calibration)))
        made = [e for s in samples if (e := odometry.update(s)) is not None]
        off[corrects] = float(np.abs(made[-1].accel_bias).max())
    assert off[True] < 0.5 * off[False]
    assert errors(wall, made).max() < 0.1
