"""The covariance of one strapdown step: what a change of the force adds to it."""

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.estimators.foot_ins import FootInsParameters, strapdown
from stridetwin.estimators.foot_ins.parameters import for_sensor
from stridetwin.estimators.foot_ins.state import D_VELOCITY, FILL, HEAD, initial_state
from tests.estimators.from_python import from_python

predict = from_python(strapdown.predict)
DT = 0.005
OLDEST, BEFORE, NEWEST = (0.0, 0.0, 9.8), (1.0, -2.0, 12.8), (1.5, -2.0, 11.8)


def velocity_variance(jerk_noise, filled):
    """(3,) of the velocity, m²/s², after one sample; the ring holds the last `filled` of the three forces."""
    parameters = replace(FootInsParameters(), accel_jerk_noise_s_rthz=jerk_noise)
    memory = initial_state()
    memory.ring[1:4, 3:] = OLDEST, BEFORE, NEWEST
    memory.clock[HEAD], memory.clock[FILL] = 3, filled
    predict(memory, for_sensor(parameters, None), (0.0, 0.0, 0.0), NEWEST, DT)
    return np.diag(memory.covariance)[D_VELOCITY : D_VELOCITY + 3]


@pytest.mark.parametrize("filled", [1, 2, 3])
def test_the_noise_of_a_changing_force_is_that_of_its_change_since_the_sample_before(filled):
    change = np.subtract(NEWEST, BEFORE)
    expected = 0.01**2 * (change @ change) / DT**2 * DT if filled > 1 else 0.0
    added = velocity_variance(0.01, filled) - velocity_variance(0.0, filled)
    np.testing.assert_allclose(added, expected, rtol=1e-9, atol=1e-15)
