"""The sky in a sensor's image, and the haze at the edge of the ground, from the elevation of each pixel's ray.

MuJoCo first draws the sky over the whole image, and everything else on top of it, which costs a third of a
software-rendered frame. A sensor view omits it and paints it here where nothing else was rendered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.compiled import cached
from stridetwin.streams.samples import Array

_called = cached(__file__)

_LEVELS = 2048  # of the sine of the elevation
_SIDES, _UP, _DOWN = (0, 1, 4, 5), 2, 3  # faces of MuJoCo's sky box
_EDGE = math.sqrt(0.5)  # of the far plane's distance: edge of MuJoCo's endless planes


def endless_planes(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Geoms of a model that are endless planes."""
    return np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_size[:, 0] == 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sky:
    """A sky without dependence on azimuth.

    Attributes:
        colours: (N, 3) uint8 RGB, evenly over the sine of the elevation from straight down to straight up.
        ground: Height of the endless ground in the world, m; -inf without one, and then there is no haze.
        edge: Distance of its edge, m.
        depth: Width of the haze in front of that edge, as a share of its distance.
        haze: (3,) RGB, 0-255.
    """

    colours: NDArray[np.uint8]
    ground: float
    edge: float
    depth: float
    haze: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, far: float) -> Self | None:
        """The sky box of a model, averaged over azimuth; None without one. The far plane is at `far` m."""
        boxes = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
        if not len(boxes):
            return None
        width, first = int(model.tex_width[boxes[0]]), int(model.tex_adr[boxes[0]])
        faces = model.tex_data[first : first + 18 * width * width].reshape(6, width, width, 3)
        along = (2 * np.arange(width) + 1) / width - 1
        column, row = np.meshgrid(along, along)
        length = np.sqrt(1 + column**2 + row**2)
        rise = np.empty((6, width, width))
        rise[_SIDES, :], rise[_UP], rise[_DOWN] = -row / length, 1 / length, -1 / length
        at, whose = np.unique(np.round(rise.ravel(), 6), return_inverse=True)
        bands = [np.bincount(whose, faces[..., i].ravel()) / np.bincount(whose) for i in range(3)]
        colours = np.stack([np.interp(np.linspace(-1, 1, _LEVELS), at, band) for band in bands], axis=1)
        return cls(
            colours=np.round(colours).astype(np.uint8),
            ground=float(model.geom_pos[endless_planes(model), 2].max(initial=-np.inf)),
            edge=_EDGE * far,
            depth=float(model.vis.map.haze),
            haze=255.0 * model.vis.rgba.haze[:3],
        )

    def paint(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], T_world_camera: Array,
        intrinsics: tuple[float, float, float, float],
    ) -> None:  # fmt: skip
        """Colours in place the pixels of an image (H, W, 3) where nothing was rendered, and the far ground.

        The depth, (H, W) m along the optical axis, is inf where nothing was rendered; intrinsics as in `SensorView`.
        """
        steepness = max(self.edge / max(T_world_camera[2, 3] - self.ground, 1e-3), 0.0)
        _paint(
            rgb, depth, self.colours, np.ascontiguousarray(T_world_camera[2, :3], float), np.array(intrinsics, float),
            steepness, self.edge, self.depth, self.haze,
        )  # fmt: skip


@_called
def _paint(
    rgb: NDArray[np.uint8], depth: NDArray[np.float32], colours: NDArray[np.uint8], vertical: Array, intrinsics: Array,
    steepness: float, edge: float, share: float, haze: Array,
) -> None:  # fmt: skip
    fu, fv, pu, pv = intrinsics
    half, near = np.float32((len(colours) - 1) / 2), np.float32(0.5 * (1 - share) * edge)
    slope, across, middle, top = np.float32(vertical[0]), np.float32(1 / fu), np.float32(pu), len(colours) - 1
    for row in range(depth.shape[0]):
        y = (row - pv) / fv
        level, base = np.float32(vertical[1] * y + vertical[2]), np.float32(1 + y * y)
        for column in range(depth.shape[1]):
            away = depth[row, column]
            if away < near:
                continue
            x = (np.float32(column) - middle) * across
            up, squared = slope * x + level, x * x + base
            flat = np.sqrt(squared - up * up)
            if away * flat > edge:
                i = int(half * (up / np.sqrt(squared) + np.float32(1)) + np.float32(0.5))
                for k in range(3):
                    rgb[row, column, k] = colours[min(max(i, 0), top), k]
            if up < 0 and away * flat > (1 - share) * edge:
                q = -up / flat * steepness  # 0 at the horizon, 1 at the edge
                s = min(q / (1 + share * q), 1.0)
                a = s * (1 + share) if q < 1 else (1 - s) * (1 + share) / share
                for k in range(3):
                    rgb[row, column, k] += int(a * (haze[k] - rgb[row, column, k]))
