"""Faults of what a camera sees: occlusion, dirt, a passer-by, worse depth, a view too high, a floor like a mirror."""

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
from pydantic import Field, StrictInt

from stridetwin.sim.faults.faults import IMAGES, Event, EventsOfTopic, Memory, SampleInTransit, TimedFault, active_event
from stridetwin.streams.fields import MILLIMETRES, Number
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Depth, Image, Odometry

_CLOTH = 28  # grey value of the occluding object, dark textile
_DIM = 0.75  # transmission of dirt; chosen by hand
_HOLE = 0.5  # opacity of dirt from which depth has no reading
_SLIM, _WAY = 0.5, 0.3  # a person's half width over half height; amplitude of the motion over the image's width
_ROUND_M = 0.12  # depth of a body, from its middle to its outline
_FLAT = 0.05  # share of its distance within which a depth pixel belongs to the floor
_MEMORY = 1000  # true poses that are kept: 5 s, more than a chunk of the twin
_LONGEST_M = 6.0  # beyond which the mirror image has no depth
ImageArray = NDArray[np.uint8] | NDArray[np.float32]
"""Pixels of a colour or grey image, or depth in m."""


@dataclass(frozen=True, kw_only=True)
class _ImageFault(TimedFault):
    """Something between a scene and its images that does not change during an event."""

    sample_types = IMAGES
    common_to = "housing"

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals with degraded images during events.

        Images that share one read-only array, as empty views do, share one degraded array as well. For them `memory`
        holds the last event, its clean image, and the corrupted one.
        """
        for arrival in stream:
            event = active_event(events, arrival)
            if event is None:
                yield arrival
                continue
            name, image = image_field(arrival)
            if image.flags.writeable:  # no other sample shares this array
                yield arrival.with_values(**{name: self.degrade(image, event)})
                continue
            # a new array is degraded only if the event or the shared image is another one than before
            if memory.get("event") is not event or memory["clean"] is not image:
                corrupted = self.degrade(image, event)
                corrupted.setflags(write=False)
                memory.update(event=event, clean=image, corrupted=corrupted)
            yield arrival.with_values(**{name: memory["corrupted"]})

    @abstractmethod
    def degrade(self, image: ImageArray, event: Event) -> ImageArray:
        """New image as the camera sees it through the fault; depth images are float32, 0 without a reading."""


@dataclass(frozen=True, kw_only=True)
class Occlusion(_ImageFault):
    """A strap or cloth that covers part of the image from one side; depth has no reading there.

    Attributes:
        share: Covered share of the image.
    """

    share: Annotated[Number, Field(ge=0.01, le=1)] = 0.3

    def degrade(self, image: ImageArray, event: Event) -> ImageArray:
        """The image with one side covered; covered depth has no reading."""
        side = int(event.rng().integers(4))  # 0 left, 1 top, 2 right, 3 bottom
        covered = image.copy()
        # a view whose first axis goes from side to side: rows for top and bottom, columns for left and right
        across = covered if side % 2 else covered.swapaxes(0, 1)
        width = math.ceil(self.share * across.shape[0])
        strip = slice(width) if side < 2 else slice(-width, None)  # at the begin of that axis, or at its end
        across[strip] = 0 if is_depth(image) else _CLOTH
        return covered


@dataclass(frozen=True, kw_only=True)
class LensDirt(_ImageFault):
    """Spots on the lens that dim and blur the image; depth has no reading in their middle.

    Attributes:
        spots: Number of spots, at random places.
        size: Radius of a spot, as a share of the image height.
    """

    spots: Annotated[StrictInt, Field(ge=1, le=50)] = 6
    size: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.08

    def degrade(self, image: ImageArray, event: Event) -> ImageArray:
        """The image through the dirty lens: dimmed and blurred at the spots; depth is missing in their middle."""
        height, width = image.shape[:2]
        dirt, corrupted = _draw_dirt(event, self.spots, self.size, height, width), image.copy()
        if is_depth(image):  # 0 is no reading
            corrupted.reshape(-1)[dirt.places[dirt.clear < 1 - _HOLE]] = 0
        else:
            # an SD of half the radius of a spot
            blurred = _blur_coarse(np.asarray(image, np.uint8), _blur_scale(self.size, height), self.size * height / 2)
            channels = math.prod(image.shape[2:])  # 1 of a grey image
            from stridetwin.sim.faults.dirt_kernel import smear  # compiled, so imported when it is needed

            # the fields of `dirt` are the further arguments, in the same order
            smear(corrupted.reshape(-1, channels).view(np.uint8), blurred.reshape(-1, channels), *dirt)
        return corrupted


def image_field(arrival: SampleInTransit) -> tuple[str, ImageArray]:
    """Name and value of the field of a camera's sample that holds the image: `pixels` or `depth`.

    Raises:
        TypeError: A sample without an image.
    """
    item = arrival.item
    if isinstance(item, Image):
        return "pixels", item.pixels
    if isinstance(item, Depth):
        return "depth", item.depth
    raise TypeError(f"{arrival.topic} carries no images")


def depth_field(arrival: SampleInTransit) -> NDArray[np.float32]:
    """Depth of a depth camera's sample.

    Raises:
        TypeError: A sample without depth.
    """
    if not isinstance(arrival.item, Depth):
        raise TypeError(f"{arrival.topic} carries no depth")
    return arrival.item.depth


def is_depth(image: ImageArray) -> bool:
    """Whether an image holds depth in metres (float32) and not brightness."""
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


def _blur_scale(size: float, height: int) -> int:
    """Ratio of image pixels to blurred pixels: a coarse grid that is still fine relative to the blur."""
    return max(1, int(size * height / 6))


def _blur_coarse(image: NDArray[np.uint8], coarse: int, sd_px: float) -> NDArray[np.uint8]:
    """Image blurred by a wide Gaussian, on a coarser grid, with one additional pixel all around.

    Args:
        image: (H, W, ...) pixels.
        coarse: Ratio of image pixels to those of the result.
        sd_px: Standard deviation of the blur, pixels of the image.
    """
    height, width = image.shape[:2]
    # columns and rows of the coarser grid, rounded up
    small = cv2.resize(image, (-(-width // coarse), -(-height // coarse)), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), sd_px / coarse)
    return np.asarray(cv2.copyMakeBorder(blurred, 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.uint8)


@lru_cache(maxsize=16)
def _draw_dirt(event: Event, spots: int, size: float, height: int, width: int) -> _Dirt:
    """Dirt of an event on an image of a size: random spots, dense in the middle, that fade at their edges.

    Args:
        event: Event, whose random numbers place the spots.
        spots: Number of spots.
        size: Radius of a spot over the image's height.
        height: Of the image, pixels.
        width: Of the image, pixels.
    """
    rng = event.rng()
    v, u = np.mgrid[:height, :width].astype(np.float32)
    clear = np.ones((height, width), np.float32)  # weight of each pixel itself, 1 without dirt
    for _ in range(spots):
        row, column, stretch = rng.random(3)
        # distance from the middle of the spot, in radii; the spot is an ellipse
        away = np.hypot((u - column * width) * (0.7 + 0.6 * stretch), v - row * height) / (size * height)
        clear *= 1 - np.clip(1.5 - away, 0, 1)  # dense up to half a radius; fades until one and a half
    places = np.flatnonzero(clear < 1)
    clear = clear.reshape(-1)[places]  # of the dirty pixels alone
    # a dirty pixel becomes clear × itself + _DIM (1 − clear) × the blurred image, which `_blur_coarse` has on a coarser
    # grid with a border of one pixel; here the place of each dirty pixel on it, for bilinear interpolation
    rows, columns = (-(-n // _blur_scale(size, height)) for n in (height, width))  # of that grid, rounded up
    # pixel n has its middle at n + 0.5; on the grid, half a pixel is subtracted again and the border adds 1: + 0.5
    y, x = (places // width + 0.5) * (rows / height) + 0.5, (places % width + 0.5) * (columns / width) + 0.5
    down, across = y % 1, x % 1  # from the upper left one of the four pixels around that place
    shares = np.stack([(1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across], axis=1)
    return _Dirt(
        places=places.astype(np.int32),
        clear=clear,
        corners=(y.astype(np.int32) * (columns + 2) + x.astype(np.int32)).astype(np.int32),
        shares=(_DIM * (1 - clear)[:, None] * shares).astype(np.float32),
        width=columns + 2,
    )


@dataclass(frozen=True, kw_only=True)
class DepthNoise(TimedFault):
    """Noise of depth beside the part's own.

    Attributes:
        noise_per_m: Standard deviation over the square of the depth.
        noise_correlation_px: Its correlation length.
    """

    sample_types = (Depth,)
    noise_per_m: Annotated[Number, Field(ge=0, le=0.2)] = 0.01
    noise_correlation_px: Annotated[Number, Field(ge=1, le=32)] = 4.0

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The depth image with added noise; pixels without depth stay without."""
        depth = depth_field(arrival)
        height, width = depth.shape
        grid = (round(height / self.noise_correlation_px) + 1, round(width / self.noise_correlation_px) + 1)
        coarse = event.rng(arrival.taken_ns).standard_normal(grid, np.float32)
        # deviates on a coarse grid, interpolated: correlated over `noise_correlation_px`, then scaled to unit variance
        noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
        noisy = depth + np.float32(self.noise_per_m) / noise.std() * depth**2 * noise
        return (arrival.with_values(depth=np.maximum(noisy, 0.0).astype(np.float32)),)


@dataclass(frozen=True, kw_only=True)
class Darkness(TimedFault):
    """The light goes out: colour images show what is left of it below their read noise; active depth measures on.

    Attributes:
        light: Share of the light that is left.
        noise: Standard deviation of the read noise, grey levels.
    """

    sample_types = (Image,)
    light: Annotated[Number, Field(ge=0, le=1)] = 0.0
    noise: Annotated[Number, Field(ge=0, le=50)] = 1.0

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The image in the dark, with new noise in each."""
        pixels = image_field(arrival)[1]
        noise = event.rng(arrival.taken_ns).standard_normal(pixels.shape, np.float32)
        dark = np.rint(self.light * pixels.astype(np.float32) + self.noise * (1.0 + noise))
        return (arrival.with_values(pixels=np.clip(dark, 0, 255).astype(np.uint8)),)


@dataclass(frozen=True, kw_only=True)
class HighView(TimedFault):
    """A camera that is pitched too high: only the upper rows of the depth image show ground within range.

    Attributes:
        share: Share of the pixels within range that those rows hold.
        range_m: Range.
    """

    sample_types = (Depth,)
    share: Annotated[Number, Field(ge=0.01, le=1)] = 0.2
    range_m: Annotated[Number, Field(ge=0.1, le=50)] = 4.5

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The depth image without its lower rows."""
        depth = depth_field(arrival).copy()
        # number of pixels within range from the top down to each row
        in_range = ((depth > 0.0) & (depth < self.range_m)).sum(axis=1).cumsum()
        first_hidden = int(np.searchsorted(in_range, self.share * in_range[-1]))  # row from which on depth is missing
        depth[first_hidden:] = 0.0
        return (arrival.with_values(depth=depth),)


@dataclass(frozen=True, kw_only=True)
class PasserBy(TimedFault):
    """A person in bright clothes who moves to and fro close to the camera, in colour and depth.

    Attributes:
        share: Share of the image that the person covers.
        distance_m: Depth of the middle of the person.
        motion_hz: Frequency of the motion.
    """

    common_to = "housing"
    sample_types = IMAGES
    share: Annotated[Number, Field(ge=0.01, le=0.9)] = 0.3
    distance_m: Annotated[Number, Field(ge=0.3, le=20)] = 1.2
    motion_hz: Annotated[Number, Field(ge=0.01, le=5)] = 0.15

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The image with the person in it."""
        name, image = image_field(arrival)
        height, width, *channels = image.shape
        # the person is an ellipse of area π `_SLIM` `tall`²: shift from the middle, and half height, both in pixels
        aside = round(_WAY * width * math.sin(2e-9 * math.pi * self.motion_hz * arrival.taken_ns))
        tall = math.sqrt(self.share * height * width / (math.pi * _SLIM))
        v, u = np.mgrid[:height, :width].astype(np.float32)
        # (H, W) squared distance from the middle of the person: 0 there, 1 on the outline
        out = ((u - width / 2 - aside) / (_SLIM * tall)) ** 2 + ((v - height / 2) / tall) ** 2
        clothes = np.roll(_draw_clothes(event, image.shape), aside, axis=1)  # they move with the person
        person = (self.distance_m + _ROUND_M * out).astype(np.float32) if is_depth(image) else clothes
        cover = (out < 1.0).reshape(height, width, *(1 for _ in channels))  # pixels of the person, all channels alike
        return (arrival.with_values(**{name: np.where(cover, person, image)}),)


@lru_cache(maxsize=16)
def _draw_clothes(event: Event, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """(height, width, ...) image of clothes: random coloured patches on larger coloured fields."""
    height, width, *channels = shape
    # large fields on a grid of 8 by 8 cells, and patches on cells of about 6 pixels; each has random colours
    grids = ((8, 8), (height // 6 + 1, width // 6 + 1))
    coarse, fine = (event.rng().integers(30, 120, (*grid, *channels), np.uint8) for grid in grids)
    fields, patches = (cv2.resize(x, (width, height), interpolation=cv2.INTER_NEAREST) for x in (coarse, fine))
    return np.asarray(fields + patches, np.uint8)  # below 240, so that the sum does not overflow


@dataclass(frozen=True, kw_only=True)
class MirrorFloor(TimedFault):
    """A level floor at height 0 that mirrors in blotches: there depth is missing, or that of the mirrored ceiling.

    It needs the true path of the camera's IMU among the items, before each image or with its chunk. In scenario files
    `blotch_m` is `blotch_mm`, whose limits are in mm.

    Attributes:
        holes: Share of the floor without depth.
        mirrored: Share of the floor with the depth of the ceiling.
        ceiling_m: Height of the ceiling.
        blotch_m: Size of a blotch.
    """

    sample_types = (Depth,)
    holes: Annotated[Number, Field(ge=0, le=0.5)] = 0.3
    mirrored: Annotated[Number, Field(ge=0, le=0.5)] = 0.12
    ceiling_m: Annotated[Number, Field(ge=1, le=20)] = 2.4
    blotch_m: Annotated[Number, Field(ge=10, le=2000, alias="blotch_mm"), MILLIMETRES] = 0.12

    def truth_topic(self, event: Event) -> str:
        """The true path of the camera's IMU."""
        return f"/truth{_camera(event).imu_topic}/odometry"

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals with mirrored floors during events; images without a true pose pass unchanged.

        `memory["truth"]` are the true poses of the camera's IMU, which `arrivals` collects; only the last ones are
        kept.
        """
        for arrival in stream:
            event, truth = active_event(events, arrival), memory.get("truth")
            if event is None or not truth:
                yield arrival
                continue
            del truth[:-_MEMORY]
            # the true pose nearest in time to the image
            pose = min(truth, key=lambda s: abs(s.t_ns - arrival.taken_ns))
            yield arrival.with_values(depth=self._mirror(depth_field(arrival), pose, event))

    def _mirror(self, depth: NDArray[np.float32], pose: Odometry, event: Event) -> NDArray[np.float32]:
        """(H, W) m, depth image of a mirroring floor; 0 without a reading.

        A pixel counts as floor if its depth is within `_FLAT` of that of the plane z = 0. The floor is divided into
        cells. Pixels in cells of high rank lose their depth. Pixels in cells of low rank get the depth of the ceiling's
        mirror image, z (h_eye + h_ceiling) / h_eye.

        Args:
            depth: (H, W) m, exact depth image.
            pose: True pose of the camera's IMU, nearest in time.
            event: The event, which draws the ranks.
        """
        camera = _camera(event)
        # (4, 4) camera to IMU, from the two mounts on their common body
        T_imu_camera = np.linalg.inv(event.rig.imu(camera.imu_topic).mount.T_body_sensor) @ camera.mount.T_body_sensor
        from scipy.spatial.transform import Rotation  # slow to import, seldom used

        R = Rotation.from_quat(pose.q_world_frame, scalar_first=True).as_matrix()  # IMU to world
        # position of the camera, m, and (H, W, 3) rays of depth 1, both in the world
        eye, rays = pose.p_frame_in_world + R @ T_imu_camera[:3, 3], _rays(camera) @ (R @ T_imu_camera[:3, :3]).T
        # depth at which each ray meets the plane z = 0; inf for rays that fall by less than `_FLAT` per metre of depth
        floor = np.where(rays[..., 2] < -_FLAT, eye[2] / -np.minimum(rays[..., 2], -_FLAT), np.inf)
        # (H, W, 2) m, where the rays meet the floor; there, the cells, half a blotch wide, whose pattern repeats
        xy = eye[:2] + np.where(np.isfinite(floor), floor, 0.0)[..., None] * rays[..., :2]
        ranks = _draw_shine_ranks(event)
        cells = np.floor(xy / (0.5 * self.blotch_m)).astype(int) % len(ranks)
        rank, on_floor = ranks[cells[..., 0], cells[..., 1]], np.abs(depth - floor) < _FLAT * floor
        mirrored = depth * (eye[2] + self.ceiling_m) / eye[2]
        is_hole, is_mirror = on_floor & (rank > 1 - self.holes), on_floor & (rank < self.mirrored)
        depth = np.select([is_hole, is_mirror], [0, mirrored], depth)
        return np.where(depth > _LONGEST_M, 0.0, depth).astype(np.float32)


def _camera(event: Event) -> CameraCalibration:
    """Calibration of the depth camera of an event."""
    return next(c for c in event.rig.cameras.values() if c.depth_topic == event.topic)


@lru_cache(maxsize=4)
def _rays(camera: CameraCalibration) -> Array:
    """(H, W, 3) ray of each pixel in the optical frame, of depth 1: K⁻¹ (u, v, 1)."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.K).T


@lru_cache(maxsize=4)
def _draw_shine_ranks(event: Event) -> Array:
    """(256, 256) rank, 0-1, of each cell of the floor among all; neighbours are alike."""
    shine = cv2.GaussianBlur(event.rng().standard_normal((256, 256)), (0, 0), 1.0)
    ranks = shine.ravel().argsort().argsort()  # sorting the order of the values gives the rank of each, from 0 on
    return (ranks / shine.size).reshape(shine.shape)
