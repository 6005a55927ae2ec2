"""Image faults: occlusion of the lens, or dirt on it."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.faults.faults import IMAGES, Arrival, Event, EventsOfTopic, Memory, TimedFault, at
from stridetwin.streams.fields import number, whole
from stridetwin.streams.samples import Depth, Image

_CLOTH = 28  # grey value of the occluding object, dark textile
_DIM = 0.75  # transmission of dirt; chosen by hand
_HOLE = 0.5  # opacity of dirt from which depth has no reading


@dataclass(frozen=True, kw_only=True)
class _ImageFault(TimedFault):
    """Something between a scene and its images that does not change during an event."""

    fits = IMAGES
    common_to = "housing"

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """As `Fault.through`; images with empty views share their pixels before and after."""
        for arrival in stream:
            event = at(events, arrival)
            if event is None:
                yield arrival
                continue
            name, image = image_of(arrival)
            if image.flags.writeable:
                yield arrival.but(**{name: self.seen(image, event)})
                continue
            if memory.get("event") is not event or memory["clean"] is not image:
                corrupted = self.seen(image, event)
                corrupted.setflags(write=False)
                memory.update(event=event, clean=image, corrupted=corrupted)
            yield arrival.but(**{name: memory["corrupted"]})

    @abstractmethod
    def seen(self, image: NDArray, event: Event) -> NDArray:
        """A new image, or depth image (float32), with the occlusion applied."""


@dataclass(frozen=True, kw_only=True)
class Occlusion(_ImageFault):
    """A strap or cloth that covers part of the image from one side; depth has no reading there.

    Attributes:
        share: Covered share of the image.
    """

    share: Annotated[float, number(0.01, 1)] = 0.3

    def seen(self, image: NDArray, event: Event) -> NDArray:
        """The image, partly covered."""
        side = int(event.rng().integers(4))
        covered = image.copy()
        across = covered if side % 2 else covered.swapaxes(0, 1)
        width = math.ceil(self.share * across.shape[0])
        across[slice(width) if side < 2 else slice(-width, None)] = 0 if is_depth(image) else _CLOTH
        return covered


@dataclass(frozen=True, kw_only=True)
class LensDirt(_ImageFault):
    """Spots on the lens that dim and blur the image; depth has no reading in their middle.

    Attributes:
        spots: Number of spots, at random places.
        size: Radius of a spot, as a share of the image height.
    """

    spots: Annotated[int, whole(1, 50)] = 6
    size: Annotated[float, number(0.01, 0.5)] = 0.08

    def seen(self, image: NDArray, event: Event) -> NDArray:
        """The image through the dirty lens."""
        height, width = image.shape[:2]
        dirt, corrupted = _dirt(event, self.spots, self.size, height, width), image.copy()
        if is_depth(image):
            corrupted.reshape(-1)[dirt.places[dirt.clear < 1 - _HOLE]] = 0
        else:
            blurred = _blurred(image, _coarse(self.size, height), self.size * height / 2)
            each = math.prod(image.shape[2:])
            from stridetwin.sim.faults.dirt_kernel import smear  # compiled, so imported when it is needed

            smear(corrupted.reshape(-1, each), blurred.reshape(-1, each), *dirt)
        return corrupted


def image_of(arrival: Arrival) -> tuple[str, NDArray]:
    """Name and value of the image in a sample of a camera."""
    item = arrival.item
    if isinstance(item, Image):
        return "pixels", item.pixels
    if isinstance(item, Depth):
        return "depth", item.depth
    raise TypeError(f"{arrival.topic} carries no images")


def is_depth(image: NDArray) -> bool:
    """Whether an image holds depth, not light."""
    return image.dtype == np.float32


class _Dirt(NamedTuple):
    """Pixels of dirt in an image, and how each is mixed with the blurred image on a coarser grid.

    Attributes:
        places: (N,) pixels, counted row by row.
        clear: (N,) weight of the pixel itself, 0-1.
        corners: (N,) upper left one of the four blurred pixels around it, counted row by row.
        shares: (N, 4) weights of those four: the two upper ones, then the two lower ones.
        width: Width of the blurred image.
    """

    places: NDArray[np.int32]
    clear: NDArray[np.float32]
    corners: NDArray[np.int32]
    shares: NDArray[np.float32]
    width: int


def _coarse(size: float, height: int) -> int:
    """Ratio of image pixels to blurred pixels: a coarse grid that is still fine relative to the blur."""
    return max(1, int(size * height / 6))


def _blurred(image: NDArray[np.uint8], coarse: int, sd_px: float) -> NDArray[np.uint8]:
    """A widely blurred image, on a coarser grid with one additional pixel all around."""
    height, width = image.shape[:2]
    small = cv2.resize(image, (-(-width // coarse), -(-height // coarse)), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), sd_px / coarse)
    return np.asarray(cv2.copyMakeBorder(blurred, 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.uint8)


@lru_cache(maxsize=16)
def _dirt(event: Event, spots: int, size: float, height: int, width: int) -> _Dirt:
    rng = event.rng()
    v, u = np.mgrid[:height, :width].astype(np.float32)
    clear = np.ones((height, width), np.float32)
    for _ in range(spots):
        row, column, stretch = rng.random(3)
        away = np.hypot((u - column * width) * (0.7 + 0.6 * stretch), v - row * height) / (size * height)
        clear *= 1 - np.clip(1.5 - away, 0, 1)  # a dense middle, and an edge that fades
    places = np.flatnonzero(clear < 1)
    clear = clear.reshape(-1)[places]
    rows, columns = (-(-n // _coarse(size, height)) for n in (height, width))
    y, x = (places // width + 0.5) * (rows / height) + 0.5, (places % width + 0.5) * (columns / width) + 0.5
    down, across = y % 1, x % 1
    shares = np.stack([(1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across], axis=1)
    return _Dirt(
        places=places.astype(np.int32),
        clear=clear,
        corners=(y.astype(np.int32) * (columns + 2) + x.astype(np.int32)).astype(np.int32),
        shares=(_DIM * (1 - clear)[:, None] * shares).astype(np.float32),
        width=columns + 2,
    )
