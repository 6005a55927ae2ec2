"""Small multiples: a few seconds of every scalar sensor stream of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import FOOT_NAMES
from stridetwin.pages.plot import ERROR, PALETTE, Plot, data_range, faint
from stridetwin.scenarios.metadata import InjectedFault, read_injected_faults
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import (
    Actuator,
    Ahrs,
    Array,
    Block,
    Depth,
    Encoder,
    Image,
    Imu,
    Insole,
    Interaction,
    Range,
    Sample,
)

_DEG = 180.0 / np.pi  # from radians to degrees
WINDOW_S = 6.0  # seconds of each stream that a report shows


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves:
    """What to draw of one stream.

    Attributes:
        title: Such as `Left foot IMU: angular rate, °/s`.
        values: (N, K) values of K curves at N instants, in the unit that the title names.
        labels: Names of the K curves.
    """

    title: str
    values: Array
    labels: tuple[str, ...]


# names of sensors in titles, where they differ from the last part of the topic
_SENSOR_NAMES = {"imu": "IMU", "ahrs": "AHRS", "interaction": "cuff", "actuator": "motor"}
_XYZ = ("x", "y", "z")
_CURVES: Mapping[type[Sample], tuple[tuple[str, tuple[str, ...], float, tuple[str, ...]], ...]] = {
    Imu: (
        ("angular rate, °/s", ("angular_rate",), _DEG, _XYZ),
        ("specific force, m/s²", ("specific_force",), 1.0, _XYZ),
    ),
    Insole: (("force, N", ("force",), 1.0, ("heel", "lateral", "medial", "toe")),),
    Interaction: (("force, N", ("force",), 1.0, ("front", "back")),),
    Range: (("range, m", ("distance",), 1.0, ("",)),),
    Encoder: (("angle, °", ("angle",), _DEG, ("",)),),
    Actuator: (("torque, N m", ("torque_command", "torque"), 1.0, ("command", "measured")),),
}
"""Quantity and unit, columns, factor to the unit, and labels of each figure, by kind of sample."""


def curves_of(block: Block[Sample]) -> list[Curves]:
    """The curves of one stream of small samples, in the units of a report; none for kinds that have no figure."""
    name = describe_topic(block.topic)
    if block.kind is Ahrs:
        attitudes = Rotation.from_quat(block.columns["q_world_sensor"], scalar_first=True)
        euler = attitudes.as_euler("ZYX", degrees=True)
        return [Curves(title=f"{name}: attitude, °", values=euler, labels=("yaw", "pitch", "roll"))]
    stream_curves = []
    for quantity, columns, factor, labels in _CURVES.get(block.kind, ()):
        values = np.column_stack([block.columns[column] for column in columns]) * factor  # (N, K)
        stream_curves.append(Curves(title=f"{name}: {quantity}", values=values, labels=labels))
    return stream_curves


def describe_topic(topic: str) -> str:
    """The sensor behind a topic, such as `Left foot IMU` or `Exoskeleton, right knee encoder`."""
    *places, sensor = topic.strip("/").split("/")
    names = [_describe_place(place) for place in places]  # such as `exoskeleton` and `right knee`
    text = f"{', '.join(names)} {_SENSOR_NAMES.get(sensor, sensor.replace('_', ' '))}".strip()
    return text[:1].upper() + text[1:]


def _describe_place(place: str) -> str:
    """A part of a topic that says where a sensor is, such as `left thigh` for `thigh_l`."""
    name, _, side = place.rpartition("_")
    if side in FOOT_NAMES and name:
        return f"{FOOT_NAMES[side]} {name.replace('_', ' ')}"
    return "exoskeleton" if place == "exo" else place.replace("_", " ")


def stream_figures(recording: Recording, topics: list[str], window: tuple[float, float]) -> list[Markup]:
    """Draws some seconds of every stream, one small figure per quantity; injected faults are shaded.

    Args:
        recording: The walk.
        topics: Streams without images.
        window: First and last time, s.
    """
    figures = []
    faults = read_injected_faults(recording.metadata)
    for topic in topics:
        block = recording.block(topic)
        t = block.t_ns * 1e-9
        inside = (t >= window[0]) & (t <= window[1])
        if inside.sum() < 2:  # a single sample gives no curve
            continue
        for curves in curves_of(block):
            values = curves.values[inside]
            quantity = curves.title.split(": ", 1)[1]  # with its unit, such as `force, N`
            span = data_range(values)
            plot = Plot(
                title=curves.title, x=window, y=span, x_label="time, s", y_label=quantity, height=220, hover="x"
            )
            _shade_faults(plot, [f for f in faults if f.topic == topic], window, span)
            for column, label, color in zip(values.T, curves.labels, PALETTE):
                plot.line(t[inside], column, color, label=label, width=1.2)
            figures.append(plot.html())
    return figures


def _shade_faults(
    plot: Plot, faults: list[InjectedFault], window: tuple[float, float], span: tuple[float, float]
) -> None:
    """Shades the times of faults within the window; the legend names their kinds.

    Args:
        plot: The figure.
        faults: Faults of the stream.
        window: First and last time of the figure, s.
        span: Lower and upper end of the figure's y axis.
    """
    # a very short fault is drawn wide enough to be seen
    first_s, last_s = window
    least_s = 0.004 * (last_s - first_s)
    for fault in faults:
        begin = max(fault.from_s, first_s)
        end = min(max(fault.until_s, fault.from_s + least_s), last_s)
        if begin < end:
            plot.bars(begin, end, *span, faint(ERROR), label=f"fault: {fault.kind}")


def scalar_topics(recording: Recording) -> list[str]:
    """The sensor topics without images and without joints that have no motor, the feet's first."""
    kinds = {t: info.kind for t, info in recording.topics.items() if not t.startswith("/truth/")}
    sensors = recording.rig.others if recording.has_rig else {}
    # an actuator without a torque limit is a joint that only measures
    without_motor = {t for t, s in sensors.items() if s.kind == "actuator" and "torque_max_nm" not in s.parameters}
    topics = [t for t, kind in kinds.items() if kind not in (Image, Depth) and t not in without_motor]
    return sorted(topics, key=_by_place)


def _by_place(topic: str) -> tuple[int, str]:
    """Sort key of topics: feet first, then head, chest, exoskeleton and others, each by name."""
    places = ("foot", "head", "chest", "exo")
    place = topic.split("/")[1]  # such as `foot_l`
    order = next((i for i, beginning in enumerate(places) if place.startswith(beginning)), len(places))
    return order, topic
