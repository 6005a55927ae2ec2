"""Parts drawn from a population: within the class, one per walk, and unknown to estimators."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.population import POPULATIONS, draw_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.sensors.model import step_ends
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import ImuCalibration, Mount
from stridetwin.streams.samples import Array, Block

TOPIC = "/foot_l/imu"


def nominal_part() -> ImuPart:
    part = load_part("ADIS16485")
    assert isinstance(part, ImuPart)
    return part


def samples_of(seed: int, **options: object) -> tuple[Twin, Array]:
    """A short walk's rates and forces of the left foot, (N, 6)."""
    level = load_scenario("level_20m").config
    segments = (replace(level.route.segments[0], length_m=2.0),)
    config = replace(
        level,
        exo=None,
        route=replace(level.route, segments=segments),
        sensors=("foot_imu",),
        fittings={"foot_imu": SensorConfig(**options)},  # type: ignore[arg-type]
    )
    twin = Twin(config, seed)
    blocks = [b for chunk in twin.blocks() for b in chunk if isinstance(b, Block) and b.topic == TOPIC]
    columns = [np.hstack([b.columns["angular_rate"], b.columns["specific_force"]]) for b in blocks]
    return twin, np.concatenate(columns)


@settings(max_examples=30, deadline=None)
@given(name=st.sampled_from(sorted(POPULATIONS)), seed=st.integers(0, 999))
def test_figures_lie_within_those_of_the_members(name: str, seed: int) -> None:
    nominal, members = nominal_part(), [load_part(m) for m in POPULATIONS[name].members]
    drawn = draw_part(name, nominal, Noise.of_topic(seed, "test"))
    for triad in ("gyroscope", "accelerometer"):
        for figure in ("noise_density", "turn_on_bias", "scale_factor", "misalignment", "resolution", "delay_s"):
            value = getattr(getattr(drawn, triad), figure)
            values = [getattr(getattr(m, triad), figure) for m in members]
            assert min(values) * (1 - 1e-9) <= value <= max(values) * (1 + 1e-9)
        for figure in ("range", "bandwidth_hz"):
            assert getattr(getattr(drawn, triad), figure) == getattr(getattr(nominal, triad), figure)
    assert (drawn.rate_hz, drawn.name, drawn.description) == (nominal.rate_hz, nominal.name, nominal.description)


def test_a_walk_draws_one_part_and_walks_differ() -> None:
    drawn = [draw_part("consumer", nominal_part(), Noise.of_topic(seed, "#")) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
    delays = {draw_part("consumer", nominal_part(), Noise.of_topic(s, "#")).accelerometer.delay_s for s in range(40)}
    assert {0.0, 0.0025, 0.0125} <= delays


def test_estimators_get_the_nominal_part_and_the_motion_stays() -> None:
    (usual, plain), (drawn, changed) = samples_of(3), samples_of(3, population="consumer")
    assert repr(usual.rig) == repr(drawn.rig)
    assert np.abs(changed - plain).max() > 0.05
    np.testing.assert_array_equal(samples_of(3, population="consumer")[1], changed)
    np.testing.assert_array_equal(usual.reference.grid, drawn.reference.grid)


def test_an_ideal_part_has_no_errors_to_draw() -> None:
    np.testing.assert_array_equal(samples_of(3, ideal=True)[1], samples_of(3, ideal=True, population="consumer")[1])


def test_a_scenario_names_the_population(tmp_path: Path) -> None:
    file = tmp_path / "walk.yaml"
    text = (
        "description: d\nterrain: [{{level: {{length_m: 3}}}}]\nexo: none\nsensors: {{foot_imu: {{population: {}}}}}\n"
    )
    file.write_text(text.format("consumer"))
    assert load_scenario(file).config.fittings["foot_imu"].population == "consumer"
    file.write_text(text.format("cheap"))
    with pytest.raises(ConfigError, match="consumer"):
        load_scenario(file)


def test_a_bias_grows_as_the_part_warms_up() -> None:
    part = nominal_part()
    part = replace(part, rate_hz=10.0, gyroscope=replace(part.gyroscope, warm_up=0.1))
    t_ns = np.arange(1, 12001) * 100_000_000
    calibration = ImuCalibration(
        topic=TOPIC,
        part="",
        rate_hz=10.0,
        mount=Mount(body=""),
        gyroscope_noise_density=0.0,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=0.0,
        accelerometer_random_walk=0.0,
    )
    cold, warm = (ImuModel(calibration, p, Noise.of_topic(5, TOPIC)) for p in (nominal_at(10.0), part))
    ends = step_ends(10.0, warm.steps, t_ns) + round(warm.delay_s * 1e9)
    n = len(ends)
    still = Track(
        t_ns=ends,
        p_body_in_world=np.zeros((n, 3)),
        q_world_body=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        v_body_in_world=np.zeros((n, 3)),
        w_body=np.zeros((n, 3)),
    )
    grown = warm.read(still, t_ns).columns["angular_rate"] - cold.read(still, t_ns).columns["angular_rate"]
    final = grown[-1]
    assert np.abs(final).max() > 0.01
    k = 2999  # after one time constant
    np.testing.assert_allclose(grown[k] / final, (1 - np.exp(-1)) / (1 - np.exp(-4)), atol=0.02)


def nominal_at(rate_hz: float) -> ImuPart:
    return replace(nominal_part(), rate_hz=rate_hz)
