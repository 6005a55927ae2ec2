"""A campaign whose walks are recordings of people."""

import json
from pathlib import Path

import pytest

from stridetwin.scenarios.campaign.campaign_file import read_campaign
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate
from stridetwin.scenarios.campaign.plan import Extra, plan_walks
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.reader import Recording
from tests.motion_files import plan_walk, write_amass, write_bvh

pytest.importorskip("mujoco")

_SCENARIO = """
description: as a person walked
motion: {file: first.bvh}
person: {height_m: 1.7}
sensors: [foot_imu]
"""
_CAMPAIGN = """
campaign: Recorded walks
walks: 2
sampling: latin_hypercube
scenarios: [person.yaml]
motion: [first.bvh, second.npz]
"""


def _write(folder: Path, campaign: str = _CAMPAIGN) -> Path:
    (folder / "person.yaml").write_text(_SCENARIO)
    (folder / "recorded.yaml").write_text(campaign)
    return folder / "recorded.yaml"


def test_every_recording_is_walked_and_copied(tmp_path: Path) -> None:
    write_bvh(tmp_path / "first.bvh", plan_walk(), "xsens", 1.0, None)
    write_amass(tmp_path / "second.npz", plan_walk())
    campaign = read_campaign(_write(tmp_path))
    planned = plan_walks(campaign, Extra())
    assert {walk.values["motion.file"] for walk in planned} == {"../files/first.bvh", "../files/second.npz"}
    done = generate(campaign, CampaignOptions(folder=tmp_path / "out"), lambda *_: None)
    assert done.verdicts == {"accepted": 2}
    assert (tmp_path / "out/files/first.bvh").read_bytes() == (tmp_path / "first.bvh").read_bytes()
    manifest = json.loads((tmp_path / "out/manifest.json").read_text())
    for walk in manifest["walks"]:
        assert "/foot_l/imu" in Recording(tmp_path / "out" / walk["recording"]).topics
        assert walk["terrain"] in manifest["splits"]["terrain"]


def test_missing_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "first.bvh").write_text("nothing")
    with pytest.raises(ConfigError, match="existing file") as caught:
        read_campaign(_write(tmp_path))
    assert "motion" in str(caught.value)
    with pytest.raises(ConfigError, match="HIERARCHY"):
        generate(
            read_campaign(_write(tmp_path, _CAMPAIGN.replace(", second.npz", ""))),
            CampaignOptions(folder=tmp_path / "out"),
            lambda *_: None,
        )
