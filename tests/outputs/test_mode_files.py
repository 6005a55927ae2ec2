"""From a recording to a table of the coming steps, by the command."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.cli.main import main
from stridetwin.outputs.modes.files import MODE_COLUMNS, find_completed_steps
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from tests.small_camera import one_renderer, small_camera


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A few steps on the level."""
    path = tmp_path_factory.mktemp("walk") / "walk.mcap"
    config = TwinConfig(
        name="modes",
        route=Route(segments=(Level(length_m=2.5),)),
        sensors=("insole", "head_imu", "head_camera"),
        gait=Gait(stand_s=0.6),
        fittings={"head_camera": SensorConfig(part=small_camera(path.parent), rate_hz=10.0)},
    )
    with one_renderer():
        record(Twin(config, 5), path, lambda *_: None)
    return path


def test_steps_are_counted_anew_where_the_odometry_began_anew():
    def estimate_at(t_s, step):
        steps = tuple(SimpleNamespace(step=step + k + 1, mode="LG") for k in range(4))
        return SimpleNamespace(t_ns=int(t_s * 1e9), step=step, steps=steps)

    numbered = ((1.0, 7), (1.6, 8), (9.0, 0), (9.5, 0), (10.0, 1), (10.6, 2))
    made = find_completed_steps([estimate_at(t_s, step) for t_s, step in numbered])
    assert [m.step.step for m in made] == [8, 1, 2]
    assert [m.steady_s for m in made] == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize("method", ["proposed", "published"])
def test_estimate_writes_a_row_a_step(walk, tmp_path, method):
    out = tmp_path / "modes.csv"
    assert main(["estimate", "locomotion_mode", str(walk), "--method", method, "--poses", "truth", "-o", str(out)]) == 0
    with out.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == MODE_COLUMNS
    assert len(rows) >= 4
    assert {row["mode"] for row in rows} == {"LG"}
    assert np.all(np.diff([float(row["t_s"]) for row in rows]) > 0.0)


def test_the_poses_are_the_odometry_s_unless_the_truth_is_requested(walk, tmp_path, capsys):
    recording, whole, without = Recording(walk), tmp_path / "whole.mcap", tmp_path / "without.mcap"
    for path, left_out in ((whole, ""), (without, "/truth/")):
        with RecordingWriter(path, recording.rig, recording.metadata) as writer:
            for sample in recording.samples([t for t in recording.topics if not (left_out and t.startswith(left_out))]):
                writer.write(sample)
    files = [tmp_path / f"{name}.csv" for name in ("with", "without", "true")]
    said = []
    for file, source, more in zip(files, (whole, without, whole), ([], [], ["--poses", "truth"])):
        assert main(["estimate", "locomotion_mode", str(source), *more, "-o", str(file), "--json"]) == 0
        said.append(json.loads(capsys.readouterr().out)["poses"])
    assert said == ["poses estimated by dvio"] * 2 + ["true poses of /truth/head/imu/odometry"]
    estimated, alone, true = (file.read_text(encoding="utf-8") for file in files)
    assert estimated == alone != true


def test_a_recording_without_insoles_is_refused(walk, tmp_path, capsys):
    recording, without = Recording(walk), tmp_path / "walk.mcap"
    topics = [topic for topic in recording.topics if topic.startswith("/head/")]
    with RecordingWriter(without, replace(recording.rig, others={}), recording.metadata) as writer:
        for sample in islice(recording.samples(topics), 300):
            writer.write(sample)
    assert main(["estimate", "locomotion_mode", str(without), "-o", str(tmp_path / "modes.csv")]) == 2
    message = capsys.readouterr().err
    assert "walk.mcap" in message
    assert "no topic /foot_l/insole or /foot_r/insole: locomotion_mode needs it" in message
    assert not (tmp_path / "modes.csv").exists()
