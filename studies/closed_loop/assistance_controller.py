"""Assistance of hips and knees by locomotion mode: torque in the direction of the joint's motion.

Negative damping, as in Aguirre-Ollinger et al. 2007, Active-impedance control of a lower-limb assistive exoskeleton
(IEEE ICORR, 188-195): torque proportional to the joint's speed, up to the module's limit. It assists extension in
stance, which lifts the body, and flexion in swing, which lifts the leg; the mode sets its share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.sim.config import SIDES
from stridetwin.sim.dynamics.drive import PERIOD_S
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Insole, Sample
from stridetwin.studies.closed_loop.environment import Streams
from stridetwin.studies.closed_loop.recognition import Recognition

LOADED_N = 80.0
"""Force above which a foot is loaded; an unloaded insole measures far less."""


class TorqueShares(NamedTuple):
    """Share of the torque limit (0-1) that a joint gets while it extends, and while it flexes."""

    extending: float = 0.0
    bending: float = 0.0


# full torque in one direction or in both
_EXTENDING, _BENDING, _BOTH = TorqueShares(extending=1.0), TorqueShares(bending=1.0), TorqueShares(1.0, 1.0)


class ModeAssistance(NamedTuple):
    """Assistance of one mode. A joint that `stance` or `swing` does not name, such as the ankle, gets no torque.

    Attributes:
        share: Share of the torque limit, 0-1, which multiplies those of the joints.
        stance: Shares of each joint of a loaded leg, by its name without side, such as `hip`.
        swing: Shares of each joint of an unloaded leg, by its name without side.
    """

    share: float
    stance: Mapping[str, TorqueShares] = {"hip": _BOTH, "knee": _EXTENDING}
    swing: Mapping[str, TorqueShares] = {"hip": TorqueShares(0.3, 1.0), "knee": _BENDING}


ASSISTANCE = {
    "LG": ModeAssistance(share=0.5),
    "SA": ModeAssistance(
        share=1.0, stance={"hip": _EXTENDING, "knee": _EXTENDING}, swing={"hip": _BOTH, "knee": _BOTH}
    ),
    "SD": ModeAssistance(share=0.5),
    "RA": ModeAssistance(share=1.0),
    "RD": ModeAssistance(share=0.75),
}
"""The values that save most work at the wearer's hips and knees; with more the wearer has to brake. Up stairs the hip
is only assisted in extension under load, and hip and knee also extend the leg onto the next tread."""
FULL_RADPS, STANCE_RADPS = 0.8, 0.3
"""Joint speed at which the torque reaches its limit: in general, and in extension under load."""
SMOOTHING_S = 0.05
"""Time constant of the torque; frame and mounts oscillate with a smaller as with a larger one."""


class AssistanceObserver(Streams):
    """Observations of an assistance by mode: the streams, which feet are loaded, and their modes.

    Besides `Streams`: `loaded` (2,) 1 for a loaded foot, left first; `mode` (2,) index into
    `estimators.locomotion_mode.MODES`: of the current step of a loaded foot, of the next step of an unloaded one.

    Args:
        rig: The sensors.
        recognition: Makes the mode recognition of each walk.
    """

    def __init__(self, rig: Rig, recognition: Callable[[], Recognition]) -> None:
        super().__init__(rig)
        self._make_recognition = recognition
        self._recognition = Recognition()
        self._loaded = dict.fromkeys(SIDES, True)

    def reset(self) -> None:
        """Starts a walk: both feet count as loaded, and the recognition begins anew."""
        super().reset()
        self._recognition = self._make_recognition()
        self._loaded = dict.fromkeys(SIDES, True)

    def update(self, samples: Iterable[Sample]) -> None:
        """Takes the samples that arrived, in time order, for streams, loads and modes."""
        sample_list = list(samples)
        super().update(sample_list)
        for sample in sample_list:
            self._recognition.update(sample)
            if isinstance(sample, Insole):
                side = sample.topic[len("/foot_")]  # topics are `/foot_l/insole` and `/foot_r/insole`
                self._loaded[side] = float(sample.force.sum()) > LOADED_N

    def observation(self) -> dict[str, Array]:
        """The latest value of each sensor by topic, `loaded`, and `mode`.

        `loaded` (2,) is 1 for a loaded foot and 0 for an unloaded one, left first. `mode` (2,) is an index into
        `MODES`: of the current step of a loaded foot, of the next step of an unloaded one.
        """
        recognition = self._recognition
        modes = [recognition.current[foot] if self._loaded[foot] else recognition.upcoming[foot] for foot in SIDES]
        return {
            **super().observation(),
            "loaded": np.array([float(self._loaded[foot]) for foot in SIDES]),
            "mode": np.array([float(MODES.index(mode)) for mode in modes]),
        }


class AssistanceController:
    """Controller from observations of `AssistanceObserver` to torques.

    Args:
        joints: In the order of actions.
        max_torque_nm: (n,) torque limits, N m.
    """

    def __init__(self, joints: Sequence[str], max_torque_nm: Array) -> None:
        self._joints, self._max_torque_nm = joints, max_torque_nm
        self._torque = np.zeros(len(joints))  # the last command, N m

    def torques(self, observation: Mapping[str, Array]) -> Array:
        """Torque commands from an observation; call it once per `PERIOD_S`.

        Each command follows its target, the share of the torque limit by mode and load, with the time constant
        `SMOOTHING_S`; the controller keeps the last commands for that.

        Returns:
            (n,) N m, flexion positive, in the order of the joints.
        """
        # (n,) N m
        target = np.array([_torque_share(joint, observation) for joint in self._joints]) * self._max_torque_nm
        # backward Euler step of a first-order lag
        self._torque += (target - self._torque) * PERIOD_S / (SMOOTHING_S + PERIOD_S)
        return self._torque.copy()


def _torque_share(joint: str, observation: Mapping[str, Array]) -> float:
    """Share of the torque limit for one joint, -1 to 1.

    It is the share of the mode, times that of leg and direction, times min(|speed| / full speed, 1), where the full
    speed is `STANCE_RADPS` in extension under load, else `FULL_RADPS`. Speed and torque are positive in flexion, so
    that the torque has the sign of the speed.

    A leg in swing takes the mode with the larger share of both legs, because a leg that swings up from the last tread
    has to be lifted though it comes down on the level. Without a sample of the joint the share is 0.

    Args:
        joint: Name of the joint with its side, such as `hip_l`.
        observation: From `AssistanceObserver.observation`.
    """
    name, side = joint.split("_")
    foot = SIDES.index(side)
    actuator = observation[f"exo/{joint}/actuator"]  # (3,) torque command and torque, N m, and speed, rad/s
    speed = float(actuator[2])
    loaded = observation["loaded"][foot] > 0.0
    modes = [MODES[int(mode)] for mode in observation["mode"]]
    mode = modes[foot] if loaded else max(modes, key=lambda mode: ASSISTANCE[mode].share)
    assistance = ASSISTANCE[mode]
    shares = (assistance.stance if loaded else assistance.swing).get(name, TorqueShares())  # ankles get no torque
    if not abs(speed) > 0.0:  # at rest, or NaN, because no sample has arrived yet
        return 0.0
    share = -shares.extending if speed < 0.0 else shares.bending
    full_radps = STANCE_RADPS if speed < 0.0 and loaded else FULL_RADPS
    return assistance.share * share * min(abs(speed) / full_radps, 1.0)
