"""Predicts the mode of the next steps, and where the ground changes, before the foot lands."""

from stridetwin.estimators.locomotion_mode.estimate import MODES, ModeEstimate, NextChange, StepPrediction
from stridetwin.estimators.locomotion_mode.filter import INSOLES, METHODS, LocomotionMode
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters

__all__ = [
    "INSOLES", "METHODS", "MODES", "LocomotionMode", "LocomotionModeParameters", "ModeEstimate", "NextChange",
    "StepPrediction",
]  # fmt: skip
