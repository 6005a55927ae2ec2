"""Functions of the package take names, strings and paths where these make sense, and name the type that they expect."""

from pathlib import Path

import numpy as np
import pytest
from fake_twin import FakeTwin

import stridetwin as st
from stridetwin.estimators.registry import names
from stridetwin.scenarios import record
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.streams.errors import ConfigError


@pytest.mark.parametrize("scenario", ["level_20m", Path("walk.yaml"), "walk.yaml", "scenario", "config"])
def test_a_twin_is_made_of_a_name_a_path_a_scenario_or_a_configuration(monkeypatch, tmp_path, scenario):
    monkeypatch.setattr(record, "twin_class", lambda: FakeTwin)
    monkeypatch.chdir(tmp_path)
    Path("walk.yaml").write_text("description: A walk.\nterrain: [{level: {length_m: 3}}]\n", encoding="utf-8")
    config = TwinConfig(name="walk", route=Route(segments=(Level(length_m=3.0),)))
    given = {"scenario": st.Scenario(description="", config=config), "config": config}.get(scenario, scenario)
    twin = st.make_twin(given)
    assert (twin.config.name, twin.seed) == ("level_20m" if scenario == "level_20m" else "walk", 0)
    st.record(twin, "walk.mcap")
    assert "/foot_l/imu" in st.Recording("walk.mcap").topics


@pytest.mark.parametrize("read", [st.read_scenario, st.load_scenario, st.load_campaign, st.make_twin])
def test_a_file_may_be_text_and_a_missing_one_is_named(read):
    for path in ("no.yaml", Path("no.yaml")):
        with pytest.raises(st.StrideTwinError, match=r"^no\.yaml: cannot be read: No such file"):
            read(path)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: st.make_twin(3), "scenario: invalid 'int': expected a Scenario, a TwinConfig, a name"),
        (lambda: st.record("level_20m", "x.mcap"), "record: twin: invalid 'str': expected a Twin"),
        (lambda: st.read_scenario(3), "path: invalid 'int': expected the path"),
        (lambda: st.check_recording("x.mcap"), "recording: invalid 'str': expected a Recording"),
        (lambda: st.all_paths("x.mcap"), "recording: invalid 'str': expected a Recording"),
        (lambda: st.evaluate("x.mcap", []), "recording: invalid 'str': expected a Recording"),
        (lambda: st.compare_scores("a.json", "b.json", st.Rules()), "now: invalid 'str': expected a ScoreTable"),
        (lambda: st.write_tum(np.zeros(3), "x.txt"), "trajectory: invalid 'ndarray': expected a Trajectory"),
    ],
)
def test_another_type_is_refused_in_one_line_that_names_the_expected_one(call, says):
    with pytest.raises(ConfigError, match=says) as refused:
        call()
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("name", names())
def test_an_estimator_refuses_a_recording_in_place_of_its_rig(name):
    with pytest.raises(ConfigError, match=r"rig: invalid 'str': expected a Rig, such as .*recording\.rig"):
        st.estimator(name)("walk.mcap")
