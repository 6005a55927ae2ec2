"""Visual bodies of the sensors on the wearer: housings, boards and pods, placed by the rig's mounts."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

from stridetwin.sim.config import SIDES
from stridetwin.sim.wearer.imu_places import thin_axis
from stridetwin.sim.wearer.leaves import read_leaf
from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.rig import Mount, Rig

UPPERS = {f"foot_{side}": f"upper_{side}" for side in SIDES}
"""Body that carries the mounts of a foot: the shoe's upper, which moves a little (`heel_strike.UpperMotion`)."""


def add_rig(spec: mujoco.MjSpec, rig: Rig) -> None:
    """Attaches massless bodies that do not collide to the wearer's bodies, one per visible sensor or board.

    Those of a shoe hang on a separate body (`UPPERS`), which coincides with the foot at rest.

    Args:
        spec: Model with the wearer's bodies.
        rig: Rig with the true mounts.
    """
    for foot, upper in UPPERS.items():
        spec.body(foot).add_body(name=upper)
    for name, part, _, mount in visible_items(rig):
        T = mount.T_body_sensor
        frame = spec.body(UPPERS.get(mount.body, mount.body)).add_frame(pos=T[:3, 3], quat=to_quaternion(T[:3, :3]))
        # the leaf's body is named after its part; the prefix makes that the name of the item
        frame.attach_body(read_leaf(part).body(part), name.removesuffix(part), "")


_CASES = ("imu_pod_front", "imu_pod", "imu_pod_top")
"""Cases of an IMU that are thin along its x, y and z axis."""


def _imu_case(topic: str) -> str:
    """Part of an IMU's case, which lies flat where it is worn."""
    group, _, place = topic.removesuffix("/imu").rpartition("/")
    return _CASES[thin_axis(place)] if group == "/body" else "imu_pod"


def visible_items(rig: Rig) -> Iterator[tuple[str, str, str, Mount]]:
    """Sensors and boards that are visible on the wearer.

    IMUs inside another housing, of an RGB-D camera or an AHRS, are left out.

    Yields:
        Name of the body, name of its part's MJCF file in `assets`, topic (empty for a board) and mount.
    """
    shown: list[tuple[str, str, Mount]] = []
    for topic, camera in rig.cameras.items():
        shown.append(("rgbd_camera" if camera.depth_topic else "shoe_camera", topic, camera.mount))
    shown += [("checkerboard", "", board.mount) for board in rig.boards.values()]
    inside = {camera.imu_topic for camera in rig.cameras.values() if camera.depth_topic}
    inside |= {topic for topic, imu in rig.imus.items() if imu.mount.body.startswith("exo_")}  # part of an AHRS
    shown += [(_imu_case(topic), topic, imu.mount) for topic, imu in rig.imus.items() if topic not in inside]
    shown += [("sonar_pod", topic, s.mount) for topic, s in rig.others.items() if s.kind == "range"]
    for i, (part, topic, mount) in enumerate(shown):
        yield f"rig_{i}_{part}", part, topic, mount
