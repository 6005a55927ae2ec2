"""A walk as a Rerun file: terrain, cameras, streams, and the outputs of every kind on one timeline."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from stridetwin.outputs.base import KindEvaluations
from stridetwin.outputs.rerun_curves import log_curves, thin_out
from stridetwin.outputs.truth import true_frames
from stridetwin.report.figures_streams import curves_of, scalar_topics
from stridetwin.report.images import camera_topics, images_of, scale_image
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import final_name
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.terrain_truth import Layout, terrain_layout

if TYPE_CHECKING:
    from rerun import RecordingStream

_GROUND = {"level": (208, 216, 226), "stair": (170, 190, 214), "ramp": (184, 208, 184)}  # red, green, blue by label
_IMAGES_HZ, _POSES_HZ, _IMAGE_WIDTH = 5.0, 30.0, 320  # rates, and width in pixels, of what is logged


def rerun_installed() -> bool:
    """Whether Rerun can be imported."""
    return importlib.util.find_spec("rerun") is not None


def recording_id(recording: Recording) -> str:
    """The viewer's reproducible identifier of a recording; the viewer merges recordings with equal identifiers.

    The digest distinguishes walks that differ in more than seed and physics, and imported ones, which have neither.
    """
    metadata = recording.metadata
    # number of samples, first and last stamp of each topic
    spans = {topic: (info.count, info.first_ns, info.last_ns) for topic, info in recording.topics.items()}
    digest = hashlib.sha256(json.dumps([dict(metadata), spans], sort_keys=True).encode()).hexdigest()
    names = (metadata.get("scenario", "walk"), metadata.get("seed", ""), metadata.get("physics", ""))
    return "-".join(["stridetwin", *filter(None, names), digest[:12]])


def write_rerun(path: Path, recording: Recording, of_kinds: Sequence[KindEvaluations]) -> None:
    """Writes a walk with its evaluated outputs as `.rrd`.

    Args:
        path: The file.
        recording: The walk.
        of_kinds: Evaluated outputs of each kind, which logs them itself.

    Raises:
        StrideTwinError: The file cannot be written.
    """
    import rerun as rr

    stream = rr.RecordingStream("stridetwin", recording_id=recording_id(recording))
    try:
        stream.save(path, default_blueprint=_blueprint(recording, of_kinds))
    except RuntimeError as error:
        raise StrideTwinError(f"{final_name(str(path))}: cannot be written: {error}") from error
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_terrain(rr, stream, terrain_layout(recording.metadata))
    _log_true_poses(rr, stream, recording)
    _log_streams(rr, stream, recording)
    for of_kind in of_kinds:
        of_kind.kind.log_rerun(rr, stream, of_kind.evaluations, recording)
    for topic in camera_topics(recording):
        for image in images_of(recording, topic, _IMAGES_HZ):
            stream.set_time("time", duration=image.t_ns / 1e9)
            stream.log(f"cameras{topic}", rr.Image(scale_image(image, _IMAGE_WIDTH)).compress(jpeg_quality=70))
    stream.flush()
    stream.disconnect()


def _log_terrain(rr: ModuleType, stream: RecordingStream, layout: Layout | None) -> None:
    """Logs every slab of the terrain as a mesh that reaches down to a common floor; nothing without a layout."""
    if layout is None:
        return
    floor = min(min(s.z0, s.z1) for s in layout.slabs) - 0.1  # 10 cm below the lowest end of any slab
    for i, slab in enumerate(layout.slabs):
        # (4, 3) m, corners of the top in order around it, and those below them on the floor; then the four sides
        tops = slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
        under = np.column_stack([tops[:, :2], np.full(4, floor)])
        sides = [(under[j], under[k], tops[k], tops[j]) for j, k in ((0, 1), (1, 2), (2, 3), (3, 0))]
        faces = np.array([tops, *sides], dtype=np.float32)
        # two triangles per face, (3 T, 3) corners one after the other, and the normal of each triangle
        flat = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        normals = np.cross(flat[1::3] - flat[::3], flat[2::3] - flat[::3])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mesh = rr.Mesh3D(
            vertex_positions=flat,
            vertex_normals=np.repeat(normals, 3, axis=0),
            vertex_colors=np.full((len(flat), 3), _GROUND[slab.terrain], np.uint8),
        )
        stream.log(f"world/terrain/{i:02d}_{slab.terrain}", mesh, static=True)


def _log_true_poses(rr: ModuleType, stream: RecordingStream, recording: Recording) -> None:
    """Logs the true poses of all frames at 30 Hz."""
    for frame in true_frames(recording.topics):
        block = recording.block(f"/truth/{frame}/odometry")
        t, p, q = thin_out(block.t_ns, _POSES_HZ, block.columns["p_frame_in_world"], block.columns["q_world_frame"])
        entity = f"world/truth/{frame}"
        stream.log(entity, rr.TransformAxes3D(0.12), static=True)  # length of the drawn axes, m
        stream.send_columns(
            entity,
            indexes=[rr.TimeColumn("time", duration=t)],
            # Rerun's order is x, y, z, w; ours begins with w
            columns=rr.Transform3D.columns(translation=p, quaternion=q[:, [1, 2, 3, 0]]),
        )


def _log_streams(rr: ModuleType, stream: RecordingStream, recording: Recording) -> None:
    """Logs every curve of the small streams."""
    for topic in scalar_topics(recording):
        block = recording.block(topic)
        for curves in curves_of(block):
            # the quantity without sensor and unit, such as `angular_rate`
            name = curves.title.rsplit(": ", 1)[1].split(",")[0].replace(" ", "_")
            log_curves(rr, stream, f"streams{topic}/{name}", block.t_ns, curves.values, curves.labels)


def _blueprint(recording: Recording, of_kinds: Sequence[KindEvaluations]) -> Any:
    """The viewer's arrangement: the walk and the cameras at the left, outputs and streams at the right."""
    import rerun.blueprint as rrb

    views = {"text": rrb.TextDocumentView, "series": rrb.TimeSeriesView}  # by the names in `rerun_views`
    cameras = [rrb.Spatial2DView(origin=f"cameras{t}", name=t.strip("/")) for t in camera_topics(recording)]
    series: list[Any] = [  # the views of the outputs, then the streams of both feet
        views[view](origin=entity, name=title)
        for of_kind in reversed(of_kinds)
        for entity, (view, title) in of_kind.kind.rerun_views(of_kind.evaluations).items()
    ]
    series += [
        rrb.TimeSeriesView(origin=f"streams/{name}", name=name)
        for name in ("foot_l/imu", "foot_r/imu", "foot_l/insole", "foot_r/insole")
        if f"/{name}" in recording.topics
    ]
    # walk above cameras, or the walk alone where there are none
    walk_and_cameras = rrb.Vertical(
        rrb.Spatial3DView(origin="world", name="walk"), rrb.Grid(*cameras), row_shares=[3, 2]
    )
    left = walk_and_cameras if cameras else rrb.Spatial3DView(origin="world", name="walk")
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Vertical(*series), column_shares=[3, 2]), collapse_panels=True)
