"""The vertical force of a recorded motion, and the times in which force plates hold all of it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.recorded_people import compare_force, vertical_force
from stridetwin.sim.motion.skeleton import Skeleton, lengths_of
from stridetwin.sim.people import Person

_PERSON = lengths_of(Person(height_m=1.75))


def test_force_of_a_body_that_bobs_is_gravity_and_acceleration() -> None:
    skeleton, dt = Skeleton.of(_PERSON), 0.01
    t = np.arange(200) * dt
    x = np.zeros((len(t), len(skeleton.layout.names)))
    x[:, 2] = 0.9 + 0.02 * np.sin(6.0 * t)
    force = vertical_force(skeleton, replace(_PERSON, mass_kg=60.0), x, dt)
    inner = slice(5, -5)
    np.testing.assert_allclose(force[inner], (1.0 - 0.02 * 36.0 * np.sin(6.0 * t) / 9.81)[inner], atol=2e-3)


def test_body_weight_is_fitted() -> None:
    motion = 1.0 + 0.3 * np.sin(np.linspace(0.0, 20.0, 500))
    weight, rms, r = compare_force(motion, 700.0 * motion)
    assert (weight, r) == (pytest.approx(700.0), pytest.approx(1.0))
    assert rms == pytest.approx(0.0, abs=1e-9)
