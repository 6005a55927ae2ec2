"""Campaigns of a few steps, walked: the same bytes whoever walks them, whoever is killed on the way, and whenever."""

import hashlib
import json
import os
import re
import shutil
import signal
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
from frail_pool import make_frail
from local_cluster import open_cluster
from small_campaign import SHORT, SMALL, write

from stridetwin.batch import executors
from stridetwin.batch.jobs import Failure
from stridetwin.cli.main import main
from stridetwin.scenarios.campaign import walk as campaign_walk
from stridetwin.scenarios.campaign.campaign_file import read_campaign
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate
from stridetwin.scenarios.campaign.plan import Extra, plan_walks
from stridetwin.scenarios.campaign.walk import WalkTask
from stridetwin.scenarios.check import check_recording
from stridetwin.sim import parts
from stridetwin.sim.parts.library import load_part
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.recording.reader import Recording

pytest.importorskip("mujoco")


def quiet(stage: str, share: float) -> None:
    pass


def contents(folder: Path) -> dict[str, bytes]:
    """Every file that somebody sees, by name; there is no other."""
    assert not [p for p in folder.rglob(".*")]
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("campaign")


@pytest.fixture(scope="module")
def campaign(home):
    return read_campaign(write(home))


@pytest.fixture(scope="module")
def one(home, campaign):
    """What one worker makes."""
    done = generate(campaign, CampaignOptions(folder=home / "one"), quiet)
    assert (done.generated, done.verdicts) == (3, {"accepted": 3})
    return home / "one"


def test_a_manifest_lists_the_files(one, campaign):
    manifest = json.loads((one / "manifest.json").read_text())
    assert [w["walk"] for w in manifest["walks"]] == [f"walk_{i:05d}" for i in range(3)]
    dealt: dict[str, set[str]] = {}
    for walk in manifest["walks"]:
        file = one / walk["recording"]
        assert hashlib.sha256(file.read_bytes()).hexdigest() == walk["sha256"]
        recording = Recording(file)
        assert recording.metadata["seed"] == str(walk["seed"])
        assert float(recording.metadata["person_height_m"]) == manifest["people"][walk["person"]]["height_m"]
        assert recording.rig.imus["/foot_l/imu"].part == load_part("MPU-9250").description
        assert check_recording(Recording(file, lenient=True)).data["valid"]
        assert walk["findings"] == []
        assert recording.duration == pytest.approx(walk["duration_s"], abs=1e-3)
        assert 0.9 <= walk["values"]["gait.speed_mps"] <= 1.2
        dealt.setdefault(walk["split"]["person"], set()).add(walk["person"])
    assert not set.intersection(*dealt.values()) or len(dealt) == 1
    assert set(manifest["versions"]) == {"stridetwin", "sources", "mujoco", "numpy", "scipy"}
    assert str(one.parent) not in (one / "manifest.json").read_text() + (one / "dataset_card.md").read_text()


def test_the_card_describes_the_data_and_its_program_reads_them(one, monkeypatch, capsys):
    card = (one / "dataset_card.md").read_text()
    assert card.startswith("# A few steps of three people\n")
    for words in ("3 walks of 3", "uniform 0.9 to 1.2", "female: 3", "## Splits", "None.", "Apache-2.0", "mujoco"):
        assert words in card
    program = card.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(one)
    exec(compile(program, "card", "exec"), {})
    read = [w for w in json.loads(Path("manifest.json").read_text())["walks"] if w["split"]["person"] == "train"]
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [w["walk"] for w in read]


def test_a_walk_is_made_again_from_its_scenario_file(one, tmp_path):
    walk = json.loads((one / "manifest.json").read_text())["walks"][2]
    again = tmp_path / "again.mcap"
    assert main(["generate", str(one / walk["scenario_file"]), "--seed", str(walk["seed"]), "-o", str(again)]) == 0
    assert again.read_bytes() == (one / walk["recording"]).read_bytes()


def test_what_is_there_is_not_made_again_and_what_is_damaged_is(one, campaign, tmp_path):
    folder = tmp_path / "two"
    shutil.copytree(one, folder)
    before = contents(folder)
    generate_again = generate(campaign, CampaignOptions(folder=folder), quiet)
    assert generate_again.generated == 0
    (folder / "recordings" / "walk_00001.mcap").write_bytes(b"")
    (folder / "rows" / "walk_00002.json").write_text("{")
    (folder / ".unfinished").mkdir()
    (folder / ".unfinished" / "half").write_text("x")
    assert generate(campaign, CampaignOptions(folder=folder), quiet).generated == 2
    assert contents(folder) == before
    done = generate(replace(campaign, walks=4), CampaignOptions(folder=folder), quiet)
    assert done.generated == 1
    assert {n: b for n, b in contents(folder).items() if n in before and "/" in n} == {
        n: b for n, b in before.items() if "/" in n
    }


def test_two_workers_give_the_same_bytes(one, campaign, tmp_path):
    assert generate(campaign, CampaignOptions(folder=tmp_path / "two", workers=2), quiet).generated == 3
    assert contents(tmp_path / "two") == contents(one)


def test_a_cluster_of_two_of_which_one_is_killed_gives_the_same_bytes(one, campaign, tmp_path):
    killed = []

    def kill_one(stage: str, share: float) -> None:
        if share > 0 and not killed:
            killed.append(next(iter(cluster.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    with open_cluster() as cluster:
        asked = CampaignOptions(folder=tmp_path / "cluster", scheduler=cluster.scheduler_address)
        assert generate(campaign, asked, kill_one).generated == 3
    assert len(killed) == 1
    assert contents(tmp_path / "cluster") == contents(one)


def tasks_of(campaign, folder: Path) -> list[WalkTask]:
    """The walks of a campaign, to be generated in a folder that exists."""
    for name in ("scenarios", "rows", "recordings", "rejected", ".unfinished"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    return [WalkTask(walk=walk, folder=folder, quality=campaign.quality) for walk in plan_walks(campaign, Extra())]


def test_a_failed_walk_has_the_person_and_terrain_of_a_successful_one(one, campaign, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign_walk, "record", lambda *_: 1 / 0)
    task = tasks_of(campaign, tmp_path)[1]
    failure = campaign_walk.generate_walk(task)
    assert failure == Failure("ZeroDivisionError: division by zero")
    row = campaign_walk.row_of_failure(task, failure.reason)
    assert (row["status"], row["reasons"]) == ("failed", ["error: ZeroDivisionError: division by zero"])
    walk = json.loads((one / "manifest.json").read_text())["walks"][1]
    assert {key: row[key] for key in ("person", "terrain")} == {key: walk[key] for key in ("person", "terrain")}


def test_a_reason_does_not_say_where_this_machine_has_the_campaign(campaign, tmp_path, monkeypatch):
    def refuse(path):
        raise ConfigError(path.parent / "../files/my/part.yaml", "rate_hz", 0, f"a rate, as in {path}")

    (task, *_) = tasks_of(campaign, tmp_path)
    monkeypatch.setattr(campaign_walk, "read_scenario", refuse)
    words = "files/my/part.yaml: rate_hz: invalid 0: expected a rate, as in walk_00000"
    assert campaign_walk.generate_walk(task)["reasons"] == [f"refused: {words}"]
    failed = campaign_walk.row_of_failure(task, f"{tmp_path}/scenarios/../files/a.stl and {tmp_path}/recordings/b")
    assert failed["reasons"] == ["error: files/a.stl and recordings/b"]


def test_a_walk_of_which_every_worker_dies_is_listed_as_failed_and_tried_again(one, campaign, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    with monkeypatch.context() as patch:
        make_frail(patch, lambda task: task.walk.name == "walk_00001")
        result = generate(campaign, CampaignOptions(folder=folder, workers=2), quiet)
    assert result.verdicts == {"accepted": 2, "failed": 1}
    failed = result.manifest["walks"][1]
    assert failed["reasons"] == ["error: its worker died; it may have run out of memory"]
    assert failed["person"]
    assert generate(campaign, CampaignOptions(folder=folder), quiet).generated == 1
    assert contents(folder) == contents(one)


def test_walks_that_are_not_fit_are_rejected_with_the_reason(tmp_path):
    text = SMALL.replace("walks: 3", "walks: 2").replace("part: MPU-9250", "part: {choice: [MPU-9250, my/small.yaml]}")
    text += "  faults: [{kind: dropout, topic: /foot_l/insole, at_s: {at}, duration_s: 0.5}]\n".replace("{at}", "1")
    path = write(tmp_path, text)
    (tmp_path / "my").mkdir()
    text = (Path(str(files(parts))) / "MPU-9250.yaml").read_text()
    for old, new in (("InvenSense MPU-9250", "My gyro"), ("range_dps: {value: 2000", "range_dps: {value: 60")):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "my" / "small.yaml").write_text(text)
    done = generate(read_campaign(path), CampaignOptions(folder=tmp_path / "out"), quiet)
    assert done.verdicts == {"accepted": 1, "rejected": 1}
    assert done.reasons == {"sensors": 1}
    (rejected,) = [w for w in done.manifest["walks"] if w["status"] == "rejected"]
    assert rejected["values"]["sensors.foot_imu.part"] == "../files/my/small.yaml"
    assert "/foot_l/imu" in rejected["reasons"][0]
    assert "% of the samples at the end of the range" in rejected["reasons"][0]
    assert (tmp_path / "out" / rejected["recording"]).parent.name == "rejected"
    assert "split" not in rejected
    assert f"`{rejected['walk']}`" in (tmp_path / "out" / "dataset_card.md").read_text()
    (accepted,) = [w for w in done.manifest["walks"] if w["status"] == "accepted"]
    assert accepted["findings"] == []
    assert any(f.startswith("/foot_l/insole") for f in accepted["expected_findings"])
    assert done.manifest["files"].keys() == {"my/small.yaml"}


def test_walks_that_nobody_can_walk_or_that_end_by_a_fall_are_rejected(tmp_path):
    loop = "  - level: {length_m: 4}\n" + "  - turn: {angle_deg: 90, radius_m: 1}\n  - level: {length_m: 2}\n" * 4
    path = write(tmp_path / "loop", SMALL, SHORT.replace("  - level: {length_m: 2}\n", loop))
    fault = "  faults: [{kind: freeze, topic: /foot_l/imu, at_s: 500}]\n"
    path.write_text(SMALL.replace("walks: 3", "walks: 1") + fault)
    done = generate(read_campaign(path), CampaignOptions(folder=tmp_path / "out"), quiet)
    (walk,) = done.manifest["walks"]
    assert (walk["status"], done.reasons) == ("rejected", {"refused": 1})
    assert "recording" not in walk
    push = "  dynamics: {fixed: {pushes: [{at_s: 1, duration_s: 0.5, left_n: 500}]}}\n"
    path = write(tmp_path / "push", SMALL.replace("walks: 3", "walks: 1") + push)
    text = path.read_text().replace("  dynamics:", "  physics: dynamic\n  dynamics:")
    path.write_text(text)
    for falls, status in (("reject", "rejected"), ("keep", "accepted")):
        path.write_text(f"{text}quality: {{falls: {falls}}}\n")  # is judged anew, not walked
        done = generate(read_campaign(path), CampaignOptions(folder=tmp_path / "pushed"), quiet)
        (walk,) = done.manifest["walks"]
        assert walk["status"] == status
        assert walk["fell_at_s"] > 1
        place = "recordings" if falls == "keep" else "rejected"
        assert [p.parent.name for p in (tmp_path / "pushed").rglob("*.mcap")] == [place]
    assert done.generated == 0


def test_only_one_generate_works_in_a_folder(one, campaign, tmp_path):
    def another(stage: str, share: float) -> None:
        if stage == "walks":
            with pytest.raises(StrideTwinError, match="another process generates walks there"):
                generate(campaign, CampaignOptions(folder=folder), quiet)

    folder = tmp_path / "two"
    shutil.copytree(one, folder)
    generate(campaign, CampaignOptions(folder=folder), another)


def test_the_command_says_what_is_wrong(tmp_path, capsys):
    path = write(tmp_path)
    for arguments, message in (
        (["stairs_and_rampz"], "invalid scenario or campaign 'stairs_and_rampz': expected "),
        (["demo", "--workers", "2"], "no --workers, as demo is a scenario"),
        ([str(path), "--workers", "2", "--scheduler", "x"], "--workers: invalid 2: expected either --workers or"),
        ([str(path), "--scheduler", "nope"], "--scheduler: invalid 'nope': expected HOST:PORT or"),
    ):
        assert main(["generate", *arguments, "-o", str(tmp_path / "out")]) == 2
        assert message in capsys.readouterr().err
    assert main(["generate", str(path), "-o", str(tmp_path / "out.mcap")]) == 2
    assert "expected a folder, as this is a campaign" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_prints_one_object(one, home, capsys):
    assert main(["generate", str(home / "small.yaml"), "--subset", "2", "-o", str(one), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["campaign"], result["walks"], result["made"], result["accepted"]) == ("small", 3, 0, 3)
    assert len(json.loads((one / "manifest.json").read_text())["walks"]) == 3  # nothing in the folder is unlisted


def test_a_folder_belongs_to_one_request(one, campaign, home, tmp_path, capsys):
    folder = tmp_path / "two"
    shutil.copytree(one, folder)
    before = contents(folder)
    path = str(write(tmp_path / "own"))
    for arguments, words in (
        (
            ["--seed", "4"],
            "of another request (seed 3, not 4): expected the same request to resume, or another folder",
        ),
        (["--only", "foot_ins"], "has walks of another request (sensors switched off: none, not foot_camera"),
        (["--physics", "dynamic"], "has walks of another request (physics as in the scenario, not dynamic)"),
    ):
        assert main(["generate", path, *arguments, "-o", str(folder)]) == 2
        assert words in capsys.readouterr().err
    for old, new, words in (
        ("[0.9, 1.2]", "[0.9, 1.3]", "its campaign file, or a file that it names, has changed since"),
        ("walks: 3", "walks: 2", "has 1 walks beyond those asked for, from walk_00002 on"),
    ):
        assert main(["generate", str(write(tmp_path / "own", SMALL.replace(old, new))), "-o", str(folder)]) == 2
        assert words in capsys.readouterr().err
    assert contents(folder) == before


def test_a_campaign_that_keeps_nothing_exits_1_and_empty_parts_are_named(tmp_path, capsys):
    text = SMALL.replace("walks: 3", "walks: 1")
    path = str(write(tmp_path, text))
    assert main(["generate", path, "-o", str(tmp_path / "out")]) == 0
    assert "WARNING: no accepted walk in validation (by person), test (by person)" in capsys.readouterr().out
    Path(path).write_text(f"{text}quality: {{help_pct: 0}}\n")
    row = tmp_path / "out" / "rows" / "walk_00000.json"
    row.write_text(json.dumps(json.loads(row.read_text()) | {"help_mean_pct": 1.0}))
    assert main(["generate", path, "-o", str(tmp_path / "out")]) == 1
    assert "WARNING: no walk was accepted" in capsys.readouterr().out


def test_ctrl_c_inside_compiled_code_stops_the_campaign(campaign, tmp_path, monkeypatch):
    def interrupted(*_):
        raise SystemError("CPUDispatcher returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(campaign_walk, "record", interrupted)
    with pytest.raises(KeyboardInterrupt):
        campaign_walk.generate_walk(tasks_of(campaign, tmp_path)[0])


def test_the_cost_announced_is_that_of_the_values_set(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(executors.Executor, "run", lambda *_: [])
    text = "campaign: far\nwalks: 40\nscenarios: [demo]\nset: {sensors: [foot_imu]}\n"
    with pytest.raises(KeyError):  # no walk has a row
        main(["generate", str(write(tmp_path, text)), "-o", str(tmp_path / "out")])
    size_mb = float(re.search(r"40 walks: .* s of walking, ([\d.]+) MB", capsys.readouterr().err)[1])
    assert size_mb < 40 * 30  # with cameras, a walk of the demo has 400 MB


def test_ctrl_c_says_what_is_kept_and_how_to_continue(tmp_path, monkeypatch, capsys):
    def run(executor, work, groups):
        yield groups[0][0], {"walk": groups[0][0].name}
        raise KeyboardInterrupt

    monkeypatch.setattr(executors.Executor, "run", run)
    folder = tmp_path / "out"
    assert main(["generate", str(write(tmp_path)), "-o", str(folder)]) == 130
    assert f"error: stopped; 1 of 3 walks are in {folder}; the same command continues" in capsys.readouterr().err
