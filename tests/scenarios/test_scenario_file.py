import math
from pathlib import Path
from typing import Annotated

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from stridetwin.scenarios.scenario_file import SENSORS, catalogue, load_scenario, read_scenario
from stridetwin.sim.config import Exo, Gait, Gaze, Level, Ramp, Stairs, Thing, Turn
from stridetwin.sim.people import PEOPLE, Person
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.fields import MILLIMETRES, Number
from stridetwin.streams.validation import validate

GOOD = {
    "description": "a walk",
    "terrain": [
        {"level": {"length_m": 3}},
        {"stairs": {"risers": 4, "riser_mm": 165, "direction": "up"}},
        {"level": {"length_m": 3}},
    ],
}


def stairs(node):
    return node["terrain"][1]["stairs"]


def written(tmp_path, change=None, text=None):
    path = tmp_path / "mine.yaml"
    node = yaml.safe_load(yaml.safe_dump(GOOD))
    if change:
        change(node)
    path.write_text(yaml.safe_dump(node) if text is None else text)
    return path


@pytest.mark.parametrize("name", list(catalogue()))
def test_every_scenario_of_the_catalogue_loads(name):
    scenario = load_scenario(name)
    assert scenario.config.name == name
    assert scenario.description
    assert isinstance(scenario.config.route.segments[0], Level)


def test_the_catalogue_holds_the_terrains():
    assert {"level_20m", "stair_up_down", "ramp_up_down", "demo"} <= set(catalogue())
    kinds = {type(s) for s in load_scenario("demo").config.route.segments}
    assert kinds == {Level, Stairs, Ramp}


def test_turns_lanes_and_uneven_risers_are_read(tmp_path):
    def change(node):
        lanes = [[{"stairs": {"risers_mm": [150, 160], "direction": "up"}}], [{"level": {"length_m": 1}}]]
        node["terrain"][1:] = [
            {"lanes": {"walk": 1, "lanes": lanes}},
            {"level": {"length_m": 2, "cross_slope_deg": 0}},
            {"turn": {"angle_deg": -90, "radius_m": 0}},
            {"level": {"length_m": 2}},
        ]
        node["scenery"] = "room"

    route = read_scenario(written(tmp_path, change)).config.route
    lanes, turn = route.segments[1], route.segments[3]
    assert lanes.walk == 0
    assert lanes.lanes[0][0].heights_m == pytest.approx((0.15, 0.16))
    assert turn == Turn(angle_rad=-math.pi / 2, radius_m=0.0)
    assert route.scenery == "room"


def test_a_loop_of_the_catalogue_comes_back_to_its_start():
    layout = lay_out(load_scenario("jao_loop_126m").config.route)
    end = layout.profile[-1].s1 - 2.0
    assert end == pytest.approx(126.0, abs=0.5)
    assert layout.way.point(end) == pytest.approx([0.0, 0.0], abs=0.3)
    assert layout.profile[-1].z1 == pytest.approx(0.0, abs=1e-9)


def test_degrees_and_millimetres_become_radians_and_metres(tmp_path):
    def change(node):
        node["terrain"][1] = {"ramp": {"angle_deg": 9, "rise_m": 0.6, "direction": "down"}}
        node["gait"] = {"speed_mps": 1}
        node["sensors"] = ["foot_imu"]
        node["ideal_sensors"] = True

    config = read_scenario(written(tmp_path, change)).config
    ramp = config.route.segments[1]
    assert ramp.angle_rad == pytest.approx(math.radians(9))
    assert ramp.down
    assert config.gait.speed_mps == 1.0
    assert config.sensors == ("foot_imu",)
    assert config.ideal
    assert read_scenario(written(tmp_path)).config.route.segments[1].riser_m == pytest.approx(0.165)


def test_people_and_exoskeletons(tmp_path):
    def read(**keys):
        return read_scenario(written(tmp_path, lambda node: node.update(keys))).config

    assert read().exo == Exo()
    assert read(exo="none").exo is None
    assert read(exo={"mode": 1}).exo == Exo(mode=1)
    assert read(exo={"mode": 3, "joints": ["hip_r", "knee_r"]}).exo == Exo(mode=3, joints=("hip_r", "knee_r"))
    assert read(person="shim_s6").person == PEOPLE["shim_s6"]
    assert read(person={"height_m": 1.7, "shoe_mm": 265}).person.shoe_m == pytest.approx(0.265)


def test_patterns_and_manners_of_walking(tmp_path):
    def read(**keys):
        return read_scenario(written(tmp_path, lambda node: node.update(keys))).config

    assert read().gait == Gait()
    assert read(gait={"pattern": "jog"}).gait.speed_mps == 1.8
    assert read(gait={"pattern": "wander", "speed_mps": 0.4}).gait == Gait.of_pattern("wander", speed_mps=0.4)
    limp = read(gait={"asymmetry": -0.2, "shuffle": True, "stairs": "step_by_step", "leading_foot": "left"}).gait
    assert (limp.asymmetry, limp.shuffle, limp.stairs, limp.leading_foot) == (-0.2, 1.0, "step_by_step", "l")
    assert read(gait={"gaze": "terrain"}).gait.gaze == Gaze(kind="terrain")
    gaze = read(gait={"gaze": {"kind": "wandering", "yaw_deg": 10}}).gait.gaze
    assert gaze == Gaze(kind="wandering", yaw_rad=math.radians(10))
    route = read(texture="white", light=0.5, bystanders=2, things=[{"shadow": {"at_m": 0.5}}]).route
    assert (route.texture, route.light, route.bystanders) == ("white", 0.5, 2)
    assert route.things == (Thing(kind="shadow", at_m=0.5),)


@pytest.mark.parametrize(
    ("change", "where", "valid"),
    [
        (lambda n: n.update(person="shim_s8"), "person", "shim_s7"),
        (lambda n: n.update(person={"shoe_mm": 500}), "person.shoe_mm", "200-320"),
        (lambda n: n.update(exo="off"), "exo", "none, or keys mode, joints"),
        (lambda n: n.update(exo={"mode": 5}), "exo.mode", "0-4"),
        (lambda n: n.update(exo={"mode": 2, "joints": ["hip_l"]}), "exo.joints", "[hip_l, hip_r] or [knee_l, knee_r]"),
        (lambda n: n.update(exo={"mode": 4, "joints": ["ankle_l"]}), "exo.joints[0]", "hip_l, hip_r, knee_l, knee_r"),
        (lambda n: n.update(exo="none", sensors=["foot_imu", "ahrs"]), "sensors[1]", "foot_imu, foot_camera"),
        (lambda n: stairs(n).update(riser_mm=500), "terrain[1].stairs.riser_mm: invalid 500", "20-250"),
        (lambda n: stairs(n).update(risers=2.5), "terrain[1].stairs.risers: invalid 2.5", "1-60"),
        (lambda n: stairs(n).update(risers=True), "terrain[1].stairs.risers: invalid True", "whole number"),
        (lambda n: stairs(n).update(direction="upp"), "invalid 'upp'", "expected up, down (did you mean 'up'?)"),
        (lambda n: stairs(n).update(riser_m=0.1), "terrain[1].stairs: invalid 'riser_m'", "riser_mm"),
        (lambda n: stairs(n).update({"": 1}), "terrain[1].stairs: invalid ''", "keys risers, riser_mm"),
        (lambda n: stairs(n).pop("risers"), "terrain[1].stairs.risers: missing", "expected"),
        (lambda n: n["terrain"].insert(1, {"stair": {}}), "terrain[1]: invalid 'stair'", "did you mean 'stairs'?"),
        (lambda n: n["terrain"].insert(1, "level"), "terrain[1]: invalid 'level'", "one of the keys level, stairs"),
        (lambda n: n["terrain"].clear(), "terrain: invalid []", "at least one item"),
        (lambda n: n["terrain"].pop(), "terrain[1]: invalid 'stairs'", "level"),
        (lambda n: n["terrain"].insert(1, n["terrain"][1]), "terrain[2]: invalid 'stairs'", "a landing"),
        (lambda n: n.update(sensors=["foot_imv"]), "sensors[0]: invalid 'foot_imv'", "did you mean 'foot_imu'?"),
        (lambda n: n.update(sensors=["sonar", "sonar"]), "sensors[1]: invalid 'sonar'", "every name once"),
        (lambda n: n.update(sensors="sonar"), "sensors: invalid 'sonar'", "a list of foot_imu"),
        (lambda n: n.update(physics="ragdoll"), "physics: invalid 'ragdoll'", "expected kinematic, dynamic"),
        (lambda n: n.update(gait=5), "gait: invalid 5", "keys pattern, speed_mps"),
        (lambda n: n.update(gait={"pattern": "jogg"}), "gait.pattern: invalid 'jogg'", "walk, wander, jog"),
        (lambda n: n.update(gait={"stairs": "hop"}), "gait.stairs", "step_over_step, step_by_step"),
        (lambda n: n.update(gait={"leading_foot": "r"}), "gait.leading_foot", "left, right"),
        (lambda n: n.update(gait={"asymmetry": 1}), "gait.asymmetry: invalid 1", "-0.4 to 0.4"),
        (lambda n: n.update(gait={"shuffle": "much"}), "gait.shuffle", "0-1"),
        (lambda n: n.update(gait={"gaze": "down"}), "gait.gaze: invalid 'down'", "ahead, terrain, wandering"),
        (lambda n: n.update(gait={"gaze": {"yaw_deg": 90}}), "gait.gaze.yaw_deg: invalid 90", "-40 to 40"),
        (lambda n: n.update(bystanders=9), "bystanders: invalid 9", "0-4"),
        (lambda n: n.update(bystanders=1, width_m=1.2), "width_m: invalid 1.2", "at least 1.6 m"),
        (lambda n: n.update(texture="blue"), "texture: invalid 'blue'", "rich, plain, white"),
        (lambda n: n.update(light=9), "light: invalid 9", "0.2-1.4"),
        (lambda n: n.update(gait={"speed_mps": float("nan")}), "gait.speed_mps: invalid nan", "0.05-2.1"),
        (lambda n: n.update(dynamics={"assist": True}), "physics: invalid 'kinematic'", "dynamic, as the scenario has"),
        (
            lambda n: n.update(physics="dynamic", dynamics={"friction": 0.1}),
            "dynamics.friction: invalid 0.1",
            "0.2-1.5",
        ),
        (
            lambda n: n.update(physics="dynamic", dynamics={"pushes": [{"left_n": 50}]}),
            "dynamics.pushes[0].at_s: missing",
            "expected",
        ),
        (lambda n: n.update(ideal_sensors="yes"), "ideal_sensors: invalid 'yes'", "true, false"),
        (lambda n: n.update(description=" "), "description: invalid ' '", "text"),
        (lambda n: n.update(person={"sex": "m"}), "person.sex: invalid 'm'", "male, female"),
        (
            lambda n: n["terrain"].insert(1, {"stairs": {"risers_mm": [100, 500], "direction": "up"}}),
            "terrain[1].stairs.risers_mm[1]: invalid 500",
            "20-250",
        ),
        (
            lambda n: n["terrain"].insert(1, {"turn": {"angle_deg": 90, "radius_m": 0.3}}),
            "radius_m: invalid 0.3",
            "at least 1",
        ),
        (
            lambda n: n["terrain"].insert(1, {"turn": {"angle_deg": 90}}),
            "terrain[2]: invalid 'stairs'",
            "at least 0.5 m",
        ),
        (
            lambda n: n["terrain"].insert(1, {"ramp": {"angle_deg": 40, "rise_m": 1, "direction": "up"}}),
            "terrain[1].ramp.angle_deg: invalid 40",
            "1-20",
        ),
        (lambda n: stairs(n).update(tread_mm=120), "terrain[1].stairs.tread_mm: invalid 120", "200-600"),
        (lambda n: n.update(width_m=0.6), "width_m: invalid 0.6", "1.2-10"),
        (lambda n: n.update(scenery="forest"), "scenery: invalid 'forest'", "outdoor, room"),
        (
            lambda n: n["terrain"].insert(1, {"lanes": {"walk": 3, "lanes": [[{"level": {"length_m": 2}}]] * 2}}),
            "terrain[1].lanes.walk: invalid 3",
            "1-2",
        ),
        (
            lambda n: n["terrain"].insert(1, {"level": {"length_m": 2, "cross_slope_deg": 9}}),
            "terrain[1].level.cross_slope_deg: invalid 9",
            "-5 to 5",
        ),
        (
            lambda n: n["terrain"].append({"level": {"length_m": 2, "cross_slope_deg": 3}}),
            "terrain[3].level.cross_slope_deg: invalid 3.0",
            "0 (a walk ends on level ground)",
        ),
        (lambda n: stairs(n).update(turn_deg=300), "terrain[1].stairs.turn_deg: invalid 300", "-270 to 270"),
        (
            lambda n: stairs(n).update(risers=6, turn_deg=90),
            "width_m: invalid 2.4",
            "so that the treads of its winding stairs do not meet",
        ),
        (lambda n: n.update(terrian=1), "'terrian'", "did you mean 'terrain'?"),
    ],
)
def test_an_error_names_file_key_value_and_what_is_valid(tmp_path, change, where, valid):
    path = written(tmp_path, change)
    with pytest.raises(ConfigError) as error:
        read_scenario(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert where in message
    assert valid in message
    assert "\n" not in message


def test_all_errors_of_a_file_are_reported_at_once(tmp_path):
    def change(node):
        stairs(node).update(riser_mm=500, tread=300)
        node.update(gait={"speed_mps": "fast", "gaze": {"yaw_deg": 90}}, sensors={"sonar": {"rate_hz": 0}}, terrian=1)
        node["faults"] = [{"kind": "nan", "topic": "/foot_l/imu", "at_s": -1}, {"kind": "nam"}]
        del node["description"]

    path = written(tmp_path, change)
    with pytest.raises(ConfigError) as error:
        read_scenario(path)
    lines = str(error.value).splitlines()
    assert all(line.startswith(f"{path}: ") and len(line) < 600 for line in lines)
    wanted = (
        "terrain[1].stairs.riser_mm: invalid 500",
        "terrain[1].stairs: invalid 'tread'",
        "gait.speed_mps: invalid 'fast'",
        "gait.gaze.yaw_deg: invalid 90",
        "sensors.sonar.rate_hz: invalid 0",
        "faults[0].at_s: invalid -1",
        "faults[1].kind: invalid 'nam'",
        "invalid 'terrian'",
        "description: missing",
    )
    assert len(lines) == len(wanted)
    assert all(sum(line.startswith(f"{path}: {place}: expected") for line in lines) == 1 for place in wanted)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("description: a\ndescription: b\n", "line 2: duplicate key 'description'"),
        ("terrain: [\n", "line 2"),
        ("- 1\n", "keys description, terrain"),
        ("", "keys description, terrain"),
        ("a: !!python/object:os.system {}\n", "line 1"),
    ],
)
def test_broken_files_are_refused_in_one_line(tmp_path, text, words):
    with pytest.raises(StrideTwinError) as error:
        read_scenario(written(tmp_path, text=text))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_scenarios_are_refused_with_the_names_there_are(tmp_path):
    with pytest.raises(StrideTwinError, match=r"invalid scenario 'level_20'.*did you mean 'level_20m'\?"):
        load_scenario("level_20")
    with pytest.raises(StrideTwinError, match="cannot be read: No such file"):
        load_scenario(str(tmp_path / "none.yaml"))


@given(st.floats(allow_nan=True, allow_infinity=True) | st.integers() | st.none() | st.text() | st.booleans())
def test_numbers_outside_their_range_never_pass(value):
    kind = Annotated[Number, Field(ge=20, le=250), MILLIMETRES]
    try:
        got = validate(kind, value, "f")
    except ConfigError as error:
        assert "20-250" in str(error)  # noqa: PT017 (both outcomes are checked)
    else:
        assert 20 <= value <= 250
        assert not isinstance(value, bool)
        assert got == pytest.approx(value * 1e-3)


def test_an_optional_number_with_a_unit_may_be_null():
    assert validate(Person, {"shoe_mm": None}, "f").shoe_m is None
    assert validate(Person, {"shoe_mm": 260}, "f").shoe_m == pytest.approx(0.26)


def test_the_sensors_are_those_of_the_twin():
    assert "foot_imu" in SENSORS
    assert "head_camera" in SENSORS


def test_the_example_of_the_documentation_loads(tmp_path):
    page = Path(__file__).parents[2] / "docs" / "scenarios.md"
    example = page.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    config = read_scenario(written(tmp_path, text=example)).config
    assert len(config.route.segments) == 7
    assert config.rig_mount == "head"
