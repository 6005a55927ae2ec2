"""Study files: errors at their place, equal bytes for any number of workers and after an interruption, and the page."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from stridetwin.batch.run import ROWS
from stridetwin.cli.main import main
from stridetwin.scenarios.campaign.named_files import copy_files
from stridetwin.sim.people import PEOPLE
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies.design import make_scenario
from stridetwin.studies.study_file.results import collect_result, csv_text, table_rows
from stridetwin.studies.study_file.run import STUDY_FILES, StudyOptions, run_study
from stridetwin.studies.study_file.study import read_study

ROOT = Path(__file__).parents[2]
STEPS = {"description": "a few steps", "terrain": [{"level": {"length_m": 1}}], "gait": {"stand_s": 1}}
DROPOUT = {"kind": "dropout", "topic": "/foot_*/imu", "at_s": 2, "duration_s": 0.3}
STUDY = {
    "study": "A few steps",
    "scenarios": ["steps.yaml"],
    "seeds": [3, 5],
    "set": {"sensors": ["foot_imu"]},
    "faults": {"none": [], "lost samples": [DROPOUT]},
    "methods": {
        "usual": {"estimator": "foot_ins"},
        "same": {"estimator": "foot_ins", "parameters": {"lever_arm_m": 0.072}},
        "phase": {"estimator": "gait_phase"},
    },
    "scores": ["end_error_m", "rmse_pct"],
}


def write_study(folder, **changes):
    (folder / "steps.yaml").write_text(yaml.safe_dump(STEPS), encoding="utf-8")
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(STUDY | changes, sort_keys=False), encoding="utf-8")
    return path


def silent(stage, share):
    """Nobody listens."""


def method(**said):
    return {"methods": {"mine": {"estimator": "foot_ins"} | said}, "scores": ["end_error_m"]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metods": {}}, r"study.yaml: invalid 'metods': expected keys .*did you mean 'methods'"),
        (method(estimator="foot_inz"), r"methods.mine.estimator: invalid 'foot_inz': expected .*mean 'foot_ins'"),
        (method(method="zupt"), "methods.mine.method: invalid 'zupt': expected proposed"),
        (
            method(parameters={"lever_m": 1}),
            r"methods.mine.parameters.lever_m: invalid 'lever_m': expected gravity_mps2, .*did you mean 'lever_",
        ),
        (method(parameters={"lever_arm_m": "long"}), r"parameters.lever_arm_m: invalid 'long': expected a number"),
        (method(parameters={"gravity_mps2": -1}), r"parameters.gravity_mps2: invalid -1.*: expected a finite number"),
        (
            method(estimator="foot_to_foot", parameters={"foot.lever": 1}),
            r"parameters.foot.lever: invalid 'lever': expected gravity_mps2",
        ),
        ({"scores": ["end_error"]}, r"scores\[0\]: invalid 'end_error': expected .*did you mean 'end_error_m'"),
        ({"vary": {"IMU": {"x": {"sensors.foot_imu.prat": 1}}}}, r"vary.IMU.x.sensors.foot_imu.prat: invalid 'prat'"),
        ({"vary": {"IMU": {"x": {"gait.speed_mps": 99}}}}, r"vary.IMU.x.gait.speed_mps: invalid 99: expected "),
        ({"vary": {"method": {"x": {}}}}, "vary: invalid 'method': expected a name other than scenario, "),
        ({"faults": {"lost": [{"kind": "dropuot"}]}}, r"faults.lost\[0\].kind: invalid 'dropuot'"),
        ({"faults": {"lost": [DROPOUT | {"topic": "/hat"}]}}, r"faults.lost\[0\].topic: invalid '/hat'"),
        (
            method(estimator="terrain_map") | {"scores": ["nis_x"]},
            "methods.mine.estimator: invalid 'terrain_map': expected an estimator that a combination feeds",
        ),
    ],
)
def test_an_error_names_its_place_in_the_file(tmp_path, changes, message):
    with pytest.raises(StrideTwinError, match=message):
        run_study(read_study(write_study(tmp_path, **changes)), StudyOptions(folder=tmp_path / "out"), silent)
    assert not (tmp_path / "out").exists()


def test_a_study_gives_the_same_bytes_on_two_workers_and_after_an_interruption(tmp_path, capsys):
    path = write_study(tmp_path)
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["experiment", str(path), "-o", str(one)]) == 0
    printed = capsys.readouterr().out
    assert "2 walks are too few" in printed
    result = json.loads((one / "study.json").read_text(encoding="utf-8"))
    assert result["failed"] == []
    usual, same, phase = result["table"][:3]
    assert usual["scores"] == same["scores"]  # fed sample by sample, with a parameter that is the estimator's own
    assert 0 < usual["scores"]["end_error_m"]["mean"] < 0.2
    assert list(phase["scores"]) == ["rmse_pct"]
    assert result["table"][3]["levels"] == {"faults": "lost samples"}
    assert result["table"][3]["scores"] != usual["scores"]
    rows = list(csv.DictReader((one / "study.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 2 * 2 * 3 * 2
    assert rows[0].keys() == {"faults", "seed", "method", "score", "value"}
    html = (one / "study.html").read_text(encoding="utf-8")
    assert html.count('<div class="plot"') == 2
    assert "stridetwin experiment study.yaml" in html

    lines = (one / ROWS).read_text(encoding="utf-8").splitlines(keepends=True)
    two.mkdir()
    (two / ROWS).write_text("".join(lines[2:]) + lines[0][:50], encoding="utf-8")  # of a killed run
    assert main(["experiment", str(path), "-o", str(two)]) == 2
    assert "expected --resume to continue it" in capsys.readouterr().err
    assert main(["experiment", str(path), "--workers", "2", "--resume", "-o", str(two)]) == 0
    for name in (*STUDY_FILES, ROWS):
        assert (one / name).read_bytes() == (two / name).read_bytes(), name


def fake_row(**errors):
    """A row with two outputs of each method, whose errors differ by 10 mm."""
    scores = {name: {"l": {"end_error_m": error}, "r": {"end_error_m": error + 0.01}} for name, error in errors.items()}
    return {"scores": scores, "failed": {}}


def test_methods_are_compared_walk_by_walk_in_each_combination(tmp_path):
    path = write_study(tmp_path, seeds=10, scores=["end_error_m"], methods=dict(list(STUDY["methods"].items())[:2]))
    study = read_study(path)
    walks = np.random.default_rng(0).uniform(0.1, 0.5, 10).tolist()
    rows = [fake_row(usual=e, same=2.0 * e) for e in walks] + [fake_row(usual=e, same=e) for e in walks]
    result = collect_result(study, rows)
    assert result["table"][0]["scores"]["end_error_m"]["mean"] == pytest.approx(np.mean(walks) + 0.005)
    assert [c["verdict"] for c in result["comparisons"]] == ["worse", ""]
    assert result["words"][0].startswith("end_error_m: same: worse than usual with none (+9")
    assert result["words"][0].endswith("no significant difference from usual with lost samples (+0 %).")
    assert table_rows(result)[0][:2] == ["none", "usual"]
    assert csv_text(study, rows).splitlines()[1] == f"none,0,usual,end_error_m,{walks[0] + 0.005:.9g}"


def test_seeds_and_number_of_walks_can_be_replaced(tmp_path):
    study = read_study(write_study(tmp_path))
    assert StudyOptions(folder=tmp_path, subset=1).of(study).seeds == (3,)
    assert StudyOptions(folder=tmp_path, first=7).of(study).seeds == (7, 8)


def test_the_example_takes_25_lines_and_is_the_one_in_the_documentation(tmp_path):
    text = (ROOT / "examples" / "study.yaml").read_text(encoding="utf-8")
    lines = text.splitlines()[1:]
    assert len(lines) <= 25
    assert "\n".join(lines) in (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    study = read_study(ROOT / "examples" / "study.yaml")
    assert (len(study.methods), len(study.combinations), len(study.seeds)) == (2, 3 * 2, 10)
    scenarios = [make_scenario(study, combination, tmp_path) for combination in study.combinations]
    assert len({repr(scenario.config) for scenario in scenarios}) == 6


def test_options_of_built_in_experiments_are_refused(tmp_path, capsys):
    assert main(["experiment", str(write_study(tmp_path)), "--keep"]) == 2
    assert "command line: --keep: invalid True: expected none" in capsys.readouterr().err


def turning_study(folder, **changes):
    keys = {
        "seeds": {"first": 10, "count": 12},
        "vary": {
            "speed": {"slow": {"gait.speed_mps": 0.8}, "fast": {"gait.speed_mps": 1.2}},
            "group": {"i": {"person": "zhao_i_{member}"}, "ii": {"person": "zhao_ii_{member}"}},
            "member": [1, 2, 3],
            "side": ["head", "chest"],
        },
        "turns": {"group": {}, "member": {"every": 2}, "side": {"every": 6, "add": ["group"]}},
        "set": {"sensors": ["foot_imu"], "camera_mount": "{side}"},
        "faults": {},
    }
    return write_study(folder, **(keys | changes))


def test_levels_take_turns_from_seed_to_seed(tmp_path):
    study = read_study(turning_study(tmp_path))
    assert study.seeds == tuple(range(10, 22))
    assert [combination.labels for combination in study.combinations] == [{"speed": "slow"}, {"speed": "fast"}]
    walks = [study.walks(seed)[1] for seed in study.seeds]
    assert [walk.labels["group"] for walk in walks] == ["i", "ii"] * 6
    assert [walk.labels["member"] for walk in walks] == [*"112233"] * 2
    assert [walk.labels["side"] for walk in walks] == ["head", "chest"] * 3 + ["chest", "head"] * 3
    config = make_scenario(study, walks[3], tmp_path).config
    assert (config.person, config.rig_mount, config.gait.speed_mps) == (PEOPLE["zhao_ii_2"], "chest", 1.2)
    later = StudyOptions(folder=tmp_path, first=15).of(study)  # other seeds take the turns that they have in the file
    assert later.levels(15)["member"].name == "3"
    header, first = csv_text(study, [fake_row(usual=0.1)] * 24).splitlines()[:2]
    assert header == "group,member,side,speed,seed,method,score,value"
    assert first.startswith("i,1,head,slow,10,usual,end_error_m,")


def test_a_part_beside_the_study_is_found_in_its_output(tmp_path):
    part = (ROOT / "examples/sensor_errors/late_forces.yaml").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(part, encoding="utf-8")
    vary = {"part": {"mine": {"sensors.foot_imu.part": "mine.yaml"}}}
    path = write_study(
        tmp_path,
        vary=vary,
        faults={},
        seeds=[3],
        set={},
        scores=["end_error_m"],
        methods={"usual": {"estimator": "foot_ins"}},
    )
    run_study(read_study(path), StudyOptions(folder=tmp_path / "out"), silent)
    assert (tmp_path / "out/files/mine.yaml").read_text(encoding="utf-8") == part


@pytest.mark.parametrize("name", ["foot", "head"])
def test_the_studies_of_sensor_errors_can_be_walked(tmp_path, name):
    study = read_study(ROOT / f"examples/sensor_errors/{name}.yaml")
    copy_files(tmp_path, study.user_files)
    (tmp_path / "scenarios").mkdir()
    configs = [make_scenario(study, combination, tmp_path).config for combination in study.combinations]
    assert len(configs) == len({repr(config) for config in configs})


def test_a_level_sets_the_whole_scenario(tmp_path):
    vary = {"walk": {"straight": {"scenario": "level_20m"}, "stairs": {"scenario": "stairs_16", "gait.speed_mps": 1.0}}}
    study = read_study(write_study(tmp_path, scenarios=[], vary=vary, faults={}))
    configs = [make_scenario(study, combination, tmp_path).config for combination in study.combinations]
    assert [(config.name, len(config.route.segments) > 1) for config in configs] == [("level_20m", 0), ("stairs_16", 1)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"turns": {"sped": {}}}, r"turns.sped: invalid 'sped': expected .*mean 'speed'"),
        (
            {"turns": {"group": {"add": ["member"]}, "member": {}}},
            r"turns.group.add\[0\]: invalid 'member': expected ",
        ),
        ({"turns": {"group": {"every": 0}}}, r"turns.group.every: invalid 0: expected a whole number, 1-10000"),
        ({"set": {"camera_mount": "{hat}"}}, "set.camera_mount: invalid '{hat}': expected names of factors .*: .*side"),
        (
            {"scenarios": []},
            r"scenarios: invalid \[\]: expected one or more scenarios, or a factor",
        ),
        ({"seeds": {"first": 3}}, r"seeds.count: missing"),
    ],
)
def test_an_error_of_turns_names_its_place(tmp_path, changes, message):
    with pytest.raises(StrideTwinError, match=message):
        run_study(read_study(turning_study(tmp_path, **changes)), StudyOptions(folder=tmp_path / "out"), silent)
