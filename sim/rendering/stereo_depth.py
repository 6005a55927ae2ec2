"""Stereo depth: noise and quantisation of the disparity, and areas without a match."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import DepthSensor
from stridetwin.sim.rendering.imager import SPARE, Pixels
from stridetwin.streams.compiled import entry_kernel

_entry_kernel = entry_kernel(__file__)

# Relative difference of a disparity from the mean around it, beside a depth discontinuity; 0 on a plane.
_DISCONTINUITY = np.float32(0.012)
Grid = NDArray[np.float32]  # an image of numbers
_FINEST_STEP_PER_M = 1e-4  # step of the inverse depth for a part without quantisation


class DepthModel:
    """Converts exact depth to the depth that a stereo camera measures.

    A disparity is f b / z, so that its constant noise and steps give errors of depth that grow with z². The noise is
    correlated over a matching window. There is no depth beside discontinuities, on dark surfaces and at glancing
    angles, and some pixels beside a discontinuity are between the two surfaces (flying pixels).

    Args:
        shape: (H, W) of the images.
        focal: Focal length, pixels.
        centre: Principal point, pixels.
        part: True parameters of the camera.
        noise: Source of its errors.
    """

    def __init__(
        self, shape: tuple[int, int], focal: float, centre: tuple[float, float], part: DepthSensor, noise: Noise
    ) -> None:
        """Draws the banks of noise, and computes the depth of each count and the rays of the pixels."""
        self._shape, self._part, self._noise = shape, part, noise
        # step of the inverse depth, 1/m: disparities are counted in it
        self._step = part.disparity_step or _FINEST_STEP_PER_M
        # banks of disparity errors, in counts, and of unit deviates for flying pixels (`_measure_depth`)
        self._bank = self._mixed = np.zeros(shape, np.float32)
        if part.noise:
            self._bank = _noise_bank(noise, shape, part.noise_px) * np.float32(part.noise / self._step)
            self._mixed = _noise_bank(noise.at(0), shape, 1.0)
        # depth of each count of the disparity that fits in 16 bits; count 0 has none
        depth = np.append(0.0, 1 / (self._step * np.arange(1, np.iinfo(np.int16).max + 1)))
        if part.resolution:  # the camera gives depth itself in whole counts
            depth = part.resolution * np.round(depth / part.resolution)
        depth[(depth < part.range_min) | (depth > part.range_max)] = 0.0
        self._depth_of_count = depth.astype(np.float32)  # m; 0 out of range
        # rays of every second pixel: x / z, y / z, and length for depth 1
        v, u = np.mgrid[: shape[0] : 2, : shape[1] : 2]
        x, y = (u - centre[0]) / focal, (v - centre[1]) / focal
        self._rays = tuple(a.astype(np.float32) for a in (x, y, np.sqrt(1 + x * x + y * y)))
        self._focal, self._window = focal, 2 * round(part.edge_px) + 1  # pixels; the edge of the matching window is odd

    def image(self, t_ns: int, depth: NDArray[np.float32], grey: Pixels | None = None) -> NDArray[np.float32]:
        """Measured depth (H, W), m, 0 without a match.

        Args:
            t_ns: Time of the image.
            depth: (H, W) exact depth, m; 0 without a surface.
            grey: (H, W) brightness of the surfaces; None: bright enough.
        """
        part = self._part
        if not part.noise and not part.disparity_step:  # an ideal part has only its range
            measured = depth.copy()
            measured[(measured < part.range_min) | (measured > part.range_max)] = 0
            return measured
        counts = _disparity_counts(depth, np.float32(1 / self._step))
        near = np.ascontiguousarray(counts[::2, ::2])  # at half the resolution
        # mean disparity in the matching window around each pixel
        mean = np.asarray(cv2.blur(counts, (self._window,) * 2), np.float32) if part.edge_px else counts
        unmatched = self._mask_unmatched(near, mean, grey)
        # another crop of the noise banks for each image
        row, column = self._noise.at(t_ns).integers((SPARE, SPARE)) if part.noise else (0, 0)
        # nearest and farthest surface in the matching window, the largest and the smallest count, between which flying
        # pixels lie
        window = np.ones((2 * (self._window // 4) + 1,) * 2, np.uint8)  # half as large, because `near` is
        front, back = (np.asarray(f(near, window), np.float32) for f in (cv2.dilate, cv2.erode))
        beside = mean if part.noise else counts  # without noise, discontinuities are sharp
        return _measure_depth(
            depth, counts, beside, unmatched, front, back, self._mixed, self._bank, (row, column), self._depth_of_count
        )

    def _mask_unmatched(self, near: Grid, mean: Grid, grey: Pixels | None) -> NDArray[np.bool_]:
        """(h, w) pixels at half the resolution without a match, because the surface is dark or at a glancing angle.

        Args:
            near: (h, w) disparity counts at half the resolution.
            mean: (H, W) mean counts around each pixel.
            grey: (H, W) brightness; None: bright enough.
        """
        part = self._part
        unmatched = np.zeros(near.shape, bool)
        if part.slant:
            # slopes per pixel of the image: a Sobel filter gives 8 times the slope, and `near` has every second pixel
            a, b = (np.asarray(cv2.Sobel(near, cv2.CV_32F, *d, scale=0.5 / 8), np.float32) for d in ((1, 0), (0, 1)))
            x, y, length = self._rays
            sine, focal = np.float32(np.sin(part.slant)), np.float32(self._focal)
            unmatched = _find_glancing_surfaces(near, mean, a, b, x, y, length, focal, sine)
        if part.dark and grey is not None:
            unmatched |= grey[::2, ::2] < 255 * part.dark
        return unmatched


@entry_kernel(__file__, error_model="numpy")
def _disparity_counts(depth: Grid, per_m: np.float32) -> Grid:
    """(H, W) disparities in steps, `per_m` / depth; 0 without depth."""
    counts = np.empty_like(depth)
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            counts[i, j] = per_m / depth[i, j] if depth[i, j] else np.float32(0)
    return counts


@_entry_kernel
def _find_glancing_surfaces(
    near: Grid, mean: Grid, a: Grid, b: Grid, x: Grid, y: Grid, length: Grid, focal: np.float32, sine: np.float32
) -> NDArray[np.bool_]:
    """(h, w) whether a pixel sees its surface at a glancing angle, away from discontinuities.

    For a plane the count is linear in the image: its normal is (f a, f b, c), and the sine of the angle between ray and
    plane is the count over the lengths of ray and normal.

    Args:
        near: (h, w) counts at half the resolution.
        mean: (H, W) mean counts around each pixel.
        a: (h, w) slope of the counts along the rows, per pixel.
        b: (h, w) slope along the columns.
        x: (h, w) x / z of the rays.
        y: (h, w) y / z of the rays.
        length: (h, w) length of the rays of depth 1.
        focal: Focal length f, pixels.
        sine: Sine of the limit angle.
    """
    slanted = np.empty(near.shape, np.bool_)
    for i in range(near.shape[0]):
        for j in range(near.shape[1]):
            count, p, q = near[i, j], a[i, j], b[i, j]  # p and q are the slopes
            c = count - focal * (p * x[i, j] + q * y[i, j])
            normal = np.sqrt(focal * focal * (p * p + q * q) + c * c)
            beside = abs(count - mean[2 * i, 2 * j]) > _DISCONTINUITY * count
            slanted[i, j] = (count < sine * normal * length[i, j]) & ~beside
    return slanted


@_entry_kernel
def _measure_depth(
    depth: Grid,
    counts: Grid,
    mean: Grid,
    unmatched: NDArray[np.bool_],
    front: Grid,
    back: Grid,
    mixed: Grid,
    noise: Grid,
    start: tuple[int, int],
    depth_of_count: NDArray[np.float32],
) -> Grid:
    """(H, W) m, measured depth: 0 without a match, with flying pixels, noise and steps of the disparity.

    Args:
        depth: (H, W) m, exact depth.
        counts: (H, W) disparity counts.
        mean: (H, W) their mean around each pixel, from which discontinuities follow.
        unmatched: (h, w) pixels without a match, at half the resolution.
        front: (h, w) largest count nearby.
        back: (h, w) smallest count nearby.
        mixed: Bank of deviates: at a discontinuity, positive ones lose the pixel, others place it between the surfaces.
        noise: Bank of disparity errors, counts.
        start: First row and column in both banks.
        depth_of_count: Depth by count, m; 0 out of range.
    """
    measured, last = np.zeros_like(depth), len(depth_of_count) - 1
    (top, left), width = start, depth.shape[1]
    for i in range(depth.shape[0]):
        luck, error = mixed[top + i, left : left + width], noise[top + i, left : left + width]
        for j in range(width):
            # no match, then a discontinuity: half of its pixels are lost, the others fly
            count = counts[i, j]
            if depth[i, j] == 0 or unmatched[i // 2, j // 2]:
                continue
            if abs(count - mean[i, j]) > _DISCONTINUITY * count:
                if luck[j] > 0:
                    continue
                weight = min(-luck[j] / np.float32(2), np.float32(1))  # a flying pixel
                count = back[i // 2, j // 2] + weight * (front[i // 2, j // 2] - back[i // 2, j // 2])
            at = max(int(np.rint(count + error[j])), 0)
            measured[i, j] = depth_of_count[at] if at <= last else np.float32(0.0)  # nearer than the range
    return measured


def _noise_bank(noise: Noise, shape: tuple[int, int], alike_px: float) -> NDArray[np.float32]:
    """(H + SPARE, W + SPARE) unit normal deviates that are correlated over `alike_px` pixels, for images (H, W)."""
    height, width = shape[0] + SPARE, shape[1] + SPARE
    coarse = noise.normal(1.0, (round(height / alike_px) + 1, round(width / alike_px) + 1)).astype(np.float32)
    if alike_px == 1:  # independent pixels, which need no interpolation
        return np.ascontiguousarray(coarse[:height, :width])
    bank = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(bank / bank.std(), np.float32)
