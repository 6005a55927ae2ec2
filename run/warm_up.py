"""Synthetic samples on which an estimator compiles its functions before the first real sample arrives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.live import messages
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Ahrs, Depth, Encoder, Image, Imu, Insole, Range, Sample

_SECONDS, _HZ, _IMAGES_HZ = 6.0, 100.0, 4.0
"""Long enough to fill an odometry's window: at rest it keeps one image every 0.4 s, ten in all."""
_TREMOR_S, _TREMOR = 0.6, np.array([0.0, 0.0, 0.3])  # rad/s, at first: an odometry starts differently at rest
_WIDTH, _HEIGHT, _FOCAL = 640, 480, 380.0  # px, of all cameras
_SQUARES = 6, 9  # columns and rows of a board
_EYE_HEIGHT_M, _WALL_M = 1.6, 4.0  # above the floor; distance of the wall that ends the view
_STAIR_M, _RISER_M, _TREAD_M, _RISERS = 1.5, 0.17, 0.3, 5  # distance of the stair, its sizes and number of risers
_AXES = {
    "head": ((0.0, -1.0, 0.0), (-0.6, 0.0, -0.8), (0.8, 0.0, -0.6)),
    "foot_l": ((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
    "foot_r": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
}
"""Right, down and forward axes of each camera in the body's frame; the boards beside the shoe cameras have the same."""


def synthetic_rig() -> Rig:
    """The rig of the synthetic samples.

    The head has an IMU and a camera; each shoe has an IMU, a sonar, a board and a camera that faces the other's board.
    """
    imus, cameras, boards, others = {}, {}, {}, {}
    for body, axes in _AXES.items():
        T_body_sensor = np.eye(4)  # the columns of the rotation are the camera's axes; IMUs have the body's axes
        T_body_sensor[:3, :3] = np.transpose(axes)
        mount, on_head = Mount(body=body, T_body_sensor=T_body_sensor), body == "head"
        imu = ImuCalibration(
            topic=f"/{body}/imu",
            part="",
            rate_hz=_HZ,
            mount=Mount(body=body),
            gyroscope_noise_density=2e-4,
            gyroscope_random_walk=5e-6,
            accelerometer_noise_density=1e-3,
            accelerometer_random_walk=4e-5,
        )
        camera = CameraCalibration(
            topic="/head/color" if on_head else f"/{body}/camera",
            part="",
            rate_hz=30.0,
            mount=mount,
            width=_WIDTH,
            height=_HEIGHT,
            intrinsics=(_FOCAL, _FOCAL, (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2),
            depth_topic="/head/depth" if on_head else "",
        )
        imus[imu.topic], cameras[camera.topic] = imu, camera
        if not on_head:
            boards[body] = Board(name=body, mount=mount, squares=_SQUARES, square_m=0.005)
            sonar = OtherSensor(
                topic=f"/{body}/sonar",
                kind="range",
                part="",
                rate_hz=_HZ,
                mount=Mount(body=body),
                parameters={"range_min_m": 0.03, "range_max_m": 6.0, "range_step_m": 0.01, "range_sd_m": 0.01},
            )
            others[sonar.topic] = sonar
    return Rig(imus=imus, cameras=cameras, boards=boards, others=others)


def synthetic_samples(takes: Mapping[str, type[Sample]]) -> Iterator[Sample]:
    """Yields six seconds of a person who stands in front of a stair, in time order, for compiling an estimator.

    The samples are encoded and decoded as messages, because kernels are compiled for the memory layout of arrays.

    Args:
        takes: The kind of sample by topic; IMU and camera topics are those of `synthetic_rig`.
    """
    encoder, decoders = messages.MessageEncoder(synthetic_rig()), dict[str, messages.MessageDecoder]()
    for synthetic in _samples(takes):
        message = encoder.encode(synthetic)
        decoder = decoders.setdefault(message.topic, messages.MessageDecoder(message.topic, message.typename))
        if (sample := decoder.decode(message)) is not None:  # None if a number is not finite
            yield sample


def write_synthetic_recording(
    path: Path,
    takes: Mapping[str, type[Sample]],
    metadata: Mapping[str, str] | None = None,
    more: Iterable[Sample] = (),
) -> Recording:
    """Writes the samples of `synthetic_samples` as a recording.

    Args:
        path: Output file, `.mcap`.
        takes: The kind of sample by topic.
        metadata: Of the recording.
        more: Samples of other topics.
    """
    samples = list(synthetic_samples(takes))
    with RecordingWriter(path, _with_image_rates(synthetic_rig(), samples), metadata) as writer:
        for sample in chain(samples, more):
            writer.write(sample)
    return Recording(path)


def _with_image_rates(rig: Rig, samples: Sequence[Sample]) -> Rig:
    """The rig with the rates at which the synthetic images come, because a recording is checked against its rig."""
    seconds = samples[-1].t_ns * 1e-9  # the samples begin at 0
    counts = Counter(sample.topic for sample in samples)
    cameras = {
        topic: replace(camera, rate_hz=max(counts[topic], counts[camera.depth_topic], 1) / seconds)
        for topic, camera in rig.cameras.items()
    }
    return replace(rig, cameras=cameras)


def _samples(takes: Mapping[str, type[Sample]]) -> Iterator[Sample]:
    """Yields the synthetic samples in time order, not yet as decoded from messages.

    The values of each kind are constant, except that IMUs tremble at first. Kinds without such values are left out.

    Args:
        takes: The kind of sample by topic.
    """
    # with depth the camera is that of the head, in colour; else it is a shoe's, which sees a board
    pixels, depth = _draw_blobs() if Depth in takes.values() else _draw_board(), _draw_stair_depths()
    rates = {topic: _IMAGES_HZ if kind in (Image, Depth) else _HZ for topic, kind in takes.items()}
    # time (ns), topic and number of every sample
    due = ((round(1e9 * (i + 1) / hz), topic, i) for topic, hz in rates.items() for i in range(int(_SECONDS * hz)))
    constant: dict[type[Sample], dict[str, Any]] = {
        Image: {"pixels": pixels},
        Depth: {"depth": depth},
        Imu: {"specific_force": np.array([0.0, 0.0, NOMINAL_GRAVITY_MPS2])},
        Ahrs: {"q_world_sensor": np.array([1.0, 0.0, 0.0, 0.0]), "angular_rate": np.zeros(3)},
        Encoder: {"angle": 0.0},
        Insole: {"force": np.array([200.0, 100.0, 100.0, 20.0])},
        Range: {"distance": 0.2},
    }
    for t_ns, topic, i in sorted(due):
        kind: Any = takes[topic]
        # the rate of an IMU changes its sign from sample to sample, and is 0 after `_TREMOR_S`
        tremor = {"angular_rate": _TREMOR * (-1) ** i * (t_ns < _TREMOR_S * 1e9)} if kind is Imu else {}
        if kind in constant:
            yield kind(topic=topic, t_ns=t_ns, **constant[kind], **tremor)


def _draw_board() -> NDArray[np.uint8]:
    """An image (H, W) of the other shoe's board, as either shoe camera sees it from 0.2 m.

    A square has 9 pixels, a white margin of one square is around the board, and the rest is grey. The board's columns
    run against those of the image, as it faces the camera.
    """
    columns, rows = _SQUARES
    # a dark square where row and column add up to an even number; then a margin of one square on each side
    dark = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    squares = np.pad(np.where(dark, 30, 220).astype(np.uint8)[:, ::-1], 1, constant_values=220)
    board = np.kron(squares, np.ones((9, 9), np.uint8))
    grey = np.full((_HEIGHT, _WIDTH), 128, np.uint8)
    top, left = (_HEIGHT - len(board)) // 2, (_WIDTH - len(board[0])) // 2
    grey[top : top + len(board), left : left + len(board[0])] = board
    return cv2.GaussianBlur(grey, (0, 0), 0.7).astype(np.uint8)


def _draw_blobs() -> NDArray[np.uint8]:
    """A colour image (H, W, 3) of smooth blobs: among equal pixels, a corner detector finds no maximum."""
    blobs = np.random.default_rng(0).integers(40, 215, (_HEIGHT // 8, _WIDTH // 8), np.uint8)
    return np.repeat(cv2.resize(blobs, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_CUBIC)[..., None], 3, axis=2)


def _draw_stair_depths() -> NDArray[np.float32]:
    """Depth (H, W) m of a floor and a stair, seen by the head's camera.

    All pixels of a row see the same depth, as nothing changes sideways: a ray per row is followed until it meets the
    ground.
    """
    _, down, forward = _AXES["head"]  # each has x (forward) and z (up) in the body's frame at 0 and 2
    rows = (np.arange(_HEIGHT) - (_HEIGHT - 1) / 2) / _FOCAL  # (H,) downward slope of each row's ray in the camera
    # (H,) by how much a ray goes forward and up, for a depth of 1
    ahead, rise = rows * down[0] + forward[0], rows * down[2] + forward[2]
    x = np.arange(0.0, _WALL_M, 0.005)
    # height of the ground at distances x, m; the wall at the end stops every ray
    ground = _RISER_M * np.clip(np.ceil((x - _STAIR_M) / _TREAD_M), 0, _RISERS)
    ground[-1] = np.inf
    # (H,) distance at which each ray first is below the ground, m
    hit = x[np.argmax(_EYE_HEIGHT_M + np.outer(rise / ahead, x) <= ground, axis=1)]
    return np.repeat((hit / ahead).astype(np.float32)[:, None], _WIDTH, axis=1)
