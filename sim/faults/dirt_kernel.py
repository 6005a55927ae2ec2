"""The blend of an image with its blurred copy where dirt is on the lens, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.compiled import entry_kernel


@entry_kernel(__file__)
def smear(
    image: NDArray[np.uint8],
    blurred: NDArray[np.uint8],
    places: NDArray[np.int32],
    clear: NDArray[np.float32],
    corners: NDArray[np.int32],
    shares: NDArray[np.float32],
    width: int,
) -> None:
    """Mixes each dirty pixel of an image with the blurred image around it, in place.

    A pixel becomes `clear` times itself plus the four blurred pixels around it, weighted by `shares`.

    Args:
        image: (N, C) pixels, row by row, which are overwritten.
        blurred: (M, C) pixels of the blurred image on its coarser grid.
        places: (K,) dirty pixels.
        clear: (K,) weight of the pixel itself, 0-1.
        corners: (K,) upper left one of the four blurred pixels around it.
        shares: (K, 4) weights of those four: the two upper ones, then the two lower ones.
        width: Width of the blurred image.
    """
    for k in range(len(places)):
        # the dirty pixel, the upper left blurred one, and the four weights
        at, first, share = places[k], corners[k], shares[k]
        for c in range(image.shape[1]):
            # the conversion to whole numbers cuts off, so that the added half rounds
            mixed = clear[k] * np.float32(image[at, c]) + np.float32(0.5)
            mixed += share[0] * np.float32(blurred[first, c]) + share[1] * np.float32(blurred[first + 1, c])
            mixed += share[2] * np.float32(blurred[first + width, c])
            mixed += share[3] * np.float32(blurred[first + width + 1, c])
            image[at, c] = np.uint8(mixed)
