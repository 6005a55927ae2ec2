import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
import yaml

from stridetwin.batch import forecast
from stridetwin.batch.run import ROWS
from stridetwin.cli.main import main
from stridetwin.cli.studies import placement_lines
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim import parts
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.studies.placement import measure as measuring
from stridetwin.studies.placement.measure import placement_forecast
from stridetwin.studies.placement.problem_file import read_problem
from stridetwin.studies.placement.run import PlacementOptions, run_placement

STEPS = {"description": "a few steps", "terrain": [{"level": {"length_m": 1.5}}], "gait": {"stand_s": 0.5}}
PARTS = {
    "placement": "Parts by weight",
    "scenarios": ["steps.yaml"],
    "seeds": 6,
    "free": {
        "sensors.foot_imu.part": {"choice": ["ADIS16485", "MPU-9250"]},
        "sensors.sonar": {"choice": [True, False]},
    },
    "scores": ["weight_g", "foot_weight_g"],
}
SIGHT = {
    "placement": "Which way the shoe's camera looks",
    "scenarios": ["steps.yaml"],
    "seeds": 2,
    "set": {
        "sensors.foot_camera.mount": {"fixed": {"position_mm": [-70, 45, 36], "faces_deg": [27, 24], "roll_deg": 90}}
    },
    "free": {
        "sensors.foot_camera.mount.position_mm[0]": {"between": [-80, -60], "step": 20},
        "sensors.foot_camera.mount.faces_deg[0]": {"between": [0, 60], "step": 20},
    },
    "scores": ["visibility_pct", "occlusion_pct"],
}
FILES = ("placement.json", "placement.html", "places.csv", ROWS)


def silent(stage, share):
    """Nobody listens."""


def problem(tmp_path, node):
    (tmp_path / "steps.yaml").write_text(yaml.safe_dump(STEPS), encoding="utf-8")
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(node), encoding="utf-8")
    return path


def test_the_command_prints_a_table_and_writes_its_files(tmp_path, capsys):
    path, out = problem(tmp_path, PARTS), tmp_path / "out"
    assert main(["place", str(path), "-o", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((out / "placement.json").read_text())
    assert result["best"]["values"] == {"foot_imu.part": "MPU-9250", "sonar": False}
    best, second = result["table"][:2]
    assert best["scores"]["foot_weight_g"]["mean"] == pytest.approx(3 + 110 + 4)  # IMU, camera, four cells
    assert second["scores"]["weight_g"]["mean"] - best["scores"]["weight_g"]["mean"] == pytest.approx(20)
    assert {row["label"] for row in result["table"]} > {"as it is"}
    assert all(c["significant"] for c in result["comparisons"] if c["difference"] > 0)
    assert any("is not significant" in words for words in result["words"])  # as it is: the same as one of the places
    assert {p.name for p in out.iterdir()} == {*FILES, "request.json", "scenarios"}
    assert "http" not in (out / "placement.html").read_text().replace("http://www.w3.org", "")
    config = load_scenario(str(out / "scenarios" / "best_steps.yaml")).config
    assert "sonar" not in config.sensors
    assert config.fittings["foot_imu"].part.name == "MPU-9250"
    assert main(["place", "foot_camra", "-o", str(out)]) == 2
    assert "did you mean 'foot_camera'" in capsys.readouterr().err


def test_a_stopped_run_goes_on_where_it_was_and_comes_to_the_same(tmp_path, monkeypatch):
    asked = read_problem(problem(tmp_path, PARTS))
    whole = run_placement(asked, PlacementOptions(folder=tmp_path / "whole"), silent)
    stopped, calls = tmp_path / "stopped", []

    def killed(stage, share):
        calls.append(share)
        if len(calls) == 13:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_placement(asked, PlacementOptions(folder=stopped), killed)
    rows = (stopped / ROWS).read_text()
    (stopped / ROWS).write_text(rows[:-20])  # a line that was being written
    made, scores = [], measuring.geometric_scores
    monkeypatch.setattr(measuring, "geometric_scores", lambda *a: made.append(1) or scores(*a))
    assert run_placement(asked, PlacementOptions(folder=stopped, resume=True), silent) == whole
    assert len(made) == 5 * 6 - 11
    for name in FILES:
        assert (stopped / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_two_workers_come_to_the_same_bytes_and_a_place_is_shown_on_the_shoe(tmp_path):
    asked = read_problem(problem(tmp_path, SIGHT))
    found = [run_placement(asked, PlacementOptions(folder=tmp_path / str(n), workers=n), silent) for n in (1, 2)]
    assert found[0] == found[1]
    for name in (*FILES, "body.png"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()
    assert found[0]["tried"] == 8
    assert found[0]["table"][0]["scores"]["visibility_pct"]["mean"] > 20
    assert "too few" in found[0]["words"][0]
    assert "on the body" in (tmp_path / "1" / "placement.html").read_text().lower()
    assert found[0]["pareto"]


def test_a_score_whose_sensor_is_off_ends_it_with_the_reason(tmp_path):
    node = SIGHT | {"set": {"sensors": ["foot_imu"]}, "free": PARTS["free"]}
    with pytest.raises(StrideTwinError, match="visibility_pct needs foot_camera, which is off"):
        run_placement(
            read_problem(problem(tmp_path, node | {"seeds": 1})), PlacementOptions(folder=tmp_path / "out"), silent
        )


def test_a_score_that_no_estimator_reports_ends_the_run_with_the_first_place(tmp_path):
    node = PARTS | {"set": {"sensors": ["foot_imu"]}, "seeds": 1, "scores": ["foot_ins.end_eror_m"]}
    node |= {"free": {"sensors.foot_imu.part": {"choice": ["ADIS16485", "MPU-9250"]}}}
    with pytest.raises(StrideTwinError, match=r"scores: invalid 'foot_ins\.end_eror_m': .* mean 'end_error_m'\?"):
        run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "out"), silent)
    assert len((tmp_path / "out" / ROWS).read_text().splitlines()) == 1
    node |= {"scores": ["magic.end_error_m"]}
    with pytest.raises(StrideTwinError, match=r"scores: .*invalid 'magic\.end_error_m': expected .*foot_ins"):
        run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "magic"), silent)


def test_a_folder_belongs_to_one_placement_which_only_resume_continues(tmp_path):
    out = PlacementOptions(folder=tmp_path / "out")
    asked = read_problem(problem(tmp_path, PARTS | {"seeds": 1}))
    run_placement(asked, out, silent)
    before = {p: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.is_file()}
    with pytest.raises(StrideTwinError, match="out: holds a placement: expected --resume to continue it"):
        run_placement(asked, out, silent)
    other = read_problem(problem(tmp_path, PARTS | {"placement": "Other parts", "scores": ["foot_weight_g"]}))
    with pytest.raises(
        StrideTwinError, match=r"holds another placement, 'Parts by weight' \(other placement, scores\)"
    ):
        run_placement(other, replace(out, resume=True), silent)
    assert {p: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.is_file()} == before
    (tmp_path / "campaign").mkdir()
    for of_another in ('{"campaign": "mine"}', '["mine"]'):
        (tmp_path / "campaign" / "request.json").write_text(of_another)
        with pytest.raises(
            StrideTwinError, match="campaign: holds results of another command: expected another folder"
        ):
            run_placement(asked, replace(out, folder=tmp_path / "campaign"), silent)
    more = run_placement(asked, replace(out, resume=True, walks=2), silent)
    assert len(more["walks"]) == 2


def test_another_distance_from_the_surface_is_another_placement(tmp_path):
    def imu(off_mm):
        on = {"over": "shoe", "around_deg": {"between": [90, 180], "step": 90}, "up_mm": 60, "off_mm": off_mm}
        node = PARTS | {"seeds": 1, "free": {"sensors.foot_imu.position_mm": on}}
        return read_problem(problem(tmp_path, node))

    out = PlacementOptions(folder=tmp_path / "out")
    result = run_placement(imu(10), out, silent)
    assert placement_lines(result)[-1] == "2 places and the unchanged one on 1 walk"
    with pytest.raises(StrideTwinError, match=r"\(other surfaces\): expected another folder"):
        run_placement(imu(12), replace(out, resume=True), silent)


def test_only_what_the_scores_need_is_simulated_and_estimated(tmp_path, monkeypatch):
    node = PARTS | {"scores": ["foot_ins.end_error_m", "foot_weight_g"], "seeds": 1}
    recorded, scored = [], []
    score = measuring.score_walk

    def recording(job):
        recorded.append({t for t in Recording(job.path).topics if not t.startswith("/truth")})
        row = score(job)
        scored.append(set(row["estimators"]))
        return row

    monkeypatch.setattr(measuring, "score_walk", recording)
    result = run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "out"), silent)
    assert recorded == [{"/foot_l/imu", "/foot_r/imu"}] * 3  # the sonar makes no other walk of five places
    assert scored == [{"foot_ins_l", "foot_ins_r"}] * 3
    assert result["table"][0]["scores"]["foot_weight_g"]["mean"] > 100.0  # of every sensor of the place


def test_a_placement_that_is_refused_leaves_nothing(tmp_path):
    node = PARTS | {"free": {"camera_mount": {"choice": ["head", "knee"]}}}
    with pytest.raises(StrideTwinError, match="'knee'"):
        run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "out"), silent)
    assert not (tmp_path / "out").exists()


def test_a_long_placement_is_announced_before_and_after_its_first_walks(tmp_path, monkeypatch, capsys):
    node = PARTS | {"free": {"sensors.foot_imu.position_mm[0]": {"between": [-40, -20], "step": 0.1}}}
    node |= {"set": {"sensors.foot_imu.position_mm": [-30, 42, 60]}, "scores": ["foot_ins.end_error_m"]}
    asked = read_problem(problem(tmp_path, node))
    now = iter((0.0, 4.0))
    monkeypatch.setattr(forecast.time, "monotonic", lambda: next(now))
    left = placement_forecast(asked, measured=6)
    assert "202 places on 6 walks: 1206 walks to measure" in capsys.readouterr().err
    for _ in range(3):
        left.count_job(workers=1)
    assert "about 0:40:00 h left; Ctrl-C stops it, and --resume continues" in capsys.readouterr().err
    few = read_problem(problem(tmp_path, PARTS))
    placement_forecast(few, measured=0)
    assert capsys.readouterr().err == ""


def test_viewing_directions_of_a_sensor_with_one_position_are_shown_on_the_body(tmp_path):
    free = {"sensors.foot_camera.mount.faces_deg[0]": {"between": [0, 60], "step": 30}}
    asked = read_problem(problem(tmp_path, SIGHT | {"free": free, "seeds": 1}))
    result = run_placement(asked, PlacementOptions(folder=tmp_path / "out"), silent)
    assert "body.png" in result["files"]
    assert "viewing directions" in (tmp_path / "out" / "placement.html").read_text()


def test_a_scenario_that_is_listed_twice_is_measured_as_each_of_its_entries(tmp_path):
    twice = ["steps.yaml", {"scenario": "steps.yaml", "set": {"sensors.insole": False}}]
    node = PARTS | {"scenarios": twice, "seeds": 1}
    result = run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "out"), silent)
    assert result["walks"] == ["steps, seed 0", "steps_2, seed 0"]
    rows = [json.loads(line) for line in (tmp_path / "out" / ROWS).read_text().splitlines()]
    weights = {}
    for row in rows:
        weights.setdefault(row["walk"], set()).add(row["scores"]["weight_g"])
    assert len(weights) == 2
    assert weights["steps, seed 0"].isdisjoint(weights["steps_2, seed 0"])
    for name, there in (("best_steps.yaml", True), ("best_steps_2.yaml", False)):
        config = load_scenario(str(tmp_path / "out" / "scenarios" / name)).config
        assert ("insole" in config.sensors) is there


def test_a_scenario_with_parts_of_its_own_takes_the_place_of_the_files_own(tmp_path, monkeypatch, capsys):
    path = problem(tmp_path, PARTS | {"seeds": 1})
    here = tmp_path / "here"
    (here / "my").mkdir(parents=True)
    part = (Path(str(files(parts))) / "MPU-9250.yaml").read_text()
    (here / "my" / "imu.yaml").write_text(part)
    (here / "mine.yaml").write_text(yaml.safe_dump(STEPS | {"sensors": {"exo_imu": False, "foot_imu": "my/imu.yaml"}}))
    monkeypatch.chdir(here)
    assert main(["place", str(path), "--scenario", "mine.yaml", "-o", "out", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["walks"] == ["mine, seed 0"]
    assert (here / "out" / "files" / "my" / "imu.yaml").read_text() == part
    (tmp_path / "my").mkdir()
    (tmp_path / "my" / "imu.yaml").write_text(part)
    other = {"sensors.foot_imu.part": {"choice": ["my/imu.yaml", "MPU-9250"]}}
    path.write_text(yaml.safe_dump(PARTS | {"seeds": 1, "free": other}))
    assert main(["place", str(path), "--scenario", "mine.yaml", "-o", "out"]) == 2
    assert "expected a scenario without another file my/imu.yaml than the placement's" in capsys.readouterr().err


def test_a_page_without_scores_of_other_places_has_no_figures_of_them(tmp_path):
    text = (Path(str(files(parts))) / "MPU-9250.yaml").read_text()
    assert "\nmass_g:" in text
    for name in ("a.yaml", "b.yaml"):  # of which nobody knows the weight
        (tmp_path / name).write_text("\n".join(line for line in text.splitlines() if not line.startswith("mass_g:")))
    free = {
        "sensors.foot_imu.part": {"choice": ["a.yaml", "b.yaml"]},
        "sensors.foot_imu.position_mm[0]": {"between": [-40, -20], "step": 20},
        "sensors.foot_imu.position_mm[2]": {"between": [40, 60], "step": 20},
    }
    node = PARTS | {"free": free, "seeds": 1, "set": {"sensors.foot_imu.position_mm": [-30, 42, 60]}}
    result = run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "out"), silent)
    assert [row["label"] for row in result["table"]] == ["as it is"]
    assert result["failed"] == result["tried"] == 8
    assert "Score over each value" not in (tmp_path / "out" / "placement.html").read_text()


def test_the_page_shows_the_unchanged_place_and_leaves_out_what_does_not_vary(tmp_path):
    node = SIGHT | {"scores": ["visibility_pct", "weight_g"]}  # the weight is the same everywhere
    run_placement(read_problem(problem(tmp_path, node)), PlacementOptions(folder=tmp_path / "out"), silent)
    page = (tmp_path / "out" / "placement.html").read_text(encoding="utf-8")
    assert '"unchanged"' in page.split("Score over each value")[1]
    assert "Trade-offs between scores" not in page
    assert "places.csv has all" not in page  # nine of nine
