"""What a camera makes of the light that falls on its sensor: vignetting, shot and read noise, gain, grey values."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import Imager

Pixels = NDArray[np.uint8]
SPARE = 64
"""A bank of noise is this much larger than a picture, and each picture takes another cut of it."""
BLANK = 96
"""Grey value of what is not drawn."""
_TARGET = 0.45  # mean of a picture over white, to which automatic exposure goes
_GAINS = (0.25, 64.0)


class Sensor:
    """Turns clean grey values into those of the camera.

    White fills the well of a pixel in the light that the camera is set for, and `light` times as much comes in.
    Electrons have shot noise, reading them adds read noise, and the gain makes grey values of them.

    Args:
        shape: (H, W) or (H, W, 3).
        imager: The camera as it really is.
        light: On the scene, over what the camera is set for.
        noise: What its errors are drawn from.
    """

    def __init__(self, shape: tuple[int, ...], imager: Imager, light: float, noise: Noise) -> None:
        self.shape, self._imager, self._light, self._noise = shape, imager, light, noise
        self._noisy = math.isfinite(imager.full_well)
        if self._noisy:
            self._bank = noise.normal(1.0, (shape[0] + SPARE, shape[1] + SPARE, *shape[2:])).astype(np.float32)
        self._falloff = _falloff(shape, imager.vignetting) if imager.vignetting else None
        self._gain: float | None = None if imager.auto_exposure_s else 1.0
        self._before_ns = 0

    def exposed(self, t_ns: int, clean: Pixels, row: int = 0, column: int = 0) -> Pixels:
        """Grey values or colours of a piece (h, w, ...) of a picture, whose upper left pixel is given.

        Pictures of a camera with automatic exposure come in order of time.
        """
        gain = self._gain_for(t_ns, clean)
        piece = (slice(row, row + len(clean)), slice(column, column + clean.shape[1]))
        bright: NDArray = clean
        if self._falloff is not None:
            bright = cv2.multiply(clean, self._falloff[piece], dtype=cv2.CV_32F)
        if self._noisy:
            shift = self._noise.at(t_ns).integers((SPARE, SPARE))
            rows, columns = (slice(s.start + by, s.stop + by) for s, by in zip(piece, shift))
            grain = cv2.multiply(cv2.LUT(clean, self._grain_of_level()), self._bank[rows, columns])
            bright = cv2.add(bright, grain, dtype=cv2.CV_32F)
        if bright is clean and gain * self._light == 1.0:
            return clean
        return np.asarray(cv2.addWeighted(bright, gain * self._light, bright, 0.0, 0.0, dtype=cv2.CV_8U))

    def _grain_of_level(self) -> NDArray[np.float32]:
        """(256,) standard deviation at each clean level, in levels before the gain."""
        imager = self._imager
        electrons = np.arange(256) / 255 * imager.full_well * self._light
        per_electron = 255 / (imager.full_well * self._light)
        return (per_electron * np.sqrt(electrons + imager.read_noise**2)).astype(np.float32)

    def _gain_for(self, t_ns: int, clean: Pixels) -> float:
        """The gain of this picture; that of the next one follows its brightness with the exposure's lag."""
        lag = self._imager.auto_exposure_s
        if not lag:
            return 1.0
        small = cv2.resize(clean, (40, 30), interpolation=cv2.INTER_NEAREST)
        mean = max(float(np.mean(small)), 1.0) / 255 * self._light
        wanted = min(max(_TARGET / mean, _GAINS[0]), _GAINS[1])
        now = wanted if self._gain is None else self._gain
        stays = math.exp(-(t_ns - self._before_ns) * 1e-9 / lag)
        self._gain, self._before_ns = now**stays * wanted ** (1 - stays), t_ns
        return now


def _falloff(shape: tuple[int, ...], loss: float) -> NDArray[np.float32]:
    """Share of the light that arrives: falls with the fourth power of the cosine, to 1 − loss in the corners."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    r2 = ((u - (shape[1] - 1) / 2) ** 2 + (v - (shape[0] - 1) / 2) ** 2) / ((shape[0] / 2) ** 2 + (shape[1] / 2) ** 2)
    tan2 = (1 - loss) ** -0.5 - 1  # cos^4 = 1 / (1 + tan^2)^2
    falloff = (1 / (1 + tan2 * r2) ** 2).astype(np.float32)
    return falloff if len(shape) == 2 else np.repeat(falloff[..., None], shape[2], axis=2)
