"""Terrain of a route: exact boxes and wedges, and the properties of the ground anywhere on them.

The walk starts at the world's origin along +x. There is a level lead-in behind the walker and a run-out beyond the last
segment; a ground plane lies just below the lowest point all around.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.sim.config import Route
from stridetwin.sim.world import obstacles
from stridetwin.sim.world.obstacles import Landmark, floor, surroundings
from stridetwin.sim.world.route import lay_out
from stridetwin.sim.world.scenery import Quad, add_ground, add_quads, add_sky, paint_box, paint_slabs
from stridetwin.sim.world.solids import Solid, SolidSet, corners
from stridetwin.sim.world.uneven_floor import UnevenFloor
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, Slab, Strip

_GROUND_BELOW_M = 0.05  # of the ground plane below the lowest point of the way
_PLANK_M = 0.04  # thickness of a tread that overhangs its riser
_CHORDS = 3  # of a rounded edge
_TINY_M = 1e-9  # shorter slabs are left out
_FOOT_OF_SLABS_M = 0.05  # below the ground plane, so that no gap shows


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain:
    """Ground to walk on.

    Attributes:
        layout: The route in the world.
        ground_m: Height of the plane all around.
        route: The route, with its scenery, texture and light.
    """

    layout: Layout
    ground_m: float
    route: Route

    @classmethod
    def from_route(cls, route: Route, seed: int = 0) -> Terrain:
        """Lays out a route from the world's origin along +x.

        Args:
            route: The route.
            seed: Of the walk; draws the floor of a route with `unevenness_m`.

        Raises:
            ConfigError: A segment that cannot be built or walked; the message names field, value and range.
        """
        layout = lay_out(route)
        obstacles.check_things(route.things, layout, route.width_m)
        if route.unevenness_m:
            layout = UnevenFloor.draw(route.unevenness_m, seed).bend(layout)
        # lowest of the four corners of all slabs
        lowest = min(
            float(slab.point([0, 0, slab.length, slab.length], [-slab.right, slab.left] * 2)[:, 2].min())
            for slab in layout.slabs
        )
        return cls(layout=layout, ground_m=lowest - _GROUND_BELOW_M, route=route)

    @property
    def profile(self) -> tuple[Strip, ...]:
        """Surface along the way, in order."""
        return self.layout.profile

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """Solids of the ground: the slabs, and the floor of a room; a tread with a nosing is a plank on its riser."""
        slabs = (*self.layout.slabs, *floor(self.route.scenery, self.layout))
        return tuple(solid for slab in slabs for solid in _make_solids(slab, self.ground_m - _FOOT_OF_SLABS_M))

    @cached_property
    def landmarks(self) -> tuple[Landmark, ...]:
        """Objects beside the way and at its end, out of the walker's reach."""
        things = obstacles.upright_things(self.route.things, self.layout, self.route.width_m)
        return surroundings(self.route.scenery, self.layout, self.ground_m - _FOOT_OF_SLABS_M, things)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Adds the terrain to a model.

        Collision geoms are `terrain_<i>`, one per solid, and the plane `ground`; the visible geoms are meshes
        `scenery_<material>` that do not collide. A sky and a sun are added, too.
        """
        for i, solid in enumerate(self.solids):
            _add_collision(spec, f"terrain_{i}", solid)
        quads = paint_slabs(self.solids, self._solid_set)
        for mark in self.landmarks:
            quads += paint_box(mark.box, mark.material)
        for area, material in obstacles.floor_markings(self.route.things, self.layout, self.route.width_m):
            quads.append(Quad(area, area[:, :2], material))  # textured in world coordinates
        add_quads(spec, quads, self.route.texture)
        # Last, so that little of it is rendered where something occludes it.
        add_ground(spec, self.ground_m, self.route.texture)
        add_sky(spec, self.route.light)

    @cached_property
    def _obstacles(self) -> SolidSet:
        """Ground and landmarks, for rays."""
        return SolidSet([*self.solids, *(mark.box for mark in self.landmarks)], self.ground_m)

    @cached_property
    def _solid_set(self) -> SolidSet:
        """The ground without landmarks, for heights and normals."""
        return SolidSet(self.solids, self.ground_m)

    def height(self, xy: ArrayLike) -> Array:
        """Height of the surface, m, (...), at (..., 2) points in the world; on a riser the upper one."""
        return self._solid_set.top_facet(xy)[0]

    def normal(self, xy: ArrayLike) -> Array:
        """Unit normal of the surface in the world (..., 3) at (..., 2) points."""
        return self._solid_set.top_normal(self._solid_set.top_facet(xy)[1])

    def terrain_class(self, xy: ArrayLike) -> NDArray[np.str_]:
        """level, stair or ramp, (...), at (..., 2) points; landings and the ground around are level."""
        names = [*(s.terrain for s in self.solids), "level"]  # index -1 is the ground plane
        return np.array(names)[self._solid_set.top_facet(xy)[1]]

    def ray_cast(self, origins: ArrayLike, directions: ArrayLike) -> Array:
        """(N,) m, distance along rays to the ground or a landmark; inf for a miss, 0 from inside a solid.

        Args:
            origins: (N, 3) m in the world.
            directions: (N, 3) of any length.
        """
        return self.ray_hit(origins, directions)[0]

    def ray_hit(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
        """Distances along rays to the ground or a landmark, and the faces that they hit.

        Args:
            origins: (N, 3) m in the world.
            directions: (N, 3) of any length.

        Returns:
            (N,) m, inf for a miss, 0 from inside a solid; (N, 3) outward normal of the face, zero for a miss.
        """
        return self._obstacles.ray_cast(origins, directions)


def _make_solids(slab: Slab, bottom: float) -> Iterator[Solid]:
    """Solids that make up a slab, from its top down to the height `bottom`, m.

    A slab that overhangs its riser is a plank on a shorter body; with an open riser it is the plank alone. Rounded
    edges are approximated by narrow solids with sloping tops.
    """
    if slab.recess:  # the plank over the whole slab
        yield _make_solid(slab, min(slab.z0, slab.z1) - _PLANK_M)
    # `upper` and `lower`: how far the inner and the outer end of a chord are below the top
    for from_edge, to_edge, upper, lower in _rounding_chords(slab.start_radius):
        yield _make_solid(_cut_slab(slab, from_edge, to_edge, lower, upper), bottom)
    for from_edge, to_edge, upper, lower in _rounding_chords(slab.end_radius):
        yield _make_solid(_cut_slab(slab, slab.length - to_edge, slab.length - from_edge, upper, lower), bottom)
    # the rest of the body; the sign of the recess gives the end at which the slab overhangs
    since = max(slab.recess, 0.0) + slab.start_radius
    until = slab.length - max(-slab.recess, 0.0) - slab.end_radius
    if until - since > _TINY_M:
        yield _make_solid(_cut_slab(slab, since, until), bottom)


def _rounding_chords(radius: float) -> Iterator[tuple[float, float, float, float]]:
    """Chords that approximate a rounded edge, from the edge inwards; none for a radius of 0.

    Yields:
        Distances of the outer and the inner end of a chord from the edge, and how far below the top these ends are:
        first the inner, then the outer end. All are in m.
    """
    if radius > 0.0:
        angles = np.linspace(0.0, math.pi / 2, _CHORDS + 1)
        away, below = radius * (1.0 - np.cos(angles)), radius * (1.0 - np.sin(angles))
        for k in range(_CHORDS):
            yield float(away[k]), float(away[k + 1]), float(below[k + 1]), float(below[k])


def _cut_slab(slab: Slab, since: float, until: float, start_below: float = 0.0, end_below: float = 0.0) -> Slab:
    """Slab from one place on a slab's axis to another; its ends may be lower than the slab's top."""
    (x, y, z0), (_, _, z1) = slab.point([since, until], [0.0, 0.0]).tolist()
    return replace(slab, x=x, y=y, length=until - since, z0=z0 - start_below, z1=z1 - end_below)


def _make_solid(slab: Slab, bottom: float) -> Solid:
    """Solid on the footprint of a slab, from `bottom` up to its surface."""
    x, y, _ = slab.point(slab.length / 2, (slab.left - slab.right) / 2).tolist()
    return Solid(
        x=x,
        y=y,
        yaw=slab.heading,
        length=slab.length,
        width=slab.left + slab.right,
        bottom=bottom,
        start=slab.z0,
        end=slab.z1,
        cross=math.tan(slab.cross_slope),
        terrain=slab.terrain,
    )


def _add_collision(spec: mujoco.MjSpec, name: str, solid: Solid) -> None:
    """Adds the exact shape of a solid, invisible (group 3)."""
    if solid.is_box:
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            group=3,
            pos=(solid.x, solid.y, (solid.bottom + solid.start) / 2),
            size=(solid.length / 2, solid.width / 2, (solid.start - solid.bottom) / 2),
            quat=(math.cos(solid.yaw / 2), 0.0, 0.0, math.sin(solid.yaw / 2)),
        )
    else:
        spec.add_mesh(name=name, uservert=corners(solid).ravel())
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, group=3)
