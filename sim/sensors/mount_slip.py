"""Mount slip: sensors that rotate and move on the body that carries them during a walk, or vibrate after heel strikes.

Both are physical: inertial sensors measure it, cameras change their view, and the ground truth of an IMU's frame
includes them. The nominal calibration in the recording does not change.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.sim.faults.faults import Event, Events, Fault, LooseStrap
from stridetwin.sim.gait.heel_strike import UpperMotion
from stridetwin.sim.kinematics.smooth import ease, ease_rate
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.wearer.sensor_bodies import visible_items
from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Slip:
    """A slip from one pose to another, smooth up to the acceleration.

    Attributes:
        from_ns: Start time.
        until_ns: End time; the new pose is permanent.
        rotation: (3,) rad, rotation vector in the body's axes.
        translation: (3,) m, in the body's axes.
        pivot: (3,) m in the body, pivot of the rotation.
    """

    from_ns: int
    until_ns: int
    rotation: Array
    translation: Array
    pivot: Array

    def mount_track(self, body: Track) -> Track:
        """Track of a frame on a body that coincides with the body's frame before the slip and moves with it."""
        share, rate = (x[:, None] for x in self._share(body.t_ns))  # (N, 1) completed share of the slip, and its rate
        p, phi = self.translation, self.rotation
        return body.displace(self.pivot, share * p, share * phi, rate * p, rate * phi)

    def T_body_frame(self, t_ns: int) -> Array:
        """(4, 4) pose of the slipped frame in the body at one time."""
        share, _ = self._share(np.array([t_ns]))
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(share[0] * self.rotation).as_matrix()
        T[:3, 3] = self.pivot - T[:3, :3] @ self.pivot + share[0] * self.translation
        return T

    def _share(self, t_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """(N,) completed share of the slip, 0-1, at (N,) ns, and its rate, 1/s."""
        length = self.until_ns - self.from_ns  # ns
        s = (t_ns - self.from_ns) / length
        return ease(s), ease_rate(s) * 1e9 / length


@dataclass(frozen=True, kw_only=True, eq=False)
class MountSlips:
    """Slips of the sensor mounts.

    Attributes:
        slips: Slips in order of their start, by topic; topics without slips are missing.
        housings: Body of the model, and mount, of visible sensors with slips, by topic.
        strikes: Vibration on the body after heel strikes, by topic; images do not show these millimetres.
    """

    slips: Mapping[str, tuple[Slip, ...]] = field(default_factory=dict)
    housings: Mapping[str, tuple[str, Mount]] = field(default_factory=dict)
    strikes: Mapping[str, UpperMotion] = field(default_factory=dict)

    @classmethod
    def of(cls, planned: Iterable[tuple[Fault, Events]], rig: Rig) -> MountSlips:
        """Slips of the loose straps among planned faults.

        Sensors of one body and one strap slip about their common centre.

        Args:
            planned: Faults with their events (`plan_faults`).
            rig: Rig with the true mounts.
        """
        slips: dict[str, list[Slip]] = {}
        for fault, events in planned:
            if isinstance(fault, LooseStrap):
                for topics in _topics_by_body(events, rig).values():
                    # middle of the sensors on this body; they all have the same events
                    pivot = np.mean([position for _, position in (_mounts(rig)[t] for t in topics)], axis=0)
                    for event in events[topics[0]]:
                        slip = _draw_slip(fault, event, pivot)
                        for topic in topics:
                            slips.setdefault(topic, []).append(slip)
        return cls(
            slips={t: tuple(sorted(s, key=lambda slip: slip.from_ns)) for t, s in slips.items()},
            housings={topic: (name, mount) for name, _, topic, mount in visible_items(rig) if topic in slips},
        )

    def mount_track(self, topic: str, body: Track) -> Track:
        """Track of the frame that holds a sensor's mount, after strikes and all its slips, given that of its body."""
        if topic in self.strikes:
            body = self.strikes[topic].upper_track(body)
        for slip in self.slips.get(topic, ()):
            body = slip.mount_track(body)
        return body

    def T_body_frame(self, topic: str, t_ns: int) -> Array:
        """(4, 4) pose in the body, at one time, of the frame that holds a sensor's mount."""
        T = np.eye(4)
        for slip in self.slips.get(topic, ()):
            T = T @ slip.T_body_frame(t_ns)
        return T

    def move_housings(self, model: mujoco.MjModel, t_ns: int) -> None:
        """Moves the visible housings of slipping sensors in a model to their poses at one time."""
        for topic, (name, mount) in self.housings.items():
            T, housing = self.T_body_frame(topic, t_ns) @ mount.T_body_sensor, model.body(name)
            housing.pos, housing.quat = T[:3, 3], to_quaternion(T[:3, :3])


def _draw_slip(fault: LooseStrap, event: Event, pivot: Array) -> Slip:
    """Slip of an event, about a random axis and in a random direction.

    Args:
        fault: The loose strap, which gives angle, distance and duration; without a duration the slip takes as long as
            the event.
        event: The event, which draws axis and direction.
        pivot: (3,) m on the body, about which all sensors on the strap rotate.
    """
    # normal deviates in each axis give uniformly distributed directions
    axis, direction = (v / np.linalg.norm(v) for v in event.rng().standard_normal((2, 3)))
    length = event.until_ns - event.from_ns if fault.duration_s is None else round(fault.duration_s * 1e9)
    return Slip(
        from_ns=event.from_ns,
        until_ns=event.from_ns + length,
        rotation=fault.angle_rad * axis,
        translation=fault.shift_m * direction,
        pivot=pivot,
    )


def _topics_by_body(events: Events, rig: Rig) -> dict[str, list[str]]:
    """Topics with events, by the body that carries their sensors."""
    bodies: dict[str, list[str]] = {}
    for topic, (body, _) in _mounts(rig).items():
        if topic in events:
            bodies.setdefault(body, []).append(topic)
    return bodies


def _mounts(rig: Rig) -> dict[str, tuple[str, Array]]:
    """Body and position (3,) m on it of every sensor, by topic; a camera is listed once, under its colour topic."""
    mounts = {topic: sensor.mount for group in (rig.imus, rig.cameras, rig.others) for topic, sensor in group.items()}
    return {topic: (mount.body, mount.T_body_sensor[:3, 3]) for topic, mount in mounts.items()}
