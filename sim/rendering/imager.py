"""Camera models: distortion of the lens; vignetting, noise, gain and grey values of the image sensor."""

from __future__ import annotations

import math
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import Imager
from stridetwin.sim.world.light import LightCourse
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array

Pixels = NDArray[np.uint8]
SPARE = 64
"""A noise bank has this many more rows and columns than an image, and each image uses another crop of it."""
BLANK = 96
"""Grey value of pixels that are not rendered."""
_TARGET = 0.45  # target of automatic exposure: mean grey value over white, that of typical cameras
_GAINS = (0.25, 64.0)  # of automatic exposure relative to the nominal one, smallest and largest
NumberT = TypeVar("NumberT", np.uint8, np.float32)  # type of a pixel: brightness or depth


class ImageSensor:
    """Converts clean grey values to those of the camera.

    At the nominal illumination white fills the full well of a pixel; the light is `light` times the nominal one.
    Electrons have shot noise, readout adds read noise, and the gain converts them to grey values.

    Args:
        shape: (H, W) or (H, W, 3).
        imager: True parameters of the camera.
        light: Brightness of the scene relative to the camera's setting.
        noise: Source of its errors.
        course: How that brightness changes during the walk.
    """

    def __init__(
        self, shape: tuple[int, ...], imager: Imager, light: float, noise: Noise, course: LightCourse | None = None
    ) -> None:
        """Prepares the bank of noise, the variance of a level, and the vignetting.

        `shape` is (H, W) or (H, W, 3); `light` is the brightness of the scene relative to the camera's setting. An
        infinite full well stands for a sensor without noise.
        """
        self.shape, self._imager, self._light, self._noise = shape, imager, light, noise
        self._course = course or LightCourse()
        self._noisy = math.isfinite(imager.full_well)
        height, width, self._channels = (*shape, 1)[:3]
        self._bank = np.zeros((height + SPARE, (width + SPARE) * self._channels), np.float32)  # unit deviates
        self._variance = np.zeros(2, np.float32)
        if self._noisy:
            self._bank[:] = noise.normal(1.0, self._bank.shape)
            # variance of a clean level, in squared levels before the gain: its growth per level, and its value in the
            # dark
            per_electron = 255 / (imager.full_well * light)  # levels; `full_well` electrons are white at nominal light
            self._variance[:] = per_electron, (per_electron * imager.read_noise) ** 2
        # Light falls off with the fourth power of the cosine, 1 / (1 + tan²)², to 1 - vignetting in the corners.
        # tan² is the sum of a share of the row and one of the column, each in proportion to the squared distance from
        # the middle; distances are doubled, so that they are whole numbers
        tan2_per_square = ((1 - imager.vignetting) ** -0.5 - 1) / (height**2 + width**2)
        self._tan2 = [(tan2_per_square * (2 * np.arange(n) - (n - 1)) ** 2).astype(np.float32) for n in (height, width)]
        # automatic exposure: gain of the next image, None before the first one, and time of the last image
        self._gain: float | None = None if imager.auto_exposure_s else 1.0
        self._before_ns = 0

    def expose(self, t_ns: int, clean: Pixels, row: int = 0, column: int = 0) -> Pixels:
        """Grey values or colours of a part (h, w, ...) of an image, given its upper left pixel.

        Images of a camera with automatic exposure must come in order of time, because each one changes the gain of the
        next.

        Args:
            t_ns: Time of the image; it selects the noise.
            clean: (h, w, ...) noise-free levels, 255 for white.
            row: First row of the part in the image.
            column: First column of the part in the image.
        """
        change = self._course.factor(t_ns)  # of the light since the start
        gain = self._update_gain(t_ns, clean, self._light * change) * (self._light * change)
        if gain == 1.0 and not self._noisy and not self._imager.vignetting:
            return clean  # an ideal camera measures the clean levels
        # another crop of the noise bank for each image
        down, right = self._noise.at(t_ns).integers((SPARE, SPARE)) if self._noisy else (0, 0)
        channels, (height, width) = self._channels, clean.shape[:2]
        # squared tangents of the rows and columns of this part
        rows, columns = self._tan2[0][row : row + height], self._tan2[1][column : column + width]
        # the channels of a pixel lie side by side, as columns of their own
        levels = np.ascontiguousarray(clean).reshape(height, channels * width)
        start = (row + down, channels * (column + right))
        # fewer electrons make a level in less light
        variance = self._variance if change == 1.0 else (self._variance / [change, change**2]).astype(np.float32)
        measured = _measure_levels(
            levels, rows, np.repeat(columns, channels), self._bank, start, variance, np.float32(gain)
        )
        return measured.reshape(clean.shape)

    def _update_gain(self, t_ns: int, clean: Pixels, light: float) -> float:
        """Gain of this image over the nominal one; updates the gain of the next image.

        The automatic exposure wants a mean of `_TARGET` times white. The logarithm of the gain approaches that of the
        wanted gain with the lag of the control. Without automatic exposure the gain is 1.

        Args:
            t_ns: Time of the image.
            clean: (h, w, ...) noise-free levels.
            light: Brightness of the scene relative to the camera's setting.
        """
        lag = self._imager.auto_exposure_s  # s, time constant
        if not lag:
            return 1.0
        # mean over white of a few pixels of the image, at nominal gain; not 0 for a black image
        small = cv2.resize(clean, (40, 30), interpolation=cv2.INTER_NEAREST)
        mean = max(float(np.mean(small)), 1.0) / 255 * light
        # the first image has the wanted gain itself
        wanted_gain = min(max(_TARGET / mean, _GAINS[0]), _GAINS[1])
        gain = wanted_gain if self._gain is None else self._gain
        kept_share = math.exp(-(t_ns - self._before_ns) * 1e-9 / lag)
        self._gain, self._before_ns = gain**kept_share * wanted_gain ** (1 - kept_share), t_ns
        return gain


@entry_kernel(__file__, error_model="numpy")
def _measure_levels(
    levels: Pixels,
    tan2_rows: NDArray[np.float32],
    tan2_columns: NDArray[np.float32],
    bank: NDArray[np.float32],
    start: tuple[int, int],
    variance: NDArray[np.float32],
    gain: np.float32,
) -> Pixels:
    """Measured levels (H, W): round(gain (level / (1 + tan²)² + noise)), clipped to 0-255.

    The noise has the variance `variance[0]` level + `variance[1]`, shot noise and read noise.

    Args:
        levels: (H, W) clean levels.
        tan2_rows: (H,) squared tangents of the rows, for vignetting.
        tan2_columns: (W,) squared tangents of the columns.
        bank: Unit normal deviates, larger than the image.
        start: First row and column in the bank.
        variance: (2,) coefficients of the variance.
        gain: Gain.
    """
    measured, one, white = np.empty(levels.shape, np.uint8), np.float32(1), np.float32(255)
    of_light, in_dark = variance
    top, left = start
    for i in range(levels.shape[0]):
        # one row: clean levels, unit deviates, and output
        clean, noise, row = levels[i], bank[top + i, left : left + levels.shape[1]], measured[i]
        for j in range(levels.shape[1]):
            level, spread = np.float32(clean[j]), one + tan2_rows[i] + tan2_columns[j]
            bright = level / (spread * spread) + np.sqrt(of_light * level + in_dark) * noise[j]
            row[j] = np.uint8(min(max(np.rint(gain * bright), np.float32(0)), white))
    return measured


_WIDEST = 4.0  # largest pinhole image, times the image size: it cannot contain rays near 90 degrees


class RenderedLens:
    """Lens of a rendered camera, with `radtan` (Brown-Conrady) or `equidistant` (Kannala-Brandt) distortion.

    A pinhole image that covers all rays of the camera is rendered; `distort` then resamples it.

    Args:
        calibration: True calibration of the camera.

    Attributes:
        straight: Whether there is no distortion.
        width, height: Size of the pinhole image to render, pixels.
        intrinsics: Intrinsics of that image, (fu, fv, pu, pv).

    Raises:
        ConfigError: Coefficients that map the image border outside a pinhole image.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        """Finds the pinhole image that covers all rays, and where each pixel of the camera lies in it."""
        self.straight = calibration.distortion_model == "radtan" and not any(calibration.distortion)
        self.width, self.height, self.intrinsics = calibration.width, calibration.height, calibration.intrinsics
        if self.straight:
            return
        fu, fv, pu, pv = calibration.intrinsics
        rays = _rays(calibration)
        # (H, W) column and row at which the pinhole camera with these intrinsics sees the ray of each pixel
        u, v = fu * rays[..., 0] + pu, fv * rays[..., 1] + pv
        # columns and rows that cover them, with one more on each side for the interpolation
        left, right = math.floor(u.min()) - 1, math.ceil(u.max()) + 1
        top, bottom = math.floor(v.min()) - 1, math.ceil(v.max()) + 1
        self.width, self.height = right - left + 1, bottom - top + 1
        if not self.width * self.height < _WIDEST**2 * calibration.width * calibration.height:
            valid = "coefficients with which every pixel is well below 90 deg off the axis"
            raise ConfigError(calibration.topic, "distortion", list(calibration.distortion), valid)
        self.intrinsics = fu, fv, pu - left, pv - top
        # (H, W) column and row of the pinhole image that each pixel of the camera shows
        self._maps = (u - left).astype(np.float32), (v - top).astype(np.float32)

    def distort(self, image: NDArray[NumberT], interpolation: int = cv2.INTER_LINEAR) -> NDArray[NumberT]:
        """The camera's image (H, W, ...), resampled from the pinhole image (height, width, ...)."""
        return image if self.straight else np.asarray(cv2.remap(image, *self._maps, interpolation), image.dtype)


def _rays(calibration: CameraCalibration) -> Array:
    """(H, W, 2) x/z and y/z of the ray of each pixel, optical axes; the distortion of the lens is undone."""
    v, u = np.mgrid[: calibration.height, : calibration.width].astype(float)
    points, d = np.stack([u, v], axis=-1).reshape(-1, 1, 2), np.array(calibration.distortion)
    undistorted = cv2.undistortPoints if calibration.distortion_model == "radtan" else cv2.fisheye.undistortPoints
    return np.asarray(undistorted(points, calibration.K, d), np.float64).reshape(
        calibration.height, calibration.width, 2
    )
