"""`estimate dvio` from the command line, on a walk with rendered pictures."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stridetwin.scenarios.cli import main
from stridetwin.scenarios.scoring import compare
from stridetwin.scenarios.truth import TruePath
from stridetwin.streams.recording import Recording
from stridetwin.streams.tum import read_tum

WALK = """\
description: a few steps in a room
terrain:
  - level: {length_m: 2.5}
scenery: room
sensors: [head_imu, head_camera]
"""


def test_a_walk_with_rendered_pictures_is_followed_to_its_end(tmp_path, capsys):
    scenario, folder, path = tmp_path / "walk.yaml", tmp_path / "walk", tmp_path / "path.txt"
    scenario.write_text(WALK)
    assert main(["run", str(scenario), "--seed", "3", "--no-film", "-o", str(folder)]) == 0
    recording = folder / "recording.mcap"
    assert main(["estimate", "dvio", str(recording), "-o", str(path)]) == 0
    assert path.read_bytes() == (folder / "dvio.txt").read_bytes()
    truth = TruePath.of(Recording(recording).block("/truth/head/imu/odometry"))
    fitted = compare(read_tum(path), truth, "yaw")
    assert fitted.distance_m[-1] > 2.0
    assert fitted.coverage > 0.8
    assert np.linalg.norm(fitted.error_m, axis=1).max() < 0.05
    capsys.readouterr()
    assert main(["score", str(recording), "--align", "yaw", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["estimators"]["dvio"]["ape_rmse_m"]
    assert told == pytest.approx(np.sqrt((fitted.error_m**2).sum(axis=1).mean()), rel=1e-3)
    report = (folder / "report.html").read_text()
    assert 'class="camera"' in report
    assert "visual-inertial odometry" in report


def test_what_goes_with_one_foot_is_refused(tmp_path, capsys):
    recording = tmp_path / "none.mcap"
    recording.write_bytes(b"")
    assert main(["estimate", "dvio", str(recording), "--foot", "l", "-o", str(tmp_path / "path.txt")]) == 2
    assert "--foot" in capsys.readouterr().err
