"""Slope, step height and class of each step from an exoskeleton's AHRS, encoders and insoles."""

from stridetwin.estimators.contact_terrain.estimate import MODES, UNKNOWN, StepEstimate, TerrainSvm
from stridetwin.estimators.contact_terrain.filter import METHODS, ContactTerrain
from stridetwin.estimators.contact_terrain.geometry import Compliance, Exoskeleton, parse_exoskeleton, read_exoskeleton
from stridetwin.estimators.contact_terrain.parameters import ContactTerrainParameters, PublishedParameters

__all__ = [
    "METHODS",
    "MODES",
    "UNKNOWN",
    "Compliance",
    "ContactTerrain",
    "ContactTerrainParameters",
    "Exoskeleton",
    "PublishedParameters",
    "StepEstimate",
    "TerrainSvm",
    "parse_exoskeleton",
    "read_exoskeleton",
]
