"""docs/own_estimator.md: its package installs, and every command of the project knows its estimator."""

import importlib
import json
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from stridetwin.cli.main import main
from stridetwin.streams.recording.reader import Recording

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "own_estimator.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```$', PAGE, re.M | re.S))


@pytest.fixture
def installed(tmp_path, monkeypatch):
    source, site = tmp_path / "source", tmp_path / "site"
    source.mkdir()
    for name, text in FILES.items():
        (source / name).write_text(text, encoding="utf-8")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(site)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(source)], check=True)
    monkeypatch.syspath_prepend(str(site))
    yield
    sys.modules.pop("my_tilt", None)
    importlib.invalidate_caches()


def printed(capsys, *words):
    capsys.readouterr()
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_package_of_the_page_takes_part(installed, walk, capsys, tmp_path):
    assert set(FILES) == {"pyproject.toml", "my_tilt.py"}
    assert printed(capsys, "list")["estimators"]["my_tilt"] == "Tilt of a foot, from gravity alone"
    words = re.search(r"^\$ stridetwin (score walk.mcap --only my_tilt --set .*)$", PAGE, re.M)[1].split()
    words[1] = walk / "recording.mcap"
    changed = printed(capsys, *words)
    assert set(changed["estimators"]) == {"my_tilt_l", "my_tilt_r"}
    assert changed["parameters"] == {"my_tilt": {"smoothing": 0.1}}
    usual = printed(capsys, *words[: words.index("--set")])
    assert usual["estimators"]["my_tilt_l"].keys() == changed["estimators"]["my_tilt_l"].keys()
    assert main(["score", str(words[1]), "--set", "my_tilt.smooth=0.1"]) == 2
    assert "--set: my_tilt.smooth: invalid 'smooth': expected smoothing" in capsys.readouterr().err


def test_the_page_of_the_foot_s_estimator_teaches_calls_that_exist(walk):
    page = (ROOT / "docs" / "foot_ins.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S)
    recording = Recording(walk / "recording.mcap")
    block = recording.block("/foot_l/imu")
    values = {"rig": recording.rig, "samples": list(block)[:200], "block": block}
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        exec(code, values)
    assert len(values["path"].trajectory) == len(block)
