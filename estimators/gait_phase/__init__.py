"""Gait phase of one leg from its foot IMU alone."""

from stridetwin.estimators.gait_phase.estimate import PhaseEstimate
from stridetwin.estimators.gait_phase.filter import GaitPhase
from stridetwin.estimators.gait_phase.parameters import GaitPhaseParameters

__all__ = ["GaitPhase", "GaitPhaseParameters", "PhaseEstimate"]
