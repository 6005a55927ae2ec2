"""Inertial navigation of two shoes that observe each other."""

from stridetwin.estimators.checkerboard.pose import BoardObservation
from stridetwin.estimators.foot_to_foot.events import RelativePosition
from stridetwin.estimators.foot_to_foot.filter import METHODS, Aiding, FootToFoot, FootToFootEstimate
from stridetwin.estimators.foot_to_foot.parameters import FootToFootParameters, PublishedParameters
from stridetwin.estimators.foot_to_foot.path import follow

__all__ = [
    "METHODS",
    "Aiding",
    "BoardObservation",
    "FootToFoot",
    "FootToFootEstimate",
    "FootToFootParameters",
    "PublishedParameters",
    "RelativePosition",
    "follow",
]
