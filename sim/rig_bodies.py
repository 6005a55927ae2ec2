"""What the sensors look like on the wearer: housings, boards and pods, put where the rig mounts them."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources

import mujoco

from stridetwin.sim.config import SIDES
from stridetwin.sim.rotation import quat_from_matrix
from stridetwin.streams.rig import Mount, Rig

UPPERS = {f"foot_{side}": f"upper_{side}" for side in SIDES}
"""Body that carries what is mounted on a foot: the shoe's upper, which moves a little (`shock.UpperMotion`)."""


def add_rig(spec: mujoco.MjSpec, rig: Rig) -> None:
    """Attaches massless bodies that do not collide to the wearer's bodies, one a visible sensor or board.

    Those of a shoe hang on a body of their own (`UPPERS`), which lies on the foot where nothing moves it.

    Args:
        spec: Model with the wearer's bodies.
        rig: Mounts as they really are.
    """
    for foot, upper in UPPERS.items():
        spec.body(foot).add_body(name=upper)
    for i, (leaf, mount) in enumerate(_visible(rig)):
        text = resources.files("stridetwin.assets").joinpath("mjcf", f"{leaf}.xml").read_text()
        T = mount.T_body_sensor
        frame = spec.body(UPPERS.get(mount.body, mount.body)).add_frame(pos=T[:3, 3], quat=quat_from_matrix(T[:3, :3]))
        frame.attach_body(mujoco.MjSpec.from_string(text).body(leaf), f"rig_{i}_", "")


def _visible(rig: Rig) -> Iterator[tuple[str, Mount]]:
    for camera in rig.cameras.values():
        yield ("rgbd_camera" if camera.depth_topic else "shoe_camera"), camera.mount
    for board in rig.boards.values():
        yield "checkerboard", board.mount
    depth_imus = {camera.imu_topic for camera in rig.cameras.values() if camera.depth_topic}
    for imu in rig.imus.values():
        if imu.topic not in depth_imus:
            yield "imu_pod", imu.mount
    for sensor in rig.others.values():
        if sensor.kind == "range":
            yield "sonar_pod", sensor.mount
