"""How a picture moves while it is taken, as if everything in it lay in one plane: motion blur and rolling shutter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

Pixels = NDArray[np.uint8]
_LEAST_BLUR_PX = 1.0  # a shorter one spreads an edge by less than 0.3 px
_COPY_PX = 1.25  # between the copies that make up a blur
_COPIES = (2, 16)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """Steady motion of a plane against a camera; optical axes of the camera.

    Attributes:
        K: (3, 3) camera matrix of the picture.
        normal: (3,) unit normal of the plane.
        distance: m along it from the camera, of either sign.
        velocity: (3,) m/s of the plane where the camera is: a point X of it moves with `velocity` + `rate` × X.
        rate: (3,) rad/s.
    """

    K: Array
    normal: Array
    distance: float
    velocity: Array
    rate: Array

    @cached_property
    def _K_inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.K))

    def homography(self, dt: float) -> Array:
        """(3, 3) from the picture to the one `dt` seconds later: K (R + t nᵀ / d) K⁻¹, lower right element 1."""
        x, y, z = self.rate * dt  # a degree at most: the second order of the turn is enough
        hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        R = np.eye(3) + hat + hat @ hat / 2
        H = self.K @ (R + np.outer(self.velocity * (dt / self.distance), self.normal)) @ self._K_inverse
        return np.asarray(H / H[2, 2])

    def way_px(self, dt: float, u: float, v: float) -> float:
        """How far the point at column u and row v moves in `dt` seconds, pixels."""
        x, y, z = self.homography(dt) @ [u, v, 1.0]
        return math.hypot(x / z - u, y / z - v)

    def of_piece(self, row: int, column: int) -> Sweep:
        """The same in the pixels of a piece of the picture, whose upper left pixel is given."""
        return replace(self, K=np.array([[1.0, 0.0, -column], [0.0, 1.0, -row], [0.0, 0.0, 1.0]]) @ self.K)

    def blurred(self, picture: Pixels, exposure_s: float) -> Pixels:
        """Mean of a picture, taken in the middle of an exposure, along its way during it."""
        height, width = picture.shape[:2]
        way = self.way_px(exposure_s, (width - 1) / 2, (height - 1) / 2)
        if way < _LEAST_BLUR_PX:
            return picture
        copies = min(max(math.ceil(way / _COPY_PX), _COPIES[0]), _COPIES[1])
        shares = (np.arange(copies) + 0.5) / copies - 0.5
        moved = (
            cv2.warpPerspective(
                picture, self.homography(share * exposure_s), (width, height), borderMode=cv2.BORDER_REPLICATE
            )
            for share in shares
        )
        if copies == 2:
            return np.asarray(cv2.addWeighted(next(moved), 0.5, next(moved), 0.5, 0.0))
        total = np.zeros(picture.shape, np.float32)
        for copy in moved:
            cv2.accumulate(copy, total)
        return np.asarray(cv2.convertScaleAbs(total, alpha=1 / copies))

    def rolled(self, picture: Pixels, readout_s: float) -> Pixels:
        """Rows taken one after another, the middle one at the time of the picture."""
        height, width = picture.shape[:2]
        v, u = np.mgrid[:height, :width].astype(np.float32)
        x, y, z = np.einsum("ij,jhw->ihw", self.homography(readout_s), np.stack([u, v, np.ones_like(u)]))
        late = v / max(height - 1, 1) - 0.5
        from_u, from_v = u - late * (x / z - u), v - late * (y / z - v)
        maps = from_u.astype(np.float32), from_v.astype(np.float32)
        return np.asarray(cv2.remap(picture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
