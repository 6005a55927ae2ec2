"""Every estimator of the project passes every check, and so do those of the example package."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from stridetwin.estimators import registry
from stridetwin.testing import conformance_cases
from stridetwin.testing.cases import CHECKS

OURS = ("foot_ins", "foot_to_foot", "contact_terrain", "dvio", "terrain_map", "locomotion_mode", "gait_phase")

sys.path.append(str(Path(__file__).parents[1] / "run" / "example_package"))
from stridetwin_example import GravityFoot  # noqa: E402
from stridetwin_example_ground import FlatGround, SteadySteps  # noqa: E402


def cases_of(estimator_class):
    """The checks of one estimator, named after both."""
    cases = conformance_cases(estimator_class)
    return [pytest.param(*case.values, id=f"{estimator_class.__name__}-{case.id}") for case in cases]


@pytest.mark.parametrize("case", [case for name in OURS for case in cases_of(registry.estimator(name))])
def test_our_estimator_conforms(case):
    case.run()


@pytest.mark.parametrize("case", [c for toy in (GravityFoot, FlatGround, SteadySteps) for c in cases_of(toy)])
def test_an_estimator_of_another_package_conforms(case):
    case.run()


def test_no_estimator_is_left_out():
    assert set(OURS) == set(registry.names())
    assert all(registry.estimator(name) for name in OURS)
    assert len(CHECKS) == len(conformance_cases(GravityFoot))
