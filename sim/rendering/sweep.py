"""Motion of an image while it is exposed, as if the scene were one plane: motion blur and rolling shutter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stridetwin.sim.rendering.imager import Pixels
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_LEAST_BLUR_PX = 1.0  # shorter blur spreads an edge by less than 0.3 px
_COPY_PX = 1.25  # spacing of the copies that are averaged to a blur
_COPIES = (2, 16)  # least and largest number of these copies


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """Steady motion of a plane relative to a camera; optical axes of the camera.

    Attributes:
        K: (3, 3) camera matrix of the image.
        normal, distance: (3,) unit normal of the plane, and m along it from the camera, signed.
        velocity: (3,) m/s of the plane where the camera is: a point X of it moves with `velocity` + `rate` × X.
        rate: (3,) rad/s.
    """

    K: Array
    normal: Array
    distance: float
    velocity: Array
    rate: Array

    def homographies(self, dt: Array) -> Array:
        """(N, 3, 3) from the image to those `dt` (N,) seconds later: K (R + t nᵀ / d) K⁻¹, lower right element 1."""
        return _homographies(self.K, self.normal, self.distance, self.velocity, self.rate, dt)

    def homography(self, dt: float) -> Array:
        """(3, 3) from the image to the one `dt` seconds later."""
        return np.asarray(self.homographies(np.array([dt]))[0])

    def path_px(self, dt: float, u: float, v: float) -> float:
        """Distance that the point at column u and row v moves in `dt` seconds, pixels."""
        H = self.homography(dt)
        # homogeneous coordinates of the point at that time: column x / z, row y / z
        z = H[2, 0] * u + H[2, 1] * v + H[2, 2]
        x, y = H[0, 0] * u + H[0, 1] * v + H[0, 2], H[1, 0] * u + H[1, 1] * v + H[1, 2]
        return math.hypot(x / z - u, y / z - v)

    def crop(self, row: int, column: int) -> Sweep:
        """Sweep in the pixels of a part of the image, given the row and column of its upper left pixel."""
        return replace(self, K=np.array([[1.0, 0.0, -column], [0.0, 1.0, -row], [0.0, 0.0, 1.0]]) @ self.K)

    def blur(self, image: Pixels, exposure_s: float) -> Pixels:
        """The image, taken at mid-exposure, averaged along its motion during the exposure.

        Two to sixteen copies, spaced by about `_COPY_PX`, are warped by the homographies and averaged; a motion of less
        than `_LEAST_BLUR_PX` leaves the image unchanged.
        """
        height, width = image.shape[:2]
        length = self.path_px(exposure_s, (width - 1) / 2, (height - 1) / 2)
        if length < _LEAST_BLUR_PX:
            return image
        copies = min(max(math.ceil(length / _COPY_PX), _COPIES[0]), _COPIES[1])
        shares = (np.arange(copies) + 0.5) / copies - 0.5  # times of the copies from mid-exposure, in exposures
        moved = (
            cv2.warpPerspective(image, H, (width, height), borderMode=cv2.BORDER_REPLICATE)
            for H in self.homographies(shares * exposure_s)
        )
        if copies == 2:  # their mean in one step
            return np.asarray(cv2.addWeighted(next(moved), 0.5, next(moved), 0.5, 0.0))
        total = np.zeros(image.shape, np.float32)
        for copy in moved:
            cv2.accumulate(copy, total)
        return np.asarray(cv2.convertScaleAbs(total, alpha=1 / copies))

    def apply_rolling_shutter(self, image: Pixels, readout_s: float) -> Pixels:
        """The image as a rolling shutter takes it, the middle row at the time of the image.

        Each row is moved by its share of the motion in the readout time, to first order.
        """
        height, width = image.shape[:2]
        v, u = np.mgrid[:height, :width].astype(np.float32)
        # where each pixel moves in the whole readout time; a row gets a share of it, from -0.5 at the top to 0.5
        x, y, z = np.einsum("ij,jhw->ihw", self.homography(readout_s), np.stack([u, v, np.ones_like(u)]))
        late = v / max(height - 1, 1) - 0.5
        # (H, W) column and row of the input image that each pixel shows
        from_u, from_v = u - late * (x / z - u), v - late * (y / z - v)
        maps = from_u.astype(np.float32), from_v.astype(np.float32)
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@entry_kernel(__file__)
def _homographies(K: Array, normal: Array, distance: float, velocity: Array, rate: Array, dt: Array) -> Array:
    """(N, 3, 3) homographies K (R + t nᵀ / d) K⁻¹ after (N,) `dt` s, lower right element 1; K is upper triangular.

    R = Exp(ω dt) to second order and t = v dt. The other arguments are the attributes of `Sweep`: the plane's unit
    normal n (3,), its distance d, m, its velocity v (3,), m/s, and its angular rate ω (3,), rad/s.
    """
    inverse = np.zeros((3, 3))  # K⁻¹
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = 1 / K[0, 0], 1 / K[1, 1], 1.0
    inverse[0, 1] = -K[0, 1] / (K[0, 0] * K[1, 1])
    inverse[0, 2] = (K[0, 1] * K[1, 2] / K[1, 1] - K[0, 2]) / K[0, 0]
    inverse[1, 2] = -K[1, 2] / K[1, 1]
    H = np.empty((len(dt), 3, 3))
    for k in range(len(dt)):
        phi = rate * dt[k]  # a degree at most: the second order of it is enough
        squared = np.sum(phi * phi)
        # M = 1 + [φ]ₓ + (φ φᵀ - |φ|² 1) / 2 + v dt nᵀ / d
        M = np.empty((3, 3))
        for i in range(3):
            for j in range(3):
                M[i, j] = phi[i] * phi[j] / 2 + velocity[i] * (dt[k] / distance) * normal[j]
            M[i, i] += 1 - squared / 2
        M[0, 1] -= phi[2]
        M[1, 0] += phi[2]
        M[2, 0] -= phi[1]
        M[0, 2] += phi[1]
        M[1, 2] -= phi[0]
        M[2, 1] += phi[0]
        for i in range(3):
            for j in range(3):
                # K M K⁻¹, without the zeros of the triangular matrices
                total = 0.0
                for a in range(i, 3):
                    for b in range(j + 1):
                        total += K[i, a] * M[a, b] * inverse[b, j]
                H[k, i, j] = total
        H[k] /= H[k, 2, 2]
    return H
