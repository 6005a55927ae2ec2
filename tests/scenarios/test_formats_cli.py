"""`import` and `export` on the command line, and the estimators on what they read."""

import json

import numpy as np
import pytest

from benchmarks.foreign_files import FORMATS, Walk
from stridetwin.scenarios import cli
from stridetwin.scenarios.cli import main
from stridetwin.streams import opening
from stridetwin.streams.imu_table import read_imu_table
from stridetwin.streams.recording import Recording
from stridetwin.streams.tum import read_tum


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    return {name: write(folder, Walk()) for name, write in FORMATS.items()}


def test_the_help_names_every_kind():
    assert cli.KINDS == opening.KINDS


def call(capsys, *words):
    code = main([str(w) for w in words])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("name", list(FORMATS))
def test_everything_that_is_imported_opens_as_a_recording(sources, capsys, tmp_path, name):
    path = tmp_path / "deep" / "walk.mcap"
    code, out, err = call(capsys, "import", sources[name], "-o", path, "--json")
    data = json.loads(out)
    assert code == 0
    assert {t: i["samples"] for t, i in data["topics"].items()} == {
        t: i.count for t, i in Recording(path).topics.items()
    }
    assert all(f"stridetwin: warning: {sources[name]}: {w}" in err for w in data["warnings"])


def test_estimators_take_bags_and_folders_as_they_are(sources, capsys, tmp_path):
    path, table = tmp_path / "path.txt", tmp_path / "foot.csv"
    rng = np.random.default_rng(1)
    n = 400
    still = np.column_stack((np.arange(n) / 100, rng.normal((0, 0, 9.81), 0.02, (n, 3)), rng.normal(0, 0.002, (n, 3))))
    header = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    np.savetxt(table, still, delimiter=",", header=header, comments="", fmt="%.9g")
    recording = tmp_path / "still.mcap"
    call(capsys, "import", table, "--map", "/foot_l/imu=/foot_r/imu", "-o", recording)
    bag = tmp_path / "bag"
    assert call(capsys, "export", recording, "--format", "rosbag2", "--storage", "sqlite3", "-o", bag)[0] == 0
    code, _, err = call(capsys, "estimate", "foot_ins", bag, "--foot", "r", "-o", path)
    assert (code, len(read_tum(path))) == (0, n), err
    assert np.abs(read_tum(path).p_frame_in_world).max() < 0.05
    code, _, err = call(capsys, "estimate", "foot_ins", sources["euroc"], "-o", path)
    assert code == 2
    assert "no topic '/foot_l/imu'; it has /head/color, /head/imu" in err


def test_exports_of_an_imported_folder(sources, capsys, tmp_path):
    for name, form in (("euroc", "euroc"), ("tum", "tum"), ("euroc", "rosbag2")):
        code, out, _ = call(
            capsys, "export", sources[name], "--format", form, "-o", tmp_path / f"{name}_{form}", "--json"
        )
        assert code == 0
        assert json.loads(out)["rows"]
    table = tmp_path / "imu.csv"
    assert call(capsys, "export", sources["rosbag1"], "--format", "table", "--frame", "head/imu", "-o", table)[0] == 0
    assert len(read_imu_table(table)) == 200
    truth = tmp_path / "truth.txt"
    words = ("export", sources["rosbag1"], "--format", "tum", "--frame", "head", "-o", truth)
    assert call(capsys, *words)[0] == 0
    np.testing.assert_allclose(read_tum(truth).p_frame_in_world, Walk().p, atol=1e-8)


def test_a_taken_place_is_left_as_it_is(sources, capsys, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    code, _, err = call(capsys, "export", sources["euroc"], "--format", "euroc", "-o", tmp_path / "mine")
    assert code == 2
    assert "valid: a folder that is new or empty" in err
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--map", "imu"), "--map: 'imu' is not valid; valid: FROM=TO"),
        (("--as", "zip"), "--as: 'zip' is not valid; valid: mcap"),
        (("--as", "euroc"), "a folder in the ASL layout"),
        (("--depth-scale", "0"), "'0' is not valid; valid: a number above 0"),
        (("--rig", "nowhere.yaml"), "nowhere.yaml: cannot be read"),
    ],
)
def test_wrong_options_are_said_in_one_line(sources, capsys, tmp_path, words, says):
    try:
        code, _, err = call(capsys, "import", sources["tum"], "-o", tmp_path / "a.mcap", *words)
    except SystemExit as stop:
        code, err = stop.code, capsys.readouterr().err
    assert code == 2
    assert says in err
    assert len([line for line in err.splitlines() if "error:" in line]) == 1
    assert not (tmp_path / "a.mcap").exists()
