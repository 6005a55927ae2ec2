"""What was seen ahead, over time, in a Rerun file: ground, planes and edges, coming steps, and what is told of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES, ModeEstimate, StepPrediction
from stridetwin.scenarios.ahead import Ahead
from stridetwin.scenarios.figures_ahead import WITHIN_95, WORDS
from stridetwin.scenarios.figures_path import outline
from stridetwin.scenarios.ground_grid import KIND_COLORS, KINDS
from stridetwin.scenarios.laying import Laying
from stridetwin.streams.samples import Array, Footprint

GROUND, STEPS, MODE = "world/ahead", "world/steps", "modes"
_STEPS_HZ = 5.0
_INK, _TRUE = (15, 28, 46), (240, 244, 248)
_OVER_M = 0.01  # so that lines do not lie in the ground
_ROUND = np.linspace(0.0, 2.0 * math.pi, 25)


def write_ahead(rr: Any, stream: Any, ahead: Ahead) -> None:
    """Adds it to a Rerun stream.

    Entities: `world/ahead/{ground,planes,edges}`, `world/steps/{true,told,ellipses}`, `modes/probability/MODE`,
    `modes/told`.
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
        laid = ahead.laid.at(estimate.t_ns)
        known = [s for s in estimate.steps if np.isfinite(s.p_foot_in_world[:2]).all()]
        colors = [KIND_COLORS[KINDS.index(s.mode)] for s in known]
        stream.set_time("time", duration=estimate.t_ns * 1e-9)
        prints = [_sole(s, estimate, laid) for s in known]
        stream.log(f"{STEPS}/told", rr.LineStrips3D(prints, colors=colors, radii=[0.006]))
        ellipses = [
            (_ellipse(sole, laid.rotation @ s.covariance @ laid.rotation.T), c)
            for s, sole, c in zip(known, prints, colors)
            if np.isfinite(s.covariance).all()
        ]
        lines = rr.LineStrips3D([e for e, _ in ellipses], colors=[c for _, c in ellipses], radii=[0.003])
        stream.log(f"{STEPS}/ellipses", lines)


def _modes(rr: Any, stream: Any, ahead: Ahead) -> None:
    told = [e for e in ahead.estimates if e.steps]
    if not told:
        return
    t = np.array([e.t_ns * 1e-9 for e in told])
    for i, mode in enumerate(MODES):
        entity = f"{MODE}/probability/{mode}"
        stream.log(entity, rr.SeriesLines(names=[WORDS[mode]], colors=[KIND_COLORS[i]]), static=True)
        p = np.array([e.steps[0].probabilities[mode] for e in told])
        columns = rr.Scalars.columns(scalars=p)
        stream.send_columns(entity, indexes=[rr.TimeColumn("time", duration=t)], columns=columns)
    before = ""
    for estimate in _thinned(told):
        words = told_words(estimate)
        if words != before:
            stream.set_time("time", duration=estimate.t_ns * 1e-9)
            stream.log(f"{MODE}/told", rr.TextDocument(words))
            before = words


def told_words(estimate: ModeEstimate) -> str:
    """What is told of the next step, and of the next change, in words."""
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
    """Some of the estimates, and every one after which another step is the next."""
    due_ns, step = -(2**62), -1
    for estimate in estimates:
        if estimate.t_ns >= due_ns or estimate.step != step:
            due_ns, step = estimate.t_ns + int(0.9e9 / _STEPS_HZ), estimate.step
            yield estimate


def _sole(step: StepPrediction, estimate: ModeEstimate, laid: Laying) -> Array:
    """(5, 3) m, the sole of a coming step in the true world."""
    half = 0.5 * (estimate.heading + laid.turn)
    place = _known_height(step, laid)
    footprint = Footprint(
        topic="", t_ns=step.t_ns, foot=step.foot, p_foot_in_world=place, terrain="", mode=step.mode,
        q_world_foot=np.array([math.cos(half), 0.0, 0.0, math.sin(half)]),
    )  # fmt: skip
    return _closed(np.column_stack([outline(footprint), np.full(4, place[2] + _OVER_M)]))


def _ellipse(sole: Array, covariance: Array) -> Array:
    """(25, 3) m, where the middle of the sole lands with 95 %."""
    middle = sole[:4].mean(axis=0)
    variances, axes = np.linalg.eigh(covariance)
    half = WITHIN_95 * np.sqrt(np.maximum(variances, 0.0))
    xy = middle[:2] + (np.column_stack([np.cos(_ROUND), np.sin(_ROUND)]) * half) @ axes.T
    return np.column_stack([xy, np.full(len(xy), middle[2])])


def _known_height(step: StepPrediction, laid: Laying) -> Array:
    """(3,) m in the true world; where no ground is known under the step, at the height of the floor of its world."""
    return laid.to_true(np.nan_to_num(step.p_foot_in_world, nan=0.0))


def _closed(corners: Array) -> Array:
    return np.vstack([corners, corners[:1]])
