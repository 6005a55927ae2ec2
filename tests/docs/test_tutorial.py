"""docs/tutorial.md, word for word, beside packages with the names of ours, outside the repository."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools.tutorial import PAGE, blocks

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tutorial")
    return subprocess.run(
        [sys.executable, ROOT / "tools" / "tutorial.py", "--folder", folder],
        env=os.environ | {"PYTHONPATH": str(ROOT / "typing")},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=1800,
    )


def test_every_command_of_the_tutorial_works(done):
    assert done.returncode == 0, done.stdout + done.stderr
    said = [line[2:] for line in done.stdout.splitlines() if line.startswith("$ ")]
    commands = [command for block in blocks(PAGE.read_text(encoding="utf-8")) for command in block.commands]
    assert said == [command for command in commands if not command.startswith("pip install")]
    assert "1 passed" in done.stdout


def test_the_tutorial_s_estimator_is_short_and_not_bad(done):
    files = {block.file: block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.file}
    estimator = files["my_foot.py"]
    assert sum(bool(line.strip()) for line in estimator.splitlines()) <= 30
    assert "stridetwin.estimators" not in estimator  # its own work, none of ours
    assert "is deprecated" not in done.stdout + done.stderr
    (end_m, end_pct), *_ = re.findall(r"^mine +(\S+) +(\S+)", done.stdout, re.M)
    assert float(end_pct) < 2.5
    assert float(end_m) < 0.5


def test_the_tutorial_shows_what_score_says(done):
    shown, compared = [block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.language == "text"]
    assert compared in done.stdout
    printed = done.stdout[done.stdout.index("\nestimator  ") :].splitlines()[1:3]
    assert shown.splitlines()[0].split() == printed[0].split()
    for ours, theirs in zip(shown.splitlines()[1].split()[1:], printed[1].split()[1:], strict=True):
        if ours != "-":
            assert float(ours) == pytest.approx(float(theirs), rel=0.1, abs=0.01)  # another machine rounds otherwise
