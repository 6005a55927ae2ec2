"""Faults from the scenario file to the report: read, injected, reported, survived by every command."""

import json

import numpy as np
import pytest
import yaml

from stridetwin.cli.main import main
from stridetwin.scenarios.metadata import read_injected_faults
from stridetwin.scenarios.scenario_file import load_scenario, read_scenario
from stridetwin.scenarios.scenario_model import FAULTS
from stridetwin.sim.faults.faults import LooseStrap
from stridetwin.sim.faults.sample_faults import Dropout
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.reader import Recording
from tests.plots import figures

GOOD = {"description": "a walk", "terrain": [{"level": {"length_m": 3}}]}
AT = {"at_s": 3, "duration_s": 0.5}
EVERY = [
    {"kind": "dropout", "topic": "/foot_l/imu", "rate_per_min": 30, "duration_s": 0.05},
    {"kind": "freeze", "topic": "/foot_l/insole", **AT},
    {"kind": "repeat", "topic": "/foot_l/imu", **AT},
    {"kind": "interpolated", "topic": "/foot_r/imu", **AT, "share": 0.2, "packet_samples": 2, "above_deg_s": 200},
    {"kind": "nan", "topic": "/foot_r/imu", **AT},
    {"kind": "late", "topic": "/foot_*/imu", "at_s": 5, "duration_s": 0.5, "delay_s": 0.2},
    {"kind": "out_of_order", "topic": "/foot_r/insole", **AT},
    {"kind": "clock_jump", "topic": "/foot_r/imu", "at_s": 6, "jump_s": -0.2},
    {"kind": "saturation", "topic": "/foot_*/imu", "at_s": 0, "fraction": 0.8},
    {"kind": "occlusion", "topic": "/head/*", **AT, "share": 0.4},
    {"kind": "lens_dirt", "topic": "/head/color", "at_s": 6},
    {"kind": "loose_strap", "topic": "/head/imu", **AT, "angle_deg": 5, "shift_mm": 10},
    {"kind": "dead_cell", "topic": "/foot_l/insole", "at_s": 4, "cell": "toe", "stuck": True},
    {"kind": "offset", "topic": "/foot_r/insole", "at_s": 5, "offset_n": 2, "drift_n_per_s": 1, "drift_s": 3},
    {"kind": "exchange", "topic": "/foot_*/insole"},
    {"kind": "passer_by", "topic": "/head/*", **AT, "share": 0.3, "distance_m": 1.2, "motion_hz": 0.2},
    {"kind": "depth_noise", "topic": "/head/depth", **AT, "noise_per_m": 0.01, "noise_correlation_px": 3},
    {"kind": "darkness", "topic": "/head/color", **AT, "light": 0.1, "noise": 2},
    {"kind": "high_view", "topic": "/head/depth", **AT, "share": 0.3, "range_m": 4},
    {"kind": "mirror_floor", "topic": "/head/depth", **AT, "holes": 0.2, "mirrored": 0.1, "blotch_mm": 100},
    {"kind": "miscalibration", "topic": "/foot_*/imu", "rotation_deg": [1, 0, 0], "gyroscope_deg_s": 300},
    {"kind": "restart", "topic": "/poses", **AT, "yaw_deg": 60, "translation_m": [3, -2, 0.5]},
]


def written(tmp_path, faults):
    path = tmp_path / "faulty.yaml"
    path.write_text(yaml.safe_dump(GOOD | {"faults": faults}))
    return path


def test_every_kind_is_read_and_the_demo_has_them_all(tmp_path):
    faults = read_scenario(written(tmp_path, EVERY)).config.faults
    assert {f.kind for f in faults} == set(FAULTS) == {f.kind for f in load_scenario("demo_faults").config.faults}
    assert faults[0] == Dropout(topic="/foot_l/imu", rate_per_min=30.0, duration_s=0.05)
    strap = next(f for f in faults if isinstance(f, LooseStrap))
    assert (strap.angle_rad, strap.shift_m) == (pytest.approx(0.0873, abs=1e-4), pytest.approx(0.01))


@pytest.mark.parametrize(
    ("fault", "where", "valid"),
    [
        ("dropout", "faults[0]: invalid 'dropout'", "keys kind, topic"),
        ({"topic": "/foot_l/imu", "at_s": 1}, "faults[0]", "keys kind, topic"),
        (
            {"kind": "dropuot", "topic": "/foot_l/imu", "at_s": 1},
            "faults[0].kind: invalid 'dropuot'",
            "mean 'dropout'?",
        ),
        ({"kind": ["nan"], "topic": "/foot_l/imu", "at_s": 1}, "faults[0].kind: invalid ['nan']", "dropout"),
        ({"kind": "nan", "at_s": 1}, "faults[0].topic: missing", "expected"),
        ({"kind": "nan", "topic": "/foot_l/imu"}, "faults[0]: invalid []", "either at_s or rate_per_min"),
        ({"kind": "nan", "topic": "/foot_l/imu", "at_s": 1, "rate_per_min": 2, "duration_s": 1}, "faults[0]", "either"),
        ({"kind": "nan", "topic": "/foot_l/imu", "rate_per_min": 2}, "faults[0].duration_s: missing", "expected"),
        ({"kind": "nan", "topic": "/foot_l/imu", "at_s": -1}, "faults[0].at_s: invalid -1", "0-36000"),
        (
            {"kind": "nan", "topic": "/foot_l/imu", "at_s": 1, "delay_s": 1},
            "faults[0]: invalid 'delay_s'",
            "keys kind, topic",
        ),
        (
            {"kind": "nan", "topic": "/foot_l/camera", "at_s": 1},
            "faults[0].topic: invalid '/foot_l/camera'",
            "/foot_l/imu",
        ),
        ({"kind": "clock_jump", "topic": "/foot_l/imu", "at_s": 1}, "faults[0].jump_s: missing", "expected"),
        (
            {"kind": "saturation", "topic": "/foot_l/imu", "at_s": 1, "fraction": 2},
            "faults[0].fraction: invalid 2",
            "0.001-1",
        ),
        (
            {"kind": "interpolated", "topic": "/foot_l/imu", "at_s": 1, "packet_samples": 0},
            "faults[0].packet_samples: invalid 0",
            "1-100",
        ),
        (
            {"kind": "interpolated", "topic": "/foot_l/insole", "at_s": 1, "above_deg_s": 90},
            "faults[0].topic: invalid '/foot_l/insole'",
            "/foot_l/imu",
        ),
        (
            {"kind": "dead_cell", "topic": "/foot_l/insole", "at_s": 1, "cell": "arch"},
            "faults[0].cell: invalid 'arch'",
            "heel",
        ),
        (
            {"kind": "offset", "topic": "/foot_l/insole", "at_s": 1, "offset_deg": 2},
            "faults[0].topic: invalid '/foot_l/insole'",
            "/exo/knee_l/encoder",
        ),
        (
            {"kind": "miscalibration", "topic": "/foot_l/imu", "at_s": 1},
            "faults[0]: invalid 'at_s'",
            "keys kind, topic",
        ),
        (
            {"kind": "miscalibration", "topic": "/foot_l/imu", "clock_offset_s": 0.01},
            "faults[0].topic: invalid '/foot_l/imu'",
            "expected /foot_l/camera, /foot_r/camera, /head/color",
        ),
        ({"kind": "miscalibration", "topic": "/foot_l/imu", "rotation_deg": [1, 2]}, "faults[0].rotation_deg", ""),
        (
            {"kind": "miscalibration", "topic": "/exo/knee_l/encoder", "thigh_mm": 500},
            "faults[0].thigh_mm: invalid 500",
            "-200 to 200",
        ),
        ({"kind": "restart", "topic": "/head/imu", "at_s": 1}, "faults[0].topic: invalid '/head/imu'", "/poses"),
        ({"kind": "exchange", "topic": "/head/imu"}, "faults[0].topic: invalid '/head/imu'", "/foot_l/imu"),
        ({"kind": "dropout", "topic": "/foot_l/imu", "at_s": 1, "share": 0}, "faults[0].share: invalid 0", "0.001-1"),
        ({"kind": "passer_by", "topic": "/head/*", "at_s": 1, "share": 1}, "faults[0].share: invalid 1", "0.01-0.9"),
        (
            {"kind": "depth_noise", "topic": "/head/color", "at_s": 1},
            "faults[0].topic: invalid '/head/color'",
            "/head/depth",
        ),
        ({"kind": "high_view", "topic": "/head/depth", "at_s": 1, "range_m": 0}, "faults[0].range_m: invalid 0", "0.1"),
        (
            {"kind": "mirror_floor", "topic": "/head/depth", "at_s": 1, "holes": 0.9},
            "faults[0].holes: invalid 0.9",
            "0-0.5",
        ),
        (
            {"kind": "saturation", "topic": "/foot_l/imu", "at_s": 1, "gyroscope_deg_s": 0},
            "faults[0].gyroscope_deg_s: invalid 0",
            "0.1",
        ),
    ],
)
def test_a_bad_fault_is_refused_with_what_is_valid(tmp_path, fault, where, valid):
    path = written(tmp_path, [fault])
    with pytest.raises(ConfigError) as error:
        read_scenario(path)
    message = str(error.value)
    assert message.startswith(f"{path}: {where}")
    assert valid in message
    assert "\n" not in message


def test_a_run_with_every_fault_reports_them_and_scores_what_is_left(simulator, tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["run", str(written(tmp_path, EVERY)), "--no-film", "-o", str(folder), "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)["estimators"]
    assert all(scores[f"{name}_{side}"]["coverage_pct"] > 90 for name in ("foot_ins", "foot_to_foot") for side in "lr")
    recording = Recording(folder / "recording.mcap", lenient=True)
    injected = read_injected_faults(recording.metadata)
    # the stand-in for the twin carries no IMU at the head, and so no strap that holds one
    assert {f.kind for f in injected} == {f["kind"] for f in EVERY} - {"loose_strap"}
    assert next(f for f in injected if f.kind == "nan").topic == "/foot_r/imu"
    assert recording.rig.imu("/foot_l/imu").gyroscope_range == pytest.approx(np.radians(300))
    assert json.loads(recording.metadata["pose_restarts"]) == [[3e9, 3.5e9, np.radians(60), 3, -2, 0.5]]
    document = json.loads((folder / "scores.json").read_text())
    assert document["recordings"][0]["faults"] == [vars(f) for f in injected]
    report = (folder / "report.html").read_text()
    assert "Injected faults" in report
    assert any("fault: late" in shown.labels for shown in figures(report).values())


def errors(said: str) -> list[str]:
    """Lines that are neither progress nor a warning."""
    return [x for x in said.splitlines() if not x.endswith("...") and not x.startswith("stridetwin: warning:")]


REFUSED = ("repeat", "nan", "out_of_order", "clock_jump")  # unless read leniently; one walk has all the others
ALONE = [[f] for f in EVERY if f["kind"] in REFUSED]


@pytest.mark.parametrize(
    "faults", [*ALONE, [f for f in EVERY if f["kind"] not in REFUSED]], ids=lambda fs: "+".join(f["kind"] for f in fs)
)
def test_every_command_survives_every_fault(simulator, tmp_path, capsys, faults):
    """Each estimates, or says in one line what stops it; read leniently each goes through."""
    recording, out = tmp_path / "a.mcap", tmp_path / "out.txt"
    assert main(["generate", str(written(tmp_path, faults)), "-o", str(recording)]) == 0
    commands = (
        ["estimate", "foot_ins", str(recording), "-o", str(out)],
        ["score", str(recording)],
        ["export", str(recording), "--format", "tum", "-o", str(out)],
    )
    capsys.readouterr()
    for command in commands:
        if main(command) != 0:
            said = errors(capsys.readouterr().err)
            assert len(said) == 1
            topics = [fault["topic"].replace("*", "") for fault in faults]
            assert "--lenient" in said[0] or any(t in said[0].replace("foot_r", "foot_") for t in topics)
            assert faults[0]["kind"] in REFUSED
        assert main([*command, "--lenient"]) == 0


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "dropout", "topic": "/foot_l/imu", "at_s": 0}, "no topic '/foot_l/imu'"),
        ({"kind": "nan", "topic": "/foot_l/imu", "at_s": 0}, "no topic '/foot_l/imu'"),
        ({"kind": "saturation", "topic": "/foot_l/imu", "at_s": 0, "fraction": 0.001}, ""),
        ({"kind": "freeze", "topic": "/foot_l/imu", "at_s": 0}, ""),
    ],
)
def test_a_stream_that_is_gone_or_worthless_is_reported_in_one_line(simulator, tmp_path, capsys, fault, words):
    scenario, recording = str(written(tmp_path, [fault])), tmp_path / "a.mcap"
    assert main(["generate", scenario, "-o", str(recording)]) == 0
    capsys.readouterr()
    code = main(["estimate", "foot_ins", str(recording), "--lenient", "-o", str(tmp_path / "out.txt")])
    said = capsys.readouterr().err
    assert code == (2 if words else 0)
    assert words in said
    assert len(errors(said)) <= 1
    assert main(["run", scenario, "--no-film", "--no-cameras", "-o", str(tmp_path / "run")]) == 0


def test_a_walk_without_faults_reports_none(simulator, tmp_path):
    recording = tmp_path / "a.mcap"
    assert main(["generate", "level_20m", "-o", str(recording)]) == 0
    assert "faults" not in Recording(recording).metadata


def test_a_fault_after_the_end_of_the_walk_is_refused(simulator, tmp_path, capsys):
    path = written(tmp_path, [{"kind": "nan", "topic": "/foot_l/imu", "at_s": 500}])
    assert main(["generate", str(path), "-o", str(tmp_path / "a.mcap")]) == 2
    assert "faulty: faults[0].at_s: invalid 500.0: expected 0-8.6, the length of the walk" in capsys.readouterr().err
    assert not (tmp_path / "a.mcap").exists()
