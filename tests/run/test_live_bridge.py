"""Estimators live over the bridge: the numbers of `estimate`, what is recorded, latency and warnings."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from live_bridge import alive, free_port, outcome, sent

from stridetwin.cli.main import main
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.locomotion_mode import INSOLES, LocomotionMode
from stridetwin.outputs.csv_tables import write_table
from stridetwin.outputs.modes.files import MODE_COLUMNS, find_completed_steps, mode_cells
from stridetwin.outputs.pose_feed import merge_poses
from stridetwin.outputs.terrain.files import write_terrain
from stridetwin.run import compile_ahead, live
from stridetwin.run.latency import Latency, Times
from stridetwin.run.live_chain import InputCheck, Request
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.tum import write_tum
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.live.sender import Sender
from stridetwin.streams.live.wire import WireError, parse_address
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Accelerometer, Depth, Image, Range


@pytest.fixture
def started(monkeypatch):
    """Nothing is compiled ahead, which takes seconds and changes no estimate; `test_warm_up.py` is about that."""
    monkeypatch.setattr(compile_ahead, "synthetic_samples", lambda *_: [])


def estimated(*words):
    assert main(["estimate", *map(str, words)]) == 0


def test_one_foot_live_is_one_foot_offline_and_everything_is_recorded(seen, tmp_path):
    result, offline, recorded = (tmp_path / n for n in ("live.txt", "offline.txt", "recorded.mcap"))
    made = alive(["foot_ins", "--foot", "r", "-o", result, "--record", recorded], sent(seen))
    estimated("foot_ins", seen, "--foot", "r", "-o", offline)
    assert result.read_bytes() == offline.read_bytes()
    estimated("foot_ins", recorded, "--foot", "r", "-o", offline)
    assert result.read_bytes() == offline.read_bytes()
    topics = {t: i.count for t, i in Recording(seen).topics.items() if not t.startswith("/truth/")}
    assert {t: i.count for t, i in Recording(recorded).topics.items()} == topics
    assert {t: c["received"] for t, c in made.data["streams"].items()} == topics
    row = made.data["latency"]["arrival_to_estimate"]["foot_ins"]["/foot_r/imu"]
    assert row["samples"] == row["estimates"] == topics["/foot_r/imu"]
    assert 0 < row["work_mean_ms"] <= row["mean_ms"] <= row["max_ms"]
    assert row["p50_ms"] <= row["p95_ms"] <= row["p99_ms"] <= row["max_ms"]
    assert made.data["refused"] == []
    assert any(line.startswith("from arrival to estimate") for line in made.lines)


@pytest.mark.usefixtures("started")
def test_feet_of_two_senders_live_are_feet_offline(seen, tmp_path):
    recording, rig = seen, tmp_path / "rig.yaml"
    write_rig(Recording(recording).rig, rig)
    offline = [tmp_path / f"offline_{f}.txt" for f in "lr"]
    estimated("foot_to_foot", recording, "-o", tmp_path / "offline.txt")
    alive(["foot_to_foot", "-o", tmp_path / "one.txt"], sent(recording))
    assert [(tmp_path / f"one_{f}.txt").read_bytes() for f in "lr"] == [f.read_bytes() for f in offline]

    def both(where):
        """Each foot has a sender of its own, in step to within some milliseconds."""
        blocks = {f: list(Recording(recording).block(f"/foot_{f}/imu")) for f in "lr"}
        address = parse_address(where, "--to")
        with Sender(Rig(), address, patience_s=240) as left, Sender(Rig(), address, patience_s=240) as right:
            for i, (a, b) in enumerate(zip(*blocks.values(), strict=True)):
                left.send(a)
                right.send(b)
                if i % 20 == 0:
                    time.sleep(0.005)

    made = alive(["foot_to_foot", "--rig", rig, "--window", "500", "-o", tmp_path / "two.txt"], both)
    late = sum(c["late"] for c in made.data["streams"].values())
    assert made.data["window_ms"] == 500.0
    for f, file in zip("lr", offline):
        result, true = np.loadtxt(tmp_path / f"two_{f}.txt"), np.loadtxt(file)
        assert np.array_equal(result[:, 0], true[:, 0])
        assert late or np.abs(result - true).max() < 1e-12


@pytest.mark.usefixtures("started")
def test_steps_live_are_steps_offline(seen, tmp_path):
    result, offline = tmp_path / "live.csv", tmp_path / "offline.csv"
    estimated("contact_terrain", seen, "-o", offline)
    alive(["contact_terrain", "-o", result], sent(seen))
    assert result.read_bytes() == offline.read_bytes()
    assert len(result.read_text().splitlines()) > 2


def poses_and_rest(recording, odometry):
    """What leads a map through a recording, as `run` does it: the odometry's poses, insoles and depth in order."""
    healthy = odometry.healthy
    topics = [*INSOLES, "/head/depth"]
    return merge_poses(odometry.path[healthy], recording, topics, odometry.camera, odometry.status[healthy])


@pytest.mark.usefixtures("started")
def test_the_head_s_estimators_live_are_those_offline(seen, tmp_path):
    recording = Recording(seen)
    (odometry,) = Dvio.follow(recording, Options())
    assert odometry.healthy.any()
    predictor = LocomotionMode(recording.rig, options=Options(poses_of="head/imu"))
    estimates = map(predictor.update, poses_and_rest(recording, odometry))
    rows = find_completed_steps(e for e in estimates if e is not None)
    write_table(MODE_COLUMNS, map(mode_cells, rows), tmp_path / "offline.csv")
    write_terrain(predictor.ground, tmp_path / "offline.json")
    made = alive(["locomotion_mode", "-o", tmp_path / "live.csv"], sent(seen))
    assert (tmp_path / "live.csv").read_bytes() == (tmp_path / "offline.csv").read_bytes()
    assert made.data["rows"][str(tmp_path / "live.csv")] == len(rows) > 0
    result = made.data["latency"]["arrival_to_estimate"]
    assert set(result) == {"dvio", "locomotion_mode"}
    assert set(result["locomotion_mode"]) == {"/head/depth", *INSOLES}
    assert set(result["dvio"]) == {"/head/imu", "/head/color", "/head/depth"}
    alive(["terrain_map", "-o", tmp_path / "live.json"], sent(seen))
    for suffix in ("json", "ply"):
        assert (tmp_path / f"live.{suffix}").read_bytes() == (tmp_path / f"offline.{suffix}").read_bytes()
    write_tum(odometry.path, tmp_path / "offline.txt")
    alive(["dvio", "-o", tmp_path / "live.txt"], sent(seen))
    assert (tmp_path / "live.txt").read_bytes() == (tmp_path / "offline.txt").read_bytes()


@pytest.mark.usefixtures("started")
def test_a_folder_of_another_tool_can_be_sent(seen, tmp_path):
    table, result = tmp_path / "imu.csv", tmp_path / "live.txt"
    main(["export", str(seen), "--format", "table", "-o", str(table)])
    rig = tmp_path / "rig.yaml"
    write_rig(Recording(seen).rig, rig)
    alive(["foot_ins", "-o", result], sent(table, "--rig", rig))
    assert len(result.read_text().splitlines()) == len(table.read_text().splitlines()) - 1


@pytest.mark.usefixtures("started")
def test_in_real_time_the_way_from_stamp_to_arrival_is_measured(seen, tmp_path):
    def some(where):
        recording = Recording(seen)
        block = [s for s in recording.block("/foot_l/imu")][:30]
        epoch_ns = time.time_ns() - block[0].t_ns
        with Sender(recording.rig, parse_address(where, "--to"), epoch_ns=epoch_ns, patience_s=240) as sender:
            for sample in block:
                time.sleep(max(0.0, (epoch_ns + sample.t_ns - time.time_ns()) * 1e-9))
                sender.send(sample)

    made = alive(["foot_ins", "-o", tmp_path / "path.txt", "--budget", "0.000001"], some)
    travel = made.data["latency"]["stamp_to_arrival"]["/foot_l/imu"]
    assert 0.0 < travel["min_ms"] <= travel["p50_ms"] * 1.02 <= travel["max_ms"] * 1.02
    assert made.code == 1  # nobody is that fast
    assert "not kept" in "\n".join(made.lines)


def test_a_port_of_thousands_of_digits_is_none():
    with pytest.raises(StrideTwinError, match=r"--to: invalid address .*: expected HOST:PORT"):
        parse_address(f"127.0.0.1:{'9' * 5000}", "--to")


def test_what_goes_wrong_is_reported_in_one_line(seen, tmp_path, monkeypatch):
    recording, nothing = seen, lambda *_: []
    monkeypatch.setattr(compile_ahead, "synthetic_samples", nothing)
    assert "nothing to do" in str(outcome("live"))
    assert "-o is only valid with an estimator" in str(outcome("live", "--record", "a.mcap", "-o", "b.txt"))
    assert "--foot is only valid for foot_ins" in str(outcome("live", "dvio", "--foot", "l"))
    assert "no folder" in str(outcome("live", "foot_ins", "-o", tmp_path / "none" / "path.txt"))
    assert "--method published is only valid for" in str(outcome("live", "foot_ins", "--method", "published"))
    assert "no topic '/x'" in str(outcome("send", recording, "--topic", "/x"))
    nobody = outcome("send", recording, "--to", f"127.0.0.1:{free_port()}", "--patience", "0.1")
    assert "no `stridetwin live` of this version listens at 127.0.0.1:" in str(nobody)
    nowhere = outcome("send", recording, "--to", "192.168..10")
    assert str(nowhere) == "--to: invalid address '192.168..10': expected HOST:PORT, such as 127.0.0.1:7365"
    lacking = alive(["dvio", "-o", tmp_path / "path.txt"], sent(recording, "--topic", "/foot_l/imu"))
    assert "nothing was estimated: no samples arrived of /head/imu, /head/color, /head/depth" in str(lacking)

    def bare(where):
        with Sender(Rig(), parse_address(where, "--to"), patience_s=240) as sender:
            sender.send(next(iter(Recording(recording).block("/foot_l/imu"))))

    lacking = alive(["foot_ins", "-o", tmp_path / "path.txt"], bare)
    assert "nothing was estimated: the rig has no IMU '/foot_l/imu'" in str(lacking)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("started")
def test_samples_of_another_kind_are_left_out_and_others_lose_nothing(seen, tmp_path, capsys):
    recording, rig = Recording(seen), tmp_path / "rig.yaml"
    write_rig(recording.rig, rig)
    right = list(recording.block("/foot_r/imu"))

    def both(where):
        """One sender brings the range of a sonar as an IMU."""
        address = parse_address(where, "--to")
        with Sender(Rig(), address, patience_s=240) as other, Sender(Rig(), address, patience_s=240) as honest:
            other.send(Range(topic="/foot_l/imu", t_ns=right[0].t_ns, distance=0.3))
            for sample in right:
                honest.send(sample)

    made = alive(["foot_to_foot", "--rig", rig, "-o", tmp_path / "feet.txt"], both)
    assert made.data["streams"]["/foot_l/imu"]["other_kind"] == 1
    assert made.data["streams"]["/foot_r/imu"]["received"] == len(right)
    assert len((tmp_path / "feet_r.txt").read_text().splitlines()) == len(right)
    said = capsys.readouterr().err
    assert "/foot_l/imu: of another kind than the estimator reads: such samples are left out (Range, not Imu)" in said

    def alone(where):
        with Sender(recording.rig, parse_address(where, "--to"), patience_s=240) as sender:
            for i in range(5):
                sender.send(Accelerometer(topic="/foot_l/imu", t_ns=i + 1, specific_force=np.ones(3)))

    assert "no samples arrived of /foot_l/imu" in str(alive(["foot_ins"], alone))
    assert capsys.readouterr().err.count("(Accelerometer, not Imu)") == 1


@pytest.mark.usefixtures("started")
def test_images_of_another_size_are_left_out_and_reported(seen, tmp_path, capsys):
    recording, rig = Recording(seen), tmp_path / "rig.yaml"
    camera = recording.rig.cameras["/head/color"]
    halved = replace(camera, width=camera.width // 2, height=camera.height // 2)
    write_rig(replace(recording.rig, cameras={camera.topic: halved}), rig)
    topics = ("--topic", "/head/imu", "--topic", "/head/color", "--topic", "/head/depth")
    for estimator in ("dvio", "terrain_map"):  # the latter would not go on
        made = alive([estimator, "--rig", rig], sent(seen, *topics))
        for topic in ("/head/color", "/head/depth"):
            counts = made.data["streams"][topic]
            assert counts["other_size"] == counts["received"] > 0
        size = f"({camera.width} × {camera.height}, not {halved.width} × {halved.height})"
        words = f"of another size than in the rig: such images are left out {size}"
        assert capsys.readouterr().err.count(words) == 2


@pytest.mark.usefixtures("started")
def test_images_that_have_waited_are_skipped_on_request_and_recorded_all_the_same(seen, tmp_path):
    recorded = tmp_path / "recorded.mcap"
    words = ["dvio", "--skip-images", "1e-6", "--record", recorded, "-o", tmp_path / "path.txt"]
    made = alive(words, sent(seen))  # all have waited longer
    for topic, counts in made.data["streams"].items():
        is_image = topic in ("/head/color", "/head/depth")
        assert counts["skipped"] == (counts["received"] if is_image else 0)
        assert Recording(recorded).topics[topic].count == counts["received"]
    assert "/head/color" not in made.data["latency"]["arrival_to_estimate"]["dvio"]
    assert any("skipped for having waited" in line for line in made.lines)


def test_what_an_estimator_can_take():
    camera = CameraCalibration(
        topic="/foot_l/camera",
        part="",
        rate_hz=30.0,
        mount=Mount(body="foot_l"),
        width=32,
        height=24,
        intrinsics=(30.0, 30.0, 15.5, 11.5),
    )
    head = replace(camera, topic="/head/color", mount=Mount(body="head"), depth_topic="/head/depth")
    fit = InputCheck(
        {"/foot_l/camera": Image, "/head/color": Image, "/head/depth": Depth},
        Rig(cameras={c.topic: c for c in (camera, head)}),
    )

    def image(topic, *shape):
        return fit.find_problem(Image(topic=topic, t_ns=1, pixels=np.zeros(shape, np.uint8)))

    assert image("/foot_l/camera", 24, 32) is image("/head/color", 24, 32, 3) is image("/head/color", 24, 32) is None
    assert "colour" in image("/foot_l/camera", 24, 32, 3)[0]
    assert image("/head/color", 32, 24, 3)[1] == "24 × 32, not 32 × 24"
    assert fit.find_problem(Depth(topic="/head/depth", t_ns=1, depth=np.zeros((24, 32), np.float32))) is None
    assert image("/head/depth", 24, 32)[1:] == ("Image, not Depth", "other_kind")
    assert image("/foot_l/camera", 24, 32, 3)[2] == image("/head/color", 32, 24, 3)[2] == "other_size"


def test_cameras_that_an_estimator_does_not_take_cost_nothing(seen, tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr(compile_ahead, "synthetic_samples", lambda takes: shown.append(set(takes)) or [])
    alive(["foot_ins", "-o", tmp_path / "path.txt"], sent(seen, "--topic", "/foot_l/imu"))
    assert shown == [{"/foot_l/imu"}]


def test_an_estimator_compiles_once_and_that_of_an_exoskeleton_as_its_geometry_is_known(seen, tmp_path, monkeypatch):
    shown, rig = [], tmp_path / "rig.yaml"
    write_rig(Recording(seen).rig, rig)
    monkeypatch.setattr(compile_ahead, "synthetic_samples", lambda takes: shown.append(set(takes)) or [])
    alive(["dvio", "--rig", rig, "-o", tmp_path / "path.txt"], sent(seen, "--topic", "/head/imu"))
    alive(["contact_terrain", "-o", tmp_path / "steps.csv"], sent(seen, "--topic", "/foot_r/insole"))
    head, legs = shown
    assert head == {"/head/imu", "/head/color", "/head/depth"}
    assert {"/exo/back/ahrs", "/exo/knee_l/encoder", "/foot_r/insole"} <= legs


@pytest.mark.parametrize("slow", [False, True])
def test_compilation_is_announced_only_if_it_takes_long(monkeypatch, slow):
    said = []
    monkeypatch.setattr(live, "SLOW_START_S", 0.2)
    monkeypatch.setattr(compile_ahead, "synthetic_samples", lambda takes: time.sleep(0.6 * slow) or [])
    session = live._Live(
        live.LiveRequest(chain=Request(estimator="foot_ins"), address=("", 0)), said.append, said.append
    )
    session._compile()
    time.sleep(0.4)
    assert said == ["foot_ins is being compiled, which takes minutes the first time"] * slow


def test_who_can_be_reached_from_elsewhere_is_warned(capsys, tmp_path, seen):
    port = free_port()
    thread = threading.Thread(
        target=outcome, args=("live", "--record", tmp_path / "a.mcap", "--listen", f"0.0.0.0:{port}")
    )
    thread.start()
    sent(seen, "--topic", "/foot_l/imu")(f"127.0.0.1:{port}")
    thread.join(60)
    assert "can be reached from other machines" in capsys.readouterr().err


def test_live_does_without_the_simulator_prints_rows_and_ends_by_a_signal(seen, tmp_path):
    port, out = free_port(), tmp_path / "rows.txt"
    code = (
        "import sys\n"
        "for name in ('mujoco', 'rerun', 'dm_control', 'trimesh'): sys.modules[name] = None\n"
        "from stridetwin.cli.main import main\n"
        f"raise SystemExit(main(['live', 'foot_ins', '--listen', '127.0.0.1:{port}']))\n"
    )
    with out.open("w") as rows:
        process = subprocess.Popen([sys.executable, "-c", code], stdout=rows, stderr=subprocess.PIPE, text=True)
    try:
        block = list(Recording(seen).block("/foot_l/imu"))[:200]
        rig = Recording(seen).rig
        with suppress(WireError), Sender(rig, ("127.0.0.1", port), patience_s=240) as sender:
            for sample in block:
                sender.send(sample)
            until = time.monotonic() + 60
            while len(out.read_text().splitlines()) < 200 and time.monotonic() < until:
                time.sleep(0.05)
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=60)
            sender._patience_s = 0.0  # nobody is there to hear of the end
    except Exception:
        process.kill()
        raise
    assert process.returncode == 0, said
    assert "from arrival to estimate" in said
    assert "Traceback" not in said
    table = np.loadtxt(out)
    assert table.shape == (200, 8)
    assert table[0, 0] == pytest.approx(block[0].t_ns * 1e-9)


def test_times_are_accurate_to_a_percent_in_constant_memory():
    rng = np.random.default_rng(0)
    seconds = np.exp(rng.normal(-6, 1, 20_000))
    times = Times()
    for s in seconds.tolist():
        times.add(s)
    for share in (0.5, 0.95, 0.99):
        assert times.quantile_s(share) == pytest.approx(np.quantile(seconds, share), rel=0.015)
    assert times.mean_s == pytest.approx(seconds.mean())
    assert times.figures()["max_ms"] == pytest.approx(1e3 * seconds.max())
    latency = Latency(0.01)
    assert json.dumps(latency.data())
    latency.add("dvio", "/head/imu", whole_s=0.02, work_s=0.001, estimated=True)
    assert not latency.within
    latency.add_travel("/head/imu", -0.5)  # a clock that is ahead of ours
    assert latency.data()["stamp_to_arrival"]["/head/imu"]["min_ms"] == -500.0


OWN = """
import numpy as np
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns

class Left:
    topics = ("/foot_l/imu",)

    def __init__(self, rig):
        self.filter = FootIns(rig, options=Options(foot="l"))

    def update(self, sample):
        print("no row")
        return self.filter.update(sample)

class Elsewhere(Left):
    topics = ("/foot_l/imus",)

class Broken(Left):
    def update(self, sample): raise ValueError("a matrix is singular")
"""


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    (tmp_path / "own_live.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield
    sys.modules.pop("own_live", None)


@pytest.mark.parametrize("words", [["own_live:Left"], ["--estimator", "mine=own_live:Left"]])
def test_a_class_of_the_user_runs_live(seen, own_module, tmp_path, words, capsys):
    result, offline = tmp_path / "live.txt", tmp_path / "offline.txt"
    done = alive([*words, "-o", result], sent(seen))
    estimated("foot_ins", seen, "--foot", "l", "-o", offline)
    assert result.read_bytes() == offline.read_bytes()
    name = words[-1].removesuffix("=own_live:Left") if "--estimator" in words else words[0]
    assert done.data["estimator"] == name
    assert done.data["latency"]["arrival_to_estimate"][name]["/foot_l/imu"]["samples"] > 0
    printed = capsys.readouterr()
    assert "no row" in printed.err
    assert "no row" not in printed.out
    assert "is being compiled" not in printed.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["own_live:Elsewhere"], "Elsewhere.topics: invalid '/foot_l/imus': .*did you mean '/foot_l/imu'"),
        (["own_live:Broken"], r"own_live:Broken: ValueError: a matrix is singular \(own_live.py:\d+, in update\)"),
        (["own_live:Nothing"], "live: own_live:Nothing: cannot be imported: AttributeError"),
        (["--estimator", "own_live:Left"], "--estimator: invalid 'own_live:Left': expected NAME=MODULE:CLASS"),
        (["foot_ins", "--estimator", "mine=own_live:Left"], "--estimator names a class: expected no other estimator"),
    ],
)
def test_an_invalid_class_of_the_user_is_reported(seen, own_module, words, said):
    has_samples = words[0] in ("own_live:Elsewhere", "own_live:Broken")

    def send(where):  # its receiver may be gone
        outcome("send", seen, "--to", where, "--speed", "0", "--patience", "5", "--topic", "/foot_l/imu")

    error = alive(words, *([send] if has_samples else []))
    assert isinstance(error, StrideTwinError)
    assert re.search(said, str(error)), error
