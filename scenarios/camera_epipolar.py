"""How well features without depth agree with a known rotation of the camera: the epipolar constraint.

With the rotation known, features of two images move along lines through one point, the epipole (Hartley and Zisserman
2004, Multiple View Geometry, 9.3). The direction of the translation that leaves least is found by reweighted least
squares, from several starts, as the cost has several minima.
"""

from __future__ import annotations

import numpy as np

from stridetwin.scenarios.image_rotation import PairTracks
from stridetwin.streams.algebra.arrays import cross
from stridetwin.streams.rays import find_rays
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

_NOISE_PX, _WORST_PX = 0.25, 1.0  # of tracked pixels: noise of a feature, and the distance from which it hardly counts
_ROUNDS = 4  # of reweighted least squares
_AHEAD = np.array([0.0, 0.0, 1.0])  # direction of the line of sight, one of the starts


def find_epipolar_cost(camera: CameraCalibration, tracks: PairTracks, R: Array, before: Array) -> tuple[float, Array]:
    """What the features of a pair of images leave over with the best direction of the translation.

    Args:
        camera: Calibration of the lens.
        tracks: The features.
        R: (3, 3) rotation of points from the first image to the second.
        before: (3,) direction of the translation of the pair before, another start of the search.

    Returns:
        Sum of the squared distances from the epipolar lines in units of the noise, each limited; and the direction (3,)
        of the translation, a unit vector of either sign in the camera's axes at the second image.
    """
    x, y = (
        np.column_stack((find_rays(pixels, camera), np.ones(len(pixels)))) for pixels in (tracks.before, tracks.after)
    )
    turned = x @ R.T
    normals = cross(turned, y)  # a translation is perpendicular to each of them
    scale = camera.intrinsics[0] / (tracks.tracked_px * _NOISE_PX)
    starts = np.stack([np.linalg.eigh(normals.T @ normals)[1][:, 0], _AHEAD, before])
    costs, directions = _refine(turned, normals, scale, starts)
    best = int(np.argmin(costs))
    return float(costs[best]), directions[best]


def _refine(turned: Array, normals: Array, scale: float, starts: Array) -> tuple[Array, Array]:
    """Costs (S,) and directions (S, 3) of the translation, as `find_epipolar_cost` gives them, from S starts.

    Args:
        turned: (N, 3) rays of the first image in the axes of the second.
        normals: (N, 3) cross products of these with the rays of the second image.
        scale: A distance of 1 in normalised coordinates, in units of the noise.
        starts: (S, 3) first directions.
    """
    most = (_WORST_PX / _NOISE_PX) ** 2
    x, y, z = turned.T
    products = (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)
    directions = starts
    for left in reversed(range(_ROUNDS + 1)):
        along_x, along_y, along_z = directions.T[:, :, None]
        # the line of a feature is the cross product of the direction and its ray; its first two entries are the normal
        squared_norm = (along_y * z - along_z * y) ** 2 + (along_z * x - along_x * z) ** 2 + 1e-8  # (S, N)
        squared = (directions @ normals.T) ** 2 / squared_norm * scale**2
        if left:
            weight = 1 / squared_norm / (1 + squared / most)
            directions = np.linalg.eigh((weight @ products).reshape(-1, 3, 3))[1][:, :, 0]
    return np.sum(most * np.log1p(squared / most), axis=1), directions
