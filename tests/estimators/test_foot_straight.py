"""The gyro's bias, learnt on long straight ways."""

import numpy as np
import pytest

from stridetwin.estimators.foot_ins import state, straight
from stridetwin.estimators.foot_ins.parameters import FootInsParameters, for_sensor
from stridetwin.streams.samples import Array
from tests.estimators.from_python import from_python

PARAMETERS = for_sensor(FootInsParameters(), None)
SPEED_MPS, STRIDE_M = 1.2, 1.3
BIAS_SD_RADPS = 1e-3
learn_bias_on_straight_way = from_python(straight.learn_bias_on_straight_way)
fit_arc = from_python(straight._fit_arc)


def blank_foot() -> state.FilterState:
    """A foot at the origin, whose gyro has an unknown bias about the vertical."""
    memory = state.initial_state()
    row = state.D_GYRO_BIAS + 2
    memory.covariance[row, row] = BIAS_SD_RADPS**2
    return memory


def stand_at(memory: state.FilterState, x: float, y: float, seconds: float) -> None:
    """Lets the foot begin a stance at a place (m) in the plane of its estimated world."""
    memory.nominal[state.POSITION : state.POSITION + 2] = x, y
    learn_bias_on_straight_way(memory, PARAMETERS, round(seconds * 1e9))


def walk(memory: state.FilterState, way_m: float, bias: float = 0.0, curvature_per_m: float = 0.0) -> None:
    """Strides as a filter sees them whose gyro has a bias (rad/s): each correction of it turns the path so far, too."""
    place, stride_s = np.zeros(2), STRIDE_M / SPEED_MPS
    for stride in range(round(way_m / STRIDE_M)):
        stand_at(memory, float(place[0]), float(place[1]), 1.0 + stride * stride_s)
        error = bias - memory.nominal[state.GYRO_BIAS + 2]
        heading = error * (1.0 + (stride + 0.5) * stride_s) + curvature_per_m * (stride + 0.5) * STRIDE_M
        place = memory.nominal[:2] + STRIDE_M * np.array([np.cos(heading), np.sin(heading)])


def told_bias(memory: state.FilterState) -> float:
    return float(memory.straight[straight.USED_BIAS])


@pytest.mark.parametrize("bias", [-1e-3, 5e-4])
def test_a_straight_way_that_seems_bent_tells_the_bias(bias: float) -> None:
    memory = blank_foot()
    walk(memory, 40.0, bias)
    assert told_bias(memory) == pytest.approx(bias, rel=0.1)
    assert 0.4 < memory.nominal[state.GYRO_BIAS + 2] / bias <= 1.0
    row = state.D_GYRO_BIAS + 2
    assert 0.3 < np.sqrt(memory.covariance[row, row]) / BIAS_SD_RADPS < 0.9


@pytest.mark.parametrize("radius_m", [-60.0, 100.0])
def test_a_curve_tells_nothing(radius_m: float) -> None:
    memory = blank_foot()
    walk(memory, 40.0, curvature_per_m=1.0 / radius_m)
    assert abs(memory.nominal[state.GYRO_BIAS + 2]) < 0.05 * BIAS_SD_RADPS


@pytest.mark.parametrize("way_m", [5.0, 18.0])
def test_a_short_way_tells_nothing(way_m: float) -> None:
    memory = blank_foot()
    walk(memory, way_m, bias=1e-3)
    assert told_bias(memory) == 0.0
    assert memory.nominal[state.GYRO_BIAS + 2] == 0.0


def test_a_pause_and_a_turn_begin_a_new_way() -> None:
    memory = blank_foot()
    walk(memory, 16.0)
    assert memory.straight[straight.END] > 12.0
    x, seconds = memory.straight[straight.PLACE], memory.straight[straight.T_LAST]
    stand_at(memory, x + STRIDE_M, 0.0, seconds + 5.0)  # a stop of some seconds
    assert memory.straight[straight.STRIDES] == 0.0
    stand_at(memory, x + 2.0 * STRIDE_M, 0.0, seconds + 6.1)
    stand_at(memory, x + 2.0 * STRIDE_M, STRIDE_M, seconds + 7.2)  # a quarter turn
    assert memory.straight[straight.STRIDES] == 0.0


def test_the_arc_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(1)
    memory = blank_foot()
    s = np.sort(rng.uniform(0.0, 50.0, 30))
    offsets: Array = 0.1 + 0.02 * s - 3e-4 * s**2 + 0.02 * rng.standard_normal(30)
    for i in range(5):
        memory.straight[straight.POWERS + i] = (s**i).sum()
    for i in range(3):
        memory.straight[straight.OFFSETS + i] = (offsets * s**i).sum()
    memory.straight[straight.SQUARES] = (offsets**2).sum()
    level, slope, bend, scatter2 = fit_arc(memory)
    coefficients = np.polyfit(s, offsets, 2)
    np.testing.assert_allclose([bend, slope, level], coefficients, rtol=1e-6, atol=1e-9)
    assert scatter2 == pytest.approx(((offsets - np.polyval(coefficients, s)) ** 2).mean(), rel=1e-5)
