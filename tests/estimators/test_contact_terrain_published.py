"""The parts of the published method, each against what its equation says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.estimators.contact_terrain import TerrainSvm
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS
from stridetwin.estimators.contact_terrain.published import (
    Markers,
    Phase,
    Pivot,
    centre_of_pressure,
    foot_phase,
    pivot_foot,
    slope,
)
from stridetwin.streams.errors import StrideTwinError

PUBLISHED = DEFAULTS.published
CELLS = np.array([[0.0, 0.0], [0.125, 0.03], [0.14, -0.02], [0.2, -0.01]])
FF, HC, HO, FO = Phase.FOOT_FLAT, Phase.HEEL_CONTACT, Phase.HEEL_OFF, Phase.FOOT_OFF


def test_the_centre_of_pressure_is_the_weighted_mean_of_the_cells():
    assert centre_of_pressure(CELLS, np.array([100.0, 0, 0, 100]), PUBLISHED.pressing_n) == pytest.approx([0.1, -0.005])
    assert centre_of_pressure(CELLS, np.full(4, 3.0), PUBLISHED.pressing_n) is None


@pytest.mark.parametrize(
    ("x", "rate", "phase"), [(0.01, 2.0, HC), (0.01, 0.1, FF), (0.1, 2.0, FF), (0.18, 2.0, HO), (0.18, 0.1, FF)]
)
def test_phases_follow_centre_of_pressure_and_rate(x, rate, phase):
    assert foot_phase(CELLS, np.array([x, 0.0]), rate) is phase
    assert foot_phase(CELLS, None, rate) is FO


@pytest.mark.parametrize(
    ("phases", "load", "foot"),
    [
        ((FF, FO), (500, 0), 0),
        ((FO, HC), (0, 90), 1),
        ((FF, HO), (100, 600), 0),
        ((HC, FF), (700, 10), 1),
        ((FF, FF), (300, 400), 1),
        ((HC, HO), (400, 300), 0),
        ((FO, FO), (0, 0), 1),
    ],
)
def test_the_pivot_is_on_the_flat_foot_or_the_one_with_more_load(phases, load, foot):
    assert pivot_foot(phases, np.array(load, dtype=float), 1) == foot


def test_the_pivot_rests_while_the_body_moves_over_it_and_steps_to_the_other_foot():
    pivot, T = Pivot(), np.tile(np.eye(4), (2, 1, 1))
    contact = np.array([0.1, 0.0, 0.0])
    for x in np.linspace(0.0, -0.3, 7):
        T[0, 0, 3] = x
        pivot.move(0, [contact, None], np.eye(3), T)
    assert pivot.p_in_world == pytest.approx(np.zeros(3))
    T[1, :3, 3] = [0.3, -0.2, 0.16]
    pivot.move(1, [contact, contact], np.eye(3), T)
    assert pivot.p_in_world == pytest.approx([0.6, -0.2, 0.16])
    pivot.move(1, [None, contact + [0.02, 0, 0]], np.eye(3), T)
    assert pivot.p_in_world == pytest.approx([0.62, -0.2, 0.16])


@given(pitch=st.floats(-0.3, 0.3), turn=st.floats(-3.1, 3.1))
def test_markers_on_a_slope_give_its_plane(pitch, turn):
    forward = np.array([np.cos(turn) * np.cos(pitch), np.sin(turn) * np.cos(pitch), np.sin(pitch)])
    medial = np.array([-np.sin(turn), np.cos(turn), 0.0])
    markers = Markers()
    for s in np.linspace(0.0, 0.12, PUBLISHED.markers_min):
        assert markers.plane() is None
        markers.add(np.array([5.0, -3.0, 1.0]) + s * forward, medial)
    plane = markers.plane()
    assert slope(plane.normal, forward[:2]) == pytest.approx(pitch, abs=1e-6)
    assert plane.centre == pytest.approx(np.array([5.0, -3.0, 1.0]) + 0.06 * forward)


def test_a_machine_classifies_steps_and_refuses_to_learn_from_one_mode():
    rng = np.random.default_rng(0)
    means = {"LG": (0.0, 0.0), "SA": (0.0, 0.16), "SD": (0.0, -0.16), "RA": (0.12, 0.05), "RD": (-0.12, -0.05)}
    modes = np.repeat(list(means), 40)
    features = np.array([means[m] for m in modes]) + rng.normal(0, (0.01, 0.01), (len(modes), 2))
    machine = TerrainSvm(features[:, 0], features[:, 1], modes)
    assert [machine.classify(*means[m]) for m in means] == list(means)
    with pytest.raises(StrideTwinError, match="expected 2 or more"):
        TerrainSvm([0.0], [0.0], ["LG"])
