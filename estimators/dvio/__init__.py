"""Path of a head- or chest-worn RGB-D camera with IMU."""

from stridetwin.estimators.dvio.estimate import DvioEstimate
from stridetwin.estimators.dvio.filter import MOUNTS, Dvio
from stridetwin.estimators.dvio.parameters import METHODS, DvioMethod, DvioParameters

__all__ = ["METHODS", "MOUNTS", "Dvio", "DvioEstimate", "DvioMethod", "DvioParameters"]
