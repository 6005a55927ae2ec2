import json
import os
import re
import subprocess
import sys
from contextlib import redirect_stdout
from importlib.metadata import version
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from fake_twin import FakeTwin

from stridetwin.cli.main import main
from stridetwin.report import runner
from stridetwin.scenarios import record
from stridetwin.streams.formats.imu_table import read_imu_table
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.samples import Imu

COMMANDS = (
    "run",
    "list",
    "generate",
    "check",
    "import",
    "export",
    "estimate",
    "live",
    "send",
    "score",
    "history",
    "experiment",
    "place",
    "view",
)
FILES = {"recording.mcap", "scores.json", "report.html", "run.rrd", "foot_ins_l.txt", "foot_ins_r.txt"}
FILES |= {"foot_ins_l.calibration.json", "foot_ins_r.calibration.json"}
FILES |= {"foot_to_foot_l.txt", "foot_to_foot_r.txt", "gait_phase_l.csv", "gait_phase_r.csv"}


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """Folder of a run without cameras or film, of another seed than `walk`; what it said is in `said.json`."""
    folder, said = tmp_path_factory.mktemp("other"), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said):
        for module in (record, runner):
            patch.setattr(module, "make_twin", lambda scenario, seed: FakeTwin(scenario.config, seed))
        words = ["run", "level_20m", "--seed", "4", "--no-cameras", "--no-film", "--json", "-o", str(folder / "walk")]
        assert main(words) == 0
    (folder / "said.json").write_text(said.getvalue())
    return folder


def call(capsys, *words):
    """Exit code, what stdout says, what stderr says."""
    code = main([str(w) for w in words])
    said = capsys.readouterr()
    return code, said.out, said.err


def failed(capsys, *words):
    """The one error line of a command that must fail."""
    code, out, err = call(capsys, *words)
    errors = [line for line in err.splitlines() if not line.endswith(" ...")]
    assert (code, out, len(errors)) == (2, "", 1), err
    assert errors[0].startswith("stridetwin: error: ")
    return errors[0]


@pytest.mark.parametrize("command", [(), *[(c,) for c in COMMANDS]])
def test_every_command_has_help(capsys, command):
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    assert "Usage: stridetwin" in capsys.readouterr().out


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert (stop.value.code, capsys.readouterr().out) == (0, f"stridetwin {version('stridetwin')}\n")


def test_run_leaves_every_file_and_says_where_the_report_is(walk):
    assert {p.name for p in walk.iterdir()} == FILES
    scores = json.loads((walk / "scores.json").read_text())
    assert set(scores["estimators"]) == {
        f"{name}_{side}" for name in ("foot_ins", "foot_to_foot", "gait_phase") for side in "lr"
    }
    assert scores["estimators"]["foot_ins_l"]["end_error_m"] < 0.1
    metadata = Recording(walk / "recording.mcap").metadata
    assert (metadata["scenario"], metadata["seed"]) == ("level_20m", "3")


def test_equal_seeds_give_equal_bytes_and_others_do_not(walk, other, simulator, capsys, tmp_path):
    call(capsys, "run", "level_20m", "--seed", 3, "-o", tmp_path)
    for name in ("scores.json", "recording.mcap", "foot_ins_l.txt", "report.html"):
        first, same, changed = ((folder / name).read_bytes() for folder in (walk, tmp_path, other / "walk"))
        assert same == first
        assert changed != first
    for topic in ("/foot_l/imu", "/foot_r/imu"):
        felt, changed = (Recording(f / "recording.mcap").block(topic).columns for f in (walk, other / "walk"))
        assert all((felt[name] != changed[name]).any() for name in felt)


def test_json_is_one_object_and_nothing_else_on_stdout(other, capsys):
    data = json.loads((other / "said.json").read_text())
    assert set(data["files"]) == FILES
    assert "/head/color" not in Recording(other / "walk" / "recording.mcap").topics
    _, out, _ = call(capsys, "list", "--json")
    assert "demo" in json.loads(out)["scenarios"]
    assert json.loads(out)["people"]["shim_s6"]["height_m"] == 1.61


def test_the_command_line_starts_without_heavy_libraries():
    heavy = {"mujoco", "numba", "scipy", "cv2", "rosbags", "pandas", "rerun"}
    code = f"import sys, stridetwin.cli.main; sys.exit(', '.join({heavy} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_list_names_scenarios_estimators_and_sensors(capsys):
    code, out, err = call(capsys, "list")
    assert (code, err) == (0, "")
    assert all(word in out for word in ("stair_up_down", "stairs_and_ramps", "foot_ins", "head_camera", "ADIS16485"))
    assert "exo_imu (off by default)" in out
    assert all(Path(folder).is_dir() for folder in json.loads(call(capsys, "list", "--json")[1])["folders"].values())


@pytest.mark.parametrize(
    ("start", "unused"),
    [
        (
            "from stridetwin.cli.main import main; main(['list'])",
            {"mujoco", "numba", "scipy", "numpy", "cv2", "stridetwin.sim.config", "stridetwin.sim.parts.kinds"},
        ),
        ("import stridetwin.sim.twin", {"scipy.signal", "scipy.stats"}),
        ("import stridetwin.scenarios.scenario_file", {"numba", "scipy"}),
    ],
)
def test_what_is_slow_to_import_is_imported_when_it_is_needed(start, unused):
    code = f"import sys; {start}; sys.exit(', '.join({unused} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_generate_writes_a_recording_alone(simulator, capsys, tmp_path):
    path = tmp_path / "deep" / "walk.mcap"
    assert call(capsys, "generate", "level_20m", "--no-cameras", "-o", path)[0] == 0
    assert "/foot_l/imu" in Recording(path).topics
    assert [p.name for p in path.parent.iterdir()] == ["walk.mcap"]


def test_only_says_what_it_does_in_each_command(capsys):
    for command, says in (("run", "simulate only the sensors"), ("score", "Score only this estimator")):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert says in " ".join(re.sub(r"[^\w ]", "", capsys.readouterr().out).split())


@pytest.mark.parametrize("command", [("generate", "level_20m"), ("import", "x.csv"), ("live", "--record")])
def test_a_recording_is_no_bag(capsys, tmp_path, command):
    words = (*command, tmp_path / "w.bag") if command[0] == "live" else (*command, "-o", tmp_path / "w.bag")
    line = failed(capsys, *words)
    assert line.endswith("expected a file that ends in .mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_table_comes_back_with_a_pose_a_row(walk, capsys, tmp_path, suffix):
    table, path = tmp_path / f"imu{suffix}", tmp_path / "path.txt"
    call(capsys, "export", walk / "recording.mcap", "--format", "table", "--frame", "foot_r/imu", "-o", table)
    block = Recording(walk / "recording.mcap").block("/foot_r/imu")
    back = read_imu_table(table)
    assert np.array_equal(back.t_ns, block.t_ns)
    assert back.columns["angular_rate"] == pytest.approx(block.columns["angular_rate"], rel=1e-8)
    assert call(capsys, "estimate", "foot_ins", table, "-o", path)[0] == 0
    assert len(read_tum(path)) == len(block)


def test_exported_truth_scores_zero(walk, capsys, tmp_path):
    path = tmp_path / "truth.txt"
    recording = walk / "recording.mcap"
    call(capsys, "export", recording, "--format", "tum", "--frame", "foot_l/imu", "-o", path)
    code, out, _ = call(capsys, "score", recording, "--estimate", f"truth={path}", "--json")
    scores = json.loads(out)["estimators"]["truth"]
    assert code == 0
    assert scores["ape_max_m"] < 1e-6


def test_an_estimate_made_alone_is_the_one_that_run_made(walk, capsys, tmp_path):
    path = tmp_path / "left.txt"
    call(capsys, "estimate", "foot_ins", walk / "recording.mcap", "--foot", "l", "-o", path)
    assert path.read_bytes() == (walk / "foot_ins_l.txt").read_bytes()


def test_a_lag_smooths_the_same_poses(walk, capsys, tmp_path):
    plain, smooth = walk / "foot_ins_l.txt", tmp_path / "smooth.txt"
    assert call(capsys, "estimate", "foot_ins", walk / "recording.mcap", "--lag", "1", "-o", smooth)[0] == 0
    a, b = np.loadtxt(plain), np.loadtxt(smooth)
    np.testing.assert_array_equal(a[:, 0], b[:, 0])
    assert 0.0 < np.abs(a[:, 1:4] - b[:, 1:4]).max() < 0.1
    said = failed(capsys, "estimate", "foot_to_foot", walk / "recording.mcap", "--lag", "1", "-o", smooth)
    assert "--lag is only valid for foot_ins" in said
    for word, names in (("--poses", "terrain_map, locomotion_mode"), ("--exoskeleton", "contact_terrain")):
        said = failed(capsys, "estimate", "foot_ins", walk / "recording.mcap", word, "nothing.txt", "-o", smooth)
        assert f"{word} is only valid for {names}" in said


def test_score_agrees_with_run_and_holds_its_baseline(walk, capsys, tmp_path):
    recording, baseline = walk / "recording.mcap", tmp_path / "base.json"
    code, out, _ = call(capsys, "score", recording, recording, "--json")
    scores = json.loads(out)
    assert code == 0
    assert scores["estimators"] == json.loads((walk / "scores.json").read_text())["estimators"]
    assert len(scores["recordings"]) == 2
    baseline.write_text(out)
    assert call(capsys, "score", recording, "--baseline", baseline)[0] == 0


def test_score_reports_what_has_become_worse(walk, capsys, tmp_path):
    baseline = tmp_path / "base.json"
    words = ("score", walk / "recording.mcap", "--estimate", f"foot_ins_l={walk / 'foot_ins_l.txt'}")
    scores = json.loads(call(capsys, *words, "--json")[1])
    for reported in (scores, *scores["recordings"]):
        reported["estimators"]["foot_ins_l"]["ape_rmse_m"] = 1e-4
    baseline.write_text(json.dumps(scores))
    code, out, _ = call(capsys, *words, "--baseline", baseline)
    assert code == 1
    assert re.search(r"foot_ins_l +ape_rmse_m", out)
    code, out, _ = call(capsys, *words, "--baseline", baseline, "--json")
    assert code == 1
    assert json.loads(out)["regressions"][0]["metric"] == "ape_rmse_m"


def test_view_says_what_to_open_without_a_display(walk, capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    path = tmp_path / "walk.rrd"
    code, out, _ = call(capsys, "view", walk / "recording.mcap", "-o", path)
    assert code == 0
    assert f"rerun {path}" in out
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run", "level_20"), "did you mean 'level_20m'?"),
        (("generate", "none.yaml", "-o", "x.mcap"), "none.yaml: cannot be read"),
        (("score", "none.mcap"), "none.mcap: cannot be read"),
        (("estimate", "foot_ins", "none.csv", "-o", "x.txt"), "none.csv: cannot be read"),
        (("view", "none.mcap"), "none.mcap: cannot be read"),
    ],
)
def test_missing_inputs_are_reported_in_one_line(capsys, words, said):
    assert said in failed(capsys, *words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run", "{}.yaml"), "cannot be read"),
        (("generate", "level_20m", "-o", "{}_rows.csv/walk.mcap"), "_rows.csv"),
        (("score", "{}.mcap"), "cannot be read"),
        (("check", "{}.bag"), "cannot be read"),
        (("estimate", "foot_ins", "{}.csv", "-o", "x.txt"), "cannot be read"),
        (("estimate", "foot_ins", "{}_rows.csv", "-o", "x.txt"), "expected"),
        (("run", "{}_keys.yaml"), "missing"),
    ],
)
def test_a_line_break_in_the_name_of_a_file_is_an_escape_in_its_error(capsys, tmp_path, words, said):
    (tmp_path / "two\nlines_rows.csv").write_text("no,table\n1,2\n")
    (tmp_path / "two\nlines_keys.yaml").write_text("description: a\n")
    line = failed(capsys, *(word.format(tmp_path / "two\nlines") for word in words))
    assert f"{tmp_path}/two\\nlines" in line
    assert said in line


@pytest.mark.parametrize(
    "words",
    [
        ("walk",),
        ("walk", "two\nlines"),
        ("run", "demo", "--two\nlines"),
        ("run",),
        ("run", "demo", "--seed", "-1"),
        ("run", "demo", "--physics", "ragdoll"),
        ("score", "a", "--tolerance", "x"),
        ("score", "a", "--workers", "9" * 20),
        (),
    ],
)
def test_bad_arguments_are_reported_in_one_line(capsys, words):
    with pytest.raises(SystemExit) as stop:
        main(list(words))
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith("stridetwin: error: ")
    assert err.count("\n") == 1


def test_a_bad_scenario_leaves_the_old_files_alone(simulator, capsys, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("description: a\nterrain:\n  - level: {length_m: 5}\n  - stairs: {risers: 3, riser_mm: 500}\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "scores.json").write_text("old")
    line = failed(capsys, "run", bad, "-o", tmp_path / "out")
    assert line.endswith(f"{bad}: terrain[1].stairs.direction: missing: expected this key")
    assert (tmp_path / "out" / "scores.json").read_text() == "old"


def test_a_run_that_fails_half_way_leaves_the_old_files_alone(simulator, capsys, tmp_path, monkeypatch):
    def broken(*_):
        raise OSError(28, "No space left on device", "report.html")

    monkeypatch.setattr("stridetwin.report.run_report.render_report", broken)
    (tmp_path / "scores.json").write_text("old")
    assert "No space left" in failed(capsys, "run", "level_20m", "--no-film", "--no-cameras", "-o", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["scores.json"]
    assert (tmp_path / "scores.json").read_text() == "old"


def test_a_cut_off_recording_is_refused_or_read_as_far_as_it_goes(walk, capsys, tmp_path):
    cut, path = tmp_path / "cut.mcap", tmp_path / "path.txt"
    whole = (walk / "recording.mcap").read_bytes()
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    path.write_text("old")
    line = failed(capsys, "estimate", "foot_ins", cut, "-o", path)
    assert "cut off" in line
    assert "--lenient" in line
    assert path.read_text() == "old"
    assert call(capsys, "estimate", "foot_ins", cut, "--lenient", "-o", path)[0] == 0
    assert len(read_tum(path)) > 100


def rewritten(source, target, change):
    """A copy of a recording, its blocks changed or left out."""
    recording = Recording(source)
    with RecordingWriter(target, recording.rig, recording.metadata) as writer:
        for topic in recording.topics:
            if "/head/" not in topic and (block := change(recording.block(topic))) is not None:
                writer.write(block)
    return target


def test_a_missing_topic_is_reported_with_the_existing_ones(walk, capsys, tmp_path):
    path, out = tmp_path / "no_left.mcap", tmp_path / "path.txt"
    rewritten(walk / "recording.mcap", path, lambda b: None if b.topic == "/foot_l/imu" else b)
    line = failed(capsys, "estimate", "foot_ins", path, "--foot", "l", "-o", out)
    assert "no topic '/foot_l/imu'" in line
    assert "/foot_r/imu" in line
    assert not out.exists()
    line = failed(capsys, "export", path, "--format", "tum", "--frame", "knee", "-o", out)
    assert "no truth of frame 'knee'; it has foot_l/imu, foot_r/imu" in line
    line = failed(capsys, "export", path, "--format", "table", "--frame", "foot_l/imu", "-o", out)
    assert "(did you mean 'foot_r/imu'?)" in line


def test_a_sample_that_is_not_a_number_is_refused_or_left_out(walk, capsys, tmp_path):
    def spoil(block):
        if block.kind is Imu:
            block.columns["angular_rate"][500, 1] = np.nan
        return block

    path, out = tmp_path / "nan.mcap", tmp_path / "path.txt"
    rewritten(walk / "recording.mcap", path, spoil)
    assert "/foot_" in failed(capsys, "estimate", "foot_ins", path, "-o", out)
    assert not out.exists()
    assert call(capsys, "estimate", "foot_ins", path, "--lenient", "-o", out)[0] == 0
    assert np.isfinite(read_tum(out).p_frame_in_world).all()


def test_without_truth_there_is_an_estimate_but_no_score(walk, capsys, tmp_path):
    path = tmp_path / "real.mcap"
    rewritten(walk / "recording.mcap", path, lambda b: None if b.topic.startswith("/truth") else b)
    assert call(capsys, "estimate", "foot_ins", path, "-o", tmp_path / "path.txt")[0] == 0
    assert "no truth of frame 'foot_l/imu'; it has none" in failed(capsys, "score", path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--estimate", "mine"), "expected NAME=FILE"),
        (("--estimate", "mine=none.txt"), "none.txt: cannot be read"),
        (("--baseline", "none.json"), "none.json: No such file"),
    ],
)
def test_bad_files_beside_a_score_are_reported_in_one_line(walk, capsys, words, said):
    assert said in failed(capsys, "score", walk / "recording.mcap", *words)


def test_the_hardware_commands_do_without_the_simulator_and_the_viewer(walk, tmp_path):
    code = (
        "import sys\n"
        "for name in ('mujoco', 'rerun', 'dm_control', 'trimesh'): sys.modules[name] = None\n"
        "from stridetwin.cli.main import main\n"
        f"r, o = {str(walk / 'recording.mcap')!r}, {str(tmp_path / 'path.txt')!r}\n"
        "assert main(['score', r]) == 0\n"
        "assert main(['export', r, '--format', 'tum', '-o', o]) == 0\n"
        "assert main(['view', r]) == 2\n"
        "assert main(['run', 'level_20m']) == 2\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert "pip install '.[view]'" in done.stderr
    assert "pip install '.[twin]'" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("words", [["list"], ["list", "--json"]])
def test_a_reader_that_leaves_early_ends_a_command_quietly(words):
    read, write = os.pipe()
    os.close(read)  # as `head` does once it has its lines
    code = f"from stridetwin.cli.main import main; raise SystemExit(main({words}))"
    done = subprocess.run([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")
