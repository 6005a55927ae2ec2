"""The sonar between the feet: what it predicts, and what it refuses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.estimators.foot_ins.sonar import FeetSonar, SonarParameters
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.rig import Mount, OtherSensor
from stridetwin.streams.samples import Array, Range

SRF08 = OtherSensor(
    topic="/foot_l/sonar", kind="range", part="Devantech SRF08", rate_hz=25.0, mount=Mount(body="foot_l"),
    parameters={"beam_rad": math.radians(60), "range_max_m": 6.0, "range_sd_m": 0.01},
)  # fmt: skip


def beside(x: float, y: float = 0.0) -> Array:
    """The other foot x away along the beam, its heel y beside it, pointing across the beam."""
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    T[:3, 3] = x, y, -0.04
    return T


def echo(distance: float) -> Range:
    return Range(topic="/foot_l/sonar", t_ns=40, distance=distance)


def test_the_range_is_that_of_the_nearest_point_of_the_shoe() -> None:
    found = FeetSonar(SRF08).measure(echo(0.2), beside(0.236, -0.06), 0.01)
    assert found is not None
    assert found.t_ns == 40
    assert found.innovation == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.H, [1.0, 0.0, 0.0], atol=1e-9)
    assert found.sd > 0.043 / math.sqrt(12)


@given(x=st.floats(0.15, 0.6), y=st.floats(-0.2, 0.05), z=st.floats(-0.1, 0.1))
def test_the_derivative_is_that_of_the_range(x: float, y: float, z: float) -> None:
    sonar = FeetSonar(SRF08, SonarParameters(gate=100.0))
    T = beside(x, y)
    T[2, 3] += z
    here = sonar.measure(echo(0.3), T, 0.01)
    for axis in range(3):
        there = T.copy()
        there[axis, 3] += 1e-6
        moved = sonar.measure(echo(0.3), there, 0.01)
        if here is not None and moved is not None:
            assert (here.innovation - moved.innovation) / 1e-6 == pytest.approx(here.H[axis], abs=1e-3)


@pytest.mark.parametrize("distance", [0.0, math.nan, math.inf, 0.05, 0.4])
def test_echoes_of_something_else_are_refused(distance: float) -> None:
    assert FeetSonar(SRF08).measure(echo(distance), beside(0.236, -0.06), 0.01) is None


def test_a_foot_outside_the_beam_is_not_heard() -> None:
    sonar = FeetSonar(SRF08, SonarParameters(gate=100.0))
    assert sonar.measure(echo(0.2), beside(-0.236, -0.06), 0.01) is None
    assert sonar.measure(echo(0.5), beside(0.2, 0.5), 0.01) is None
    assert sonar.measure(echo(0.5), np.full((4, 4), np.nan), 0.01) is None


def test_a_wider_gate_for_a_less_certain_filter() -> None:
    sonar = FeetSonar(SRF08)
    assert sonar.measure(echo(0.3), beside(0.236, -0.06), 0.0) is None
    assert sonar.measure(echo(0.3), beside(0.236, -0.06), 0.1) is not None


def test_bad_calibration_is_refused() -> None:
    with pytest.raises(StrideTwinError, match="beam_rad"):
        FeetSonar(OtherSensor(topic="/s", kind="range", part="", rate_hz=25.0, mount=Mount(body="foot_l")))
    with pytest.raises(ConfigError, match="step_m"):
        SonarParameters(step_m=-1.0)
