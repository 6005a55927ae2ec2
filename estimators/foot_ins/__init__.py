"""Path of one foot from its IMU alone (zero-velocity updates)."""

from stridetwin.estimators.foot_ins.estimate import FootInsEstimate, FootInsPath, StartPose
from stridetwin.estimators.foot_ins.filter import METHODS, FootIns
from stridetwin.estimators.foot_ins.parameters import FootInsParameters
from stridetwin.estimators.foot_ins.published import ZeroVelocityDetector
from stridetwin.estimators.foot_ins.smoother import FootInsSmoother

__all__ = [
    "METHODS",
    "FootIns",
    "FootInsEstimate",
    "FootInsParameters",
    "FootInsPath",
    "FootInsSmoother",
    "StartPose",
    "ZeroVelocityDetector",
]
