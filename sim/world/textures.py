"""Procedural textures that tile seamlessly: rich in corners for visual odometry, and realistic to look at.

Each function paints a square of `SIZE` pixels that represents a square of `PERIOD_M` metres. Most add up a tone, a grey
value of 0-1: a mean, a random difference for every slab, plank or brick, noise, and pebbles. Joints have a tone of
their own, and `_paint` multiplies the tone by a tint. All these numbers are chosen by eye.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

SIZE = 1024  # edge of a texture, pixels
PERIOD_M = 2.0  # edge of the square that it represents

Pixels = NDArray[np.uint8]


def concrete(rng: np.random.Generator) -> Pixels:
    """Pale paving slabs of 0.5 m with pebbles."""
    # column, row and joints of the slabs; each slab has a tone of its own
    slab_x, slab_y, joint = _slabs(columns=4, rows=4, joint_m=0.008)
    tone = 0.60 + 0.05 * rng.standard_normal((4, 4))[slab_y, slab_x] + 0.035 * _noise(rng, 1.2)
    tone += _pebbles(rng, count=9000, radius=(1.0, 3.2), contrast=0.16)
    return _paint(np.where(joint, 0.33, tone), (1.0, 0.975, 0.93))


def wood(rng: np.random.Generator) -> Pixels:
    """Oak planks 0.125 m wide, along the columns of the image, with grain and knots."""
    end, plank, joint = _slabs(columns=2, rows=16, joint_m=0.004, shift=0.5)
    tone = 0.50 + 0.07 * rng.standard_normal((16, 2))[plank, end]
    tone += 0.07 * _noise(rng, 0.9, stretch=(0.06, 1.0)) + 0.02 * _noise(rng, 0.5)
    tone += _pebbles(rng, count=2500, radius=(1.0, 4.0), contrast=-0.18)
    return _paint(np.where(joint, 0.16, tone), (1.12, 0.80, 0.54)).transpose(1, 0, 2)


def brick(rng: np.random.Generator) -> Pixels:
    """Red bricks of 0.33 m by 0.125 m in running bond."""
    brick_x, brick_y, joint = _slabs(columns=6, rows=16, shift=0.5, joint_m=0.014)
    tone = 0.50 + 0.07 * rng.standard_normal((16, 6))[brick_y, brick_x] + 0.04 * _noise(rng, 0.8)
    tone += _pebbles(rng, count=6000, radius=(0.8, 2.5), contrast=0.14)
    bricks = _paint(tone, (1.12, 0.72, 0.58))
    mortar = _paint(0.66 + 0.05 * _noise(rng, 0.4), (1.0, 0.97, 0.92))
    return np.where(joint[..., None], mortar, bricks)


def stone(rng: np.random.Generator) -> Pixels:
    """Draws grey granite blocks of 0.4 m by 0.2 m, for the side faces of terrain."""
    block_x, block_y, joint = _slabs(columns=5, rows=10, shift=0.5, joint_m=0.010)
    tone = 0.47 + 0.05 * rng.standard_normal((10, 5))[block_y, block_x] + 0.05 * _noise(rng, 0.9)
    tone += _pebbles(rng, count=7000, radius=(1.0, 3.0), contrast=0.15)
    return _paint(np.where(joint, 0.26, tone), (0.97, 0.99, 1.04))


def grass(rng: np.random.Generator) -> Pixels:
    """Draws a lawn."""
    return _paint(0.40 + 0.05 * _noise(rng, 1.0) + 0.05 * _noise(rng, 0.3), (0.80, 1.06, 0.50))


def leaves(rng: np.random.Generator) -> Pixels:
    """Draws the leaves of a trimmed hedge."""
    tone = 0.30 + 0.04 * _noise(rng, 1.0) + _pebbles(rng, count=16000, radius=(2.0, 7.0), contrast=0.16)
    return _paint(tone, (0.66, 1.06, 0.46))


def plaster(rng: np.random.Generator) -> Pixels:
    """Draws a warm white wall with scattered marks."""
    tone = 0.78 + 0.025 * _noise(rng, 1.3) + _pebbles(rng, count=2500, radius=(1.5, 5.0), contrast=0.13)
    return _paint(tone, (1.0, 0.96, 0.88))


def poster(rng: np.random.Generator) -> Pixels:
    """Printed sheets of coloured fields of 0.17 m with blots and fine dots on them."""
    v, u = np.mgrid[0:SIZE, 0:SIZE] * 12 // SIZE
    fields = rng.uniform(0.25, 0.9, (12, 12, 1)) * rng.uniform(0.75, 1.15, (12, 12, 3))
    ink = _pebbles(rng, count=600, radius=(4.0, 12.0), contrast=0.25) + _pebbles(rng, 5000, (1.0, 2.5), 0.3)
    return np.clip(255 * (fields[v, u] + ink[..., None]), 0, 255).astype(np.uint8)


TEXTURES: dict[str, Callable[[np.random.Generator], Pixels]] = {
    f.__name__: f for f in (concrete, wood, brick, stone, grass, leaves, plaster, poster)
}

_PLAIN_CONTRAST = 0.12  # contrast of a plain texture over that of the rich one
_WHITE = (236, 236, 232)


def _plain(pixels: Pixels) -> Pixels:
    """Texture with hardly any contrast and the mean colour of the original."""
    mean = pixels.mean(axis=(0, 1))
    return (mean + _PLAIN_CONTRAST * (pixels - mean)).astype(np.uint8)


def _white(pixels: Pixels) -> Pixels:
    """Bare white: no features but edges and shading."""
    return np.broadcast_to(np.array(_WHITE, np.uint8), pixels.shape).copy()


FINISHES: dict[str, Callable[[Pixels], Pixels]] = {"rich": lambda pixels: pixels, "plain": _plain, "white": _white}
"""By name of a finish: the change that it makes to a painted texture."""


def _noise(rng: np.random.Generator, power: float, stretch: tuple[float, float] = (1.0, 1.0)) -> Array:
    """(SIZE, SIZE) periodic noise of unit variance with a spectrum of 1/f^`power`.

    `stretch` scales the frequencies along x and y: below 1, the noise is drawn out along that axis.
    """
    fy, fx = np.meshgrid(np.fft.fftfreq(SIZE) * SIZE, np.fft.rfftfreq(SIZE) * SIZE, indexing="ij")
    radius = np.hypot(fx / stretch[0], fy / stretch[1])
    radius[0, 0] = np.inf  # no mean value; below three periods per edge, the spectrum is flat
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) / np.maximum(radius, 3.0) ** power
    image = np.fft.irfft2(spectrum, s=(SIZE, SIZE))
    return image / image.std()


def _slabs(
    columns: int, rows: int, joint_m: float, shift: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Column and row of the slab under each pixel, and whether it is a joint: three (SIZE, SIZE) arrays.

    Args:
        columns: Slabs per row of the texture.
        rows: Rows of slabs.
        joint_m: Width of the joints, m.
        shift: Offset of odd rows, in slabs.
    """
    v, u = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    down = v * rows
    row = np.floor(down).astype(int)
    across = (u * columns + shift * (row % 2)) % columns
    half = joint_m / PERIOD_M / 2
    joint = (_to_border(down) < half * rows) | (_to_border(across) < half * columns)
    return np.floor(across).astype(int), row, joint


def _to_border(value: Array) -> Array:
    """(...) distance of (...) values, counted in slabs, to the nearest border, a whole number."""
    return np.abs(value - np.round(value))


def _pebbles(rng: np.random.Generator, count: int, radius: tuple[float, float], contrast: float) -> Array:
    """(SIZE, SIZE) scattered discs, whose sharp borders are features for corner detectors.

    Args:
        rng: Draws places, sizes and brightness.
        count: Number of discs.
        radius: Smallest and largest radius, pixels.
        contrast: Standard deviation of their brightness over that around them, which is 0.
    """
    image = np.zeros((SIZE, SIZE))
    centre = rng.integers(0, SIZE, (count, 2))
    size = rng.uniform(*radius, count)
    level = contrast * rng.standard_normal(count)
    # pixel by pixel around all centres at once; borders wrap around, so that the texture tiles
    reach = int(np.ceil(radius[1]))
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            near = dx * dx + dy * dy <= size * size
            y, x = (centre[near] + (dy, dx)).T % SIZE
            image[y, x] = level[near]
    return image


def _paint(tone: Array, tint: tuple[float, float, float]) -> Pixels:
    """(SIZE, SIZE, 3) pixels from (SIZE, SIZE) grey tones in 0-1, each channel times its factor in `tint`."""
    return np.clip(255 * tone[..., None] * np.array(tint), 0, 255).astype(np.uint8)
