"""A walk in MuJoCo's passive viewer, in real time.

The window shows the scene of the walk (`scene_spec`): its sensors' cameras can be looked through.
"""

from __future__ import annotations

import queue
import threading
import time
import warnings
from dataclasses import dataclass

import glfw
import mujoco
import numpy as np
from mujoco import viewer

from stridetwin.sim.scene.scene_spec import scene_spec
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.body import compile_model
from stridetwin.sim.world.bystanders import pose_crowd
from stridetwin.streams.errors import StrideTwinError

KEYS = {
    "space": "pause",
    "left, right": "1 s back, ahead",
    "down, up": "slower, faster",
    "home": "to the start",
    "enter": "next camera",
}
"""Keys, and what they do; the window shows them."""
_SPACE, _ENTER, _RIGHT, _LEFT, _DOWN, _UP, _HOME = 32, 257, 262, 263, 264, 265, 268  # GLFW's numbers
_FRAME_S = 1 / 60  # least time of a frame
_CLOSE_S = 5.0  # longest wait for the viewer's thread
_JUMP_S = 1.0  # by which an arrow key moves the time
_SLOWEST, _FASTEST = 1 / 16, 16.0  # speeds
FOLLOW = "follow the walker"  # name of camera 0


@dataclass
class Playhead:
    """Time, speed and camera of a playback; keys and the passing time change them.

    Attributes:
        duration_s: Length of the walk.
        cameras: Names of the cameras in turn.
        time_s: Time in the walk.
        speed: Of the walk over real time.
        paused: Whether it stands still; at the end of the walk it does.
        camera: Number of the camera.
    """

    duration_s: float
    cameras: tuple[str, ...]
    time_s: float = 0.0
    speed: float = 1.0
    paused: bool = False
    camera: int = 0

    def press(self, key: int) -> None:
        """Handles a key, by its GLFW number; keys without a meaning here have no effect."""
        if key == _SPACE:
            if self.paused and self.time_s >= self.duration_s:  # at the end: start again
                self.time_s = 0.0
            self.paused = not self.paused
        elif key in (_LEFT, _RIGHT):
            self._seek(self.time_s + (_JUMP_S if key == _RIGHT else -_JUMP_S))
        elif key in (_DOWN, _UP):
            self.speed = min(max(self.speed * (2.0 if key == _UP else 0.5), _SLOWEST), _FASTEST)
        elif key == _HOME:
            self._seek(0.0)
        elif key == _ENTER:
            self.camera = (self.camera + 1) % len(self.cameras)

    def advance(self, elapsed_s: float) -> None:
        """Advances the playback by `elapsed_s` of real time; it pauses at the end of the walk."""
        if not self.paused:
            self._seek(self.time_s + self.speed * elapsed_s)
            self.paused = self.time_s >= self.duration_s

    def _seek(self, time_s: float) -> None:
        """Sets the time, within the walk."""
        self.time_s = min(max(time_s, 0.0), self.duration_s)


def check_display() -> None:
    """Rejects a machine without a display, where MuJoCo's viewer would end the process.

    Raises:
        StrideTwinError: There is no display.
    """
    with warnings.catch_warnings(record=True):  # GLFW warns where it has no display
        warnings.simplefilter("always")
        has_display = glfw.init()
    if not has_display:
        raise StrideTwinError("no display for MuJoCo's viewer: expected a screen, on Linux DISPLAY or WAYLAND_DISPLAY")


def play(twin: Twin) -> None:
    """Opens a window and plays a walk until the window is closed; call `check_display` first.

    Raises:
        StrideTwinError: No window can be opened.
    """
    model = compile_model(scene_spec(twin.config, twin.seed))
    data = mujoco.MjData(model)
    walk, pressed = twin.walk, queue.SimpleQueue[int]()  # the viewer's thread puts the keys into the queue
    before = threading.enumerate()  # threads that are not the viewer's
    head = Playhead(walk.duration_s, (FOLLOW, *(model.camera(i).name for i in range(model.ncam))))
    with _launch_viewer(model, data, pressed) as window:
        shown, last = -1, time.monotonic()  # number of the camera that is shown, and time of the last frame
        while window.is_running():
            start = time.monotonic()
            while not pressed.empty():
                head.press(pressed.get())
            head.advance(start - last)
            last = start
            with window.lock():
                if shown != head.camera:  # otherwise the mouse moves the view
                    _aim_camera(window.cam, model, head)
                    shown = head.camera
                qpos, _ = walk.position_velocity(np.array([head.time_s]))
                data.qpos, data.time = qpos[0], head.time_s
                pose_crowd(model, data, twin.crowd, head.time_s)
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_camlight(model, data)
            window.set_texts((None, None, *_overlay_text(head)))
            window.sync()
            time.sleep(max(_FRAME_S - (time.monotonic() - start), 0.0))
    for thread in threading.enumerate():  # the viewer's own draws until it has seen the end; Python must not go first
        if thread not in before:
            thread.join(_CLOSE_S)


def _launch_viewer(model: mujoco.MjModel, data: mujoco.MjData, pressed: queue.SimpleQueue[int]) -> viewer.Handle:
    """Opens MuJoCo's passive viewer; pressed keys arrive in the queue.

    Raises:
        StrideTwinError: No window can be opened, on macOS for example without `mjpython`.
    """
    try:
        return viewer.launch_passive(model, data, key_callback=pressed.put, show_left_ui=False, show_right_ui=False)
    except RuntimeError as error:  # macOS without mjpython
        raise StrideTwinError(f"MuJoCo's viewer: {error}") from error


def _aim_camera(camera: mujoco.MjvCamera, model: mujoco.MjModel, head: Playhead) -> None:
    """Sets the window's camera: one of the model, or for number 0 a view that follows the pelvis."""
    if head.camera:
        # the model's own cameras count from 0, those of the window from 1
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, head.camera - 1
        return
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_TRACKING, -1
    camera.trackbodyid = model.body("pelvis").id
    camera.azimuth, camera.elevation, camera.distance = 140.0, -12.0, 4.0  # degrees, degrees, m


def _overlay_text(head: Playhead) -> tuple[str, str]:
    """Two columns of text in a corner of the window: time, speed, camera and keys."""
    rows = (
        ("time", f"{head.time_s:.1f} of {head.duration_s:.1f} s{', paused' if head.paused else ''}"),
        ("speed", f"{head.speed:g} x real time"),
        ("camera", head.cameras[head.camera]),
        *KEYS.items(),
    )
    return "\n".join(row[0] for row in rows), "\n".join(row[1] for row in rows)
