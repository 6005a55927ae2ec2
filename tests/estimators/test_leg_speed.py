"""Velocity of the back from the legs, on a short walk of the twin."""

from dataclasses import replace

import numpy as np
import pytest
from exo_walk import dropped, level_walk, turned
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain.speed import LegSpeeds
from stridetwin.streams.samples import Ahrs, Insole


def speeds(exo, samples):
    legs = LegSpeeds(exo)
    return [speed for s in samples if (speed := legs.update(s)) is not None]


@pytest.fixture(scope="module")
def walk():
    return level_walk()


@pytest.fixture(scope="module")
def measured(walk):
    exo, samples, _ = walk
    return speeds(exo, samples)


def test_the_way_that_it_adds_up_to_is_the_way_walked(walk, measured):
    """From the footprint before the walk to the last one the back goes as far as the feet."""
    _, _, footprints = walk
    t = np.array([s.t_ns for s in measured]) * 1e-9
    v = np.array([s.v_back_in_world for s in measured])
    way = 0.5 * ((v[1:] + v[:-1]) * np.diff(t)[:, None]).sum(axis=0)
    first, last = footprints[0].p_foot_in_world, footprints[-1].p_foot_in_world
    assert np.linalg.norm(way[:2]) == pytest.approx(np.linalg.norm((last - first)[:2]), abs=0.2)
    assert abs(way[2]) < 0.10
    assert np.diff(t).max() < 0.1  # a walker always has a foot on the ground


def test_standing_is_detected_and_walking_is_not(measured):
    resting = np.array([s.resting for s in measured])
    speed = np.array([np.linalg.norm(s.v_back_in_world) for s in measured])
    assert resting[:20].mean() > 0.8
    assert speed[resting].mean() < 0.06
    assert resting[speed > 0.5].mean() < 0.01


def test_a_world_with_another_heading_turns_the_velocity(walk, measured):
    exo, samples, _ = walk
    R = Rotation.from_euler("z", 1.0)
    other = speeds(exo, turned(samples, R))
    a, b = (np.array([s.v_back_in_world for s in x]) for x in (measured, other))
    assert b == pytest.approx(R.apply(a), abs=1e-6)


def test_feet_in_the_air_measure_nothing(walk):
    exo, samples, _ = walk
    assert not speeds(exo, [replace(s, force=np.zeros(4)) if isinstance(s, Insole) else s for s in samples])


def test_lost_and_corrupted_samples_leave_every_number_finite(walk, measured):
    exo, samples, _ = walk
    spoiled = [
        replace(s, angular_rate=np.full(3, np.nan)) if isinstance(s, Ahrs) and i % 7 == 0 else s
        for i, s in enumerate(dropped(samples, 0.1))
    ]
    v = np.array([s.v_back_in_world for s in speeds(exo, spoiled)])
    assert len(v) > 0.5 * len(measured)
    assert np.isfinite(v).all()
    assert np.abs(v).max() < 5.0
