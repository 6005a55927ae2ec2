"""The mapped ground in a Rerun file."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

from stridetwin.outputs.terrain.grid import CLASS_COLORS, CLASS_NAMES, GROUND_CLASSES
from stridetwin.outputs.terrain.snapshots import Snapshot

if TYPE_CHECKING:
    from rerun import RecordingStream

GROUND = "world/ahead"
_INK = (15, 28, 46)
_ABOVE_M = 0.01
"""How far lines lie above the ground, so that they are seen."""


def log_ground(rerun: ModuleType, stream: RecordingStream, snapshots: Sequence[Snapshot]) -> None:
    """Logs the ground over time, `world/ahead/{ground,planes,edges}`, with a colour per class."""
    classes = [
        rerun.AnnotationInfo(id=i, label=CLASS_NAMES.get(name, name), color=CLASS_COLORS[i])
        for i, name in enumerate(GROUND_CLASSES)
    ]
    stream.log(GROUND, rerun.AnnotationContext(classes), static=True)
    for snapshot in snapshots:
        stream.set_time("time", duration=snapshot.t_ns * 1e-9)
        points = rerun.Points3D(snapshot.points, class_ids=snapshot.classes, radii=[0.02])
        stream.log(f"{GROUND}/ground", points)
        outlines = [line for line, _ in snapshot.planes]
        colors = [CLASS_COLORS[ground_class] for _, ground_class in snapshot.planes]
        stream.log(f"{GROUND}/planes", rerun.LineStrips3D(outlines, colors=colors, radii=[0.006]))
        edges = [line + [0.0, 0.0, _ABOVE_M] for line in snapshot.edges]
        stream.log(f"{GROUND}/edges", rerun.LineStrips3D(edges, colors=[_INK], radii=[0.012]))
