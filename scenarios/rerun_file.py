"""A walk as a Rerun file: terrain, paths, cameras, curves and what was seen ahead on one time line."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.scenarios.ahead import Ahead
from stridetwin.scenarios.evaluate import Result, true_frames
from stridetwin.scenarios.figures_path import part_of
from stridetwin.scenarios.figures_streams import curves_of, scalar_topics
from stridetwin.scenarios.ground import Layout, from_metadata
from stridetwin.scenarios.pictures import camera_topics, pictures_of, shown
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import asked_name
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array

_COLORS = {"l": (11, 107, 203), "r": (217, 72, 15), "camera": (95, 61, 196), "truth": (70, 84, 104)}
_GROUND = {"level": (208, 216, 226), "stair": (170, 190, 214), "ramp": (184, 208, 184)}
_PICTURES_HZ, _CURVES_HZ, _POSES_HZ, _PICTURE_WIDTH = 5.0, 50.0, 30.0, 320


def rerun_installed() -> bool:
    """Whether Rerun can be imported."""
    return importlib.util.find_spec("rerun") is not None


def recording_id(recording: Recording) -> str:
    """What the viewer knows a recording by, the same each time: it lays those of one name over each other.

    The digest tells walks apart that differ in more than seed and physics, and imported ones, which have neither.
    """
    metadata = recording.metadata
    spans = {topic: (i.count, i.first_ns, i.last_ns) for topic, i in recording.topics.items()}
    digest = hashlib.sha256(json.dumps([dict(metadata), spans], sort_keys=True).encode()).hexdigest()
    told = (metadata.get("scenario", "walk"), metadata.get("seed", ""), metadata.get("physics", ""))
    return "-".join(["stridetwin", *filter(None, told), digest[:12]])


def write_rerun(path: Path, recording: Recording, results: Sequence[Result], ahead: Ahead | None = None) -> None:
    """Writes the file.

    Args:
        path: File to write, `.rrd`.
        recording: The walk.
        results: Scored estimates.
        ahead: What was seen ahead, or None.

    Raises:
        StrideTwinError: The file cannot be written.
    """
    import rerun as rr

    from stridetwin.scenarios.rerun_ahead import write_ahead

    stream = rr.RecordingStream("stridetwin", recording_id=recording_id(recording))
    try:
        stream.save(path, default_blueprint=_blueprint(recording, results, ahead))
    except RuntimeError as error:
        raise StrideTwinError(f"{asked_name(str(path))}: cannot be written: {error}") from error
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _terrain(rr, stream, from_metadata(recording.metadata))
    _paths(rr, stream, recording, results)
    _curves(rr, stream, recording, results)
    if ahead is not None:
        write_ahead(rr, stream, ahead)
    for topic in camera_topics(recording):
        for picture in pictures_of(recording, topic, _PICTURES_HZ):
            stream.set_time("time", duration=picture.t_ns / 1e9)
            stream.log(f"cameras{topic}", rr.Image(shown(picture, _PICTURE_WIDTH)).compress(jpeg_quality=70))
    stream.flush()
    stream.disconnect()


def _terrain(rr: Any, stream: Any, layout: Layout | None) -> None:
    if layout is None:
        return
    floor = min(min(s.z0, s.z1) for s in layout.slabs) - 0.1
    for i, slab in enumerate(layout.slabs):
        tops = slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
        under = np.column_stack([tops[:, :2], np.full(4, floor)])
        sides = [(under[j], under[k], tops[k], tops[j]) for j, k in ((0, 1), (1, 2), (2, 3), (3, 0))]
        faces = np.array([tops, *sides], dtype=np.float32)
        flat = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        normals = np.cross(flat[1::3] - flat[::3], flat[2::3] - flat[::3])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mesh = rr.Mesh3D(
            vertex_positions=flat,
            vertex_normals=np.repeat(normals, 3, axis=0),
            vertex_colors=np.full((len(flat), 3), _GROUND[slab.terrain], np.uint8),
        )
        stream.log(f"world/terrain/{i:02d}_{slab.terrain}", mesh, static=True)


def _paths(rr: Any, stream: Any, recording: Recording, results: Sequence[Result]) -> None:
    for result in results:
        part, step = part_of(result.estimate), 2
        for kind, path, color in (
            ("truth", result.comparison.truth, _COLORS["truth"]),
            ("estimate", result.comparison.estimate, _COLORS[part]),
        ):
            line = rr.LineStrips3D([path.p_frame_in_world[::step]], colors=[color], radii=[0.004])
            stream.log(f"world/{result.estimate.name}/{kind}", line, static=True)
    for frame in true_frames(recording.topics):
        block = recording.block(f"/truth/{frame}/odometry")
        t, p, q = _thinned(block.t_ns, _POSES_HZ, block.columns["p_frame_in_world"], block.columns["q_world_frame"])
        entity = f"world/truth/{frame}"
        stream.log(entity, rr.TransformAxes3D(0.12), static=True)
        stream.send_columns(
            entity,
            indexes=[rr.TimeColumn("time", duration=t)],
            columns=rr.Transform3D.columns(translation=p, quaternion=q[:, [1, 2, 3, 0]]),
        )


def _curves(rr: Any, stream: Any, recording: Recording, results: Sequence[Result]) -> None:
    for topic in scalar_topics(recording):
        block = recording.block(topic)
        for curves in curves_of(block):
            name = curves.title.rsplit(": ", 1)[1].split(",")[0].replace(" ", "_")
            t, values = _thinned(block.t_ns, _CURVES_HZ, curves.values)
            _send(rr, stream, f"streams{topic}/{name}", t, values, curves.labels)
    for result in results:
        error = np.linalg.norm(result.comparison.error_m, axis=1)[:, None] * 1000.0
        t, values = _thinned(result.comparison.truth.t_ns, _CURVES_HZ, error)
        _send(rr, stream, f"error_mm/{result.estimate.name}", t, values, ("",))


def _send(rr: Any, stream: Any, entity: str, t: Array, values: Array, labels: tuple[str, ...]) -> None:
    stream.log(entity, rr.SeriesLines(names=[n or entity.rsplit("/", 1)[1] for n in labels]), static=True)
    columns = rr.Scalars.columns(scalars=values)
    stream.send_columns(entity, indexes=[rr.TimeColumn("time", duration=t)], columns=columns)


def _thinned(t_ns: Any, rate_hz: float, *columns: Array) -> tuple[Array, ...]:
    """Times in s and columns, at about the rate or as they are if slower."""
    seconds = t_ns * 1e-9
    span = float(seconds[-1] - seconds[0]) if len(seconds) > 1 else 1.0
    step = max(1, round(len(seconds) / (span * rate_hz)))
    return seconds[::step], *(np.asarray(c[::step], dtype=float) for c in columns)


def _blueprint(recording: Recording, results: Sequence[Result], ahead: Ahead | None) -> Any:
    import rerun.blueprint as rrb

    cameras = [rrb.Spatial2DView(origin=f"cameras{t}", name=t.strip("/")) for t in camera_topics(recording)]
    series: list[Any] = []
    if ahead is not None and ahead.estimates:
        series += [
            rrb.TextDocumentView(origin="modes/told", name="told"),
            rrb.TimeSeriesView(origin="modes/probability", name="next step"),
        ]
    series += [rrb.TimeSeriesView(origin="error_mm", name="position error, mm")] if results else []
    series += [
        rrb.TimeSeriesView(origin=f"streams/{name}", name=name)
        for name in ("foot_l/imu", "foot_r/imu", "foot_l/insole", "foot_r/insole")
        if f"/{name}" in recording.topics
    ]
    left = rrb.Vertical(rrb.Spatial3DView(origin="world", name="walk"), rrb.Grid(*cameras), row_shares=[3, 2])
    world = left if cameras else rrb.Spatial3DView(origin="world", name="walk")
    return rrb.Blueprint(rrb.Horizontal(world, rrb.Vertical(*series), column_shares=[3, 2]), collapse_panels=True)
