"""From a recording to a table of the coming steps, by the command."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from stridetwin.scenarios.cli import main
from stridetwin.scenarios.mode_files import COLUMNS
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.twin import Twin


def recorded(folder: Path, *sensors: str) -> Path:
    """Four metres on the level, with some groups of sensors."""
    path = folder / "walk.mcap"
    route = Route(segments=(Level(length_m=4.0),))
    record(
        Twin(TwinConfig(name="modes", route=route, sensors=sensors, gait=Gait(stand_s=0.6)), 5), path, lambda *_: None
    )
    return path


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("walk"), "insole", "head_imu", "head_camera")


@pytest.mark.parametrize("method", ["stridetwin", "published"])
def test_estimate_writes_a_row_a_step(walk, tmp_path, method):
    out = tmp_path / "modes.csv"
    assert main(["estimate", "locomotion_mode", str(walk), "--method", method, "-o", str(out)]) == 0
    with out.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) >= 4
    assert {row["mode"] for row in rows} == {"LG"}
    assert np.all(np.diff([float(row["t_s"]) for row in rows]) > 0.0)


def test_a_recording_without_insoles_is_refused(tmp_path, capsys):
    walk = recorded(tmp_path, "head_imu", "head_camera")
    assert main(["estimate", "locomotion_mode", str(walk), "-o", str(tmp_path / "modes.csv")]) == 2
    told = capsys.readouterr().err
    assert "walk.mcap" in told
    assert "/foot_l/insole or /foot_r/insole" in told
    assert not (tmp_path / "modes.csv").exists()
