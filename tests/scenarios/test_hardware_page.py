"""Every command and calibration of docs/hardware.md, and the adapters under examples/, without hardware."""

import json
import re
import runpy
import shlex
import socket
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest
from live_bridge import alive, free_port, outcome

from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.kalibr import read_rig, rig_from_yaml, write_rig
from stridetwin.streams.live import wire
from stridetwin.streams.live.messages import MessageEncoder
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.ros_types import typestore
from stridetwin.streams.samples import Imu

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/hardware.md").read_text(encoding="utf-8")
CONSOLES = re.findall(r"```console\n(.*?)```", PAGE, re.S)


def example(monkeypatch, name, *words):
    """Runs an example as a user does."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
    runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")


@pytest.mark.parametrize("console", CONSOLES, ids=range(len(CONSOLES)))
def test_every_command_of_the_page_does_what_it_says(console, seen, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("stridetwin.run.compile_ahead.synthetic_samples", lambda *_: [])  # which costs seconds
    (tmp_path / "walk.mcap").symlink_to(seen)
    write_rig(Recording(seen).rig, tmp_path / "rig.yaml")
    lines = [shlex.split(line.removeprefix("$ ")) for line in console.splitlines()]
    live: list[threading.Thread] = []
    made = []
    for line in lines:
        if line[-1] == "&":  # the next line's samples are for it
            monkeypatch.setattr(wire, "PORT", free_port())
            words = line[1:-1]
            live.append(threading.Thread(target=lambda words=words: made.append(outcome(*words))))
            live[-1].start()
            continue
        if line[0] == "python":
            example(monkeypatch, Path(line[1]).name, *line[2:], "--speed", "4")
        else:
            made.append(outcome(*line[1:]))
        while live:
            live.pop().join(300)
    assert len(made) == len([line for line in lines if line[0] == "stridetwin"])
    for said in made:
        assert not isinstance(said, Exception), said
    for line in lines:
        if "-o" in line:
            named = line[line.index("-o") + 1]
            there = [named] if "foot_to_foot" not in line else [named.replace(".txt", f"_{f}.txt") for f in "lr"]
            assert all((tmp_path / file).stat().st_size for file in there)


def test_the_calibration_of_the_page_is_one(tmp_path):
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
    rig = rig_from_yaml(text, "page")
    assert set(rig.imus) == {"/head/imu", "/foot_l/imu", "/foot_r/imu"}
    camera = rig.cameras["/head/color"]
    assert (camera.depth_topic, camera.mount.body) == ("/head/depth", "head")
    T_cam_imu = np.linalg.inv(camera.mount.T_body_sensor) @ rig.imus["/head/imu"].mount.T_body_sensor
    expected = np.array([[0, -1, 0, -0.03], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(T_cam_imu, expected, atol=1e-12)
    write_rig(rig, tmp_path / "rig.yaml")
    assert set(read_rig(tmp_path / "rig.yaml").imus) == set(rig.imus)


def test_an_imu_of_lines_leads_where_the_recording_leads(seen, tmp_path, monkeypatch):
    live, offline = tmp_path / "live.txt", tmp_path / "offline.txt"
    alive(
        ["foot_ins", "-o", live],
        lambda where: example(monkeypatch, "imu.py", "--replay", seen, "--to", where),
    )
    outcome("estimate", "foot_ins", seen, "-o", offline)
    ours, theirs = read_tum(live), read_tum(offline)
    assert len(ours) == len(theirs)
    # Stamps are the system's, by way of the device's clock, to a few milliseconds where the machine is busy.
    np.testing.assert_allclose(ours.p_frame_in_world[-1], theirs.p_frame_in_world[-1], atol=0.05)


@pytest.fixture
def imu_example(monkeypatch):
    """What examples/imu.py defines."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    return runpy.run_path(str(ROOT / "examples/imu.py"))


def test_lines_of_an_imu_that_are_none_are_passed_over(imu_example):
    parsed = imu_example["parsed"]
    device_ns, numbers = parsed("12345678,0.01,-0.02,0.00,0.1,0.2,9.8\r\n")
    assert device_ns == 12_345_678_000
    assert numbers.tolist() == [0.01, -0.02, 0.0, 0.1, 0.2, 9.8]
    for line in (
        "",
        ".00,0.1,0.2,9.8",
        "02,0.00,0.1,0.2,9.8",
        "1,2,3,4,5,6",
        "1,2,3,4,5,6,7,8",
        "1,2,3,4,5,6,",
        "1,2,3,4,5,6,nan",
        "1,2,3,4,5,6,inf",
        "t,gx,gy,gz,ax,ay,az",
        "1.5,2,3,4,5,6,7",
        "1,2,3,4,5,6,\ufffd7",
    ):
        assert parsed(line) is None, line


def test_a_serial_port_is_joined_in_the_middle_of_a_line(imu_example, monkeypatch):
    said = [b",0.1,0.2,9.8\n", b"1000,1,2,3,4,5,6\n", b"\xff\xfe\n", b"2000,1,2,3,4,5,6\n"]

    class Serial:
        def __init__(self, port, baud):
            self.lines = iter(said)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def readline(self):
            return next(self.lines)

    monkeypatch.setitem(sys.modules, "serial", types.SimpleNamespace(Serial=Serial))
    lines = imu_example["from_serial"]("/dev/ttyUSB0")
    parsed = [imu_example["parsed"](next(lines)) for _ in range(3)]
    assert [t and t[0] for t in parsed] == [1_000_000, None, 2_000_000]


@pytest.mark.parametrize("then_us", [0, 4_000_000_000], ids=["from 0", "from later on"])
def test_a_clock_that_goes_back_is_followed_anew(imu_example, monkeypatch, then_us):
    now = [1_700_000_000_000_000_000]
    monkeypatch.setattr(time, "time_ns", lambda: now[0])
    clock, stamps = imu_example["DeviceClock"](), []
    for start_us in (2**32 - 500_000, then_us):
        for i in range(100):
            now[0] += 5_000_000
            stamps.append(clock.system_ns((start_us + 5_000 * i) * 1000))
    steps = np.diff(stamps)
    assert steps.min() > 4_900_000
    assert steps.max() < 5_100_000


def test_the_adapter_of_the_page_sends(tmp_path, monkeypatch):
    (snippet,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
    monkeypatch.chdir(tmp_path)
    Path("rig.yaml").write_text(text)
    made = alive(
        ["foot_ins", "-o", tmp_path / "path.txt"], lambda where: exec(snippet.replace("7365", where.split(":")[1]))
    )
    assert made.data["streams"]["/foot_l/imu"]["received"] == 1


def test_examples_compile():
    files = {file.name: file for file in (ROOT / "examples").glob("*.py")}
    assert {"imu.py", "realsense.py", "replay.py", "ros2_forward.py"} <= set(files)
    for file in files.values():
        assert compile(file.read_text(encoding="utf-8"), file, "exec").co_filename == str(file)


def test_a_ros_node_forwards_messages_as_they_are(tmp_path, monkeypatch):
    """With a stand-in for rclpy, which is not there: what it hands over is the message's bytes."""
    subscribed = {}

    class Node:
        def __init__(self, name):
            self.name = name

        def create_subscription(self, kind, topic, callback, qos, *, raw):
            assert raw
            subscribed[topic] = kind, callback

    stand_in = {
        "rclpy": {"init": lambda: None, "spin": lambda node: spin(node)},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "rosidl_runtime_py": {},
        "rosidl_runtime_py.utilities": {"get_message": lambda name: name},
    }
    for name, parts in stand_in.items():
        module = types.ModuleType(name)
        vars(module).update(parts)
        monkeypatch.setitem(sys.modules, name, module)
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
    plain = rig_from_yaml(text, "page")
    write_rig(plain, tmp_path / "rig.yaml")
    encoder = MessageEncoder(plain)
    samples = [
        Imu(
            topic="/foot_l/imu",
            t_ns=i * 10_000_000 + 10**9,
            angular_rate=np.full(3, 0.01 * i),
            specific_force=np.ones(3),
        )
        for i in range(20)
    ]

    def forward(where):
        until = time.monotonic() + 60
        while socket.socket().connect_ex(("127.0.0.1", int(where.split(":")[1]))) and time.monotonic() < until:
            time.sleep(0.05)  # a node does not look twice
        example(monkeypatch, "ros2_forward.py", tmp_path / "rig.yaml", *where.split(":"))

    def spin(node):
        kind, callback = subscribed["/xsens/imu"]
        assert kind == "sensor_msgs/msg/Imu"
        for sample in samples:
            callback(encoder.encode(sample).payload)

    recorded = tmp_path / "ros.mcap"
    made = alive(["--record", recorded], forward)
    assert made.data["streams"]["/foot_l/imu"]["received"] == 20
    block = Recording(recorded).block("/foot_l/imu")
    assert block.t_ns.tolist() == [s.t_ns for s in samples]
    parsed = typestore().deserialize_cdr(encoder.encode(samples[3]).payload, "sensor_msgs/msg/Imu")
    assert parsed.angular_velocity.x == pytest.approx(0.03)
    assert json.dumps(made.data)
