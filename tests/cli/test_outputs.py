"""What a command writes never takes the place of what it reads."""

import numpy as np
import pytest

from stridetwin.cli.main import main, parse
from stridetwin.cli.options import check_outputs


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a table of an IMU at rest, a scenario and a history's file."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(600) / 120.0
    rest = np.tile([0.0, 0.0, 9.81], (600, 1))
    np.savez(tmp_path / "imu.npz", t=t, accel=rest, gyro=np.zeros((600, 3)))
    (tmp_path / "s.yaml").write_text("description: Short\nterrain: [{level: {length_m: 2}}]\nsensors: [foot_imu]\n")
    (tmp_path / "h.jsonl").write_text('{"label": "a"}\n')
    (tmp_path / "b.json").write_text("{}")
    (tmp_path / "folder").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("estimate foot_ins imu.npz -o imu.npz", "estimate -o: invalid 'imu.npz'"),
        ("estimate foot_ins imu.npz -o folder/../imu.npz", "estimate -o: invalid 'folder/../imu.npz'"),
        ("import imu.npz -o imu.npz", "import -o: invalid 'imu.npz'"),
        ("export imu.npz --format table -o imu.npz", "export -o: invalid 'imu.npz'"),
        ("generate s.yaml -o s.yaml", "generate -o: invalid 's.yaml'"),
        ("view imu.npz -o imu.npz", "view -o: invalid 'imu.npz'"),
        ("history h.jsonl -o h.jsonl", "history -o: invalid 'h.jsonl'"),
        ("score imu.npz --baseline b.json --junit b.json", "score --junit: invalid 'b.json'"),
        ("score imu.npz --baseline b.json --junit imu.npz", "score --junit: invalid 'imu.npz'"),
        ("score imu.npz --history imu.npz --label a", "score --history: invalid 'imu.npz'"),
        ("score imu.npz --estimate mine=h.jsonl --history h.jsonl --label a", "score --history: invalid 'h.jsonl'"),
        ("score imu.npz --baseline b.json --junit x --markdown x", "score --markdown: invalid 'x'"),
    ],
)
def test_an_output_that_is_read_or_written_for_something_else_is_refused(here, capsys, words, said):
    before = {p: p.read_bytes() for p in here.iterdir() if p.is_file()}
    assert main(words.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"error: {said}: expected a file that is not also an input or another output" in line
    assert {p: p.read_bytes() for p in here.iterdir() if p.is_file()} == before


@pytest.mark.parametrize("name", ["folder", ".", "/"])
@pytest.mark.parametrize(
    "words",
    [
        "estimate foot_ins imu.npz -o",
        "estimate foot_to_foot imu.npz -o",
        "import imu.npz -o",
        "generate s.yaml -o",
        "view imu.npz -o",
        "history h.jsonl -o",
        "live --record",
        "live foot_ins -o",
        "score imu.npz --baseline b.json --markdown",
    ],
)
def test_a_file_cannot_be_written_where_a_folder_is(here, capsys, words, name):
    assert main([*words.split(), name]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"invalid {name!r}: expected the name of a file, where there is no folder" in line
    assert not list(here.glob(".*"))


def test_a_file_in_a_folder_that_is_not_there_is_refused_before_anything_is_done(here, capsys):
    assert main(["estimate", "foot_ins", "imu.npz", "-o", "no/path.txt"]) == 2
    assert "no does not exist" in capsys.readouterr().err
    assert main(["import", "imu.npz", "-o", "new/walk.mcap"]) == 0  # makes it, as generate does


def test_a_scenario_may_be_called_as_the_folder_of_its_run(here):
    (here / "demo").mkdir()
    call = parse(["run", "demo", "-o", "demo"])
    check_outputs(call.command, call.options)
