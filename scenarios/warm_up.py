"""Samples that nobody measured, on which an estimator compiles what it will need before the first true one comes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Ahrs, Depth, Encoder, Image, Imu, Insole, Range, Sample

_SECONDS, _SMALL_HZ, _PICTURES_HZ = 1.5, 100, 10


def made_up_samples(topics: Sequence[str], rig: Rig) -> Iterator[Sample]:
    """A second and a half of rest before a still picture, in order of time, pictures last.

    Args:
        topics: Those that the estimator takes.
        rig: Its calibration.
    """
    pictures = _pictures(rig)
    kinds = {t: rig.others[t].kind if t in rig.others else t.rpartition("/")[2] for t in topics if t not in pictures}
    for i in range(int(_SECONDS * _SMALL_HZ)):
        t_ns = (i + 1) * 1_000_000_000 // _SMALL_HZ
        for topic, kind in kinds.items():
            if (sample := _small(topic, kind, t_ns)) is not None:
                yield sample
        for topic in topics:
            if topic in pictures and i % (_SMALL_HZ // _PICTURES_HZ) == 0:
                still = pictures[topic]
                if still.dtype == np.uint8:
                    yield Image(topic=topic, t_ns=t_ns, pixels=still)
                else:
                    yield Depth(topic=topic, t_ns=t_ns, depth=still)


def _pictures(rig: Rig) -> dict[str, NDArray[Any]]:
    """What each camera and each depth stream shows: blobs where an odometry looks, plain grey on feet, a floor."""
    shown: dict[str, NDArray[Any]] = {}
    for camera in rig.cameras.values():
        shape = camera.height, camera.width
        blobs = np.random.default_rng(0).integers(40, 215, (shape[0] // 8 + 1, shape[1] // 8 + 1), np.uint8)
        textured = np.kron(blobs, np.ones((8, 8), np.uint8))[: shape[0], : shape[1]]
        on_foot = camera.mount.body.startswith("foot")
        shown[camera.topic] = np.full(shape, 128, np.uint8) if on_foot else np.repeat(textured[..., None], 3, axis=2)
        if camera.depth_topic:
            rows = np.linspace(3.0, 1.5, shape[0], dtype=np.float32)
            shown[camera.depth_topic] = np.repeat(rows[:, None], shape[1], axis=1)
    return shown


def _small(topic: str, kind: str, t_ns: int) -> Sample | None:
    """A small sample of someone who stands; None where nobody knows what the topic carries."""
    match kind:
        case "imu":
            return Imu(topic=topic, t_ns=t_ns, angular_rate=np.zeros(3), specific_force=np.array([0.0, 0.0, 9.81]))
        case "ahrs":
            return Ahrs(topic=topic, t_ns=t_ns, q_world_sensor=np.array([1.0, 0.0, 0.0, 0.0]), angular_rate=np.zeros(3))
        case "encoder":
            return Encoder(topic=topic, t_ns=t_ns, angle=0.0)
        case "insole":
            return Insole(topic=topic, t_ns=t_ns, force=np.array([200.0, 100.0, 100.0, 20.0]))
        case "range":
            return Range(topic=topic, t_ns=t_ns, distance=0.3)
    return None
