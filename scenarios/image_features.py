"""Corners of a camera's images: how they are chosen, followed to the next image, and found in a depth image.

Images are reduced before corners are looked for, which takes less time and hardly any accuracy. A pixel of a reduced
image and that of the camera's own image differ by a factor and by the place of pixel centres at whole numbers.
"""

from __future__ import annotations

from typing import TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Depth, Image, Mask

Grey = NDArray[np.uint8]
"""(H, W) grey image."""
DepthImage = NDArray[np.float32]
"""(H, W) depths, m; 0 where the camera measured none."""
Corners = NDArray[np.float32]
"""(N, 2) column and row of features in a reduced image, px."""


class _FlowOptions(TypedDict):
    """Options of the optical flow of Lucas and Kanade: size of a window, and the topmost level of the pyramid."""

    winSize: tuple[int, int]
    maxLevel: int


_WIDTH = 400
"""Most pixels across of a reduced image."""
_CORNER_QUALITY, _CORNER_SPACING_PX = 0.01, 8
"""Least strength of a corner relative to the strongest one, and least distance of two corners."""
_LUCAS_KANADE: _FlowOptions = {"winSize": (15, 15), "maxLevel": 3}


def read_small_grey(recording: Recording, camera: CameraCalibration, number: int) -> Grey:
    """A camera's image in grey, reduced to at most `_WIDTH` pixels across.

    Args:
        recording: Recording with the images.
        camera: The camera, of which the topic counts.
        number: Number of the image.

    Raises:
        StrideTwinError: The image is damaged.
    """
    image = recording.images(camera.topic, [number])[0]
    assert isinstance(image, Image)  # a camera's topic has no depth images
    pixels = image.pixels if image.pixels.ndim == 2 else cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, _WIDTH / pixels.shape[1])
    return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def read_depth(recording: Recording, camera: CameraCalibration, number: int) -> DepthImage | None:
    """A camera's depth image; None if the topic of its depth has another kind of image.

    Args:
        recording: Recording with the images.
        camera: The camera, of which the topic of the depth counts.
        number: Number of the depth image.

    Raises:
        StrideTwinError: The image is damaged.
    """
    image = recording.images(camera.depth_topic, [number])[0]
    return image.depth if isinstance(image, Depth) else None


def find_corners(grey: Grey, most: int) -> Corners:
    """Up to `most` of the strongest corners of a reduced image, px; (0, 2) without any."""
    corners = cv2.goodFeaturesToTrack(grey, most, _CORNER_QUALITY, _CORNER_SPACING_PX)
    return np.asarray([] if corners is None else corners, np.float32).reshape(-1, 2)


def follow_corners(before: Grey, after: Grey, corners: Corners) -> tuple[Corners, Mask]:
    """Follows corners to the next image by the optical flow of Lucas and Kanade.

    Args:
        before: Image in which they are known, reduced.
        after: Next image, of the same size.
        corners: (N, 2) px in the first image, at least one.

    Returns:
        (N, 2) px in the next image, and (N,) whether each one has been followed; the others' pixels mean nothing.
    """
    points = corners.reshape(-1, 1, 2)
    pixels, is_followed, _ = cv2.calcOpticalFlowPyrLK(before, after, points, np.zeros_like(points), **_LUCAS_KANADE)
    return np.asarray(pixels, np.float32).reshape(-1, 2), np.ravel(is_followed) == 1


def to_full_size(corners: Corners, scale: float) -> Array:
    """(N, 2) pixels at the camera's own resolution.

    Args:
        corners: (N, 2) px in a reduced image.
        scale: Width of that image relative to the camera's own.
    """
    # 0.5 moves from the centre of a pixel to its corner and back
    return np.asarray((corners.astype(np.float64) + 0.5) / scale - 0.5)


def find_depth_pixels(corners: Corners, scale: float) -> NDArray[np.int_]:
    """(N, 2) column and row of the pixels of a depth image that are nearest to corners; they may lie beside the image.

    Args:
        corners: (N, 2) px in a reduced image.
        scale: Width of that image relative to the depth image.
    """
    # 0.5 moves from the centre of a pixel to its corner and back
    return np.asarray(np.rint((corners + 0.5) / scale - 0.5), np.int_)
