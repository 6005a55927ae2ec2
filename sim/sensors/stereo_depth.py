"""Depth as a stereo camera gives it: noise and steps of the disparity, and places where nothing is matched."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import DepthSensor
from stridetwin.sim.sensors.imager import SPARE, Pixels

_OUTLINE = 0.012  # how far a disparity is off the mean about it, over itself, beside an outline; 0 on a plane
_FINEST_STEP_PER_M = 1e-4


class DepthModel:
    """Turns exact depth into what the sensor says.

    A disparity is f b / z, so its constant noise and steps make those of the depth grow with z². The noise is alike
    over a matching window. Beside outlines, on dark surfaces and on those seen at a glancing angle there is nothing,
    and some pixels beside an outline lie between the two surfaces.

    Args:
        shape: (H, W).
        focal: Pixels.
        centre: (pu, pv).
        part: The sensor as it really is.
        noise: What its errors are drawn from.
    """

    def __init__(
        self, shape: tuple[int, int], focal: float, centre: tuple[float, float], part: DepthSensor, noise: Noise
    ) -> None:
        self._shape, self._part, self._noise = shape, part, noise
        self._step = part.disparity_step or _FINEST_STEP_PER_M
        self._bank = None
        if part.noise:
            self._bank = _smooth(noise, shape, part.noise_px) * np.float32(part.noise / self._step)
            self._mixed = _smooth(noise.at(0), shape, 1.0)
        counts = np.arange(1, np.iinfo(np.int16).max + 1)
        depth = np.concatenate([[0.0], 1 / (self._step * counts)])
        if part.resolution:
            depth = part.resolution * np.round(depth / part.resolution)
        depth[(depth < part.range_min) | (depth > part.range_max)] = 0.0
        self._depth_of_count = depth.astype(np.float32)
        v, u = np.mgrid[: shape[0] : 2, : shape[1] : 2]
        x, y = (u - centre[0]) / focal, (v - centre[1]) / focal
        self._rays = tuple(a.astype(np.float32) for a in (x, y, np.sqrt(1 + x * x + y * y)))
        self._focal = focal
        self._window = 2 * round(part.edge_px) + 1

    def picture(self, t_ns: int, depth: NDArray[np.float32], grey: Pixels | None = None) -> NDArray[np.float32]:
        """Told depth (H, W), m, 0 where none.

        Args:
            t_ns: When.
            depth: (H, W) exact depth, m; 0 where nothing is seen.
            grey: (H, W) how bright the surfaces are; None: bright enough.
        """
        part = self._part
        if self._bank is None and not part.disparity_step:
            told = depth.copy()
            told[(told < part.range_min) | (told > part.range_max)] = 0
            return told
        with np.errstate(divide="ignore"):
            counts = np.float32(1 / self._step) / depth
        counts[depth == 0] = 0
        outline = self._outline(counts)
        holes = self._unmatched(counts, outline, grey)
        if self._bank is not None:
            row, column = self._noise.at(t_ns).integers((SPARE, SPARE))
            cut = (slice(row, row + self._shape[0]), slice(column, column + self._shape[1]))
            self._fringe(counts, outline, holes, self._mixed[cut])
            counts += self._bank[cut]
        told = np.take(self._depth_of_count, np.rint(counts).astype(np.intp), mode="clip")
        told[(depth == 0) | (holes > 0)] = 0
        return told

    def _outline(self, counts: NDArray[np.float32]) -> NDArray[np.bool_]:
        """(H, W) what lies beside an outline."""
        if not self._part.edge_px:
            return np.zeros(self._shape, bool)
        mean = cv2.blur(counts, (self._window, self._window))
        return np.asarray(np.abs(counts - mean) > _OUTLINE * counts)

    def _unmatched(
        self, counts: NDArray[np.float32], outline: NDArray[np.bool_], grey: Pixels | None
    ) -> Pixels:  # fmt: skip
        """(H, W) 1 where nothing is matched but for outlines; found at half the resolution."""
        part, near = self._part, counts[::2, ::2]
        bad = np.zeros(near.shape, bool)
        if part.slant:
            # Of a plane the count is linear in the picture: its normal is (f a, f b, c), and the ray's sine against it
            # the count over both lengths (a, b its slopes, c what is left for the axis).
            a, b = (0.5 / 8 * cv2.Sobel(near, cv2.CV_32F, *d) for d in ((1, 0), (0, 1)))
            x, y, length = self._rays
            c = near - self._focal * (a * x + b * y)
            normal = np.sqrt(self._focal**2 * (a * a + b * b) + c * c)
            bad |= (near < np.float32(np.sin(part.slant)) * normal * length) & ~outline[::2, ::2]
        if part.dark and grey is not None:
            bad |= grey[::2, ::2] < 255 * part.dark
        small = bad.astype(np.uint8)
        return np.asarray(cv2.resize(small, self._shape[::-1], interpolation=cv2.INTER_NEAREST))

    def _fringe(
        self, counts: NDArray[np.float32], outline: NDArray[np.bool_], holes: Pixels, mixed: NDArray[np.float32]
    ) -> None:
        """Leaves out or mixes what lies beside outlines, in place."""
        at = np.flatnonzero(outline)
        if not len(at):
            return
        luck = mixed[at // outline.shape[1], at % outline.shape[1]]
        holes.ravel()[at[luck > 0]] = 1
        at, weight = at[luck <= 0], np.minimum(-luck[luck <= 0] / 2, 1.0)
        rows, columns = at // (2 * outline.shape[1]), at % outline.shape[1] // 2
        coarse, window = counts[::2, ::2].copy(), np.ones((2 * (self._window // 4) + 1,) * 2, np.uint8)
        near, far = (find(coarse, window)[rows, columns] for find in (cv2.dilate, cv2.erode))
        counts.ravel()[at] = far + weight * (near - far)  # flying pixels


def _smooth(noise: Noise, shape: tuple[int, int], alike_px: float) -> NDArray[np.float32]:
    """Bank of unit normal deviates that are alike over some pixels."""
    height, width = shape[0] + SPARE, shape[1] + SPARE
    coarse = noise.normal(1.0, (round(height / alike_px) + 1, round(width / alike_px) + 1)).astype(np.float32)
    if alike_px == 1:
        return coarse[:height, :width]
    bank = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(bank / bank.std(), np.float32)
