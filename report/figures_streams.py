"""Small multiples: a few seconds of every scalar sensor stream of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.report.svg import Plot, data_range
from stridetwin.scenarios.metadata import InjectedFault, injected_faults
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

_COLORS = ("#0b6bcb", "#d9480f", "#2b8a3e", "#7048a8")
_SPOILED = "#dc354526"
_DEG = 180.0 / np.pi
WINDOW_S = 6.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves:
    """What to draw of one stream.

    Attributes:
        title: Such as `foot_l/imu: angular rate, °/s`.
        values: (N, K) values.
        labels: K names.
    """

    title: str
    values: Array
    labels: tuple[str, ...]


def curves_of(block: Block[Sample]) -> list[Curves]:
    """The curves of one stream, in the units of a report; none for images."""
    name, c = block.topic.strip("/"), block.columns
    xyz = ("x", "y", "z")
    kind = block.kind
    if kind is Imu:
        return [
            Curves(title=f"{name}: angular rate, °/s", values=c["angular_rate"] * _DEG, labels=xyz),
            Curves(title=f"{name}: specific force, m/s²", values=c["specific_force"], labels=xyz),
        ]
    if kind is Ahrs:
        euler = Rotation.from_quat(c["q_world_sensor"], scalar_first=True).as_euler("ZYX", degrees=True)
        return [Curves(title=f"{name}: attitude, °", values=euler, labels=("yaw", "pitch", "roll"))]
    if kind is Insole:
        return [Curves(title=f"{name}: force, N", values=c["force"], labels=("heel", "lateral", "medial", "toe"))]
    if kind is Interaction:
        return [Curves(title=f"{name}: force, N", values=c["force"], labels=("front", "back"))]
    if kind is Range:
        return [Curves(title=f"{name}: range, m", values=c["distance"][:, None], labels=("",))]
    if kind is Encoder:
        return [Curves(title=f"{name}: angle, °", values=c["angle"][:, None] * _DEG, labels=("",))]
    if kind is Actuator:
        torques = np.column_stack([c["torque_command"], c["torque"]])
        return [Curves(title=f"{name}: torque, N m", values=torques, labels=("command", "measured"))]
    return []


def stream_figures(recording: Recording, topics: list[str], window: tuple[float, float]) -> list[str]:
    """One small plot for each curve of each topic, over the same window, s; injected faults are shaded."""
    figures, faults = [], injected_faults(recording.metadata)
    for topic in topics:
        block = recording.block(topic)
        t = block.t_ns * 1e-9
        inside = (t >= window[0]) & (t <= window[1])
        if inside.sum() < 2:
            continue
        for curves in curves_of(block):
            values = curves.values[inside]
            plot = Plot(width=380, height=180, x=window, y=data_range(values), title=curves.title)
            _shade(plot, [f for f in faults if f.topic == topic])
            for k, label in enumerate(curves.labels):
                plot.line(t[inside], values[:, k], _COLORS[k], label=label, stroke=1.2)
            figures.append(f"<figure><figcaption>{curves.title}</figcaption>{plot.svg()}</figure>")
    return figures


def _shade(plot: Plot, faults: list[InjectedFault]) -> None:
    """Shades the times of faults, and names each kind where it first appears."""
    (left, right), (low, high) = plot.x, plot.y
    least, first = 0.004 * (right - left), dict[str, float]()
    for fault in faults:
        begin, end = max(fault.from_s, left), min(max(fault.until_s, fault.from_s + least), right)
        if begin < end:
            plot.band([begin, end], [low, low], [high, high], _SPOILED)
            first.setdefault(fault.kind, begin)
    for i, (kind, begin) in enumerate(first.items()):
        plot.note(begin, high - (0.08 + 0.1 * i) * (high - low), f" {kind}", anchor="start")


def scalar_topics(recording: Recording) -> list[str]:
    """The sensor topics without images, the feet's first."""
    kinds = {t: info.kind for t, info in recording.topics.items() if not t.startswith("/truth/")}
    return sorted((t for t, kind in kinds.items() if kind not in (Image, Depth)), key=_by_place)


def _by_place(topic: str) -> tuple[int, str]:
    """Feet first, then the head, then the exoskeleton."""
    place = topic.split("/")[1]
    order = next((i for i, p in enumerate(("foot", "head", "chest", "exo")) if place.startswith(p)), 9)
    return order, topic
