"""What the feet measure for a worn camera: a velocity in its world."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain.speed import LegSpeed
from stridetwin.estimators.dvio import Dvio, DvioParameters
from stridetwin.estimators.dvio.feet import Feet
from stridetwin.estimators.dvio.state import D_VELOCITY, FRAME
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Depth, Image, Imu, Insole
from tests.estimators.dvio.wall import Wall, rig, swaying

HEADING = 0.7


class Legs:
    """Legs that measure a motion's velocity with noise, in a world with another heading."""

    def __init__(self, speed: Callable[[float], np.ndarray], sd: float = 0.1) -> None:
        self._speed, self._sd, self._rng = speed, sd, np.random.default_rng(0)

    def update(self, sample):
        v = Rotation.from_euler("z", -HEADING).apply(self._speed(sample.t_ns * 1e-9))
        return LegSpeed(
            t_ns=sample.t_ns, v_back_in_world=v + self._sd * self._rng.normal(size=3), resting=bool(np.allclose(v, 0))
        )


def sample(t_ns: int) -> Insole:
    return Insole(topic="legs", t_ns=t_ns, force=np.zeros(4))


def feet_of(speed: Callable[[float], np.ndarray]) -> Feet:
    return Feet(["legs"], Legs(speed))


def walking(t):
    return np.array([1.2 * np.cos(0.3 * t), 1.2 * np.sin(0.3 * t), 0.1 * np.sin(10 * t)])


def test_the_heading_of_the_legs_is_found_from_how_both_move():
    feet = feet_of(walking)
    for t in np.arange(0.0, 4.0, 0.02):
        feet.take(sample(round(t * 1e9)))
        feet.compare(round(t * 1e9), walking(t))
    errors = []
    for t in np.arange(4.0, 5.0, 0.02):
        feet.take(sample(round(t * 1e9)))
        errors.append(feet.at(round(t * 1e9)).v_in_world - walking(t))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.1, abs=0.03)
    assert feet.at(round(6.0e9)) is None


def test_a_velocity_of_unknown_heading_is_none():
    feet = feet_of(walking)
    feet.take(sample(0))
    assert feet.at(0).v_in_world is None
    for t in np.arange(0.0, 3.0, 0.02):
        feet.take(sample(round(t * 1e9)))
        feet.compare(round(t * 1e9), np.array([np.cos(9 * t), np.sin(9 * t), 0.0]))  # what moves otherwise
    assert feet.at(round(2.98e9)).v_in_world is None


def test_feet_need_an_exoskeleton():
    with pytest.raises(ConfigError, match="exoskeleton"):
        Dvio(rig(), parameters=DvioParameters(feet=True))


def test_a_leg_velocity_is_a_measurement_of_the_newest_frame_and_goes_with_it():
    wall = Wall(swaying, 3.0, seed=3)
    odometry = Dvio(rig(), parameters=DvioParameters())
    for s in wall.samples():
        odometry.update(s)
    core = odometry._core
    slot = int(core.window.frames.count[0]) - 1
    before = copy.deepcopy(core.window.prior)
    core._set_leg_velocity(slot, core.window.frames.v[slot] + [0.3, 0.0, 0.0])
    at = core.window.shared + FRAME * slot + D_VELOCITY
    assert core.window.prior.b[at] == pytest.approx(0.3 / core.parameters.legs.speed_sd_mps**2)
    assert core.window.prior.H[at, at] == pytest.approx(core.parameters.legs.speed_sd_mps**-2)
    core._set_leg_velocity(slot, None)
    assert np.array_equal(core.window.prior.H, before.H)
    assert np.array_equal(core.window.prior.b, before.b)


def end_m(wall: Wall, dark_s: float, feet: bool, monkeypatch) -> float:
    """How far the end is off where neither camera nor depth measures anything from a time on."""

    def speed(t: float) -> np.ndarray:
        return (wall.pose(t + 1e-3)[1] - wall.pose(t - 1e-3)[1]) / 2e-3

    legs = feet_of(speed)
    monkeypatch.setattr(Feet, "of", lambda exo, parameters: exo)
    odometry = Dvio(rig(), parameters=DvioParameters(feet=feet), exoskeleton=legs)
    last = None
    for s in wall.samples():
        if feet and isinstance(s, Imu):
            odometry.update(sample(s.t_ns))
        if isinstance(s, Image) and s.t_ns > dark_s * 1e9:
            s = replace(s, pixels=np.zeros_like(s.pixels))
        elif isinstance(s, Depth) and s.t_ns > dark_s * 1e9:
            s = replace(s, depth=np.zeros_like(s.depth))
        last = odometry.update(s) or last
    assert last is not None
    assert last.health == "imu_only"
    return float(np.linalg.norm(last.T_world_imu[:3, 3] - wall.pose(last.t_ns * 1e-9)[1]))


def test_ten_seconds_in_the_dark_lead_less_astray_with_feet(monkeypatch):
    """Both read the same samples: each wall draws its noise anew, from the same seed. Not every walk is led better."""
    without, with_feet = (
        [end_m(Wall(swaying, 16.0, seed=seed), 6.0, feet, monkeypatch) for seed in (2, 8)] for feet in (False, True)
    )
    assert max(with_feet) < 0.4
    assert sum(with_feet) < 0.9 * sum(without)
