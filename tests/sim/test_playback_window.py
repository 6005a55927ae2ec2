"""A walk in MuJoCo's viewer: what the keys do, a window under a virtual display, and the error without one."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from stridetwin.cli.main import main
from stridetwin.sim.scene.playback_window import Playhead

SPACE, ENTER, RIGHT, LEFT, DOWN, UP, HOME = 32, 257, 262, 263, 264, 265, 268

WINDOW = """
import json, threading, time
from types import SimpleNamespace

import numpy as np
from mujoco import viewer

from stridetwin.sim.composition import compose
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.scene import playback_window
from stridetwin.sim.wearer.body import compile_model
from stridetwin.sim.world.bystanders import Crowd

config = TwinConfig(name="walk", route=Route(segments=(Level(length_m=2.0),)))
q = compile_model(compose(config).spec).qpos0


def moving(t):
    return np.tile(q, (len(t), 1)) + np.pad(t[:, None], ((0, 0), (0, len(q) - 1))), None


real, seen = viewer.launch_passive, {}


def until(true):
    end = time.monotonic() + 60
    while not true() and time.monotonic() < end:
        time.sleep(0.02)
    return true()


def stands(data):
    before = data.time
    time.sleep(0.2)
    return data.time == before


def launch(model, data, **how):
    window, press = real(model, data, **how), how["key_callback"]

    def drive():
        # both are read while they change
        seen["moves"] = until(lambda: data.time > 0.3) and bool(abs(data.qpos[0] - data.time) < 0.5)
        press(32)
        seen["pauses"] = until(lambda: stands(data))
        stopped = data.time
        press(257)
        seen["follows"] = window.cam.trackbodyid == model.body("pelvis").id
        seen["through a camera"] = until(lambda: window.cam.fixedcamid == 0)
        press(262)
        seen["jumps"] = until(lambda: data.time == stopped + 1.0)
        window.close()

    threading.Thread(target=drive, daemon=True).start()
    return window


viewer.launch_passive = launch
playback_window.check_display()
walk = SimpleNamespace(duration_s=50.0, position_velocity=moving)
playback_window.play(SimpleNamespace(config=config, seed=1, crowd=Crowd(), walk=walk))
print(json.dumps(seen))
"""
"""A window with a walker who glides along x at 1 m/s; a thread presses keys and closes it."""


@pytest.fixture
def display():
    """Number of a virtual display."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed (tools/system_packages.sh installs it)")
    read, write = os.pipe()
    words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "160x120x24", "-nolisten", "tcp"]
    server = subprocess.Popen(words, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as file:
        number = file.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()


def test_window_plays_pauses_jumps_and_looks_through_cameras(display):
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-c", WINDOW],
        env=environment | {"DISPLAY": display},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen == dict.fromkeys(("moves", "pauses", "follows", "through a camera", "jumps"), True)


def test_without_a_display_the_error_is_one_line(monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    if sys.platform != "linux":
        pytest.skip("other systems have their display without a variable")
    assert main(["view", "level_20m", "--mujoco"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("stridetwin: error: no display for MuJoCo's viewer: expected a screen")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--mujoco", "-o", "x.rrd"], "view: -o: invalid 'x.rrd': expected no -o with --mujoco"),
        (["--mujoco", "--lenient"], "view: --lenient: invalid True: expected no --lenient with --mujoco"),
        (["--seed", "3"], "view: --seed: invalid 3: expected no --seed, as a recording has its own"),
    ],
)
def test_options_of_the_other_viewer_are_refused(words, said, capsys):
    assert main(["view", "level_20m", *words]) == 2
    assert said in capsys.readouterr().err


def played(*keys):
    head = Playhead(duration_s=10.0, cameras=("follow", "head"))
    for key in keys:
        head.press(key)
    return head


def test_playback_advances_with_real_time_times_its_speed():
    head = played()
    head.advance(0.5)
    assert head.time_s == 0.5
    head.press(UP)
    head.advance(0.5)
    assert (head.speed, head.time_s) == (2.0, 1.5)
    assert played(DOWN, DOWN).speed == 0.25
    assert played(*[UP] * 9).speed == 16.0
    assert played(*[DOWN] * 9).speed == 1 / 16


def test_playback_pauses_at_the_end_and_starts_again():
    head = played()
    head.advance(11.0)
    assert (head.time_s, head.paused) == (10.0, True)
    head.press(SPACE)
    assert (head.time_s, head.paused) == (0.0, False)
    head.press(SPACE)
    head.advance(1.0)
    assert head.time_s == 0.0


def test_keys_jump_within_the_walk_and_cycle_cameras():
    assert played(RIGHT, RIGHT, LEFT).time_s == 1.0
    assert played(LEFT).time_s == 0.0
    assert played(*[RIGHT] * 12).time_s == 10.0
    assert played(RIGHT, HOME).time_s == 0.0
    assert played(ENTER).camera == 1
    assert played(ENTER, ENTER).camera == 0
    assert played(65) == played()
