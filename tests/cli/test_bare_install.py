"""`pip install .` is what goes onto a robot: every estimator on a recording where no extra can be imported."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from stridetwin.streams.errors import EXTRA_OF, install_hint
from tools.without_extras import EXTRAS

ROOT = Path(__file__).parents[2]
MADE = {
    "foot_ins": ["o.txt"],
    "foot_to_foot": ["o_l.txt", "o_r.txt"],
    "contact_terrain": ["o.csv"],
    "dvio": ["o.txt"],
    "terrain_map": ["o.json", "o.ply"],
    "locomotion_mode": ["o.csv"],
}
NAMES = {
    "dm-control": "dm_control",
    "rerun-sdk": "rerun",
    "scikit-learn": "sklearn",
    "eclipse-zenoh": "zenoh",
    "open3d-cpu": "open3d",
}


def test_what_is_blocked_is_what_the_extras_bring():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in set(project["optional-dependencies"]) - {"dev", "docs"}:
        for requirement in project["optional-dependencies"][extra]:
            name = requirement.split(">")[0].split("[")[0].strip()
            if name != "stridetwin":  # an extra that takes another one with it
                assert NAMES.get(name, name.replace("-", "_")) in EXTRAS


def test_every_blocked_library_has_a_hint_with_its_extra_and_the_readme_lists_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    assert set(EXTRA_OF) == EXTRAS
    assert set(EXTRA_OF.values()) == set(extras) - {"dev", "docs"}
    for extra in set(extras) - {"dev", "docs"}:
        for requirement in extras[extra]:
            name = requirement.split(">")[0].split("[")[0].strip()
            if name != "stridetwin":
                assert EXTRA_OF[NAMES.get(name, name.replace("-", "_"))] == extra
    table = (ROOT / "README.md").read_text(encoding="utf-8").split("| extra | adds |")[1].split("\n\n")[0]
    assert set(re.findall(r"`([\w-]+)`(?=[, |])", table)) >= set(extras) - {"dev", "docs"}


@pytest.fixture(scope="module")
def estimates(seen, tmp_path_factory):
    """What each estimator writes of one recording, all by one process, as a start takes seconds."""
    folder = tmp_path_factory.mktemp("bare")
    commands = []
    for name, files in MADE.items():
        (folder / name).mkdir()
        commands.append(["estimate", name, str(seen), "-o", str(folder / name / files[0].replace("_l", ""))])
    script = (
        "import json, sys; from tools.without_extras import EXTRAS, main as bare;"
        "commands = json.loads(sys.argv.pop()); bare();"
        "from stridetwin.cli.main import main; codes = [main(words) for words in commands];"
        "assert not EXTRAS & set(sys.modules); sys.exit(max(codes))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps(commands)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    (folder / "said.txt").write_text(done.stdout)
    return folder


def test_streams_estimators_and_command_line_import(estimates):
    assert int((estimates / "said.txt").read_text().split()[0]) > 100


@pytest.mark.parametrize("name", MADE)
def test_an_estimator_runs_on_a_recording(name, estimates):
    for file in MADE[name]:
        assert (estimates / name / file).stat().st_size > 100
    if (paths := [f for f in MADE[name] if f.endswith(".txt")]) and name != "dvio":
        for file in paths:
            rows = [line.split() for line in (estimates / name / file).read_text().splitlines()[1:] if line[0] != "#"]
            end = [float(v) for v in rows[-1][1:4]]
            assert 0.3 < (end[0] ** 2 + end[1] ** 2) ** 0.5 < 1.5  # half a metre of way, and its last step
            assert abs(end[2]) < 0.1


def test_list_needs_no_extra_and_what_needs_the_simulator_says_so_in_one_line(tmp_path):
    commands = [
        ["list"],
        ["place", "shoe_sight", "-o", "x"],
        ["experiment", "assistance", "-o", "x"],
        ["scene", "demo", "-o", "x"],
        ["view", "demo", "--mujoco"],
        ["live", "--record", "x.mcap"],
        ["history", "x.jsonl", "-o", "x.html"],
        ["run", "level_20m"],
        ["view", "x.mcap"],
    ]
    script = (
        "import json, sys; from tools.without_extras import Nothing; sys.meta_path.insert(0, Nothing());"
        "from stridetwin.cli.main import main;"
        "print('', [main(words) for words in json.loads(sys.argv[1])])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps(commands)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == " [0, 2, 2, 2, 2, 2, 2, 2, 2]"
    assert "\nshoe_sight " in done.stdout
    lines = done.stderr.splitlines()
    assert [line.partition(" is not installed; ")[2] for line in lines] == [
        f"placements need the simulator: {install_hint('twin')}",
        f"the closed loop needs it: {install_hint('closed-loop')}",
        *[f"scenes need the simulator: {install_hint('twin')}"] * 2,
        f"live and send need it: {install_hint('live')}",
        f"pages need it: {install_hint('report')}",
        f"runs need the simulator and its reports: {install_hint('twin')}",
        f"the viewer needs it: {install_hint('view')}",
    ]
    assert list(tmp_path.iterdir()) == []
