"""The output of the terrain map: planes, terrains and the ground profile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Plane:
    """A ground plane, η of Zhao et al. 2023.

    Attributes:
        id: Constant over the plane's lifetime.
        centre: (3,) m, world.
        normal: (3,) unit vector, up.
        area_m2: Area, seen from above.
        spread: (2, 2) m², covariance of its points in plan.
        votes: Score w of the paper: frames that confirm the plane minus frames that do not.
        covariance: (3, 3) covariance of the height at the centre (m) and of the slopes along world x and y.
    """

    id: int
    centre: Array
    normal: Array
    area_m2: float
    spread: Array
    votes: float
    covariance: Array

    @cached_property
    def gradient(self) -> Array:
        """(2,) slopes along world x and y."""
        return np.asarray(-self.normal[:2] / self.normal[2])

    @cached_property
    def slope(self) -> float:
        """Angle to the horizontal, rad, ≥ 0."""
        return math.atan(math.hypot(*self.gradient.tolist()))

    @cached_property
    def slope_sd(self) -> float:
        """Standard deviation of the slope, rad, along the steepest ascent."""
        gx, gy = self.gradient.tolist()
        (xx, xy), (_, yy) = self.covariance[1:, 1:].tolist()  # of both slopes, rise over run
        steep = math.hypot(gx, gy)
        x, y = (gx / steep, gy / steep) if steep > 0.0 else (1.0, 0.0)  # direction of steepest ascent
        steep_sd = math.sqrt(x * x * xx + 2.0 * x * y * xy + y * y * yy)  # rise over run
        return steep_sd * math.cos(self.slope) ** 2  # the factor is d atan(g) / dg

    @cached_property
    def rise(self) -> float:
        """Height from the lowest to the highest side, m, taken as a rectangle that slopes along one of its edges."""
        height_variance = float(self.gradient @ self.spread @ self.gradient)  # m², of the plane's points
        # a uniform distribution of length l has the variance l² / 12
        return math.sqrt(12.0 * max(height_variance, 0.0))

    def height(self, xy: Array) -> Array:
        """(...) height, m, at (..., 2) positions in the world."""
        return np.asarray(self.centre[2] + (np.asarray(xy) - self.centre[:2]) @ self.gradient)


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """Level ground: a flat plane that is not a tread.

    Attributes:
        id: Constant over the lifetime of its plane.
        plane: The plane's id.
    """

    id: int
    plane: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Ramp:
    """A sloping plane.

    Attributes:
        id: Constant over the lifetime of its plane.
        plane: The plane's id.
        slope: rad, > 0.
        slope_sd: Standard deviation of `slope`, rad.
        heading: Direction of steepest ascent in the world, rad from x.
    """

    id: int
    plane: int
    slope: float
    slope_sd: float
    heading: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Stairs:
    """A flight of equal steps; its edges lie at s = start + k tread, k = 0..steps - 1, along the way up.

    Attributes:
        id: Constant as long as one of its planes exists.
        planes: Ids of the planes from the lowest: ground before the first riser, each tread, landing at the top.
        steps: Number of observed risers.
        riser: Height of a step, m.
        tread: Depth of a step, m; NaN while only one edge is observed.
        heading: Direction of ascent in the world, rad from x.
        start: Position of the first edge, m along that direction from the world's origin.
        base: Height of the lowest plane at the first edge, m.
        covariance: (5, 5) of (riser, tread, heading, start, base); inf where unknown.
        edges: (steps,) m along the direction of ascent from the world's origin, each measured edge.
        risers: (steps,) m, each measured riser.
        across: (2,) m, lateral extent of the edges (2nd and 98th percentile of their points), positive to the left
            of the direction of ascent.
    """

    id: int
    planes: tuple[int, ...]
    steps: int
    riser: float
    tread: float
    heading: float
    start: float
    base: float
    covariance: Array
    edges: Array
    risers: Array
    across: Array

    @property
    def up(self) -> Array:
        """(2,) unit vector of the direction of ascent."""
        return np.array([math.cos(self.heading), math.sin(self.heading)])


Terrain = Level | Ramp | Stairs


@dataclass(frozen=True, kw_only=True, eq=False)
class TerrainEstimate:
    """The estimated ground around the walker at one instant.

    Attributes:
        t_ns: Time of the depth image.
        planes: Planes by id.
        terrains: Levels, ramps and stairs.
        p_camera_in_world: (3,) m, position of the camera.
        rises: Rows of rises that nobody can walk, such as those of planters and crates, and stairs of which too little
            is in view; their edges are measured like those of stairs.
    """

    t_ns: int
    planes: dict[int, Plane]
    terrains: tuple[Terrain, ...]
    p_camera_in_world: Array
    rises: tuple[Stairs, ...] = ()

    @property
    def stairs(self) -> tuple[Stairs, ...]:
        """The terrains that are stairs."""
        return tuple(t for t in self.terrains if isinstance(t, Stairs))

    @property
    def ramps(self) -> tuple[Ramp, ...]:
        """The terrains that are ramps."""
        return tuple(t for t in self.terrains if isinstance(t, Ramp))

    def terrain_of(self, plane: int) -> Terrain | None:
        """The terrain of a plane by its id: stairs if the plane is a tread, else a level or a ramp; None if unknown."""
        level_or_ramp: Terrain | None = None
        for terrain in self.terrains:
            if isinstance(terrain, Stairs):
                if plane in terrain.planes[1:-1]:  # a tread; the first and the last are the ground before and beyond
                    return terrain
            elif terrain.plane == plane:
                level_or_ramp = terrain
        return level_or_ramp


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """A change of the ground along a line.

    Attributes:
        kind: `edge` where the height steps, `slope_break` where the slope changes.
        s: m along the line.
        sd: Standard deviation of `s`, m.
        drop: Height after minus height before, m; 0 at a slope break.
        bend: Slope after minus slope before, rad; 0 at an edge.
    """

    kind: str
    s: float
    sd: float
    drop: float
    bend: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Profile:
    """The ground along a line.

    Attributes:
        s: (N,) m along the line.
        height: (N,) m, NaN where unknown.
        plane: (N,) id of the plane, -1 = none.
        changes: Edges and slope breaks in order.
        slope: (N,) slope along the line, rad, uphill positive, NaN where unknown; None: that of the planes.
        slope_sd: (N,) its standard deviation, rad; None as before.
    """

    s: Array
    height: Array
    plane: NDArray[np.int64]
    changes: tuple[Change, ...]
    slope: Array | None = None
    slope_sd: Array | None = None
