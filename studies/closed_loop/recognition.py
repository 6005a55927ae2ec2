"""Locomotion-mode recognition for the controller: the terrain under each foot, and that of its next step.

The prediction from the camera knows a step in advance; the recognition from the legs knows it once the foot is flat;
the truth serves for comparison.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence

import numpy as np

from stridetwin.estimators.contact_terrain import UNKNOWN, ContactTerrain, Exoskeleton
from stridetwin.estimators.locomotion_mode import MODES, LocomotionMode, ModeEstimate
from stridetwin.outputs.pose_feed import OdometryDriven
from stridetwin.sim.config import SIDES
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Sample

LEVEL_MODE = "LG"
"""Mode of level ground."""
_LATE_NS = 100_000_000
"""So long after its planned touch-down a step still counts as upcoming, because the foot may land late."""


class Recognition:
    """Modes of each foot's steps, from samples alone; without any recognition, level ground everywhere.

    Attributes:
        current: By foot, mode of its current step.
        upcoming: By foot, mode of its next step.
    """

    def __init__(self) -> None:
        self.current = dict.fromkeys(SIDES, LEVEL_MODE)
        self.upcoming = dict.fromkeys(SIDES, LEVEL_MODE)

    def update(self, sample: Sample) -> None:
        """Processes a sample; samples come in time order. Without recognition it does nothing."""


class CameraRecognition(Recognition):
    """Recognition with a camera: visual-inertial odometry, terrain map, and prediction of the modes of upcoming steps.

    Args:
        rig: With a camera with depth and IMU on head or chest, and insoles.
    """

    def __init__(self, rig: Rig) -> None:
        super().__init__()
        self._predictor = OdometryDriven(rig, LocomotionMode)
        self._next: tuple[int, str, str] | None = None  # next step as predicted last: its number, foot and mode

    def update(self, sample: Sample) -> None:
        """Passes a sample to odometry and predictor; a new prediction sets the modes."""
        self._predictor.update_odometry(sample)
        estimate = self._predictor.update(sample)
        if isinstance(estimate, ModeEstimate):
            self._update_modes(estimate)

    def _update_modes(self, estimate: ModeEstimate) -> None:
        """Sets the upcoming modes by a prediction.

        The current mode of a foot is what was predicted for the step it has taken.

        Args:
            estimate: Its `step` is the number of steps that have landed; its `steps` are the coming ones, the next
                first, whose foot is "" if it is not known.
        """
        if self._next is not None:
            number, foot, mode = self._next
            # the step that came next in the last prediction has landed; an unknown mode changes nothing
            if estimate.step >= number and mode != UNKNOWN:
                self.current[foot] = mode
        for step in reversed(estimate.steps):  # the nearest step of a foot is set last, and stays
            if step.foot and step.mode != UNKNOWN:
                self.upcoming[step.foot] = step.mode
        first = estimate.steps[0]  # the next estimate tells whether it has landed
        self._next = (first.step, first.foot, first.mode) if first.foot else None


class LegRecognition(Recognition):
    """Recognition with the exoskeleton's own sensors (`ContactTerrain`).

    A step is known once its foot is flat; its mode is assumed for all steps until the next one is known.

    Args:
        exoskeleton: Nominal geometry.
    """

    def __init__(self, exoskeleton: Exoskeleton) -> None:
        super().__init__()
        self._legs = ContactTerrain(Rig(), exoskeleton=exoskeleton)

    def update(self, sample: Sample) -> None:
        """Passes a sample to the estimator; a new step with a known mode sets all modes."""
        step = self._legs.update(sample)
        if step is not None and step.step > 0 and step.mode != UNKNOWN:  # step 0 is standing at the start
            self.current = dict.fromkeys(SIDES, step.mode)
            self.upcoming = dict.fromkeys(SIDES, step.mode)


class TrueModes(Recognition):
    """Recognition that knows the truth, for comparison; a share of the steps may be wrong.

    Args:
        steps: By foot: touch-down of each step, ns, and its mode, in order.
        wrong: Share of steps with a wrong mode.
        rng: Chooses these steps and their modes.
    """

    def __init__(
        self, steps: Mapping[str, Sequence[tuple[int, str]]], wrong: float = 0.0, rng: np.random.Generator | None = None
    ) -> None:
        super().__init__()
        rng = rng or np.random.default_rng(0)
        # per foot, n touch-downs, ns, and n + 2 modes: of standing at the start, of each step, of standing at the end
        self._times = {foot: [t_ns for t_ns, _ in steps[foot]] for foot in SIDES}
        self._modes = {
            foot: [LEVEL_MODE, *(_corrupt_mode(mode, wrong, rng) for _, mode in steps[foot]), LEVEL_MODE]
            for foot in SIDES
        }

    def update(self, sample: Sample) -> None:
        """Sets the modes at the time of a sample; a step up to 0.1 s late is still upcoming."""
        for foot, times in self._times.items():
            # number of steps that have landed, which is also the index of the mode of the last one of them
            landed = bisect_right(times, sample.t_ns)
            landed_long_ago = bisect_right(times, sample.t_ns - _LATE_NS)  # 0.1 s ago or earlier
            self.current[foot] = self._modes[foot][landed]
            self.upcoming[foot] = self._modes[foot][landed_long_ago + 1]


def _corrupt_mode(mode: str, wrong_share: float, rng: np.random.Generator) -> str:
    """The mode, or with the probability `wrong_share` another one."""
    wrong_modes = [m for m in MODES if m != mode]
    return str(rng.choice(wrong_modes)) if rng.random() < wrong_share else mode
