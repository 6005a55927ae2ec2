"""Terrain along a route: exact boxes and wedges, and what the ground is like anywhere on them.

The walk goes along +x from x = 0 at height 0. A level lead-in lies behind the walker and a run-out beyond the
last segment; a ground plane lies just below the lowest point all around.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.sim.config import Route
from stridetwin.sim.route import Strip, lay_out
from stridetwin.sim.scenery import Landmark, add_ground, add_quads, add_sky, landmarks, paint_landmarks, paint_way
from stridetwin.sim.solids import Box, Solid, SolidSet, Wedge, corners
from stridetwin.streams.samples import Array

_GROUND_BELOW_M = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain:
    """Ground to walk on.

    Attributes:
        profile: Surface along the way, in order of x; where one strip's z1 differs from the next one's z0
            there is a riser.
        width_m: Lateral extent of the way, centred on y = 0.
        ground_m: Height of the plane all around.
    """

    profile: tuple[Strip, ...]
    width_m: float
    ground_m: float

    @classmethod
    def from_route(cls, route: Route) -> Terrain:
        """Lays out a route.

        Args:
            route: Segments along +x.

        Returns:
            The terrain; its first strip begins at x = -2 m, its last level reaches 2 m beyond the route's
            end.

        Raises:
            ConfigError: A segment that cannot be built or walked; the message names field, value and range.
        """
        profile = lay_out(route)
        lowest = min(min(strip.z0, strip.z1) for strip in profile)
        return cls(profile=profile, width_m=route.width_m, ground_m=lowest - _GROUND_BELOW_M)

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """One solid a strip, standing on the ground plane."""
        return tuple(self._solid(s) for s in self.profile)

    def _solid(self, strip: Strip) -> Solid:
        x, length = (strip.x0 + strip.x1) / 2, strip.x1 - strip.x0
        bottom = self.ground_m - 0.05  # so that no gap shows at the foot of the way
        if strip.z0 == strip.z1:
            return Box(
                x=x,
                y=0.0,
                length=length,
                width=self.width_m,
                bottom=bottom,
                top=strip.z0,
                terrain=strip.terrain,
            )
        return Wedge(
            x=x, y=0.0, length=length, width=self.width_m, bottom=bottom, start=strip.z0, end=strip.z1,
            terrain=strip.terrain,
        )  # fmt: skip

    @cached_property
    def landmarks(self) -> tuple[Landmark, ...]:
        """Things beside the way, out of the walker's reach."""
        return landmarks(self.profile, self.width_m, self.ground_m)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Adds the terrain to a model.

        Collision geoms are `terrain_<i>`, one a strip of the profile, and the plane `ground`; what is seen
        are meshes `scenery_<material>` that do not collide. A sky and a sun come with it.
        """
        for i, solid in enumerate(self.solids):
            _add_collision(spec, f"terrain_{i}", solid)
        add_quads(spec, [*paint_way(self.profile, self.solids), *paint_landmarks(self.landmarks)])
        # Last, so that little of it is drawn where something stands before it.
        add_ground(spec, self.ground_m)
        add_sky(spec)

    @cached_property
    def _obstacles(self) -> SolidSet:
        return SolidSet([*self.solids, *(mark.box for mark in self.landmarks)], self.ground_m)

    @cached_property
    def _set(self) -> SolidSet:
        return SolidSet(self.solids, self.ground_m)

    def height(self, xy: ArrayLike) -> Array:
        """Height of the surface, m, (...), at (..., 2) points in the world; on a riser the upper one."""
        return self._set.top_facet(xy)[0]

    def normal(self, xy: ArrayLike) -> Array:
        """Unit normal of the surface in the world (..., 3) at (..., 2) points."""
        return self._set.top_normal(self._set.top_facet(xy)[1])

    def terrain_class(self, xy: ArrayLike) -> NDArray[np.str_]:
        """level, stair or ramp, (...), at (..., 2) points; landings and the ground around are level."""
        names = np.array([s.terrain for s in self.solids] + ["level"])  # index -1 is the ground plane
        return names[self._set.top_facet(xy)[1]]

    def edge_distance(self, xy: ArrayLike) -> Array:
        """Horizontal distance, m, (...), from (..., 2) points to the nearest jump or bend of the surface."""
        return self._set.edge_distance(xy)

    def ray_cast(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """Distance along rays to the surface or a landmark.

        Args:
            origins: (N, 3) in the world, m.
            directions: (N, 3) in the world, any length but zero.

        Returns:
            (N,) m; inf where nothing is hit, 0 where the origin lies inside a solid.
        """
        return self.ray_hit(origins, directions)[0]

    def ray_hit(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
        """As `ray_cast`, and the (N, 3) outward normal of the face that is hit (zero where there is none)."""
        return self._obstacles.ray_cast(origins, directions)


def _add_collision(spec: mujoco.MjSpec, name: str, solid: Solid) -> None:
    """Adds the exact shape of a solid, unseen (group 3)."""
    if isinstance(solid, Box):
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, group=3,
            pos=(solid.x, solid.y, (solid.bottom + solid.top) / 2),
            size=(solid.length / 2, solid.width / 2, (solid.top - solid.bottom) / 2),
            quat=(math.cos(solid.yaw / 2), 0.0, 0.0, math.sin(solid.yaw / 2)),
        )  # fmt: skip
    else:
        spec.add_mesh(name=name, uservert=corners(solid).ravel())
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, group=3)
