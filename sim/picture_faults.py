"""Faults of pictures: something before the lens, or dirt on it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.faults import PICTURES, Arrival, Event, Fault
from stridetwin.streams.samples import Depth, Image

_CLOTH = 28  # grey value of what hangs before the lens
_DIM = 0.75  # share of light that dirt lets through
_HOLE = 0.5


@dataclass(frozen=True, kw_only=True)
class Occlusion(Fault):
    """A strap or cloth that covers part of the picture from one side; depth has no reading there.

    Attributes:
        share: Of the picture that is covered.
    """

    kind = "occlusion"
    fits = PICTURES
    common_to = "housing"
    share: float = 0.3

    def spoiled(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The picture, partly covered."""
        side = int(event.rng().integers(4))
        name, picture = _picture(arrival)
        covered = picture.copy()
        across = covered if side % 2 else covered.swapaxes(0, 1)
        width = math.ceil(self.share * across.shape[0])
        across[slice(width) if side < 2 else slice(-width, None)] = _CLOTH if name == "pixels" else 0
        return (arrival.but(**{name: covered}),)


@dataclass(frozen=True, kw_only=True)
class LensDirt(Fault):
    """Spots on the lens, through which the picture is dim and blurred; depth has no reading in their middle.

    Attributes:
        spots: How many, at random places.
        size: Radius of a spot, as a share of the picture's height.
    """

    kind = "lens_dirt"
    fits = PICTURES
    common_to = "housing"
    spots: int = 6
    size: float = 0.08

    def spoiled(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The picture through the dirty lens."""
        name, picture = _picture(arrival)
        height, width = picture.shape[:2]
        dirt = _dirt(event, self.spots, self.size, height, width)
        if name == "depth":
            return (arrival.but(depth=np.where(dirt > _HOLE, np.float32(0), picture)),)
        dim = cv2.convertScaleAbs(_blurred(picture, self.size * height / 2), alpha=_DIM)
        return (arrival.but(pixels=cv2.blendLinear(picture, dim, 1 - dirt, dirt)),)


def _picture(arrival: Arrival) -> tuple[str, NDArray]:
    item = arrival.item
    if isinstance(item, Image):
        return "pixels", item.pixels
    if isinstance(item, Depth):
        return "depth", item.depth
    raise TypeError(f"{arrival.topic} carries no pictures")


def _blurred(picture: NDArray[np.uint8], sd_px: float) -> NDArray[np.uint8]:
    """A picture blurred widely: on a grid that is coarse, but fine against the blur."""
    height, width = picture.shape[:2]
    coarse = max(1, int(sd_px / 3))
    small = cv2.resize(picture, (-(-width // coarse), -(-height // coarse)), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(cv2.GaussianBlur(small, (0, 0), sd_px / coarse), (width, height)), np.uint8)


@lru_cache(maxsize=16)
def _dirt(event: Event, spots: int, size: float, height: int, width: int) -> NDArray[np.float32]:
    """(H, W) how much of the light comes through dirt, 0-1."""
    rng = event.rng()
    v, u = np.mgrid[:height, :width].astype(np.float32)
    clear = np.ones((height, width), np.float32)
    for _ in range(spots):
        row, column, stretch = rng.random(3)
        away = np.hypot((u - column * width) * (0.7 + 0.6 * stretch), v - row * height) / (size * height)
        clear *= 1 - np.clip(1.5 - away, 0, 1)  # a dense middle, and an edge that fades
    return 1 - clear
