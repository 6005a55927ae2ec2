"""Visual-inertial odometry with depth."""

from stridetwin.estimators.dvio.estimate import DvioEstimate
from stridetwin.estimators.dvio.filter import MOUNTS, Dvio
from stridetwin.estimators.dvio.parameters import METHODS, DvioParameters

__all__ = ["METHODS", "MOUNTS", "Dvio", "DvioEstimate", "DvioParameters"]
