"""The site of a walk: its normal gravity, which bodies, loads and inertial sensors obey alike."""

import math

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.scenarios.scenario_file import read_scenario
from stridetwin.sim.config import Level, Route, Site, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2, compute_normal_gravity


@pytest.mark.parametrize(
    ("latitude_deg", "height_m", "gravity_mps2"),
    [
        (0, 0, 9.7803253359),  # WGS 84, at the equator
        (90, 0, 9.8321849379),  # at the poles
        (-90, 0, 9.8321849379),
        (45, 0, 9.8061977694),
        (45, 1000, 9.8031129),
    ],
)
def test_normal_gravity_is_that_of_the_wgs_84(latitude_deg, height_m, gravity_mps2):
    assert compute_normal_gravity(math.radians(latitude_deg), height_m) == pytest.approx(gravity_mps2, abs=1e-7)


@given(latitude_deg=st.floats(-90, 90), height_m=st.floats(-500, 8990))
def test_gravity_grows_towards_the_poles_and_falls_with_the_height(latitude_deg, height_m):
    here = compute_normal_gravity(math.radians(latitude_deg), height_m)
    assert 9.75 < here < 9.834
    assert here == compute_normal_gravity(math.radians(-latitude_deg), height_m)
    # 0.3086 mGal for each m
    assert here - compute_normal_gravity(math.radians(latitude_deg), height_m + 10) == pytest.approx(3.086e-5, rel=0.01)
    nearer_pole = math.radians(min(abs(latitude_deg) + 1, 90))
    assert here <= compute_normal_gravity(nearer_pole, height_m) + 1e-12


def walk(site):
    config = TwinConfig(
        name="here",
        route=Route(segments=(Level(length_m=2.5),)),
        sensors=("foot_imu",),
        exo=None,
        ideal=True,
        site=site,
    )
    return Twin(config, 1)


def blocks_of(twin):
    return {block.topic: block for block in next(iter(twin.blocks()))}


def test_sensors_at_rest_and_loads_show_the_gravity_of_the_site():
    quito = Site(latitude_rad=math.radians(-0.2), height_m=2850)
    expected = compute_normal_gravity(quito.latitude_rad, quito.height_m)
    assert expected < NOMINAL_GRAVITY_MPS2 - 0.035
    twin, nominal = walk(quito), walk(None)
    assert (twin.model.opt.gravity == [0, 0, -expected]).all()
    assert (nominal.model.opt.gravity == [0, 0, -NOMINAL_GRAVITY_MPS2]).all()
    for walked, gravity_mps2 in ((twin, expected), (nominal, NOMINAL_GRAVITY_MPS2)):
        blocks = blocks_of(walked)
        force = blocks["/foot_l/imu"].columns["specific_force"][:40]
        np.testing.assert_allclose(np.linalg.norm(force, axis=1), gravity_mps2, atol=1e-3)
        ground = sum(blocks[f"/truth/foot_{s}/wrench"].columns["force_in_world"][:40, 2] for s in "lr")
        np.testing.assert_allclose(ground.mean(), walked.total_mass_kg * gravity_mps2, rtol=1e-3)


def test_a_scenario_names_its_site(tmp_path):
    def read(**keys):
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump({"description": "a walk", "terrain": [{"level": {"length_m": 3}}], **keys}))
        return read_scenario(path).config

    assert read().site is None
    assert read().gravity_mps2 == NOMINAL_GRAVITY_MPS2
    config = read(site={"latitude_deg": 78.2, "height_m": 20})
    assert config.site == Site(latitude_rad=math.radians(78.2), height_m=20.0)
    assert config.gravity_mps2 == pytest.approx(9.8298, abs=1e-3)
    with pytest.raises(ConfigError, match=r"site.latitude_deg: invalid 91.*-90"):
        read(site={"latitude_deg": 91})
    with pytest.raises(ConfigError, match=r"site.latitude_deg: missing"):
        read(site={"height_m": 100})
