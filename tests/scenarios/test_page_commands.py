"""Every command of the README and of docs/: run, or where that takes minutes, read by its own parser."""

import argparse
import re
import runpy
import shlex
import tomllib

import numpy as np
import pytest
from fake_twin import FakeTwin
from live_bridge import outcome
from page_commands import PAGES, ROOT, fenced, in_text, name, rows_of_the_command_line, variants

from stridetwin.cli import main
from stridetwin.cli.commands import COMMANDS
from stridetwin.estimators import registry
from stridetwin.report import runner
from stridetwin.scenarios import record
from stridetwin.scenarios.built_in import experiments
from stridetwin.scenarios.campaign.campaign_file import campaigns
from stridetwin.scenarios.scenario_file import PHYSICS, catalogue
from stridetwin.streams.recording.reader import Recording
from stridetwin.studies.placement.problem_file import problems

WHOLE = {"docs/bring_your_own.md", "docs/hardware.md", "docs/own_estimator.md", "docs/tutorial.md"}
"""Pages that other tests do from end to end: test_bring_your_own_page, test_hardware_page, test_own_estimator_page,
test_tutorial."""

RUN = [
    "stridetwin list",
    "stridetwin estimate foot_ins my_foot_imu.npz -o path.txt",
    "stridetwin check ~/data/V1_01_easy",
    "stridetwin export walk.mcap --format rosbag2 -o walk_bag",
]
"""What is run here, on a stand-in's walk."""

READ = {
    "it installs what is missing and walks for minutes": ["make demo"],
    "they install, test or build for minutes": ["make setup", "make check", "make test", "make docs"],
    "a walk; test_cli does the same with a stand-in's": [
        "stridetwin generate level_20m --no-cameras -o walk.mcap",
        "stridetwin run level_20m --no-cameras -o runs/level",
    ],
    "minutes; test_cli runs, scores and compares a stand-in's walk by the same commands": [
        "stridetwin run stair_up_down --seed 7 -o runs/stair",
        "stridetwin score runs/stair/recording.mcap --json",
    ],
    "half a minute of checks; tests/testing does the same": [
        "stridetwin conform foot_ins",
        "stridetwin conform my_foot:MyFoot",
        "stridetwin conform my_foot:MyFoot --only fault_nan --json",
    ],
    "paints large textures, or needs a display; test_scene and test_playback_window do the same": [
        "stridetwin scene stair_up_down -o scenes",
        "stridetwin view stair_up_down --mujoco",
    ],
    "many walks; campaign/ and gate/ do the same with few short ones": [
        "stridetwin generate stairs_and_ramps --workers 2 -o data",
        "stridetwin generate stairs_and_ramps --workers 2 -o data/stairs",
        "stridetwin generate mine.yaml --subset 20 -o data/mine",
        "stridetwin generate mine.yaml --scheduler tcp://10.0.0.5:8786 -o /shared/mine",
        "stridetwin generate gate.yaml --workers 2 -o gate/walks",
        "stridetwin score data --json > good.json",
        "stridetwin score data --baseline good.json --junit gate.xml",
        "stridetwin score gate/walks --json > gate/baseline.json",
        "stridetwin score gate/walks --baseline gate/baseline.json",
    ],
    "ten simulated walks, or one with the images of two cameras": [
        "stridetwin experiment jao_loop_126m --workers 2 -o runs/loop",
        "stridetwin experiment jao_straight_53m --physics kinematic --subset 1 --keep -o runs/quick",
        "stridetwin estimate foot_to_foot runs/quick/seed_1000.mcap --method published -o path.txt",
    ],
    "minutes; tests/studies/test_study_file.py does the same with few short walks": [
        "stridetwin experiment examples/study.yaml --workers 2 -o runs/study",
    ],
    "hundreds of places on several walks; placement/ does the same with few on short ones": [
        "stridetwin place foot_camera",
        "stridetwin place foot_camera -o runs/place",
        "stridetwin place shoe_sight -o runs/shoe",
        "stridetwin place mine.yaml --workers 2 --resume -o runs/mine",
    ],
    "on a bag of somebody's; tests/streams/test_imports.py and test_formats_cli make theirs": [
        "stridetwin import walk.bag --map /xsens/imu=/foot_l/imu -o walk.mcap",
        "stridetwin estimate foot_ins walk.bag --map /xsens/imu=/foot_l/imu -o left.txt",
    ],
    "on a logger's table; tests/streams/test_imu_tables.py makes one": [
        'stridetwin estimate foot_ins log.csv --columns "t=clock[ms],ax=accX[mg],ay=accY[mg],az=accZ[mg],'
        'gx=p[deg/s],gy=q[deg/s],gz=r[deg/s]" -o path.txt',
    ],
}
"""What is only read, and why."""

OTHERS = {"git", "pre-commit", "source", "xdg-open"}
"""Programs that are none of ours."""

YOURS = {"gate.yaml", "mine.yaml", "stairs.yaml", "walk.yaml"}
"""Files that a page says are the reader's own."""

PLACES = {
    "SENSOR": "foot_camera",
    "PROBLEM": "shoe_sight",
    "SCENARIO": "level_20m",
    "CAMPAIGN": "stairs_and_ramps",
    "ESTIMATOR": "foot_ins",
    "NAME": "jao_simulation",
    "KIND": "mcap",
    "F": "pelvis",
    "S": "mcap",
    "T": "/foot_l/imu",
    "FIRST": "7",
    "DIR": "runs",
    "PX": "64",
} | dict.fromkeys(["N", "K", "M", "PCT", "MS"], "2")
"""Examples of what usages leave to the reader; all other words may be anything."""

SHOWN = [(name(page), command) for page in PAGES for command in dict.fromkeys(fenced(page))]
IN_TEXT = [(name(page), command) for page in PAGES for command in dict.fromkeys(in_text(page))]


class ParsedError(Exception):
    """A program's arguments are right."""


def filled(words):
    made = [PLACES.get(word, word) for word in words]
    for seconds in {"--lag", "--time-offset"} & set(made):
        made[made.index(seconds) + 1] = "1"
    return made


def read_stridetwin(words):
    """Fails where the command line would refuse the words, or there is no such walk."""
    if words[0] == "COMMAND" or (len(words) == 1 and words[0] in COMMANDS):
        return
    if "--help" in words:
        assert words == ["--help"] or words[0] in COMMANDS
        return
    call = main.parse(words)
    asked = call.options
    if getattr(asked, "problem", None):
        assert asked.problem in {*problems(), *YOURS}
    if getattr(asked, "scenario", None):
        assert asked.scenario in {*catalogue(), *campaigns(), *YOURS}
    if getattr(asked, "physics", None):
        assert asked.physics in PHYSICS
    if call.command in ("estimate", "live") and asked.method is not None:
        assert asked.method in registry.estimator(asked.estimator).declaration.methods


def read_program(monkeypatch, words):
    """Fails where a module or script of ours would refuse the words."""

    def parse(parser, *_):
        try:
            real(parser, words[3:] if words[1] == "-m" else words[2:])
        except SystemExit as end:
            raise AssertionError(shlex.join(words)) from end
        raise ParsedError

    real = argparse.ArgumentParser.parse_args
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse)
    if words[1] != "-m":
        monkeypatch.syspath_prepend(str((ROOT / words[1]).parent))  # as Python does
    run, what = (runpy.run_module, words[2]) if words[1] == "-m" else (runpy.run_path, str(ROOT / words[1]))
    with pytest.raises(ParsedError):
        run(what, run_name="__main__")


def read(monkeypatch, command):
    """Fails where a variant of the command is none; returns how many there are."""
    every = list(variants(command))
    for words in every:
        if words == ["stridetwin", "--version"]:
            continue
        if words[0] == "stridetwin":
            read_stridetwin(filled(words[1:]))
        elif words[0] == "make":
            targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
            assert set(words[1:]) <= set(targets)
        elif words[0] == "python":
            read_program(monkeypatch, filled(words))
        elif words[0] == "pip":
            project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
            extras = re.findall(r"\[([\w,]+)\]", command)
            assert {e for several in extras for e in several.split(",")} <= set(project["optional-dependencies"])
        else:
            assert words[0] in OTHERS
    return len(every)


@pytest.mark.parametrize("command", sorted({command for page, command in SHOWN if page not in WHOLE}))
def test_a_command_of_a_console_is_run_or_listed_as_read(command):
    once = [*RUN, *(c for several in READ.values() for c in several)]
    assert len(once) == len(set(once))
    assert command in once or command.split()[0] in OTHERS


def test_what_is_listed_stands_on_a_page():
    shown = {command for _, command in SHOWN}
    assert {*RUN, *(c for several in READ.values() for c in several)} <= shown


def test_commands_of_ours_are_found_on_each_page_that_shows_any():
    assert {page for page, _ in SHOWN} >= WHOLE | {"README.md", "docs/gate.md", "docs/campaigns.md", "docs/formats.md"}
    assert len(IN_TEXT) > 60


@pytest.mark.parametrize(
    "command", sorted({command for _, command in [*SHOWN, *IN_TEXT] if command.split()[0] != "pytest"})
)
def test_a_command_is_one(command, monkeypatch):
    assert read(monkeypatch, command) >= 1


def test_the_page_of_the_command_line_lists_every_command_and_experiment():
    commands = set(COMMANDS)
    rows = rows_of_the_command_line(commands)
    for usage in rows:
        for words in variants(usage):
            read_stridetwin(filled(words[1:]))
    assert {usage.split()[1] for usage in rows} == commands
    page = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    table = page.split("## Experiments")[1].split("\n\n")[1]
    listed = [n for line in table.splitlines()[2:] for n in re.findall(r"`(\w+)`", line.split("|")[1])]
    assert sorted(listed) == sorted(experiments())


def test_a_wrong_command_would_be_found(monkeypatch):
    for wrong in (
        "stridetwin run level_20m --sed 3",
        "stridetwin generate level_20 -o walk.mcap",
        "stridetwin experiment jao_loop_126",
        "stridetwin estimate dvio PATH -o FILE --method zupt",
        "python -m benchmarks.gait --sed 3",
        "make dem",
        "pip install '.[twn]'",
        "rm -rf here",
    ):
        with pytest.raises((AssertionError, SystemExit)):
            read(monkeypatch, wrong)
    with pytest.raises(ImportError):
        read(monkeypatch, "python -m benchmarks.gai")


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """Recording of a stand-in's walk without cameras."""
    path = tmp_path_factory.mktemp("steps") / "walk.mcap"
    with pytest.MonkeyPatch.context() as patch:
        for module in (record, runner):
            patch.setattr(module, "make_twin", lambda scenario, seed: FakeTwin(scenario.config, seed))
        assert main.main(["generate", "level_20m", "--no-cameras", "-o", str(path)]) == 0
    return path


@pytest.mark.parametrize("command", RUN)
def test_a_command_does_what_it_says(command, steps, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk.mcap").symlink_to(steps)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "V1_01_easy").symlink_to(steps)
    block = Recording(steps).block("/foot_l/imu")
    columns = {"accel": block.columns["specific_force"], "gyro": block.columns["angular_rate"]}
    np.savez(tmp_path / "my_foot_imu.npz", t=block.t_ns * 1e-9, **columns)
    words = [word.replace("~", str(tmp_path)) for word in shlex.split(command)[1:]]
    made = outcome(*words)
    assert not isinstance(made, Exception), made
    assert made.code == 0
    if "-o" in words:
        assert (tmp_path / words[words.index("-o") + 1]).exists()


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_python_on_a_page_names_what_there_is(page):
    """Each block compiles, and what it imports of the project is there."""
    for block in re.findall(r"^```python[^\n]*\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S):
        compile(block, name(page), "exec")
        for line in re.findall(r"^(?:from|import) stridetwin\S* .*", block, re.M):
            names = {}
            exec(line, names)
            assert names.keys() > {"__builtins__"}


def test_the_readme_s_python_runs(steps, tmp_path, monkeypatch):
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    (place,) = re.findall(r'Recording\("(\S+)"\)', code)
    monkeypatch.chdir(tmp_path)
    (tmp_path / place).parent.mkdir(parents=True)
    (tmp_path / place).symlink_to(steps)
    names = {}
    exec(code, names)
    assert np.isfinite(names["estimate"].pose.p_frame_in_world).all()
