import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from stridetwin.cli.main import main
from stridetwin.scenarios.campaign.named_files import SCENARIOS, copy_files
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.streams.errors import FieldLocation, StrideTwinError
from stridetwin.studies.placement.free import Knob
from stridetwin.studies.placement.problem_file import Place, check_ends, problems, read_problem, scenario_at

GOOD = {
    "placement": "An IMU on the shoe",
    "scenarios": ["level_20m"],
    "free": {"sensors.foot_imu.part": {"choice": ["ADIS16485", "MPU-9250"]}},
    "scores": ["weight_g"],
}


NUMBER = {"gait.speed_mps": {"between": [0.8, 1.2]}}
CHOICES = {"sensors.foot_imu.part": {"choice": ["ADIS16485", "MPU-9250"]}, "sensors.sonar": {"choice": [True, False]}}


def written(tmp_path, **changes):
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in (GOOD | changes).items() if v is not None}), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", problems())
def test_every_placement_of_the_catalogue_is_valid_at_all_its_ends(name, tmp_path):
    problem = read_problem(problems()[name])
    check_ends(problem, tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"placement": None}, "placement: missing: expected text"),
        ({"scores": ["visibility"]}, r"scores\[0\]: invalid 'visibility'.*did you mean 'visibility_pct'"),
        ({"scores": ["weight_g", "weight_g"]}, r"scores\[1\]: invalid 'weight_g'.*every score once"),
        ({"scores": [{"score": "weight_g", "weight": 0}]}, "at least one score with a weight above 0"),
        ({"free": {"sensors.foot_imu.position_mm[0]": {"between": [5, 1]}}}, "two numbers, the lower one first"),
        ({"free": {"gait.speed_mps": {"between": [1.0, 1.2]}}}, "a step, as the method is sweep"),
        ({"free": {"sensors.foot_imu.position_mm": {"over": "knee"}}}, r"\.over: invalid 'knee'.*shoe, head, chest"),
        ({"free": {"a b": {"choice": [1, 2]}}}, "keys with dots between"),
        ({"free": {"sensors.foot_imu.part": {"choice": ["../x.yaml", "D455"]}}}, "a file in the placement's folder"),
        ({"scenarios": ["../level.yaml"]}, "a file in the placement's folder"),
        ({"set": {"gait.speed_mps": {"uniform": [1, 2]}}}, r"set\.gait\.speed_mps.*free variables belong in free"),
        ({"method": {"optimise": {"budget": 10}}}, "sweep, as all free variables are choices"),
        (
            {"method": {"optimise": {"budget": 1, "starts": 2}}, "free": NUMBER},
            r"method\.optimise\.budget: invalid 1: expected 2 or more",
        ),
        (
            {"method": {"optimise": {"budget": 3}}, "free": NUMBER | CHOICES},
            r"budget: invalid 3: expected 4 or more \(4 combinations of choices, 3 starts\)",
        ),
        ({"free": {"light,texture": {"choice": [1, 2]}, "light, texture": {"choice": [1, 2]}}}, "every field once"),
        ({"seeds": [1, 1]}, "every seed once"),
        ({"output": "/tmp"}, "'output'.*keys placement"),
    ],
)
def test_an_error_names_file_field_value_and_what_is_valid(tmp_path, changes, message):
    path = written(tmp_path, **changes)
    with pytest.raises(StrideTwinError, match=message) as error:
        read_problem(path)
    assert str(path) in str(error.value)


def test_invalid_values_are_refused_before_the_first_walk(tmp_path):
    free = {"sensors.foot_imu.position_mm[0]": {"between": [-400, 0], "step": 100}}
    place = {"sensors.foot_imu.position_mm": [0, 40, 60]}
    problem = read_problem(written(tmp_path, free=free, set=place))
    with pytest.raises(
        StrideTwinError, match=r"free\.sensors\.foot_imu\.position_mm\[0\]: invalid -400.*level_20m.*-300 to 300"
    ):
        check_ends(problem, tmp_path)
    surface = {
        "sensors.foot_imu.position_mm": {"over": "shoe", "around_deg": {"between": [0, 90], "step": 90}, "up_mm": 190}
    }
    with pytest.raises(StrideTwinError, match="no surface at a height of 190 mm"):
        check_ends(read_problem(written(tmp_path, free=surface)), tmp_path)
    misspelt = {"sensors.foot_imu.position_m": surface["sensors.foot_imu.position_mm"] | {"up_mm": 60}}
    said = r"free\.sensors\.foot_imu\.position_m\.around_deg: invalid 'position_m': .* mean 'position_mm'\?"
    with pytest.raises(StrideTwinError, match=said):
        check_ends(read_problem(written(tmp_path, free=misspelt)), tmp_path)


@pytest.mark.parametrize(
    ("path", "standard", "value", "changed"),
    [
        ("foot_imu.position_mm[2]", "/foot_l/imu", 70, [-30, 42, 70]),
        ("foot_camera.mount.position_mm[0]", "/foot_l/camera", -60, [-60, -45, 36]),
        ("head_camera.mount.position_mm[2]", "/head/color", 90, [100, 0, 90]),
    ],
)
def test_one_coordinate_leaves_the_others_at_their_standard(tmp_path, path, standard, value, changed):
    free = {f"sensors.{path}": {"between": [value - 10, value], "step": 10}}
    problem = read_problem(written(tmp_path, free=free, set={}))
    check_ends(problem, tmp_path)
    place = Place(values={problem.knobs[0].name: float(value)})
    mounts = []
    for chosen in (place, Place()):
        rig = sensor_rig(scenario_at(problem, problem.bases[0], chosen, tmp_path).config).rig
        mounts.append({**rig.imus, **rig.cameras}[standard].mount.T_body_sensor)
    np.testing.assert_allclose(1e3 * mounts[0][:3, 3], changed, atol=1e-6)
    np.testing.assert_allclose(mounts[0][:3, :3], mounts[1][:3, :3], atol=1e-6)


def test_a_point_on_the_shoe_is_outside_of_it_by_what_is_asked(tmp_path):
    on = {"over": "shoe", "around_deg": {"between": [90, 180], "step": 90}, "up_mm": 50, "off_mm": 10}
    problem = read_problem(written(tmp_path, free={"sensors.foot_imu.position_mm": on}))
    knob = problem.knobs[0].name
    found = {}
    for angle in (90.0, 180.0):
        config = scenario_at(problem, problem.bases[0], Place(values={knob: angle}), tmp_path).config
        found[angle] = 1e3 * sensor_rig(config).rig.imus["/foot_l/imu"].mount.T_body_sensor[:3, 3]
    assert found[180.0] == pytest.approx([-52.0, 0.0, 50.0], abs=0.5)  # heel of 42 mm
    assert found[90.0] == pytest.approx([0.0, 44.0, 50.0], abs=3.0)  # outer side, 34 mm


def test_a_chosen_number_has_six_digits_and_lies_within_its_bounds_however_small_they_are():
    at = FieldLocation(source="test")
    small = Knob(name="x", low=0.0002, high=0.0006, step=0.0002, at=at)
    assert small.grid == [0.0002, 0.0004, 0.0006]
    assert small.middle == 0.0004
    free = Knob(name="x", low=0.00021234567, high=0.00061234567, at=at)
    assert [free.at_share(u) for u in (0.0, 0.5, 1.0)] == [0.000212346, 0.000412346, 0.00061234567]
    assert str(Knob(name="x", low=-1.0, high=1.0, at=at).at_share(0.5)) == "0.0"


@pytest.mark.parametrize(
    ("changes", "words", "message"),
    [
        ({}, ["--budget", "3"], "--budget: invalid 3: expected no --budget, as problem only sweeps"),
        (
            {"method": {"optimise": {"budget": 9}}, "free": NUMBER | CHOICES},
            ["--budget", "3"],
            "command line: --budget: invalid 3: expected 4 or more",
        ),
        ({}, ["--scenario", "../mine.yaml"], "--scenario: invalid '../mine.yaml': expected a file in the working f"),
    ],
)
def test_what_the_command_line_says_in_its_place_is_checked_too(tmp_path, monkeypatch, capsys, changes, words, message):
    (tmp_path / "here").mkdir()
    (tmp_path / "mine.yaml").write_text("description: mine")
    monkeypatch.chdir(tmp_path / "here")
    assert main(["place", str(written(tmp_path, **changes)), *words, "-o", "out"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "here" / "out").exists()


def test_the_file_on_the_page_can_be_walked_as_it_stands(tmp_path):
    root = Path(__file__).parents[3]
    page = (root / "docs/placement.md").read_text(encoding="utf-8")
    (tmp_path / "p.yaml").write_text(re.search(r"```yaml\n(placement:.*?)```", page, re.DOTALL)[1], encoding="utf-8")
    (tmp_path / "mine.yaml").write_text("description: mine\nterrain: [{level: {length_m: 3}}]\n", encoding="utf-8")
    shutil.copy(root / "sim/parts/MPU-9250.yaml", tmp_path / "my_imu.yaml")
    problem, out = read_problem(tmp_path / "p.yaml"), tmp_path / "out"
    (out / SCENARIOS).mkdir(parents=True)
    copy_files(out, problem.user_files)
    check_ends(problem, out)
    assert [path.name for path in problem.user_files.values()] == ["my_imu.yaml"]
    assert [base.name for base in problem.bases] == ["level_20m", "mine"]
