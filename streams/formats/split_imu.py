"""IMUs that a driver publishes as two streams, one per sensor (RealSense: `gyro/sample` and `accel/sample`)."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from stridetwin.streams.recording.imported import Notes
from stridetwin.streams.recording.topic_reader import increasing
from stridetwin.streams.samples import Array, Block, Imu

_GYRO = re.compile(r"gyro(?:/sample)?", re.IGNORECASE)
_JOINED = "imu"


def joined(blocks: dict[str, Block[Any]], notes: Notes) -> dict[str, Block[Any]]:
    """The streams with such pairs joined: the force is interpolated to the stamps of the rate.

    Args:
        blocks: Streams by topic.
        notes: Collects a warning per pair.
    """
    result = dict(blocks)
    for topic, gyro in blocks.items():
        other = _GYRO.sub(lambda m: m[0].replace("gyro", "accel").replace("Gyro", "Accel"), topic)
        accel = blocks.get(other)
        if other == topic or accel is None or gyro.kind is not Imu or accel.kind is not Imu:
            continue
        if gyro.columns["specific_force"].any() or accel.columns["angular_rate"].any() or len(accel) < 2:
            continue
        name = joined_name(topic)
        del result[topic], result[other]
        result[name] = joined_at_rates(name, gyro, accel)
        notes.warn(f"{topic} and {other} are joined as {name}, the force interpolated to the stamps of the rate")
    return result


def joined_name(topic: str) -> str:
    """Topic of the IMU that a gyroscope's stream is a part of."""
    return _GYRO.sub(_JOINED, topic)


def joined_at_rates(name: str, gyro: Block[Imu], accel: Block[Any]) -> Block[Imu]:
    """One IMU from two streams, with the force interpolated to those stamps of the rate that are within its own.

    Args:
        name: Topic of the IMU.
        gyro: Stream whose rates are used.
        accel: Stream whose forces are used; at least two samples.
    """
    order = increasing(accel.t_ns, -1)
    t, force = accel.t_ns[order], accel.columns["specific_force"][order]
    within = (gyro.t_ns >= t[0]) & (gyro.t_ns <= t[-1])
    since: Array = (gyro.t_ns[within] - t[0]) * 1e-9
    known: Array = (t - t[0]) * 1e-9
    columns = {
        "angular_rate": gyro.columns["angular_rate"][within],
        "specific_force": np.column_stack([np.interp(since, known, force[:, k]) for k in range(3)]),
    }
    return Block(topic=name, kind=Imu, t_ns=gyro.t_ns[within], columns=columns)
