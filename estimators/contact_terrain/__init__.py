"""Slope and step height from the legs of an exoskeleton."""

from stridetwin.estimators.contact_terrain.classes import TerrainSvm
from stridetwin.estimators.contact_terrain.estimate import MODES, UNKNOWN, StepEstimate
from stridetwin.estimators.contact_terrain.filter import METHODS, ContactTerrain
from stridetwin.estimators.contact_terrain.geometry import Exoskeleton, parse_exoskeleton, read_exoskeleton

__all__ = [
    "METHODS", "MODES", "UNKNOWN", "ContactTerrain", "Exoskeleton", "StepEstimate", "TerrainSvm", "parse_exoskeleton",
    "read_exoskeleton",
]  # fmt: skip
