"""Mode, place and time of the coming steps from depth images, poses and insoles."""

from stridetwin.estimators.locomotion_mode.estimate import MODES, UNKNOWN, ModeEstimate, NextChange, StepPrediction
from stridetwin.estimators.locomotion_mode.filter import INSOLES, METHODS, LocomotionMode
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters

__all__ = [
    "INSOLES",
    "METHODS",
    "MODES",
    "UNKNOWN",
    "LocomotionMode",
    "LocomotionModeParameters",
    "ModeEstimate",
    "NextChange",
    "StepPrediction",
]
