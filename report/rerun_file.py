"""A walk as a Rerun file: terrain, paths, cameras, curves, mapped ground and predicted steps on one timeline."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES, ModeEstimate, StepPrediction
from stridetwin.evaluation.alignment import YawAlignment
from stridetwin.evaluation.evaluate import Result, true_frames
from stridetwin.evaluation.terrain_ahead import Ahead
from stridetwin.pipeline.terrain_files import KIND_COLORS, KINDS
from stridetwin.report.figures_path import outline, part_of
from stridetwin.report.figures_streams import curves_of, scalar_topics
from stridetwin.report.figures_terrain import WORDS, ellipse
from stridetwin.report.images import camera_topics, images_of, scaled
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import asked_name
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout, terrain_layout

GROUND, STEPS, MODE = "world/ahead", "world/steps", "modes"
_STEPS_HZ = 5.0
_INK, _TRUE = (15, 28, 46), (240, 244, 248)
_OVER_M = 0.01  # so that lines lie above the ground


def write_ahead(rr: Any, stream: Any, ahead: Ahead) -> None:
    """Adds the mapped ground and the predicted steps to a Rerun stream.

    Entities: `world/ahead/{ground,planes,edges}`, `world/steps/{true,predicted,ellipses}`, `modes/probability/MODE`,
    `modes/predicted`.
    """
    colors = [rr.AnnotationInfo(id=i, label=WORDS.get(k, k), color=KIND_COLORS[i]) for i, k in enumerate(KINDS)]
    stream.log(GROUND, rr.AnnotationContext(colors), static=True)
    for snapshot in ahead.snapshots:
        stream.set_time("time", duration=snapshot.t_ns * 1e-9)
        points = rr.Points3D(snapshot.points, class_ids=snapshot.kinds, radii=[0.02])
        stream.log(f"{GROUND}/ground", points)
        planes = rr.LineStrips3D(
            [line for line, _ in snapshot.planes], colors=[KIND_COLORS[k] for _, k in snapshot.planes], radii=[0.006]
        )
        stream.log(f"{GROUND}/planes", planes)
        edges = [line + [0.0, 0.0, _OVER_M] for line in snapshot.edges]
        stream.log(f"{GROUND}/edges", rr.LineStrips3D(edges, colors=[_INK], radii=[0.012]))
    _footprints(rr, stream, ahead.footprints)
    _steps(rr, stream, ahead)
    _modes(rr, stream, ahead)


def _footprints(rr: Any, stream: Any, footprints: list[Footprint]) -> None:
    made = [_closed(np.column_stack([outline(f), np.full(4, f.p_foot_in_world[2] + _OVER_M)])) for f in footprints]
    for i, footprint in enumerate(footprints):
        stream.set_time("time", duration=footprint.t_ns * 1e-9)
        stream.log(f"{STEPS}/true", rr.LineStrips3D(made[: i + 1], colors=[_TRUE], radii=[0.005]))


def _steps(rr: Any, stream: Any, ahead: Ahead) -> None:
    for estimate in _thinned(ahead.estimates):
        alignment = ahead.alignment.at(estimate.t_ns)
        known = [s for s in estimate.steps if np.isfinite(s.p_foot_in_world[:2]).all()]
        colors = [KIND_COLORS[KINDS.index(s.mode)] for s in known]
        stream.set_time("time", duration=estimate.t_ns * 1e-9)
        prints = [_sole(s, estimate, alignment) for s in known]
        stream.log(f"{STEPS}/predicted", rr.LineStrips3D(prints, colors=colors, radii=[0.006]))
        ellipses = [
            (_flat_ellipse(sole, alignment.rotation @ s.covariance @ alignment.rotation.T), c)
            for s, sole, c in zip(known, prints, colors)
            if np.isfinite(s.covariance).all()
        ]
        lines = rr.LineStrips3D([e for e, _ in ellipses], colors=[c for _, c in ellipses], radii=[0.003])
        stream.log(f"{STEPS}/ellipses", lines)


def _modes(rr: Any, stream: Any, ahead: Ahead) -> None:
    estimates = [e for e in ahead.estimates if e.steps]
    if not estimates:
        return
    t = np.array([e.t_ns * 1e-9 for e in estimates])
    for i, mode in enumerate(MODES):
        entity = f"{MODE}/probability/{mode}"
        stream.log(entity, rr.SeriesLines(names=[WORDS[mode]], colors=[KIND_COLORS[i]]), static=True)
        p = np.array([e.steps[0].probabilities[mode] for e in estimates])
        columns = rr.Scalars.columns(scalars=p)
        stream.send_columns(entity, indexes=[rr.TimeColumn("time", duration=t)], columns=columns)
    before = ""
    for estimate in _thinned(estimates):
        words = prediction_text(estimate)
        if words != before:
            stream.set_time("time", duration=estimate.t_ns * 1e-9)
            stream.log(f"{MODE}/predicted", rr.TextDocument(words))
            before = words


def prediction_text(estimate: ModeEstimate) -> str:
    """The prediction of the next step and of the next terrain change, as text."""
    step, change = estimate.steps[0], estimate.change
    foot = {"l": "left", "r": "right"}.get(step.foot, "next")
    lines = [f"next step ({foot}): {WORDS[step.mode]}, {100 * step.probabilities[step.mode]:.0f} %"]
    if change is not None:
        size = ""
        if math.isfinite(change.riser):
            size = f", riser {1e3 * change.riser:.0f} mm"
        if math.isfinite(change.tread):
            size += f", tread {1e3 * change.tread:.0f} mm"
        if math.isfinite(change.slope):
            size = f", {math.degrees(change.slope):.1f}°"
        lines.append(f"then {WORDS[change.mode]} in {change.distance:.1f} m{size}")
    return "\n".join(lines)


def _thinned(estimates: list[ModeEstimate]) -> Iterator[ModeEstimate]:
    """Some of the estimates, and every one at which the next step changes."""
    due_ns, step = -(2**62), -1
    for estimate in estimates:
        if estimate.t_ns >= due_ns or estimate.step != step:
            due_ns, step = estimate.t_ns + int(0.9e9 / _STEPS_HZ), estimate.step
            yield estimate


def _sole(step: StepPrediction, estimate: ModeEstimate, alignment: YawAlignment) -> Array:
    """(5, 3) m, the sole of a coming step in the true world."""
    half = 0.5 * (estimate.heading + alignment.yaw)
    place = _known_height(step, alignment)
    footprint = Footprint(
        topic="", t_ns=step.t_ns, foot=step.foot, p_foot_in_world=place, terrain="", mode=step.mode,
        q_world_foot=np.array([math.cos(half), 0.0, 0.0, math.sin(half)]),
    )  # fmt: skip
    return _closed(np.column_stack([outline(footprint), np.full(4, place[2] + _OVER_M)]))


def _flat_ellipse(sole: Array, covariance: Array) -> Array:
    """(25, 3) m, the 95 % ellipse of the sole's centre."""
    middle = sole[:4].mean(axis=0)
    xy = ellipse(middle, covariance)
    return np.column_stack([xy, np.full(len(xy), middle[2])])


def _known_height(step: StepPrediction, alignment: YawAlignment) -> Array:
    """(3,) m in the true world; unknown ground has the floor's height in the estimator's world."""
    return alignment.to_true(np.nan_to_num(step.p_foot_in_world, nan=0.0))


def _closed(corners: Array) -> Array:
    return np.vstack([corners, corners[:1]])


_COLORS = {"l": (11, 107, 203), "r": (217, 72, 15), "camera": (95, 61, 196), "truth": (70, 84, 104)}
_GROUND = {"level": (208, 216, 226), "stair": (170, 190, 214), "ramp": (184, 208, 184)}
_IMAGES_HZ, _CURVES_HZ, _POSES_HZ, _IMAGE_WIDTH = 5.0, 50.0, 30.0, 320


def rerun_installed() -> bool:
    """Whether Rerun can be imported."""
    return importlib.util.find_spec("rerun") is not None


def recording_id(recording: Recording) -> str:
    """The viewer's reproducible identifier of a recording; the viewer merges recordings with equal identifiers.

    The digest distinguishes walks that differ in more than seed and physics, and imported ones, which have neither.
    """
    metadata = recording.metadata
    spans = {topic: (i.count, i.first_ns, i.last_ns) for topic, i in recording.topics.items()}
    digest = hashlib.sha256(json.dumps([dict(metadata), spans], sort_keys=True).encode()).hexdigest()
    names = (metadata.get("scenario", "walk"), metadata.get("seed", ""), metadata.get("physics", ""))
    return "-".join(["stridetwin", *filter(None, names), digest[:12]])


def write_rerun(path: Path, recording: Recording, results: Sequence[Result], ahead: Ahead | None = None) -> None:
    """Writes a walk with its scored estimates, maps and predicted steps as `.rrd`.

    Raises:
        StrideTwinError: The file cannot be written.
    """
    import rerun as rr

    stream = rr.RecordingStream("stridetwin", recording_id=recording_id(recording))
    try:
        stream.save(path, default_blueprint=_blueprint(recording, results, ahead))
    except RuntimeError as error:
        raise StrideTwinError(f"{asked_name(str(path))}: cannot be written: {error}") from error
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _terrain(rr, stream, terrain_layout(recording.metadata))
    _paths(rr, stream, recording, results)
    _curves(rr, stream, recording, results)
    if ahead is not None:
        write_ahead(rr, stream, ahead)
    for topic in camera_topics(recording):
        for image in images_of(recording, topic, _IMAGES_HZ):
            stream.set_time("time", duration=image.t_ns / 1e9)
            stream.log(f"cameras{topic}", rr.Image(scaled(image, _IMAGE_WIDTH)).compress(jpeg_quality=70))
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
        t, p, q = _thinned_path(
            block.t_ns, _POSES_HZ, block.columns["p_frame_in_world"], block.columns["q_world_frame"]
        )
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
            t, values = _thinned_path(block.t_ns, _CURVES_HZ, curves.values)
            _send(rr, stream, f"streams{topic}/{name}", t, values, curves.labels)
    for result in results:
        error = np.linalg.norm(result.comparison.error_m, axis=1)[:, None] * 1000.0
        t, values = _thinned_path(result.comparison.truth.t_ns, _CURVES_HZ, error)
        _send(rr, stream, f"error_mm/{result.estimate.name}", t, values, ("",))


def _send(rr: Any, stream: Any, entity: str, t: Array, values: Array, labels: tuple[str, ...]) -> None:
    stream.log(entity, rr.SeriesLines(names=[n or entity.rsplit("/", 1)[1] for n in labels]), static=True)
    columns = rr.Scalars.columns(scalars=values)
    stream.send_columns(entity, indexes=[rr.TimeColumn("time", duration=t)], columns=columns)


def _thinned_path(t_ns: Any, rate_hz: float, *columns: Array) -> tuple[Array, ...]:
    """Times in s and columns, reduced to about the rate; unchanged if slower."""
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
            rrb.TextDocumentView(origin="modes/predicted", name="prediction"),
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
