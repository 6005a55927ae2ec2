"""Estimators of others on a walk of the fake twin: a Python class, a program, and what goes wrong with them."""

import json
import multiprocessing
import os
import re
import sys
import tempfile
import textwrap
import time
from contextlib import suppress

import numpy as np
import pytest

from stridetwin.cli.main import main
from stridetwin.estimators.base import PathEstimate
from stridetwin.gate.own_estimators import Program, PythonClass, estimate_path
from stridetwin.outputs.path.evaluate import evaluate
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.recording.reader import Recording

CLASSES = """
from dataclasses import replace
import numpy as np
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns

class Left:
    topics = ("/foot_l/imu",)

    def __init__(self, rig):
        self.filter = FootIns(rig, options=Options(foot="l"))

    def update(self, sample):
        e = self.filter.update(sample)
        if e is None or not e.aligned:
            return None
        return e.pose

class Right(Left):
    frame = "foot_r/imu"

    def __init__(self, rig):
        self.filter = FootIns(rig, options=Options(foot="r"))
    topics = ("/foot_r/imu",)

class Greedy:
    topics = ("/truth/foot_l/imu/odometry",)
    def __init__(self, rig): pass
    def update(self, sample): return None

class Silent(Greedy):
    topics = None

class Broken(Left):
    def update(self, sample): raise ValueError("a matrix is singular")

class Odd(Left):
    def update(self, sample):
        e = super().update(sample)
        return e and self.changed(e)

class Zero(Odd):
    def changed(self, e): return replace(e, rotation=np.zeros(4))

class Five(Odd):
    def changed(self, e): return replace(e, rotation=np.array([5.0, 0, 0, 0]))

class Far(Odd):
    def changed(self, e): return replace(e, p_frame_in_world=np.array([0, 1e200, 0]))

class Covered(Odd):
    def changed(self, e): return replace(e, covariance=1e-4 * np.eye(6))

class Small(Odd):
    def changed(self, e): return replace(e, covariance=np.eye(3))

class Elsewhere(Left):
    topics = ("/foot_x/imu",)

class NoSuchImu(Left):
    def __init__(self, rig): rig.imu("/foot_left/imu")

class Timeless(Odd):
    def changed(self, e): return replace(e, t_ns=5)

class Framed(Left):
    frame = ["a"]

class Quits(Left):
    def update(self, sample): raise SystemExit(0)

class Stopped(Left):
    def update(self, sample): raise KeyboardInterrupt

class Loud(Left):
    def update(self, sample):
        print("words", sample.t_ns)
        return super().update(sample)

class Unsaid(Left):
    def update(self, sample): raise ValueError("\\ud800" + 2000 * "x")

nothing = 3
"""

PROGRAM = """
import sys
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.formats.tum import write_tum

recording = Recording(sys.argv[1])
path = FootIns(recording.rig, options=Options(foot="l")).run(recording.block("/foot_l/imu")).trajectory
write_tum(path, sys.argv[2])
"""

WORSE = """
import sys
import numpy as np

path = np.loadtxt({path!r})
path[:, 1:3] *= 1.05
np.savetxt(sys.argv[2], path, fmt="%.9f")
"""


@pytest.fixture
def recording(walk):
    return Recording(walk / "recording.mcap")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder to work in, with a module and a program."""
    (tmp_path / "own_filters.py").write_text(CLASSES)
    (tmp_path / "program.py").write_text(PROGRAM)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    yield tmp_path
    sys.modules.pop("own_filters", None)


def script(folder, text):
    file = folder / "script.py"
    file.write_text(textwrap.dedent(text))
    return f"{sys.executable} {file} {{recording}} {{output}}"


def program(command, timeout_s=60.0):
    return Program(name="mine", command=command, frame="foot_l/imu", timeout_s=timeout_s)


def test_a_class_gets_the_scores_of_the_filter_inside(walk, place, capsys):
    words = ["score", str(walk / "recording.mcap"), "--json"]
    own = ["--estimator", "left=own_filters:Left", "--estimator", "right=own_filters:Right"]
    assert main([*words, *own]) == 0
    found = json.loads(capsys.readouterr().out)["estimators"]
    built_in = json.loads((walk / "scores.json").read_text())["estimators"]
    assert set(found) == {"left", "right"}
    for name, twin in (("left", "foot_ins_l"), ("right", "foot_ins_r")):
        assert found[name]["ape_rmse_m"] == pytest.approx(built_in[twin]["ape_rmse_m"], abs=2e-3)


def test_a_page_shows_the_error_the_bound_and_the_nees_of_a_class_over_time(walk, place, capsys):
    words = ["score", str(walk / "recording.mcap"), "--report", "page.html", "--estimator"]
    assert main([*words, "mine=own_filters:Covered"]) == 0
    assert f"page  {(place / 'page.html').as_uri()}" in capsys.readouterr().out
    page = (place / "page.html").read_text(encoding="utf-8")
    for text in (
        "Position error over time",
        "own 95 % bound",
        "NEES of the position over time",
        "mine beside the truth",
    ):
        assert text in page
    assert "Without a covariance" not in page
    assert main([*words, "bare=own_filters:Left"]) == 0
    page = (place / "page.html").read_text(encoding="utf-8")
    assert "Without a covariance: bare." in page
    assert "NEES of the position over time" not in page
    many = ["score", *[str(walk / "recording.mcap")] * 2, "--report", "none.html"]
    assert main(many) == 2
    assert "--report: invalid 'none.html': expected one RECORDING" in capsys.readouterr().err
    assert not (place / "none.html").exists()


def test_what_is_installed_is_found_before_what_lies_in_the_working_folder(place, monkeypatch):
    installed = place / "site-packages"
    installed.mkdir()
    (installed / "own_filters.py").write_text(CLASSES.replace("nothing = 3", "Left.version = 'installed'"))
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(place)] + [str(installed)])
    kind = PythonClass(name="mine", place="own_filters:Left", frame="foot_l/imu").load()
    assert kind.version == "installed"
    assert sys.path[-1] == str(place)


def test_a_program_that_writes_a_tum_file_is_scored_and_gated_like_any_other(walk, place, capsys):
    base = ["score", str(walk / "recording.mcap"), "--program"]
    good = f"mine={sys.executable} program.py {{recording}} {{output}}"
    assert main([*base, good, "--json"]) == 0
    output = capsys.readouterr().out
    (place / "base.json").write_text(output)
    own, built_in = (
        json.loads(output)["estimators"]["mine"],
        json.loads((walk / "scores.json").read_text())["estimators"],
    )
    assert own["end_error_m"] == pytest.approx(built_in["foot_ins_l"]["end_error_m"], abs=0.01)
    gate = ["--baseline", "base.json", "--junit", "gate.xml"]
    (place / "program.py").write_text(WORSE.format(path=str(walk / "foot_ins_l.txt")))
    capsys.readouterr()
    assert main([*base, good, *gate]) == 1
    assert re.search(r"mine +ape_rmse_m", capsys.readouterr().out)
    assert "<failure" in (place / "gate.xml").read_text()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("own_filters:Greedy", "Greedy.topics: invalid /truth/foot_l/imu/odometry: expected topics"),
        ("own_filters:Elsewhere", r"Elsewhere.topics: invalid '/foot_x/imu': expected .*did you mean '/foot_[lr]/imu'"),
        (
            "own_filters:NoSuchImu",
            r"own_filters:NoSuchImu: .* no IMU '/foot_left/imu'; .* \(own_filters.py:\d+, in __i",
        ),
        ("own_filters:Timeless", "Timeless.update: t_ns: invalid 5: expected more than 5, the stamp of the previous"),
        ("own_filters:Silent", "Silent.update has returned no estimate"),
        (
            "own_filters:Broken",
            r"own_filters:Broken: ValueError: a matrix is singular \(\S*own_filters.py:\d+, in up",
        ),
        ("own_filters:Quits", "own_filters:Quits: SystemExit: 0"),
        (
            "own_filters:Unsaid",
            r"own_filters:Unsaid: ValueError: \\ud800x{580,600} \(\S*own_filters.py:\d+, in up",
        ),
        ("own_filters:Framed", r"--estimator mine: own_filters:Framed: frame: invalid \['a'\]: expected text"),
        ("own_filters:nothing", "is not a class with an update"),
        ("own_filters:Missing", "cannot be imported: AttributeError"),
        ("no_such_module:A", "cannot be imported: ModuleNotFoundError"),
        ("own_filters", "expected module:Class"),
    ],
)
def test_an_invalid_class_is_reported(recording, place, name, said):
    with pytest.raises(StrideTwinError, match=said):
        PythonClass(name="mine", place=name, frame="foot_l/imu").path(recording)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "Zero",
            r"mine: q_world_frame at t = \d\.\d+ s: invalid \[0\.0, 0\.0, 0\.0, 0\.0\]: expected a unit quaternion",
        ),
        (
            "Five",
            r"mine: q_world_frame at t = \d\.\d+ s: invalid \[5\.0, 0\.0, 0\.0, 0\.0\]: expected a unit quaternion",
        ),
        ("Far", r"mine: p_frame_in_world at t = \d\.\d+ s: invalid \[0\.0, 1e\+200, 0\.0\]: expected finite numbers"),
        ("Quits", r"own_filters:Quits: SystemExit: 0"),
        (
            "Small",
            r"Small.update: Pose.covariance at t = \d\.\d+ s: invalid shape \(3, 3\): expected \(6, 6\), of x, y",
        ),
    ],
)
def test_what_is_no_pose_is_one_error_of_that_estimator(walk, place, capsys, name, said):
    own = ["--estimator", f"mine=own_filters:{name}"]
    assert main(["score", str(walk / "recording.mcap"), *own, "--json"]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert re.search(f"^stridetwin: error: {said}", output.err, re.MULTILINE)


@pytest.mark.parametrize("value", [float("inf"), float("nan"), -1e101])
def test_a_score_that_no_file_can_hold_is_an_error(walk, recording, value):
    path = read_tum(walk / "foot_ins_l.txt")
    made = PathEstimate(name="mine", frame="foot_l/imu", path=path, nis={"standing": value})
    with pytest.raises(StrideTwinError, match=r"^mine: nis_standing: invalid \S+: expected a number of up to 1e"):
        evaluate(recording, [made])


def test_a_module_that_quits_is_no_estimator_and_one_that_prints_leaves_stdout_alone(walk, place, capsys):
    (place / "quits.py").write_text("import sys; sys.exit(0)")
    words = ["score", str(walk / "recording.mcap"), "--json", "--estimator"]
    assert main([*words, "mine=quits:A"]) == 2
    assert "--estimator mine: quits:A: cannot be imported: SystemExit: 0" in capsys.readouterr().err
    (place / "own_filters.py").write_text(CLASSES + "print('loaded')")
    assert main([*words, "mine=own_filters:Loud"]) == 0
    output = capsys.readouterr()
    assert "mine" in json.loads(output.out)["estimators"]
    assert {"loaded", "words"} <= set(output.err.split())


def test_ctrl_c_within_a_class_stops_all(recording, place):
    with pytest.raises(KeyboardInterrupt):
        PythonClass(name="mine", place="own_filters:Stopped", frame="foot_l/imu").path(recording)


def test_a_class_sees_all_that_sensors_say_in_order_and_no_truth(recording):
    class Listener:
        def __init__(self):
            self.seen = []

        def update(self, sample):
            self.seen.append((sample.topic, sample.t_ns))

    listener = Listener()
    with pytest.raises(StrideTwinError, match="no estimate"):
        estimate_path(listener, recording)
    topics = {topic for topic, _ in listener.seen}
    assert {"/foot_l/imu", "/foot_r/imu", "/head/depth"} <= topics
    assert not any(topic.startswith("/truth") for topic in topics)
    assert (np.diff([t for _, t in listener.seen]) >= 0).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import sys; sys.exit('no map was found')", "exit code 1; stderr: no map was found"),
        ("pass", "has not written {output}; nothing on stderr"),
        ("import sys; open(sys.argv[2], 'w').write('0 1 2')", r"{output}: line 1: invalid '0 1 2'"),
    ],
)
def test_a_failing_program_is_reported_with_its_output(recording, tmp_path, text, said):
    with pytest.raises(StrideTwinError) as error:
        program(script(tmp_path, text)).path(recording)
    assert said in str(error.value)


def test_a_program_that_hangs_is_stopped_with_its_children(recording, tmp_path):
    mark = tmp_path / "mark"
    text = f"""
        import subprocess, sys, time
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1.5); open({str(mark)!r}, 'w')"])
        print("still at work", file=sys.stderr, flush=True)
        time.sleep(60)
    """
    begin = time.monotonic()
    with pytest.raises(StrideTwinError, match="stopped after 1 s"):
        program(script(tmp_path, text), 1.0).path(recording)
    assert time.monotonic() - begin < 10.0
    time.sleep(1.0)
    assert not mark.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="needs fork")
def test_where_this_process_is_killed_the_program_ends_with_its_children_and_its_folder_goes(
    recording, tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    text = f"""
        import os, subprocess, sys, time
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
        with open({str(tmp_path / "new")!r}, "w") as file:
            file.write(f"{{os.getpid()}} {{child.pid}}")
        os.rename({str(tmp_path / "new")!r}, {str(tmp_path / "pids")!r})
        time.sleep(60)
    """
    run = multiprocessing.get_context("fork").Process(target=program(script(tmp_path, text)).path, args=(recording,))
    run.start()
    wait_for((tmp_path / "pids").exists)
    assert list(tmp_path.glob("stridetwin-*"))
    run.kill()
    run.join()
    for pid in (tmp_path / "pids").read_text().split():
        wait_for(lambda pid=pid: ended(int(pid)))
    wait_for(lambda: not list(tmp_path.glob("stridetwin-*")))


def wait_for(what):
    end = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def ended(pid):
    """Whether a process is no more, or a corpse that nobody has fetched."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    with suppress(OSError), open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] == "Z"
    return False


def test_words_of_a_command_are_no_shells(recording, tmp_path):
    mark = tmp_path / "mark"
    with pytest.raises(StrideTwinError, match="exit code"):
        program(f"{sys.executable} -c 'raise SystemExit(3)' {{recording}} {{output}}; touch {mark}").path(recording)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--program", "mine"], "expected NAME="),
        (["--program", "mine=cat {recording}"], "expected COMMAND {recording} {output}"),
        (["--program", "mine=no-such-program {recording} {output}"], "invalid 'no-such-program'"),
        (["--program", "mine='cat {recording} {output}"], "No closing quotation"),
        (["--estimator", "mine=nowhere:A"], "cannot be imported"),
        (["--estimate", "a=x.txt", "--estimate", "a=y.txt"], "invalid name 'a' of two estimators"),
        (["--junit", "x.xml"], "expected --baseline as well"),
        (["--history", "x.jsonl"], "needs the --label"),
        (["--label", "v1"], "--label names a version in a history: expected --history"),
        (["--history", "x.jsonl", "--label", "a\udc80"], r"--label: invalid 'a\udc80': expected text in UTF-8"),
        (["--tolerance", "10"], "--tolerance is about changes: expected --baseline as well"),
        (["--least", "3"], "--least is about changes: expected --baseline as well"),
        (["--false-alarms", "5"], "--false-alarms is about changes: expected --baseline as well"),
        (["--only", "foot_inz"], "--only: estimator: invalid 'foot_inz': expected contact_terrain, "),
    ],
)
def test_invalid_options_are_reported_before_anything_is_scored(walk, capsys, words, said):
    assert main(["score", str(walk / "recording.mcap"), *words]) == 2
    assert said in capsys.readouterr().err


def test_a_level_too_low_for_the_baseline_is_reported_before_anything_is_scored(tmp_path, capsys):
    scores = {f"e{i}": {f"score_{k}_m": 1.0 for k in range(6)} for i in range(20)}
    rows = [{"name": f"w{i}", "sha256": str(i), "estimators": scores} for i in range(12)]
    (tmp_path / "base.json").write_text(json.dumps({"estimators": scores, "recordings": rows}))
    words = ["score", "no-such.mcap", "--baseline", str(tmp_path / "base.json"), "--false-alarms", "0.01"]
    assert main(words) == 2
    assert "--false-alarms: invalid 0.01: expected 0.024 or more, with the 120" in capsys.readouterr().err


def test_a_frame_that_no_estimator_has_is_refused(walk, place, capsys):
    command = ["score", str(walk / "recording.mcap"), "--estimator", "mine=own_filters:Right", "--frame", "foot_left"]
    assert main(command) == 2
    said = "--frame: invalid 'foot_left': expected foot_r/imu, as the classes declare"
    assert said in capsys.readouterr().err


def test_a_class_in_place_of_an_object_is_refused(recording):
    with pytest.raises(
        StrideTwinError, match=r"invalid class Recording: expected an object of it, such as Recording\("
    ):
        estimate_path(Recording, recording)
