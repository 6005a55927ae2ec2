"""Planes, ramps and stairs around the walker from depth images and poses."""

from stridetwin.estimators.terrain_map.estimate import (
    Change,
    Level,
    Plane,
    Profile,
    Ramp,
    Stairs,
    Terrain,
    TerrainEstimate,
)
from stridetwin.estimators.terrain_map.filter import TerrainMap
from stridetwin.estimators.terrain_map.parameters import TerrainMapParameters

__all__ = [
    "Change",
    "Level",
    "Plane",
    "Profile",
    "Ramp",
    "Stairs",
    "Terrain",
    "TerrainEstimate",
    "TerrainMap",
    "TerrainMapParameters",
]
