"""The ground under one footprint as a plane, by least squares over its markers (Shim et al. 2019, 2.2.4 and 2.2.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, PublishedParameters
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Plane:
    """A plane fitted to the markers of one step: equation (18).

    Attributes:
        normal: (3,) unit vector, up.
        centre: (3,) m, mean of the markers.
    """

    normal: Array
    centre: Array


class Markers:
    """The markers of one step, as the sums that the plane needs: memory does not grow with them.

    Args:
        parameters: How many markers a plane needs, and where virtual ones lie.

    Attributes:
        count: Number of markers, the virtual ones not counted.
    """

    def __init__(self, parameters: PublishedParameters = DEFAULTS.published) -> None:
        self._parameters = parameters
        self.count = 0
        self._origin = np.zeros(3)
        self._sum = np.zeros(3)
        self._moments = np.zeros((3, 4))  # of (x, y, 1) with (x, y, 1, z), virtual markers too

    def add(self, p_in_world: Array, medial_in_world: Array) -> None:
        """Takes a marker and makes its virtual one.

        Args:
            p_in_world: (3,) m.
            medial_in_world: (3,) unit vector along the sole to the inner side of the foot.
        """
        if self.count == 0:
            self._origin = p_in_world
        self.count += 1
        self._sum += p_in_world
        for point in (p_in_world, p_in_world + self._parameters.virtual_m * medial_in_world):
            x, y, z = point - self._origin
            self._moments += np.outer((x, y, 1.0), (x, y, 1.0, z))

    @property
    def enough(self) -> bool:
        """Whether there are as many as a plane needs."""
        return self.count >= self._parameters.markers_min

    @property
    def centre(self) -> Array:
        """(3,) m, mean of the markers."""
        return self._sum / self.count

    def plane(self) -> Plane | None:
        """The plane z = a x + b y + d of least squares; None while there are too few markers.

        See docs/contact_terrain.md (4).
        """
        if not self.enough:
            return None
        a, b, _ = np.linalg.lstsq(self._moments[:, :3], self._moments[:, 3], rcond=1e-12)[0]
        normal = np.array([-a, -b, 1.0])
        return Plane(normal=normal / np.linalg.norm(normal), centre=self.centre)


def slope(normal: Array, heading: Array) -> float:
    """Slope, rad: the angle between normal and vertical, positive uphill.

    See docs/contact_terrain.md (5).

    Equation (19) as printed is zero for every normal; this is what its text says.

    Args:
        normal: (3,) unit vector, up.
        heading: (2,) horizontal direction of the walk.
    """
    tilt = math.hypot(normal[0], normal[1])
    return math.copysign(math.atan2(tilt, normal[2]), -float(normal[:2] @ heading))
