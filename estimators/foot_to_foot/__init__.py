"""Paths of both feet, coupled by shoe cameras and sonars."""

from stridetwin.estimators.checkerboard.pose import BoardObservation
from stridetwin.estimators.foot_to_foot.events import RelativePosition
from stridetwin.estimators.foot_to_foot.filter import METHODS, Aiding, FootToFoot, FootToFootEstimate, follow
from stridetwin.estimators.foot_to_foot.parameters import FootToFootParameters, PublishedParameters

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
