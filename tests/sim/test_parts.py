import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.sim.choices import part_files
from stridetwin.sim.parts.kinds import Gyroscope, ImuPart
from stridetwin.sim.parts.library import IDEAL, kind_of, load_part, make_ideal, read_part
from stridetwin.sim.parts.sensor_config import KIND, STANDARD, STANDARD_BACK_AHRS
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.yaml_file import read_yaml

GOOD = """kind: sonar
description: A sonar of mine
rate_hz: 20
beam_deg: {value: 30, source: "measured"}
range_max_m: 4
noise_mm: 3
"""


def written(folder, text):
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", part_files())
def test_every_figure_of_the_library_has_a_source(name):
    def sourced(node, at):
        for key, value in node.items():
            if key in ("kind", "description"):
                continue
            if set(value) == {"value", "source"}:
                assert len(value["source"]) > 5, f"{at}{key}"
            else:
                sourced(value, f"{at}{key}.")

    sourced(read_yaml(part_files()[name]), f"{name}: ")
    assert load_part(name).name == name


def test_every_group_has_a_standard_part_of_its_kind():
    assert set(STANDARD) == set(KIND)
    assert all(kind_of(load_part(name)) == KIND[group] for group, name in STANDARD.items())
    assert kind_of(load_part(STANDARD_BACK_AHRS)) == "ahrs"


def test_figures_come_in_si():
    imu = load_part("ADIS16485")
    assert isinstance(imu, ImuPart)
    assert imu.gyroscope.range == pytest.approx(math.radians(450))
    assert imu.gyroscope.noise_density == pytest.approx(math.radians(0.3) / 60)
    assert imu.accelerometer.noise_density == pytest.approx(0.023 / 60, rel=1e-3)
    assert imu.gyroscope.bias_instability == pytest.approx(math.radians(6.25) / 3600)
    assert load_part("AMT203").bits == 12
    assert load_part("SRF08").step == pytest.approx(0.043)


@pytest.mark.parametrize("name", part_files())
def test_an_ideal_twin_is_of_the_same_size_without_errors(name):
    real, twin = load_part(name), load_part(name + IDEAL)
    assert twin == make_ideal(real) == make_ideal(twin)
    assert (twin.name, twin.rate_hz, type(twin)) == (real.name, real.rate_hz, type(real))
    if isinstance(twin, ImuPart):
        own = dataclasses.asdict(twin.gyroscope)
        assert {k: v for k, v in own.items() if v} == {"range": math.inf, "bandwidth_hz": math.inf}


def test_a_part_of_ones_own_is_one_file(tmp_path):
    mine = read_part(written(tmp_path, GOOD))
    assert mine.beam == pytest.approx(math.radians(30))
    assert (mine.name, mine.step, mine.noise) == ("mine", 0.0, 0.003)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("noise_mm: 3", "noise_mm: -1"), ["mine.yaml: noise_mm: invalid -1", "0-1000"]),
        (("noise_mm: 3", "noise_mm: loud"), ["noise_mm: invalid 'loud'", "0-1000"]),
        (
            ("noise_mm: 3", "noise_m: 3"),
            ["mine.yaml: invalid 'noise_m'", "range_max_m", "mine.yaml: noise_mm: missing"],
        ),
        (("noise_mm: 3\n", ""), ["mine.yaml: noise_mm: missing", "missing: expected 0-1000"]),
        (("value: 30", "value: 300"), ["beam_deg: invalid 300", "1-170"]),
        (("source:", "origin:"), ["beam_deg: invalid 'origin'", "value, source"]),
        (("kind: sonar", "kind: radar"), ["mine.yaml: kind: invalid 'radar'", "imu, ahrs"]),
        (("description: A sonar of mine\n", ""), ["mine.yaml: description: missing", "text"]),
    ],
)
def test_an_invalid_part_is_reported_with_file_field_value_and_expected_values(tmp_path, change, words):
    assert change[0] in GOOD
    with pytest.raises(ConfigError) as raised:
        read_part(written(tmp_path, GOOD.replace(*change)))
    assert all(line.startswith(str(tmp_path)) for line in str(raised.value).splitlines())
    assert all(word in str(raised.value) for word in words), str(raised.value)


def test_a_missing_file_and_an_unknown_name_are_reported(tmp_path):
    with pytest.raises(StrideTwinError, match="cannot be read"):
        read_part(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="ADIS16485"):
        load_part("ADIS1648")


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_a_figure_is_within_its_bounds_or_refused(tmp_path_factory, value):
    path = tmp_path_factory.mktemp("parts") / "mine.yaml"
    path.write_text(GOOD.replace("range_max_m: 4", f"range_max_m: {value!r}"), encoding="utf-8")
    try:
        got = read_part(path).range_max
    except ConfigError as error:
        assert "range_max_m" in str(error)  # noqa: PT017 (both outcomes are checked)
    else:
        assert 0.1 <= got <= 50


def test_a_nested_figure_is_named_by_its_path(tmp_path):
    text = part_files()["MPU-9250"].read_text(encoding="utf-8").replace("range_dps", "range_deg")
    with pytest.raises(ConfigError, match=r"mine.yaml: gyroscope: invalid 'range_deg'"):
        read_part(written(tmp_path, text))
    assert {f.name for f in dataclasses.fields(Gyroscope)} > {"g_sensitivity"}
