"""`score` of a campaign's folder: accepted walks alone, by one worker or two, failures reported."""

import hashlib
import json
import shutil

import pytest
from frail_pool import make_frail

from stridetwin.cli.main import main
from stridetwin.gate.walk_scores import jobs_of
from stridetwin.streams.errors import StrideTwinError


@pytest.fixture
def campaign(walk, tmp_path):
    """Folder of a campaign of three walks, of which one is rejected."""
    folder = tmp_path / "data"
    rows = []
    for i, status in enumerate(("accepted", "rejected", "accepted")):
        place = f"{'recordings' if status == 'accepted' else 'rejected'}/walk_{i:05d}.mcap"
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(walk / "recording.mcap", folder / place)
        text = (folder / place).read_bytes()
        rows.append(
            {
                "walk": f"walk_{i:05d}",
                "status": status,
                "recording": place,
                "bytes": len(text),
                "findings": [],
                "expected_findings": [],
                "sha256": hashlib.sha256(text).hexdigest(),
            }
        )
    (folder / "manifest.json").write_text(json.dumps({"format": "stridetwin-campaign-1", "walks": rows}))
    return folder


OWN = ["--program", "mine=false {recording} {output}"]


def test_accepted_walks_are_scored_by_every_estimator(campaign, walk, capsys):
    assert main(["score", str(campaign), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in output["recordings"]] == ["walk_00000", "walk_00002"]
    assert {row["sha256"] for row in output["recordings"]} == {
        hashlib.sha256((walk / "recording.mcap").read_bytes()).hexdigest()
    }
    assert set(output["recordings"][0]["estimators"]) == set(output["estimators"]) > {"foot_ins_l"}
    assert output["estimators"] == json.loads((walk / "scores.json").read_text())["estimators"]


def test_recordings_that_the_manifest_does_not_list_are_named(campaign, capsys):
    assert len(jobs_of([campaign], lenient=False)) == 2
    assert capsys.readouterr().err == ""
    (campaign / "recordings" / "walk_00009.mcap").write_bytes(b"")
    assert len(jobs_of([campaign], lenient=False)) == 2
    assert "1 recordings, such as walk_00009.mcap, are not in " in capsys.readouterr().err


def test_two_workers_give_the_same_scores_as_one(campaign, walk, capsys):
    words = ["score", str(campaign), "--program", f"mine=env R={{recording}} cp {walk / 'foot_ins_l.txt'} {{output}}"]
    assert main([*words, "--json"]) == 0
    one = capsys.readouterr().out
    assert main([*words, "--json", "--workers", "2"]) == 0
    assert capsys.readouterr().out == one
    assert json.loads(one)["estimators"]["mine"]["ape_rmse_m"] > 0.0


def test_a_walk_of_which_every_worker_dies_has_failed_and_the_others_are_scored(campaign, walk, monkeypatch, capsys):
    make_frail(monkeypatch, lambda job: job.name == "walk_00002")
    words = ["score", str(campaign), "--program", f"mine=env R={{recording}} cp {walk / 'foot_ins_l.txt'} {{output}}"]
    assert main([*words, "--json", "--workers", "2"]) == 1
    scored, failed = json.loads(capsys.readouterr().out)["recordings"]
    assert set(scored["estimators"]) == {"mine"}
    assert scored["sha256"] == failed["sha256"]
    assert list(failed["failed"].values()) == ["its worker died; it may have run out of memory"]


def test_an_estimator_that_fails_on_a_walk_is_reported_and_the_others_continue(campaign, capsys):
    assert main(["score", str(campaign), *OWN, "--json"]) == 1
    said = capsys.readouterr()
    rows = json.loads(said.out)["recordings"]
    assert [row["failed"]["mine"] for row in rows] == ["false: exit code 1; nothing on stderr"] * 2
    assert "exit code 1" not in said.err
    assert main(["score", str(campaign), *OWN]) == 1
    said = capsys.readouterr()  # the reason once, whatever the number of walks
    assert "FAILED walk_00000 and 1 more: mine: false: exit code 1" in said.out
    assert (said.out + said.err).count("exit code 1") == 1


def test_what_score_has_written_of_walks_of_which_one_fails_is_a_baseline(campaign, walk, tmp_path, capsys):
    once = (
        f"mine=sh -c 'cp {walk / 'foot_ins_l.txt'} \"$1\" && case $0 in *00002*) exit 3; esac' {{recording}} {{output}}"
    )
    words = ["score", str(campaign), "--program", once, "--json"]
    assert main(words) == 1
    output = capsys.readouterr().out
    assert [list(row.get("failed", {})) for row in json.loads(output)["recordings"]] == [[], ["mine"]]
    (tmp_path / "base.json").write_text(output)
    assert main([*words, "--baseline", str(tmp_path / "base.json")]) == 1
    assert json.loads(capsys.readouterr().out)["regressions"] == []


def test_a_failure_of_an_estimator_without_baseline_is_reported_in_every_file(campaign, walk, tmp_path, capsys):
    (tmp_path / "base.json").write_text('{"estimators": {"fine": {"end_error_m": 9.0}}, "recordings": []}')
    fine = f"fine=env R={{recording}} cp {walk / 'foot_ins_l.txt'} {{output}}"
    out = {name: tmp_path / name for name in ("gate.xml", "gate.md", "gate.jsonl")}
    words = ["--baseline", str(tmp_path / "base.json"), "--junit", str(out["gate.xml"]), "--label", "v1"]
    words += ["--markdown", str(out["gate.md"]), "--history", str(out["gate.jsonl"])]
    assert main(["score", str(campaign), *OWN, "--program", fine, *words]) == 1
    assert "none of 1 scores is worse, but 2 failed" in capsys.readouterr().out
    assert 'errors="2"' in out["gate.xml"].read_text()
    assert "**nothing worse**, but **2 failed**" in out["gate.md"].read_text()
    assert json.loads(out["gate.jsonl"].read_text())["verdict"] == "failed"


def test_a_folder_that_is_not_as_its_manifest_says_is_refused(campaign):
    asked = {"lenient": False, "alignment": "start", "user_estimators": ()}
    assert [job.strict for job in jobs_of([campaign], **asked)] == [False, False]
    (campaign / "recordings" / "walk_00002.mcap").write_bytes(b"short")
    with pytest.raises(StrideTwinError, match=r"5 bytes, but .* generate it again"):
        jobs_of([campaign], **asked)
    (campaign / "manifest.json").write_text('{"format": "another"}')
    with pytest.raises(StrideTwinError, match="invalid manifest of a campaign"):
        jobs_of([campaign], **asked)


def test_a_folder_that_holds_campaigns_is_not_taken_for_one(tmp_path):
    (tmp_path / "walks").mkdir()
    (tmp_path / "walks" / "manifest.json").touch()
    with pytest.raises(StrideTwinError, match=f"no campaign: expected a folder that generate has .*{tmp_path}/walks"):
        jobs_of([tmp_path])
