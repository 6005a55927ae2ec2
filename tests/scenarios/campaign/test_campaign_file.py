"""Campaign files: what is wrong is named, nothing outside their folder is read, and YAML only says values."""

import shutil
from importlib.resources import files
from pathlib import Path

import pytest
from small_campaign import SHORT, SMALL, write

from stridetwin.scenarios.campaign.campaign_file import campaigns, find_campaign, load_campaign, read_campaign
from stridetwin.scenarios.campaign.extremes import check_extremes
from stridetwin.scenarios.campaign.named_files import copy_files
from stridetwin.scenarios.campaign.plan import Extra, plan_walks
from stridetwin.scenarios.scenario_file import CAMERAS, catalogue
from stridetwin.sim import parts
from stridetwin.streams.errors import StrideTwinError


def refused(path) -> str:
    with pytest.raises(StrideTwinError) as error:
        check_extremes(read_campaign(path), Extra())
    return str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("walks: 3", "", "small.yaml: walks: missing: expected a whole number"),
        ("walks: 3", "walks: 0", "small.yaml: walks: invalid 0: expected a whole number, 1-1000000"),
        ("seed: 3", "sed: 3", "invalid 'sed': expected keys campaign, walks, seed, "),
        ("seed: 3", "sampling: sobel", "sampling: invalid 'sobel': expected sobol, latin_hypercube (did you mean"),
        ("short.yaml", "demoo", "scenarios[0].scenario: invalid 'demoo': expected bystanders, "),
        ("short.yaml", "gone.yaml", "scenarios[0].scenario: invalid 'gone.yaml': expected an existing file"),
        (
            "gait.speed_mps",
            "gait.speed mps",
            "set.gait.speed mps: invalid 'gait.speed mps': expected keys with dots",
        ),
        (
            "[0.9, 1.2]",
            "[0.9, 3]",
            "set.gait.speed_mps: invalid 3.0: expected 0.05-2.1",
        ),
        (
            "gait.speed_mps",
            "gait.sped_mps",
            "set.gait.sped_mps: invalid 'sped_mps': expected keys pattern, speed_mps",
        ),
        (
            "terrain[0]",
            "terrain[3]",
            "scenarios[0].set.terrain[3].level.length_m: invalid 'terrain[3].level.length_m': expected "
            "terrain[0] to terrain[0]",
        ),
        ("part: MPU-9250", "part: MPU-9999", "set.sensors.foot_imu.part: invalid 'MPU-9999': expected "),
        ("[1.55, 1.8]", "[1.3, 1.8]", "people[0].height_m: invalid 1.3: expected 1.5-1.95"),
        ("sex: female", "sex: femal", "people[0].sex: invalid 'femal': expected male, female"),
        ("sex: female", "age: 30", "people[0]: invalid 'age': expected keys named, count, bmi, sex, height_m"),
        ("bmi: {normal: [24, 3], within: [19, 30]}", "bmi: 60", "people[0].bmi: invalid 60: expected 15-45"),
        (
            "bmi:",
            "mass_kg: 60\n    bmi:",
            "people[0].bmi: invalid 'normal 24 ± 3 within 19 to 30': expected ",
        ),
        (
            "gait.speed_mps",
            "'light,texture': 1\n  'light , texture': 2\n  gait.speed_mps",
            "set.light , texture: invalid 'light , texture': expected every place once",
        ),
        ("[0.9, 1.2]", "[90, 130]", "set.gait.speed_mps: invalid 'uniform 90 to 130': expected 0.05-2.1"),
        ("  gait.speed_mps", "  person.height_m", "set.person.height_m: invalid 'person.height_m': expected no per"),
        ("seed: 3", "splits: {shares: {train: 0.7}}", "splits.shares: invalid {'train': 0.7}: expected shares"),
        ("seed: 3", "splits: {shares: {../x: 1}}", "splits.shares: invalid '../x': expected names of lower-case"),
        ("seed: 3", "quality: {falls: drop}", "quality.falls: invalid 'drop': expected reject, keep"),
        ("seed: 3", "seed: 3\nseed: 4", "line 5: duplicate key 'seed'"),
        ("seed: 3", "seed: !!python/object/apply:os.getcwd []", "line 4: not YAML: could not determine a constructor"),
        ("seed: 3", "seed: 2020-01-01", "seed: invalid '2020-01-01': expected a whole number, 0-2147483648"),
    ],
)
def test_an_error_names_file_field_value_and_what_is_valid(tmp_path, old, new, message):
    assert old in SMALL
    assert message in refused(write(tmp_path, SMALL.replace(old, new)))


def test_an_error_in_the_scenario_itself_is_reported_as_one(tmp_path):
    message = refused(write(tmp_path, short=SHORT.replace("length_m: 2", "length_m: -2").replace("0.5", "0")))
    assert f"{tmp_path / 'short.yaml'}: terrain[0].level.length_m: invalid -2: expected" in message
    assert f"{tmp_path / 'short.yaml'}: gait.stand_s: invalid 0: expected" in message


@pytest.mark.parametrize("by_campaign", [True, False])
def test_errors_of_a_part_of_ones_own_name_its_path_and_all_keys(tmp_path, by_campaign):
    (tmp_path / "my").mkdir()
    (tmp_path / "my" / "imu.yaml").write_text("kind: sonar\ndescription: mine\n")
    text, short = SMALL, SHORT
    if by_campaign:
        text = SMALL.replace("  sensors.foot_imu.part: MPU-9250", "  sensors.sonar.part: my/imu.yaml")
    else:
        short = SHORT.replace("[foot_imu, insole]", "{sonar: my/imu.yaml}")
    message = refused(write(tmp_path, text, short))
    for key in ("rate_hz", "beam_deg", "range_max_m", "noise_mm"):
        assert f"{tmp_path / 'my' / 'imu.yaml'}: {key}: missing: expected " in message
    assert "parsed" not in message


@pytest.mark.parametrize("name", ["../outside.yaml", "{tmp}/outside.yaml", "link.yaml"])
def test_no_file_outside_of_the_campaigns_folder_is_read(tmp_path, name):
    outside = tmp_path / "outside.yaml"
    outside.write_text(SHORT)
    name = name.replace("{tmp}", str(tmp_path))
    home = tmp_path / "home"
    path = write(home, SMALL.replace("short.yaml", name))
    (home / "link.yaml").symlink_to(outside)
    assert "a file in the campaign's folder" in refused(path)
    path.write_text(SMALL.replace("MPU-9250", name))
    assert "a file in the campaign's folder" in refused(path)


def test_aliases_that_name_a_million_things_or_themselves_are_refused(tmp_path):
    levels = "".join(f"x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 10)}]\n" for i in range(1, 9))
    assert "up to 100000 values" in refused(write(tmp_path, f"x0: &x0 [1]\n{levels}{SMALL}"))
    assert "up to 100000 values" in refused(write(tmp_path, f"x: &x [*x]\n{SMALL}"))


def test_a_value_goes_to_all_of_its_places_and_short_forms_open(tmp_path):
    text = SMALL.replace("  gait.speed_mps:", "  'gait.gaze.yaw_deg, gait.gaze.pitch_deg':").replace(
        "[0.9, 1.2]", "[1, 9]"
    )
    walks = plan_walks(read_campaign(write(tmp_path, text)), Extra(off=CAMERAS, physics="dynamic"))
    for walk in walks:
        (angle,) = {v for name, v in walk.values.items() if name.startswith("gait")}
        assert walk.scenario["gait"]["gaze"] == {"yaw_deg": angle, "pitch_deg": angle}
        assert walk.scenario["physics"] == "dynamic"
        sensors = walk.scenario["sensors"]
        assert sensors["foot_imu"] == {"part": "MPU-9250"}
        assert {name for name, on in sensors.items() if on is False} >= {"foot_camera", "head_camera", "ahrs", "sonar"}
        assert sensors.get("insole", True) is True


def test_parts_of_ones_own_are_named_as_the_output_folder_has_them(tmp_path):
    path = write(tmp_path, SMALL.replace("MPU-9250", "{choice: [mine/a.yaml, MPU-9250]}"))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.yaml").write_text("kind: imu\ndescription: mine\nrate_hz: 100\n")
    campaign = read_campaign(path)
    assert campaign.user_files == {"mine/a.yaml": tmp_path / "mine" / "a.yaml"}
    named = {walk.scenario["sensors"]["foot_imu"]["part"] for walk in plan_walks(campaign, Extra())}
    assert named == {"../files/mine/a.yaml", "MPU-9250"}


STL = "solid x\nfacet normal 0 0 1\nouter loop\n" + 3 * "vertex 0 0 0\n" + "endloop\nendfacet\nendsolid\n"


@pytest.mark.parametrize("model", ["exo.xml", "exo.urdf"])
def test_an_exoskeleton_and_a_mesh_come_with_all_that_they_name(tmp_path, model):
    mine = tmp_path / "mine"
    (mine / "shapes").mkdir(parents=True)
    (mine / "exo.xml").write_text(
        '<mujoco><compiler meshdir="shapes"/><asset><mesh name="a" file="a.stl"/></asset><worldbody/></mujoco>'
    )
    (mine / "exo.urdf").write_text(
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="shapes/a.stl"/></geometry></visual></link>'
        "</robot>"
    )
    for name in ("shapes/a.stl", "ground.STL"):
        (mine / name).write_text(STL)
    (mine / "rig.yaml").write_text(
        "imus:\n  shank_l: {link: bar, part: own.yaml}\n  shank_r: {link: bar, part: MPU-9250}\n"
    )
    (mine / "own.yaml").write_text("kind: imu\ndescription: mine\nrate_hz: 100\n")
    (mine / "walk.yaml").write_text(
        f"description: mine\nterrain: {{mesh: ground.STL}}\nexo: {{model: {model}, rig: rig.yaml}}\n"
    )
    path = write(tmp_path, "campaign: mine\nwalks: 2\nscenarios: [mine/walk.yaml]\n")
    campaign = read_campaign(path)
    names = {f"mine/{model}", "mine/shapes/a.stl", "mine/rig.yaml", "mine/own.yaml", "mine/ground.STL"}
    assert campaign.user_files == {name: tmp_path / name for name in names}
    for walk in plan_walks(campaign, Extra()):
        assert walk.scenario["exo"] == {"model": f"../files/mine/{model}", "rig": "../files/mine/rig.yaml"}
        assert walk.scenario["terrain"] == {"mesh": "../files/mine/ground.STL"}
    copy_files(tmp_path / "out", campaign.user_files)
    for name in names:
        assert (tmp_path / "out" / "files" / name).read_bytes() == (tmp_path / name).read_bytes()
    (mine / model).write_text((mine / model).read_text().replace("a.stl", "../../../a.stl"))
    assert "../a.stl': expected a file in the campaign's folder" in refused(path)


def test_the_exoskeleton_of_the_examples_walks_in_campaigns(tmp_path):
    shutil.copytree(Path(__file__).parents[3] / "examples" / "own_exo", tmp_path / "own_exo")
    path = write(tmp_path, "campaign: mine\nwalks: 2\nscenarios: [own_exo/walk.yaml]\n")
    campaign = read_campaign(path)
    check_extremes(campaign, Extra())
    assert {"own_exo/my_exo.xml", "own_exo/my_exo.yaml"} <= campaign.user_files.keys()


def test_campaigns_are_distinguished_from_scenarios_by_their_keys(tmp_path):
    assert find_campaign("demo") is None
    assert find_campaign("stairs_and_ramps") == campaigns()["stairs_and_ramps"]
    path = write(tmp_path)
    assert find_campaign(str(path)) == path
    assert find_campaign(str(tmp_path / "short.yaml")) is None
    path.write_text(SMALL.replace("campaign:", "campain:"))
    assert "invalid 'campain': expected keys campaign" in refused(find_campaign(str(path)))
    assert not set(campaigns()) & set(catalogue())


@pytest.mark.parametrize("name", campaigns())
def test_every_campaign_of_the_catalogue_is_valid(name):
    campaign = load_campaign(name)
    check_extremes(campaign, Extra())
    walks = plan_walks(campaign, Extra())
    assert len({w.seed for w in walks}) == len({w.name for w in walks}) == campaign.walks


def test_the_example_of_the_documentation_is_valid(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "campaigns.md").read_text(encoding="utf-8")
    path = tmp_path / "mine.yaml"
    path.write_text(page.split("```yaml\n")[1].split("```")[0], encoding="utf-8")
    part = Path(str(files(parts))) / "MPU-9250.yaml"
    (tmp_path / "my_imu.yaml").write_bytes(part.read_bytes())
    campaign = read_campaign(path)
    check_extremes(campaign, Extra())
    walks = plan_walks(campaign, Extra())
    for walk in walks[:30]:
        imu = walk.scenario["sensors"]["foot_imu"]
        assert imu["position_mm"][:2] == [-30, 42]
        assert 55 <= imu["position_mm"][2] <= 65
        assert 2 <= walk.scenario["faults"][0]["at_s"] <= 6
    assert sum(w.base == "stair_up_down" for w in walks) == pytest.approx(750, abs=3)
    assert len({str(w.scenario["person"]) for w in walks}) == 22
