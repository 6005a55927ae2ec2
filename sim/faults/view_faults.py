"""Faults of what a camera sees: worse depth, a view that is pitched too high, a passer-by, a floor like a mirror."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.sim.faults.faults import IMAGES, Arrival, Event, EventsOfTopic, Memory, Stream, StreamFault, at
from stridetwin.sim.faults.image_faults import image_of, is_depth
from stridetwin.sim.parts.kinds import RgbdPart
from stridetwin.sim.parts.library import part_described_by
from stridetwin.streams.fields import number
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Depth, Odometry

_SLIM, _WAY = 0.5, 0.3  # a person's half width over half height; amplitude of the motion over the image's width
_ROUND_M = 0.12  # depth of a body, from its middle to its outline
_FLAT = 0.05  # share of its distance within which a depth pixel belongs to the floor
_LONGEST_M = 6.0  # beyond which the mirror image has no depth


@dataclass(frozen=True, kw_only=True)
class DepthNoise(StreamFault):
    """Depth with more noise than the part's, correlated between pixels like the part's.

    Attributes:
        factor: Standard deviation of the noise over the part's.
    """

    kind = "depth_noise"
    fits = (Depth,)
    factor: Annotated[float, number(1, 20)] = 3.0

    def suits(self, stream: Stream) -> bool:
        """Whether the noise of the part is known."""
        return stream.kind in self.fits and isinstance(part_described_by(stream.part), RgbdPart)

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The depth image with added noise; pixels without depth stay without."""
        camera = part_described_by(event.part)
        assert isinstance(camera, RgbdPart)
        assert isinstance(arrival.item, Depth)
        depth, alike = arrival.item.depth, camera.depth.noise_px
        height, width = depth.shape
        coarse = (round(height / alike) + 1, round(width / alike) + 1)
        noise = event.rng(arrival.taken_ns).standard_normal(coarse, np.float32)
        noise = cv2.resize(noise, (width, height), interpolation=cv2.INTER_LINEAR)
        sd = np.float32(math.sqrt(self.factor**2 - 1) * camera.depth.noise / noise.std())
        return (arrival.but(depth=np.maximum(depth + sd * depth**2 * noise, 0.0).astype(np.float32)),)


@dataclass(frozen=True, kw_only=True)
class HighView(StreamFault):
    """A camera that is pitched too high: only the upper rows of the depth image show ground within range.

    Attributes:
        share: Share of the pixels within range that those rows hold.
        range_m: Range.
    """

    kind = "high_view"
    fits = (Depth,)
    share: Annotated[float, number(0.01, 1)] = 0.2
    range_m: Annotated[float, number(0.1, 50)] = 4.5

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The depth image without its lower rows."""
        assert isinstance(arrival.item, Depth)
        depth = arrival.item.depth.copy()
        ground = ((depth > 0.0) & (depth < self.range_m)).sum(axis=1).cumsum()
        depth[int(np.searchsorted(ground, self.share * ground[-1])) :] = 0.0
        return (arrival.but(depth=depth),)


@dataclass(frozen=True, kw_only=True)
class PasserBy(StreamFault):
    """A person in bright clothes who moves to and fro close to the camera, in colour and depth.

    Attributes:
        share: Share of the image that the person covers.
        distance_m: Depth of the middle of the person.
        motion_hz: Frequency of the motion.
    """

    kind = "passer_by"
    common_to = "housing"
    fits = IMAGES
    share: Annotated[float, number(0.01, 0.9)] = 0.3
    distance_m: Annotated[float, number(0.3, 20)] = 1.2
    motion_hz: Annotated[float, number(0.01, 5)] = 0.15

    def corrupted(self, arrival: Arrival, event: Event) -> Iterable[Arrival]:
        """The image with the person in it."""
        name, image = image_of(arrival)
        height, width, *channels = image.shape
        aside = round(_WAY * width * math.sin(2e-9 * math.pi * self.motion_hz * arrival.taken_ns))
        tall = math.sqrt(self.share * height * width / (math.pi * _SLIM))
        v, u = np.mgrid[:height, :width].astype(np.float32)
        out = ((u - width / 2 - aside) / (_SLIM * tall)) ** 2 + ((v - height / 2) / tall) ** 2
        if is_depth(image):
            person = (self.distance_m + _ROUND_M * out).astype(np.float32)
        else:
            person = np.roll(_clothes(event, image.shape), aside, axis=1)
        cover = (out < 1.0).reshape(height, width, *(1 for _ in channels))
        return (arrival.but(**{name: np.where(cover, person, image)}),)


@lru_cache(maxsize=16)
def _clothes(event: Event, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Coloured fields with finer patches on them."""
    (height, width, *channels), rng = shape, event.rng()
    fields, patches = (
        cv2.resize(
            rng.integers(*tones, (*cells, *channels), np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
        )
        for tones, cells in (((60, 180), (8, 8)), ((0, 75), (height // 6 + 1, width // 6 + 1)))
    )
    return np.asarray(fields + patches, np.uint8)


@dataclass(frozen=True, kw_only=True)
class MirrorFloor(StreamFault):
    """A level floor at height 0 that mirrors in blotches: there depth is missing, or that of the mirrored ceiling.

    It needs the true path of the camera's IMU, before each image or with its chunk.

    Attributes:
        holes: Share of the floor without depth.
        mirrored: Share of the floor with the depth of the ceiling.
        ceiling_m: Height of the ceiling.
        blotch_m: Size of a blotch.
    """

    kind = "mirror_floor"
    fits = (Depth,)
    holes: Annotated[float, number(0, 0.5)] = 0.3
    mirrored: Annotated[float, number(0, 0.5)] = 0.12
    ceiling_m: Annotated[float, number(1, 20)] = 2.4
    blotch_m: Annotated[float, number(10, 2000, key="blotch_mm", scale=1e-3)] = 0.12

    def truth_topic(self, event: Event) -> str:
        """The true path of the camera's IMU."""
        return f"/truth{_camera(event).imu_topic}/odometry"

    def through(self, stream: Iterable[Arrival], events: EventsOfTopic, memory: Memory) -> Iterator[Arrival]:
        """As `StreamFault.through`; images without a true pose before them pass unchanged."""
        truth: list[Odometry] = memory.setdefault("truth", [])
        for arrival in stream:
            while len(truth) > 1 and truth[1].t_ns <= arrival.taken_ns:
                truth.pop(0)
            event = at(events, arrival)
            if event is None or not truth or truth[0].t_ns > arrival.taken_ns:
                yield arrival
            else:
                assert isinstance(arrival.item, Depth)
                T_world_imu = _extrapolate(truth[0], 1e-9 * (arrival.taken_ns - truth[0].t_ns))
                yield arrival.but(depth=self._mirror(arrival.item.depth, T_world_imu, event))

    def _mirror(self, depth: NDArray[np.float32], T_world_imu: Array, event: Event) -> NDArray[np.float32]:
        camera = _camera(event)
        T_body_imu = event.rig.imu(camera.imu_topic).mount.T_body_sensor
        T = T_world_imu @ np.linalg.inv(T_body_imu) @ camera.mount.T_body_sensor
        eye, ahead = T[:3, 3], _rays(camera.width, camera.height, camera.intrinsics) @ T[:3, :3].T
        floor = np.where(ahead[..., 2] < -_FLAT, eye[2] / -np.minimum(ahead[..., 2], -_FLAT), np.inf)
        xy = eye[:2] + np.where(np.isfinite(floor), floor, 0.0)[..., None] * ahead[..., :2]
        shine = _shine(event)
        cells = np.floor(xy / (0.5 * self.blotch_m)).astype(int) % len(shine)
        rank, on_floor = shine[cells[..., 0], cells[..., 1]], np.abs(depth - floor) < _FLAT * floor
        depth = np.where(on_floor & (rank > 1.0 - self.holes), 0.0, depth)
        depth = np.where(on_floor & (rank < self.mirrored), depth * (eye[2] + self.ceiling_m) / eye[2], depth)
        return np.where(depth > _LONGEST_M, 0.0, depth).astype(np.float32)


def _camera(event: Event) -> CameraCalibration:
    return next(c for c in event.rig.cameras.values() if c.depth_topic == event.topic)


def _extrapolate(pose: Odometry, dt_s: float) -> Array:
    """(4, 4) pose a moment after a true one."""
    T = np.eye(4)
    rotation = Rotation.from_quat(pose.q_world_frame, scalar_first=True)
    T[:3, :3] = (rotation * Rotation.from_rotvec(dt_s * pose.angular_rate)).as_matrix()
    T[:3, 3] = pose.p_frame_in_world + dt_s * pose.v_frame_in_world
    return T


@lru_cache(maxsize=4)
def _rays(width: int, height: int, intrinsics: tuple[float, float, float, float]) -> Array:
    """(H, W, 3) ray of each pixel in the optical frame, of depth 1."""
    fu, fv, pu, pv = intrinsics
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([(u - pu) / fu, (v - pv) / fv, np.ones_like(u)], axis=-1)


@lru_cache(maxsize=4)
def _shine(event: Event) -> Array:
    """(256, 256) rank, 0-1, of each cell of the floor among all; neighbours are alike."""
    shine = cv2.GaussianBlur(event.rng().standard_normal((256, 256)), (0, 0), 1.0)
    return (shine.ravel().argsort().argsort() / shine.size).reshape(shine.shape)
