"""Pictures as cameras give them: read noise on grey or colour, range-dependent noise and holes in depth."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.streams.samples import Depth, Image

READ_NOISE_SD = 1.5  # of 255; a well lit global-shutter sensor
DEPTH_SD_PER_M = 0.004  # sigma = 0.004 / m * z^2: D455, 2 % at 4 m with room to spare
DEPTH_RANGE_M = (0.4, 6.0)
DEPTH_STEP_M = 0.001
_SPARE = 64  # the bank of noise is this much larger than a picture, and each picture takes another cut of it


class CameraModel:
    """Adds read noise.

    Args:
        topic: Stream of the pictures.
        shape: (H, W) for grey, (H, W, 3) for colour.
        noise: Its noise.
    """

    def __init__(self, topic: str, shape: tuple[int, ...], noise: Noise) -> None:
        self._topic, self._shape, self._noise = topic, shape, noise
        bank = (shape[0] + _SPARE, shape[1] + _SPARE, *shape[2:])
        self._bank = np.round(noise.normal(READ_NOISE_SD, bank)).astype(np.int16)

    def picture(self, t_ns: int, rgb: NDArray[np.uint8]) -> Image:
        """The sample for a rendered (H, W, 3) picture, turned to grey where the camera is grey."""
        clean = rgb if len(self._shape) == 3 else cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        if self._noise.ideal:
            return Image(topic=self._topic, t_ns=t_ns, pixels=np.asarray(clean, np.uint8))
        noisy = cv2.add(clean, _cut(self._bank, self._shape, self._noise.at(t_ns)), dtype=cv2.CV_8U)
        return Image(topic=self._topic, t_ns=t_ns, pixels=np.asarray(noisy, np.uint8))


class DepthModel:
    """Adds noise that grows with the square of the range, leaves out too near and too far, counts in mm.

    Args:
        topic: Stream of the pictures.
        shape: (H, W).
        noise: Its noise; ideal depth has no noise and no steps, but the same range.
    """

    def __init__(self, topic: str, shape: tuple[int, int], noise: Noise) -> None:
        self._topic, self._shape, self._noise = topic, shape, noise
        self._bank = noise.normal(DEPTH_SD_PER_M, (shape[0] + _SPARE, shape[1] + _SPARE)).astype(np.float32)

    def picture(self, t_ns: int, depth: NDArray[np.float32]) -> Depth:
        """The sample for a rendered (H, W) depth picture, m."""
        told = np.array(depth, dtype=np.float32)
        if not self._noise.ideal:
            told += told * told * _cut(self._bank, self._shape, self._noise.at(t_ns))
            told = np.round(told / np.float32(DEPTH_STEP_M)) * np.float32(DEPTH_STEP_M)
        low, high = DEPTH_RANGE_M
        told[(told < low) | (told > high)] = 0
        return Depth(topic=self._topic, t_ns=t_ns, depth=told)


def _cut(bank: NDArray, shape: tuple[int, ...], noise: Noise) -> NDArray:
    """A piece of the bank, the size of a picture, from a random place."""
    row, column = noise.integers((_SPARE, _SPARE))
    return np.ascontiguousarray(bank[row : row + shape[0], column : column + shape[1]])
