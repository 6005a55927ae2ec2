"""Faults of an odometry's poses on their way to estimators of terrain and modes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from stridetwin.sim.faults.faults import Events, Fault, StreamFault
from stridetwin.streams.fields import DEG, number
from stridetwin.streams.pose_restart import PoseRestart
from stridetwin.streams.samples import Odometry

_Length = Annotated[float, number(-1000, 1000)]


@dataclass(frozen=True, kw_only=True)
class Restart(StreamFault):
    """An odometry that is lost during the event, and then starts again in another frame, permanently.

    It acts on the poses of the replay (`streams.pose_restart`), which a twin does not have.

    Attributes:
        yaw_rad: Rotation about the vertical from the old frame to the new one.
        translation_m: Translation from the old frame to the new one, after the rotation.
    """

    kind = "restart"
    fits = (Odometry,)
    yaw_rad: Annotated[float, number(-180, 180, key="yaw_deg", scale=DEG)] = 0.0
    translation_m: tuple[_Length, _Length, _Length] = (0.0, 0.0, 0.0)


def pose_restarts(planned: Iterable[tuple[Fault, Events]]) -> list[PoseRestart]:
    """The restarts of planned faults, in time order."""
    restarts = [
        PoseRestart(
            from_ns=event.from_ns, until_ns=event.until_ns, yaw_rad=fault.yaw_rad, translation_m=fault.translation_m
        )
        for fault, events in planned
        if isinstance(fault, Restart)
        for of_topic in events.values()
        for event in of_topic
    ]
    return sorted(restarts, key=lambda restart: restart.from_ns)
