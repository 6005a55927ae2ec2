"""Help with hips and knees, by mode: each joint is pushed the way it turns, where the mode wants work of it.

Negative damping, as of Aguirre-Ollinger et al. 2007, Active-impedance control of a lower-limb assistive exoskeleton
(IEEE ICORR, 188-195): a push that grows with the joint's speed, up to what the module may give. In stance it goes with
extension, where the body is lifted, in swing with flexion, where the leg is; how much of it is a question of the mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.scenarios.closed_loop.observers import Streams
from stridetwin.scenarios.closed_loop.recognition import Recognition, Unaware
from stridetwin.sim.config import SIDES
from stridetwin.sim.dynamics.drive import PERIOD_S
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Insole, Sample

LOADED_N = 80.0
"""An insole that tells more is stood on; what an unloaded one tells stays well below."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """How much of the most torque a joint is pushed with, in each direction (0-1).

    Attributes:
        extending: Where it extends.
        bending: Where it bends.
    """

    extending: float = 0.0
    bending: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Help:
    """How a mode is helped.

    Attributes:
        share: Of the most torque.
        stance: By joint, of the leg that is stood on.
        swing: By joint, of the other.
    """

    share: float
    stance: Mapping[str, Push] = field(
        default_factory=lambda: {"hip": Push(extending=1.0, bending=1.0), "knee": Push(extending=1.0)}
    )
    swing: Mapping[str, Push] = field(
        default_factory=lambda: {"hip": Push(extending=0.3, bending=1.0), "knee": Push(bending=1.0)}
    )


HELP = {
    "LG": Help(share=0.5),
    "SA": Help(
        share=1.0,
        stance={"hip": Push(extending=1.0), "knee": Push(extending=1.0)},
        swing={"hip": Push(extending=1.0, bending=1.0), "knee": Push(extending=1.0, bending=1.0)},
    ),
    "SD": Help(share=0.5),
    "RA": Help(share=1.0),
    "RD": Help(share=0.75),
}
"""What saves the wearer's hips and knees most work; more of it he has to brake. Up stairs the hip only extends under
load, and hip and knee extend the leg down onto the next tread."""
FULL_RADPS, STANCE_RADPS = 0.8, 0.3
"""Speed from which on a joint is pushed with all that its mode gives, and where it extends under load."""
SMOOTHING_S = 0.05
"""With less, as with more, frame and straps swing on what the wearer then has to do."""


class Helped(Streams):
    """What a controller that helps by mode sees: the streams, which feet are loaded, and their modes.

    Besides `Streams`: `loaded` (2,) 1 where a foot is stood on, left first; `mode` (2,) numbers of
    `estimators.locomotion_mode.MODES`: of the step that a foot stands on, or in the air makes.

    Args:
        rig: The sensors.
        recognition: Makes who tells the modes, anew for each walk.
    """

    def __init__(self, rig: Rig, recognition: Callable[[], Recognition]) -> None:
        super().__init__(rig)
        self._begin = recognition
        self._recognition: Recognition = Unaware()
        self._loaded = dict.fromkeys(SIDES, True)

    def reset(self) -> None:
        """As `Observer`."""
        super().reset()
        self._recognition = self._begin()
        self._loaded = dict.fromkeys(SIDES, True)

    def update(self, samples: Iterable[Sample]) -> None:
        """As `Observer`."""
        taken = list(samples)
        super().update(taken)
        for sample in taken:
            self._recognition.update(sample)
            if isinstance(sample, Insole):
                self._loaded[sample.topic[len("/foot_")]] = float(sample.force.sum()) > LOADED_N

    def observation(self) -> dict[str, Array]:
        """As `Observer`."""
        told = self._recognition
        modes = [told.standing[foot] if self._loaded[foot] else told.coming[foot] for foot in SIDES]
        return {
            **super().observation(),
            "loaded": np.array([float(self._loaded[foot]) for foot in SIDES]),
            "mode": np.array([float(MODES.index(mode)) for mode in modes]),
        }


class Helper:
    """From what `Helped` has seen to torques.

    Args:
        joints: In the order of actions.
        most: (n,) N m.
    """

    def __init__(self, joints: Sequence[str], most: Array) -> None:
        self._joints, self._most = joints, most
        self._torque = np.zeros(len(joints))

    def torques(self, seen: Mapping[str, Array]) -> Array:
        """(n,) N m to be asked for now, flexion positive; called once a `PERIOD_S` with an observation."""
        wanted = np.array([_share(joint, seen) for joint in self._joints]) * self._most
        self._torque += (wanted - self._torque) * PERIOD_S / (SMOOTHING_S + PERIOD_S)
        return self._torque.copy()


def _share(joint: str, seen: Mapping[str, Array]) -> float:
    """Of the most torque, -1 to 1."""
    name, side = joint.split("_")
    foot, speed = SIDES.index(side), float(seen[f"exo/{joint}/actuator"][2])
    loaded = seen["loaded"][foot] > 0.0
    modes = [MODES[int(mode)] for mode in seen["mode"]]
    # a leg that swings up from the last tread has to be lifted, though it comes down on the level
    of = HELP[modes[foot] if loaded else max(modes, key=lambda mode: HELP[mode].share)]
    pushed = (of.stance if loaded else of.swing).get(name, Push())  # an ankle's motor is not asked
    if speed > 0.0:
        push, full = pushed.bending, FULL_RADPS
    elif speed < 0.0:
        push, full = -pushed.extending, STANCE_RADPS if loaded else FULL_RADPS
    else:
        return 0.0  # nor where nothing has come yet
    return of.share * push * min(abs(speed) / full, 1.0)
